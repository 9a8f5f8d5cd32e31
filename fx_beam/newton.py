"""Newton's method for the increment of one time step, on PETSc."""

from __future__ import annotations

from dataclasses import dataclass

from petsc4py import PETSc

import numpy as np

from .model import Model

# A correction that turns a node further [rad] is shortened to this. From the previous
# configuration the first one overshoots where axial force has nearly emptied the tangent;
# on the pinned beam this replaces one step halved in ten at dt 0.02 and costs no iteration.
_LONGEST_TURN = 0.5
# Part of the step's energy that rounding leaves undetermined.
_ENERGY_FLOOR = 4 * np.finfo(float).eps


@dataclass(frozen=True)
class NewtonOptions:
    """When Newton's method stops.

    Parameters
    ----------
    tolerance : float
        Largest entry of the last correction: displacements over the size of the scene, and
        rotations in radians. Convergence is quadratic, so that the error left is far smaller.
    max_iterations : int
        Corrections before the step is given up.
    max_turn : float
        Largest increment of a nodal rotation in a step [rad]. The mid-point rule takes the tangent
        of half of it, which has no meaning beyond a half turn.
    """

    tolerance: float = 1e-10
    max_iterations: int = 25
    max_turn: float = 2.0


@dataclass
class StepSolution:
    """A converged step.

    Parameters
    ----------
    D : (size,) float
        Increment of displacements and rotations.
    reaction : (size,) float
        Forces and couples of the supports at the scheme's level, zero elsewhere [N, N m].
    iterations : int
        Corrections made.
    ended_by : str
        "increment" or "round-off".
    """

    D: np.ndarray
    reaction: np.ndarray
    iterations: int
    ended_by: str


class StepFailed(Exception):
    """A step that did not converge: why, and the history that shows how.

    Parameters
    ----------
    reason : str
        What happened.
    D : (size,) float
        Last increment.
    residuals : list of float
        Largest out-of-balance force or couple at each iteration.
    """

    def __init__(self, reason: str, D: np.ndarray, residuals: list[float]):
        super().__init__(reason)
        self.reason = reason
        self.D = D
        self.residuals = residuals


