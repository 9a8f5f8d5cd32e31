"""All forces of a scene in a step: those of its beams, and those at points."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse

from fx_beam.errors import SceneError
from fx_beam.laws.interval import Interval, StepStart
from fx_beam.laws.point_laws import StepRule
from fx_beam.laws.schemes import Scheme
from fx_beam.scene.beam import Beam
from fx_beam.scene.scene import Scene

from .beam_forms import BeamForms
from .loads import Followers
from .mesh import Mesh
from .parameter_values import ParameterValues
from .point_forces import PointForce, PointForces
from .sparsity import matrix_between, places_of_cells, with_pairs

if TYPE_CHECKING:
    from .member_contacts import MemberContacts


class Forms:
    """The forces of a scene for a scheme, and their tangent.

    Vectors contain all degrees of freedom; `Mesh.dofs` gives those of a node.
    """

    def __init__(self, scene: Scene, scheme: Scheme, mesh: Mesh, instant: bool = False):
        if scene.virtual_works and not scene.beams:
            raise SceneError("add_virtual_work acts on beams, but the scene has none. Add a beam")
        self.size = mesh.dofs.size
        self._mesh, self._rates = mesh, scheme.rates
        #: Parameters of the user's functions.
        self.parameters = parameters = ParameterValues(scene)
        #: Those of contact, drag of nodes, followers, and the coordinates of joints.
        self._rule = StepRule.of(scheme.rates, instant)
        forces, followers, members = self._at_points(scene)
        self.points = PointForces(forces, followers, self._rule, parameters, members)
        #: Those of beams, None without any.
        self.beams = None
        if scene.beams:
            self.beams = BeamForms(scene, scheme, mesh, parameters, holds=instant)
        self._parts = [part for part in (self.beams, self.points) if part is not None]
        #: Shape (cells, degree, width) of the internal variables; the width is zero without any.
        self.internal_shape = (0, 1, 0) if self.beams is None else self.beams.internal_shape
        #: Whether the forces depend on the start of the last step.
        self.needs_previous = self.beams is not None and self.beams.facts.needs_previous
        #: Whether the scene has added virtual works or follower forces.
        self.has_added = any(part.has_external for part in self._parts)
        #: Whether forces may depend on rates, and may dissipate energy.
        self.depend_on_rates = any(part.depend_on_rates for part in self._parts)
        self.dissipate = any(part.dissipate for part in self._parts)
        #: Matrix with the entries of beams and of each node.
        self.of_members = matrix_between(mesh.elements, len(mesh.X))
        #: Tangent of all forces, and the places (cells, n * n) in it of the entries of cells.
        at_nodes = self.points.pairs.min(axis=1) >= 0
        self.stiffness = K = with_pairs(self.of_members, self.points.pairs[at_nodes])
        self.of_cells = places_of_cells(mesh.unknowns.dofs, K.indptr, K.indices)
        self.points.locate_in(K)
        self._force = np.zeros(self.size)
        #: Least and largest damping [s] of each friction that sticks, by what it belongs to.
        self.friction_damping: dict[str, list[float]] = {}

    def refill(self, scene: Scene) -> None:
        """Set all numbers to those of a scene of the same structure, whose mesh is set."""
        self.parameters.refill(scene)
        if may_have_forces(scene):
            self.points.refill(*self._at_points(scene))
        if self.beams is not None:
            self.beams.refill(scene)
        self.set_load(1.0, 0.0)

    def damp_friction(self, scene: Scene, mobility: np.ndarray) -> None:
        """Give friction its critical damping, by 1 / mass of degrees of freedom, then of slides."""
        forces, followers, members = self._at_points(scene, mobility)
        self.points.refill(forces, followers, members)
        times: dict[str, list[float]] = {}
        for force in forces:
            if force.law.has_stick_state:
                times.setdefault(force.belongs_to, []).append(float(force.numbers[-3]))
        times |= {} if members is None else members.friction_damping
        self.friction_damping = {name: [min(of), max(of)] for name, of in times.items()}

    def _at_points(
        self, scene: Scene, mobility: np.ndarray | None = None
    ) -> tuple[list[PointForce], Followers, MemberContacts | None]:
        """The forces at points, the values over time of those that follow nodes, and members."""
        if mobility is None:
            mobility = np.zeros(self.size + scene.joint_count)
        forces, members = [], None
        if may_have_forces(scene):
            from .scene_forces import point_forces

            forces = point_forces(scene, self._mesh, mobility, self._rates.at_rest)
        if any(isinstance(obstacle.shape, Beam) for obstacle in scene.contacts):
            from .member_contacts import MemberContacts

            members = MemberContacts(scene, self._rule, self._mesh, mobility)
        return forces, Followers(scene, self._rates.level), members

    # -- A step ---------------------------------------------------------------------------------

    def set_load(self, factor: float, increment: float) -> None:
        """Set the load factor at the end of a step in statics, and its increment in it."""
        for part in self._parts:
            part.set_load(factor, increment)

    def begin(self, interval: Interval, start: StepStart) -> None:
        """Begin a step."""
        self.parameters.begin(interval.at(self._rates.level), start.parameters)
        for part in self._parts:
            part.begin(interval, start)

    def internal_force(self, D: np.ndarray) -> np.ndarray:
        """Internal forces (size,) [N, N m] for the increment D, with all others against the motion.

        The next call overwrites the result.
        """
        self._force[:] = 0.0
        for part in self._parts:
            part.add_force(D, self._force)
        return self._force

    def tangent(self) -> scipy.sparse.csr_matrix:
        """Derivatives of the last `internal_force`, with contact of members in its sparsity."""
        K, members = self.stiffness.copy(), self.points.members
        K.data[:] = 0.0
        if self.beams is not None:
            self.beams.add_tangent(K.data, self.of_cells)
        self.points.add_tangent(K.data)
        return K if members is None else K + members.tangent()

    def added_force(self) -> np.ndarray:
        """Forces (size,) of added virtual works and followers at the last increment [N, N m]."""
        force = np.zeros(self.size)
        for part in self._parts:
            part.add_external(force)
        return force

    def strain_energy(
        self, q: np.ndarray, internal: np.ndarray | None = None, natural: np.ndarray | None = None
    ) -> float:
        """Stored energy [J] of q (size,), internal variables and natural strains of beams."""
        return 0.0 if self.beams is None else self.beams.strain_energy(q, internal, natural)


def may_have_forces(scene: Scene) -> bool:
    """Whether a scene has anything that may exert forces at points; some numbers may be zero."""
    parts = scene.joints, scene.forces_between, scene.loads, scene.contacts, scene.drags
    return any(parts)
