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

from typing import Any

import numpy as np
import scipy.sparse

from .graph import Couplings, Entries


class Auxiliaries:
    """The auxiliary unknowns of a scene, in the order of `Couplings.auxiliaries`."""

    def __init__(self, couplings: Couplings):
        auxiliaries, row_of, unknown_of = couplings.auxiliaries, *couplings.system
        self._count = len(auxiliaries)
        self._shape = self._count, couplings.columns + self._count
        self._entries = entries = Entries.of((k, one.entries) for k, one in enumerate(auxiliaries))
        arms = [(k, arm) for k, one in enumerate(auxiliaries) for arm in one.arms]
        #: Auxiliary and arm of each arm of a joint in their sums.
        self._arms = np.array(arms, dtype=int).reshape(-1, 2).T
        self._moves = np.flatnonzero(unknown_of[entries.column] >= 0)
        numbers, column = unknown_of[couplings.columns :], entries.column[self._moves]
        of = numbers[entries.row[self._moves]]
        #: Entries that auxiliary unknowns add to the linear system: diagonals, equations, forces.
        self.rows = np.concatenate([numbers, numbers + 1, of, row_of[column]])
        self.columns = np.concatenate([numbers, numbers + 1, unknown_of[column], of + 1])
        #: Unknowns (2, m) of auxiliary unknowns, and those on which they depend.
        self.dependent = np.array([np.append(of, of + 1), np.tile(unknown_of[column], 2)])

    def __len__(self):
        return self._count

    def entries_of(self, auxiliaries: np.ndarray) -> np.ndarray:
        """Numbers of the entries of some, the latest first: others depend on earlier ones only."""
        of = np.flatnonzero(np.isin(self._entries.row, auxiliaries))
        return of[np.argsort(-self._entries.row[of], kind="stable")]

    def equations(self, values: np.ndarray) -> scipy.sparse.csr_matrix:
        """Rows (auxiliaries, columns) whose products with all columns are zero, by values of T."""
        own = scipy.sparse.eye(*self._shape, k=self._shape[1] - self._count)
        return (self._entries.matrix(values, self._shape) - own).tocsr()

    def members(self) -> dict[str, Any]:
        """Their sums, by the names in problem.h; empty without any."""
        if not self._count:
            return {}
        return {
            "auxiliaries": self._count,
            "auxiliary_entries": len(self._entries.row),
            "auxiliary_of": self._entries.row,
            **self._entries.members("auxiliary"),
            "auxiliary_arms": self._arms.shape[1],
            "auxiliary_arm_of": self._arms[0],
            "auxiliary_arm": self._arms[1],
        }

    def storage(self, at: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Storage indices in the tangent by the names in problem.h, and of entries that are 1.

        `at` has those of the entries at `rows` and `columns`.
        """
        if not self._count:
            return {}, at
        both = np.full((2, len(self._entries.row)), -1)
        ones, both[:, self._moves] = at[: 2 * self._count], at[2 * self._count :].reshape(2, -1)
        return dict(zip(("auxiliary_equation", "auxiliary_force"), both, strict=True)), ones
