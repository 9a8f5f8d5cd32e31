"""Which degrees of freedom the joints eliminate: trees of coupled nodes, columns of unknowns."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.fem.mesh import Mesh
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import SlidingJoint, sliding_joints

from .sliding_order import hold_sliding_nodes, with_order

#: An entry of a coupling: column, position of its value (0 is the constant 1), and sign.
Entry = tuple[int, int, float]
# Key of the ground's column, which is fixed.
_GROUND = ("ground",)


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


@dataclass(frozen=True)
class Closure:
    """A joint that closes a loop in x or y: an equation between columns, gap = 0."""

    joint: Joint
    #: 0 for x, 1 for y.
    component: int
    #: Entries of the gap: the displacement of b minus that of its place on a.
    entries: list[Entry]


@dataclass(frozen=True)
class Couplings:
    """All degrees of freedom as functions of the remaining columns.

    Order of columns: free degrees of freedom and slides; driven (prescribed motions, then motors);
    fixed, with one for the ground; those of nodes that slide on beams, which depend on the others.
    """

    #: Number of free columns, of driven ones, and of all.
    free: int
    driven: int
    columns: int
    #: Column (size,) that each degree of freedom equals; -1 for a sum, with its entries in `sums`.
    column: np.ndarray
    sums: dict[int, list[Entry]]
    #: Column of the slide of each joint that has one, by the joint's number.
    slides: dict[int, int]
    #: Joints whose coupling changes with the motion. Joint m has the values 1 + 4 m to 4 + 4 m: the
    #: derivatives of x and y by the rotation, then by the slide.
    moving: list[Joint]
    #: For x, y and rotation (3, joints): 1 if b follows a, -1 if a follows b, 0 if neither does.
    sign: np.ndarray
    #: For x, y and rotation, and for each joint: the nodes that follow through it.
    subtree: list[list[np.ndarray]]
    #: Joints of nodes that slide on beams: each after those on whose nodes its beam depends.
    sliding: list[SlidingJoint]
    #: Columns of the nodes that slide, by the number of the joint.
    carried: dict[int, list[int]]
    #: Joints that close loops.
    closures: list[Closure]

    @property
    def is_index(self) -> bool:
        """Whether each degree of freedom equals one column."""
        return not self.sums and not self.sliding

    @property
    def independent(self) -> int:
        """Number of columns that do not depend on others."""
        return self.columns - sum(map(len, self.carried.values()))

    def entries(self, dof: int) -> list[Entry]:
        """Entries of a degree of freedom."""
        return self.sums.get(dof) or [(int(self.column[dof]), 0, 1.0)]

    def all_entries(self) -> tuple[np.ndarray, ...]:
        """Degrees of freedom, columns, positions and signs of all entries, in order."""
        alone = np.flatnonzero(self.column >= 0)
        of_sums = [(dof, *entry) for dof, own in self.sums.items() for entry in own]
        dofs, columns, places, signs = np.array(of_sums).reshape(-1, 4).T
        dofs = np.concatenate([alone, dofs.astype(int)])
        order = np.argsort(dofs, kind="stable")
        n = len(alone)
        parts = (
            (self.column[alone], columns.astype(int)),
            (np.zeros(n, int), places.astype(int)),
            (np.ones(n), signs),
        )
        return dofs[order], *(np.concatenate(part)[order] for part in parts)

    @cached_property
    def places(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Free columns of degrees of freedom and of slides, each with its owners."""
        dofs = np.flatnonzero((self.column >= 0) & (self.column < self.free))
        slides = np.array([pair for pair in self.slides.items() if pair[1] < self.free], int)
        number, of_slide = slides.reshape(-1, 2).T
        return self.column[dofs], dofs, of_slide, number

    def unknowns(self, D: np.ndarray, slides: np.ndarray) -> np.ndarray:
        """Unknowns (..., free) from increments (..., size) and slides (..., joints)."""
        y = np.zeros((*D.shape[:-1], self.free))
        columns, dofs, of_slides, numbers = self.places
        y[..., columns], y[..., of_slides] = D[..., dofs], slides[..., numbers]
        return y

    def free_slides(self, y: np.ndarray, joints: int) -> np.ndarray:
        """Increments of the slides (..., joints) from the unknowns (..., free)."""
        slides = np.zeros((*y.shape[:-1], joints))
        _, _, columns, numbers = self.places
        slides[..., numbers] = y[..., columns]
        return slides

    def entries_of_guide(self, joint: Joint, dofs: np.ndarray) -> list[Entry]:
        """Entries of the rotation of a joint's offset and axis; none on the ground."""
        return self.entries(dofs[joint.a.number, 2]) if joint.a is not GROUND else []


