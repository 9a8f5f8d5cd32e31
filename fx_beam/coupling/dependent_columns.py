"""Columns that follow others: of nodes that slide on beams, and of closed loops of joints."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from fx_beam.content_cache import cached_property
from fx_beam.fem.mesh import Mesh, Pattern, positions_in, sparsity, starts_of
from fx_beam.scene.joints import Joint
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import SlidingJoint

from .graph import Auxiliaries, Closure, Couplings, Entries, SystemEntries

# -- Degrees of freedom x = A z as linear functions of columns z, with equations C z = 0 --------


# A sum is zero but for rounding errors at this part of the sizes of its terms.
_CANCELLED = 1e-12


class ColumnMap:
    """x = A z, where the equations C z = 0 give the `dependent` columns.

    `weights` are the entries of A: rows, columns and values. C is an array, or in compressed rows.
    Where it is `nested`, an equation has -1 for its own dependent column, and others of those
    before it. Dependent columns are not finite if C z = 0 does not determine them.
    """

    def __init__(
        self,
        weights: tuple[np.ndarray, np.ndarray, np.ndarray],
        shape: tuple[int, int],
        C: csr_matrix | np.ndarray,
        dependent: np.ndarray,
        nested: bool = False,
    ):
        self._weights, self.shape, self._dependent = weights, shape, dependent
        #: C without the dependent columns.
        self._C: Any = None
        #: What dependent columns have of those before them, if C is sparse and nested.
        self._nested: Any = None
        if not len(dependent):
            return
        independent = np.ones(shape[1])
        independent[dependent] = 0.0
        try:
            if isinstance(C, np.ndarray):
                inverse = np.linalg.inv(C[:, dependent])
                self._solve = lambda x, side="N": (inverse if side == "N" else inverse.T) @ x
                self._C = C * independent
            else:
                self._solve = splu(C[:, dependent].tocsc()).solve
                if nested:
                    self._nested = C[:, dependent] + scipy.sparse.identity(len(dependent))
                self._C = C @ scipy.sparse.diags(independent)
        except (np.linalg.LinAlgError, RuntimeError):  # it is singular
            self._C = np.full(C.shape, np.nan)
            self._solve = lambda x, side="N": np.full_like(x, np.nan)

    def with_dependent(self, z: np.ndarray) -> np.ndarray:
        """z (columns,) with its dependent entries computed from the others."""
        if len(self._dependent):
            z = z.copy()
            z[self._dependent] = -self._solve(self._C @ z)
        return z

    def __matmul__(self, z: np.ndarray) -> np.ndarray:
        """x = A z, for the independent entries of z."""
        row, column, values = self._weights
        return np.bincount(row, values * self.with_dependent(z)[column], self.shape[0])

    def transposed(self, r: np.ndarray, column_forces: np.ndarray) -> np.ndarray:
        """A^T r + `column_forces`; those on dependent columns are passed on to the others."""
        row, column, values = self._weights
        out = np.bincount(column, values * r[row], self.shape[1]) + column_forces
        if len(self._dependent):
            out -= self._C.T @ self._solve(out[self._dependent], "T")
            out[self._dependent] = 0.0
        return out

    @cached_property
    def dependence_matrix(self) -> csr_matrix:
        """Matrix (columns, columns) of `with_dependent`."""
        independent = np.setdiff1d(np.arange(self.shape[1]), self._dependent)
        entries = np.ones(len(independent)), (independent, independent)
        if self._nested is not None:
            ratios = nested_solution(self._nested, self._C).tocoo()
            places = self._dependent[ratios.row], ratios.col
            matrix = csr_matrix((ratios.data, places), (self.shape[1],) * 2)
            return matrix + csr_matrix(entries, matrix.shape)
        if len(self._dependent):
            # Of the independent columns few are in long loops.
            used = np.flatnonzero(abs(self._C).sum(axis=0))
            C = self._C[:, used]
            ratios = -self._solve(C if isinstance(C, np.ndarray) else C.toarray())
            k, column = np.nonzero(ratios)
            places = (
                np.append(independent, self._dependent[k]),
                np.append(independent, used[column]),
            )
            entries = np.append(entries[0], ratios[k, column]), places
        return csr_matrix(entries, (self.shape[1],) * 2)

    @cached_property
    def matrix(self) -> csr_matrix:
        """The matrix from z to x."""
        row, column, values = self._weights
        A = csr_matrix((values, (row, column)), self.shape)
        return A @ self.dependence_matrix if len(self._dependent) else A

    @property
    def array(self) -> np.ndarray:
        """Array (rows, columns) of the matrix, for a small scene, which takes far less time."""
        if len(self._dependent):
            return self.matrix.toarray()
        row, column, values = self._weights
        places = row * self.shape[1] + column
        return np.bincount(places, values, math.prod(self.shape)).reshape(self.shape)


def nested_solution(N: csr_matrix, b: csr_matrix) -> csr_matrix:
    """x (n, m) = N x + b, where N (n, n) is triangular in some order, with zero diagonal."""
    x = term = b
    N.eliminate_zeros()
    while term.nnz:
        term = N @ term
        term.eliminate_zeros()
        x = x + term
    return x


def without_dependent(
    weights: csr_matrix, C: csr_matrix, dependent: np.ndarray
) -> tuple[csr_matrix, csr_matrix]:
    """B (n, columns) of independent columns, and Y (n, dependent), with W z = B z + Y C z.

    An equation has dependent columns of those before it only. What cancels is no entry: the
    difference of two nodes far down in a tree has entries of the way between them.
    """
    number = np.full(C.shape[1], -1)
    number[dependent] = np.arange(len(dependent))
    number_of, equations = number.tolist(), [dict(equation) for equation in _rows(C)]
    pivots = [equation.pop(k) for equation, k in zip(equations, dependent.tolist(), strict=True)]
    left, multipliers = list[dict[int, float]](), list[dict[int, float]]()
    for terms in _rows(weights):
        value, size, used = dict[int, float](), dict[int, float](), dict[int, float]()
        waiting = list[tuple[int, int]]()  # the last one is the next
        while True:
            for column, x in terms:
                if column not in value and number_of[column] >= 0:
                    heapq.heappush(waiting, (-number_of[column], column))
                value[column] = value.get(column, 0.0) + x
                size[column] = size.get(column, 0.0) + abs(x)
            if not waiting:
                break
            (k, column), terms = heapq.heappop(waiting), []
            if abs(x := value.pop(column)) > _CANCELLED * size[column]:
                used[-k] = y = x / pivots[-k]
                terms = [(other, -y * part) for other, part in equations[-k].items()]
        left.append({k: x for k, x in value.items() if abs(x) > _CANCELLED * size[k]})
        multipliers.append(used)
    return _matrix(left, C.shape[1]), _matrix(multipliers, len(dependent))


def _rows(matrix: csr_matrix) -> Iterator[list[tuple[int, float]]]:
    """Columns and values of each row."""
    entries = [*zip(matrix.indices.tolist(), matrix.data.tolist(), strict=True)]
    return (entries[begin:end] for begin, end in pairwise(matrix.indptr.tolist()))


def _matrix(rows: list[dict[int, float]], columns: int) -> csr_matrix:
    indices, values = ([x for row in rows for x in part(row)] for part in (dict.keys, dict.values))
    shape = len(rows), columns
    matrix = csr_matrix((values, indices, starts_of([*map(len, rows)])), shape)
    matrix.sort_indices()
    return matrix


# -- Nodes that slide on flexible beams: their columns depend on the others ---------------------
# Node c at the arc length s: phi_c = sum N_a phi_a. With bars for means of both ends of the step
# and D for increments,
#
#     virtual phi_c = sum Nbar_a virtual phi_a + z virtual alpha
#                     + virtual s (sum (DN_a/Ds) phibar_a - z Dalpha/Ds)
#     z = W/4 sum DN_a Dphi_a,    virtual alpha = W rbar . (virtual r) / |rbar|^2
#
# where r is the chord of the element in which the step begins. It gives the step's own increment
# Dphi_c, a translation for a translation, and a rotation for a rotation. A sleeve also turns with
# the beam, psi_c = sum N_a Psi_a with Psi_a = psi_a + the reference angle. With x_a = Dpsi_a/2, y
# = sum Nbar_a x_a, y_c = Dpsi_c/2 and k(x) = x / sin x,
#
#     virtual psi_c = sum B_a virtual psi_a + virtual s q sin(y_c - y) / ((y_c - y) cos y_c cos y)
#     B_a = Nbar_a k(x_a - y) cos x_a / sum of the same,    q = sum (DN_a/Ds) Psibar_a
#
# which gives Dtheta_c = 2 tan(Dpsi_c/2) for the nodal Dtheta_a = 2 tan(Dpsi_a/2). Schemes with
# another level have the derivatives at both ends, weighted as their forces are. The columns
# border a tangent without them (c/bordering_rows.h).


# A node at rest on the end of a beam may be beyond it, by this part of the length.
_BEYOND = 1e-9


class Bordered(NamedTuple):
    """A tangent before the elimination, as one of the unknowns and what borders it."""

    #: Sparsity of the unknowns.
    pattern: Pattern
    #: Entries before the elimination that belong to the unknowns, and their positions.
    inside: np.ndarray
    positions: np.ndarray
    #: Positions of the diagonals of slides, which are 1.
    ones: np.ndarray
    #: The other entries, and the columns of the scene that are their rows and columns.
    border_entries: np.ndarray
    rows: np.ndarray
    columns: np.ndarray


class Guide:
    """A beam on which nodes slide: its dofs (nodes, 3), and members of ``Slider`` of c/slider.h."""

    def __init__(self, joint: SlidingJoint, couplings: Couplings, dofs: np.ndarray):
        self.path = path = joint.path
        self.dofs = dofs
        #: Entries of the degrees of freedom.
        self.parts = Entries.of((k, couplings.entries(dof)) for k, dof in enumerate(dofs.ravel()))
        #: Columns on which the beam depends.
        self.columns = np.unique(self.parts.column)
        self._column_set = frozenset(self.columns.tolist())
        self.members: dict[str, Any] = {
            "degree": path.degree,
            "elements": len(path.h),
            "most": path.most,
            "width": path.width,
            "ends": path.s,
            "coefficients": path.coefficients,
            # Only differences count, which have few digits far from the origin.
            "position": path.X - path.X[0],
            "angle": path.angles,
            "dofs": dofs.astype(np.int32),
            "part_start": self.parts.starts(dofs.size).astype(np.int32),
            "part_column": self.parts.column.astype(np.int32),
            "part_value": self.parts.value_at.astype(np.int32),
            "part_sign": self.parts.sign,
        }

    def depends_on(self, columns: set[int]) -> bool:
        """Whether the beam depends on one of some columns."""
        return not columns.isdisjoint(self._column_set)


class Slide:
    """One sliding node: the beam on which it slides, and its columns."""

    def __init__(self, joint: SlidingJoint, guide: Guide, couplings: Couplings, mesh: Mesh):
        self.joint, self.guide, self.path = joint, guide, joint.path
        #: Whether the next one needs the motion of all nodes with this one and those before.
        self.carries = True
        self.columns = np.array(couplings.carried[joint.number])
        self.column = couplings.slides[joint.number]
        #: Degrees of freedom of the beam (nodes, 3) and of the node (3,).
        self.dofs, self.node_dofs = guide.dofs, mesh.dofs[joint.b.number]
        #: Entries in the columns of the node.
        all_entries = couplings.all_entries
        entry_numbers = [np.flatnonzero(all_entries.column == column) for column in self.columns]
        self._entries = all_entries.take(np.concatenate(entry_numbers))
        self._entry_start = starts_of([*map(len, entry_numbers)])

    def members(self) -> dict[str, Any]:
        """As ``Slider`` of c/slider.h."""
        return self.guide.members | {
            "joint": self.joint.number,
            "carries": self.carries,
            "column": self.column,
            "components": len(self.columns),
            "carried": self.columns,
            "node": self.node_dofs,
            "entry_start": self._entry_start,
            "entry_row": self._entries.row,
            "entry_value": self._entries.value_at,
            "entry_sign": self._entries.sign,
        }


class SlideEquations:
    """Rows C (columns of nodes on beams, columns) with C z = 0, of all nodes that slide."""

    def __init__(self, slides: Sequence[Slide], guides: Sequence[Guide]):
        counts = np.array([len(slide.columns) for slide in slides])
        # For each row the number of its slide, its component, and the number of components.
        self._slide = np.repeat(np.arange(len(slides)), counts)
        self._component = np.concatenate([*map(np.arange, counts)])
        self._components = counts[self._slide]
        self._slide_column = np.array([slide.column for slide in slides])[self._slide]
        #: The columns that the rows give.
        self.columns = np.concatenate([slide.columns for slide in slides])
        # Nodes in a window of the beam, and its first degree of freedom among all of `_parts`.
        self._width = np.array([slide.path.width for slide in slides])[self._slide]
        starts = starts_of([guide.dofs.size for guide in guides]).tolist()
        start_of = {id(guide): start for guide, start in zip(guides, starts, strict=False)}
        self._start = np.array([start_of[id(slide.guide)] for slide in slides])[self._slide]
        parts = [g.parts._replace(row=g.parts.row + start_of[id(g)]) for g in guides]
        self._parts = Entries(*map(np.concatenate, zip(*parts, strict=True)))

    def entries(
        self, relations: np.ndarray, first: np.ndarray, values: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows, columns and values of the entries, by values of T or Tv.

        `relations` (slides, 3, ...): derivatives of each node by a window of its beam, which begins
        with node `first`, and by its slide (c/slider.h).
        """
        begin = self._start + 3 * first[self._slide]
        low, high = np.searchsorted(self._parts.row, (begin, begin + 3 * self._width))
        counts, every = high - low, np.arange(len(begin))
        row = np.repeat(every, counts)
        entry = np.arange(len(row)) + np.repeat(low - starts_of(counts)[:-1], counts)
        dof, column, weights = (part[entry] for part in self._parts.weights(values))
        node, component = np.divmod(dof - begin[row], 3)
        slopes = relations[self._slide, self._component]
        # A node that turns by itself does not depend on rotations of the beam.
        depends, place = component < self._components[row], component * self._width[row] + node
        weights *= np.where(depends, slopes[row, place], 0.0)
        return (
            np.concatenate([row, every, every]),
            np.concatenate([column, self._slide_column, self.columns]),
            np.concatenate([weights, slopes[:, -1], np.full(len(every), -1.0)]),
        )