class Newton:
    """Solver for the increment over a step.

    The equation of motion at the scheme's level is
    r(D) = M a(D) + f(D) - F = 0 at the free degrees of freedom (eqs 43 and 46).

    Parameters
    ----------
    model : Model
        Forms and matrices.
    options : NewtonOptions
        When to stop.
    """

    def __init__(self, model: Model, options: NewtonOptions):
        self.model = model
        self.options = options
        self._linear = _LinearSolver(model.forms.stiffness, model.free)
        #: Size of a unit correction: the size of the scene for displacements, 1 for rotations.
        self._unit = np.full(model.size, model.mesh.size)
        self._unit[model.turns] = 1.0

    def solve(
        self, v0: np.ndarray, a0: np.ndarray, dt: float, force: np.ndarray, motion: np.ndarray
    ) -> StepSolution:
        """Increment over the step that `Forms.set_step` has set.

        Parameters
        ----------
        v0, a0 : (size,) float
            Rates and accelerations at the start.
        dt : float
            Length of the step [s].
        force : (size,) float
            External dead forces at the scheme's level [N, N m].
        motion : (size,) float
            Prescribed increments, zero elsewhere [m, rad].

        Returns
        -------
        StepSolution
            The increment and the forces of the supports.

        Raises
        ------
        StepFailed
            If there is no convergence.
        """
        model, options, rates = self.model, self.options, self.model.scheme.rates
        free, K = model.free, model.forms.stiffness
        # The previous configuration is the start: predictors diverge on stiff scenes.
        D = np.zeros(model.size)
        residuals: list[float] = []
        previous = np.inf
        for iteration in range(1, options.max_iterations + 1):
            a, slope = rates.acceleration(D, v0, a0, dt, model.turns)
            f = model.forms.internal_force(D)
            r = f + model.mass @ a - force
            model.forms.assemble_stiffness()
            K.data += model.mass.data * slope[K.indices]
            residuals.append(abs(r[free]).max(initial=0.0))

            correction = np.zeros(model.size)
            if iteration == 1 and motion.any():
                # Prescribed motion enters with the first, linearised solution, so that the
                # neighbours of a moved support follow it at once.
                correction -= motion
                r = r + K @ motion
            correction[free] = self._linear.solve(r[free])
            turn = abs(correction[model.turns]).max()
            if turn > _LONGEST_TURN:
                correction *= _LONGEST_TURN / turn
            D -= correction
            size = (abs(correction) / self._unit).max()
            self._check(size, D, residuals)
            ended_by = None
            if size <= options.tolerance:
                ended_by = "increment"
            elif size > 0.5 * previous and self._at_round_off(r, correction, f, D, v0):
                ended_by = "round-off"
            if ended_by:
                reaction = np.zeros(model.size)
                held = model.constrained
                if len(held):
                    reaction[held] = (r - K @ correction)[held]
                return StepSolution(D, reaction, iteration, ended_by)
            previous = size
        raise StepFailed(f"no convergence in {options.max_iterations} iterations", D, residuals)

    def _check(self, size: float, D: np.ndarray, residuals: list[float]) -> None:
        if not np.isfinite(size):
            raise StepFailed("the tangent is singular or a value is not finite", D, residuals)
        turn = abs(D[self.model.turns]).max()
        if turn > self.options.max_turn:
            raise StepFailed(
                f"a node turns by {turn:.3g} rad in one step, more than the bound "
                f"{self.options.max_turn:g}",
                D,
                residuals,
            )

    def _at_round_off(
        self, r: np.ndarray, correction: np.ndarray, f: np.ndarray, D: np.ndarray, v0: np.ndarray
    ) -> bool:
        """Whether a correction that does not shrink any more changes the energy by rounding only.

        The work of the residual on the correction is the energy that the step still lacks. A bound
        on the residual itself would not do: in a stiff scene its rounding, of the size of EA times
        that of a strain, hides what is missing in the soft directions.
        """
        model = self.model
        energy = v0 @ (model.mass @ v0) + abs(f) @ abs(D)
        return bool(abs(r @ correction) <= _ENERGY_FLOOR * energy)


class _LinearSolver:
    """LU factorisation of the free rows and columns of a matrix whose values change."""

    def __init__(self, matrix, free: np.ndarray):
        self._values = matrix.data
        renumber = np.full(matrix.shape[0], -1)
        renumber[free] = np.arange(len(free))
        rows = np.repeat(np.arange(matrix.shape[0]), np.diff(matrix.indptr))
        keep = (renumber[rows] >= 0) & (renumber[matrix.indices] >= 0)
        self._pick = np.flatnonzero(keep)
        counts = np.bincount(renumber[rows[keep]], minlength=len(free))
        indptr = np.concatenate(([0], np.cumsum(counts))).astype(PETSc.IntType)
        indices = renumber[matrix.indices[keep]].astype(PETSc.IntType)
        self._reduced = np.zeros(len(indices))
        n = (len(free), len(free))
        # PETSc works on our arrays; no value is copied in or out.
        self._matrix = PETSc.Mat().createAIJWithArrays(
            n, (indptr, indices, self._reduced), comm=PETSc.COMM_SELF
        )
        self._b, self._x = np.zeros(len(free)), np.zeros(len(free))
        self._vectors = tuple(
            PETSc.Vec().createWithArray(array, comm=PETSc.COMM_SELF) for array in (self._b, self._x)
        )
        self._ksp = PETSc.KSP().create(PETSc.COMM_SELF)
        self._ksp.setType(PETSc.KSP.Type.PREONLY)
        pc = self._ksp.getPC()
        pc.setType(PETSc.PC.Type.LU)
        pc.setFactorOrdering(PETSc.Mat.OrderingType.RCM)
        self._ksp.setOperators(self._matrix)

    def solve(self, b: np.ndarray) -> np.ndarray:
        """Solution for the present values of the matrix; not finite if it is singular."""
        np.take(self._values, self._pick, out=self._reduced)
        self._matrix.stateIncrease()
        self._b[:] = b
        self._ksp.solve(*self._vectors)
        return self._x
