"""Newton's method for the increment of one step of time or load."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from fx_beam.fem.member_contacts import FINE, MOVED, PASSED, SLID
from fx_beam.laws.interval import Interval
from fx_beam.results.state import State
from fx_beam.validation import as_float, is_whole, require

from .equations import Balance, Equations
from .line_search import line_search
from .linear_solver import LinearSolver

# A correction that rotates a node further than this [rad] is shortened to it. The first correction
# overshoots if the axial force makes the tangent nearly singular. For the pinned beam at dt 0.02
# this avoids halving every tenth step and costs no iteration.
LONGEST_TURN = 0.5
# Rounding error of the energy, relative to the energy of the step.
ENERGY_FLOOR = 4 * np.finfo(float).eps
# Largest work of the last correction, relative to the tolerance times the energy of the step.
ENERGY_SHARE = 1e-4
# Largest next correction, relative to the tolerance, that is left out. It is predicted by quadratic
# convergence.
NEGLIGIBLE = 1e-6
# The predictor is used up to this relative error in the previous step.
PREDICTOR_ERROR = 0.4
# Largest number of searches for the members that points come near in a step.
SEARCHES = 8


@dataclass(frozen=True)
class NewtonOptions:
    """When Newton's method stops.

    Parameters
    ----------
    tolerance : float
        Largest entry of the last correction: displacements divided by the size of the scene (1 m
        for a single node), and rotations in radians. Convergence is quadratic: the remaining error
        is far smaller. In a stiff scene a small correction may do much work; the work of the last
        correction is at most 1e-4 times the tolerance, relative to the energy of the step. The last
        correction may be larger if the next one, predicted by quadratic convergence, would be at
        most 1e-6 times the tolerance, and if its own work is at most the tolerance times twice the
        kinetic energy.
    max_iterations : int
        Largest number of corrections; the step fails if it has not converged by then.
    max_turn : float
        Largest increment of a nodal rotation in a step [rad], below pi: the mid-point rule uses
        the tangent of half the increment, which is valid for less than a half turn.

    Raises
    ------
    SceneError
        If a value is out of range; the message names it.

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.NewtonOptions(tolerance=1e-8)
    NewtonOptions(tolerance=1e-08, max_iterations=40, max_turn=2.0)
    """

    tolerance: float = 1e-10
    max_iterations: int = 40
    max_turn: float = 2.0

    def __post_init__(self):
        tolerance, turn = as_float(self.tolerance), as_float(self.max_turn)
        for name, fits, wanted in (
            ("tolerance", 0 < tolerance < 1, "a number between 0 and 1"),
            ("max_iterations", is_whole(self.max_iterations, 1), "a whole number from 1 on"),
            ("max_turn", 0 < turn < np.pi, "a number between 0 and pi, a half turn [rad]"),
        ):
            require(fits, f"NewtonOptions: {name}", getattr(self, name), wanted)
        checked = (tolerance, int(self.max_iterations), turn)
        for name, value in zip(("tolerance", "max_iterations", "max_turn"), checked, strict=True):
            object.__setattr__(self, name, value)


@dataclass
class StepSolution:
    """A converged step."""

    #: Increment (size,) of displacements and rotations, and (free,) of the unknowns.
    D: np.ndarray
    y: np.ndarray
    #: Forces and couples (size,) of supports and joints at the scheme's level [N, N m].
    r: np.ndarray
    #: Number of corrections, and why they ended: "increment" or "round-off".
    iterations: int
    ended_by: str
    #: D by the tangent at the start: the linear predictor.
    predicted: np.ndarray


class StepFailed(Exception):
    """A failed step: kind and reason as in `Failure`, last increment, norms of the residuals."""

    def __init__(self, kind: str, reason: str, D: np.ndarray, residuals: list[float]):
        super().__init__(reason)
        self.kind, self.reason = kind, reason
        self.D = D
        self.residuals = residuals


class Predictor(Protocol):
    """Predicts increments from those of the last steps."""

    def predict(self, dt: float) -> np.ndarray | None:
        """Predicted unknowns (free,) of a step of length dt [s]; None without a prediction."""

    def update(self, dt: float, step: StepSolution) -> None:
        """Add the increment of a step of length dt [s]."""


class Newton:
    """Newton's method for the increment over a step."""

    def __init__(self, equations: Equations, options: NewtonOptions):
        self.equations, self.model, self.options = equations, equations.model, options
        #: What predicts increments, if anything does.
        self.predictor: Predictor | None = None
        #: Holding forces (free,) on the unknowns, in addition to the forces of the model.
        self.hold: np.ndarray = np.zeros(self.model.reduction.free)

    def use(self, equations: Equations, linear: Any) -> None:
        """Solve other equations, whose linear systems a solver of their own may solve."""
        self.equations = equations
        self.__dict__.pop("linear", None)
        if linear is not None:
            self.linear = linear

    @functools.cached_property
    def linear(self) -> LinearSolver:
        """The linear systems of the corrections."""
        return LinearSolver(self.model.reduction)

    @np.errstate(over="ignore", invalid="ignore")  # a step that overflows fails, and says so
    def solve(
        self,
        interval: Interval,
        start: State,
        force: np.ndarray,
        driven: np.ndarray,
        known: StepSolution | None = None,
    ) -> StepSolution:
        """Increment over a step, for dead loads (size,) at the scheme's level and driven motion.

        StepFailed if it does not converge. It may begin at an increment that is `known`.
        """
        for _ in range(SEARCHES):
            try:
                return self._solve_once(interval, start, force, driven, known)
            except StepFailed as failure:
                last = failure
                if failure.kind != "members":
                    raise
        raise last

    def _solve_once(
        self,
        interval: Interval,
        start: State,
        force: np.ndarray,
        driven: np.ndarray,
        known: StepSolution | None,
    ) -> StepSolution:
        """The same with the members that points are near, as they are known."""
        self.equations.begin(interval, start)
        at_rest = self.model.scheme.rates.at_rest
        predictor = self.predictor
        predicted_y = None if predictor is None else predictor.predict(interval.length)
        if self.model.reduction.singularity:
            return self._out_of_line(interval, start, force, driven, predicted_y)
        moving = 0.0 if at_rest else float(start.v @ (self.model.mass @ start.v))
        if known is not None:
            return self._solve(force, driven, moving, known.y)
        try:
            step = self._solve(force, driven, moving, predicted_y)
        except StepFailed:
            if predicted_y is None:
                raise
            step = self._solve(force, driven, moving, None)
        if predictor is not None:
            predictor.update(interval.length, step)
        return step

    def _out_of_line(self, interval, start, force, driven, predicted_y) -> StepSolution:
        """Step from a singular position of loops: it goes on with the motion.

        The loops are closed by unknowns that can do so at the end of the step.
        """
        model, reduction = self.model, self.model.reduction
        at_rest = model.scheme.rates.at_rest
        if predicted_y is None and not at_rest:
            slides = np.zeros(model.scene.joint_count)
            predicted_y = model.couplings.unknowns(interval.length * start.v, slides)
        if predicted_y is not None:
            reduction.choose(predicted_y, driven)
        if reduction.singularity:
            D = np.zeros(model.size)
            raise StepFailed("singular", reduction.singularity, D, [])
        return self._solve(force, driven, float(start.v @ (model.mass @ start.v)), predicted_y)

    def _solve(self, force, driven, moving: float, predicted_y: np.ndarray | None) -> StepSolution:
        """Newton iterations from a predictor, or from the previous configuration."""
        model, options, reduction = self.model, self.options, self.model.reduction
        free = reduction.free
        y = np.zeros(free) if predicted_y is None else predicted_y
        moved_first = predicted_y is None and driven.any()
        driven_now = np.zeros(reduction.driven) if moved_first else driven
        residuals: list[float] = []
        sizes, errors, small_corrections, gained = _Sequence(), _Sequence(), 0, 0.0
        step = np.zeros(reduction.columns)
        for iteration in range(1, options.max_iterations + 1):
            balance = self._balance(y, driven_now, force)
            if iteration > 1 and model.may_overshoot:
                at = functools.partial(self._balance, driven=driven_now, force=force)
                y, balance = line_search(model, y, step[:free], gained, balance, at)
            model.points.remember()
            D, f, r, residual = balance
            residuals.append(abs(residual).max(initial=0.0))
            step = np.zeros(reduction.columns)
            if driven_now is not driven:
                # Driven motion is part of the first correction: the neighbours of a moved support
                # follow by the linearised equations.
                step[free : free + reduction.driven], driven_now = -driven, driven
                moved = self.equations.change(reduction.spread(step))
                residual = reduction.project(r - moved)[:free] - self.hold
            energy = float(abs(f) @ abs(D)) + moving
            step[:free] = self.linear.solve(self.equations, r, residual, energy)
            correction = reduction.spread(step)
            if iteration == 1:
                predicted = -correction
            shortening = self.shortening(correction)
            step[:free] *= shortening
            y = y - step[:free]
            size = float((abs(correction) / model.unit).max())
            self.check_finite(size, residuals)
            # A correction that was shortened is far from the solution, whatever its work.
            small, stalled = size <= options.tolerance, size > 0.5 * sizes.last and shortening == 1
            gained = float(residual @ step[:free])
            work = abs(gained)
            negligible = NEGLIGIBLE * options.tolerance
            next_size = max(sizes.next_after(size), self.linear.error * size)
            final = next_size <= negligible
            final &= errors.next_after(work**0.5) <= negligible * energy**0.5
            # In very stiff scenes the forces before the correction make the energy far too large.
            final &= work <= options.tolerance * moving
            small_corrections += small
            ended_by = None
            # A third small correction shows that only rounding errors are left.
            small_work = work <= ENERGY_SHARE * options.tolerance * energy
            # An equilibrium may start a motion: its error would be an acceleration.
            final &= iteration > 2 and not self.equations.model.scheme.rates.at_rest
            if final or (small and (small_work or small_corrections > 2)):
                ended_by = "increment"
            elif stalled and not small and work <= ENERGY_FLOOR * energy:
                ended_by = "round-off"
            if ended_by:  # forces at the corrected state, to first order
                r = r - self.equations.change(correction)
            D = reduction.expand(y, driven)
            self.check_turn(D, residuals)
            if ended_by:
                self.check_slides(D, residuals)
                self.check_members(D, residuals)
                return StepSolution(D, y, r, iteration, ended_by, predicted)
        reason = f"no convergence in {options.max_iterations} iterations"
        raise StepFailed("no convergence", reason, D, residuals)

    def _balance(self, y: np.ndarray, driven: np.ndarray, force: np.ndarray) -> Balance:
        """The equations, with the residual of the unknowns (free,) less what holds them."""
        balance = self.equations.at(y, driven, force)
        return balance._replace(residual=balance.residual[: len(y)] - self.hold)

    # -- Checks, also for arc-length steps --------------------------------------------------------

    def shortening(self, correction: np.ndarray) -> float:
        """Factor that limits the rotations of a correction (size,)."""
        turn = abs(correction[self.model.turns]).max()
        return LONGEST_TURN / turn if LONGEST_TURN < turn < np.inf else 1.0

    def check_finite(self, size: float, residuals: list[float]) -> None:
        """Reject a correction whose size is not finite."""
        if not np.isfinite(size):
            D = np.full(self.model.size, np.nan)
            reason = "the tangent is singular or a value is not finite"
            raise StepFailed("singular", reason, D, residuals)

    def check_turn(self, D: np.ndarray, residuals: list[float]) -> None:
        """Reject an increment (size,) with a rotation above the bound."""
        turn = abs(D[self.model.turns]).max()
        if not np.isfinite(turn):
            raise StepFailed("no convergence", "a loop of joints cannot be closed", D, residuals)
        if turn > self.options.max_turn:
            raise StepFailed(
                "large rotation",
                f"a node turns by {turn:.3g} rad in one step, more than max_turn = "
                f"{self.options.max_turn:g}",
                D,
                residuals,
            )

    def check_members(self, D: np.ndarray, residuals: list[float]) -> None:
        """Reject a step in which a point passes a member, or comes near more than were found."""
        members = self.model.points.members
        state = FINE if members is None else members.check(D)
        if state in (MOVED, SLID):
            reason = "points move further in contact with members than half an element"
            raise StepFailed("members", reason, D, residuals)
        if state == PASSED:
            reason = (
                "a node passes through the middle of a member. Raise the stiffness of the contact, "
                "or the radius of the members"
            )
            raise StepFailed("members", reason, D, residuals)

    def check_slides(self, D: np.ndarray, residuals: list[float]) -> None:
        """Reject a step in which a node leaves the beam on which it slides."""
        if (fault := self.model.reduction.fault()) is not None:
            raise StepFailed(*fault, D, residuals)


class _Sequence:
    """A sequence that converges quadratically: its last value, and its slowest convergence."""

    def __init__(self) -> None:
        self.last, self._slowest = np.inf, 0.0

    def next_after(self, value: float) -> float:
        """Add a value; returns a bound of the one after it."""
        square = self.last * self.last
        ratio = value / square if square else np.inf * value
        self._slowest, self.last = max(self._slowest, ratio), value
        return self._slowest * (value * value)
