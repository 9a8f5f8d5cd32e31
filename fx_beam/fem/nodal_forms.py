"""Forces at the nodes of a scene: all there are without beams."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import scipy.sparse

from fx_beam.errors import SceneError
from fx_beam.mechanics.interval import Interval
from fx_beam.mechanics.point_laws import StepRule
from fx_beam.mechanics.schemes import Scheme
from fx_beam.scene.beam import Beam
from fx_beam.scene.loads import Drag
from fx_beam.scene.scene import Scene

from .beam_drag import BeamDrag
from .dolfinx_api import CompiledForm
from .follower_loads import Followers
from .free_nodes import with_blocks, with_pairs
from .mesh import Mesh
from .point_forces import PointForces
from .scene_forces import point_forces


class NodalForms:
    """Forces at the points of a scene for a scheme; `Forms` adds its beams.

    Vectors contain all degrees of freedom, dolfinx's first; `Mesh.dofs` gives those of a node.
    """

    #: Whether the forces depend on the start of the last step, and on rates at the start of a step.
    needs_before = needs_rates = False
    #: Whether the resultants depend on rates at the start of a step, and on any rates.
    resultants_need_rates = resultants_move = False
    #: Shape (cells, degree, width) of the internal variables; the width is zero without any.
    internal_shape: tuple[int, int, int] = 0, 1, 0

    def __init__(self, scene: Scene, scheme: Scheme, mesh: Mesh):
        self._scheme, self._mesh = scheme, mesh
        self.size = mesh.dofs.size
        #: Degrees of freedom that are rotations.
        self.turns = np.sort(mesh.dofs[:, 2])
        #: Forms by name: on the mesh, and as compiled.
        self.bound: dict[str, tuple[Any, CompiledForm]] = {}
        #: Their names, in order.
        self.names: list[str] = []
        #: Functions that change: the first in every iteration, the others in every step. They are
        #: numbered as the kinds of coefficients in problem.h; None is missing.
        self.moving: list[Any] = []
        self.load_factor: Any = SimpleNamespace(value=1.0)
        self.load_increment: Any = SimpleNamespace(value=0.0)
        #: Forces at points: of contact, drag, followers, and the coordinates of joints.
        self.points = PointForces(
            point_forces(scene, mesh, scheme.rates), StepRule.of(scheme.rates)
        )
        #: Matrix with the entries of members and of each node: the assembled values first.
        self.of_members = self._build_forms(scene)
        #: Tangent of all forces, and the positions of the assembled values in it.
        self.stiffness, positions = with_pairs(self.of_members, self.points.pairs_of_nodes)
        self._spread = positions is not None
        assembled = slice(0, self._assembled)
        self.assembled: slice | np.ndarray = (
            assembled if positions is None else positions[assembled]
        )
        self.points.locate_in(self.stiffness)
        self._force = np.zeros(self.size)
        self.followers, self._thrust = None, np.empty((0, 2))
        if any(load.follower for load in scene.loads):
            self.followers = Followers(scene, scheme.rates.level)
        self._build_resistances(scene)

    def refill(self, scene: Scene) -> None:
        """Set all numbers to those of a scene of the same structure, whose mesh is set."""
        self.points.refill(point_forces(scene, self._mesh, self._scheme.rates))
        if self.followers is not None:
            self.followers = Followers(scene, self._scheme.rates.level)

    @property
    def _assembled(self) -> int:
        """Number of assembled values of the tangent."""
        return 0

    def _build_forms(self, scene: Scene) -> scipy.sparse.csr_matrix:
        """Build the forms of beams; returns the matrix of their tangent."""
        if scene.virtual_works:
            raise SceneError("add_virtual_work acts on beams, but the scene has none. Add a beam")
        none = np.empty(0, dtype=np.int32)
        return with_blocks(np.empty(0), none, np.zeros(1, np.int32), self.size)

    def _build_resistances(self, scene: Scene) -> None:
        """The drag on beams, None without it."""
        drags = [] if self._scheme.rates.at_rest else scene.drags
        of_beams = [drag for drag in drags if isinstance(drag.target, Beam)]
        self.beam_drag = self._drag_on_beams(scene, of_beams) if of_beams else None

    def _drag_on_beams(self, scene: Scene, drags: list[Drag]) -> BeamDrag:
        raise NotImplementedError  # there are no beams

    @property
    def has_added(self) -> bool:
        """Whether the scene has added virtual works or follower forces."""
        return self.points.has_external

    @property
    def depend_on_rates(self) -> bool:
        """Whether forces may depend on rates."""
        others = self.has_added or self.beam_drag is not None or self.resultants_move
        return others or self.points.any_have("loss")

    def bind_inversion(self) -> None:
        """Bind the form that `is_inverted` takes."""

    # -- Evaluation -----------------------------------------------------------------------------

    def set_step(self, interval: Interval, q: np.ndarray, v: np.ndarray, a: np.ndarray) -> None:
        """Set the interval of a step, and displacements, rates and accelerations at its start."""
        if self.followers is not None:
            self._thrust = self.followers.at(interval)
        t = interval.start + self._scheme.rates.level * interval.length
        self.points.begin(q, v, t, interval.length)

    def set_memory(self, before: np.ndarray | None, memory: float) -> None:
        """Set the start of the last step (size,), and `Step.memory`, for schemes that need them."""

    def set_internal(self, internal: np.ndarray | None) -> None:
        """Set the internal variables (cells, degree, width) at the start of the step."""

    def evolve(self, D: np.ndarray) -> np.ndarray | None:
        """Internal variables (cells, degree, width) at the end of the step; None without any."""
        return None

    def losses(self, D: np.ndarray) -> list[float]:
        """Energies [J] that material, drag and contact take; that the scheme takes, and holds."""
        lost = self.points.loss()
        return [lost if self.beam_drag is None else lost + self.beam_drag.loss(D), 0.0, 0.0]

    def internal_force(self, D: np.ndarray) -> np.ndarray:
        """Internal forces (size,) [N, N m] for the increment D, with all others against the motion.

        The next call overwrites the result.
        """
        self._D = D
        self._force[:] = 0.0
        self.add_beam_forces()
        if self.beam_drag is not None:
            self.beam_drag.add_force(D, self._force)
        self.evaluate_points(D)
        self.points.add_forces(self._force)
        return self._force

    def evaluate_points(self, D: np.ndarray) -> None:
        """Evaluate the forces at nodes for the increment D."""
        if self.points.has_external:
            self.points.set_loads(self._factor, self._thrust)
        self.points.evaluate(D)

    def add_beam_forces(self) -> None:
        """Add the internal forces of beams."""

    def assemble_stiffness(self) -> None:
        """Assemble `stiffness` at the increment of the last `internal_force`."""
        data = self.stiffness.data
        self.set_beam_tangent(data)
        if self.beam_drag is not None:
            self.beam_drag.add_tangent(self._D, data, self.assembled)
        self.points.add_tangent(data)

    def set_beam_tangent(self, data: np.ndarray) -> None:
        """Set the values of `stiffness` to those of beams."""
        data[:] = 0.0

    def added_force(self) -> np.ndarray:
        """Forces (size,) of added virtual works and followers at the last increment [N, N m]."""
        force = np.zeros(self.size)
        if self.points.has_external:
            self.evaluate_points(self._D)
            self.points.add_forces(force, self.points.external, -1.0)
        return force

    def added_per_load(self) -> np.ndarray:
        """Derivative (size,) of `added_force` by the load factor, assumed to be linear."""
        now = self.added_force()
        self.load_factor.value += 1.0
        more = self.added_force()
        self.load_factor.value -= 1.0
        return more - now

    @property
    def _factor(self) -> float:
        return float(self.load_factor.value)

    def strain_energy(self, q: np.ndarray, internal: np.ndarray | None = None) -> float:
        """Stored energy [J] of q (size,) and internal variables, integrated by the reduced rule."""
        return 0.0

    def is_inverted(self, q: np.ndarray) -> bool:
        """Whether t . phi' > 0 (eq. 4) is violated at any Gauss point, for q (size,)."""
        return False
