"""Stability along a path of equilibria."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from fx_beam.results.solution import Solution
from fx_beam.results.stability import Stability
from fx_beam.results.state import State

from .critical_points import CriticalPoint, CriticalPoints
from .load_steps import LoadStepper
from .small_motions import SmallMotions

_log = logging.getLogger("fx_beam")


class PathStability:
    """Stability of the states of a path; `solved` makes a solution of a single state.

    The first state may be a bifurcation at which the path `branches_off`.
    """

    def __init__(
        self,
        stepper: LoadStepper,
        states: list[State],
        solved: Callable[[State], Solution],
        branches_off: bool = False,
    ):
        # There an eigenvalue is zero: it counts as the first state behind it.
        self._first = int(branches_off and len(states) > 1)
        self._motions, self._states = SmallMotions(stepper), states
        self._points = CriticalPoints(stepper, states, solved)

    def found_when_read(self) -> Stability:
        """For a solution."""
        return Stability(self.unstable_modes, self.critical_points)

    def critical_points(self) -> list[CriticalPoint]:
        """The critical points between the states, and at their end; none if modes are unknown."""
        try:
            counts = self.unstable_modes()
        except ValueError as error:
            _log.warning("critical_points: none is known. %s", error)
            return []
        return self._points.between(counts, self._failed)

    def at_end(self) -> list[CriticalPoint]:
        """The critical point at the end of the path, or ahead of it if it has failed."""
        return self._points.at_end(self.unstable_modes(), self._failed)

    @property
    def _failed(self) -> bool:
        failure = self._motions.stepper.stats.failure
        return failure is not None and failure.kind != "too many steps"

    def unstable_modes(self) -> np.ndarray:
        """Numbers (n,) of modes that grow: those of the steps' factors, else of new ones."""
        states = self._states[self._first :]
        known = [state.negative_eigenvalues for state in states]
        if None in known and self._motions.model.flows:
            raise ValueError(
                "unstable_modes: where friction slips or material flows, the tangent is not "
                "symmetric, and small motions have no modes"
            )
        counts: list[int] = []
        limits = self._motions.stepper.stats.limit_points
        for count, state in zip(known, states, strict=True):
            if counts and state.t in limits:
                counts.append(counts[-1])  # an eigenvalue is zero
            else:
                counts.append(sum(self._motions.growing(state)) if count is None else count)
        return np.array(counts[:1] * self._first + counts, dtype=int)
