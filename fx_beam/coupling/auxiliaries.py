"""Auxiliaries: degrees of freedom in long trees that are unknowns of the linear system.

With the displacements u of auxiliary unknowns, u = B y + N u in small changes of the columns y, and
the forces h that what follows them exerts on them, the reduced tangent A of y and u becomes

    [A_yy  A_yu  -Bv^T ] [dy]   [R]
    [A_uy  A_uu  1-Nv^T] [du] = [0]
    [-B    1-N   0     ] [-h]   [0]

with Bv and Nv for virtual displacements. There are few entries in each row, where the tangent of y
alone is full.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse

from .graph import Couplings
from .tables import AuxiliaryTables


class Auxiliaries:
    """The auxiliary unknowns of a scene, in the order of `Couplings.auxiliary unknowns`."""

    def __init__(self, couplings: Couplings):
        auxiliaries, free, first = couplings.auxiliaries, couplings.free, couplings.columns
        self._count, self._free, self._first = len(auxiliaries), free, first
        #: Unknowns of the linear system.
        self.unknowns = free + 2 * len(auxiliaries)
        numbers = free + 2 * np.arange(len(auxiliaries))
        none = np.full(first - free, -1)
        #: For all columns: the column of the linear system for a change, and the row for forces.
        #: The auxiliary unknown's equation is in the row of its displacement, the balance in that
        #: of its force: the diagonals are 1.
        self.columns_of_unknowns = np.concatenate([np.arange(free), none, numbers])
        self.rows_of_unknowns = np.concatenate([np.arange(free), none, numbers + 1])
        entries = [
            (k, *entry) for k, auxiliary in enumerate(auxiliaries) for entry in auxiliary.entries
        ]
        auxiliary, column, value_at, sign = np.array(entries, dtype=float).reshape(-1, 4).T
        #: Tie, column, position of the value, and sign of each entry.
        self.auxiliary, self.column, self.value_at = (
            auxiliary.astype(int),
            column.astype(int),
            value_at.astype(int),
        )
        self.sign = sign
        arms = [(k, arm) for k, auxiliary in enumerate(auxiliaries) for arm in auxiliary.arms]
        #: Tie and arm of each arm of a joint in their sums.
        self.arm_auxiliary, self.arm = np.array(arms, dtype=int).reshape(-1, 2).T
        self._moves = np.flatnonzero(self.columns_of_unknowns[self.column] >= 0)
        of, column = numbers[self.auxiliary[self._moves]], self.column[self._moves]
        #: Entries that auxiliary unknowns add to the linear system: diagonals, equations, forces.
        self.rows = np.concatenate([numbers, numbers + 1, of, self.rows_of_unknowns[column]])
        self.columns = np.concatenate(
            [numbers, numbers + 1, self.columns_of_unknowns[column], of + 1]
        )

        #: As `Reduction.dependent`.
        needs = np.tile(self.columns_of_unknowns[column], 2)
        self.dependent = np.array([np.concatenate([of, of + 1]), needs])

    def __len__(self):
        return self._count

    def entries(self, values: np.ndarray, virtual_map: np.ndarray) -> np.ndarray:
        """Values of the entries at `rows` and `columns`, for the values of T and Tv."""
        value_at, sign = self.value_at[self._moves], self.sign[self._moves]
        return np.concatenate(
            [np.ones(2 * self._count), -sign * values[value_at], -sign * virtual_map[value_at]]
        )

    def tables(self, at: np.ndarray) -> AuxiliaryTables | None:
        """The lists of numbers, for the positions of the entries; None without any."""
        if not self._count:
            return None
        entries = np.full((2, len(self.auxiliary)), -1)
        ones, entries[:, self._moves] = at[: 2 * self._count], at[2 * self._count :].reshape(2, -1)
        return AuxiliaryTables(
            values={
                "auxiliaries": self._count,
                "unknowns": self.unknowns,
                "auxiliary_entries": len(self.auxiliary),
                "auxiliary_arms": len(self.arm),
                "auxiliary_of": self.auxiliary,
                "auxiliary_column": self.column,
                "auxiliary_value": self.value_at,
                "auxiliary_arm_of": self.arm_auxiliary,
                "auxiliary_arm": self.arm,
                "auxiliary_sign": self.sign,
            },
            entries=dict(zip(("auxiliary_equation", "auxiliary_force"), entries, strict=True)),
            ones=ones,
        )

    # -- Sums over the trees --------------------------------------------------------------------

    def set_increments(self, z: np.ndarray, steps: np.ndarray) -> None:
        """Set the columns of the auxiliaries in the increments z, for those of the joints' arms."""
        constant = self.value_at == 0
        of_arms = np.bincount(self.arm_auxiliary, steps[self.arm], self._count)
        self._add_down(z, np.where(constant, self.sign, 0.0), of_arms)

    def set_changes(self, z: np.ndarray, values: np.ndarray) -> None:
        """Set the columns of the auxiliary unknowns in small changes z, for the values of T."""
        self._add_down(z, self.sign * values[self.value_at], np.zeros(self._count))

    def _add_down(self, z: np.ndarray, weights: np.ndarray, start: np.ndarray) -> None:
        changes, first = z.tolist(), self._first
        changes[first:] = start.tolist()
        terms = self.auxiliary.tolist(), self.column.tolist(), weights.tolist()
        for auxiliary, column, weight in zip(*terms, strict=True):
            changes[first + auxiliary] += weight * changes[column]
        z[first:] = changes[first:]

    def collect(self, out: np.ndarray, virtual_map: np.ndarray) -> None:
        """Add the forces on the auxiliaries, in `out`, to those on the columns before, for Tv."""
        self._collect(out, self.sign * virtual_map[self.value_at])

    def collect_whether(self, out: np.ndarray, values: np.ndarray) -> None:
        """The same for what is positive if anything moves."""
        self._collect(out, 1.0 * (values[self.value_at] != 0))

    def _collect(self, out: np.ndarray, weights: np.ndarray) -> None:
        forces, first = out.tolist(), self._first
        terms = self.auxiliary.tolist(), self.column.tolist(), weights.tolist()
        for auxiliary, column, weight in reversed(list(zip(*terms, strict=True))):
            forces[column] += weight * forces[first + auxiliary]
        out[:] = forces

    def by_columns(self, rows: np.ndarray, values: np.ndarray) -> np.ndarray:
        """Rows (n, columns) from those by columns and auxiliaries, for the values of T or Tv."""
        out, weights = rows.T.copy(), self.sign * values[self.value_at]
        for auxiliary, column, weight in reversed(
            list(zip(self.auxiliary, self.column, weights, strict=True))
        ):
            out[column] += weight * out[self._first + auxiliary]
        return out[: self._first].T

    def completion(self, values: np.ndarray) -> scipy.sparse.csr_matrix:
        """Matrix (columns and auxiliaries, columns) that gives all columns, for T or Tv.

        It is full: for small motions, not for steps.
        """
        each = np.eye(self._first + self._count)
        return scipy.sparse.csr_matrix(self.by_columns(each, values))
