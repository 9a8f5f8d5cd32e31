"""Nodes that slide on beams: their columns are eliminated from the equations after all others.

The columns of such a node are functions of the other columns, z_c = sum T_e z_e over the entries e
of a window of nodes around it. They border a tangent without them (bordering_rows.h).
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fx_beam.fem.mesh import Mesh
from fx_beam.laws.rates import UpdateRule
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import SlidingJoint

from .graph import Couplings
from .sliding import Sliding
from .tables import sparsity

# A node at rest on the end of a beam may be beyond it, by this part of the length.
_BEYOND = 1e-9


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

    def local_dofs(self, first: int) -> np.ndarray:
        """Degrees of freedom of the window that begins with a node, component by component."""
        components = len(self.columns)
        return self.dofs[first : first + self.path.width, :components].T.ravel()


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
        return position

    @property
    def entries_before(self) -> int:
        """Number of entries of the tangent before the elimination."""
        return len(self._given)

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
            force = forces[slide.columns] + [
                (r[rows] * virtual_map[value_at]) @ signs
                for rows, value_at, signs in self._entries[k]
            ]
            *on_beam, along = force @ relation.virtual_map
            np.add.at(r, slide.local_dofs(relation.nodes.start), on_beam)
            forces[slide.column] += along
        return r
