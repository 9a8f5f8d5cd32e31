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

from .graph import Couplings


class Auxiliaries:
    """The auxiliary unknowns of a scene, in the order of `Couplings.auxiliaries`."""

    def __init__(self, couplings: Couplings):
        auxiliaries, row_of, unknown_of = couplings.auxiliaries, *couplings.system
        self._count = len(auxiliaries)
        self._shape = self._count, couplings.columns + self._count
        entries = [(k, *entry) for k, one in enumerate(auxiliaries) for entry in one.entries]
        arms = [(k, arm) for k, one in enumerate(auxiliaries) for arm in one.arms]
        of, column, value_at, sign = np.array(entries, dtype=float).reshape(-1, 4).T
        #: Auxiliary, column, and position of the value of each entry, and its sign.
        self._of, self._column, self._value_at = (x.astype(int) for x in (of, column, value_at))
        self._sign = sign
        #: Auxiliary and arm of each arm of a joint in their sums.
        self._arms = np.array(arms, dtype=int).reshape(-1, 2).T
        self._moves = np.flatnonzero(unknown_of[self._column] >= 0)
        numbers, column = unknown_of[couplings.columns :], self._column[self._moves]
        of = numbers[self._of[self._moves]]
        #: Entries that auxiliary unknowns add to the linear system: diagonals, equations, forces.
        self.rows = np.concatenate([numbers, numbers + 1, of, row_of[column]])
        self.columns = np.concatenate([numbers, numbers + 1, unknown_of[column], of + 1])
        #: Unknowns (2, m) of auxiliary unknowns, and those on which they depend.
        self.dependent = np.array([np.append(of, of + 1), np.tile(unknown_of[column], 2)])

    def __len__(self):
        return self._count

    def entries(self, values: np.ndarray, virtual_map: np.ndarray) -> np.ndarray:
        """Values of the entries at `rows` and `columns`, for the values of T and Tv."""
        value_at, sign = self._value_at[self._moves], self._sign[self._moves]
        of_entries = -sign * values[value_at], -sign * virtual_map[value_at]
        return np.concatenate([np.ones(2 * self._count), *of_entries])

    def entries_of(self, auxiliaries: np.ndarray) -> np.ndarray:
        """Numbers of the entries of some, the latest first: others depend on earlier ones only."""
        of = np.flatnonzero(np.isin(self._of, auxiliaries))
        return of[np.argsort(-self._of[of], kind="stable")]

    def sums(self, values: np.ndarray) -> scipy.sparse.csr_matrix:
        """Derivatives (auxiliaries, columns) by all columns, for the values of T or Tv."""
        entries = self._sign * values[self._value_at], (self._of, self._column)
        return scipy.sparse.csr_matrix(entries, self._shape)

    def members(self) -> dict[str, Any]:
        """Their sums, by the names in problem.h; empty without any."""
        if not self._count:
            return {}
        return {
            "auxiliaries": self._count,
            "auxiliary_entries": len(self._of),
            "auxiliary_of": self._of,
            "auxiliary_column": self._column,
            "auxiliary_value": self._value_at,
            "auxiliary_sign": self._sign,
            "auxiliary_arms": self._arms.shape[1],
            "auxiliary_arm_of": self._arms[0],
            "auxiliary_arm": self._arms[1],
        }

    def places(self, at: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Storage indices in the tangent by the names in problem.h, and of entries that are 1.

        `at` has those of the entries at `rows` and `columns`.
        """
        if not self._count:
            return {}, at
        both = np.full((2, len(self._of)), -1)
        ones, both[:, self._moves] = at[: 2 * self._count], at[2 * self._count :].reshape(2, -1)
        return dict(zip(("auxiliary_equation", "auxiliary_force"), both, strict=True)), ones
