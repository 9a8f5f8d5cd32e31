"""Removal of parts of a scene, with all that goes with them; joints that are locked.

Numbers of nodes and joints stay: rows of solutions belong to them. Nodes of no member are held.
"""

from __future__ import annotations

import bisect
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any

from fx_beam.errors import SceneError, is_one_of, require, shown

from .beam import COMPONENTS, Beam, Node
from .body import Body
from .contacts import Contact
from .coordinate import Locked
from .forces_between import ForceBetween
from .joints import Joint
from .loads import Damping, Drag, Load, Mass, NaturalStrain, VirtualWork
from .part_index import PartIndex

# Nodes, beams and shapes on which the parts of each list are.
_ENDS: dict[str, Callable[[Any], Iterable[object]]] = {
    "loads": lambda load: (load.target, getattr(load.target, "beam", None)),
    "natural_strains": lambda strain: (strain.beam,),
    "drags": lambda drag: (drag.target,),
    "velocities": lambda velocity: (velocity.target,),
    "virtual_works": lambda work: (work.beam,),
    "contacts": lambda part: (part.target, part.shape, getattr(part.shape, "carrier", None)),
    "joints": lambda joint: (joint.a, joint.b, getattr(joint, "beam", None)),
    "forces_between": lambda force: (*force.points, getattr(force, "target", None)),
    "gears": lambda gear: gear.nodes,
}
# Names of the lists of parts that can be taken away, by kinds; all others can only be gears.
_LIST_OF_KIND = {
    Load: "loads",
    ForceBetween: "forces_between",
    Joint: "joints",
    Beam: "beams",
    Body: "bodies",
    Mass: "masses",
    Contact: "contacts",
    NaturalStrain: "natural_strains",
    Drag: "drags",
    Damping: "dampings",
    VirtualWork: "virtual_works",
}


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


def place_in(scene, name: str, part: object, caller: str, kind: str) -> tuple[PartIndex, int]:
    """Index of a list of a scene, and the place of a part in it; SceneError if it is not there."""
    index = scene.part_indices.of(scene, name)
    if (span := index.find(part)) is None:
        raise _unknown(part, caller, kind)
    return index, span.start


def _unknown(part: object, name: str, kind: str) -> SceneError:
    return SceneError(
        f"{name}: the scene does not have {shown(part)}. Give {kind} that a method such as "
        "add_force of this scene returned, and that was not changed or removed since"
    )


def remove_parts(scene, parts: Sequence[object]) -> None:
    """Take parts away, with what goes with them; SceneError if the scene does not have one."""
    parts = [isinstance(part, Joint) and own_joint(scene, part) or part for part in parts]
    groups: dict[str, list] = {}
    for part in parts:
        groups.setdefault(_list_of(part), []).append(part)
    indices = {name: scene.part_indices.of(scene, name) for name in groups}
    spans = {name: indices[name].find(*group) for name, group in groups.items()}
    if None in spans.values():
        for part in parts:  # the first one that the scene does not have is refused
            place_in(scene, _list_of(part), part, "remove", "a part")
    for name, group in groups.items():
        indices[name].remove(spans[name], group)
    for part in parts:
        _forget(scene, part)
    if joints := {part.number for part in parts if isinstance(part, Joint)}:
        scene.gears[:] = [
            gear
            for gear in scene.gears
            if joints.isdisjoint((gear.joint_a.number, gear.joint_b.number))
        ]
    beams = [part for part in parts if isinstance(part, Beam)]
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
        _remove_what_is_on(scene, [*beams, *_held_nodes(scene, nodes)])


def _list_of(part: object) -> str:
    """Name of the list in which a part can be."""
    return next((name for kind, name in _LIST_OF_KIND.items() if isinstance(part, kind)), "gears")


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


def _held_nodes(scene, nodes: Iterable[Node]) -> list[Node]:
    """Nodes that belong to no member any more, held where they are."""
    used = {node.number for member in (*scene.beams, *scene.bodies) for node in member.nodes}
    used |= {node.number for beam in scene.beams for node in beam.carriers} | scene.gone
    free = list({node.number: node for node in nodes if node.number not in used}.values())
    for node in free:
        scene.gone.add(node.number)
        for i in range(len(COMPONENTS)):
            scene.prescribed.pop((node.number, i), None)
            scene.fixed.add((node.number, i))
    return free


def _remove_what_is_on(scene, targets: Sequence[Beam | Node]) -> None:
    """Take loads, masses, joints, contacts and more away that act on beams or on nodes."""
    ids = {*map(id, targets)}
    for name, ends in _ENDS.items():
        parts = getattr(scene, name)
        on_them = {id(part): part for part in parts if not ids.isdisjoint(map(id, ends(part)))}
        for part in on_them.values():
            _forget(scene, part)
        if on_them:
            parts[:] = [part for part in parts if id(part) not in on_them]
    numbers = {target.number for target in targets if isinstance(target, Node)}
    scene.masses[:] = [mass for mass in scene.masses if mass.node not in numbers]
