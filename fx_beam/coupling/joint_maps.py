"""Small changes through joints: the maps T and Tv at one configuration, and their transposes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import scipy.sparse

from fx_beam.content_cache import shallow_copy
from fx_beam.fem.compiled_points import CompiledPoints
from fx_beam.fem.sparsity import starts_of

from .graph import Couplings
from .joints_in_c import JointsInC

if TYPE_CHECKING:
    from .column_map import ColumnMap

# Up to so many columns of nodes on beams, what they depend on is an array: it takes less time.
_FEW = 100


class JointMaps:
    """T and Tv at the last configuration of joints, from columns z to degrees of freedom."""

    def __init__(self, joints: JointsInC, compiled_points: CompiledPoints):
        self._joints, self._compiled_points = joints, compiled_points
        columns = joints.couplings.columns + len(joints.auxiliaries)
        self._shape, self._columns = (joints.size, columns), joints.couplings.columns
        self._entries = joints.couplings.all_entries
        self._maps: dict[Any, Any] = {}

    def on(self, joints: JointsInC, compiled_points: CompiledPoints) -> JointMaps:
        """The maps of joints of another scene with this structure."""
        other = shallow_copy(self)
        other._joints, other._compiled_points, other._maps = joints, compiled_points, {}
        return other

    def forget(self) -> None:
        """Take another configuration."""
        self._maps = {}

    def _values(self, virtual: bool) -> np.ndarray:
        selects = self._joints.couplings.is_selection
        return np.ones(1) if selects else self._joints.configuration.values[virtual]

    def _map(self, virtual: bool, auxiliaries: bool = True, closed: bool = True) -> ColumnMap:
        """T or Tv, with dependent columns of what slides, `auxiliaries`, and of `closed` loops."""
        if (key := (virtual, auxiliaries, closed)) not in self._maps:
            from .column_map import ColumnMap

            values = self._values(virtual)
            dependence = self._dependence(values, virtual, auxiliaries, closed)
            others = auxiliaries and len(self._joints.auxiliaries)
            nested = not (others or (closed and self._joints.loops))
            weights = self._entries.weights(values)
            self._maps[key] = ColumnMap(weights, self._shape, *dependence, nested=nested)
        return self._maps[key]

    def _dependence(
        self, values: np.ndarray, virtual: bool, auxiliaries: bool, closed: bool
    ) -> tuple[scipy.sparse.csr_matrix | np.ndarray, np.ndarray]:
        """C (dependent, columns) with C z = 0, and the numbers of the dependent columns."""
        columns, slides = self._shape[1], self._joints.sliders.all if self._joints.sliders else []
        relations = self._joints.configuration.relations(virtual) if slides else []
        dependent = [np.empty(0, int), *(slide.columns for slide in slides)]
        starts = starts_of([*map(len, dependent[1:])])
        parts = [(np.empty(0, int), np.empty(0, int), np.empty(0))]
        for slide, first_row, (relation, first) in zip(slides, starts, relations, strict=False):
            row, column, weights = slide.equations(relation, first, values)
            parts.append((first_row + row, column, weights))
        row, column, weights = map(np.concatenate, zip(*parts, strict=True))
        has_auxiliaries = auxiliaries and len(self._joints.auxiliaries)
        if not has_auxiliaries and starts[-1] <= _FEW:
            C = np.bincount(row * columns + column, weights, starts[-1] * columns)
            rows: list[Any] = [C.reshape(starts[-1], columns)]
        else:
            rows = [scipy.sparse.csr_matrix((weights, (row, column)), (starts[-1], columns))]
        if has_auxiliaries:
            rows.insert(0, self._joints.auxiliaries.equations(values))
            dependent.insert(0, np.arange(self._columns, columns))
        if closed and self._joints.loops is not None:
            rows.append(self._joints.loops.derivatives(values))
            dependent.append(self._joints.following)
        if all(isinstance(block, np.ndarray) for block in rows):
            return np.concatenate(rows), np.concatenate(dependent)
        C = scipy.sparse.vstack([scipy.sparse.csr_matrix(block) for block in rows], "csr")
        return C, np.concatenate(dependent)

    @property
    def column_map(self) -> ColumnMap:
        """T, with auxiliary unknowns, at this configuration."""
        return self._map(False)

    def closure_derivatives(self) -> scipy.sparse.csr_matrix:
        """Derivatives (closures, unknowns) of closures [m] by units of the loops' unknowns."""
        from .column_map import without_dependent

        assert (loops := self._joints.loops) is not None
        C, dependent = self._dependence(values := self._values(False), False, True, False)
        equations = scipy.sparse.csr_matrix(C), dependent
        G = without_dependent(loops.derivatives(values), *equations)[0][:, loops.unknowns]
        unit = scipy.sparse.diags(loops.unit[loops.unknowns])
        return (scipy.sparse.diags(loops.lengths) @ G @ unit).tocsr()

    def dependence_matrix(self) -> scipy.sparse.csr_matrix:
        """Matrix (columns, columns) from rates of independent columns to rates of all."""
        return self._map(False).dependence_matrix[: self._columns, : self._columns]

    def _with_auxiliaries(self, z: np.ndarray) -> np.ndarray:
        return np.append(z, np.zeros(extra)) if (extra := len(self._joints.auxiliaries)) else z

    def with_dependent(self, z: np.ndarray) -> np.ndarray:
        """Rates of all columns from z with rates of independent columns: dependence_matrix() z."""
        if self._joints.couplings.is_selection:
            return z
        return self._map(False).with_dependent(self._with_auxiliaries(z))[: self._columns]

    def to_nodes(self, z: np.ndarray) -> np.ndarray:
        """dq = T dz (size,), the small change of all degrees of freedom by all columns."""
        if self._joints.couplings.is_selection:
            return z[self._joints.couplings.column] + 0.0
        return self._map(False) @ self._with_auxiliaries(z)

    def motion(self, x: np.ndarray) -> np.ndarray:
        """Small change (size,) of all degrees of freedom by `independent` unknowns."""
        z = np.zeros(self._columns)
        z[self._joints.independent] = x
        return self.to_nodes(z)

    def coupling(self, closed: bool = True, virtual: bool = False) -> scipy.sparse.csr_matrix:
        """T (size, columns), or with `virtual` Tv; loops follow the unknowns if `closed`."""
        T = self._map(virtual, closed=closed).matrix
        return T[:, : self._columns] if len(self._joints.auxiliaries) else T

    def coupling_array(self, closed: bool = True) -> np.ndarray:
        """T of a small scene, as an array."""
        return self._map(False, closed=closed).array[:, : self._columns]

    def transpose_to_nodes(self, r: np.ndarray) -> np.ndarray:
        """T^T r (columns,), without Tv and springs."""
        return self._map(False).transposed(r, np.zeros(self._shape[1]))[: self._columns]

    def reduced_force(self, r: np.ndarray) -> np.ndarray:
        """Tv^T r (columns,), with springs and dampers on slides."""
        compiled, slide_forces = self._compiled_points, np.zeros(self._shape[1])
        np.add.at(slide_forces, compiled.points.columns, compiled.on_slides(0))
        return self._map(True).transposed(r, slide_forces)[: self._columns]

    def moves(self, dofs: np.ndarray) -> np.ndarray:
        """Whether each unknown (free,) moves one of some degrees of freedom (size,), or a loop."""
        random = np.random.default_rng(0).random(self._shape[0]) * dofs  # which do not cancel
        moved = self._map(False, closed=False).transposed(random, np.zeros(self._shape[1]))
        moves = moved[: self._joints.couplings.free] != 0
        if self._joints.loops is not None:
            moves[self._joints.loops.unknowns] = True
        return moves

    def normal(self, weight: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """T^T W T for a matrix W (size, size), as a system with the equations C z = 0.

        Its first unknowns x solve T^T W T x = b, if zeros follow b.
        """
        values = self._values(False)
        C = scipy.sparse.csr_matrix(self._dependence(values, False, True, True)[0])
        auxiliary = np.arange(self._columns, self._shape[1])
        moving = np.append(np.arange(self._joints.couplings.free), auxiliary)
        A, C = self._entries.matrix(values, self._shape)[:, moving], C[:, moving]
        return scipy.sparse.bmat([[A.T @ weight @ A, C.T], [C, None]], "csr")

    def reduced(self, matrix: scipy.sparse.csr_matrix) -> scipy.sparse.csr_matrix:
        """The part Tv^T A T of the linear system for a matrix A of any sparsity, without loops."""
        couplings = self._joints.couplings
        (row_of, unknown_of), n = couplings.system, couplings.unknown_count
        T, Tv = (self._map(virtual, False, False).matrix for virtual in (False, True))
        A = (Tv.T @ matrix @ T).tocoo()
        row, column = row_of[A.row], unknown_of[A.col]
        valid = (row >= 0) & (column >= 0) & (row < n) & (column < n)
        return scipy.sparse.csr_matrix((A.data[valid], (row[valid], column[valid])), (n, n))


def moves_alone(couplings: Couplings, dofs: np.ndarray) -> np.ndarray:
    """Whether each unknown (free,) equals one of some degrees of freedom (size,).

    So far as it is known: not in long trees, loops or on beams.
    """
    if couplings.auxiliaries or couplings.sliding:
        return np.zeros(couplings.free, dtype=bool)
    row, column, value_at, _ = couplings.all_entries
    alone = np.bincount(row, minlength=len(dofs)) == 1
    equal = column[alone[row] & dofs[row] & (value_at == 0)]
    return np.bincount(equal, minlength=couplings.columns)[: couplings.free] > 0
