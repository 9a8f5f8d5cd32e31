"""Slopes of the forces on the unknowns by the unknowns, where the map Tv(y) of joints changes."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse

from .reduction import Reduction


def map_slopes(
    reduction: Reduction,
    project: Callable[[], np.ndarray],
    y: np.ndarray,
    driven: np.ndarray,
    columns: np.ndarray,
    steps: np.ndarray,
) -> scipy.sparse.csr_matrix:
    """d(Tv(y)^T r)/dy (n, n) in some columns, by central differences over steps (n,).

    `project` gives Tv^T r (n,), by the independent unknowns, at the last place of the map.
    """
    n = len(reduction.independent)
    slopes = np.zeros((n, len(columns)))
    for slope, unknown, h in zip(
        slopes.T, reduction.independent[columns], steps[columns], strict=True
    ):
        for step in (h, -h):
            place = y.copy()
            place[unknown] += step
            reduction.increment(place, driven)
            slope += project() / (2 * step)
    reduction.increment(y, driven)
    starts = len(columns) * np.arange(n + 1)
    entries = slopes.ravel(), np.tile(columns, n), starts
    return scipy.sparse.csr_matrix(entries, (n, n))
