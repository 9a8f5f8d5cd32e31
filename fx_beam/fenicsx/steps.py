"""What problems whose steps PETSc takes have in common: their form, fields and solver."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mpi4py import MPI
from petsc4py import PETSc

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

import numpy as np
import scipy.sparse

from fx_beam.errors import SceneError
from fx_beam.results.records import BeamResultants
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.beam import Beam, Node, arc_lengths, gauss_rule
from fx_beam.step.loop import CompiledLoop
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import Recorder

from .equations import Equations
from .form import Resultants, StepForm, csr_of
from .newton import Newton


class Steps:
    """A scene on a mesh of dolfinx, in a state; see `Problem` and `Equilibrium`."""

    # Present state.
    _state: State

    def __init__(
        self,
        loop: CompiledLoop,
        newton: NewtonOptions,
        petsc_options: dict[str, Any] | None,
        comm: MPI.Comm,
    ):
        self._loop, self._model = loop, loop.model
        self._form = StepForm(loop.model, comm)
        self._equations = Equations(self._form, loop, newton.max_turn)
        self._newton = Newton(self._equations, newton, petsc_options or {})
        self.comm, self.mesh = comm, self._form.grid.mesh
        self._show()
        # Natural strains of a user, and resultants (cells, points, 3) of rows that are replaced.
        self._natural: Any = None
        self._rows: list[np.ndarray] = []

    def _show(self) -> None:
        """Have the fields of the form as attributes."""
        form = self._form
        self.V, self.step, self.resultants = form.V, form.step, form.resultants
        self.u, self.q, self.v, self.a = form.u, form.q, form.v, form.a

    # -- The form ----------------------------------------------------------------------------------

    def measure(self, where: Beam | Node | None = None, points: int | None = None) -> ufl.Measure:
        """Measure of a beam, of all beams, or of a node in which beams end.

        Parameters
        ----------
        where : Beam or Node, optional
            Over which beam to integrate, by default over all; or at which node: the integral is the
            value there, once for each beam that ends in it.
        points : int, optional
            Number of Gauss points of an element; by default that of the internal forces, which is
            the degree of the elements.

        Returns
        -------
        ufl.Measure
            ``dx`` or ``ds`` with its rule.

        Raises
        ------
        SceneError
            For what is not in the scene, and for a node inside beams.
        """
        return self._form.grid.measure(where, points)

    def add(self, term: ufl.Form) -> None:
        """Add a term to the residual: virtual work against the motion.

        Its work is part of `Energy.work`. Constants and Functions in it are read anew in each
        iteration. As here, an elastic foundation with a stiffness that is a Constant:
        ``problem.add(k * ufl.dot(step.u, step.virtual_u) * problem.measure())``.

        Parameters
        ----------
        term : ufl.Form
            Integral over `mesh` that is linear in ``step.virtual_u`` and ``step.virtual_psi``.

        Raises
        ------
        SceneError
            For what is no such form, and for one on another mesh.
        """
        self._form.add(term)

    def replace_resultants(
        self, resultants: Resultants, strain_energy: Callable[[Any, Any, Any], Any] | None = None
    ) -> None:
        """Replace the stress resultants of the scene.

        Call it first: the step and its Functions are new ones then, and terms that were added are
        gone.

        Parameters
        ----------
        resultants : callable
            ``resultants(step, law)`` gives the `Resultants` of a step as UFL expressions, as in
            `Scheme`; they may contain Functions and Constants on `mesh`.
        strain_energy : callable, optional
            ``strain_energy(eps, gamma, kappa)`` gives the stored energy at the end of a step [J/m],
            for `energies` and for solutions; without it the strain energy is nan there.
        """
        self._form.replace_resultants(resultants, strain_energy)
        self._form.end(self._state)
        self._show()

    @property
    def natural_strains(self) -> Any:
        """Axial strain, shear strain and curvature (3,) without stress, in UFL; None for none.

        They may contain Functions that other problems compute on `mesh` between steps, such as a
        temperature. They are evaluated at the Gauss points before each step, for its end, and
        replace the natural strains of the scene, which needs some: ``scene.add_natural_strain(beam,
        axial=0.0)``. The first step starts with the natural strains of the scene and ends with the
        ones given here. What changes them does work, which is part of `Energy.work`.
        """
        return self._natural

    @natural_strains.setter
    def natural_strains(self, strains: Any) -> None:
        if not self._model.data.natural:
            raise SceneError(
                "fenicsx: natural_strains: the scene has none, so that its forms have none. Call "
                "scene.add_natural_strain(beam, axial=0.0) before the problem is made"
            )
        if strains is not None and not _has_ufl(strains):
            strains = fem.Constant(self.mesh, np.array(strains, float))
        self._natural = None if strains is None else ufl.as_vector(strains)

    @property
    def F(self) -> ufl.Form:
        """Residual of a step without inertia, whose rates are nodal, and forces at points."""
        return self._form.F

    @property
    def J(self) -> ufl.Form:
        """Derivative of `F` by the increment of the step."""
        return self._form.J

    # -- Matrices and the solver -------------------------------------------------------------------

    @property
    def snes(self) -> PETSc.SNES:
        """PETSc's nonlinear solver."""
        return self._newton.snes

    @property
    def iterations(self) -> int:
        """Iterations of Newton's method in the last step."""
        return self._newton.iterations

    @property
    def K(self) -> PETSc.Mat:
        """Derivative of `F` in the last iteration, for all degrees of freedom of the scene.

        A copy. Of each node they are displacements (2) and rotation, in the order of nodes, before
        supports and joints, whose maps are `T` and `Tv`.
        """
        K = self._form.pattern.copy()
        K.data[:] = self._form.grid.total(self._form.tangent().copy())
        return self._distributed(K)

    @property
    def M(self) -> PETSc.Mat:
        """Mass matrix for all degrees of freedom of the scene, as a copy [kg, kg m^2]."""
        return self._distributed(self._form.mass)

    def _distributed(self, matrix: scipy.sparse.csr_matrix) -> PETSc.Mat:
        """A matrix whose rows the processes share."""
        new = PETSc.Mat().create(self.comm)
        new.setSizes(matrix.shape)
        new.setType("aij")
        new.setUp()
        new.setPreallocationCSR(csr_of(matrix[slice(*new.getOwnershipRange())]))
        new.assemble()
        return new

    @property
    def residual(self) -> np.ndarray:
        """All forces r (size,) of the last iteration, with inertia, in the scene's order [N, N m].

        At the end of a step Tv^T r is zero: what is left are forces of supports and joints.
        """
        return self._equations.forces

    @property
    def scene_dofs(self) -> np.ndarray:
        """Number in the scene of each degree of freedom of `V`: its row of `T`, `Tv`, `K`, `M`."""
        return self._form.V_numbers

    @property
    def T(self) -> scipy.sparse.csr_matrix:
        """dq = T dy (size, n): small motions of all degrees of freedom by the unknowns."""
        return self._equations.unknowns.T

    @property
    def Tv(self) -> scipy.sparse.csr_matrix:
        """Virtual motions (size, n) by virtual unknowns: forces on the unknowns are Tv^T r."""
        return self._equations.unknowns.Tv

    # -- Values ------------------------------------------------------------------------------------

    def at_points(self, expression: Any, points: Any = None) -> np.ndarray:
        """Values of an expression at points of all elements.

        Parameters
        ----------
        expression : ufl expression or list
            In the last step; or one for each material, as `resultants` are.
        points : (m,) float, optional
            Places in an element, from 0 to 1; by default the Gauss points of the internal forces.

        Returns
        -------
        (cells, m, ...) float array
            Beam by beam, along each.
        """
        tags, expressions = self._form.beams.data.tags, expression
        if not isinstance(expression, list):
            tags, expressions = 0 * tags, [expression]
        return self._form.grid.at_points(expressions, tags, points)

    def interpolate(self, expression: Any, name: str = "f") -> fem.Function:
        """Interpolate an expression at the Gauss points, element by element.

        Parameters
        ----------
        expression : ufl expression or list
            As in `at_points`.
        name : str
            Name of the Function, in files.

        Returns
        -------
        dolfinx.fem.Function
            Discontinuous, of one degree less than the elements.
        """
        return self._form.grid.interpolated(self.at_points(expression), name)

    def energies(self) -> dict[str, float]:
        """Energies at the end of the last step, assembled by dolfinx.

        Returns
        -------
        dict
            "kinetic", "strain" (of beams), "potential" and "springs" (all other stored energy) [J].
        """
        state, model = self._state, self._model
        return {
            "kinetic": float(state.v @ (self._form.mass @ state.v)) / 2,
            "strain": self._form.strain_energy(),
            "potential": 0.0
            if model.masses.weight is None
            else -float(model.masses.weight @ state.q),
            "springs": float(
                model.forms.compiled_points.energy(state.q, state.slides, state.spring_internal)
            ),
        }

    # -- What steps call ---------------------------------------------------------------------------

    def _find_natural_strains(self) -> None:
        """Have the natural strains of a user at the end of the next step."""
        if self._natural is not None:
            self._equations.natural = self.at_points(self._natural)

    def _replace_in_row(self, recorder: Recorder) -> None:
        """Have what follows from replaced resultants in the last row of a record."""
        if self._form.replaced:
            recorder.arrays["energies"][recorder.rows - 1, 1] = self._form.strain_energy()
            self._rows.append(self.at_points(self.resultants))

    def _with_replaced(self, solution: Solution) -> Solution:
        """The solution with the resultants of its rows, if they are replaced."""
        if not self._form.replaced:
            return solution
        rows, model = np.array(self._rows), self._model
        pairs = zip(model.scene.beams, model.mesh.cells, strict=True)
        beams = {beam.name: (beam, cells) for beam, cells in pairs}

        def resultants(name: str) -> BeamResultants:
            beam, cells = beams[name]
            N, Q, M = np.moveaxis(rows[:, cells].reshape(len(rows), -1, 3), -1, 0)
            return BeamResultants(arc_lengths(beam, gauss_rule(beam.degree)[0]).ravel(), N, Q, M)

        solution.resultants_of_beam = resultants
        return solution


def _has_ufl(strains: Any) -> bool:
    """Whether strains are, or contain, an expression of UFL."""
    return isinstance(strains, Expr) or any(isinstance(strain, Expr) for strain in strains)
