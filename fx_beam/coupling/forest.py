"""Trees of coupled nodes: which node follows which through a joint."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.scene.beam import COMPONENTS
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import SlidingJoint, sliding_joints

# Loops are changed only if the number of joints in all loops falls below this part of it.
_SHORTER = 0.7
_PASSES = 3
# What joints and supports hold.
_COMPONENTS = "displacement in x", "displacement in y", "rotation"


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
    supports = [{n for n, part in {*scene.fixed, *scene.prescribed} if part == i} for i in range(3)]
    sliding = sliding_joints(scene.joints)
    _check_sliding_nodes(sliding, supports)
    carried = [key for joint in sliding for key in joint.carried]
    on_beams = [{node for _, node, part in carried if part == i} for i in range(3)]
    supports = [supported | on_beam for supported, on_beam in zip(supports, on_beams, strict=True)]
    joints = [joint for joint in scene.joints if joint not in sliding]
    turning = [joint for joint in joints if joint.turns_together]
    joints = order_for_short_loops(joints, _forest(scene, joints, 0, supports, on_beams)[1])
    joints_of = joints, joints, turning
    grown = [_forest(scene, members, i, supports, on_beams) for i, members in enumerate(joints_of)]
    forests, closed = zip(*grown, strict=True)
    return list(forests), [[loop[-1] for loop in loops] for loops in closed]


def _forest(
    scene: Scene,
    joints: Iterable[Joint],
    component: int,
    supports: list[set[int]],
    on_beams: list[set[int]],
) -> tuple[list[Branch], list[list[Joint]]]:
    """Joints as branches of trees, parents first, and loops with the closing joint behind.

    Roots: supported nodes and the ground; else a node that is supported in the other displacement,
    or the one with the smallest number. Loops without an arm or a node on a beam over-constrain.
    """
    supported = {*supports[component], GROUND.number}
    preferred = supports[1 - component] if component < 2 else set()
    # Supported nodes hang together.
    trees = dict.fromkeys(supported, GROUND.number)
    neighbours: dict[int, list[tuple[int, Joint]]] = {}
    closing: list[Joint] = []

    def tree(node: int) -> int:
        while (above := trees.setdefault(node, node)) != node:
            trees[node] = trees[above]  # halves the path for the next search
            node = above
        return node

    for joint in joints:
        a, b = joint.a.number, joint.b.number
        if tree(a) == tree(b):
            closing.append(joint)
            continue
        trees[tree(a)] = tree(b)
        neighbours.setdefault(a, []).append((b, joint))
        neighbours.setdefault(b, []).append((a, joint))

    above: dict[int, Branch] = {}
    depth: dict[int, int] = {}
    nodes = sorted(neighbours)
    reached: set[int] = set()
    for root in (n for part in (supported, preferred, neighbours) for n in nodes if n in part):
        queue = [] if root in reached else [root]
        for parent in queue:
            reached.add(parent)
            depth.setdefault(parent, 0)
            grown = [Branch(n, parent, j) for n, j in neighbours[parent] if n not in reached]
            above |= {branch.node: branch for branch in grown}
            depth |= dict.fromkeys((branch.node for branch in grown), depth[parent] + 1)
            queue += [branch.node for branch in grown]
    loops = [_loop(scene, joint, component, above, depth, on_beams[component]) for joint in closing]
    return [*above.values()], loops


def _loop(
    scene: Scene,
    joint: Joint,
    component: int,
    above: dict[int, Branch],
    depth: dict[int, int],
    on_beams: set[int],
) -> list[Joint]:
    """The loop that a joint closes, with this joint last; SceneError if it over-constrains."""
    way_a, way_b = list[Joint](), list[Joint]()
    first, last = joint.a.number, joint.b.number
    while first != last and (first in above or last in above):  # up from the deeper one
        if depth.get(first, 0) >= depth.get(last, 0):
            way_a.append(above[first].joint)
            first = above[first].parent
        else:
            way_b.append(above[last].joint)
            last = above[last].parent
    loop = [*way_b, *reversed(way_a), joint]
    turning, kind = component == 2, _COMPONENTS[component]
    on_beam = first != last and not on_beams.isdisjoint({first, last})
    yields = on_beam and not (turning and joint.rotation is not None)
    if yields or not (turning or all(other.is_selection for other in loop)):
        return loop
    reason = f"they close a loop in which each joint couples the {kind}"
    if first != last:
        loop = [*reversed(way_b), joint, *way_a][:: 1 if first < last else -1]
        ends = sorted((first, last))
        names = [str(GROUND if n == GROUND.number else scene.nodes[n]) for n in ends]
        reason = f"the {kind} of {names[0]} and of {names[1]} are both supported; support one of "
        reason += "them only"
    raise SceneError(
        f"over-constrained: {'; '.join(map(str, loop))}: {reason}. Remove one of them, or release "
        "a degree of freedom by a slide, a free rotation, or a beam between the nodes"
    )


def order_for_short_loops(joints: Sequence[Joint], loops: Sequence[Sequence[Joint]]) -> list[Joint]:
    """Joints in the order in which trees grow; joints that close loops are last.

    The last joint of a loop closes it. Loops of one tree are a basis of all loops: another joint f
    of loop k may close it; then each other loop with f becomes its sum with loop k. So the rungs of
    a ladder close one cell each. Only plain hinges are exchanged.
    """
    number = {id(joint): k for k, joint in enumerate(joints)}
    closing = [number[id(loop[-1])] for loop in loops]
    # Which joints each loop has; a joint is in one column.
    basis = np.zeros((len(loops), len(joints)), dtype=bool, order="F")
    for has, loop in zip(basis, loops, strict=True):
        has[[number[id(joint)] for joint in loop]] = True
    hinges = np.array([joint.is_selection and not joint.turns_together for joint in joints], bool)
    entry_count = np.count_nonzero(basis)
    changed, passes = len(basis) > 1, 0
    while changed and passes < _PASSES:
        changed, passes = False, passes + 1
        for k in np.argsort(np.count_nonzero(basis, axis=1), kind="stable").tolist():
            members = np.flatnonzero(basis[k])
            new = _better(k, basis[:, members], hinges[members])
            if new is not None and hinges[closing[k]]:
                other_loops = np.flatnonzero(basis[:, members[new]])
                other_loops = other_loops[other_loops != k]
                basis[np.ix_(other_loops, members)] ^= True
                closing[k], changed = int(members[new]), True
    if np.count_nonzero(basis) > _SHORTER * entry_count:
        return list(joints)
    return [joints[k] for k in sorted(range(len(joints)), key=set(closing).__contains__)]


def _better(k: int, basis: np.ndarray, hinges: np.ndarray) -> int | None:
    """The hinge of loop k that shortens other loops most if it closes loop k; None if none does.

    By which joints (loops, n) of loop k each loop has, and which of them are hinges.
    """
    gains = 2 * np.count_nonzero(basis, axis=1) - basis.shape[1]
    gains[k] = 0
    of_hinges = np.where(hinges, gains @ basis, 0)
    if not (most := of_hinges.max(initial=0)):
        return None
    # Of equal ones that of the first other loop.
    best = np.flatnonzero(of_hinges == most)
    first = np.argmax(basis[:, best] & (np.arange(len(basis)) != k)[:, None], axis=0)
    return int(best[np.argmin(first)])


def _check_sliding_nodes(sliding: list[SlidingJoint], supports: list[set[int]]) -> None:
    """Refuse a sliding node that is held in x, y or rotation, or that slides on two beams."""
    for joint in sliding:
        joints_of_node = [other for other in sliding if other.b is joint.b]
        if len(joints_of_node) > 1:
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
