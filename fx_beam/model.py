"""A scene and a scheme as compiled forms, constant matrices and lists of unknowns."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import ufl

import numpy as np
import scipy.sparse

from fx_beam.coupling.graph import couple, motors
from fx_beam.coupling.index_reduction import IndexReduction, Reduction
from fx_beam.coupling.joint_reduction import JointReduction
from fx_beam.coupling.mechanism_check import check_no_massless_mechanism
from fx_beam.coupling.spring_dampers import Actuators
from fx_beam.fem.dead_loads import Loads
from fx_beam.fem.forms import Forms
from fx_beam.fem.mesh import build_mesh
from fx_beam.fem.section_fields import on_beam, section_data
from fx_beam.mechanics.schemes import Scheme
from fx_beam.scene.beam import Beam
from fx_beam.scene.loads import label
from fx_beam.scene.scene import Scene

from .fem import dolfinx_api
from .validation import vector


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
    mobile : bool
        Whether parts that have mass may move freely at rest, as they may in time.

    Raises
    ------
    SceneError
        For a scene that cannot move in time, or a virtual work that is none.
    """

    def __init__(self, scene: Scene, scheme: Scheme, mobile: bool = False):
        self.scene = scene
        self.scheme = scheme
        self.mesh = build_mesh(scene)
        self.forms = Forms(scene, scheme, self.mesh)
        self.size, self.turns = self.forms.size, self.forms.turns
        #: Size of a unit increment: the size of the scene for displacements, 1 for rotations.
        self.unit = np.full(self.size, self.mesh.size)
        self.unit[self.turns] = 1.0
        #: Names of the compiled forms and of the assembled matrices and vectors.
        self.compiled = list(self.forms.compiled)
        self.assembled: list[str] = []

        self.loads = Loads(scene, self.mesh, self._assemble_line_load)
        self.assembled += [str(load) for load in scene.loads]
        self._build_weight()
        self._build_reduction()
        if not scene.virtual_works:
            mass = None if scheme.rates.at_rest and not mobile else self.mass
            check_no_massless_mechanism(scene, self.mesh, self.forms.stiffness, mass)

    @functools.cached_property
    def mass(self) -> scipy.sparse.csr_matrix:
        """The constant mass matrix (eqs 19 to 21), lumped entries included.

        It has the sparsity of the stiffness, and is assembled when it is first asked for: statics
        does without.
        """
        u, psi, virtual_u, virtual_psi = self.forms.trial_and_test()
        density: Any = 0
        if self._has("rhoA"):
            density += self._density("rhoA") * ufl.dot(virtual_u, u)
            self.assembled.append("distributed mass")
        if self._has("rhoI"):
            density += self._density("rhoI") * virtual_psi * psi
            self.assembled.append("distributed rotary inertia")
        mass = self.forms.stiffness.copy()
        mass.data[:] = 0.0
        if density != 0:
            dx = dolfinx_api.measure(self.mesh.mesh, self._full_rule)
            form = dolfinx_api.compile_form(density * dx, "mass")
            self.compiled.append("mass")
            matrix = dolfinx_api.create_matrix(form)
            dolfinx_api.assemble_matrix(matrix, form)
            mass.data[:] = matrix.data
        if self.scene.masses:
            mass.setdiag(mass.diagonal() + self.from_nodes(self._lumped()))
            self.assembled.append("lumped mass")
        return mass

    def _has(self, name: str) -> bool:
        """Whether any section has one of the data."""
        return any(getattr(beam.section, name) for beam in self.scene.beams)

    def _density(self, name: str):
        """Distributed mass or inertia in UFL, for the rule by which it is integrated."""
        return section_data(self.mesh, self.scene, (name,), self._full_rule)

    @functools.cached_property
    def massless(self) -> np.ndarray:
        """Whether each degree of freedom (size,) is without mass."""
        return self.mass.diagonal() == 0

    @functools.cached_property
    def unit_of_unknowns(self) -> np.ndarray:
        """Size of a unit increment of each unknown (free,), as `unit` is for the nodes."""
        unit = np.full(self.couplings.columns, self.mesh.size)
        turning = [entry[0] for dof in self.turns for entry in self.couplings.entries[dof]]
        unit[turning] = 1.0
        return unit[: self.couplings.free]

    @property
    def _full_rule(self) -> int:
        """Points of the rule that integrates products of two fields exactly."""
        return self.forms.step.degree + 1

    def _lumped(self) -> np.ndarray:
        """Lumped masses and inertias (n_node, 3) by the components that they resist."""
        lumped = np.zeros((len(self.mesh.X), 3))
        for node, mass, inertia in self.scene.masses:
            lumped[node] += mass, mass, inertia
        return lumped

    def _build_weight(self) -> None:
        """Weight (size,) of every mass, or none."""
        self.weight = None
        if self.scene.gravity is None:
            return
        gravity = np.array([*self.scene.gravity, 0.0])
        if self.scheme.rates.at_rest:
            self.weight = self.from_nodes(self._lumped() * gravity) + self._distributed_weight()
        else:
            self.weight = self.mass @ self.from_nodes(np.tile(gravity, (len(self.mesh.X), 1)))
        self.assembled.append("gravity")

    def _distributed_weight(self) -> np.ndarray:
        """Weight (size,) of the beams, as a load."""
        weight = np.zeros(self.size)
        if self._has("rhoA"):
            gravity = dolfinx_api.constant(self.mesh.mesh, self.scene.gravity)
            pull = self._density("rhoA") * ufl.dot(gravity, self.forms.step.virtual_u)
            dx = dolfinx_api.measure(self.mesh.mesh, self._full_rule)
            form = dolfinx_api.compile_form(pull * dx, "weight")
            self.compiled.append("weight")
            dolfinx_api.assemble_vector(weight, form)
        return weight

    def _build_reduction(self) -> None:
        """Unknowns: what supports and joints leave."""
        scene, dofs, matrix = self.scene, self.mesh.dofs, self.forms.stiffness
        self.couplings = couple(scene, self.mesh)
        #: Joints with a motor, and on which coordinate.
        self.motors = motors(scene)
        self.prescribed = np.array([dofs[key] for key in scene.prescribed], dtype=int)
        counts = self.couplings.free, self.couplings.driven, self.couplings.columns
        keys = [*scene.prescribed, *sorted(scene.fixed)]
        motors_between = np.arange(len(keys)) >= len(scene.prescribed)
        #: Supported nodes, components, and places among the driven and fixed columns.
        self.supports = (
            np.array([node for node, _ in keys], dtype=int),
            np.array([component for _, component in keys], dtype=int),
            np.arange(len(keys)) + motors_between * len(self.motors),
        )
        self.actuators = Actuators(scene.joints, self.couplings, self.scheme.rates, dofs)
        self.reduction: Reduction
        if self.couplings.is_index and not self.actuators:
            column = np.array([own[0][0] for own in self.couplings.entries])
            self.reduction = IndexReduction(column, *counts, matrix)
        else:
            self.reduction = JointReduction(
                self.couplings, self.actuators, self.scheme.rates, dofs, matrix
            )
            self.assembled.append("joints")

    def _assemble_line_load(self, beam: Beam, along: Callable | None) -> np.ndarray:
        """Nodal forces (size, 2) of a unit line load along x and y, or (size, 1) of one along s."""
        mesh = self.mesh.mesh
        unit = dolfinx_api.constant(mesh, np.zeros(2))
        if along is None:
            force, directions = on_beam(self.mesh, self.scene, beam) * unit, np.eye(2)
        else:
            values = self._at_gauss_points(beam, along)
            force, directions = dolfinx_api.at_gauss_points(mesh, values), np.ones((1, 2))
        dx = dolfinx_api.measure(mesh, self._full_rule)
        form = dolfinx_api.compile_form(ufl.dot(force, self.forms.step.virtual_u) * dx, "line load")
        if "line load" not in self.compiled:
            self.compiled.append("line load")
        columns = np.zeros((len(directions), self.size))
        for column, direction in zip(columns, directions, strict=True):
            unit.value = direction
            dolfinx_api.assemble_vector(column, form)
        return columns.T

    def _at_gauss_points(self, beam: Beam, along: Callable) -> np.ndarray:
        """A line load (cells, points, 2) where it is integrated [N/m]."""
        points = dolfinx_api.gauss_points(self._full_rule).T
        force = np.zeros((len(self.mesh.beam_of_cell), points.size, 2))
        s = beam.s[:-1, None] + np.diff(beam.s)[:, None] * points
        what = f"line load on {label(beam)}"
        force[self.mesh.cells[self.scene.beams.index(beam)]] = [
            [vector(along(at), 2, f"{what} at s = {at:g}") for at in row] for row in s
        ]
        return force

    # -- Numbering ------------------------------------------------------------------------------

    def to_nodes(self, vector: np.ndarray) -> np.ndarray:
        """Values (n_node, 3) of a vector (size,) at the nodes."""
        return vector[self.mesh.dofs]

    def from_nodes(self, values: np.ndarray) -> np.ndarray:
        """Vector (size,) of values (n_node, 3) at the nodes."""
        vector = np.empty(self.size)
        vector[self.mesh.dofs] = values
        return vector


