"""Places on beams, and how they change with the motion, the place, and the shape of the beam.

At the arc length s a place is at sum N_a phi_a, its beam has the slope t = sum N_a' phi_a and the
bend k = sum N_a' Psi_a (rate_equations.py).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse

from fx_beam.content_cache import cached_property
from fx_beam.scene.path import Path


class PlaceOnBeam:
    """Places s (n,) on a beam with the degrees of freedom (nodes, 3), at configurations q.

    `weights` N, N' and N'' (3, n, near) are those of the nodes that have any, with the degrees of
    freedom `dofs` (near, 3); `slope` t (n, 2) and `bend` (n,). Derivatives are those of t, k and N
    in one array (n, 3 + near).
    """

    def __init__(self, path: Path, dofs: np.ndarray, q: np.ndarray, s: np.ndarray):
        self.near, self.weights = path.weights_near(s)
        self.dofs, self._path, self._s = dofs[self.near], path, s
        nodes = np.column_stack([path.X, path.angles()])[self.near]
        #: Positions and angles (n, near, 3).
        self._at = nodes + q[:, self.dofs]
        along, change = (np.einsum("na,nai->ni", w, self._at) for w in self.weights[1:])
        self.slope, self.bend = along[:, :2], along[:, 2]
        #: Derivatives by s.
        self.by_slide = np.hstack([change, self.weights[1]])

    @cached_property
    def by_numbers(self) -> scipy.sparse.csr_matrix:
        """Derivatives (n (3 + near), numbers) by the numbers of the path."""
        path, n, near, first = self._path, len(self._s), len(self.near), self.weights[1]
        values, slopes = _weights_by_numbers(path, self._s)
        of_nodes = len(path.s) + 2 * self.near, path.numbers.size - len(path) + self.near
        columns = of_nodes[0], of_nodes[0] + 1, of_nodes[1]
        row, at = np.repeat(np.arange(n), near), np.arange(n * near)
        parts = []
        for i in range(3):
            sums = scipy.sparse.csr_matrix((self._at[:, :, i].ravel(), (row, at)))
            nodal = first.ravel(), (row, np.tile(columns[i], n))
            parts.append(sums @ slopes + scipy.sparse.csr_matrix(nodal, (n, path.numbers.size)))
        order = np.arange(n * (3 + near)).reshape(n, -1)
        to = np.concatenate([*order[:, :3].T, order[:, 3:].ravel()])
        return scipy.sparse.vstack([*parts, values]).tocsr()[np.argsort(to)]

    def vjp(self, by: np.ndarray, by_q: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives by s (n,) and by the numbers of the path at each place (n, numbers).

        From those by t, k and N; adds to those by q (n, size).
        """
        by_q[:, self.dofs] += self.weights[1][:, :, None] * by[:, None, :3]
        rows = np.repeat(np.arange(len(by)), by.shape[1]), np.arange(by.size)
        each = scipy.sparse.csr_matrix((by.ravel(), rows), (len(by), by.size))
        return (by * self.by_slide).sum(axis=1), (each @ self.by_numbers).toarray()


def _weights_by_numbers(path: Path, s: np.ndarray) -> list[scipy.sparse.csr_matrix]:
    """Derivatives (n near, numbers) of N and N' of `Path.weights_near` by `Path.numbers`."""
    e = np.clip(np.searchsorted(path.s, s, "right") - 1, 0, len(path.h) - 1)
    x, h = ((s - path.s[e]) / path.h[e])[:, None], path.h[e][:, None]
    one, width = np.ones_like(x), 3 * path.degree + 1
    powers = np.hstack([one, x, x**2, x**3]), np.hstack([0 * x, one, 2 * x, 3 * x**2])
    bends = np.hstack([0 * x, 0 * x, 2 * one, 6 * x])
    nodes = path.degree * (e[:, None] - 1) + np.arange(width)
    known = (nodes >= 0) & (nodes < len(path))
    near, at = np.unique(nodes[known], return_inverse=True)
    of_point, local = np.nonzero(known)
    rows, c, cell = of_point * len(near) + at, path.coefficients[e][known], e[of_point]
    first = len(path.s) + path.X.size + 4 * (cell * width + local)
    by_numbers = []
    for order, (value, slope) in enumerate(((powers[0], powers[1]), (powers[1], bends))):
        # A coefficient, and both ends of the element.
        by_begin = (slope * (x - 1) + order * value) / h ** (order + 1)
        by_end = -(slope * x + order * value) / h ** (order + 1)
        parts = [(first + i, (value / h**order)[of_point, i]) for i in range(4)]
        parts += [
            (cell, (c * by_begin[of_point]).sum(1)),
            (cell + 1, (c * by_end[of_point]).sum(1)),
        ]
        columns, values = (np.concatenate(part) for part in zip(*parts, strict=True))
        shape = len(s) * len(near), len(path.numbers)
        entries = values, (np.tile(rows, len(parts)), columns)
        by_numbers.append(scipy.sparse.csr_matrix(entries, shape))
    return by_numbers
