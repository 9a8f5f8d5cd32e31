"""Masses in the equations of rates for C (c/fitted_rates.c): where these or their bands are few."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.csgraph
import scipy.sparse.linalg

from fx_beam.content_cache import cached_by_content

# Largest width of bands in the equations of nodes with lumped masses. Otherwise so many equations,
# and degrees of freedom in them, are full matrices.
_WIDEST, _MOST = 60, (30, 200)


def tables_of_masses(
    row: np.ndarray, dof: np.ndarray, rows: int, mass: scipy.sparse.csc_matrix, little: np.ndarray
) -> dict[str, Any]:
    """What depends on masses by the names of RateFit, for the entries of so many equations.

    Masses contain the little ones (size,) of what has none. If sparse matrices are better, there
    are tables for neither bands nor full matrices.
    """
    used, at = np.unique(dof, return_inverse=True)
    massless = little[used] > 0
    tables: dict[str, Any] = {
        "used_dof": used,
        "used_of": at,
        "massless": massless,
        "used": len(used),
        "width": rows,
        "number": np.arange(rows),
    }
    if not rows:  # all that joints hold are massless points
        return tables
    if _alone(mass)[used].all() and not massless.any():
        bands = _bands_of(row, at)
        if bands.width <= _WIDEST:
            inverse = 1 / mass.diagonal()[used]
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
    if rows > _MOST[0] or len(used) > _MOST[1]:
        return tables | {"width": 0}
    impulses = np.zeros((mass.shape[0], len(used)))
    impulses[used, np.arange(len(used))] = 1.0
    flexible = scipy.sparse.linalg.splu(mass).solve(impulses).T
    return tables | {"flexible": flexible, "inner": flexible[:, used]}


class _Bands(NamedTuple):
    """S = G M^-1 G^T as bands: products of entries `left` and `right` of G."""

    #: Position of each equation, and half width with the diagonal.
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
