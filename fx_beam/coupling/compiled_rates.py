"""Rates that fit the joints, in C (c/fitted_rates.c): where equations or their bands are few."""

from __future__ import annotations

import functools
import logging
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
import scipy.sparse.linalg

from fx_beam import c_library
from fx_beam.content_cache import cached_by_content
from fx_beam.results.state import MACROS
from fx_beam.structs import Structs

from .fitted_rates import Fit, FittedRates

_log = logging.getLogger("fx_beam")
# Largest width of bands in the equations of nodes with lumped masses. Otherwise so many equations,
# and degrees of freedom in them, are full matrices.
_WIDEST, _MOST = 60, (30, 200)


def compiled_rates(rates: FittedRates) -> FittedRates | CompiledRates:
    """The same in C, unless sparse matrices are better, or there is no C compiler."""
    used, at = np.unique(rates.points.dof, return_inverse=True)
    if (masses := _tables_of_masses(rates, used, at)) is None:
        return rates
    try:
        ffi, library = _library()
    except c_library.CannotBuild as error:
        _log.debug("rates of joints by SciPy: %s", error)
        return rates
    points = rates.points.tables()
    tables = rates.equations.tables() | points | masses
    return CompiledRates(ffi, library, tables | {"used_dof": used, "used_of": at})


@functools.cache
def _library() -> tuple[Any, Any]:
    return c_library.open_library("rates of joints", "fitted_rates.c", "fitted_rates.h", MACROS)


class CompiledRates:
    """Finds the nearest rates that fit, as `FittedRates` does, by the C struct RateFit."""

    def __init__(self, ffi: Any, library: Any, tables: dict[str, Any]):
        self._buffer, self._fit = ffi.from_buffer, library.fx_fit
        self._structs = Structs(ffi, c_library.declarations("fitted_rates.h"))
        self._c = ffi.new("RateFit *")
        self._structs.set(self._c, **tables)
        self._structs.set(self._c, scratch=np.zeros(library.fx_fit_scratch(self._c)))
        self._structs.check(self._c)
        self._size, self._joints = tables["size"], tables["joints"]
        self._columns = tables["columns"]

    def fit(self, q: np.ndarray, v: np.ndarray, slides: np.ndarray, driven: np.ndarray) -> Fit:
        """As `FittedRates.fit`."""
        n, size = len(q), self._size
        fit = Fit(
            np.empty((n, size)),
            np.empty((n, size)),
            np.empty((n, self._joints, 3)),
            np.empty((n, self._columns)),
        )
        given = map(np.ascontiguousarray, (q, v, slides, driven))
        self._c.driven = driven.shape[1]
        self._fit(self._c, n, *(self._buffer("double[]", x) for x in (*given, *fit)))
        return fit


def _tables_of_masses(
    rates: FittedRates, used: np.ndarray, at: np.ndarray
) -> dict[str, Any] | None:
    """Tables of RateFit that depend on masses, for the degrees of freedom that are used.

    `at` are those of the entries. None if sparse matrices are better.
    """
    row, massless, remaining = rates.points.row, rates.little[used] > 0, len(rates.points.remaining)
    tables: dict[str, Any] = {
        "massless": massless,
        "used": len(used),
        "width": remaining,
        "number": np.arange(remaining),
    }
    if not remaining:  # all that joints hold are massless points
        return tables
    if _alone(rates.mass)[used].all() and not massless.any():
        bands = _bands_of(row, at)
        if bands.width <= _WIDEST:
            inverse = 1 / rates.mass.diagonal()[used]
            return tables | {
                "width": bands.width,
                "number": bands.number,
                "pairs": len(bands.to),
                "pair_left": bands.left,
                "pair_right": bands.right,
                "pair_to": bands.to,
                "pair_weight": inverse[at[bands.left]],
                "inverse_mass": inverse,
            }
    if remaining > _MOST[0] or len(used) > _MOST[1]:
        return None
    impulses = np.zeros((rates.mass.shape[0], len(used)))
    impulses[used, np.arange(len(used))] = 1.0
    flexible = scipy.sparse.linalg.splu(rates.mass).solve(impulses).T
    return tables | {"flexible": flexible, "inner": flexible[:, used]}


class _Bands(NamedTuple):
    """S = G M^-1 G^T as bands: products of entries `left` and `right` of G."""

    #: Place of each equation, and half width with the diagonal.
    number: np.ndarray
    width: int
    left: np.ndarray
    right: np.ndarray
    #: Positions of the products, column by column of the lower bands.
    to: np.ndarray


@cached_by_content
def _bands_of(row: np.ndarray, dof: np.ndarray) -> _Bands:
    """Bands for entries at `row` and, of the degrees of freedom that are used, at `dof`."""
    of_dof = scipy.sparse.csr_matrix((np.ones(len(row)), (dof, np.arange(len(row)))))
    pairs = (of_dof.T @ of_dof).tocoo()
    pattern = scipy.sparse.csr_matrix((np.ones(pairs.nnz), (row[pairs.row], row[pairs.col])))
    number = np.argsort(scipy.sparse.csgraph.reverse_cuthill_mckee(pattern, symmetric_mode=True))
    i, j = number[row[pairs.row]], number[row[pairs.col]]
    lower = i >= j
    i, j, left, right = i[lower], j[lower], pairs.row[lower], pairs.col[lower]
    width = int((i - j).max()) + 1
    return _Bands(number, width, left, right, j * width + i - j)


def _alone(matrix: scipy.sparse.csc_matrix) -> np.ndarray:
    """Whether a column of a symmetric matrix has its diagonal entry only."""
    column = np.repeat(np.arange(matrix.shape[1]), np.diff(matrix.indptr))
    return np.bincount(column[matrix.data != 0], minlength=matrix.shape[1]) == 1
