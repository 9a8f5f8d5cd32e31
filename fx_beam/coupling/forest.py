"""Trees of coupled nodes: which node follows which through a joint."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.scene.beam import COMPONENTS
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import SlidingJoint, sliding_joints

# Loops are changed only if the number of joints in all loops falls below this part of it.
_SHORTER = 0.7


@dataclass(frozen=True)
class TreeNode:
    """A node that a joint couples to its parent in a tree."""

    node: int
    parent: int
    joint: Joint

    @property
    def sign(self) -> float:
        """1 where b follows a, -1 where a follows b."""
        return 1.0 if self.node == self.joint.b.number else -1.0


def grown_forests(scene: Scene) -> tuple[list[list[TreeNode]], list[list[Joint]]]:
    """Trees of x, y and rotation, and the joints that close loops in each.

    Of two joined nodes, one may be fixed in x and the other in y. If only one component of a tree
    is fixed, the other component has the same root.
    """
    supports = [{n for n, part in {*scene.fixed, *scene.prescribed} if part == i} for i in range(3)]
    sliding = sliding_joints(scene.joints)
    _check_sliding_nodes(sliding, supports)
    carried = [key for joint in sliding for key in joint.carried]
    beam_nodes = [{node for _, node, part in carried if part == i} for i in range(3)]
    supports = [
        supported | meets_beam for supported, meets_beam in zip(supports, beam_nodes, strict=True)
    ]
    joints = [joint for joint in scene.joints if joint not in sliding]
    turning = [joint for joint in joints if joint.turns_together]
    joints = _for_short_loops(joints, supports)
    grown = [_forest(members, i, supports) for i, members in enumerate((joints, joints, turning))]
    forests, closed = zip(*grown, strict=True)
    return list(forests), list(closed)


def _forest(
    joints: Iterable[Joint], component: int, supports: list[set[int]]
) -> tuple[list[TreeNode], list[Joint]]:
    """Joints as branches of trees, parents first, and those that close loops.

    Roots: supported nodes and the ground; else a node that is supported in the other displacement,
    or the one with the smallest number.
    """
    supported = {*supports[component], GROUND.number}
    preferred = supports[1 - component] if component < 2 else set()
    # Supported nodes hang together.
    trees = dict.fromkeys(supported, GROUND.number)
    neighbours: dict[int, list[tuple[int, Joint]]] = {}
    closing: list[Joint] = []

    def tree(node: int) -> int:
        while (parent := trees.setdefault(node, node)) != node:
            trees[node] = trees[parent]  # halves the path for the next search
            node = parent
        return node

    for joint in joints:
        a, b = joint.a.number, joint.b.number
        if tree(a) == tree(b):
            closing.append(joint)
            continue
        trees[tree(a)] = tree(b)
        neighbours.setdefault(a, []).append((b, joint))
        neighbours.setdefault(b, []).append((a, joint))

    forest = list[TreeNode]()
    nodes = sorted(neighbours)
    reached: set[int] = set()
    for root in (n for part in (supported, preferred, neighbours) for n in nodes if n in part):
        queue = [] if root in reached else [root]
        for parent in queue:
            reached.add(parent)
            grown = [TreeNode(n, parent, j) for n, j in neighbours[parent] if n not in reached]
            forest += grown
            queue += [branch.node for branch in grown]
    return forest, closing


def _loops_through(forest: list[TreeNode], closing: list[Joint]) -> list[int]:
    """Number (branches,) of loops through each branch: up from both nodes to where these meet."""
    number = {branch.node: k for k, branch in enumerate(forest)}
    # The last branch, -1, is above all roots.
    parents = np.array([*(number.get(branch.parent, -1) for branch in forest), -1])
    depth = np.zeros(len(parents), dtype=int)
    for k in range(len(forest)):
        depth[k] = 1 + depth[parents[k]]
    ends = zip(*((joint.a.number, joint.b.number) for joint in closing), strict=True)
    a, b = (np.array([number.get(node, -1) for node in nodes]) for nodes in ends)
    count = np.zeros(len(parents), dtype=int)
    for branches, loops in ((a, 1), (b, 1), (_meeting(parents, depth, a, b), -2)):
        np.add.at(count, branches, loops)
    for k in reversed(range(len(forest))):
        count[parents[k]] += count[k]
    return count[:-1].tolist()


def _meeting(parents: np.ndarray, depth: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Branches at which the ways up from branches a and b meet."""
    strides = [parents]  # up by powers of two
    while (strides[-1] >= 0).any():
        strides.append(strides[-1][strides[-1]])
    for k, up in reversed([*enumerate(strides)]):  # to the same depth
        deeper = depth[a] - depth[b]
        a, b = np.where(deeper >= 1 << k, up[a], a), np.where(-deeper >= 1 << k, up[b], b)
    for up in reversed(strides):
        apart = up[a] != up[b]
        a, b = np.where(apart, up[a], a), np.where(apart, up[b], b)
    return np.where(a == b, a, parents[a])