def couple(scene: Scene, mesh: Mesh) -> Couplings:
    """Couplings of a scene; SceneError for joints that over-constrain, with their names."""
    forests, closing = _forests(scene)
    columns = _Columns(scene, mesh, forests)
    moving = [b.joint for b in forests[0] if not b.joint.is_index]
    moving += [joint for joint in closing[0] if not joint.is_index]
    place = {joint.number: 1 + 4 * m for m, joint in enumerate(moving)}
    ground = [(columns.of[_GROUND], 0, 1.0)] if _GROUND in columns.of else []
    #: Entries of the nodes that follow through a joint.
    entries: dict[tuple[int, int], list[Entry]] = {(GROUND.number, i): ground for i in range(3)}

    def entries_of(node: int, component: int) -> list[Entry]:
        root = int(columns.of_roots[node, component]) if node >= 0 else -1
        return entries[node, component] if root < 0 else [(root, 0, 1.0)]

    for branch in forests[2]:
        own = list(entries_of(branch.parent, 2))
        if branch.joint.rotation is not None:
            own.append((columns.of["motor", branch.joint.number], 0, branch.sign))
        entries[branch.node, 2] = own

    def entries_of_arm(joint: Joint, i: int, side: float) -> list[Entry]:
        if joint.number not in place:
            return []
        first = place[joint.number] + i
        turn = entries_of(joint.a.number, 2)
        own = [(column, first, sign * side) for column, _, sign in turn]
        if joint.slide is not None:
            own.append((columns.slides[joint.number], first + 2, side))
        return own

    for i in (0, 1):
        for branch in forests[i]:
            arm = entries_of_arm(branch.joint, i, branch.sign)
            entries[branch.node, i] = [*entries_of(branch.parent, i), *arm]
    closures = []
    for i in (0, 1):
        for joint in closing[i]:
            total: dict[tuple[int, int], float] = {}
            ends = (1.0, entries_of(joint.b.number, i)), (-1.0, entries_of(joint.a.number, i))
            for side, own in (*ends, (1.0, entries_of_arm(joint, i, -1.0))):
                for *key, sign in own:
                    total[key[0], key[1]] = total.get((key[0], key[1]), 0.0) + side * sign
            gap = [(at, value, sign) for (at, value), sign in total.items() if sign]
            closures.append(Closure(joint, i, gap))

    column = np.empty(mesh.dofs.size, dtype=int)
    column[mesh.dofs] = columns.of_roots
    sums = {}
    for (node, component), own in entries.items():
        if node < 0:
            continue
        dof = int(mesh.dofs[node, component])
        if len(own) == 1 and own[0][1:] == (0, 1.0):
            column[dof] = own[0][0]
        else:
            sums[dof] = own
    couplings = Couplings(
        free=columns.free,
        driven=columns.driven,
        columns=columns.count,
        column=column,
        sums=sums,
        slides=columns.slides,
        moving=moving,
        sign=np.array([_signs(forest, len(scene.joints)) for forest in forests]),
        subtree=[_descendants(forest, len(scene.joints)) for forest in forests],
        sliding=sliding_joints(scene.joints),
        carried=columns.carried,
        closures=closures,
    )
    return with_order(scene, mesh, couplings, forests) if couplings.sliding else couplings


class _Columns:
    """Numbers of the columns: free, driven, fixed."""

    def __init__(self, scene: Scene, mesh: Mesh, forests: list[list[Branch]]):
        follows = [(branch.node, i) for i, forest in enumerate(forests) for branch in forest]
        taken = [*scene.prescribed, *sorted(scene.fixed)]
        root, free_root = np.ones((2, len(mesh.X), 3), dtype=bool)
        carried = [key for joint in sliding_joints(scene.joints) for key in joint.carried]
        for key in follows:
            root[key] = free_root[key] = False
        for key in (*taken, *(key[1:] for key in carried)):
            free_root[key] = False
        motored = motors(scene)
        moved = {joint.number for joint, name in motored if name == "slide"}
        slides = [joint.number for joint in scene.joints if joint.slide is not None]
        free: list[tuple] = [("slide", number) for number in slides if number not in moved]
        driven: list[tuple] = list(scene.prescribed)
        driven += [("motor", joint.number) for joint, _ in motored]
        branches = [branch for forest in forests for branch in forest]
        ground = [_GROUND] if any(b.parent == GROUND.number for b in branches) else []
        keys = [*free, *driven, *sorted(scene.fixed), *ground, *carried]
        alone = int(np.count_nonzero(free_root))
        #: Columns of slides, driven and fixed degrees of freedom, and of the ground.
        self.of: dict[tuple, int] = {key: column for column, key in enumerate(keys, start=alone)}
        #: Column (nodes, 3) of each component of a node that follows no joint; -1 for the others.
        self.of_roots = np.full(root.shape, -1)
        self.of_roots[free_root] = np.arange(alone)
        for key in taken:
            if root[key]:
                self.of_roots[key] = self.of[key]
        for sliding in carried:
            self.of_roots[sliding[1:]] = self.of[sliding]
        self.free, self.driven, self.count = alone + len(free), len(driven), alone + len(keys)
        #: Columns of the nodes that slide, by the number of the joint.
        self.carried = {
            joint.number: [self.of[key] for key in joint.carried]
            for joint in sliding_joints(scene.joints)
        }
        self.slides = {n: self.of["motor" if n in moved else "slide", n] for n in slides}


