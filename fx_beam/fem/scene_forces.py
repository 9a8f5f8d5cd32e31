"""The forces at points of a scene: of its obstacles, drag, followers, and joints' coordinates."""

from __future__ import annotations

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
    Coulomb,
    SmoothFriction,
    friction_numbers,
    functions_of,
    numbers_of_loss,
)
from fx_beam.scene.joints import Joint
from fx_beam.scene.law import functions_of_energy
from fx_beam.scene.loads import damping_of
from fx_beam.scene.scene import Scene

from .mesh import Mesh, rotation_of
from .point_forces import Load, PointForce, Role

# Laws with functions of a user, by what these give.
_Known = dict[tuple, PointLaw]


def point_forces(
    scene: Scene, mesh: Mesh, X: MaybeDual, mobility: np.ndarray, at_rest: bool
) -> list[PointForce]:
    """All forces at points; without those of rates alone if the scene is `at_rest`.

    Nodes are at X (n, 2). By the `mobility`, 1 / mass of degrees of freedom, then slides, friction
    has critical damping.
    """
    shapes = [contact for contact in scene.contacts if not isinstance(contact.shape, Beam)]
    known: _Known = {}
    return [  # first those of joints, whose internal variables have their places from them
        *_joint_forces(scene, known, at_rest),
        *_gear_forces(scene, known, at_rest),
        *_followers(scene, mesh),
        *_between(scene, mesh, X, known, at_rest),
        *_frictions(scene, mesh, mobility),
        *(
            force
            for contact in shapes
            for force in _contacts(contact, scene, mesh, X, mobility, known, at_rest)
        ),
        *([] if at_rest else _drags(scene, mesh)),
    ]


def _shared(
    known: _Known, law: Callable, kind: CoordinateKind, functions: Iterable, *arguments: Any
) -> PointLaw:
    """A law with functions of a user; functions that give equal expressions share one law."""
    key = law, kind, *functions
    if key not in known:
        known[key] = law(kind, *arguments)
    return known[key]


def _contacts(
    obstacle: Contact,
    scene: Scene,
    mesh: Mesh,
    X: MaybeDual,
    mobility: np.ndarray,
    known: _Known,
    at_rest: bool,
) -> Iterator[PointForce]:
    loss_numbers, friction = numbers_of_loss(obstacle, at_rest), obstacle.friction
    points, nodes = obstacle.points, mesh.nodes_of(scene, obstacle.target)
    count, thick = points.nodes.shape[1], friction is not None and obstacle.radii > 0
    shape, half = obstacle.shape, obstacle.radii
    assert not isinstance(shape, Beam)
    carried = shape.carrier is not None
    kind = gap_of(shape.name, count, carried, friction is not None, thick)
    carrier = mesh.dofs[shape.carrier.number].tolist() if shape.carrier is not None else []
    carrier = carrier[: kind.size - count * (3 if thick else 2)]
    expressions = [bool(loss_numbers), *functions_of_energy(obstacle.energy, None, 1)]
    law = _shared(known, laws.contact, kind, expressions, bool(loss_numbers), obstacle.energy)
    relative = points.of(X[nodes]) - dual_array(shape.origin)
    for i, point_nodes in enumerate(nodes[points.nodes]):
        length, weights = points.lengths[i], points.weights[i] if count > 1 else ()
        law_numbers = obstacle.stiffness * length, *loss_numbers
        numbers = [*map(as_float, relative[i]), *shape.gap_numbers, half, *weights, *law_numbers]
        if friction is not None:
            moves = mobility[mesh.dofs[point_nodes, :2]].max() + mobility[carrier[:2]].max(
                initial=0.0
            )
            numbers += friction_numbers(friction, length, moves)
        dofs = [*mesh.dofs[point_nodes, :2].ravel().tolist(), *carrier]
        dofs += mesh.dofs[point_nodes, 2].tolist() if thick else []
        yield PointForce(law, numbers, dofs, role=Role.CONTACT, nodes=count, owner=str(obstacle))


