"""Derivatives of the weights of the nodes of a beam, at an arc length, by its shape."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from fx_beam.scene.path import Path


def weights_by_numbers(path: Path, s: np.ndarray) -> list[scipy.sparse.csr_matrix]:
    """Derivatives (n near, numbers) of N and N' of `Path.weights_near` by `Path.numbers`."""
    e = np.clip(np.searchsorted(path.s, s, "right") - 1, 0, len(path.h) - 1)
    x, h = ((s - path.s[e]) / path.h[e])[:, None], path.h[e][:, None]
    one, width = np.ones_like(x), 3 * path.degree + 1
    powers = np.hstack([one, x, x**2, x**3]), np.hstack([0 * x, one, 2 * x, 3 * x**2])
    bends = np.hstack([0 * x, 0 * x, 2 * one, 6 * x])
    nodes = path.degree * (e[:, None] - 1) + np.arange(width)
    known = (nodes >= 0) & (nodes < len(path))
    near, at = np.unique(nodes[known], return_inverse=True)
    places, local = np.nonzero(known)
    rows, c, cell = places * len(near) + at, path.coefficients[e][known], e[places]
    first = len(path.s) + path.X.size + 4 * (cell * width + local)
    by_numbers = []
    for order, (value, slope) in enumerate(((powers[0], powers[1]), (powers[1], bends))):
        # A coefficient, and both ends of the element.
        by_begin = (slope * (x - 1) + order * value) / h ** (order + 1)
        by_end = -(slope * x + order * value) / h ** (order + 1)
        parts = [(first + i, (value / h**order)[places, i]) for i in range(4)]
        parts += [
            (cell, (c * by_begin[places]).sum(1)),
            (cell + 1, (c * by_end[places]).sum(1)),
        ]
        columns, values = (np.concatenate(part) for part in zip(*parts, strict=True))
        shape = len(s) * len(near), len(path.numbers)
        entries = values, (np.tile(rows, len(parts)), columns)
        by_numbers.append(scipy.sparse.csr_matrix(entries, shape))
    return by_numbers
