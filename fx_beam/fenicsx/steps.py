"""Form, fields and solver of a problem whose steps PETSc takes."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.errors import SceneError, require
from fx_beam.results.state import State
from fx_beam.scene.beam import Beam, Node
from fx_beam.step.loop import CompiledLoop
from fx_beam.step.newton import NewtonOptions

from .assembly import Assembly
from .equations import Equations
from .form import Resultants, StepForm, StrainEnergy
from .grid import Grid
from .newton import Newton, PetscOptions
from .system import System
from .versions import Mesh


class Steps:
    """A scene on a mesh of dolfinx, in a state; see `Problem` and `Equilibrium`."""

    # Present state.
    _state: State

    def __init__(
        self,
        loop: CompiledLoop,
        newton: NewtonOptions,
        petsc_options: PetscOptions | None,
        comm: MPI.Comm,
    ):
        model, beams = loop.model, loop.model.forms.beams
        if beams is None:
            raise SceneError("fenicsx: the scene has no beams, of which a mesh could be made")
        self._options = newton, petsc_options or {}
        grid = Grid(model.scene, model.mesh, beams, comm)
        self._set_form(StepForm(model, grid), loop)

    def _set_form(self, form: StepForm, loop: CompiledLoop) -> None:
        """Have a form with its fields, equations and solver."""
        newton, petsc_options = self._options
        self._form, fields = form, form.fields
        self._equations = Equations(Assembly(form, loop.model), loop, newton.max_turn)
        self.mesh, self.system = form.grid.mesh, System(self._equations)
        self.snes = Newton(self._equations, newton, petsc_options).snes
        self.V, self.step, self.resultants = fields.V, fields.step, fields.resultants
        self.u, self.q, self.v, self.a = fields.u, fields.q, fields.v, fields.a

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
        self, resultants: Resultants, strain_energy: StrainEnergy | None = None
    ) -> None:
        """Replace the stress resultants of the scene.

        Call it first: the step, its Functions, `snes` and `system` are new ones then, and terms
        that were added are gone.

        Parameters
        ----------
        resultants : callable
            ``resultants(step, law)`` gives the `Resultants` of a step as UFL expressions, as in
            `Scheme`; they may contain Functions and Constants on `mesh`. The couple that acts is
            `m`; `M` is what solutions have: change both.
        strain_energy : callable, optional
            ``strain_energy(eps, gamma, kappa)`` gives the stored energy at the end of a step [J/m],
            for `energies` and for solutions; without it the strain energy is nan there.
        """
        loop, grid = self._equations.loop, self._form.grid
        form = StepForm(loop.model, grid, resultants, strain_energy)
        form.natural = self._form.natural
        self._set_form(form, loop)
        form.fields.end(self._state)

    @property
    def natural_strains(self) -> Expr | None:
        """Axial strain, shear strain and curvature (3,) without stress, in UFL; None for none.

        They may contain Functions that other problems compute on `mesh` between steps, such as a
        temperature. They are evaluated at the Gauss points before each step, for its end, and
        replace the natural strains of the scene, which needs some: ``scene.add_natural_strain(beam,
        axial=0.0)``. The first step starts with the natural strains of the scene and ends with the
        ones given here. What changes them does work, which is part of `Energy.work`.
        """
        return self._form.natural

    @natural_strains.setter
    def natural_strains(self, strains: Sequence[Expr | float] | None) -> None:
        if not self._equations.model.data.natural:
            raise SceneError(
                "fenicsx: natural_strains: the scene has none, so that its forms have none. Call "
                "scene.add_natural_strain(beam, axial=0.0) before the problem is made"
            )
        if strains is None:
            self._form.natural = None
            return
        if not isinstance(strains, Expr):
            strains = [_in_ufl(strain, self.mesh) for strain in strains]
        vector = ufl.as_vector(strains)
        expected = "three numbers or expressions in UFL"
        require(vector.ufl_shape == (3,), "fenicsx: natural_strains", vector, expected)
        self._form.natural = vector

    @property
    def F(self) -> ufl.Form:
        """Residual of a step without inertia, whose rates are nodal, and forces at points."""
        return self._form.F

    @property
    def J(self) -> ufl.Form:
        """Derivative of `F` by the increment of the step."""
        return self._form.J

    # -- Values ------------------------------------------------------------------------------------

    def at_points(
        self, expression: Expr | list[Expr], points: ArrayLike | None = None
    ) -> np.ndarray:
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
        return self._form.grid.at_points(expression, points)

    def interpolate(self, expression: Expr | list[Expr], name: str = "f") -> fem.Function:
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
        state, model = self._state, self._equations.model
        weight, mass = model.masses.weight, self._equations.assembly.mass
        return {
            "kinetic": float(state.v @ (mass @ state.v)) / 2,
            "strain": self._form.strain_energy(),
            "potential": 0.0 if weight is None else -float(weight @ state.q),
            "springs": float(
                model.forms.compiled_points.energy(state.q, state.slides, state.spring_internal)
            ),
        }


def _in_ufl(strain: Expr | float, mesh: Mesh) -> Expr:
    """A strain as an expression that depends on the mesh."""
    return strain if isinstance(strain, Expr) else fem.Constant(mesh, float(strain))
