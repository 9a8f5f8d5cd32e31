"""The pencil K - x M of a stiffness and a mass: eigenvalues are counted, vectors found."""

from __future__ import annotations

import numpy as np
import scipy.linalg

from .extended import ConstrainedMatrix

# Largest error of a vector in its iteration.
_EXACT = 1e-12
# Share of a vector that is left of it where a basis is complete: more than its rounding errors.
_ROUNDING = 1e-10
# An eigenvalue far above the largest, which is of order 1.
_FAR = 1e6
# Number of vectors after which the errors of eigenvectors are looked at again.
_MORE = 10


class Pencil:
    """K - x M of `ConstrainedMatrix` matrices: its factors have one sparsity, whatever x.

    Stiffnesses and eigenvalues are of order 1. Other unknowns of the system have vectors as well;
    `massive` are those with mass.
    """

    def __init__(self, K: ConstrainedMatrix, M: ConstrainedMatrix, massive: np.ndarray):
        #: Both matrices of the unknowns (size, size).
        self.K, self.M = K.alone, M.alone
        self._free, self._massive = K.free, massive
        # Orthonormal motions (size, few) that have no mass.
        self._massless = np.empty((len(massive), 0))
        # Also entries that are zero belong to it: whole nodes are factorised faster.
        counted = [A.with_data(np.arange(1, A.system.nnz + 1)).system for A in (K, M)]
        numbered = counted[0] + 1j * counted[1]
        numbered.sort_indices()
        numbers = (part.astype(int) - 1 for part in (numbered.data.real, numbered.data.imag))
        pairs = zip((K.system, M.system), numbers, strict=True)
        self._values = [np.append(A.data, 0.0)[k] for A, k in pairs]
        self._rows, self._columns = K.places.rows, K.places.columns
        self._extended, self._lu = K, K.factors((numbered.indptr, numbered.indices))

    def _factorise(self, x: float) -> bool:
        K, M = self._values
        return self._lu.factorise(K - x * M)

    def below(self, x: float) -> int:
        """Number of eigenvalues below x: negative pivots of K - x M, by Sylvester's law of inertia.

        -1 if a pivot is zero: x is an eigenvalue.
        """
        return self._extended.negative_eigenvalues(self._lu) if self._factorise(x) else -1

    def set_finite(self, finite: int) -> None:
        """Find motions without mass of unknowns that have mass, such as turns in a sleeve.

        The number of eigenvalues that are `finite` tells how many there are.
        """
        massive = int(self._massive[: self._free].sum())
        size = max(0, massive - finite), len(self._massive)
        if size[0] and not self._factorise(-_FAR):
            raise _failure()
        x = np.random.default_rng(0).standard_normal(size)
        for _ in range(2):  # each makes other motions smaller by 1 / _FAR
            x = np.array([self._solved(self.K @ vector) for vector in x]).reshape(size)
        self._massless = np.linalg.qr((self._massive * x).T)[0]

    def nearest(self, n: int, shift: float, deflated: np.ndarray) -> np.ndarray:
        """Eigenvectors (size, n or fewer) nearest to a shift, except the deflated ones.

        By Lanczos' method for the inverse of K - shift M, in the inner product of M, with vectors
        that are all made orthogonal to one another.
        """
        if not self._factorise(shift):
            raise _failure()
        size, first = deflated.shape
        basis = np.concatenate([self._bounded(deflated).T, np.empty((2 * n + 20, size))])
        # Other starts each time: those before have no part in a copy that was missed.
        starts = np.random.default_rng(first)
        diagonal, off_diagonal, m = list[float](), list[float](), first
        x, new = self._inverse(starts.standard_normal(size)), True
        whole = self._length(x)
        while True:
            x, force, left = self._orthogonal(x, basis[:m])
            if not np.isfinite(left) or m > size:
                raise _failure()
            complete = left <= _ROUNDING * whole
            if complete or not (new or (m - first) % _MORE):
                # Eigenvalues and vectors of a tridiagonal matrix, from its lower half.
                values, parts = np.linalg.eigh(np.diag(diagonal) + np.diag(off_diagonal[1:], -1))
                lowest = np.argsort(-abs(values))[:n]
                errors = left * abs(parts[-1:, lowest])
                if new or (len(lowest) == n and (errors <= _EXACT * abs(values[lowest])).all()):
                    break
                if complete:  # the other copies are found from another start
                    x, new = self._inverse(starts.standard_normal(size)), True
                    whole = self._length(x)
                    continue
            if m == len(basis):
                basis = np.concatenate([basis, np.empty((n + 20, size))])
            off_diagonal.append(0.0 if new else left)
            basis[m], force = x / left, force / left
            # Without its parts along the last two vectors one projection is mostly enough.
            x = self._solved(force)
            diagonal.append(float(x @ force))
            x -= diagonal[-1] * basis[m]
            if not new:
                x -= left * basis[m - 1]
            whole, new = np.hypot(diagonal[-1], off_diagonal[-1]), False
            m += 1
        if not len(lowest):
            raise _failure()
        vectors = parts[:, lowest].T @ basis[first:m]
        return np.column_stack([self._inverse(vector) for vector in vectors])

    def _orthogonal(self, x: np.ndarray, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """The part of x that is orthogonal to vectors (m, size), M times it, and its length.

        Once more while less than half is left, with rounding errors of what was longer.
        """
        before, force = np.inf, self.M @ x
        left = float(np.sqrt(abs(x @ force)))
        while left < 0.5 * before:
            x = self._bounded(x - (basis @ force) @ basis)
            force = self.M @ x
            before, left = left, float(np.sqrt(abs(x @ force)))
        return x, force, left

    def _bounded(self, x: np.ndarray) -> np.ndarray:
        """Vectors without motions that have no mass, which rounding errors would let grow."""
        x = (self._massive * x.T).T
        return x - self._massless @ (self._massless.T @ x) if self._massless.size else x

    def _inverse(self, x: np.ndarray) -> np.ndarray:
        return self._solved(self.M @ x)

    def _solved(self, forces: np.ndarray) -> np.ndarray:
        sides = np.zeros(len(self._rows) * 2 - self._free)
        sides[self._rows] = forces
        return self._lu.solve(sides)[self._columns]

    def _length(self, x: np.ndarray) -> float:
        return float(np.sqrt(abs(x @ (self.M @ x))))

    def ritz_vectors(self, vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rayleigh quotients in the span of vectors, their rounding errors, vectors of mass 1."""
        vectors = (
            vectors
            @ scipy.linalg.eigh(vectors.T @ (self.K @ vectors), vectors.T @ (self.M @ vectors))[1]
        )
        vectors /= np.sqrt(np.einsum("ij,ij->j", vectors, self.M @ vectors))
        values = np.einsum("ij,ij->j", vectors, self.K @ vectors)
        sizes = np.einsum("ij,ij->j", abs(vectors), abs(self.K) @ abs(vectors))
        # Of the sum, and of the vectors: the latter counts where nothing else has stiffness.
        eps = np.finfo(float).eps
        return values, 2 * eps * sizes + (10 * eps) ** 2 * (vectors**2).sum(axis=0), vectors


def _failure() -> RuntimeError:
    return RuntimeError(
        "modes: no mode was found. Try fewer modes, and check the units of stiffnesses and masses: "
        "very different magnitudes are lost in rounding errors"
    )
