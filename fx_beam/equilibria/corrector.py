"""The corrector of a step along a path: Newton's method for the unknowns and the load factor."""

from __future__ import annotations

import numpy as np

from fx_beam.results.state import State
from fx_beam.step.load_loop import StepSolution
from fx_beam.step.newton import ENERGY_FLOOR, SEARCHES, newton
from fx_beam.step.step_failures import StepFailed

from .path_equations import PathEquations, Tangent


class Corrector:
    """Increments (y, l) from a state with R(y, l) = 0 and <normal, (y, l)> = distance.

    The predictor is a length along a tangent.
    """

    def __init__(self, path: PathEquations, start: State, normal: Tangent, distance: float):
        self._path, self._start, self._normal, self._distance = path, start, normal, distance
        self._failures = path.loop.failures

    def corrected(self, tangent: Tangent, length: float) -> tuple[StepSolution, float]:
        """The step, and its load factor l; StepFailed if Newton's method does not converge."""
        for _ in range(SEARCHES):
            self._predict(tangent, length)
            try:
                return self._solve(length * tangent.D), self._load
            except StepFailed as failure:
                last = failure
                if failure.kind != "members":  # those near to points are found in a search
                    raise
        raise last

    def _predict(self, tangent: Tangent, length: float) -> None:
        self._path.set_start(self._start)
        self._y, self._load = length * tangent.y, length * tangent.load
        self._D, self._sizes = length * tangent.D, list[float]()

    def _solve(self, predicted: np.ndarray) -> StepSolution:
        """The step from a predictor (size,)."""
        options = self._failures.options
        iterations, ended_by = newton(self._correct, options.tolerance, options.max_iterations)
        if not ended_by:
            raise self._failures.unconverged(self._D, self._sizes)
        r, load_slopes, dy, dload = self._last
        r = r + self._path.loop.equations.change(self._path.spread(dy, 0.0)) + dload * load_slopes
        self._failures.check_places(self._D, self._sizes)
        return StepSolution(self._D, self._y, r, iterations, ended_by, predicted)

    def _correct(self) -> tuple[float, bool]:
        """Size of a correction (dy, dl), and whether it may be round-off."""
        path, failures, normal = self._path, self._failures, self._normal
        (D, f, r, residual), load_slopes, column = path.balance(self._y, self._load)
        residual = residual[: len(self._y)]
        missing = path.along(normal, D, self._load) - self._distance
        dy, dload = path.solve(column, normal, -residual, -missing)
        correction = path.spread(dy, dload)
        factor = failures.shortening(correction)
        size = max((abs(correction) / path.model.units.nodes).max(), abs(dload))
        failures.check_finite(size, self._sizes)
        self._sizes.append(size)
        #: Forces (size,) at nodes before the correction, with their derivatives by the load factor.
        self._last = r, load_slopes, dy, dload
        self._y, self._load = self._y + factor * dy, self._load + factor * dload
        self._D = path.expand(self._y, self._load)
        failures.check_turn(self._D, self._sizes)
        return size, abs(residual @ dy) <= ENERGY_FLOOR * (abs(f) @ abs(self._D))
