"""The forces at points of a scene: of its obstacles, drag, followers, and joints' coordinates."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Iterator
from typing import Any

import numpy as np

from fx_beam.dual import MaybeDual, dual_array, scene_number
from fx_beam.errors import as_float
from fx_beam.laws import scalar_laws as laws
from fx_beam.laws.gaps import gap_of
from fx_beam.laws.point_laws import (
    ANGLE,
    DISPLACEMENT,
    FOLLOWER,
    GEAR,
    LENGTH,
    ROTATION,
    SLIDE,
    CoordinateKind,
    PointLaw,
    drag,
)
from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.contacts import Contact
from fx_beam.scene.coordinate import (
    Coordinate,
    Coulomb,
    Damper,
    SmoothFriction,
    friction_numbers,
    functions_of,
    numbers_of_loss,
)
from fx_beam.scene.forces_between import RopeSpring
from fx_beam.scene.joints import Joint
from fx_beam.scene.law import functions_of_energy
from fx_beam.scene.loads import damping_of
from fx_beam.scene.scene import Scene

from .mesh import Mesh, rotation_of
from .point_forces import FrictionNormalForce, PointForce, Role


@functools.cache
def _once(make: Callable[..., Any], *facts: Any) -> Any:
    """A law or a kind of coordinate by its facts, made once for all scenes."""
    return make(*facts)


class SceneForces:
    """The forces at points of a scene with nodes at X (n, 2).

    Without forces of rates alone if the scene is `at_rest`. By the `mobility`, 1 / mass of degrees
    of freedom, then slides, friction has critical damping.
    """

    def __init__(self, scene: Scene, mesh: Mesh, X: MaybeDual, mobility: np.ndarray, at_rest: bool):
        self._scene, self._mesh, self._X = scene, mesh, X
        self._mobility, self._at_rest = mobility, at_rest
        # Laws with functions of a user, by the expressions of these.
        self._laws: dict[tuple, PointLaw] = {}

    def all(self) -> list[PointForce]:
        """All forces."""
        return [  # first those of joints, whose internal variables have their places from them
            *self._joint_forces(),
            *self._gear_forces(),
            *self._followers(),
            *self._lines(),
            *self._frictions(),
            *self._contacts(),
            *([] if self._at_rest else self._drags()),
        ]

    def _shared(
        self, law: Callable, kind: CoordinateKind, functions: Iterable, *arguments: Any
    ) -> PointLaw:
        """A law with functions of a user; functions that give equal expressions share one law."""
        key = law, kind, *functions
        if key not in self._laws:
            self._laws[key] = law(kind, *arguments)
        return self._laws[key]

    def _contacts(self) -> Iterator[PointForce]:
        """Contact with shapes."""
        for contact in self._scene.contacts:
            if not isinstance(contact.shape, Beam):
                yield from self._contact(contact)

    def _contact(self, obstacle: Contact) -> Iterator[PointForce]:
        """Contact of each point of a node or beam with a shape."""
        mesh, mobility = self._mesh, self._mobility
        loss_numbers, friction = numbers_of_loss(obstacle, self._at_rest), obstacle.friction
        points, nodes = obstacle.points, mesh.nodes_of(self._scene, obstacle.target)
        count, thick = points.nodes.shape[1], friction is not None and obstacle.radii > 0
        shape, half = obstacle.shape, obstacle.radii
        assert not isinstance(shape, Beam)
        carried = shape.carrier is not None
        kind = _once(gap_of, shape.name, count, carried, friction is not None, thick)
        carrier = mesh.dofs[shape.carrier.number].tolist() if shape.carrier is not None else []
        carrier = carrier[: kind.size - count * (3 if thick else 2)]
        expressions = [bool(loss_numbers), *functions_of_energy(obstacle.energy, None, 1)]
        law = self._shared(laws.contact, kind, expressions, bool(loss_numbers), obstacle.energy)
        relative = points.of(self._X[nodes]) - dual_array(shape.origin)
        for i, point_nodes in enumerate(nodes[points.nodes]):
            length, weights = points.lengths[i], points.weights[i] if count > 1 else ()
            place = [*map(as_float, relative[i]), *shape.gap_numbers, half, *weights]
            numbers = [*place, obstacle.stiffness * length, *loss_numbers]
            if friction is not None:
                moves = mobility[mesh.dofs[point_nodes, :2]].max()
                moves += mobility[carrier[:2]].max(initial=0.0)
                numbers += friction_numbers(friction, length, moves)
            dofs = [*mesh.dofs[point_nodes, :2].ravel().tolist(), *carrier]
            dofs += mesh.dofs[point_nodes, 2].tolist() if thick else []
            owner = str(obstacle)
            yield PointForce(law, numbers, dofs, role=Role.CONTACT, nodes=count, owner=owner)

    def _followers(self) -> Iterator[PointForce]:
        """Forces that turn with the section of their node; their values change in time."""
        for load in self._scene.loads:
            if load.follower:
                assert isinstance(load.target, Node)  # only forces on nodes turn
                dofs = self._mesh.dofs[load.target.number].tolist()
                yield PointForce(FOLLOWER, (0.0, 0.0, 1.0), dofs, role=Role.EXTERNAL)

    def _drags(self) -> Iterator[PointForce]:
        """Drag of nodes, and damping of lumped masses."""
        scene, mesh = self._scene, self._mesh
        alpha: Any = scene_number(damping_of(scene)[0])
        for node, mass, inertia in scene.masses if alpha > 0 else ():
            first, end = 0 if mass else 2, 3 if inertia else 2
            if first < end:
                numbers = [alpha * number for number in (mass, inertia) if number]
                dofs = mesh.dofs[node, first:end].tolist()
                yield PointForce(_once(drag, bool(mass), False, bool(inertia)), numbers, dofs)
        for scene_drag in scene.drags:
            if isinstance(scene_drag.target, Node):
                numbers = [*scene_drag.linear, *scene_drag.quadratic, *scene_drag.rotation]
                linear, quadratic, rotation = parts = [*map(bool, numbers)]
                first, end = 0 if linear or quadratic else 2, 3 if rotation else 2
                dofs = mesh.dofs[scene_drag.target.number, first:end].tolist()
                yield PointForce(
                    _once(drag, *parts), [number for number in numbers if number], dofs
                )

    def _joint_forces(self) -> Iterator[PointForce]:
        """Springs, dampers, friction and stops on the coordinates of joints."""
        for joint in self._scene.joints:
            for name, coordinate in joint.coordinates.items():
                kind, place = _place_on(joint, name)
                for law, numbers in self._coordinate_laws(coordinate, kind):
                    yield PointForce(law, numbers, **place)

    def _gear_forces(self) -> Iterator[PointForce]:
        """Stiffness, losses and play of gears."""
        for gear in self._scene.gears:
            for law, numbers in self._coordinate_laws(gear.on, GEAR):
                dofs = [rotation_of(node) for node in gear.nodes]
                yield PointForce(law, [gear.ratio, gear.value, *numbers], dofs, joint=gear.number)

    def _frictions(self) -> Iterator[PointForce]:
        """Friction of joints that follows their own force."""
        for joint in self._scene.joints:
            for name, coordinate in joint.coordinates.items():
                if not isinstance(friction := coordinate.friction, Coulomb):
                    continue
                (kind, place), load = _place_on(joint, name), FrictionNormalForce(joint.number)
                moving = [self._mesh.dofs.size + joint.number]
                if kind is ANGLE:
                    moving = [dof for dof in place["dofs"] if dof >= 0]
                elif joint.axis is not None:
                    axis = tuple(joint.kinematics.tangent(0.0).tolist())
                    load = FrictionNormalForce(joint.number, axis, rotation_of(joint.a))
                moves = self._mobility[moving].sum()
                tau, mu, stiffness = friction_numbers(friction, 1.0, moves)
                numbers = [tau, mu * (friction.radius or 1.0), stiffness]
                yield PointForce(_once(laws.joint_friction, kind), numbers, load=load, **place)

    def _lines(self) -> Iterator[PointForce]:
        """Forces along lines between points, and to the ground."""
        for force in self._scene.forces_between:
            if force.to_ground:
                yield from self._ground_springs(force)
                continue
            kind, apart, dofs = self._length(force)
            moves = () if force.kinds else tuple(node >= 0 for node in force.nodes)
            for law, numbers in self._coordinate_laws(force.on, kind):
                arguments = law.over(moves) if moves else law, [*apart, *numbers], dofs
                yield PointForce(*arguments, owner=str(force), line=force.number)
            if force.force is not None:
                law = self._shared(laws.pull, kind, force.functions, force.force)
                arguments = law.over(moves) if moves else law, [*apart, 1.0], dofs
                owner = str(force)
                yield PointForce(*arguments, role=Role.EXTERNAL, owner=owner, line=force.number)

    def _length(self, force: Any) -> tuple[CoordinateKind, list[Any], list[int]]:
        """Kind of the length of a line, with its numbers and degrees of freedom."""
        table = self._mesh.dofs
        if force.kinds:
            from fx_beam.laws.point_laws import rope_over

            ends = zip(force.nodes, force.kinds, strict=True)
            dofs = [table[node, : 3 if kind == "D" else 2] for node, kind in ends if node >= 0]
            return _once(rope_over, force.kinds), force.numbers, np.concatenate(dofs).tolist()
        apart = [component for vector in force.apart for component in vector]  # with slopes
        dofs = table[[node for node in force.nodes if node >= 0], :2].ravel().tolist()
        return LENGTH, apart, dofs

    def _ground_springs(self, force: Any) -> Iterator[PointForce]:
        """Springs from a node, or from each node of a beam, to the ground."""
        member = {"owner": str(force), "line": force.number}
        if force.direction is None:
            for law, numbers in self._coordinate_laws(force.on, ROTATION):
                yield PointForce(law, numbers, [-1, rotation_of(force.target)], **member)
            return
        nodes = self._mesh.nodes_of(self._scene, force.target)
        ways = force.ways(self._X[nodes])
        for node, way, length in zip(nodes, ways, force.lengths, strict=True):
            dofs = self._mesh.dofs[node, :2].tolist()
            share = length if force.is_bed else None
            for law, numbers in self._coordinate_laws(force.on, DISPLACEMENT, share):
                yield PointForce(law, [*way, *numbers], dofs, **member)

    def _coordinate_laws(
        self, coordinate: Any, kind: CoordinateKind, length: float | None = None
    ) -> Iterator[tuple[PointLaw, list[float]]]:
        """Laws of a coordinate, and their numbers; those of beds act on a length."""
        share = 1.0 if length is None else length
        has_losses = not self._at_rest and (coordinate.damper or coordinate.friction)
        if has_losses and isinstance(coordinate.spring, RopeSpring):
            yield self._rope_law(coordinate, kind)
            coordinate = Coordinate(stop=coordinate.stop)
        spring, stop, friction = coordinate.spring, coordinate.stop, coordinate.friction
        damper = None if self._at_rest else coordinate.damper
        k, rest = (spring.stiffness, spring.rest) if spring else (0.0, 0.0)
        c = damper.viscosity if damper else 0.0
        k, c = k * share, c * share
        if k or c:
            yield _once(laws.spring, kind, bool(c)), [k, rest, c] if c else [k, rest]

        def shared(law: Callable, *functions: Any) -> PointLaw:
            return self._shared(law, kind, functions_of(coordinate), *functions)

        if spring is not None and spring.strain_energy is not None:
            facts = spring.strain_energy, spring.internal, length is not None
            numbers = [rest] if length is None else [rest, length]
            yield shared(laws.stored_energy, *facts), numbers
        if stop is not None:
            losses = numbers_of_loss(stop, self._at_rest)
            for sign, limit in ((1, stop.lower), (-1, stop.upper)):
                if limit is not None:
                    law = _once(laws.contact, kind, bool(losses), None, sign)
                    yield law, [stop.stiffness * share, *losses, limit]
        if damper is not None and damper.law is not None:
            yield shared(laws.damper_law, damper.law), []
        if isinstance(friction, SmoothFriction) and not self._at_rest:
            if callable(friction.force):
                yield shared(laws.friction, friction.force), [friction.speed]
            else:
                yield _once(laws.friction, kind), [friction.speed, friction.force * share]

    def _rope_law(self, coordinate: Any, kind: CoordinateKind) -> tuple[PointLaw, list[float]]:
        """Law and numbers of a rope that only pulls, with a damper or friction."""
        spring, friction = coordinate.spring, coordinate.friction
        damper = coordinate.damper or Damper()
        force = friction and friction.force
        kinds = damper.law is None, friction is None, callable(force)
        numbers = [damper.viscosity]
        if friction:
            numbers += [friction.speed, 0.0 if callable(force) else force]
            force = force if callable(force) else 0.0
        functions = [*kinds, *functions_of(coordinate)]
        facts = spring.slope, spring.length, damper.law, force
        return self._shared(laws.rope, kind, functions, *facts), numbers


def _place_on(joint: Joint, coordinate: str) -> tuple[CoordinateKind, dict[str, Any]]:
    """Kind of the laws on a coordinate of a joint, and members of their forces."""
    if coordinate == "slide":
        return SLIDE, {"slide": joint.number, "role": Role.SLIDE}
    return ANGLE, {"dofs": (rotation_of(joint.a), rotation_of(joint.b)), "joint": joint.number}
