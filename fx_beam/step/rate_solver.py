"""The linear system of rates that fit the joints, for many configurations in C.

    [ M  G^T ] [  v  ]   [ p ]
    [ G   0  ] [ -mu ] = [ g ]

Small masses of what has none, and small entries on the diagonal of equations, which are singular
where joints are redundant, make it regular without an exchange of rows; C removes their effects.
"""

from __future__ import annotations

import functools
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from fx_beam import c_library
from fx_beam.c_library import Structs
from fx_beam.content_cache import cached_by_content
from fx_beam.coupling.rate_equations import RateEquations
from fx_beam.results.state import MACROS

from .lu_layout import fill_in

# Mass of what has none, relative to the least mass that there is. A smaller one takes more
# repetitions: the regularisation of an equation is in proportion to the mobility of its rates.
_LITTLE = 1e-2
# Up to so many rates in the equations, those that follow from them by masses are left out.
_MOST = 200


class Fit(NamedTuple):
    """Rates that fit, and what they take."""

    #: Rates v* (n, size), and their difference c from the given ones.
    rates: np.ndarray
    corrections: np.ndarray
    #: Impulses (n, joints, 3) of joints on their nodes b, and (n, columns) of motors and supports.
    joints: np.ndarray
    constraints: np.ndarray


class _Factors(NamedTuple):
    """Places of the factors L D L^T, column by column."""

    #: Position (n,) of each unknown, start of each column, n times column plus row of each entry,
    #: and from which entry each product of two of a column is subtracted.
    order: np.ndarray
    starts: np.ndarray
    keys: np.ndarray
    target: np.ndarray

    def at(self, i: np.ndarray, j: np.ndarray) -> np.ndarray:
        """Places of entries of the matrix."""
        first, second = np.sort([self.order[i], self.order[j]], axis=0)
        return np.searchsorted(self.keys, first * len(self.order) + second)


class RateSolver:
    """The system of the rates in some equations, or of `all_rates`.

    `mass` (size, size) is that of the scene, `unit` (size,) the size of a unit increment.
    """

    def __init__(
        self,
        equations: RateEquations,
        mass: scipy.sparse.csr_matrix,
        unit: np.ndarray,
        all_rates: bool = False,
    ):
        ffi, self._library = c_library.kept_library(
            "rates of joints", "fitted_rates.c", "fitted_rates.h", MACROS
        )
        self.equations, self._null = equations, ffi.NULL
        self._of = functools.partial(ffi.from_buffer, "double[]")
        #: Small masses (size,) of what has none.
        self.little = _little_mass(mass, unit)
        self._c = ffi.new("RateFit *")
        structs = Structs(ffi, c_library.declarations("fitted_rates.h"))
        structs.set(self._c, **equations.tables(), **self._tables(mass, all_rates))
        structs.check(self._c)
        self._structs = structs

    def _tables(self, mass: scipy.sparse.csr_matrix, all_rates: bool) -> dict[str, Any]:
        """Masses and factors by the names of RateFit."""
        equations, size = self.equations, len(self.little)
        used = np.arange(size) if all_rates else np.unique(equations.dof)
        used, others, M, follow = _condensed(mass, self.little, used)
        self.used, n = len(used), len(used) + equations.count
        little, of = self.little[used], np.searchsorted(used, equations.dof)
        # Unknowns are rates, then negative multipliers.
        own, of_mass, row = np.arange(n), M.tocoo(), len(used) + equations.row
        rows, columns = np.append(own, of_mass.row), np.append(own, of_mass.col)
        factors = _factors(np.append(rows, row), np.append(columns, of), equations.count)
        order, start = factors.order, np.zeros(len(factors.keys))
        start[factors.at(own[: len(used)], own[: len(used)])] = little
        below = order[of_mass.row] >= order[of_mass.col]
        start[factors.at(of_mass.row[below], of_mass.col[below])] += M.data[below]
        return {
            "used": len(used),
            "used_dof": used,
            "order": order,
            "entry_rate": order[of],
            "entry_multiplier": order[row],
            "entry_at": factors.at(row, of),
            "mobility": 1 / (M.diagonal() + little)[of],
            "masses": M.nnz,
            "mass_row": order[of_mass.row],
            "mass_column": order[of_mass.col],
            "mass": M.data,
            "column_start": factors.starts,
            "row_of": factors.keys % max(n, 1),
            "target": factors.target,
            "start_of_factors": start,
            "others": len(others),
            "other_dof": others,
            "follow": follow,
        }

    def fit(self, *given: np.ndarray, values: np.ndarray | None = None) -> Fit:
        """As `FittedRates.fit`, for q, v, slides and driven rates; with `values` of equations."""
        q, c = given[0], self._c
        n, c.driven = len(q), given[-1].shape[1]
        rates, corrections = np.empty(q.shape), np.empty(q.shape)
        fit = Fit(rates, corrections, np.empty((n, c.joints, 3)), np.empty((n, c.columns)))
        given = tuple(np.ascontiguousarray(x, dtype=float) for x in given)
        to = self._null if values is None else self._of(values)
        self._check(self._library.fx_fit(c, n, *map(self._of, (*given, *fit)), to))
        return fit

    def solve(self, entries: np.ndarray, right: np.ndarray) -> np.ndarray:
        """Rates and negative multipliers for right sides (n, ..., used + count)."""
        right, n = np.ascontiguousarray(right), len(right)
        x, m = np.empty(right.shape), right[0, ..., 0].size if n else 0
        arrays = map(self._of, (entries, right, x))
        self._check(self._library.fx_solve_rates(self._c, n, m, *arrays))
        return x

    @staticmethod
    def _check(done: int) -> None:
        if not done:
            raise MemoryError("rates that fit the joints")


