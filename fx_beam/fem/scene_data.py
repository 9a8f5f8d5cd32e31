"""All numbers of a scene by the indices of a model: the one path from a scene to its numbers."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from fx_beam.dual import MaybeDual, dual_array, floats
from fx_beam.errors import all_of
from fx_beam.laws.rates import UpdateRule
from fx_beam.scene.beam import Beam
from fx_beam.scene.joints import Joint
from fx_beam.scene.parts import Parts
from fx_beam.scene.scene import Scene

from .beam_data import data_of_beams
from .loads import Followers, LoadedBeams, SumOfLoads
from .mesh import Mesh
from .parameter_values import ParameterFunctions
from .point_forces import PointForce, by_role

if TYPE_CHECKING:
    from .member_contacts import MemberPair


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
    forces, pairs = at_points(scene, mesh, X, mobility, rates.at_rest)
    data, followers = data_of_beams(scene, mesh, rates.at_rest), Followers(scene, rates.level)
    return FormData(ParameterFunctions(scene), data, forces, followers, pairs)


def at_points(
    scene: Scene, mesh: Mesh, X: MaybeDual, mobility: np.ndarray | None, at_rest: bool
) -> tuple[list[PointForce], list[MemberPair]]:
    """Forces at points, and contact with members."""
    forces, pairs = list[PointForce](), list["MemberPair"]()
    parts = scene.joints, scene.forces_between, scene.loads, scene.contacts, scene.drags
    if not (any(parts) or scene.dampings):
        return forces, pairs
    from .scene_forces import SceneForces

    if mobility is None:
        mobility = np.zeros(mesh.dofs.size + scene.joint_count)
    forces = SceneForces(scene, mesh, X, mobility, at_rest).all()
    if any(isinstance(obstacle.shape, Beam) for obstacle in scene.contacts):
        from .member_contacts import member_pairs

        pairs = member_pairs(scene, mesh, floats(X), mobility, at_rest)
    return forces, pairs