class JointForces:
    """Forces and moments of the joints on their nodes b, as sums over what follows through them.

    Parameters
    ----------
    model : Model
        The model.
    """

    def __init__(self, model: Model):
        self._model = model
        couplings, dofs = model.couplings, model.mesh.dofs
        joints = range(len(model.scene.joints))
        rows, columns, signs = [], [], []
        for j in joints:
            for i in range(3):
                followers, sign = couplings.subtree[i][j], couplings.sign[i, j]
                rows += [3 * j + i] * len(followers)
                columns += dofs[followers, i].tolist()
                signs += [sign] * len(followers)
        shape = (3 * len(joints), model.size)
        self._sums = scipy.sparse.csr_matrix((signs, (rows, columns)), shape)
        turning = couplings.subtree[2]
        counts = [len(nodes) for nodes in turning]
        nodes = np.concatenate([np.empty(0, int), *turning])
        turned = np.repeat(couplings.sign[2], counts), nodes, np.cumsum([0, *counts])
        self._turning = scipy.sparse.csr_matrix(turned, (len(joints), len(dofs)))

    @property
    def tables(self) -> tuple[scipy.sparse.csr_matrix, scipy.sparse.csr_matrix]:
        """Sums over nodal forces, three rows a joint, and over the moments of carrying nodes."""
        return self._sums, self._turning

    def of(self, r: np.ndarray) -> np.ndarray:
        """Forces and moments in a step.

        Parameters
        ----------
        r : (size,) float
            Forces and couples of supports and joints on the nodes [N, N m].

        Returns
        -------
        (joints, 3) float
            Force [N] and moment [N m] of each joint.
        """
        out = (self._sums @ r).reshape(-1, 3)
        # Offset and sliding joints turn what carries them, springs turn both of their ends: what
        # that takes of the moments of the nodes is not this joint's, but for its own spring.
        carried = self._model.reduction.guide_moments(r)
        if carried is not None:
            actuators = self._model.actuators
            carried = carried - actuators.node_moments(len(carried))
            out[:, 2] += self._turning @ carried + actuators.moments(len(out))
        return out
