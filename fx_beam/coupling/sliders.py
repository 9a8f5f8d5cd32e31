"""Nodes that slide on beams: their columns are eliminated from the equations after all others.

The columns of such a node are functions of the other columns, z_c = sum T_e z_e over the entries e
of a window of nodes around it. Here the pattern of the tangent has room for every window on the
way; in the compiled loop they border a tangent without them (bordering_rows.h).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.fem.mesh import Mesh
from fx_beam.laws.rates import UpdateRule
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import SlidingJoint

from .graph import Couplings
from .index_reduction import sparsity
from .sliding import Sliding

# A node at rest on the end of a beam may be beyond it, by this part of the length.
_BEYOND = 1e-9


class Window(NamedTuple):
    """Entries of the local degrees of freedom in a window, and their positions in the tangent."""

    #: Local degree of freedom, column, position of the value and sign of each entry (n,).
    local: np.ndarray
    column: np.ndarray
    value: np.ndarray
    sign: np.ndarray
    #: Positions of neighbours and entries (k, n), of entries and neighbours (n, k), and of entries
    #: (n, n); those that are not unknowns have the position behind the last.
    beside: np.ndarray
    above: np.ndarray
    inside: np.ndarray


class Bordered(NamedTuple):
    """A tangent before the elimination, as one of the unknowns and what borders it."""

    #: Sparsity (indptr, indices) of the unknowns; the entries before the elimination that belong
    #: to it, and their positions; those of diagonals of slides, which are 1.
    pattern: tuple[np.ndarray, np.ndarray]
    inside: np.ndarray
    positions: np.ndarray
    ones: np.ndarray
    #: The other entries, with their rows and columns as columns of the scene.
    beside: np.ndarray
    rows: np.ndarray
    columns: np.ndarray


class Slide:
    """One sliding node: its relation, the degrees of freedom of its beam, and its columns."""

    def __init__(
        self,
        joint: SlidingJoint,
        couplings: Couplings,
        rates: UpdateRule,
        mesh: Mesh,
        nodes: np.ndarray,
    ):
        self.joint, self.path = joint, joint.path
        self.columns = np.array(couplings.carried[joint.number])
        self.column = couplings.slides[joint.number]
        components = len(self.columns)
        #: Degrees of freedom (nodes, 3) of the beam.
        self.dofs = mesh.dofs[nodes]
        #: Those of the node (3,).
        self.node_dofs = mesh.dofs[joint.b.number]
        self.relation = Sliding(self.path, components, rates.level, rates.turning)
        #: Forces (components,) of the node on the beam.
        self.force = np.zeros(components)

    def local_dofs(self, first: int) -> np.ndarray:
        """Degrees of freedom of the window that begins with a node, component by component."""
        components = len(self.columns)
        return self.dofs[first : first + self.path.width, :components].T.ravel()

    @property
    def windows(self) -> range:
        """First nodes of all windows."""
        path = self.path
        return range(0, path.degree * (len(path.h) - path.window) + 1, path.degree)


class Sliders:
    """All sliding nodes of a scene, in the order of `Couplings.sliding`."""

    def __init__(self, scene: Scene, couplings: Couplings, rates: UpdateRule, mesh: Mesh):
        self._couplings = couplings
        self.all = [
            Slide(joint, couplings, rates, mesh, mesh.nodes_of(scene, joint.beam))
            for joint in couplings.sliding
        ]
        #: Index of each column among the unknowns and, behind them and the auxiliary unknowns, the
        #: sliding columns; or -1.
        free, first = couplings.free, couplings.independent
        auxiliaries = free + 2 * np.arange(len(couplings.auxiliaries))
        self._unknowns = free + 2 * len(auxiliaries)
        self.index = np.full(couplings.columns + len(auxiliaries), -1)
        self.index[:free] = np.arange(free)
        self.index[first : couplings.columns] = np.arange(couplings.columns - first)
        self.index[first : couplings.columns] += self._unknowns
        self.index[couplings.columns :] = auxiliaries
        #: The same of the rows of forces on them (auxiliaries.py).
        self.row_index = self.index.copy()
        self.row_index[couplings.columns :] += 1
        self.size = self._unknowns + couplings.columns - first
        rows, columns, value_at, signs = couplings.all_entries()
        #: Entries of the sliding columns: rows, positions of values, signs.
        self._entries = [
            [(rows[on], value_at[on], signs[on]) for on in (columns == c for c in slide.columns)]
            for slide in self.all
        ]

    # -- The pattern of the tangent -------------------------------------------------------------

    def set_tangent(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Set the entries of the tangent before the elimination; returns their positions."""
        self._given, position = np.unique(rows * self.size + columns, return_inverse=True)
        self._known: list[dict[int, Window]] = [{} for _ in self.all]
        return position

    @property
    def entries_before(self) -> int:
        """Number of entries of the tangent before the elimination."""
        return len(self._given)

    @functools.cached_property
    def pattern(self) -> tuple[np.ndarray, np.ndarray]:
        """Sparsity of the tangent after the elimination."""
        i, j = np.divmod(self._keys[self._of_unknowns], self.size)
        pattern, _ = sparsity(i, j, self._unknowns)
        return pattern

    @property
    def outside(self) -> np.ndarray:
        """Columns of the scene that border the others: free slides and all sliding columns."""
        slides = np.array([slide.column for slide in self.all])
        sliding = np.arange(self._couplings.independent, self._couplings.columns)
        return np.concatenate([slides[slides < self._couplings.free], sliding])

    @functools.cached_property
    def bordered(self) -> Bordered:
        """The tangent of the compiled loop, in which what slides borders the other unknowns."""
        n, rows, columns = self._unknowns, *np.divmod(self._given, self.size)
        slides = self.outside[self.outside < self._couplings.free]
        outside = np.zeros(self.size, dtype=bool)
        outside[n:] = outside[slides] = True
        on_bordering = outside[rows] | outside[columns]
        inside = np.flatnonzero(~on_bordering)
        # What slides is an unknown of the other equations that is zero there.
        all_rows = np.concatenate([rows[inside], slides])
        all_columns = np.concatenate([columns[inside], slides])
        pattern, position = sparsity(all_rows, all_columns, n)
        beside = np.flatnonzero(on_bordering)
        return Bordered(
            pattern=pattern,
            inside=inside,
            positions=position[: len(inside)],
            ones=position[len(inside) :],
            beside=beside,
            rows=self._column_of(rows[beside]),
            columns=self._column_of(columns[beside]),
        )

    def _column_of(self, index: np.ndarray) -> np.ndarray:
        """Columns of the scene that belong to rows or columns of the tangent."""
        free, c = self._couplings.free, self._couplings
        auxiliaries, sliding = (
            c.columns + (index - free) // 2,
            c.independent + index - self._unknowns,
        )
        return np.where(index < free, index, np.where(index < self._unknowns, auxiliaries, sliding))

    def diagonals(self, slide: Slide) -> tuple[np.ndarray, np.ndarray]:
        """Unknowns (nodes, 3) that degrees of freedom of a beam equal, or -1 for others.

        Also their diagonals among the entries before the elimination, and those of what slides.
        """
        column = self._couplings.column[slide.dofs]
        index = np.where(column >= 0, self.index[column], -1)
        position = np.searchsorted(self._given, self.row_index[column] * self.size + index)
        alone = (index >= 0) & (column < self._couplings.free)
        return np.where(alone, column, -1), np.where(index >= 0, position, -1)

    @functools.cached_property
    def _neighbours(self) -> list[np.ndarray]:
        """Indices of what the sliding columns of each node are coupled with."""
        return self._eliminated[1]

    @functools.cached_property
    def _keys(self) -> np.ndarray:
        """Sorted keys (row * size + column) of all entries that the elimination meets."""
        return self._eliminated[0]

    @functools.cached_property
    def _of_unknowns(self) -> np.ndarray:
        """The entries of the unknowns among them."""
        i, j = np.divmod(self._keys, self.size)
        return np.flatnonzero((i < self._unknowns) & (j < self._unknowns))

    @functools.cached_property
    def _given_positions(self) -> np.ndarray:
        """Positions of the entries before the elimination among them."""
        return np.asarray(np.searchsorted(self._keys, self._given))

    @functools.cached_property
    def _eliminated(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Keys and neighbours, for all windows."""
        n = self.size
        pattern = _pattern(*np.divmod(self._given, n), n)
        neighbours: list[np.ndarray] = [np.empty(0, int)] * len(self.all)
        for k, slide in reversed(list(enumerate(self.all))):
            carried = self.index[slide.columns]
            near = pattern[carried].indices, pattern.T.tocsr()[carried].indices
            neighbours[k] = around = np.setdiff1d(np.concatenate(near), carried)
            columns = [self._entries_of(slide, first)[1] for first in slide.windows]
            windows = [np.append(self.index[c], self.row_index[c]) for c in columns]
            unknowns = [np.unique(w[w >= 0]) for w in windows]
            counts = [len(w) for w in unknowns]
            each = np.repeat(np.arange(len(unknowns)), counts), np.concatenate(unknowns)
            touched = scipy.sparse.csr_matrix((np.ones(len(each[0])), each), (len(unknowns), n))
            reached = np.unique(np.concatenate([*unknowns, carried]))
            beside = np.union1d(around, carried)
            i, j = (part.ravel() for part in np.meshgrid(beside, reached, indexing="ij"))
            pattern = pattern + touched.T @ touched + _pattern(i, j, n) + _pattern(j, i, n)
            i, j = (part.ravel() for part in np.meshgrid(around, carried, indexing="ij"))
            pattern = pattern + _pattern(i, j, n) + _pattern(j, i, n)
            pattern.data[:] = 1.0
        pattern.sort_indices()
        i = np.repeat(np.arange(n), np.diff(pattern.indptr))
        return i * n + pattern.indices, neighbours

    def _entries_of(self, slide: Slide, first: int) -> tuple[np.ndarray, ...]:
        """Local degrees of freedom, columns, positions and signs of the entries of a window."""
        entries = [
            (k, *entry)
            for k, dof in enumerate(slide.local_dofs(first).tolist())
            for entry in self._couplings.entries(dof)
        ]
        entries.append((len(slide.local_dofs(first)), slide.column, 0, 1.0))
        local, column, value, sign = np.array(entries).T
        return local.astype(int), column.astype(int), value.astype(int), sign

    def entries(self, k: int) -> Sequence[tuple[np.ndarray, ...]]:
        """Rows, positions of values and signs of the entries of each sliding column of node k."""
        return self._entries[k]

    def parts(self, slide: Slide) -> tuple[np.ndarray, ...]:
        """Entries of the degrees of freedom of a beam, one after the other.

        Where those of each begin; columns, positions of values and signs.
        """
        entries = [self._couplings.entries(dof) for dof in slide.dofs.ravel().tolist()]
        column, value, sign = np.array([e for of_dof in entries for e in of_dof]).reshape(-1, 3).T
        starts = np.concatenate([[0], np.cumsum([len(of_dof) for of_dof in entries])])
        return starts, column.astype(int), value.astype(int), sign

    def _window(self, k: int, first: int) -> Window:
        """The window of node k that begins with a node of its beam."""
        if first not in self._known[k]:
            local, column, value, sign = self._entries_of(self.all[k], first)
            index, rows = self.index[column], self.row_index[column]
            around = self._neighbours[k]
            self._known[k][first] = Window(
                local,
                column,
                value,
                sign,
                beside=self._positions(around[:, None], index),
                above=self._positions(rows[:, None], around),
                inside=self._positions(rows[:, None], index),
            )
        return self._known[k][first]

    def _positions(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Positions of entries in the tangent; behind the last where there is none."""
        position = np.searchsorted(self._keys, rows * self.size + columns)
        return np.where((rows >= 0) & (columns >= 0), position, len(self._keys))

    # -- A step ---------------------------------------------------------------------------------

    def begin(self, q: np.ndarray, slides: np.ndarray) -> None:
        """Set the start of a step: displacements and rotations, and slides."""
        for slide in self.all:
            slide.relation.begin(q[slide.dofs], float(slides[slide.joint.number]))

    def fault(self, arcs: Sequence[tuple[float, float]] = ()) -> tuple[str, str] | None:
        """Kind and reason of a step that leaves a beam, or passes too many elements; or None.

        Of the last step, or of one with these arc lengths of all nodes at its ends.
        """
        for slide, ends in zip(self.all, arcs, strict=False):
            slide.relation.place(*ends)
        for slide in self.all:
            relation, joint = slide.relation, slide.joint
            off, end = relation.off_the_end()
            if off > _BEYOND * slide.path.length:
                return (
                    "off the end",
                    f"{joint}: the node runs off the {end} of the beam, by {off:.3g}",
                )
            if not relation.reaches():
                most = slide.path.most
                return (
                    "large slide",
                    f"{joint}: the node passes more than {most} ends of elements in one step",
                )
        return None

    def carry(self, r: np.ndarray, virtual_map: np.ndarray, forces: np.ndarray) -> np.ndarray:
        """Forces (size,) with those of the sliding nodes on their beams.

        `forces` (columns,) are generalised forces; those on the slides are added to them.
        """
        r = r.copy()
        for k, slide in reversed(list(enumerate(self.all))):
            relation = slide.relation
            slide.force = forces[slide.columns] + [
                (r[rows] * virtual_map[value_at]) @ signs
                for rows, value_at, signs in self._entries[k]
            ]
            *on_beam, along = slide.force @ relation.virtual_map
            np.add.at(r, slide.local_dofs(relation.nodes.start), on_beam)
            forces[slide.column] += along
        return r

    def eliminate(
        self, before: np.ndarray, values: np.ndarray, virtual_map: np.ndarray
    ) -> np.ndarray:
        """Entries of the unknowns after the elimination, from those before."""
        tangent = np.zeros(len(self._keys) + 1)
        tangent[self._given_positions] = before
        for k, slide in reversed(list(enumerate(self.all))):
            relation = slide.relation
            window = self._window(k, relation.nodes.start)
            of_T, of_virtual = (
                window.sign * values[window.value],
                window.sign * virtual_map[window.value],
            )
            T, T_virtual = (
                relation.T[:, window.local] * of_T,
                relation.virtual_map[:, window.local] * of_virtual,
            )
            carried, around = self.index[slide.columns], self._neighbours[k]
            K = tangent[self._positions(carried[:, None], carried)]
            to_left = tangent[self._positions(around[:, None], carried)]
            to_right = tangent[self._positions(carried[:, None], around)]
            second = relation.second(slide.force)[np.ix_(window.local, window.local)]
            np.add.at(tangent, window.beside, to_left @ T)
            np.add.at(tangent, window.above, T_virtual.T @ to_right)
            np.add.at(
                tangent, window.inside, T_virtual.T @ K @ T + of_virtual[:, None] * second * of_T
            )
        return tangent[self._of_unknowns]


def _pattern(rows: np.ndarray, columns: np.ndarray, n: int) -> scipy.sparse.csr_matrix:
    return scipy.sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), (n, n))