@cached_by_content
def _factors(rows: np.ndarray, columns: np.ndarray, multipliers: int) -> _Factors:
    """Factors of a symmetric matrix with these entries and their transposes."""
    n = int(rows.max(initial=-1)) + 1
    if not n:  # all that joints hold are rigid points
        none = np.empty(0, dtype=int)
        return _Factors(none, np.zeros(1, dtype=int), none, none)
    graph = scipy.sparse.csr_matrix((np.ones(len(rows)), (rows, columns)), (n, n))
    order, keys = fill_in((graph + graph.T).tocsr(), multipliers)
    starts = np.searchsorted(keys, np.arange(n + 1) * n)
    # Entries below the diagonal, each with all before it in its column.
    number = np.arange(len(keys)) - np.repeat(starts[:-1], np.diff(starts))
    left = np.repeat(np.arange(len(keys)), number)
    ends = np.cumsum(number)
    right = left - (np.repeat(ends, number) - np.arange(len(left))) + 1
    target = np.searchsorted(keys, keys[right] % n * n + keys[left] % n)
    return _Factors(order, starts, keys, target)


def _little_mass(mass: scipy.sparse.csr_matrix, unit: np.ndarray) -> np.ndarray:
    """Small masses and inertias (size,) of the degrees of freedom that have none."""
    inertia = mass.diagonal() * unit**2
    least = inertia[inertia > 0].min() if inertia.any() else 1.0
    return np.where(inertia > 0, 0.0, _LITTLE * least / unit**2)


def _condensed(
    mass: scipy.sparse.csr_matrix, little: np.ndarray, used: np.ndarray
) -> tuple[np.ndarray, np.ndarray, scipy.sparse.csr_matrix, np.ndarray]:
    """Rates that are unknown, others that follow from them, their mass, and how they follow."""
    M, unused = mass.tocsr(copy=True), np.ones(len(little), dtype=bool)
    M.eliminate_zeros()  # the masses have the stiffness' pattern
    if len(used) == len(little):
        return used, np.empty(0, int), M, np.empty((len(used), 0))
    unused[used] = False
    between, none = M[unused][:, used], np.empty((len(used), 0))
    if between.nnz and len(used) > _MOST:
        return np.arange(len(little)), np.empty(0, int), M, np.empty((len(little), 0))
    own = M[used][:, used]
    if not between.nnz:
        return used, np.empty(0, int), own, none
    rest = (M + scipy.sparse.diags(little)).tocsr()[unused][:, unused]
    follow = -scipy.sparse.linalg.splu(rest.tocsc()).solve(between.toarray())
    moves = follow.any(axis=1)
    own = scipy.sparse.csr_matrix(own + between.T @ follow)
    return used, np.flatnonzero(unused)[moves], own, follow[moves].T.copy()
