"""A scene and a scheme as compiled forms, constant matrices and lists of unknowns."""

from __future__ import annotations

from typing import Any

import ufl
from dolfinx import fem

import numpy as np
import scipy.sparse

from . import compat
from .errors import SceneError
from .kinematics import Step, strains, virtual_work
from .loads import Loads
from .mechanism import check_no_massless_mechanism
from .mesh import build_mesh
from .scene import Scene
from .schemes import Scheme
from .section import Law, quadratic_law


class Model:
    """Everything of a scene that stays the same from step to step.

    Vectors run over all degrees of freedom in the order of dolfinx; `mesh.dofs` finds those of a
    node. Nothing is compiled or assembled that the scene does not have.

    Parameters
    ----------
    scene : Scene
        What is computed.
    scheme : Scheme
        How it is stepped in time.

    Raises
    ------
    SceneError
        For a scene that cannot move in time, or a virtual work that is none.
    """

    def __init__(self, scene: Scene, scheme: Scheme):
        self.scene = scene
        self.scheme = scheme
        self.mesh = build_mesh(scene)
        self.size = self.mesh.space.dofmap.index_map.size_local
        #: Degrees of freedom that are rotations.
        self.turns = np.sort(self.mesh.dofs[:, 2])
        #: Names of the compiled forms and of the assembled matrices and vectors.
        self.compiled: list[str] = []
        self.assembled: list[str] = []

        self._build_fields()
        self._build_forms()
        self._build_mass()
        self.loads = Loads(scene, self.mesh, self._assemble_line_load)
        self.assembled += [str(load) for load in scene.loads]
        self._build_gravity()
        self._build_supports()
        if not scene.virtual_works:
            check_no_massless_mechanism(self.mesh, self.mass, self.constrained)

    # -- Construction ---------------------------------------------------------------------------

    def _build_fields(self) -> None:
        mesh, space = self.mesh.mesh, self.mesh.space
        self.start, self.increment = fem.Function(space), fem.Function(space)
        #: Increment on which the forces do work, a nodal function of `increment`.
        self.path = fem.Function(space)
        #: Velocity and acceleration at the start of the step.
        self.start_rates = fem.Function(space), fem.Function(space)
        self.time, self.dt = compat.constant(mesh, 0.0), compat.constant(mesh, 1.0)
        self._test, self._trial = ufl.TestFunction(space), ufl.TrialFunction(space)

        # The tangent from the Jacobian: one rule a form, so mixing rules cannot arise.
        J = ufl.Jacobian(mesh)
        h = ufl.sqrt(J[0, 0] ** 2 + J[1, 0] ** 2)
        t0 = ufl.as_vector((J[0, 0] / h, J[1, 0] / h))
        (u0, psi0), (Du, Dpsi) = ufl.split(self.start), ufl.split(self.increment)
        v0, a0 = (ufl.split(rate) for rate in self.start_rates)
        level = self.scheme.rates.level
        v, omega = self.scheme.rates.fields(Du, Dpsi, v0, a0, self.dt)
        virtual_u, virtual_psi = ufl.split(self._test)
        self.step = Step(
            u0=u0,
            psi0=psi0,
            Du=Du,
            Dpsi=Dpsi,
            Dtheta=ufl.split(self.path)[1],
            u=u0 + level * Du,
            psi=psi0 + level * Dpsi,
            v=v,
            omega=omega,
            virtual_u=virtual_u,
            virtual_psi=virtual_psi,
            X=ufl.SpatialCoordinate(mesh),
            t0=t0,
            h=h,
            degree=self.scene.beams[0].degree,
            t=self.time,
            dt=self.dt,
        )

    def _build_forms(self) -> None:
        step = self.step
        self._laws, law_of_cell = self._group_laws()
        tags = law_of_cell if len(self._laws) > 1 else None
        self._law_of_cell = law_of_cell
        dx = compat.measure(self.mesh.mesh, step.degree, tags)
        dphi = step.t0 + step.prime(step.u0)
        start_strains = strains(dphi, step.psi0, step.prime(step.psi0), step.t0)

        residual: Any = 0
        energy: Any = 0
        for tag, law in enumerate(self._laws):
            dx_law = dx if tags is None else dx(tag)
            r = self.scheme.resultants(step, law)
            residual += virtual_work(step, r.dphi, r.n, r.m) * dx_law
            energy += law.energy(*start_strains) * dx_law
        added = self._added_virtual_work()
        self.added = None
        if added is not None:
            self.added = self._compile("added virtual work", added * dx)
            residual -= added * dx

        self.residual = self._compile("internal forces", residual)
        tangent = ufl.derivative(residual, self.increment, self._trial)
        self.tangent = self._compile("tangent", tangent)
        self.path_tangent = None
        if self.path in residual.coefficients():
            tangent = ufl.derivative(residual, self.path, self._trial)
            self.path_tangent = self._compile("tangent of the path", tangent)
            self._path_matrix = compat.create_matrix(self.path_tangent)
        self.energy = self._compile("strain energy", energy)
        self.needs_rates = any(rate in residual.coefficients() for rate in self.start_rates)

        self._matrix = compat.create_matrix(self.tangent)
        shape = (self.size, self.size)
        pattern = self._matrix.indices, self._matrix.indptr
        #: Tangent of the internal forces, a view on the assembled values.
        self.stiffness = scipy.sparse.csr_matrix((self._matrix.data, *pattern), shape, copy=False)
        self._force = np.zeros(self.size)

    def _group_laws(self) -> tuple[list[Law], np.ndarray]:
        """The different stored energies of the scene, and which of them each cell has."""
        sections = [beam.section for beam in self.scene.beams]
        kinds = list(dict.fromkeys(section.strain_energy for section in sections))
        laws = []
        for kind in kinds:
            if kind is not None:
                laws.append(Law(kind, quadratic=False))
                continue
            rows = [(s.EA, s.GA, s.EI) if s.strain_energy is None else (0,) * 3 for s in sections]
            laws.append(quadratic_law(self._cell_data(np.array(rows, dtype=float), kinds)))
        kind_of_beam = np.array([kinds.index(section.strain_energy) for section in sections])
        return laws, kind_of_beam[self.mesh.beam_of_cell]

    def _cell_data(self, rows: np.ndarray, kinds=(None,)):
        """Data of the beams in UFL: one constant where all beams have the same."""
        if len(kinds) == 1 and (rows == rows[0]).all():
            return compat.constant(self.mesh.mesh, rows[0])
        return compat.cellwise(self.mesh.mesh, rows[self.mesh.beam_of_cell])

    def _added_virtual_work(self):
        total = None
        for number, work in enumerate(self.scene.virtual_works, start=1):
            what = f"virtual work {number}"
            try:
                term = ufl.as_ufl(work.term(self.step))
            except Exception as error:
                raise SceneError(f"{what}: calling it with the step raised {error!r}") from error
            arguments = ufl.algorithms.extract_arguments(term)
            if term.ufl_shape != () or arguments != [self._test]:
                raise SceneError(
                    f"{what}: it must be a scalar UFL expression linear in step.virtual_u and "
                    f"step.virtual_psi, not {term}"
                )
            if work.beam is not None:
                inside = self.mesh.beam_of_cell == self.scene.beams.index(work.beam)
                term = term * compat.cellwise(self.mesh.mesh, inside.astype(float))
            total = term if total is None else total + term
        return total

    def _build_mass(self) -> None:
        """The constant mass matrix (eqs 18 to 21), lumped entries included."""
        sections = [beam.section for beam in self.scene.beams]
        rhoA, rhoI = (
            np.array([getattr(s, name) for s in sections], dtype=float) for name in ("rhoA", "rhoI")
        )
        (u, psi), (virtual_u, virtual_psi) = ufl.split(self._trial), ufl.split(self._test)
        density: Any = 0
        if rhoA.any():
            density += self._cell_data(rhoA) * ufl.dot(virtual_u, u)
            self.assembled.append("distributed mass")
        if rhoI.any():
            density += self._cell_data(rhoI) * virtual_psi * psi
            self.assembled.append("distributed rotary inertia")
        #: Mass matrix with the sparsity of `stiffness`.
        self.mass = self.stiffness.copy()
        self.mass.data[:] = 0.0
        if density != 0:
            dx = compat.measure(self.mesh.mesh, self.step.degree + 1)
            form = self._compile("mass", density * dx)
            matrix = compat.create_matrix(form)
            compat.assemble_matrix(matrix, form)
            self.mass.data[:] = matrix.data
        if self.scene.masses:
            lumped = np.zeros((len(self.mesh.X), 3))
            for node, mass, inertia in self.scene.masses:
                lumped[node] += mass, mass, inertia
            self.mass.setdiag(self.mass.diagonal() + self.from_nodes(lumped))
            self.assembled.append("lumped mass")
        #: Degrees of freedom without mass.
        self.massless = self.mass.diagonal() == 0

    def _build_gravity(self) -> None:
        """Weight of every mass: the mass matrix times a uniform acceleration."""
        self.weight = None
        if self.scene.gravity is not None:
            field = np.zeros((len(self.mesh.X), 3))
            field[:, :2] = self.scene.gravity
            self.weight = self.mass @ self.from_nodes(field)
            self.assembled.append("gravity")

    def _build_supports(self) -> None:
        dof = self.mesh.dofs
        self.prescribed = np.array([dof[key] for key in self.scene.prescribed], dtype=int)
        fixed = np.array([dof[key] for key in sorted(self.scene.fixed)], dtype=int)
        #: Supported degrees of freedom, those that move as prescribed included.
        self.constrained = np.concatenate([fixed, self.prescribed])
        self.free = np.setdiff1d(np.arange(self.size), self.constrained)

    def _assemble_line_load(self, beam) -> np.ndarray:
        """Nodal forces (size, 2) of a unit line load along x and along y."""
        inside = self.mesh.beam_of_cell == self.scene.beams.index(beam)
        where = compat.cellwise(self.mesh.mesh, inside.astype(float))
        direction = compat.constant(self.mesh.mesh, np.zeros(2))
        dx = compat.measure(self.mesh.mesh, self.step.degree + 1)
        work = where * ufl.dot(direction, self.step.virtual_u) * dx
        form = compat.compile_form(work)
        if "line load" not in self.compiled:
            self.compiled.append("line load")
        columns = np.zeros((self.size, 2))
        for i in (0, 1):
            direction.value = np.eye(2)[i]
            column = np.zeros(self.size)
            compat.assemble_vector(column, form)
            columns[:, i] = column
        return columns

    def _compile(self, name: str, form):
        self.compiled.append(name)
        return compat.compile_form(form)

    # -- Evaluation -----------------------------------------------------------------------------

    def set_step(self, t: float, dt: float, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        """Set the start of a step.

        Parameters
        ----------
        t, dt : float
            Start and length of the step [s].
        q, v, a : (size,) float
            Displacements and rotations, rates and accelerations at its start.
        """
        self.time.value = t + self.scheme.rates.level * dt
        self.dt.value = dt
        self.start.x.array[:] = q
        if self.needs_rates:
            for function, rate in zip(self.start_rates, (v, a), strict=True):
                function.x.array[:] = rate

    def internal_force(self, D: np.ndarray) -> np.ndarray:
        """Internal forces less the added ones, for the increment D; overwritten by the next call.

        Parameters
        ----------
        D : (size,) float
            Increment over the step.

        Returns
        -------
        (size,) float
            Nodal forces and couples [N, N m] (eq. 53).
        """
        self._set_increment(D)
        compat.assemble_vector(self._force, self.residual)
        return self._force

    def assemble_stiffness(self) -> None:
        """Assemble `stiffness` at the increment of the last `internal_force` (eq. 54)."""
        compat.assemble_matrix(self._matrix, self.tangent)
        if self.path_tangent is not None:
            compat.assemble_matrix(self._path_matrix, self.path_tangent)
            _, slope = self.scheme.rates.work_increment(self.increment.x.array, self.turns)
            self.stiffness.data += self._path_matrix.data * slope[self.stiffness.indices]

    def _set_increment(self, D: np.ndarray) -> None:
        self.increment.x.array[:] = D
        if self.path_tangent is not None:
            self.path.x.array[:], _ = self.scheme.rates.work_increment(D, self.turns)

    def added_force(self) -> np.ndarray:
        """Nodal forces (size,) of the added virtual works at the last increment [N, N m]."""
        force = np.zeros(self.size)
        compat.assemble_vector(force, self.added)
        return force

    def strain_energy(self, q: np.ndarray) -> float:
        """Stored energy of a configuration [J].

        Parameters
        ----------
        q : (size,) float
            Displacements and rotations.

        Returns
        -------
        float
            Integral of the stored energy, by the reduced rule.
        """
        self.start.x.array[:] = q
        return compat.assemble_scalar(self.energy)

    def resultants(self, t: np.ndarray, q: np.ndarray) -> np.ndarray:
        """Stress resultants N, Q, M of the scheme at the Gauss points, step by step.

        Parameters
        ----------
        t : (n,) float
            Times [s].
        q : (n, size) float
            Displacements and rotations at these times.

        Returns
        -------
        (n, cells, degree, 3) float
            Row k is that of the step from k-1 to k; row 0 that of the start configuration.
        """
        points = compat.gauss_points(self.step.degree)
        out = np.empty((len(t), len(self._law_of_cell), len(points), 3))
        for tag, law in enumerate(self._laws):
            r = self.scheme.resultants(self.step, law)
            expression = compat.compile_expression(ufl.as_vector((r.N, r.Q, r.M)), points)
            cells = np.flatnonzero(self._law_of_cell == tag).astype(np.int32)
            self.dt.value = 1.0
            for k in range(len(t)):
                previous = max(k - 1, 0)
                self.start.x.array[:] = q[previous]
                self._set_increment(q[k] - q[previous])
                if k:
                    self.dt.value = t[k] - t[previous]
                out[k, cells] = expression.eval(cells).reshape(len(cells), len(points), 3)
        return out

    # -- Numbering ------------------------------------------------------------------------------

    def to_nodes(self, vector: np.ndarray) -> np.ndarray:
        """Values (n_node, 3) of a vector (size,) at the nodes."""
        return vector[self.mesh.dofs]

    def from_nodes(self, values: np.ndarray) -> np.ndarray:
        """Vector (size,) of values (n_node, 3) at the nodes."""
        vector = np.empty(self.size)
        vector[self.mesh.dofs] = values
        return vector
