"""A step whose unknowns a user finds: by Newton's method, a line search or an arc length."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from petsc4py import PETSc

from fx_beam.errors import SceneError

from .equations import ReducedEquations
from .newton import Newton


class TrialStep:
    """Residual and tangent of a step that has begun, at unknowns of your own.

    `Problem.begin` and `Equilibrium.begin` make it. Unknowns y are increments over the step of what
    supports and joints leave.

    Parameters
    ----------
    newton : Newton
        The solver of the problem.
    equations : Equations
        Its equations.
    advance : callable
        Takes the step.

    Attributes
    ----------
    y : PETSc.Vec
        Predicted unknowns at the end of the step, from which iterations may start.
    """

    def __init__(self, newton: Newton, equations: ReducedEquations, advance: Callable[[], None]):
        self._newton, self._equations, self._advance = newton, equations, advance
        self.y: PETSc.Vec = equations.unknowns.A.createVecRight()
        self.y.array[:] = equations.unknowns.own(equations.y)

    def residual(self, y: PETSc.Vec, out: PETSc.Vec) -> None:
        """Set a vector to the residual Tv^T r.

        Parameters
        ----------
        y : PETSc.Vec
            Unknowns.
        out : PETSc.Vec
            The residual [N, N m]; nan where joints cannot be closed, or nodes turn too far.
        """
        if self._newton.own is None:
            raise SceneError("fenicsx: begin: the step has ended. Begin another one")
        self._newton.residual(y, out)

    def tangent(self, y: PETSc.Vec) -> PETSc.Mat:
        """Give the derivative of the residual.

        Parameters
        ----------
        y : PETSc.Vec
            Unknowns, at which there is a configuration.

        Returns
        -------
        PETSc.Mat
            The matrix of the problem, which the next call overwrites.
        """
        self.residual(y, y.duplicate())
        return self._equations.tangent()

    def accept(self, y: PETSc.Vec) -> None:
        """End the step at unknowns: it is a step of the problem then.

        Parameters
        ----------
        y : PETSc.Vec
            Unknowns. How small the residual is there is not judged.

        Raises
        ------
        StepError
            Where there is no configuration; then all is as before.
        """
        self._newton.own = partial(self._newton.take, y)
        try:
            self._advance()
        finally:
            self._newton.own = None


@contextmanager
def trial_step(
    newton: Newton,
    equations: ReducedEquations,
    prepare: Callable[[], None],
    advance: Callable[[], None],
) -> Iterator[TrialStep]:
    """A step that `prepare` begins without an end, and that `advance` takes if it is accepted."""
    newton.own = newton.stay
    try:
        prepare()
        yield TrialStep(newton, equations, advance)
    finally:
        newton.own = None
