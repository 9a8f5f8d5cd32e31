"""Nodes that slide on flexible beams: their columns depend on the others.

Node c at the arc length s: phi_c = sum N_a phi_a. With bars for means of both ends of the step and
D for increments,

    virtual phi_c = sum Nbar_a virtual phi_a + z virtual alpha
                    + virtual s (sum (DN_a/Ds) phibar_a - z Dalpha/Ds)
    z = W/4 sum DN_a Dphi_a,    virtual alpha = W rbar . (virtual r) / |rbar|^2

where r is the chord of the element in which the step begins. It gives the step's own increment
Dphi_c, a translation for a translation, and a rotation for a rotation.
A sleeve also turns with the beam, psi_c = sum N_a Psi_a with Psi_a = psi_a + the reference angle.
With x_a = Dpsi_a/2, y = sum Nbar_a x_a, y_c = Dpsi_c/2 and k(x) = x / sin x,

    virtual psi_c = sum B_a virtual psi_a + virtual s q sin(y_c - y) / ((y_c - y) cos y_c cos y)
    B_a = Nbar_a k(x_a - y) cos x_a / sum of the same,    q = sum (DN_a/Ds) Psibar_a

which gives Dtheta_c = 2 tan(Dpsi_c/2) for the nodal Dtheta_a = 2 tan(Dpsi_a/2).
Schemes with another level have the derivatives at both ends, weighted as their forces are.
The columns border a tangent without them (c/bordering_rows.h).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from fx_beam.fem.mesh import Mesh
from fx_beam.fem.sparsity import Pattern, sparsity, starts_of
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import SlidingJoint

from .graph import Couplings, Entries

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

    def equations(
        self, relation: np.ndarray, first: int, values: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows C (components, columns) with C z = 0: rows, columns and values of their entries.

        By values of T or Tv. `relation`: derivatives of the node by a window of the beam that
        begins with node `first` (c/slider.h).
        """
        count, width = len(relation), self.path.width
        begin, end = 3 * first, 3 * (first + width)
        parts = self.guide.parts.take(slice(*np.searchsorted(self.guide.parts.row, (begin, end))))
        dof_weights = np.zeros((count, width, 3))
        dof_weights[:, :, :count] = relation[:, :-1].reshape(count, count, width).swapaxes(1, 2)
        row, column, weights = parts.weights(values)
        part_weights = dof_weights.reshape(count, -1)[:, row - begin] * weights
        every = np.arange(count)
        return (
            np.concatenate([np.repeat(every, len(column)), every, every]),
            np.concatenate([np.tile(column, count), np.full(count, self.column), self.columns]),
            np.concatenate([part_weights.ravel(), relation[:, -1], np.full(count, -1.0)]),
        )

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
