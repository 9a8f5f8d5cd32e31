"""Newton's method for the increment of one time step, on PETSc."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np

from fx_beam.mechanics.interval import Interval
from fx_beam.model.equations import Equations
from fx_beam.model.model import Model
from fx_beam.results.state import Past, State
from fx_beam.validation import is_number, is_whole, require

# A correction that turns a node further [rad] is shortened to this. From the previous
# configuration the first one overshoots where axial force has nearly emptied the tangent;
# on the pinned beam this replaces one step halved in ten at dt 0.02 and costs no iteration.
LONGEST_TURN = 0.5
# Part of the step's energy that rounding leaves undetermined.
ENERGY_FLOOR = 4 * np.finfo(float).eps
# Part of the step's energy, times the tolerance, that the last correction may still bring in.
ENERGY_SHARE = 1e-4
# Relative error up to which the last increments are taken to foretell the next one.
CLOSE = 0.4
# Increments that are remembered for this.
_PAST = 4


@dataclass(frozen=True)
class NewtonOptions:
    """When Newton's method stops.

    Parameters
    ----------
    tolerance : float
        Largest entry of the last correction: displacements over the size of the scene, and
        rotations in radians. Convergence is quadratic, so that the error left is far smaller. In
        a stiff scene a small correction may still bring in much energy; of this the last one may
        bring no more than a ten-thousandth of the tolerance, relative to what moves in the step.
    max_iterations : int
        Corrections before the step is given up.
    max_turn : float
        Largest increment of a nodal rotation in a step [rad], below pi: the mid-point rule takes
        the tangent of half of it, which has no meaning beyond a half turn.

    Raises
    ------
    SceneError
        For a value out of range, naming it.

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
        tolerance, most, turn = self.tolerance, self.max_iterations, self.max_turn
        for name, fits, wanted in (
            ("tolerance", is_number(tolerance) and 0 < tolerance < 1, "a number between 0 and 1"),
            ("max_iterations", is_whole(most, 1), "a whole number from 1 on"),
            (
                "max_turn",
                is_number(turn) and 0 < turn < np.pi,
                "a number between 0 and pi, a half turn [rad]",
            ),
        ):
            require(fits, f"NewtonOptions: {name}", getattr(self, name), wanted)


@dataclass
class StepSolution:
    """A converged step."""

    #: Increment (size,) of displacements and rotations, and (free,) of the unknowns.
    D: np.ndarray
    y: np.ndarray
    #: Forces and couples (size,) of supports and joints at the scheme's level [N, N m].
    r: np.ndarray
    #: Corrections made, and what ended them: "increment" or "round-off".
    iterations: int
    ended_by: str
    #: What the tangent at the start gives for D.
    predicted: np.ndarray


class StepFailed(Exception):
    """A step without convergence, as in `Failure`; the last increment, the largest residuals."""

    def __init__(self, kind: str, reason: str, D: np.ndarray, residuals: list[float]):
        super().__init__(reason)
        self.kind, self.reason = kind, reason
        self.D = D
        self.residuals = residuals


def petsc(what: str) -> Any:
    """PETSc's interface; an error where that is missing, which names what needs it."""
    if find_spec("petsc4py") is None:
        raise RuntimeError(
            f"{what} needs PETSc, which is missing here: install petsc4py (Debian's "
            "python3-petsc4py), or take what runs without it, fx_beam.simulate in the compiled loop"
        )
    from petsc4py import PETSc

    return PETSc