class Sliders:
    """All sliding nodes of a scene, in the order of `Couplings.sliding`."""

    def __init__(self, scene: Scene, couplings: Couplings, mesh: Mesh):
        self._couplings, self.scene_size = couplings, mesh.size
        guides: dict[int, Guide] = {}
        for joint in couplings.sliding:
            if id(joint.beam) not in guides:
                dofs = mesh.dofs[mesh.nodes_of(scene, joint.beam)]
                guides[id(joint.beam)] = Guide(joint, couplings, dofs)
        #: Beams on which nodes slide, in the order of their first ones.
        self.guides = [*guides.values()]
        joints = ((joint, guides[id(joint.beam)]) for joint in couplings.sliding)
        self.all = [Slide(joint, guide, couplings, mesh) for joint, guide in joints]
        moved: set[int] = set()
        for last, slide in zip(self.all, self.all[1:], strict=False):
            moved.update(last.columns.tolist())
            last.carries = bool(couplings.auxiliaries) or slide.guide.depends_on(moved)
            if last.carries:
                moved.clear()
        self._unknowns = couplings.unknown_count
        self._size = self._unknowns + couplings.columns - couplings.independent
        slides = np.array([slide.column for slide in self.all], dtype=int)
        sliding = np.arange(couplings.independent, couplings.columns)
        #: Columns of the scene that border the others: free slides and all sliding columns.
        self.outside = np.concatenate([slides[slides < couplings.free], sliding])

    @cached_property
    def equations(self) -> SlideEquations:
        """Equations of the columns of all nodes."""
        return SlideEquations(self.all, self.guides)

    def set_tangent(self, rows: np.ndarray, columns: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Set the entries of the tangent before the elimination; returns their positions."""
        #: Forces that close loops and border the other unknowns as well.
        self.forces = forces
        self._keys, position = np.unique(
            rows.astype(int) * self._size + columns, return_inverse=True
        )
        #: Number of entries before the elimination.
        self.entries_before = len(self._keys)
        #: The tangent of the compiled loop, in which what slides borders the other unknowns.
        self.bordered = self._bordered()
        return position

    def _bordered(self) -> Bordered:
        n, rows, columns = self._unknowns, *np.divmod(self._keys, self._size)
        slides = np.append(self.outside[self.outside < self._couplings.free], self.forces)
        borders = np.zeros(self._size, dtype=bool)
        borders[n:] = borders[slides] = True
        is_bordering = borders[rows] | borders[columns]
        inner, border = np.flatnonzero(~is_bordering), np.flatnonzero(is_bordering)
        # What slides is an unknown of the other equations that is zero there.
        all_rows, all_columns = (np.append(part[inner], slides) for part in (rows, columns))
        pattern, position = sparsity(all_rows, all_columns, n)
        positions, diagonal = np.split(position, [len(inner)])
        column_of = np.empty(self._size, dtype=int)
        column_of[self.forces] = len(self._couplings.system[0]) + np.arange(len(self.forces))
        for index in self._couplings.system:
            column_of[index[index >= 0]] = np.flatnonzero(index >= 0)
        border_columns = column_of[rows[border]], column_of[columns[border]]
        return Bordered(pattern, inner, positions, diagonal, border, *border_columns)

    def diagonals(self, slide: Slide) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns (nodes, 3) that degrees of freedom of a beam equal, or -1.

        Also the diagonals (nodes, 3) of their columns among the entries before the elimination.
        """
        column, (row_of, unknown_of) = self._couplings.column[slide.dofs], self._couplings.system
        index = np.where(column >= 0, unknown_of[column], -1)
        position = np.searchsorted(self._keys, row_of[column].astype(int) * self._size + index)
        alone = (index >= 0) & (column < self._couplings.free)
        return np.where(alone, column, -1), np.where(index >= 0, position, -1)

    def reach(self, slides: np.ndarray, z: np.ndarray) -> float:
        """How often columns z can be added to a state before a node slides off its element."""
        ways = [np.inf]
        for slide in self.all:
            if z[slide.column]:
                gaps = abs(slide.path.s[1:-1] - slides[slide.joint.number])
                ways.append(gaps.min(initial=np.inf) / abs(z[slide.column]))
        return min(ways)

    def fault(self, arcs: Sequence[tuple[float, float]]) -> tuple[str, str] | None:
        """Kind and reason of a step that leaves a beam, or passes too many elements; or None.

        `arcs` are the arc lengths of all nodes at both ends of the step.
        """
        for slide, (start, end) in zip(self.all, arcs, strict=True):
            path, joint = slide.path, slide.joint
            off, which = (-end, "start") if end < 0 else (end - path.length, "end")
            if off > _BEYOND * path.length:
                reason = f"{joint}: the node runs off the {which} of the beam, by {off:.3g}"
                return "off the end", reason
            if abs(path.element(end) - path.element(start)) > path.most:
                reason = f"the node passes more than {path.most} ends of elements in one step"
                return "large slide", f"{joint}: {reason}"
        return None


# -- Closed loops of joints, without multipliers: some unknowns follow the others ---------------
# The trees of joints leave the columns z; a joint that closes a loop gives equations closure(z) =
# 0. Some unknowns, d, follow all others, i, by Newton's method on these equations. The forces of
# the closing joints on b are such that d has no residual R_d. With G the derivative of the
# closures, and Gv that of virtual displacements, so that Gv times the work increments of a step
# is its closure:
#
#     F = Gv_d^-T R_d,    0 = R_i - Gv_i^T F,    z_d = -G_d^-1 G_i z_i   (in small changes)
#
# The forces do no work and leave both momenta, since they are forces of joints like all others.
# In the linear system they are unknowns:
#
#     [A + k Gv^T G   Gv^T] [dy]   [R]
#     [G              0   ] [F ] = [0]
#
# The stiffness k does no work where G dy = 0. With it the first block is regular also if the tree
# has no inertia against a motion that the loops do not allow.


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

    def derivatives(self, values: np.ndarray) -> csr_matrix:
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
        membership = csr_matrix((np.ones(len(free)), (free, closure[free])), shape)
        left, right = (membership @ membership.T).nonzero()
        weighted = self._entries._replace(sign=self._entries.sign * self.lengths[closure] ** 2)
        return weighted.take(left), self._entries.take(right)

    def scales(self, pattern: Pattern) -> tuple[np.ndarray, np.ndarray]:
        """Diagonals of unknowns in the linear system, which give the stiffness, and units [size].

        Slides on beams, which border the system, are left out: their diagonals are 1.
        """
        inner = np.setdiff1d(np.arange(len(self.unit)), self._sliders.outside)
        return positions_in(*pattern, inner, inner), self.unit[inner] / self.size


def _most_in_band(depends: csr_matrix) -> int:
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
) -> tuple[np.ndarray, csr_matrix, np.ndarray]:
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
        weights = csr_matrix(random.uniform(1.0, 2.0, (len(slide.columns), len(guide_columns))))
        identity = scipy.sparse.identity(size, format="csr")
        rows.append(weights @ identity[guide_columns] - identity[slide.columns])
        dependent.append(slide.columns)
    return values, scipy.sparse.vstack(rows, "csr"), np.concatenate(dependent)


def blocks_of(depends: csr_matrix) -> list[tuple[np.ndarray, np.ndarray]]:
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
