"""Which degrees of freedom joints eliminate: trees of nodes, columns of unknowns, their sums."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse import csr_matrix

from fx_beam.errors import SceneError
from fx_beam.fem.mesh import Mesh, connected_parts, starts_of
from fx_beam.scene.beam import COMPONENTS, Beam
from fx_beam.scene.joints import GROUND, Joint, joints_by_number, missing_joints
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import SlidingJoint, sliding_joints

if TYPE_CHECKING:
    from fx_beam.scene.gears import Gear


# -- Trees of coupled nodes: which node follows which through a joint ---------------------------


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


# -- Which degrees of freedom the joints eliminate: columns of unknowns, and sums over trees ----


#: An entry of a coupling: column, position of its value (0 is the constant 1), and sign.
Entry = tuple[int, int, float]
# Trees in which a degree of freedom would be a sum of more entries than the first number are tied:
# sums then have as many entries as the second, or the few more of one joint. More entries make more
# products in the tangent, more auxiliary unknowns make it larger.
_LONG, _REACH = 14, 6
# What joints and supports hold.
_COMPONENTS = "displacement in x", "displacement in y", "rotation"
# Key of the ground's column, which is fixed.
_GROUND = ("ground",)


class Entries(NamedTuple):
    """Entries of several sums as arrays, in order."""

    #: Number of the sum, column, position of the value, and sign of each.
    row: np.ndarray
    column: np.ndarray
    value_at: np.ndarray
    sign: np.ndarray

    @classmethod
    def of(cls, sums: Iterable[tuple[int, Sequence[Entry]]]) -> Entries:
        """Entries of numbered sums."""
        entries = [(row, *entry) for row, row_entries in sums for entry in row_entries]
        table = np.array(entries, dtype=float).reshape(-1, 4)
        row, column, value_at = table[:, :3].T.astype(np.int32)
        return cls(row, column, value_at, table[:, 3])

    def take(self, chosen: np.ndarray | slice) -> Entries:
        """The chosen entries."""
        return Entries(*(part[chosen] for part in self))

    def matrix(self, values: np.ndarray, shape: tuple[int, int]) -> csr_matrix:
        """The sums (rows, columns) for the values of T or Tv."""
        row, column, weights = self.weights(values)
        return csr_matrix((weights, (row, column)), shape)

    def weights(self, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows, columns and values of `matrix`."""
        return self.row, self.column, values[self.value_at] * self.sign

    def members(self, prefix: str = "") -> dict[str, np.ndarray]:
        """Columns, positions of values and signs, by the names in tables.h."""
        parts = ("column", self.column), ("value", self.value_at), ("sign", self.sign)
        return {f"{prefix}{part}": values for part, values in parts}

    @property
    def factors(self) -> dict[str, np.ndarray]:
        """Positions of values twice: of T for equations, then of Tv for the balance of forces."""
        constant = np.zeros(len(self.row), dtype=int)
        virtual, value = np.append(constant, self.value_at), np.append(self.value_at, constant)
        return {"virtual": virtual, "value": value, "sign": np.tile(self.sign, 2)}

    @property
    def arms(self) -> tuple[np.ndarray, np.ndarray]:
        """Sums and arms of joints in them (n,): 2 m for x and 2 m + 1 for y of joint m."""
        moves = self.value_at > 0
        joint, part = np.divmod(self.value_at[moves] - 1, 4)  # see `Couplings.arm_joints`
        arm, count = 2 * joint + part % 2, self.value_at.max(initial=1)  # which is larger
        return np.divmod(np.unique(self.row[moves].astype(int) * count + arm), count)

    def starts(self, rows: int) -> np.ndarray:
        """Where the entries of each of so many sums begin, and the last ones end."""
        return starts_of(np.bincount(self.row, minlength=rows))