def motors(scene: Scene) -> list[tuple[Joint, str]]:
    """Joints with a motor, each with the name of its coordinate: "slide" or "rotation"."""
    found = []
    for joint in scene.joints:
        names = [
            name
            for name, coordinate in (("slide", joint.slide), ("rotation", joint.rotation))
            if coordinate is not None and coordinate.motor is not None
        ]
        if len(names) == 2:
            raise SceneError(f"{joint}: it has two motors. Move one of them to another joint")
        found += [(joint, name) for name in names]
    return found


def _forests(scene: Scene) -> tuple[list[list[Branch]], list[list[Joint]]]:
    """Trees of x, y and rotation, and the joints that close loops in each.

    Of two joined nodes, one may be fixed in x and the other in y. If only one component of a tree
    is fixed, the other component has the same root.
    """
    held = [{n for n, part in {*scene.fixed, *scene.prescribed} if part == i} for i in range(3)]
    sliding = hold_sliding_nodes(scene.joints, held)
    joints = [joint for joint in scene.joints if joint not in sliding]
    turning = [joint for joint in joints if joint.turns_together]
    found = [
        _forest(scene, joints, held[0], held[1], "displacement in x"),
        _forest(scene, joints, held[1], held[0], "displacement in y"),
        _forest(scene, turning, held[2], set(), "rotation"),
    ]
    forests, closing = zip(*found, strict=True)
    return list(forests), list(closing)


def _forest(
    scene: Scene, joints: Iterable[Joint], supported: set[int], preferred: set[int], what: str
) -> tuple[list[Branch], list[Joint]]:
    """Joints as branches of trees, parents first; a supported node or the ground is a root.

    Otherwise the root is a preferred node, or the one with the smallest number. Also the joints
    that close loops with an arm that turns or slides; other loops are over-constrained.
    """
    neighbours: dict[int, list[tuple[int, Joint]]] = {}
    trees: dict[int, int] = {}
    anchors = {node: node for node in {*supported, GROUND.number}}
    closing: list[Joint] = []

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
            loop = [*_path(neighbours, anchors[tree(a)], a), joint]
            loop += _path(neighbours, b, anchors[tree(b)])
        if what != "rotation" and not all(other.is_index for other in loop):
            closing.append(joint)
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

    found = sorted(neighbours)
    roots = [n for n in found if n in supported or n == GROUND.number]
    for root in [*roots, *(n for n in found if n in preferred), *found]:
        if root not in reached:
            grow(root)
    return branches, closing


def _path(neighbours, start: int, end: int) -> list[Joint]:
    """Joints between two nodes of a tree."""
    came: dict[int, tuple[int, Joint] | None] = {start: None}
    queue = [start]
    for node in queue:
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
    if sliding_joints(scene.joints) and "both supported" in reason:
        reason += ", where a beam supports the node that slides on it"
    raise SceneError(
        f"over-constrained: {names}: {reason}. Remove one of them, or release a degree of freedom "
        "by a slide, a free rotation, or a beam between the nodes"
    )


def _signs(branches: list[Branch], joints: int) -> np.ndarray:
    signs = np.zeros(joints)
    for branch in branches:
        signs[branch.joint.number] = branch.sign
    return signs


def _descendants(branches: list[Branch], joints: int) -> list[np.ndarray]:
    """Nodes that follow through each joint, the branch's node included."""
    below: dict[int, list[int]] = {b.node: [b.node] for b in branches}
    for branch in reversed(branches):
        if branch.parent in below:
            below[branch.parent] += below[branch.node]
    found: list[np.ndarray] = [np.empty(0, dtype=int)] * joints
    for branch in branches:
        found[branch.joint.number] = np.array(below[branch.node])
    return found
