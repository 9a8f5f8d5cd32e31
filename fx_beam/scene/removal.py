"""Removal of parts of a scene, with all that goes with them; joints that are locked.

Numbers of nodes and joints stay: rows of solutions belong to them. Nodes of no member are held.
"""

from __future__ import annotations

import bisect
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

from fx_beam.errors import SceneError, is_one_of, require, shown

from .beam import COMPONENTS, Beam, Node
from .body import Body
from .coordinate import Locked
from .forces_between import ForceBetween
from .joints import Joint

# Lists of parts, each with the node or beam on which it is, or with both ends.
_WITH_ENDS = """loads natural_strains drags velocities virtual_works contacts joints
    forces_between gears""".split()
# Lists of parts that can be taken away.
_REMOVABLE = {*_WITH_ENDS, "beams", "bodies", "masses", "dampings"} - {"velocities"}


def own_joint(scene, joint: Joint) -> Joint | None:
    """The joint of a scene with the number and nodes of `joint`, which may be locked by now."""
    place = place_of_joint(scene, joint.number)
    key = joint.kind, joint.a, joint.b
    if place == len(scene.joints) or any(n.scene not in (scene, None) for n in (joint.a, joint.b)):
        return None
    known: Joint = scene.joints[place]
    is_same = known.number == joint.number and (known.kind, known.a, known.b) == key
    return known if is_same else None


def place_of_joint(scene, number: int) -> int:
    """Place in the list of joints, which is in the order of their numbers."""
    return bisect.bisect_left(scene.joints, number, key=lambda joint: joint.number)


def joint_of(scene, joint: object, name: str) -> Joint:
    """`own_joint` of a scene; SceneError if there is none."""
    known: Any = own_joint(scene, joint) if isinstance(joint, Joint) else None
    expected = "a joint that add_joint of this scene returned, and that was not removed"
    require(known is not None, name, joint, expected)
    return known


def position_in(parts: Sequence, part: object, name: str, kind: str) -> int:
    """Index of a part in a list of a scene; SceneError if it is not there."""
    for i, other in enumerate(parts):
        if other is part:
            return i
    raise _unknown(part, name, kind)


def _unknown(part: object, name: str, kind: str) -> SceneError:
    return SceneError(
        f"{name}: the scene does not have {shown(part)}. Give {kind} that a method such as "
        "add_force of this scene returned, and that was not changed or removed since"
    )


def remove_parts(scene, parts: Sequence[object]) -> None:
    """Take parts away, with what goes with them; SceneError if the scene does not have one."""
    parts = [isinstance(part, Joint) and own_joint(scene, part) or part for part in parts]
    gone = {*map(id, parts)}
    lists = [getattr(scene, name) for name in _REMOVABLE]
    ids_in_lists = [gone.intersection(map(id, items)) for items in lists]
    known = set[int]().union(*ids_in_lists)
    for part in parts:
        if id(part) not in known:
            raise _unknown(part, "remove", "a part")
    for items, ids in zip(lists, ids_in_lists, strict=True):
        if ids:
            items[:] = [part for part in items if id(part) not in ids]
    for part in parts:
        _forget(scene, part)
    if any(isinstance(part, Joint) for part in parts):
        numbers = {joint.number for joint in scene.joints}
        scene.gears[:] = [g for g in scene.gears if {t.joint.number for t in g.terms} <= numbers]
    beams = [part for part in parts if isinstance(part, Beam)]
    if beams:
        _remove_what_is_on(scene, beams)
    bodies = [part for part in parts if isinstance(part, Body)]
    if bodies:  # nodes of beams that followed them are free
        led = {(body.centre.number, node.number) for body in bodies for node in body.nodes}
        scene.joints[:] = [
            joint
            for joint in scene.joints
            if not (joint.is_rigid and (joint.a.number, joint.b.number) in led)
        ]
    nodes = [node for beam in beams for node in (*beam.nodes, *beam.carriers)]
    nodes += [node for body in bodies for node in body.nodes]
    if nodes:
        _remove_nodes(scene, nodes)


def _forget(scene, part: object) -> None:
    """Take the parameters of a force between points, or of a pressure, away."""
    for name in getattr(part, "own", ()):
        scene.parameters.forget(name)


def locked(joint: Joint, coordinate: str | None) -> Joint:
    """The joint with a coordinate that keeps its value; SceneError if it has no such one."""
    names = ["slide"] if joint.on_beam else [*joint.coordinates]
    ok = coordinate is None or is_one_of(coordinate, names)
    require(ok, f"lock {joint}: coordinate", coordinate, f"one of {names}")
    if not names:
        raise SceneError(f"lock {joint}: it has no slide and no relative rotation to lock")
    if coordinate is None and len(names) > 1:
        raise SceneError(f"lock {joint}: it has {names} coordinates. Name one of them")
    name = coordinate or names[0]
    if name in joint.driven:
        raise SceneError(f"lock {joint}: a motor, or a lock, holds its {name} already")
    changed: dict = {name: replace(joint.coordinates[name], motor=Locked())}
    return replace(joint, **changed)


def unlocked(joint: Joint) -> Joint:
    """The joint without its lock; SceneError if it has none."""
    for name, part in joint.coordinates.items():
        if isinstance(part.motor, Locked):
            changed: dict = {name: replace(part, motor=None)}
            return replace(joint, **changed)
    raise SceneError(f"unlock {joint}: it is not locked")


def _remove_nodes(scene, nodes: Iterable[Node]) -> None:
    """Take all away that is on nodes which belong to no member, and hold them."""
    used = {node.number for member in (*scene.beams, *scene.bodies) for node in member.nodes}
    used |= {node.number for beam in scene.beams for node in beam.carriers} | scene.gone
    free = list({node.number: node for node in nodes if node.number not in used}.values())
    if free:
        _remove_what_is_on(scene, free)
    for node in free:
        scene.gone.add(node.number)
        for i in range(len(COMPONENTS)):
            scene.prescribed.pop((node.number, i), None)
            scene.fixed.add((node.number, i))


def _remove_what_is_on(scene, targets: Sequence[Beam | Node]) -> None:
    """Take loads, masses, joints, contacts and more away that act on beams or on nodes."""
    ids = {*map(id, targets)}

    def is_on_them(part) -> bool:
        shape = getattr(part, "shape", None)
        ends = [getattr(part, name, None) for name in ("target", "beam", "a", "b")]
        ends += part.points if isinstance(part, ForceBetween) else ()
        ends += part.nodes if name == "gears" else ()
        ends.append(getattr(getattr(part, "target", None), "beam", None))  # of a place
        return any(id(end) in ids for end in (*ends, shape, getattr(shape, "carrier", None)))

    for name in _WITH_ENDS:
        parts = getattr(scene, name)
        on_them = {id(part): part for part in parts if is_on_them(part)}
        for part in on_them.values():
            _forget(scene, part)
        parts[:] = [part for part in parts if id(part) not in on_them]
    numbers = {target.number for target in targets if isinstance(target, Node)}
    scene.masses[:] = [mass for mass in scene.masses if mass.node not in numbers]