class Newton:
    """Solver for the increment over a step, of the equations that are set for it."""

    def __init__(self, equations: Equations, options: NewtonOptions):
        self.equations, self.model, self.options = equations, equations.model, options
        self.guess = Guess(self.model)
        #: Generalised forces (free,) that act on the unknowns besides those of the model.
        self.hold: np.ndarray = np.zeros(self.model.reduction.free)

    @functools.cached_property
    def _linear(self) -> _LinearSolver:
        if find_spec("petsc4py") is None:  # a step on which the compiled loop gave up
            D = np.full(self.model.size, np.nan)
            raise StepFailed(
                "no convergence",
                "no convergence; with petsc4py installed this would say more",
                D,
                [],
            )
        return _LinearSolver(self.model.reduction.pattern)

    def solve(
        self, interval: Interval, start: State, force: np.ndarray, driven: np.ndarray
    ) -> StepSolution:
        """Increment over a step, for dead loads (size,) at the scheme's level and driven motion.

        StepFailed if there is no convergence.
        """
        self.equations.begin(interval, start)
        at_rest = self.model.scheme.rates.at_rest
        guess = None if at_rest else self.guess.of(interval.length)
        moving = 0.0 if at_rest else float(start.v @ (self.model.mass @ start.v))
        try:
            step = self._solve(force, driven, moving, guess)
        except StepFailed:
            if guess is None:
                raise
            step = self._solve(force, driven, moving, None)
        self.guess.learn(interval.length, step)
        return step

    def _solve(self, force, driven, moving: float, guess: np.ndarray | None) -> StepSolution:
        """The same from a guess of the unknowns, or from the previous configuration."""
        model, options, reduction = self.model, self.options, self.model.reduction
        K, free = model.forms.stiffness, reduction.free
        y = np.zeros(free) if guess is None else guess
        led = np.zeros(reduction.driven) if guess is None else driven
        residuals: list[float] = []
        previous, smalls = np.inf, 0
        for iteration in range(1, options.max_iterations + 1):
            D, f, r, residual = self.equations.at(y, led, force)
            residual = residual[:free] - self.hold
            residuals.append(abs(residual).max(initial=0.0))
            step = np.zeros(reduction.columns)
            if led is not driven:
                # Driven motion enters with the first, linearised solution, so that the neighbours
                # of a moved support follow it at once.
                step[free : free + reduction.driven], led = -driven, driven
                residual = reduction.project(r - K @ reduction.spread(step))[:free] - self.hold
            step[:free] = self._linear.solve(self.equations, r, residual)
            correction = reduction.spread(step)
            if iteration == 1:
                predicted = -correction
            step[:free] *= self.shortening(correction)
            y = y - step[:free]
            size = (abs(correction) / model.unit).max()
            self.check_finite(size, residuals)
            small, ended_by = size <= options.tolerance, None
            if small or size > 0.5 * previous:
                lack = _lacking(float(residual @ step[:free]), float(abs(f) @ abs(D)) + moving)
                smalls += small
                # After a third small one: the motion is so small that rounding is all that is left.
                if small and (lack <= ENERGY_SHARE * options.tolerance or smalls > 2):
                    ended_by = "increment"
                elif not small and lack <= ENERGY_FLOOR:
                    ended_by = "round-off"
            if ended_by:  # forces at the corrected state, while K is at hand
                r = r - K @ correction
            D = reduction.expand(y, driven)
            self.check_turn(D, residuals)
            if ended_by:
                return StepSolution(D, y, r, iteration, ended_by, predicted)
            previous = size
        reason = f"no convergence in {options.max_iterations} iterations"
        raise StepFailed("no convergence", reason, D, residuals)

    # -- What every solver for an increment asks --------------------------------------------------

    def shortening(self, correction: np.ndarray) -> float:
        """Factor of a correction (size,) that would turn a node too far."""
        turn = abs(correction[self.model.turns]).max()
        return LONGEST_TURN / turn if LONGEST_TURN < turn < np.inf else 1.0

    def check_finite(self, size: float, residuals: list[float]) -> None:
        """Refuse a correction whose size is no number."""
        if not np.isfinite(size):
            D = np.full(self.model.size, np.nan)
            reason = "the tangent is singular or a value is not finite"
            raise StepFailed("singular", reason, D, residuals)

    def check_turn(self, D: np.ndarray, residuals: list[float]) -> None:
        """Refuse an increment (size,) that turns a node beyond the bound."""
        turn = abs(D[self.model.turns]).max()
        if turn > self.options.max_turn:
            raise StepFailed(
                "large rotation",
                f"a node turns by {turn:.3g} rad in one step, more than the bound "
                f"{self.options.max_turn:g}",
                D,
                residuals,
            )