def _followers(scene: Scene, mesh: Mesh) -> Iterator[PointForce]:
    """Forces that turn with the section of their node; their values change in time."""
    for load in scene.loads:
        if load.follower:
            assert isinstance(load.target, Node)  # only forces on nodes turn
            dofs = mesh.dofs[load.target.number].tolist()
            yield PointForce(FOLLOWER, (0.0, 0.0, 1.0), dofs, role=Role.EXTERNAL)


def _drags(scene: Scene, mesh: Mesh) -> Iterator[PointForce]:
    alpha: Any = scene_number(damping_of(scene)[0])
    for node, mass, inertia in scene.masses if alpha > 0 else ():
        first, end = 0 if mass else 2, 3 if inertia else 2
        if first < end:
            drag_numbers = [alpha * number for number in (mass, inertia) if number]
            dofs = mesh.dofs[node, first:end].tolist()
            yield PointForce(drag(bool(mass), False, bool(inertia)), drag_numbers, dofs)
    for scene_drag in scene.drags:
        if isinstance(scene_drag.target, Node):
            numbers = [*scene_drag.linear, *scene_drag.quadratic, *scene_drag.rotation]
            linear, quadratic, rotation = parts = [*map(bool, numbers)]
            first, end = 0 if linear or quadratic else 2, 3 if rotation else 2
            dofs = mesh.dofs[scene_drag.target.number, first:end].tolist()
            yield PointForce(drag(*parts), [number for number in numbers if number], dofs)


def _joint_forces(scene: Scene, known: _Known, at_rest: bool) -> Iterator[PointForce]:
    """Springs, dampers, friction and stops on the coordinates of joints."""
    for joint in scene.joints:
        for name, coordinate in joint.coordinates.items():
            kind, place = _place_on(joint, name)
            for law, numbers in _coordinate_laws(coordinate, kind, known, at_rest):
                yield PointForce(law, numbers, **place)


def _gear_forces(scene: Scene, known: _Known, at_rest: bool) -> Iterator[PointForce]:
    """Stiffness, losses and play of gears."""
    for gear in scene.gears:
        for law, numbers in _coordinate_laws(gear.on, GEAR, known, at_rest):
            dofs = [rotation_of(node) for node in gear.nodes]
            yield PointForce(law, [gear.ratio, gear.value, *numbers], dofs, joint=gear.number)


def _place_on(joint: Joint, coordinate: str) -> tuple[CoordinateKind, dict[str, Any]]:
    """Kind of the laws on a coordinate of a joint, and where their forces are."""
    if coordinate == "slide":
        return SLIDE, {"slide": joint.number, "role": Role.SLIDE}
    return ANGLE, {"dofs": (rotation_of(joint.a), rotation_of(joint.b)), "joint": joint.number}


def _frictions(scene: Scene, mesh: Mesh, mobility: np.ndarray) -> Iterator[PointForce]:
    """Friction of joints that follows their own force."""
    for joint in scene.joints:
        for name, coordinate in joint.coordinates.items():
            if not isinstance(friction := coordinate.friction, Coulomb):
                continue
            (kind, place), load = _place_on(joint, name), Load(joint.number)
            moving = [mesh.dofs.size + joint.number]
            if kind is ANGLE:
                moving = [dof for dof in place["dofs"] if dof >= 0]
            elif joint.axis is not None:
                axis = tuple(joint.kinematics.tangent(0.0).tolist())
                load = Load(joint.number, axis, rotation_of(joint.a))
            tau, mu, stiffness = friction_numbers(friction, 1.0, mobility[moving].sum())
            numbers = [tau, mu * (friction.radius or 1.0), stiffness]
            yield PointForce(laws.joint_friction(kind), numbers, load=load, **place)


