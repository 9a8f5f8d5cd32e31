"""Local errors of steps, relative to what is allowed; compare local_error.h."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.step.local_error import AVERAGED, order_and_constant
from fx_beam.step.model import Model


class _Memory(NamedTuple):
    #: Times since the configurations before the last one [s], the latest first.
    ages: np.ndarray
    #: Divided differences of orders 1 to p, each (size,).
    differences: list[np.ndarray]
    #: The last differences of order p + 1, each (size,), the latest first.
    highest: list[np.ndarray]


class LocalError:
    """Local errors of steps, relative to what is allowed."""

    def __init__(self, model: Model):
        self.order, _ = order_and_constant(model.scheme)
        self._unit = model.unit
        self._displaced = np.ones(model.size, dtype=bool)
        self._displaced[model.turns] = False
        self.forget()

    def forget(self) -> None:
        """Begin anew: the next steps are not compared with those before."""
        #: What the estimate of the next step needs; a copy is a reference to it.
        self.memory = _Memory(np.empty(0), [], [])

    def add(self, D: np.ndarray, dt: float, smooth: float, raw: float) -> float | None:
        """Ratio of the error to what is allowed, in a step with increment D (size,), length dt [s].

        The factors are those of `StepControl.factors`. None in the first steps.
        """
        ages = dt + np.concatenate([[0.0], self.memory.ages])
        now = [D / dt]
        for old, age in zip(self.memory.differences, ages[1:], strict=True):
            now.append((now[-1] - old) / age)
        highest, product = self.memory.highest, np.prod(ages)
        if len(now) > self.order:
            highest = [now.pop(), *highest][:AVERAGED]
        self.memory = _Memory(ages[: len(now)], now, highest)
        if len(highest) < AVERAGED:
            return None
        mean = (highest[0] + 2 * highest[1] + highest[2]) / 4
        sizes = abs(mean / self._unit)[self._displaced], abs(highest[0] / self._unit)
        return product * max(smooth * sizes[0].max(initial=0.0), raw * sizes[1].max())
