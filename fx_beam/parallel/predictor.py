"""Increments that are predicted from those of the last steps; compare `update_predictor` in C."""

from __future__ import annotations

import numpy as np

from fx_beam.results.state import Past
from fx_beam.step.model import Model
from fx_beam.step.newton import PREDICTOR_ERROR, StepSolution

# Largest order of the predictor.
_PAST = 4


class Predictor:
    """Predictor of an increment: a polynomial in time through the last configurations.

    By Newton's formula with divided differences, since steps may have different lengths.
    """

    def __init__(self, model: Model):
        self._model, self._unit = model, model.unit
        self.forget()

    def forget(self) -> None:
        """Begin anew: the next step has no prediction."""
        #: Times since the last configurations [s], the latest first.
        self._ages = np.empty(0)
        #: Divided differences, from order 1 on, of configurations (size,) and of unknowns (free,).
        self._past: list[np.ndarray] = []
        self._past_y: list[np.ndarray] = []
        #: Orders of extrapolation, for each sub-step of the scheme, and the next sub-step.
        self._orders = np.zeros(len(self._model.scheme.fractions), dtype=int)
        self._next = 0

    @property
    def memory(self) -> tuple:
        """All on which the next predictions depend."""
        return self._ages, self._past, self._past_y, self._orders, self._next

    @memory.setter
    def memory(self, memory: tuple) -> None:
        self._ages, self._past, self._past_y, self._orders, self._next = memory

    @property
    def past(self) -> Past:
        """The last motion, in a form that does not depend on the numbering of unknowns."""
        model, known = self._model, len(self._past)
        y = np.reshape(self._past_y, (known, model.reduction.free))
        slides = model.couplings.free_slides(y, model.scene.joint_count)
        differences = np.reshape(self._past, (known, model.size))
        return Past(self._ages, self._orders, differences, slides)

    @past.setter
    def past(self, past: Past | None) -> None:
        if past is not None:
            self._ages, self._orders, self._next = past.ages, past.orders, 0
            self._past = list(past.differences)
            self._past_y = list(self._model.couplings.unknowns(past.differences, past.slides))

    def predict(self, dt: float) -> np.ndarray | None:
        """Predicted unknowns (free,) of a step of length dt [s]; None without a prediction."""
        order = self._orders[self._next]
        if not order:
            return None
        factors = np.cumprod([dt, *(dt + self._ages[: order - 1])])
        return np.sum([c * d for c, d in zip(factors, self._past_y, strict=False)], axis=0)

    def update(self, dt: float, step: StepSolution) -> None:
        """Add the increment of a step of length dt [s], and choose the order of extrapolation.

        A scheme with sub-steps has an order for each: some go back between known configurations.
        """
        ages = dt + np.concatenate([[0.0], self._ages])
        best, order = PREDICTOR_ERROR * self._size(step.D), 0
        now, now_y, product = [step.D / dt], [step.y / dt], dt
        for old, old_y, age in zip(self._past, self._past_y, ages[1:], strict=True):
            now.append((now[-1] - old) / age)
            now_y.append((now_y[-1] - old_y) / age)
            product *= age
            if (error := self._size(now[-1]) * abs(product)) <= best:
                best, order = error, len(now) - 1
        self._past, self._past_y, self._ages = now[:_PAST], now_y[:_PAST], ages[:_PAST]
        self._orders = self._orders.copy()  # `memory` may have the one before
        self._orders[self._next] = order
        self._next = (self._next + 1) % len(self._orders)

    def _size(self, D: np.ndarray) -> float:
        return abs(D / self._unit).max()