def _lacking(work: float, energy: float) -> float:
    """Energy that a step still lacked before a correction, relative to what moves in it.

    It is the work of the residual on the correction, and about what the correction leaves.
    """
    return float(abs(work) / energy) if energy else 0.0


class Guess:
    """First guess of an increment: a polynomial in time through the last ones."""

    def __init__(self, model: Model):
        self._model, self._unit = model, model.unit
        self._dt = 0.0
        #: Backward differences of the increments of all degrees of freedom, and of the unknowns.
        self._past: list[np.ndarray] = []
        self._past_y: list[np.ndarray] = []
        self._foretelling = 0

    @property
    def past(self) -> Past:
        """What it knows, by degrees of freedom and slides, which other scenes have as well."""
        model, size = self._model, self._model.size
        known = len(self._past)
        y = np.reshape(self._past_y, (known, model.reduction.free))
        slides = model.couplings.free_slides(y, len(model.scene.joints))
        return Past(self._dt, self._foretelling, np.reshape(self._past, (known, size)), slides)

    @past.setter
    def past(self, past: Past | None) -> None:
        if past is not None:
            self._dt, self._foretelling = past.length, past.foretelling
            self._past = list(past.increments)
            self._past_y = list(self._model.couplings.unknowns(past.increments, past.slides))

    def of(self, dt: float) -> np.ndarray | None:
        """Unknowns (free,) of a step of length dt [s], or none."""
        if not self._foretelling or self._changed(dt):
            return None
        return np.sum(self._past_y[: self._foretelling], axis=0)

    def learn(self, dt: float, step: StepSolution) -> None:
        """Keep the increment of a step of length dt [s]."""
        if self._changed(dt):
            self._past, self._past_y, self._dt = [], [], dt
        now, now_y = [step.D], [step.y]
        best, self._foretelling = CLOSE * self._size(step.D), 0
        for order, (old, old_y) in enumerate(zip(self._past, self._past_y, strict=True), start=1):
            now.append(now[-1] - old)
            now_y.append(now_y[-1] - old_y)
            if (error := self._size(now[-1])) <= best:
                best, self._foretelling = error, order
        self._past, self._past_y = now[:_PAST], now_y[:_PAST]

    def _size(self, D: np.ndarray) -> float:
        return abs(D / self._unit).max()

    def _changed(self, dt: float) -> bool:
        return abs(dt - self._dt) > 1e-6 * dt


class _LinearSolver:
    """LU factorisation of the reduced tangent, whose values change and whose sparsity does not."""

    def __init__(self, pattern: tuple[np.ndarray, np.ndarray]):
        PETSc = petsc("a step in Python")
        indptr, indices = (part.astype(PETSc.IntType) for part in pattern)
        n = len(indptr) - 1
        self._values = np.zeros(len(indices))
        # PETSc works on our arrays; no value is copied in or out.
        self._matrix = PETSc.Mat().createAIJWithArrays(
            (n, n), (indptr, indices, self._values), comm=PETSc.COMM_SELF
        )
        self._b, self._x = np.zeros(n), np.zeros(n)
        self._vectors = tuple(
            PETSc.Vec().createWithArray(array, comm=PETSc.COMM_SELF) for array in (self._b, self._x)
        )
        self._ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        pc = self._ksp.getPC()
        pc.setType(PETSc.PC.Type.LU)
        pc.setFactorOrdering(PETSc.Mat.OrderingType.RCM)
        # By default what is below 2e-14 is no pivot, whatever the units of the scene are.
        pc.setFactorPivot(zeropivot=0.0)
        self._ksp.setOperators(self._matrix)

    def solve(self, equations: Equations, r: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Solution for the reduced tangent; not finite if it is singular."""
        equations.fill_tangent(r, self._values)
        self._matrix.stateIncrease()
        self._b[:] = b
        self._ksp.solve(*self._vectors)
        return self._x
