"""Rates that fit the joints, and the impulses of joints and supports that make them fit.

The mid-point rule leaves in the rates a part that joints do not allow: v1 = 2 Du/dt - v0. It
alternates from step to step, and hardly enters the motion, but forces of a step contain its change.
The nearest rates in the norm of the mass are without it:

    v* = v + c    with    M c = G^T mu,    G v* = g

The joints exert the impulses mu. So their mean force over a step is that of the step, plus the
increment of mu, divided by the length of the step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse
import scipy.sparse.csgraph
import scipy.sparse.linalg

from .rate_equations import RateEquations, summing
from .rigid_points import RigidPoints

# Up to so many equations, and degrees of freedom in them, they are full matrices.
_SMALL = 30, 200
# Largest width of bands in the equations of nodes with lumped masses.
_WIDEST = 60
# Numbers in the full matrices of the configurations that are solved at once.
_AT_ONCE = 1 << 20
# Mass of what has none, relative to the least mass that there is. Repetitions remove its effect: at
# most so many, until corrections are below round-off.
_LITTLE, _REPETITIONS, _ROUND_OFF = 1e-6, 20, 1e-14
# Added to the scaled equations, which are singular where loops are in line; removed alike.
_REGULAR = 1e-13


class Fit(NamedTuple):
    """Rates that fit, and what they take."""

    #: Rates v* (n, size), and their difference c from the given ones.
    rates: np.ndarray
    corrections: np.ndarray
    #: Impulses (n, joints, 3) of joints on their nodes b, and (n, columns) of motors and supports.
    joints: np.ndarray
    constraints: np.ndarray


class FittedRates:
    """Finds the nearest rates that fit joints, supports and driven motions.

    `mass` (size, size) is that of the scene, `unit` (size,) the size of a unit increment.
    """

    def __init__(
        self, equations: RateEquations, points: RigidPoints, mass: scipy.sparse.csr_matrix, unit
    ):
        self._equations, self._points = equations, points
        massless = mass.diagonal() == 0
        self._count, self._used = len(points.kept), np.unique(points.dof)
        self._at = np.searchsorted(self._used, points.dof)
        self._massless = massless[self._used]
        self._little = _little_mass(mass, unit)
        self._mass = (mass + scipy.sparse.diags(self._little)).tocsc()
        self._to_used = summing(self._at, len(self._used))
        self._to_rows = summing(points.row, self._count)
        self._solve = self._by_sparse_matrices
        if self._count <= _SMALL[0] and len(self._used) <= _SMALL[1]:
            self._solve = self._by_full_matrices
            impulses = np.zeros((equations.size, len(self._used)))
            impulses[self._used, np.arange(len(self._used))] = 1.0
            #: Rates (used, size) from unit impulses.
            self._flexible = scipy.sparse.linalg.splu(self._mass).solve(impulses).T.copy()
        elif not self._massless.any() and _is_diagonal(self._mass[:, self._used]):
            bands = _Bands(points.row, self._at, self._count, 1 / mass.diagonal()[self._used])
            if bands.width <= _WIDEST:
                self._bands, self._solve = bands, self._by_bands

    def fit(self, q: np.ndarray, v: np.ndarray, slides: np.ndarray, driven: np.ndarray) -> Fit:
        """Rates for v (n, size) at q (n, size) and slides (n, joints).

        `driven` (n, driven) are the rates of driven motions; those that are NaN are taken from v.
        """
        full = self._solve == self._by_full_matrices
        numbers = self._count * len(self._used) if full else 10 * len(self._little)
        rows = max(1, _AT_ONCE // max(1, numbers))
        parts = [
            self._fit(*(values[k : k + rows] for values in (q, v, slides, driven)))
            for k in range(0, len(q), rows)
        ]
        return parts[0] if len(parts) == 1 else Fit(*map(np.concatenate, zip(*parts, strict=True)))

    def _fit(self, q, v, slides, driven) -> Fit:
        equations, points = self._equations, self._points
        of, arms = equations.at(q, slides), points.arms(q)
        entries = points.condensed(of.entries, arms)
        lacking = equations.driven(of, driven)[:, points.kept]
        lacking = np.nan_to_num(lacking - (entries * v[:, points.dof]) @ self._to_rows)
        c, found = np.zeros_like(v), lacking
        if self._count:
            c, found = self._solve(entries, lacking)
        multipliers = np.zeros((len(q), equations.count))
        multipliers[:, points.kept] = found
        points.complete(of.entries, multipliers, arms)
        fitted = v + c
        points.move(fitted, arms)
        return Fit(fitted, fitted - v, *equations.forces(of, multipliers))

    def _by_full_matrices(self, entries: np.ndarray, lacking: np.ndarray):
        """Corrections (n, size) and multipliers (n, rows)."""
        n, count, used, massless = len(lacking), self._count, self._used, self._massless
        inner = self._flexible[:, used]
        G = np.zeros((n, count, len(used)))
        G[:, self._points.row, self._at] = entries
        GT = G.transpose(0, 2, 1)
        S = (G.reshape(-1, len(used)) @ inner).reshape(G.shape) @ GT
        scale = 1 / np.sqrt(np.einsum("nii->ni", S))
        S *= scale[:, :, None] * scale[:, None, :]
        inverse = np.linalg.inv(S + _REGULAR * np.eye(count))
        x, multipliers = np.zeros((n, len(used))), np.zeros((n, count))
        for _ in range(_REPETITIONS):
            # Impulses act on masses only: massless nodes keep the rates of the last repetition.
            left = scale * (lacking - _times(G, np.where(massless, x, 0.0)))
            y = _times(inverse, left)
            multipliers = scale * (y + _times(inverse, left - _times(S, y)))
            impulses = _times(GT, multipliers)
            before, x = x, np.where(massless, x, 0.0) + impulses @ inner
            if not massless.any() or abs(x - before).max() <= _ROUND_OFF * abs(x).max():
                break
        c = impulses @ self._flexible
        c[:, used[massless]] = x[:, massless]
        return c, multipliers

    def _by_bands(self, entries: np.ndarray, lacking: np.ndarray):
        """The same for nodes with lumped masses, at a cost linear in the number of equations."""
        bands, row = self._bands, self._points.row
        factors = bands.factors(entries)
        c, multipliers = np.zeros((len(lacking), len(self._little))), np.zeros(lacking.shape)
        for _ in range(2):  # the second time against round-off
            left = lacking - (entries * c[:, self._points.dof]) @ self._to_rows
            multipliers += bands.solve(factors, left)
            impulses = (entries * multipliers[:, row]) @ self._to_used
            c[:, self._used] = impulses * bands.inverse_mass
        return c, multipliers

    def _by_sparse_matrices(self, entries: np.ndarray, lacking: np.ndarray):
        """The same for many equations: configuration by configuration, at a cost linear in them."""
        n, size, little = len(lacking), len(self._little), self._little
        c, multipliers = np.zeros((n, size)), np.zeros(lacking.shape)
        for k in range(n):
            if k == 0 or (entries[k] != entries[k - 1]).any():
                factors = scipy.sparse.linalg.splu(self._saddle(entries[k]))
            for _ in range(_REPETITIONS):
                x = factors.solve(np.append(little * c[k], lacking[k]))
                before, c[k], multipliers[k] = c[k].copy(), x[:size], -x[size:]
                if not self._massless.any() or (
                    abs(c[k] - before)[little > 0].max() <= _ROUND_OFF * abs(c[k]).max()
                ):
                    break
        return c, multipliers

    def _saddle(self, entries: np.ndarray) -> scipy.sparse.csc_matrix:
        """Matrix of the rates and of the negative multipliers."""
        at, shape = (self._points.row, self._points.dof), (self._count, len(self._little))
        G = scipy.sparse.csr_matrix((entries, at), shape)
        G.eliminate_zeros()  # a node that slides has entries of the whole beam
        return scipy.sparse.bmat([[self._mass, G.T], [G, None]], format="csc")


class _Bands:
    """S = G M^-1 G^T as bands, for masses that are diagonal in the equations' degrees of freedom.

    Entries are at `row` and, of those degrees of freedom, at `place`.
    """

    def __init__(self, row: np.ndarray, place: np.ndarray, count: int, inverse_mass: np.ndarray):
        self.inverse_mass = inverse_mass
        each = np.ones(len(row)), (place, np.arange(len(row)))
        of_place = scipy.sparse.csr_matrix(each)
        pairs = (of_place.T @ of_place).tocoo()
        pattern = scipy.sparse.csr_matrix((np.ones(pairs.nnz), (row[pairs.row], row[pairs.col])))
        self._order = scipy.sparse.csgraph.reverse_cuthill_mckee(pattern, symmetric_mode=True)
        number = np.argsort(self._order)
        i, j = number[row[pairs.row]], number[row[pairs.col]]
        lower = i >= j
        i, j = i[lower], j[lower]
        self._pairs = pairs.row[lower], pairs.col[lower]
        self._weights = inverse_mass[place[self._pairs[0]]]
        self.width = int((i - j).max()) + 1
        each = np.ones(len(i)), (np.arange(len(i)), (i - j) * count + j)
        self._sums = scipy.sparse.csr_matrix(each, (len(i), self.width * count))

    def factors(self, entries: np.ndarray) -> list[np.ndarray]:
        """Cholesky factors of S for each of n sets of entries (n, entries)."""
        first, second = self._pairs
        S = (entries[:, first] * entries[:, second] * self._weights) @ self._sums
        S = S.reshape(len(entries), self.width, -1)
        S[:, 0] *= 1 + _REGULAR
        return [scipy.linalg.cholesky_banded(bands, lower=True) for bands in S]

    def solve(self, factors: list[np.ndarray], right: np.ndarray) -> np.ndarray:
        """Solutions (n, rows) of S x = right."""
        found = np.empty_like(right)
        for k, bands in enumerate(factors):
            b = right[k, self._order]
            found[k, self._order] = scipy.linalg.cho_solve_banded((bands, True), b)
        return found


def _is_diagonal(columns: scipy.sparse.csc_matrix) -> bool:
    """Whether columns of a symmetric matrix have their diagonal entries only."""
    return bool((np.diff((columns != 0).tocsc().indptr) == 1).all())


def _little_mass(mass: scipy.sparse.csr_matrix, unit: np.ndarray) -> np.ndarray:
    """Small masses and inertias (size,) of the degrees of freedom that have none."""
    inertia = mass.diagonal() * unit**2
    least = inertia[inertia > 0].min() if inertia.any() else 1.0
    return np.where(inertia > 0, 0.0, _LITTLE * least / unit**2)


def _times(A: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Products (n, m) of matrices (n, m, k) and vectors (n, k)."""
    return (A @ x[..., None])[..., 0]
