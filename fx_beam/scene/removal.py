"""What is taken away from a scene, and what goes with it.

Numbers of nodes and joints stay: rows of solutions belong to them. Nodes of no member are held.
"""

from __future__ import annotations

from typing import Any

from .beam import COMPONENTS, Beam, Node
from .body import Body
from .joints import Joint


def remove_joint(scene: Any, joint: Joint) -> None:
    """Take a joint away; its nodes are free of each other."""
    at = next(i for i, one in enumerate(scene.joints) if one is joint)
    del scene.joints[at]


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

    def on_it(*ends: Any) -> bool:
        return any(end is target for end in ends)

    scene.loads[:] = [load for load in scene.loads if not on_it(load.target)]
    scene.drags[:] = [drag for drag in scene.drags if not on_it(drag.target)]
    scene.velocities[:] = [given for given in scene.velocities if not on_it(given.target)]
    scene.virtual_works[:] = [work for work in scene.virtual_works if work.beam is not target]
    for between in [force for force in scene.forces_between if on_it(force.a, force.b)]:
        scene.remove(between)
    scene.obstacles[:] = [
        one for one in scene.obstacles if not on_it(one.target, getattr(one.shape, "carrier", None))
    ]
    if isinstance(target, Node):
        scene.masses[:] = [mass for mass in scene.masses if mass.node != target.number]
        ends = ((joint, joint.a, joint.b) for joint in scene.joints)
        for joint in [joint for joint, *nodes in ends if on_it(*nodes)]:
            remove_joint(scene, joint)
    else:
        sliding = [joint for joint in scene.joints if on_it(getattr(joint, "beam", None))]
        for joint in sliding:
            remove_joint(scene, joint)
