"""Nodes that slide on beams: their columns are eliminated from the equations after all others.

The columns of such a node are functions of the other columns, z_c = sum T_e z_e over the entries e
of a window of nodes around it. The pattern of the tangent has room for every window on the way.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.fem.mesh import Mesh
from fx_beam.mechanics.rates import UpdateRule
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import SlidingJoint

from .graph import Couplings
from .sliding import Sliding

# A node at rest on the end of a beam may be beyond it, by this part of the length.
_BEYOND = 1e-9


class Window(NamedTuple):
    """Entries of the local degrees of freedom in a window, and their places in the tangent."""

    #: Local degree of freedom, column, position of the value and sign of each entry (n,).
    local: np.ndarray
    column: np.ndarray
    value: np.ndarray
    sign: np.ndarray
    #: Places of neighbours and entries (k, n), of entries and neighbours (n, k), and of entries
    #: (n, n); those that are not unknowns have the place behind the last.
    beside: np.ndarray
    above: np.ndarray
    inside: np.ndarray


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
        at_once, _ = rates.work_increment(np.array([1.0]), np.array([0]))
        self.relation = Sliding(self.path, components, rates.level, bool(at_once[0] != 1.0))
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
        #: Index of each column among the unknowns and, behind them and the ties, the sliding
        #: columns; or -1.
        free, first = couplings.free, couplings.independent
        self._unknowns = free + 2 * len(couplings.ties)
        self.index = np.full(couplings.columns, -1)
        self.index[:free] = np.arange(free)
        self.index[first:] = self._unknowns + np.arange(couplings.columns - first)
        self.size = self._unknowns + couplings.columns - first
        rows, columns, places, signs = couplings.all_entries()
        #: Entries of the sliding columns: rows, positions of values, signs.
        self._entries = [
            [(rows[on], places[on], signs[on]) for on in (columns == c for c in slide.columns)]
            for slide in self.all
        ]

    # -- The pattern of the tangent -------------------------------------------------------------

    def add_to_pattern(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Sorted keys (row * size + column) of all entries that the elimination meets."""
        n = self.size
        pattern = _pattern(rows, columns, n)
        self._neighbours: list[np.ndarray] = [np.empty(0, int)] * len(self.all)
        for k, slide in reversed(list(enumerate(self.all))):
            own = self.index[slide.columns]
            near = pattern[own].indices, pattern.T.tocsr()[own].indices
            self._neighbours[k] = around = np.setdiff1d(np.concatenate(near), own)
            windows = [self.index[self._entries_of(slide, first)[1]] for first in slide.windows]
            kept = [np.unique(w[w >= 0]) for w in windows]
            counts = [len(w) for w in kept]
            each = np.repeat(np.arange(len(kept)), counts), np.concatenate(kept)
            touched = scipy.sparse.csr_matrix((np.ones(len(each[0])), each), (len(kept), n))
            reached = np.unique(np.concatenate([*kept, own]))
            beside = np.union1d(around, own)
            i, j = (part.ravel() for part in np.meshgrid(beside, reached, indexing="ij"))
            pattern = pattern + touched.T @ touched + _pattern(i, j, n) + _pattern(j, i, n)
            i, j = (part.ravel() for part in np.meshgrid(around, own, indexing="ij"))
            pattern = pattern + _pattern(i, j, n) + _pattern(j, i, n)
            pattern.data[:] = 1.0
        pattern.sort_indices()
        i = np.repeat(np.arange(n), np.diff(pattern.indptr))
        self.keys = i * n + pattern.indices
        #: The entries of the unknowns, whose pattern has these rows and columns.
        self.kept = np.flatnonzero((i < self._unknowns) & (pattern.indices < self._unknowns))
        self._known: list[dict[int, Window]] = [{} for _ in self.all]
        return self.keys

    def _entries_of(self, slide: Slide, first: int) -> tuple[np.ndarray, ...]:
        """Local degrees of freedom, columns, positions and signs of the entries of a window."""
        found = [
            (k, *entry)
            for k, dof in enumerate(slide.local_dofs(first).tolist())
            for entry in self._couplings.entries(dof)
        ]
        found.append((len(slide.local_dofs(first)), slide.column, 0, 1.0))
        local, column, value, sign = np.array(found).T
        return local.astype(int), column.astype(int), value.astype(int), sign

    def neighbours(self, k: int) -> np.ndarray:
        """Indices of what the sliding columns of node k are coupled with."""
        return self._neighbours[k]

    def entries(self, k: int) -> Sequence[tuple[np.ndarray, ...]]:
        """Rows, positions of values and signs of the entries of each sliding column of node k."""
        return self._entries[k]

    def window(self, k: int, first: int) -> Window:
        """The window of node k that begins with a node of its beam."""
        if first not in self._known[k]:
            local, column, value, sign = self._entries_of(self.all[k], first)
            index, around = self.index[column], self._neighbours[k]
            self._known[k][first] = Window(
                local,
                column,
                value,
                sign,
                beside=self.places(around[:, None], index),
                above=self.places(index[:, None], around),
                inside=self.places(index[:, None], index),
            )
        return self._known[k][first]

    def places(self, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Places of entries in the tangent; behind the last where there is none."""
        place = np.searchsorted(self.keys, rows * self.size + columns)
        return np.where((rows >= 0) & (columns >= 0), place, len(self.keys))

    # -- A step ---------------------------------------------------------------------------------

    def begin(self, q: np.ndarray, slides: np.ndarray) -> None:
        """Set the start of a step: displacements and rotations, and slides."""
        for slide in self.all:
            slide.relation.begin(q[slide.dofs], float(slides[slide.joint.number]))

    def fault(self) -> tuple[str, str] | None:
        """Kind and reason of a step that leaves a beam, or passes too many elements; or None."""
        for slide in self.all:
            relation, joint = slide.relation, slide.joint
            if (off := relation.off_the_end()) > _BEYOND * slide.path.length:
                end = "start" if relation.s1 < 0 else "end"
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
                (r[rows] * virtual_map[places]) @ signs for rows, places, signs in self._entries[k]
            ]
            *on_beam, along = slide.force @ relation.virtual_map
            np.add.at(r, slide.local_dofs(relation.weights.first), on_beam)
            forces[slide.column] += along
        return r

    def eliminate(self, tangent: np.ndarray, values: np.ndarray, virtual_map: np.ndarray) -> None:
        """Eliminate the sliding columns from a tangent with the keys of `add_to_pattern`."""
        for k, slide in reversed(list(enumerate(self.all))):
            relation = slide.relation
            window = self.window(k, relation.weights.first)
            of_T, of_virtual = (
                window.sign * values[window.value],
                window.sign * virtual_map[window.value],
            )
            T, T_virtual = (
                relation.T[:, window.local] * of_T,
                relation.virtual_map[:, window.local] * of_virtual,
            )
            own, around = self.index[slide.columns], self._neighbours[k]
            K = tangent[self.places(own[:, None], own)]
            to_left = tangent[self.places(around[:, None], own)]
            to_right = tangent[self.places(own[:, None], around)]
            second = relation.second(slide.force)[np.ix_(window.local, window.local)]
            np.add.at(tangent, window.beside, to_left @ T)
            np.add.at(tangent, window.above, T_virtual.T @ to_right)
            np.add.at(
                tangent, window.inside, T_virtual.T @ K @ T + of_virtual[:, None] * second * of_T
            )


def _pattern(rows: np.ndarray, columns: np.ndarray, n: int) -> scipy.sparse.csr_matrix:
    return scipy.sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), (n, n))
