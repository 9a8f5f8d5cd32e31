"""What is taken away from a scene, and what goes with it; joints that are locked.

Numbers of nodes and joints stay: rows of solutions belong to them. Nodes of no member are held.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from fx_beam.errors import SceneError, require

from .beam import COMPONENTS, Beam, Node
from .body import Body
from .coordinate import Held
from .joints import Joint, joints_by_number

# Lists of parts, each with the node or beam on which it is, or with both ends.
_WITH_ENDS = "loads natural_strains drags velocities virtual_works contacts joints".split()


def own_joint(scene: Any, joint: Joint) -> Joint | None:
    """The joint of a scene that was added as this one, and may have been locked since."""
    known = joints_by_number(scene).get(joint.number)
    key = joint.kind, joint.a, joint.b
    same = known is not None and (known.kind, known.a, known.b) == key
    return known if same and all(n.scene in (scene, None) for n in (joint.a, joint.b)) else None


def remove_joint(scene: Any, joint: Joint) -> None:
    """Take a joint away; its nodes are free of each other."""
    scene.joints[:] = [one for one in scene.joints if one.number != joint.number]


def locked(joint: Joint, coordinate: str | None) -> Joint:
    """The joint with a coordinate that keeps its value; SceneError if it has no such one."""
    names = [*joint.coordinates]
    fits = coordinate is None or coordinate in names
    require(fits, f"lock {joint}: coordinate", coordinate, f"one of {names}")
    if not names:
        raise SceneError(f"lock {joint}: it has no slide and no relative rotation to lock")
    if coordinate is None and len(names) > 1:
        raise SceneError(f"lock {joint}: it has {names} coordinates. Name one of them")
    name = coordinate or names[0]
    if name in joint.driven:
        raise SceneError(f"lock {joint}: a motor, or a lock, holds its {name} already")
    held: Any = replace(joint.coordinates[name], motor=Held())
    return replace(joint, **{name: held})


def unlocked(joint: Joint) -> Joint:
    """The joint without its lock; SceneError if it has none."""
    for name, part in joint.coordinates.items():
        if isinstance(part.motor, Held):
            free: Any = replace(part, motor=None)
            return replace(joint, **{name: free})
    raise SceneError(f"unlock {joint}: it is not locked")


def remove_beam(scene: Any, beam: Beam) -> None:
    """Take a beam away, with all that is on it or on nodes that belong to nothing else."""
    scene.beams[:] = [other for other in scene.beams if other is not beam]
    _remove_what_is_on(scene, beam)
    _remove_nodes(scene, beam.nodes)


def remove_body(scene: Any, body: Body) -> None:
    """Take a body away; nodes of beams that followed it are free."""
    scene.bodies[:] = [other for other in scene.bodies if other is not body]
    points = {node.number for node in body.points.values()}
    scene.joints[:] = [
        joint
        for joint in scene.joints
        if not (joint.is_rigid and joint.a is body.centre and joint.b.number in points)
    ]
    _remove_nodes(scene, body.nodes)


def _remove_nodes(scene: Any, nodes: Any) -> None:
    """Take all away that is on nodes which belong to no member, and hold them."""
    used = {node.number for member in (*scene.beams, *scene.bodies) for node in member.nodes}
    for node in nodes:
        if node.number not in used and node.number not in scene.gone:
            _remove_what_is_on(scene, node)
            scene.gone.add(node.number)
            for i in range(len(COMPONENTS)):
                scene.prescribed.pop((node.number, i), None)
                scene.fixed.add((node.number, i))


def _remove_what_is_on(scene: Any, target: Beam | Node) -> None:
    """Take loads, masses, joints, contacts and more away that act on a beam or on a node."""

    def is_on_it(part: Any) -> bool:
        shape = getattr(part, "shape", None)
        ends = (getattr(part, name, None) for name in ("target", "beam", "a", "b"))
        return any(end is target for end in (*ends, shape, getattr(shape, "carrier", None)))

    for name in _WITH_ENDS:
        known = getattr(scene, name)
        known[:] = [part for part in known if not is_on_it(part)]
    for between in [force for force in scene.forces_between if is_on_it(force)]:
        scene.remove(between)
    if isinstance(target, Node):
        scene.masses[:] = [mass for mass in scene.masses if mass.node != target.number]
