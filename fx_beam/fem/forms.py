"""The weak form of one step, compiled: internal forces, tangent, stored energy."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, NamedTuple

import ufl

import numpy as np
import scipy.sparse

from fx_beam.errors import SceneError
from fx_beam.mechanics.exact_work import Nodes, lagrange
from fx_beam.mechanics.kinematics import Step, arc_derivative, director
from fx_beam.mechanics.resultants import ExactResultants
from fx_beam.mechanics.schemes import Scheme
from fx_beam.scene.scene import Scene
from fx_beam.scene.section import Law, quadratic_law
from fx_beam.validation import fields_in, refuse_fields

from . import dolfinx_api
from .follower_loads import Followers
from .mesh import Mesh
from .section_fields import section_data
from .virtual_works import added_virtual_work


class Part(NamedTuple):
    """A completed step, or a part of a halved one."""

    #: Start and length [s].
    t: float
    dt: float
    #: Increment (size,), and displacements and rotations (size,) at the start.
    D: np.ndarray
    q: np.ndarray
    #: Rates and accelerations (size,) at the start.
    rates: tuple[np.ndarray, ...] = ()


class Forms:
    """Internal forces, tangent and energies of the beams for a scheme, in UFL and compiled.

    Vectors contain all degrees of freedom in dolfinx's order; `Mesh.dofs` gives those of a node.
    """

    def __init__(self, scene: Scene, scheme: Scheme, mesh: Mesh):
        self._scene, self._scheme, self._mesh = scene, scheme, mesh
        self.size, self._degree = mesh.dofs.size, scene.beams[0].degree
        #: Degrees of freedom that are rotations.
        self.turns = np.sort(mesh.dofs[:, 2])
        #: Compiled forms by name, each with its UFL.
        self.compiled: dict[str, tuple[Any, Any]] = {}
        #: Their names, in the order of compilation.
        self.names: list[str] = []
        #: Load factor, in statics only.
        self.load_factor: Any = (
            dolfinx_api.constant(mesh.mesh, 1.0) if scheme.rates.at_rest else None
        )
        self._laws, self._law_of_cell = self._group_laws()
        self._build_fields()
        self._build_forms()
        self.followers = None
        if any(load.follower for load in scene.loads):
            self.followers = Followers(scene, mesh, self.stiffness, scheme.rates.level)

    # -- Construction ---------------------------------------------------------------------------

    def _build_fields(self) -> None:
        mesh, space = self._mesh.mesh, self._mesh.space
        self.start = dolfinx_api.function(space)
        #: Velocity and acceleration at the start of the step.
        self.start_rates = dolfinx_api.function(space), dolfinx_api.function(space)
        self.time, self.dt = dolfinx_api.constant(mesh, 0.0), dolfinx_api.constant(mesh, 1.0)
        self._build_step(space)
        found = [self._scheme.resultants(self.step, law) for law in self._laws]
        if self._degree > 1 and any(isinstance(r, ExactResultants) for r in found):
            coordinate = dolfinx_api.coordinate_on_cells(mesh, self._degree)
            self._build_step(dolfinx_api.nodal_rotations(space, self._degree), coordinate)

    def _build_step(self, space, coordinate=None) -> None:
        """The step, with increments and test functions on a space.

        With a coordinate on the cells, the rotations of the space are nodal.
        """
        self.increment = dolfinx_api.function(space)
        self._test, self._trial = ufl.TestFunction(space), ufl.TrialFunction(space)
        # Tangent vector from the Jacobian; each form has a single quadrature rule.
        J = ufl.Jacobian(self._mesh.mesh)
        h = ufl.sqrt(J[0, 0] ** 2 + J[1, 0] ** 2)
        t0 = ufl.as_vector((J[0, 0] / h, J[1, 0] / h))
        (u0, psi0), (Du, Dpsi) = ufl.split(self.start), ufl.split(self.increment)
        virtual_u, virtual_psi = ufl.split(self._test)
        nodes = None
        if coordinate is not None:
            shape, slope = lagrange(coordinate, self._degree)
            nodes = Nodes(Dpsi, virtual_psi, shape, self._degree / h * slope)
            Dpsi, virtual_psi = ufl.dot(shape, Dpsi), ufl.dot(shape, virtual_psi)
        #: Fields that the forms may depend on.
        self._known = [self.start, self.increment, *self.start_rates, self.time, self.dt]
        self._known += [field for field in (self.load_factor, coordinate) if field is not None]
        level = self._scheme.rates.level
        v, omega = self._rates_in(Du, Dpsi)
        self.step = Step(
            u0=u0,
            psi0=psi0,
            Du=Du,
            Dpsi=Dpsi,
            u=u0 + level * Du,
            psi=psi0 + level * Dpsi,
            v=v,
            omega=omega,
            virtual_u=virtual_u,
            virtual_psi=virtual_psi,
            X=ufl.SpatialCoordinate(self._mesh.mesh),
            t0=t0,
            h=h,
            degree=self._degree,
            t=self.time,
            dt=self.dt,
            load_factor=1.0 if self.load_factor is None else self.load_factor,
            nodes=nodes,
        )

    def _rates_in(self, Du, Dpsi):
        """Velocity and spin at the scheme's level."""
        v0, a0 = (ufl.split(rate) for rate in self.start_rates)
        v, omega = self._scheme.rates.fields(Du, Dpsi, v0, a0, self.dt)
        of_rates = fields_in(ufl.as_vector((*v, omega)))
        refuse_fields(of_rates, f"rates of {self._scheme.name}", self._known)
        return v, omega

    def _build_forms(self) -> None:
        step = self.step
        tags = self._law_of_cell if len(self._laws) > 1 else None
        #: N, Q and M of each law.
        self._resultants: list[Any] = []
        dx = dolfinx_api.measure(self._mesh.mesh, step.degree, tags)
        residual: Any = 0
        energy: Any = 0
        moments: list[Any] = []
        for tag, law in enumerate(self._laws):
            dx_law = dx if tags is None else dx(tag)
            r = self._scheme.resultants(step, law)
            moments.append(r.M)
            self._resultants.append(ufl.as_vector((r.N, r.Q, r.M)))
            residual += r.virtual_work(step) * dx_law
            energy += law.energy(*step.strains0) * dx_law
        self._refuse_fields_of_scheme(residual, moments)
        added = added_virtual_work(self._scene, self._mesh, step, self._test, self._known)
        if added is not None:
            try:
                self.compile("added virtual work", added * dx)
            except dolfinx_api.REFUSALS as error:
                raise SceneError(
                    f"the added virtual work does not compile: {error}. Simplify its expressions"
                ) from error
            residual -= added * dx

        self._residual = self.compile("internal forces", residual)
        tangent = ufl.derivative(residual, self.increment, self._trial)
        self._tangent = self.compile("tangent", tangent)
        self._energy = self.compile("strain energy", energy)
        self._needs_rates = any(rate in residual.coefficients() for rate in self.start_rates)
        moves = self._needs_rates or self.dt in residual.constants()
        found = [part for r in self._resultants for part in fields_in(r)] if moves else []
        #: Whether the resultants depend on rates at the start of a step, and on any rates.
        self.resultants_need_rates = any(rate in found for rate in self.start_rates)
        self.resultants_move = self.resultants_need_rates or self.dt in found

        self._matrix = dolfinx_api.create_matrix(self._tangent)
        shape = (self.size, self.size)
        pattern = self._matrix.indices, self._matrix.indptr
        #: Tangent of the internal forces, a view on the assembled values.
        self.stiffness = scipy.sparse.csr_matrix((self._matrix.data, *pattern), shape, copy=False)
        self._force = np.zeros(self.size)

    def _refuse_fields_of_scheme(self, residual, moments) -> None:
        # UFL extracts those of the form anyway, and caches them.
        found = [*residual.coefficients(), *residual.constants()]
        found += [field for M in moments for field in fields_in(M)]
        known = [*self._known, *(field for law in self._laws for field in law.data)]
        refuse_fields(found, f"resultants of {self._scheme.name}", known)

    def _group_laws(self) -> tuple[list[Law], np.ndarray]:
        """The different stored energies of the scene, and the index of each cell's energy."""
        sections = [beam.section for beam in self._scene.beams]
        kinds: list[Any] = []
        for section in sections:
            if section.strain_energy not in kinds:
                kinds.append(section.strain_energy)
        laws = []
        for kind in kinds:
            if kind is not None:
                laws.append(Law(kind, quadratic=False))
                continue
            names = "EA", "GA", "EI"
            stiffness = section_data(self._mesh, self._scene, names, self._degree)
            laws.append(quadratic_law(stiffness))
        kind_of_beam = np.array([kinds.index(section.strain_energy) for section in sections])
        return laws, kind_of_beam[self._mesh.beam_of_cell]

    def trial_and_test(self):
        """Trial functions of displacement and rotation, and the virtual ones."""
        space = self._mesh.space
        return *ufl.TrialFunctions(space), *ufl.TestFunctions(space)

    def compile(self, name: str, form):
        """Compile a form, and keep it by its name."""
        compiled = dolfinx_api.compile_form(form, name)
        if name not in self.compiled:
            self.names.append(name)
        self.compiled[name] = compiled, form
        return compiled

    @property
    def full_rule(self) -> int:
        """Points of the rule that integrates products of two fields exactly."""
        return self.step.degree + 1

    def full_measure(self):
        """Measure of the members by that rule."""
        return dolfinx_api.measure(self._mesh.mesh, self.full_rule)

    @property
    def has_added(self) -> bool:
        """Whether the scene has added virtual works or follower forces."""
        return "added virtual work" in self.compiled or self.followers is not None

    @property
    def moving(self) -> tuple:
        """Functions that change: the first in every iteration, the others in every step."""
        return self.increment, self.start, *self.start_rates

    def cells_of(self, tag: int) -> np.ndarray:
        """Cells of a subdomain of the forms; -1 for all."""
        every = np.arange(len(self._law_of_cell))
        return every if tag < 0 else np.flatnonzero(self._law_of_cell == tag)

    # -- Evaluation -----------------------------------------------------------------------------

    def set_step(self, t: float, dt: float, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        """Set start and length of a step [s], with displacements, rates and accelerations."""
        self._set_start(t, dt, q)
        if self.followers is not None:
            self.followers.set_step(t, dt)
        if self._needs_rates:
            self._set_rates(v, a)

    def _set_start(self, t: float, dt: float, q: np.ndarray) -> None:
        self.time.value = t + self._scheme.rates.level * dt
        self.dt.value = dt
        self.start.x.array[:] = q

    def _set_rates(self, *rates: np.ndarray) -> None:
        for function, rate in zip(self.start_rates, rates, strict=True):
            function.x.array[:] = rate

    def internal_force(self, D: np.ndarray) -> np.ndarray:
        """Internal minus added forces (size,) [N, N m] for the increment D (eq. 53).

        The next call overwrites the result.
        """
        self.increment.x.array[:] = D
        dolfinx_api.assemble_vector(self._force, self._residual)
        if self.followers is not None:
            self.followers.add_force(*self._motion, -self._factor, self._force)
        return self._force

    def assemble_stiffness(self) -> None:
        """Assemble `stiffness` at the increment of the last `internal_force` (eq. 54)."""
        dolfinx_api.assemble_matrix(self._matrix, self._tangent)
        if self.followers is not None:
            self.followers.subtract_tangent(*self._motion, self._factor, self.stiffness.data)

    def added_force(self) -> np.ndarray:
        """Forces (size,) of added virtual works and followers at the last increment [N, N m]."""
        force = np.zeros(self.size)
        if "added virtual work" in self.compiled:
            dolfinx_api.assemble_vector(force, self.compiled["added virtual work"][0])
        if self.followers is not None:
            self.followers.add_force(*self._motion, self._factor, force)
        return force

    def added_per_load(self) -> np.ndarray:
        """Derivative (size,) of `added_force` by the load factor, assumed to be linear."""
        now = self.added_force()
        self.load_factor.value += 1.0
        more = self.added_force()
        self.load_factor.value -= 1.0
        return more - now

    @property
    def _motion(self) -> tuple[np.ndarray, np.ndarray]:
        return self.start.x.array, self.increment.x.array

    @property
    def _factor(self) -> float:
        return 1.0 if self.load_factor is None else float(self.load_factor.value)

    def strain_energy(self, q: np.ndarray) -> float:
        """Stored energy [J] of a configuration q (size,), integrated by the reduced rule."""
        self.start.x.array[:] = q
        return dolfinx_api.assemble_scalar(self._energy)

    def compile_facing(self) -> None:
        """Compile what `faces_backwards` takes."""
        #: t . phi' of eq. 4 at the start of the step: 1 and the axial strain.
        self._facing = 1 + self.step.strains0[0]
        # The derivative along the element's own coordinate has the same sign and is cheaper.
        J = ufl.Jacobian(self._mesh.mesh)
        X = ufl.as_vector((J[0, 0], J[1, 0]))
        along = ufl.dot(director(self.step.psi0, X), X + arc_derivative(self.step.u0, X))
        backwards = abs(along) - along
        dx = dolfinx_api.measure(self._mesh.mesh, self.step.degree)
        self._backwards = self.compile("sections facing backwards", backwards * dx)

    def faces_backwards(self, q: np.ndarray) -> bool:
        """Whether t . phi' > 0 (eq. 4) is violated at any Gauss point, for q (size,)."""
        self.start.x.array[:] = q
        return dolfinx_api.assemble_scalar(self._backwards) > 0

    def facing(self, q: np.ndarray) -> np.ndarray:
        """t . phi' (cells, degree) of eq. 4 at the Gauss points, for q (size,)."""
        points = dolfinx_api.gauss_points(self.step.degree)
        self.start.x.array[:] = q
        expression = dolfinx_api.compile_expression(self._facing, points)
        return dolfinx_api.evaluate(expression, self._mesh.mesh, self.cells_of(-1))

    def resultants(self, parts: Iterable[Part]) -> np.ndarray:
        """N, Q and M (n, cells, degree, 3) at the Gauss points, for n steps or parts."""
        points = dolfinx_api.gauss_points(self.step.degree)
        expressions = [
            (dolfinx_api.compile_expression(r, points), self.cells_of(tag))
            for tag, r in enumerate(self._resultants)
        ]
        rows = []
        for part in parts:
            self._set_start(part.t, part.dt, part.q)
            self.increment.x.array[:] = part.D
            if self.resultants_need_rates:
                self._set_rates(*part.rates)
            out = np.empty((len(self._law_of_cell), len(points), 3))
            for expression, cells in expressions:
                values = dolfinx_api.evaluate(expression, self._mesh.mesh, cells)
                out[cells] = values.reshape(len(cells), len(points), 3)
            rows.append(out)
        return np.array(rows)
