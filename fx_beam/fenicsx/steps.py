"""Form, fields and solver of a problem whose steps PETSc takes."""

from __future__ import annotations

from collections.abc import Sequence

from mpi4py import MPI

import ufl
from dolfinx import fem
from ufl.core.expr import Expr

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.errors import SceneError, all_of, require
from fx_beam.results.state import State
from fx_beam.scene.beam import Beam, Node
from fx_beam.step.loop import CompiledLoop
from fx_beam.step.newton import NewtonOptions

from .assembly import Assembly
from .equations import ReducedEquations
from .form import Resultants, StepForm, StrainEnergy
from .grid import BeamMesh
from .newton import Newton, PetscOptions
from .system import System
from .versions import DolfinxMesh


class DolfinxSteps:
    """A scene on a mesh of dolfinx, in a state; see `Problem` and `Equilibrium`."""

    # Present state.
    _state: State

    def __init__(
        self,
        loop: CompiledLoop,
        newton: NewtonOptions,
        petsc_options: PetscOptions | None,
        comm: MPI.Comm,
        mesh: DolfinxMesh | None,
    ):
        model, beams = loop.model, loop.model.forms.beams
        if beams is None:
            raise SceneError("fenicsx: the scene has no beams, of which a mesh could be made")
        self._options = newton, petsc_options or {}
        grid = BeamMesh(model.scene, model.mesh, beams, comm, mesh)
        self._set_form(StepForm(model, grid), loop)

    def _set_form(self, form: StepForm, loop: CompiledLoop) -> None:
        """Have a form with its fields, equations and solver."""
        newton, petsc_options = self._options
        self._form, fields = form, form.fields
        self._equations = ReducedEquations(Assembly(form, loop.model), loop, newton.max_turn)
        self.mesh, self.cell_tags = form.grid.mesh, form.grid.cell_tags
        self.cell_map = loop.model.mesh.beam_of_cell[form.grid.cells]
        self.system = System(self._equations)
        self._newton = Newton(self._equations, newton, petsc_options)
        self.snes = self._newton.snes
        self.V, self.step, self.resultants = fields.V, fields.step, fields.resultants
        self.increment, self.start = fields.symbols.increment, fields.symbols.start
        self.test, self.trial = fields.symbols.test, fields.symbols.trial
        self.u, self.q, self.v, self.a = fields.u, fields.q, fields.v, fields.a

    def _lose(self, energy: float) -> None:
        """Have an energy [J] among those that are lost since the start."""
        self._state = self._state.changed(dissipated=self._state.dissipated + energy)

    # -- The form ----------------------------------------------------------------------------------

    def written(self, format: str = "text") -> str:
        """Write resultants and terms as on paper, as `Scheme.written` does.

        Parameters
        ----------
        format : {"text", "unicode", "latex"}
            As in `Scheme.written`.

        Returns
        -------
        str
            Lines of each material, and a line ``delta_W`` of each term that was added. Functions
            and Constants have their names, or values.
        """
        return self._form.written(format)

    @property
    def dx(self) -> ufl.Measure:
        """Measure of all beams: ``dx(i)`` is that of the beam ``scene.beams[i]``."""
        return self.measure()

    def measure(
        self, where: Beam | Sequence[Beam] | Node | None = None, points: int | None = None
    ) -> ufl.Measure:
        """Measure of beams, or of a node in which beams end.

        Parameters
        ----------
        where : Beam, list of Beams, or Node, optional
            Over which beams to integrate, by default over all; or at which node: the integral is
            the value there, once for each beam that ends in it.
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
        self._form.added.append(self._form.term("add", term))

    def replace_resultants(
        self,
        resultants: Resultants,
        strain_energy: StrainEnergy | None = None,
        dissipation: StrainEnergy | None = None,
    ) -> None:
        """Replace the stress resultants of the scene.

        Call it first: the step, `snes` and `system` are new ones then, and terms that were added
        are gone. What contains fields of the step before is refused.

        Parameters
        ----------
        resultants : callable
            ``resultants(step, law)`` gives the `Resultants` of a step as UFL expressions, as in
            `Scheme`; they may contain Functions and Constants on `mesh`. The couple that acts is
            `m`; `M` is what solutions have: change both.
        strain_energy : callable, optional
            ``strain_energy(eps, gamma, kappa)`` gives the stored energy at the end of a step [J/m],
            for `energies` and for solutions; without it the strain energy is nan there.
        dissipation : callable, optional
            ``dissipation(eps, gamma, kappa)`` gives the energy that is lost in a step of `run`
            [J/m], after its `update`, from the strains at the end and Functions at both ends of
            the step. It is part of `Energy.dissipated`.

        Raises
        ------
        SceneError
            For symbols on another mesh, of the step before, or without values; also in
            `natural_strains`. Then all is as before.
        """
        loop = self._equations.loop
        form = StepForm(
            loop.model, self._form.grid, self._form, resultants, strain_energy, dissipation
        )
        self._set_form(form, loop)
        form.fields.end(self._state)

    def replace_form(self, F: ufl.Form, energy: ufl.Form | None = None) -> None:
        """Replace the virtual work of all beams by a form as a whole.

        Inertia, drag, loads, joints, forces at points and added terms stay those of the scene. N, Q
        and M of a solution are nan then, as they are in no form.

        Parameters
        ----------
        F : ufl.Form
            Virtual work of the beams over `mesh`, linear in `test`: of `start`, `increment` and
            what follows from them in `step`, and of Functions and Constants on `mesh`. In a step of
            `Equilibrium` it may be ``ufl.derivative(Pi, problem.increment, problem.test)``.
        energy : ufl.Form, optional
            Stored energy Pi [J] of `start` and `increment`, at the end of the step, for `energies`
            and for solutions; without it the strain energy is nan there.

        Raises
        ------
        SceneError
            For what is no such form, and in scenes with retardation, internal variables, or natural
            strains, and schemes with losses, which would be in no form. Then all is as before.
        """
        self._form.replace_work(F, energy)
        self.resultants = self._form.fields.resultants

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
        vector = None if strains is None else ufl.as_vector(strains)
        if vector is not None:
            expected = "three numbers or expressions in UFL"
            require(vector.ufl_shape == (3,), "fenicsx: natural_strains", vector, expected)
            self._form.check("natural_strains", vector)
        self._form.natural = vector

    @property
    def F(self) -> ufl.Form:
        """Residual of a step without inertia, whose rates are nodal, and forces at points.

        A user's own tags of cells do not compile with those of `cell_tags` in one form, and FFCx
        0.5 confuses Gauss rules: where there are several, assemble the forms of `parts`.
        """
        return self._form.F

    @property
    def parts(self) -> list[ufl.Form]:
        """Forms whose sum is F: internal forces, drag if there is any, and added terms."""
        return self._form.parts

    @property
    def F_inertia(self) -> ufl.Form:
        """Inertia of beams in a step, for schemes of Newmark's family.

        F, this and minus `loads` are the residual of `system`, but for lumped masses and forces at
        points; assemble each alone, as their Gauss rules differ. Other schemes have nodal
        accelerations: their inertia is `system.M` times them, and no integral; then this is a
        SceneError.
        """
        return self._form.inertia(self._equations.model)

    @property
    def loads(self) -> np.ndarray:
        """Dead loads and gravity (size,) of the last step at its level, as in `system` [N, N m]."""
        return self._equations.dead.copy()

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

        Raises
        ------
        SceneError
            For symbols on another mesh, of a step before `replace_resultants`, or without values;
            for a list of another length, and for places outside elements.
        """
        parts = [*map(ufl.as_ufl, expression if isinstance(expression, list) else [expression])]
        ok = not isinstance(expression, list) or len(parts) == len(self.resultants)
        ok = ok and len({part.ufl_shape for part in parts}) == 1
        expected = "in UFL, or a list of equal shapes, one for each material as in `resultants`"
        require(ok, "fenicsx: expression", expression, expected)
        self._form.check("expression", *parts)
        if points is not None:
            ok = all_of(abs(np.asarray(points, float) - 0.5) <= 0.5)
            require(ok, "fenicsx: points", points, "numbers from 0 to 1")
        return self._form.grid.at_points(parts, points)

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
        values = self.at_points(expression)
        expected = "a scalar or a vector"
        require(values.ndim < 4, "fenicsx: interpolate: expression", expression, expected)
        return self._form.grid.interpolated(values, name)

    def function(self, name: str, shape: tuple[int, ...] = ()) -> fem.Function:
        """Make a Function of zeros at the Gauss points, in the space of `interpolate`.

        Parameters
        ----------
        name : str
            Its name, in files.
        shape : tuple, optional
            Shape of a value: a scalar, or (n,) of a vector.

        Returns
        -------
        dolfinx.fem.Function
            For internal variables of one's own.
        """
        return self.interpolate(ufl.zero(*shape), name)

    def energies(self) -> dict[str, float]:
        """Energies at the end of the last step, assembled by dolfinx.

        Returns
        -------
        dict
            "kinetic", "strain" (of beams), "potential" and "springs" (all other stored energy) [J].
        """
        state, model = self._state, self._equations.model
        weight, mass = model.masses.weight, model.masses.matrix
        return {
            "kinetic": float(state.v @ (mass @ state.v)) / 2,
            "strain": self._form.strain_energy(),
            "potential": 0.0 if weight is None else -float(weight @ state.q),
            "springs": float(
                model.forms.compiled_points.energy(state.q, state.slides, state.spring_internal)
            ),
        }