def joined(*tables: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """One table of several, behind each other."""
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


class SystemEntries(NamedTuple):
    """Entries of T and Tv in the linear system: rows, columns and factors.

    There may be more rows and columns than factors: the last entries are 1.
    """

    rows: np.ndarray
    columns: np.ndarray
    #: Values and signs, by the names in tables.h.
    factors: dict[str, np.ndarray]


@dataclass(frozen=True)
class Closure:
    """A joint that closes a loop in a component: an equation between columns, closure = 0."""

    joint: Joint | Gear
    #: 0 for x or a rack, 1 for y; 2 for the rotation, only in loops with a sleeve, or a gear.
    component: int
    #: Entries of closure = u_b - u_p, with the point p of a at which b is.
    entries: list[Entry]


@dataclass(frozen=True)
class Auxiliary:
    """A degree of freedom in a long tree, with a column of its own: column = sum of entries.

    What follows it refers to this column, not to all columns on the way from the root. Newton's
    method does not know it; the linear system has it as an unknown, with the sum as an equation.
    """

    dof: int
    #: Entries of the sum; it has columns of earlier auxiliary unknowns only.
    entries: list[Entry]


@dataclass(frozen=True)
class Couplings:
    """All degrees of freedom as functions of the remaining columns.

    Order of columns: free degrees of freedom and slides; driven (prescribed motions, then motors);
    fixed, with one for the ground; nodes that slide on beams, which depend on other columns;
    auxiliary unknowns.
    """

    #: Number of free columns, of driven ones, of the last free ones that are driven in motions, and
    #: of all but the auxiliary unknowns.
    free: int
    driven: int
    released: int
    columns: int
    #: Column (size,) that each degree of freedom equals; -1 for a sum, with its entries in `sums`.
    column: np.ndarray
    sums: dict[int, list[Entry]]
    #: Column of the slide of each joint that has one, by the joint's number.
    slides: dict[int, int]
    #: Joints whose coupling changes with the motion. Joint m has the values 1 + 4 m to 4 + 4 m: the
    #: derivatives of x and y by the rotation, then by the slide.
    arm_joints: list[Joint]
    #: For x, y and rotation (3, joints): 1 if b follows a, -1 if a follows b, 0 if neither does.
    sign: np.ndarray
    #: Auxiliaries: of rotations, then of x and y.
    auxiliaries: list[Auxiliary]
    #: For x, y and rotation: the nodes that follow others through joints, parents first.
    forests: list[list[TreeNode]]
    #: Joints of nodes that slide on beams, in order: a beam depends on earlier sliding nodes only.
    sliding: list[SlidingJoint]
    #: Columns of the nodes that slide, by the number of the joint.
    carried: dict[int, list[int]]
    #: Joints that close loops, and gears.
    closures: list[Closure]
    #: Gears that are relations. Number g has the values 2 g and 2 g + 1 after those of arms.
    gears: list[Gear]
    #: Numbers of joints that were removed, or were not there yet.
    missing: list[int]
    #: Entries of all degrees of freedom.
    all_entries: Entries
    #: Free columns and their degrees of freedom, free columns and their slides (by joint).
    free_columns: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    #: Row of the forces on each column in the linear system, and unknown; -1 for none. Order: free
    #: columns, then two for each auxiliary unknown (row of its equation: displacement; row of its
    #: balance: force). Nodes that slide on beams are behind all unknowns.
    system: tuple[np.ndarray, np.ndarray]

    @property
    def need_places(self) -> bool:
        """Whether joints close loops, or slide on beams: they are set up for their places."""
        return bool(self.closures or self.sliding)

    @property
    def is_selection(self) -> bool:
        """Whether each degree of freedom equals one column, and no joint closes a loop."""
        return not (self.sums or self.sliding or self.closures)

    @property
    def independent(self) -> int:
        """Number of columns that do not depend on others."""
        return self.columns - sum(map(len, self.carried.values()))

    @property
    def unknown_count(self) -> int:
        """Number of free columns, two for each auxiliary unknown, and forces of closures."""
        return self.free + 2 * len(self.auxiliaries) + len(self.closures)

    def entries(self, dof: int) -> list[Entry]:
        """Entries of a degree of freedom."""
        return self.sums.get(dof) or [(int(self.column[dof]), 0, 1.0)]

    def unknowns(self, D: np.ndarray, slides: np.ndarray) -> np.ndarray:
        """Unknowns (..., free) from increments (..., size) and slides (..., joints)."""
        y = np.zeros((*D.shape[:-1], self.free))
        columns, dofs, slide_columns, numbers = self.free_columns
        y[..., columns], y[..., slide_columns] = D[..., dofs], slides[..., numbers]
        return y

    def free_slides(self, y: np.ndarray, joints: int) -> np.ndarray:
        """Increments of the slides (..., joints) from the unknowns (..., free)."""
        slides = np.zeros((*y.shape[:-1], joints))
        _, _, columns, numbers = self.free_columns
        slides[..., numbers] = y[..., columns]
        return slides


def joints_with_arms(couplings: Couplings, scene: Scene) -> list[Joint]:
    """Joints of a scene with an arm or a slide, in the order of `Couplings.arm_joints`."""
    joints = joints_by_number(scene)
    return [joints[joint.number] for joint in couplings.arm_joints]


def couple(scene: Scene, mesh: Mesh, released: bool = False) -> Couplings:
    """Couplings of a scene; SceneError for joints that over-constrain, with their names.

    If they are `released`, driven columns are free.
    """
    forests, closing = grown_forests(scene)
    columns = _Columns(scene, mesh, forests, released)
    arm_joints = [b.joint for b in forests[0] if not b.joint.is_selection]
    arm_joints += [joint for joint in closing[0] if not joint.is_selection]
    # Auxiliaries depend on no columns of nodes that slide.
    whole = {joint.b.number for joint in sliding_joints(scene.joints)}
    sums = _Sums(columns, forests, arm_joints, whole)
    column = columns.root.astype(np.int32).ravel()
    summed = {}
    for key, entries in sums.entries.items():
        if key[0] < 0:
            continue
        dof = 3 * key[0] + key[1]
        if len(entries) == 1 and entries[0][1:] == (0, 1.0):
            column[dof] = entries[0][0]
        else:
            column[dof], summed[dof] = -1, entries
    gears = [gear for gear in scene.gears if gear.is_ideal]
    closures = [sums.closure(joint, i) for i in range(3) for joint in closing[i]]
    closures += [sums.gear(gear, 2 * g) for g, gear in enumerate(gears)]
    for closure in closures:
        _check_closure(scene, closure, forests, columns)
    sign = np.zeros((3, scene.joint_count))
    for i, branch in ((i, branch) for i, forest in enumerate(forests) for branch in forest):
        sign[i, branch.joint.number] = branch.sign
    couplings = Couplings(
        free=columns.free,
        driven=columns.driven,
        released=columns.released,
        columns=columns.count,
        column=column,
        sums=summed,
        slides=columns.slides,
        arm_joints=arm_joints,
        sign=sign,
        auxiliaries=sums.auxiliaries,
        forests=forests,
        sliding=sliding_joints(scene.joints),
        carried=columns.carried,
        closures=closures,
        gears=gears,
        missing=missing_joints(scene),
        all_entries=_all_entries(column, summed),
        free_columns=_free_columns(column, columns),
        system=_system(columns, len(sums.auxiliaries), len(closures)),
    )
    if couplings.sliding:
        return replace(couplings, sliding=_sliding_in_order(scene, mesh, couplings))
    return couplings


def _check_closure(
    scene: Scene, closure: Closure, forests: list[list[TreeNode]], columns: _Columns
) -> None:
    """Refuse a closure that no column moves, or of rotations with a motor, which has no entry."""
    joint, i = closure.joint, closure.component
    held = range(columns.free, columns.count - sum(map(len, columns.carried.values())))
    is_driven = i == 2 and getattr(joint, "rotation", None) is not None
    if not is_driven and any(column not in held for column, _, _ in closure.entries):
        return
    if not isinstance(joint, Joint):
        raise SceneError(
            f"over-constrained: {joint}: both of its joints are held. Remove it, or a support "
            "or motor of one of them"
        )
    (joints, roots), kind = loop_through(forests[i], joint), _COMPONENTS[i]
    reason = f"they close a loop in which each joint couples the {kind}"
    if roots:
        a, b = (GROUND if node == GROUND.number else scene.nodes[node] for node in roots)
        reason = f"the {kind} of {a} and of {b} are both supported; support one of them only"
    raise SceneError(
        f"over-constrained: {'; '.join(map(str, joints))}: {reason}. Remove one of them, or "
        "release a degree of freedom by a slide, a free rotation, or a beam between the nodes"
    )


def _all_entries(column: np.ndarray, sums: dict[int, list[Entry]]) -> Entries:
    """`Couplings.all_entries` of columns (size,) and sums."""
    alone, summed = np.flatnonzero(column >= 0), Entries.of(sums.items())
    entries = Entries(
        np.append(alone.astype(np.int32), summed.row),
        np.append(column[alone], summed.column),
        np.append(np.zeros(len(alone), np.int32), summed.value_at),
        np.append(np.ones(len(alone)), summed.sign),
    )
    return entries.take(np.argsort(entries.row, kind="stable"))


def _free_columns(
    column: np.ndarray, columns: _Columns
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """`Couplings.free_columns` of columns (size,)."""
    dofs = np.flatnonzero((column >= 0) & (column < columns.free)).astype(np.int32)[::-1]
    # Of equal degrees of freedom the last has the column.
    dofs = dofs[np.unique(column[dofs], return_index=True)[1]]
    slides = np.array([pair for pair in columns.slides.items() if pair[1] < columns.free], int)
    number, slide_columns = slides.reshape(-1, 2).T
    return column[dofs], dofs, slide_columns, number


def _system(columns: _Columns, auxiliaries: int, closures: int) -> tuple[np.ndarray, np.ndarray]:
    """`Couplings.system` for so many auxiliary unknowns and closures."""
    unknowns, free = np.full(columns.count + auxiliaries, -1, np.int32), columns.free
    unknowns[:free] = np.arange(free)
    unknowns[columns.count :] = free + 2 * np.arange(auxiliaries)
    carried = sum(map(len, columns.carried.values()))
    first_carried = free + 2 * auxiliaries + closures
    unknowns[columns.count - carried : columns.count] = first_carried + np.arange(carried)
    rows = unknowns.copy()
    rows[columns.count :] += 1
    return rows, unknowns


def _sliding_in_order(scene: Scene, mesh: Mesh, couplings: Couplings) -> list[SlidingJoint]:
    """Sliding joints in order: a beam depends on earlier sliding nodes only."""
    owner = {c: number for number, columns in couplings.carried.items() for c in columns}
    joints = {joint.number: joint for joint in couplings.sliding}

    def owners(beam: Beam) -> set[int]:
        dofs = mesh.dofs[mesh.nodes_of(scene, beam)].ravel().tolist()
        return {owner[c] for dof in dofs for c, _, _ in couplings.entries(dof) if c in owner}

    beams_by_id = {id(joint.beam): joint.beam for joint in joints.values()}
    needed = {key: owners(beam) for key, beam in beams_by_id.items()}
    needs = {number: needed[id(joint.beam)] for number, joint in joints.items()}
    try:
        return [joints[number] for number in TopologicalSorter(needs).static_order()]
    except CycleError as error:
        names = "; ".join(str(joints[number]) for number in sorted({*error.args[1]}))
        raise SceneError(
            f"{names}: each node slides on a beam that the other nodes carry, as in a telescope. "
            "This is not possible: remove one of them"
        ) from None


class _Sums:
    """The sums of entries that the nodes of trees are, and the auxiliaries that keep them short."""

    def __init__(
        self,
        columns: _Columns,
        forests: list[list[TreeNode]],
        arm_joints: list[Joint],
        whole: set[int],
    ):
        self._columns = columns
        self._number = {joint.number: m for m, joint in enumerate(arm_joints)}
        ground = [(columns.number[_GROUND], 0, 1.0)] if _GROUND in columns.number else []
        #: Entries of the nodes that follow through a joint, by node and component.
        self.entries: dict[tuple[int, int], list[Entry]]
        self.entries = {(GROUND.number, i): ground for i in range(3)}
        self.auxiliaries: list[Auxiliary] = []
        whole = _connected(forests, whole)
        for i in (2, 0, 1):
            auxiliary = self._in_long_trees(forests[i], i) - whole
            for branch in forests[i]:
                entries = self._at(branch.parent, i) + self._of_joint(branch.joint, i, branch.sign)
                if branch.node in auxiliary and len(entries) > _REACH:
                    self.auxiliaries.append(Auxiliary(3 * branch.node + i, entries))
                    entries = [(columns.count + len(self.auxiliaries) - 1, 0, 1.0)]
                self.entries[branch.node, i] = entries

    def _at(self, node: int, component: int) -> list[Entry]:
        root = int(self._columns.root[node, component]) if node >= 0 else -1
        return self.entries[node, component] if root < 0 else [(root, 0, 1.0)]

    def _of_joint(self, joint: Joint, i: int, side: float) -> list[Entry]:
        """Entries that a joint adds: of a motor's rotation, or of the arm between its nodes."""
        if i == 2:
            driven = joint.rotation is not None
            return [(self._columns.number["motor", joint.number], 0, side)] if driven else []
        if joint.number not in self._number:
            return []
        first = 1 + 4 * self._number[joint.number] + i
        turn = self._at(joint.a.number, 2)
        entries = [(column, first, sign * side) for column, _, sign in turn]
        if joint.slide is not None:
            entries.append((self._columns.slides[joint.number], first + 2, side))
        return entries

    def _in_long_trees(self, forest: list[TreeNode], i: int) -> set[int]:
        """Nodes of trees in which a sum has many entries without auxiliary unknowns."""
        entries, roots = dict[int, int](), dict[int, int]()
        most = dict[int, int]()
        for branch in forest:
            node, parent = branch.node, branch.parent
            # What hangs on the ground are trees of their own.
            roots[node] = root = roots.get(parent, node if parent == GROUND.number else parent)
            added = len(self._of_joint(branch.joint, i, 1.0))
            entries[node] = entries.get(parent, 1) + added
            most[root] = max(most.get(root, 0), entries[node])
        return {node for node, root in roots.items() if most[root] > _LONG}

    def closure(self, joint: Joint, i: int) -> Closure:
        """The equation by which a joint closes a loop in a component."""
        a, b = (self._at(node.number, i) for node in (joint.a, joint.b))
        return Closure(joint, i, _difference([*b, *self._of_joint(joint, i, -1.0)], a))

    def gear(self, gear: Gear, number: int) -> Closure:
        """The equation of a gear, whose first term has a number."""
        entries, first = list[Entry](), 1 + 4 * len(self._number) + number
        for value, (joint, name, _) in enumerate(gear.terms, start=first):
            if name == "slide":
                entries.append((self._columns.slides[joint.number], value, 1.0))
                continue
            turns = _difference(*(self._at(node.number, 2) for node in (joint.b, joint.a)))
            entries += [(column, value, sign) for column, _, sign in turns]
        return Closure(gear, gear.column, entries)


def _difference(b: list[Entry], a: list[Entry]) -> list[Entry]:
    """Entries of a sum less those of another one."""
    total: dict[tuple[int, int], float] = {}
    for side, entries in ((1.0, b), (-1.0, a)):
        for *key, sign in entries:
            total[key[0], key[1]] = total.get((key[0], key[1]), 0.0) + side * sign
    return [(*key, sign) for key, sign in total.items() if sign]


def _connected(forests: list[list[TreeNode]], nodes: set[int]) -> set[int]:
    """Nodes of all trees that contain one of some nodes; the ground connects nothing."""
    pairs = [(b.node, b.parent) for forest in forests for b in forest if b.parent >= 0]
    if not nodes or not pairs:
        return set()
    size = 1 + max(map(max, pairs))
    tree = connected_parts(np.transpose(pairs), size)
    connected = np.isin(tree, tree[[node for node in nodes if 0 <= node < size]])
    return set(np.flatnonzero(connected).tolist())


class _Columns:
    """Numbers of the columns: free, driven, fixed."""

    def __init__(self, scene: Scene, mesh: Mesh, forests: list[list[TreeNode]], released: bool):
        follow = {(branch.node, i) for i, forest in enumerate(forests) for branch in forest}
        supported = [*scene.prescribed, *sorted(scene.fixed)]
        sliding = sliding_joints(scene.joints)
        carried = [key for joint in sliding for key in joint.carried]
        free_root = np.ones((len(mesh.X), 3), dtype=bool)
        for node, component in (*follow, *supported, *(key[1:] for key in carried)):
            free_root[node, component] = False
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
        self.number: dict[tuple, int] = {key: k for k, key in enumerate(keys, start=alone)}
        #: Column (nodes, 3) of each component of a node that follows no joint; -1 for the others.
        self.root = np.full(free_root.shape, -1)
        self.root[free_root] = np.arange(alone)
        for key in supported:
            if key not in follow:
                self.root[key] = self.number[key]
        for sliding_key in carried:
            self.root[sliding_key[1:]] = self.number[sliding_key]
        self.released = len(driven) if released else 0
        self.driven = len(driven) - self.released
        self.free, self.count = alone + len(free) + self.released, alone + len(keys)
        #: Columns of the nodes that slide, by the number of the joint.
        self.carried = {j.number: [self.number[key] for key in j.carried] for j in sliding}
        self.slides = {n: self.number["motor" if n in moved else "slide", n] for n in slides}


def motors(scene: Scene) -> list[tuple[Joint, str]]:
    """Joints with a motor, each with the name of its coordinate: "slide" or "rotation"."""
    moved = []
    for joint in scene.joints:
        if len(joint.driven) == 2:
            raise SceneError(f"{joint}: it has two motors. Move one of them to another joint")
        moved += [(joint, name) for name in joint.driven]
    return moved


# With the displacements u of auxiliary unknowns, u = B y + N u in small changes of the columns y,
# and the forces h that what follows them exerts on them, the reduced tangent A of y and u becomes
#
#     [A_yy  A_yu  -Bv^T ] [dy]   [R]
#     [A_uy  A_uu  1-Nv^T] [du] = [0]
#     [-B    1-N   0     ] [-h]   [0]
#
# with Bv and Nv for virtual displacements. There are few entries in each row, where the tangent of
# y alone is full.


class Auxiliaries:
    """The auxiliary unknowns of a scene, in the order of `Couplings.auxiliaries`."""

    def __init__(self, couplings: Couplings):
        auxiliaries, row_of, unknown_of = couplings.auxiliaries, *couplings.system
        self._count = len(auxiliaries)
        self._shape = self._count, couplings.columns + self._count
        self._entries = entries = Entries.of(enumerate(a.entries for a in auxiliaries))
        moving = entries.take(unknown_of[entries.column] >= 0)
        numbers = unknown_of[couplings.columns :]
        auxiliary, needed = numbers[moving.row], unknown_of[moving.column]
        rows = np.concatenate([auxiliary, row_of[moving.column], numbers, numbers + 1])
        columns = np.concatenate([needed, auxiliary + 1, numbers, numbers + 1])
        #: What auxiliary unknowns add to the linear system: equations, forces, diagonals.
        self.system_entries = SystemEntries(
            rows, columns, moving._replace(sign=-moving.sign).factors
        )
        #: Unknowns (2, m) in the linear system: the auxiliary, and the one on which it depends;
        #: None without any.
        self.dependent: np.ndarray | None = None
        if self._count:
            self.dependent = np.array([np.append(auxiliary, auxiliary + 1), np.tile(needed, 2)])

    def __len__(self):
        return self._count

    def entries_of(self, chosen: csr_matrix) -> list[np.ndarray]:
        """Numbers of the entries of auxiliaries that each row has, the latest first."""
        starts = self._entries.starts(self._count).tolist()
        return [
            np.array([k for row in rows[::-1] for k in range(*starts[row : row + 2])], dtype=int)
            for rows in np.split(chosen.indices, chosen.indptr[1:-1])
        ]

    def equations(self, values: np.ndarray) -> csr_matrix:
        """Rows (auxiliaries, columns) whose products with all columns are zero, by values of T."""
        auxiliaries = scipy.sparse.eye(*self._shape, k=self._shape[1] - self._count)
        return (self._entries.matrix(values, self._shape) - auxiliaries).tocsr()

    def members(self) -> dict[str, object]:
        """The sums as ``Auxiliary`` of tables.h."""
        owners, arms = self._entries.arms
        return {
            "count": self._count,
            "entries": len(self._entries.row),
            "of": self._entries.row,
            **self._entries.members(),
            "arms": len(arms),
            "arm_of": owners,
            "arm": arms,
        }