def _between(
    scene: Scene, mesh: Mesh, X: MaybeDual, known: _Known, at_rest: bool
) -> Iterator[PointForce]:
    for force in scene.forces_between:
        if force.to_ground:
            yield from _to_ground(force, scene, mesh, X, known, at_rest)
            continue
        kind, apart, dofs = _along(force, mesh)
        moves = () if force.over_pulleys else tuple(node >= 0 for node in force.nodes)
        for law, numbers in _coordinate_laws(force.on, kind, known, at_rest):
            arguments = law.over(moves) if moves else law, [*apart, *numbers], dofs
            yield PointForce(*arguments, owner=str(force), line=force.number)
        if force.force is not None:
            numbers = [*apart, 1.0]
            law = _shared(known, laws.pull, kind, force.functions, force.force)
            law = law.over(moves) if moves else law
            yield PointForce(law, numbers, dofs, role=Role.EXTERNAL, line=force.number)


def _along(force: Any, mesh: Mesh) -> tuple[CoordinateKind, list[Any], list[int]]:
    """Kind of the length of a line, with its numbers and degrees of freedom."""
    if force.over_pulleys:
        from fx_beam.laws.rope_laws import rope_over

        kinds = force.kinds
        ends = zip(force.nodes, kinds, strict=True)
        dofs = [mesh.dofs[node, : 3 if kind == "D" else 2] for node, kind in ends if node >= 0]
        return rope_over(kinds), force.numbers, np.concatenate(dofs).tolist()
    apart = [component for vector in force.apart for component in vector]  # with slopes
    dofs = mesh.dofs[[node for node in force.nodes if node >= 0], :2].ravel().tolist()
    return LENGTH, apart, dofs


def _to_ground(
    force: Any, scene: Scene, mesh: Mesh, X: MaybeDual, known: _Known, at_rest: bool
) -> Iterator[PointForce]:
    """Springs from a node, or from each node of a beam, to the ground."""
    if force.direction is None:
        for law, numbers in _coordinate_laws(force.on, ROTATION, known, at_rest):
            dofs = [-1, rotation_of(force.target)]
            yield PointForce(law, numbers, dofs, owner=str(force), line=force.number)
        return
    nodes = mesh.nodes_of(scene, force.target)
    ways = force.ways(X[nodes])
    for node, way, length in zip(nodes, ways, force.lengths, strict=True):
        for law, (stiffness, *numbers) in _coordinate_laws(force.on, DISPLACEMENT, known, at_rest):
            arguments = law, [*way, stiffness * length, *numbers], mesh.dofs[node, :2].tolist()
            yield PointForce(*arguments, owner=str(force), line=force.number)


def _coordinate_laws(
    coordinate: Any, kind: CoordinateKind, known: _Known, at_rest: bool
) -> Iterator[tuple[PointLaw, list[float]]]:
    """Laws of a coordinate, and their numbers."""
    spring, stop, damper = (
        coordinate.spring,
        coordinate.stop,
        None if at_rest else coordinate.damper,
    )
    k, rest = (spring.stiffness, spring.rest) if spring else (0.0, 0.0)
    c = damper.viscosity if damper else 0.0
    if k or c:
        yield laws.spring(kind, bool(c)), [k, rest, c] if c else [k, rest]

    def shared(law: Callable, *functions: Any) -> PointLaw:
        return _shared(known, law, kind, functions_of(coordinate), *functions)

    if spring is not None and spring.strain_energy is not None:
        yield shared(laws.stored_energy, spring.strain_energy, spring.internal), [rest]
    if stop is not None:
        loss_numbers = numbers_of_loss(stop, at_rest)
        for sign, limit in ((1, stop.lower), (-1, stop.upper)):
            if limit is not None:
                yield (
                    laws.stop(kind, sign, bool(loss_numbers)),
                    [stop.stiffness, *loss_numbers, limit],
                )
    if damper is not None and damper.law is not None:
        yield shared(laws.damper_law, damper.law), []
    if isinstance(coordinate.friction, SmoothFriction) and not at_rest:
        if callable(coordinate.friction.force):
            yield shared(laws.friction_law, coordinate.friction.force), [coordinate.friction.speed]
        else:
            yield laws.friction(kind), [coordinate.friction.speed, coordinate.friction.force]
