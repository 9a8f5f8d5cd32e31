"""How the states of a linear system are read from a motion."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.results.state import State
from fx_beam.scene.inputs import values_of
from fx_beam.step.recorded_histories import driven_of

from .moving_state import Deviations


class Reading:
    """Reads deviations of a motion from a state; it holds arrays alone, and no model.

    `driven` inputs are numbers and factors of their first motions; inputs `straining` a material
    are their numbers, places in all inputs, and values in the state.
    """

    def __init__(
        self,
        about: Deviations,
        driven: Sequence[tuple[int, float]],
        straining: Sequence[tuple[int, int, float]],
        count: int,
    ):
        model, state = about.model, about.state
        self._q, self._slides, self._t = state.q, state.slides, state.t
        self._frame, self._factor = about.frame, about.factor
        self._T, self._dT, self._rates = about.T, about.dT, about.rates
        self._rates_from = about.rates_from
        self._widths = dict(about.held.widths)
        self._driven, self._straining, self._count = driven, straining, count
        D, slides = np.split(np.eye(model.size + len(self._slides)), [model.size], axis=1)
        unknowns = model.couplings.unknowns(D, slides)[:, about.unknowns]
        self._free = len(about.unknowns)
        #: What is read of displacements and slides: unknowns, then driven motions.
        self._read = np.hstack([unknowns, driven_of(model, D, slides)]).T

    def read(
        self, q: np.ndarray, v: np.ndarray, slides: np.ndarray, end: State
    ) -> tuple[np.ndarray, ...]:
        """Unknowns y, y', positions p, p' of driven inputs, and inputs u that strain.

        For displacements q (nodes, 3), rates v, slides (joints,), and a state with its time [s]
        and inputs.
        """
        if q.size != self._q.size or len(slides) != len(self._slides):
            raise SceneError("deviation: the motion is one of another scene")
        q, v = q.reshape(-1), v.reshape(-1)
        if self._frame is not None:
            q, v = self._frame.seen(q, v, self._factor, end.t - self._t)
        z = self._read @ np.concatenate([q - self._q, slides - self._slides])
        rates = self._rates_from @ (v - self._T @ self._rates - self._dT @ z)
        p, dp = (
            np.array([values[self._free + number] / factor for number, factor in self._driven])
            for values in (z, rates)
        )
        u = np.zeros(self._count)
        if (inputs := values_of(end, self._widths)) is not None:
            for number, place, value in self._straining:
                u[number] = inputs[place] - value
        return z[: self._free], rates[: self._free], p, dp, u
