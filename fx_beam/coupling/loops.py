"""Closed loops of joints, without multipliers: some unknowns follow the others.

The trees of joints leave the columns z; a joint that closes a loop gives equations closure(z) = 0.
Some unknowns, d, follow all others, i, by Newton's method on these equations. The forces of the
closing joints on b are such that d has no residual R_d. With G the derivative of the closures,
and Gv that of virtual displacements, so that Gv times the work increments of a step is its closure:

    F = Gv_d^-T R_d,    0 = R_i - Gv_i^T F,    z_d = -G_d^-1 G_i z_i   (in small changes)

The forces do no work and leave both momenta, since they are forces of joints like all others. In
the linear system they are unknowns:

    [A + k Gv^T G   Gv^T] [dy]   [R]
    [G              0   ] [F ] = [0]

The stiffness k does no work where G dy = 0. With it the first block is regular also if the tree has
no inertia against a motion that the loops do not allow.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse

from fx_beam.fem.sparsity import Pattern, positions_in, starts_of
from fx_beam.scene.joints import Joint

from .column_map import without_dependent
from .graph import Auxiliaries, Closure, Couplings, Entries, SystemEntries
from .sliders import Slide, Sliders

# Closure that is left, relative to the size of the scene.
_CLOSED = 1e-15
# Numbers of an elimination for which there is always room, for each of the closures' derivatives.
_FILL = 8


class Loops:
    """The closed loops of a scene; `turns` (free,) says which unknowns are rotations.

    Closures are in the order of blocks; a block shares unknowns, directly or through others.
    """

    def __init__(
        self, couplings: Couplings, auxiliaries: Auxiliaries, turns: np.ndarray, sliders: Sliders
    ):
        #: Size of the scene [m].
        self.size = size = sliders.scene_size
        self.unit = unit = np.where(turns, 1.0, size)
        self._couplings, self._sliders = couplings, sliders
        self._entries = Entries.of(enumerate(closure.entries for closure in couplings.closures))
        values, *dependence = _dependence(couplings, auxiliaries, sliders.all)
        shape = len(couplings.closures), dependence[0].shape[1]
        depends, passed = without_dependent(self._entries.matrix(values, shape), *dependence)
        blocks = blocks_of(depends[:, : couplings.free])
        order = np.concatenate([members for members, _ in blocks])
        self.closures = [couplings.closures[k] for k in order]
        self._entries = Entries.of(enumerate(closure.entries for closure in self.closures))
        #: In compressed rows the columns on which each closure depends.
        self._dependence = depends[order]
        #: Units (free,) by which those that follow are chosen: beams turn by about 1 over their own
        #: length, also where the scene is larger.
        self._pivot_unit = unit.copy()
        for _, columns in blocks:
            guides = [s.guide.path.length for s in sliders.all if s.column in columns]
            lengths = columns[~turns[columns]]
            self._pivot_unit[lengths] = min([size, *guides])
        self._pivot_unit[couplings.free - couplings.released :] = 0.0  # these follow none
        moved = scipy.sparse.csgraph.maximum_bipartite_matching(
            self._dependence[:, : couplings.free], perm_type="column"
        )
        #: For each closure an unknown of the linear system on which its force acts, a different
        #: one for each; -1 for none.
        self.acts_on = np.where(moved < 0, -1, couplings.system[1][moved])
        #: Entries of auxiliary unknowns of each, in the order in which they are collected.
        self._auxiliaries = auxiliaries.entries_of(passed[order, : len(auxiliaries)])
        row_of, unknown_of = couplings.system
        moving = self._entries.take(unknown_of[self._entries.column] >= 0)
        force = couplings.unknown_count - len(self) + moving.row
        rows = np.append(force, row_of[moving.column])
        columns = np.append(unknown_of[moving.column], force)
        #: What closures add to the linear system.
        self.system_entries = SystemEntries(rows, columns, moving.factors)
        column = self._entries.column
        is_carried = (column >= couplings.independent) & (column < couplings.columns)
        #: Closures with nodes on beams: their forces border the compiled loop's tangent.
        self.carried = np.unique(self._entries.row[is_carried])
        #: What makes lengths of closures: some are angles.
        self.lengths = np.array([size if k.component == 2 else 1.0 for k in self.closures])
        sizes, widths = ([len(part[i]) for part in blocks] for i in (0, 1))
        self._block_starts = starts_of(sizes), starts_of(widths)
        used = np.unique(self._dependence.indices)
        unknowns = np.concatenate([columns for _, columns in blocks])
        #: Unknowns of the loops, block by block; and with other columns on which closures depend.
        self.unknowns = unknowns.astype(int)
        self.columns = np.append(unknowns, used[used >= couplings.free]).astype(int)

    def __len__(self):
        return len(self.closures)

    @property
    def blocks(self) -> list[tuple[slice, slice]]:
        """Closures of each block, and their unknowns among `unknowns`."""
        ends = ([slice(*part) for part in zip(s, s[1:], strict=False)] for s in self._block_starts)
        return list(zip(*ends, strict=True))

    @property
    def singularity(self) -> str:
        """Reason why a position is singular, for an error."""
        names = "; ".join(dict.fromkeys(str(closure.joint) for closure in self._couplings.closures))
        return (
            f"the loops that {names} close are in a singular position, such as bars in one "
            "line, from which the motion may go on in several ways"
        )

    def derivatives(self, values: np.ndarray) -> scipy.sparse.csr_matrix:
        """Derivatives (closures, columns) of closures by columns, for the values of T or Tv."""
        columns = self._couplings.columns + len(self._couplings.auxiliaries)
        return self._entries.matrix(values, (len(self._couplings.closures), columns))

    def members(self) -> dict[str, object]:
        """``Loops`` of tables.h, without positions in the tangent."""
        couplings, arm_joints = self._couplings, self._couplings.arm_joints
        arms = {
            (joint.number, i): 2 * m + i for m, joint in enumerate(arm_joints) for i in range(2)
        }
        closed = [(closure.joint, closure.component) for closure in self.closures]
        ends = [_ends(closure) for closure in self.closures]
        column_numbers = np.empty(couplings.columns, dtype=int)
        column_numbers[self.columns] = np.arange(len(self.columns))
        arms_at_rest = [joint.arm if joint.place is None else joint.apart for joint in arm_joints]
        parts = [
            self._dependence[closures][:, self.unknowns[unknowns]]
            for closures, unknowns in self.blocks
        ]
        return {
            "closures": len(self),
            "columns": len(self.columns),
            "blocks": len(parts),
            "pivoting_size": max(_FILL * part.nnz + part.shape[1] for part in parts),
            "column": self.columns,
            "unit": self._pivot_unit[self.unknowns],
            "b": [b for _, b in ends],
            "a": [a for a, _ in ends],
            "arm": [arms.get((joint.number, i), -1) for joint, i in closed],
            "force": [3 * joint.number + i for joint, i in closed],
            "entry_start": self._entries.starts(len(self)),
            **self._entries.members("entry_"),
            "near": column_numbers[self._dependence.indices],
            "start": self._dependence.indptr,
            "auxiliary": np.concatenate(self._auxiliaries),
            "auxiliary_start": starts_of([len(part) for part in self._auxiliaries]),
            "block_closure": self._block_starts[0],
            "block_column": self._block_starts[1],
            "block_part": starts_of([_most_in_band(part) for part in parts]),
            "arm_at_rest": np.array(arms_at_rest).reshape(-1, 2),
            "length": self.lengths,
            "closed": _CLOSED * self.size,
            "carried": len(self.carried),
            "carried_closure": self.carried,
        }

    def gear_members(self) -> dict[str, object]:
        """``Gears`` of tables.h."""
        gears = self._couplings.gears
        arms = {joint.number: m for m, joint in enumerate(self._couplings.arm_joints)}
        terms = [(term.joint, term.name == "slide") for gear in gears for term in gear.terms]
        turns = [(-1, -1) if slides else (j.a.number, j.b.number) for j, slides in terms]
        closure_number = {id(closure.joint): k for k, closure in enumerate(self.closures)}
        return {
            "count": len(terms),
            "closure": [closure_number[id(gear)] for gear in gears for _ in gear.terms],
            "joint": [arms[joint.number] if slides else -1 for joint, slides in terms],
            "a": [max(-1, 3 * a + 2) for a, _ in turns],
            "b": [max(-1, 3 * b + 2) for _, b in turns],
        }

    def stiffened(self) -> tuple[Entries, Entries]:
        """Pairs of entries of a closure, which its stiffness couples."""
        closure, column = self._entries.row, self._entries.column
        free = np.flatnonzero(self._couplings.system[1][column] >= 0)
        shape = len(closure), len(self)
        membership = scipy.sparse.csr_matrix((np.ones(len(free)), (free, closure[free])), shape)
        left, right = (membership @ membership.T).nonzero()
        weighted = self._entries._replace(sign=self._entries.sign * self.lengths[closure] ** 2)
        return weighted.take(left), self._entries.take(right)

    def scales(self, pattern: Pattern) -> tuple[np.ndarray, np.ndarray]:
        """Diagonals of unknowns in the linear system, which give the stiffness, and units [size].

        Slides on beams, which border the system, are left out: their diagonals are 1.
        """
        inner = np.setdiff1d(np.arange(len(self.unit)), self._sliders.outside)
        return positions_in(*pattern, inner, inner), self.unit[inner] / self.size


def _most_in_band(depends: scipy.sparse.csr_matrix) -> int:
    """Most numbers of the factors of closures by those columns that follow, or of the transpose.

    The closures are m of n columns: of the columns before one, as many follow as there are closures
    that depend on none but these, or more, and behind it likewise.
    """
    m, n = depends.shape
    entries = depends.tocoo()
    first, last = np.full(m, n), np.full(m, -1)
    np.minimum.at(first, entries.row, entries.col)
    np.maximum.at(last, entries.row, entries.col)
    least = np.cumsum(np.bincount(last + 1, minlength=n + 1))[entries.col]
    starting_later = np.cumsum(np.bincount(first, minlength=n + 1)[::-1])[::-1][entries.col + 1]
    lower = (entries.row - least).max(initial=0)
    upper = (m - 1 - starting_later - entries.row).max(initial=0)
    return int(m * min(m, lower + upper + max(lower, upper) + 1))


def _ends(closure: Closure) -> tuple[int, int]:
    """Degrees of freedom of a and b; -1 for the ground, whose number is -1, and for gears."""
    joint, i = closure.joint, closure.component
    if not isinstance(joint, Joint):
        return -1, -1
    return max(-1, 3 * joint.a.number + i), max(-1, 3 * joint.b.number + i)


def _dependence(
    couplings: Couplings, auxiliaries: Auxiliaries, slides: list[Slide]
) -> tuple[np.ndarray, scipy.sparse.csr_matrix, np.ndarray]:
    """Random values of T, C of the equations C z = 0, and the numbers of dependent columns.

    Random values do not cancel; a node on a beam may be anywhere on it.
    """
    random = np.random.default_rng(0)
    values = random.uniform(1.0, 2.0, 1 + 4 * len(couplings.arm_joints) + 2 * len(couplings.gears))
    values[0] = 1.0
    size = couplings.columns + len(auxiliaries)
    rows, dependent = [auxiliaries.equations(values)], [np.arange(couplings.columns, size)]
    for slide in slides:
        guide_columns = np.append(slide.guide.columns, slide.column)
        weights = scipy.sparse.csr_matrix(
            random.uniform(1.0, 2.0, (len(slide.columns), len(guide_columns)))
        )
        identity = scipy.sparse.identity(size, format="csr")
        rows.append(weights @ identity[guide_columns] - identity[slide.columns])
        dependent.append(slide.columns)
    return values, scipy.sparse.vstack(rows, "csr"), np.concatenate(dependent)


def blocks_of(depends: scipy.sparse.csr_matrix) -> list[tuple[np.ndarray, np.ndarray]]:
    """Blocks (closures, unknowns) of loops that share unknowns, directly or through others.

    Closures of neighbouring loops are near to each other.
    """
    neighbours = (depends @ depends.T).tocsr()
    _, label = scipy.sparse.csgraph.connected_components(neighbours, directed=False)
    order = scipy.sparse.csgraph.reverse_cuthill_mckee(neighbours, symmetric_mode=True)
    order = order[np.argsort(label[order], kind="stable")]
    blocks = []
    for members in np.split(order, np.flatnonzero(np.diff(label[order])) + 1):
        part = depends[members].tocoo()
        columns, index = np.unique(part.col, return_inverse=True)
        place = np.bincount(index, part.row) / np.bincount(index)
        blocks.append((members, columns[np.argsort(place, kind="stable")]))
    return blocks