def loop_through(forest: list[TreeNode], joint: Joint) -> tuple[list[Joint], list[int]]:
    """Joints of the loop that one closes, by number; the roots at its ends, if these are two."""
    joints, pulls = [joint], Counter({joint.b.number: 1})
    pulls[joint.a.number] -= 1
    for branch in reversed(forest):
        if pull := pulls.pop(branch.node, 0):
            joints.append(branch.joint)
            pulls[branch.parent] += pull
    ends = sorted(node for node, pull in pulls.items() if pull)
    return sorted(joints, key=lambda joint: joint.number), ends


def _for_short_loops(joints: list[Joint], supports: list[set[int]]) -> list[Joint]:
    """Joints in an order in which loops of the tree of x are short; those that close them are last.

    A loop is closed by the hinge through which most loops went before, so that each cell of a
    ladder is one. Only plain hinges are exchanged.
    """
    hinges = {id(joint) for joint in joints if joint.is_selection and not joint.turns_together}
    order, lengths, closed_by = joints, list[int](), list[set[int]]()
    most_loops = len(joints)
    while len(lengths) < 2 or lengths[-1] == min(lengths) < lengths[-2]:
        forest, closing = _forest(order, 0, supports)
        if len(closing) < 2:
            return joints
        counts = [*_loops_through(forest, closing), *[1] * len(closing)]
        names = [id(joint) for joint in (*(branch.joint for branch in forest), *closing)]
        lengths.append(sum(counts))
        closed_by.append({*names[len(forest) :]})
        loops = dict(zip(names, counts, strict=True))  # through each
        for name in loops.keys() - hinges:  # which stay where they are
            loops[name] = most_loops if name in closed_by[-1] else -1
        order = [joints[k] for k in np.argsort([loops[id(x)] for x in joints], kind="stable")]
    best = int(np.argmin(lengths))
    if lengths[best] > _SHORTER * lengths[0]:
        return joints
    return sorted(joints, key=lambda joint: id(joint) in closed_by[best])


def _check_sliding_nodes(sliding: list[SlidingJoint], supports: list[set[int]]) -> None:
    """Refuse a sliding node that is held in x, y or rotation, or that slides on two beams."""
    joints_at = dict[int, list[SlidingJoint]]()
    for joint in sliding:
        joints_at.setdefault(joint.b.number, []).append(joint)
    for joint in sliding:
        if len(joints_of_node := joints_at[joint.b.number]) > 1:
            names = "; ".join(map(str, joints_of_node))
            raise SceneError(
                f"over-constrained: {names}: {joint.b} slides on two beams. Let two nodes slide, "
                "and join them by a beam"
            )
        for _, node, i in joint.carried:
            if node in supports[i]:
                raise SceneError(
                    f"over-constrained: {joint}: {COMPONENTS[i]} of the node is supported, but the "
                    "beam moves it. Support the node before this joint is added: then it is a guide"
                )
