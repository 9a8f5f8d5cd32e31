"""All forces of a scene in a step, and all numbers of the scene that they read."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fx_beam.content_cache import cached_property, shallow_copy
from fx_beam.dual import MaybeDual, dual_array, floats
from fx_beam.errors import SceneError, all_of
from fx_beam.laws.interval import Interval, StepBatch
from fx_beam.laws.point_laws import StepRule
from fx_beam.laws.rates import NodalRates, UpdateRule
from fx_beam.laws.schemes import Scheme
from fx_beam.scene.beam import Beam
from fx_beam.scene.joints import Joint
from fx_beam.scene.parts import Parts
from fx_beam.scene.scene import Scene

from .beam_data import check_shapes, data_of_beams
from .beam_forms import BeamForms
from .compiled_laws import compiled_rule
from .functions_of_time import (
    Followers,
    LoadedBeams,
    ParameterFunctions,
    ParameterValues,
    SumOfLoads,
)
from .mesh import Mesh, matrix_between, places_of_cells, with_pairs
from .point_forces import CompiledPoints, PointForce, PointForces, by_role

if TYPE_CHECKING:
    from .member_contacts import MemberPair


# -- All numbers of a scene by the indices of a model: the one path from a scene to its numbers -


class FormData(NamedTuple):
    """The numbers of forms and of forces at points, with slopes that the scene has."""

    parameters: ParameterFunctions
    #: Data (cells, points, ...) of sections and of drag by name.
    beams: dict[str, MaybeDual]
    #: Forces at points: of contact, drag of nodes, followers, and the coordinates of joints.
    forces: list[PointForce]
    #: Values over time of those that follow nodes.
    followers: Followers
    #: Contact of nodes with members.
    pairs: list[MemberPair]

    @property
    def numbers(self) -> dict[str, MaybeDual]:
        """Flat arrays by name."""
        numbers_of_points = [number for force in by_role(self.forces) for number in force.numbers]
        numbers = self.beams | {"points": dual_array(numbers_of_points)}
        if pairs := self.pairs:
            numbers["members"] = np.concatenate([np.ravel(pair.numbers) for pair in pairs])
        return numbers

    @property
    def friction_damping(self) -> dict[str, list[float]]:
        """Least and largest damping [s] of each friction that sticks, by what it belongs to."""
        times: dict[str, list[float]] = {}
        for force in self.forces:
            if force.law.has_stick_state:
                times.setdefault(force.belongs_to, []).append(float(force.numbers[-3]))
        for pair in self.pairs:
            if pair.law.has_stick_state and pair.contact:
                times[str(pair.contact)] = pair.numbers[:, -3].tolist()
        return {name: [min(values), max(values)] for name, values in times.items()}


class Arm(NamedTuple):
    """Vectors (2,) of a joint that moves [m]; of its axis None if it does not slide."""

    arm: list[float]
    offset: list[float]
    axis: list[float] | None
    apart: list[float]


def arms_of(scene: Scene) -> dict[int, Arm]:
    """Arms of the joints of a scene that move, by their numbers."""
    arms = dict[int, Arm]()
    for joint in scene.joints:
        if not joint.is_selection:
            axis = None if joint.axis is None else floats(joint.axis).tolist()
            arm, offset, apart = (
                floats(vector).tolist() for vector in (joint.arm, joint.offset, joint.apart)
            )
            arms[joint.number] = Arm(arm, offset, axis, apart)
    return arms


class SceneArrays(NamedTuple):
    """The numbers of a scene, with slopes that it has."""

    scene: Scene
    #: Positions (n, 2) of nodes [m].
    X: MaybeDual
    #: Of forms and of forces at points.
    forms: FormData
    #: Entries of the "mass", and the "weight" (size,) if there is gravity.
    masses: dict[str, MaybeDual]
    loads: SumOfLoads
    natural: SumOfLoads
    arms: dict[int, Arm]
    #: Weights and sum at rest of each gear that is a relation.
    gears: list[list[Any]]
    #: Joints with a motor, each with the name of its coordinate.
    motors: list[tuple[Joint, str]]
    #: What section forces and pictures need, whatever becomes of the scene.
    loaded_beams: LoadedBeams
    parts: Parts

    def lies_as(self, other: SceneArrays) -> bool:
        """Whether nodes and joints are where other data have them, or nothing depends on it."""
        if self.arms != other.arms:
            return False
        return self.X is other.X or all_of(floats(self.X) == floats(other.X))

    @property
    def before_motors(self) -> MaybeDual:
        """Slides (driven,) in the reference, from which motors go on; 0 for other motions."""
        motor_slides = [joint.start()[0] if name == "slide" else 0.0 for joint, name in self.motors]
        return np.append(np.zeros(len(self.scene.prescribed)), motor_slides)


def form_data(
    scene: Scene, mesh: Mesh, X: MaybeDual, rates: UpdateRule, mobility: np.ndarray | None = None
) -> FormData:
    """The numbers of a scene with nodes at X (n, 2).

    By the `mobility`, 1 / mass of degrees of freedom, then slides, friction has critical damping.
    """
    forces, pairs = list[PointForce](), list["MemberPair"]()
    parts = scene.joints, scene.forces_between, scene.loads, scene.contacts, scene.drags
    if any(parts) or scene.dampings:
        from .scene_forces import SceneForces

        if mobility is None:
            mobility = np.zeros(mesh.dofs.size + scene.joint_count)
        forces = SceneForces(scene, mesh, X, mobility, rates.at_rest).all()
        if any(isinstance(obstacle.shape, Beam) for obstacle in scene.contacts):
            from .member_contacts import member_pairs

            pairs = member_pairs(scene, mesh, floats(X), mobility, rates.at_rest)
    data, followers = data_of_beams(scene, mesh, rates.at_rest), Followers(scene, rates.level)
    return FormData(ParameterFunctions(scene), data, forces, followers, pairs)


# -- All forces of a scene in a step: those of its beams, and those at points -------------------


class Forms:
    """The forces of a scene for a scheme, and their tangent.

    Vectors contain all degrees of freedom; `Mesh.dofs` gives those of a node.
    """

    def __init__(
        self, scene: Scene, scheme: Scheme, mesh: Mesh, data: FormData, instant: bool = False
    ):
        if scene.virtual_works and not scene.beams:
            raise SceneError("add_virtual_work acts on beams, but the scene has none. Add a beam")
        self._cell_dofs = mesh.unknowns.dofs
        self._rates, rule, members = scheme.rates, StepRule.of(scheme.rates, instant), None
        #: Parameters of the user's functions.
        self.parameters = parameters = ParameterValues(data.parameters)
        if data.pairs:
            from .member_contacts import MemberContacts

            first = sum(force.law.internal for force in data.forces)
            members = MemberContacts(data.pairs, rule, mesh, first)
        #: Forces of contact, drag of nodes, followers, and the coordinates of joints.
        self.points = PointForces(data.forces, data.followers, rule, parameters, members)
        #: The same in C, as steps call them.
        self.compiled_points = CompiledPoints(self.points)
        #: Those of beams, None without any.
        self.beams = None
        if scene.beams:
            self.beams = BeamForms(scene, scheme, mesh, parameters, data.beams, holds=instant)
        #: Shape (cells, degree, width) of the internal variables; the width is zero without any.
        self.internal_shape = (0, 1, 0) if self.beams is None else self.beams.internal_shape
        #: Whether the forces depend on the start of the last step, and whether a step does.
        self.needs_previous = self.beams is not None and self.beams.facts.needs_previous
        self.keeps_previous = self.needs_previous or scheme.rates.user_defined
        #: The nodal rules of the rates, if they are those of a user.
        self.nodal_rules = []
        if isinstance(rates := scheme.rates, NodalRates):
            self.nodal_rules = [compiled_rule(rates, rule) for rule in rates.rules]
        #: Whether the scene has added virtual works or follower forces.
        follow = self.points.external.stop > self.points.external.start
        self.has_added = follow or (self.beams is not None and self.beams.has_external)
        #: Whether forces may dissipate energy, and may depend on rates.
        loses, beams = self.points.any_have("loss"), self.beams
        self.dissipate = loses or (beams is not None and beams.dissipate)
        self.depend_on_rates = follow or loses or (beams is not None and beams.depend_on_rates)
        # Sparsity with the entries of beams and of each node, of zeros.
        beam_pattern = matrix_between(mesh.elements, len(mesh.X))
        nodal = self.points.pairs.min(axis=1) >= 0
        #: Tangent of all forces.
        self.stiffness = K = with_pairs(beam_pattern, self.points.pairs[nodal])
        self.points.locate_in(K)

    @cached_property
    def cell_entries(self) -> np.ndarray:
        """Places (cells, n * n) in the tangent of the entries of cells."""
        return places_of_cells(self._cell_dofs, self.stiffness.indptr, self.stiffness.indices)

    def forget_cell_entries(self) -> None:
        """Free the places of entries of a large scene, which are found again if asked for."""
        self.__dict__.pop("cell_entries", None)

    def used_entries(self, masses: np.ndarray, coupled: bool) -> np.ndarray:
        """Whether an entry of the tangent may be other than zero: at many points none is.

        The sparsity has all entries of nodes without beams. Some entries have `masses`; rates that
        are `coupled` may couple all components at a node.
        """
        used = np.full(self.stiffness.nnz, coupled)
        used[self.cell_entries], used[masses] = True, True
        value_at = self.points.value_at
        used[value_at[value_at >= 0]] = True
        return used

    def check(self, data: FormData) -> None:
        """OtherStructureError if data are of other kinds."""
        self.parameters.signals.check(data.parameters)
        self.points.check(data.forces)
        if self.points.members is not None:
            self.points.members.check_pairs(data.pairs)
        if self.beams is not None:
            check_shapes(self.beams.kind, data.beams)

    def in_block(self, block: Any, mesh: Mesh) -> Forms:
        """Forces whose numbers are in the block of a run; `set_numbers` is to follow."""
        other = shallow_copy(self)
        other.parameters = parameters = self.parameters.in_block(block)
        other.points = self.points.in_block(block, parameters, mesh)
        other.compiled_points = self.compiled_points.in_block(block, other.points)
        if self.beams is not None:
            other.beams = self.beams.on(mesh, parameters)
        return other

    def set_numbers(self, data: FormData) -> None:
        """Set all numbers, with the mesh, and begin anew."""
        self.parameters.set_functions(data.parameters)
        self.points.set_numbers(data.forces, data.followers, data.pairs)
        self.compiled_points.set_axes()
        if self.beams is not None:
            self.beams.set_numbers(data.beams)
        self.set_load(1.0)

    # -- A step ---------------------------------------------------------------------------------

    def set_load(self, factor: float) -> None:
        """Set the load factor of external forces and of virtual works."""
        self.compiled_points.set_load(factor, 0.0)
        if self.beams is not None:
            self.beams.set_load(factor)

    def begin_step(self, interval: Interval, start: StepBatch) -> StepForces:
        """The forces of a step that begins, by the arrays of one step."""
        t = interval.time_at(self._rates.level)
        self.parameters.set_step_values(t)
        self.compiled_points.begin_step(interval, start)
        times, parameters = np.array([[t], [interval.length]]), self.parameters.values[None]
        return StepForces(self, start._replace(t=times[0], dt=times[1], parameters=parameters))

    def strain_energy(
        self, q: np.ndarray, internal: np.ndarray | None = None, natural: np.ndarray | None = None
    ) -> float:
        """Stored energy [J] of q (size,), internal variables and natural strains of beams."""
        if self.beams is None:
            return 0.0
        named = {"internal": internal, "natural": natural, "parameters": self.parameters.values}
        return self.beams.strain_energy(StepBatch.at_rest(q, **named))


class StepForces:
    """Forces of `Forms` in a step that has begun, and at the last increment."""

    def __init__(self, forms: Forms, step: StepBatch):
        self._forms, self._step = forms, step

    def internal(self, D: np.ndarray) -> np.ndarray:
        """Internal forces (size,) [N, N m] for an increment D, with others against the motion."""
        force = self.of_beams(D)
        self._forms.compiled_points.add_force(D, force)
        return force

    def of_beams(self, D: np.ndarray) -> np.ndarray:
        """Forces (size,) of beams alone, with added virtual works [N, N m]."""
        force, self._step = np.zeros(len(D)), self._step._replace(D=D[None])
        if self._forms.beams is not None:
            self._forms.beams.add_force(self._step, force)
        return force

    def added(self) -> np.ndarray:
        """Forces (size,) of added virtual works and followers [N, N m]."""
        force = np.zeros(self._forms.stiffness.shape[0])
        if self._forms.beams is not None:
            self._forms.beams.add_external(self._step, force)
        self._forms.compiled_points.add_external(force)
        return force
