"""Trees of coupled nodes: which node follows which through a joint."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from fx_beam.errors import SceneError
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.scene import Scene

from .short_loops import order_for_short_loops
from .sliding_order import hold_sliding_nodes


@dataclass(frozen=True)
class Branch:
    """A node that a joint couples to its parent in a tree."""

    node: int
    parent: int
    joint: Joint

    @property
    def sign(self) -> float:
        """1 where b follows a, -1 where a follows b."""
        return 1.0 if self.node == self.joint.b.number else -1.0


def grown_forests(scene: Scene) -> tuple[list[list[Branch]], list[list[Joint]]]:
    """Trees of x, y and rotation, and the joints that close loops in each.

    Of two joined nodes, one may be fixed in x and the other in y. If only one component of a tree
    is fixed, the other component has the same root.
    """
    held = [{n for n, part in {*scene.fixed, *scene.prescribed} if part == i} for i in range(3)]
    sliding = hold_sliding_nodes(scene.joints, held)
    carried = [key for joint in sliding for key in joint.carried]
    on_beams = [{node for _, node, part in carried if part == i} for i in range(3)]
    joints = [joint for joint in scene.joints if joint not in sliding]
    turning = [joint for joint in joints if joint.turns_together]
    loops = _forest(scene, joints, held[0], held[1], on_beams[0], "displacement in x")[1]
    joints = order_for_short_loops(joints, loops)
    grown = [
        _forest(scene, joints, held[0], held[1], on_beams[0], "displacement in x"),
        _forest(scene, joints, held[1], held[0], on_beams[1], "displacement in y"),
        _forest(scene, turning, held[2], set(), on_beams[2], "rotation"),
    ]
    forests, closed = zip(*grown, strict=True)
    return list(forests), [[loop[-1] for loop in loops] for loops in closed]


def _forest(
    scene: Scene,
    joints: Iterable[Joint],
    supported: set[int],
    preferred: set[int],
    on_beams: set[int],
    what: str,
) -> tuple[list[Branch], list[list[Joint]]]:
    """Joints as branches of trees, parents first; a supported node or the ground is a root.

    Otherwise the root is a preferred node, or the one with the smallest number. Also the loops with
    an arm that turns or slides, or with a node on a beam, each with the joint that closes it behind
    the others; other loops are over-constrained.
    """
    neighbours: dict[int, list[tuple[int, Joint]]] = {}
    trees: dict[int, int] = {}
    anchors = {node: node for node in {*supported, GROUND.number}}
    closed_loops: list[list[Joint]] = []

    def tree(node: int) -> int:
        while (above := trees.setdefault(node, node)) != node:
            trees[node] = trees[above]  # halves the path for the next search
            node = above
        return node

    for joint in joints:
        a, b = joint.a.number, joint.b.number
        closed = tree(a) == tree(b)
        loop = [*_path(neighbours, a, b), joint] if closed else []
        if not closed and tree(a) in anchors and tree(b) in anchors:
            ends = anchors[tree(a)], anchors[tree(b)]
            loop = [*_path(neighbours, ends[0], a), *_path(neighbours, b, ends[1]), joint]
            if on_beams.intersection(ends) and (joint.rotation is None or what != "rotation"):
                closed_loops.append(loop)
                continue
        if what != "rotation" and not all(other.is_index for other in loop):
            closed_loops.append(loop)
            continue
        if closed:
            _refuse(scene, loop, f"they close a loop in which each joint couples the {what}")
        if tree(a) in anchors:
            anchors.setdefault(tree(b), anchors[tree(a)])
        trees[tree(a)] = tree(b)
        neighbours.setdefault(a, []).append((b, joint))
        neighbours.setdefault(b, []).append((a, joint))

    branches: list[Branch] = []
    reached: set[int] = set()

    def grow(root: int) -> None:
        reached.add(root)
        queue = [root]
        for parent in queue:
            for node, joint in neighbours.get(parent, []):
                if node in reached:
                    continue
                if node in supported or node == GROUND.number:
                    path = _path(neighbours, root, node)
                    first, second = (
                        GROUND if n == GROUND.number else scene.nodes[n] for n in (root, node)
                    )
                    reason = (
                        f"the {what} of {first} and of {second} are both supported; support one of "
                        "them only"
                    )
                    _refuse(scene, path, reason)
                reached.add(node)
                branches.append(Branch(node, parent, joint))
                queue.append(node)

    nodes = sorted(neighbours)
    roots = [n for n in nodes if n in supported or n == GROUND.number]
    for root in [*roots, *(n for n in nodes if n in preferred), *nodes]:
        if root not in reached:
            grow(root)
    return branches, closed_loops


def _path(neighbours, start: int, end: int) -> list[Joint]:
    """Joints between two nodes of a tree."""
    came: dict[int, tuple[int, Joint] | None] = {start: None}
    queue = [start]
    for node in queue:
        if node == end:
            break
        for other, joint in neighbours.get(node, []):
            if other not in came:
                came[other] = (node, joint)
                queue.append(other)
    joints = []
    step = came[end]
    while step is not None:
        joints.append(step[1])
        step = came[step[0]]
    return joints


def _refuse(scene: Scene, joints, reason: str) -> None:
    names = "; ".join(str(joint) for joint in joints)
    raise SceneError(
        f"over-constrained: {names}: {reason}. Remove one of them, or release a degree of freedom "
        "by a slide, a free rotation, or a beam between the nodes"
    )
