"""Modes of K x = omega^2 M x."""

from __future__ import annotations

import bisect
import functools
from collections.abc import Callable

import numpy as np
import scipy.sparse

from fx_beam.errors import SceneError

from .extended import ConstrainedMatrix
from .pencil import Pencil
from .sparse_lu import Pattern

# Smaller stiffnesses have few digits, which processors lose; they are none.
_TINY = 1e-290
# Largest difference of two entries across the diagonal, relative to the largest ones of their rows.
_ACROSS = 1e-12


class Symmetry:
    """Whether sparse matrices of one pattern are symmetric, by sizes of unit unknowns (n,)."""

    def __init__(self, pattern: Pattern, unit: np.ndarray, sliding: bool):
        indptr, columns = pattern
        n = len(indptr) - 1
        rows = np.repeat(np.arange(n), np.diff(indptr))
        numbers = np.arange(1, len(columns) + 1)
        numbered = scipy.sparse.csr_matrix((numbers, columns, indptr), (n, n))
        # The entry across the diagonal from each: -1 where the pattern has none.
        self._mirrored = np.asarray(numbered[columns, rows]).ravel() - 1
        self._rows, self._columns, self._starts = rows, columns, indptr[:-1]
        self._units = unit[rows] * unit[columns]
        # With nodes that slide on beams entries are differences of others that may be far larger.
        self._sliding = sliding

    @classmethod
    def of(cls, matrix: scipy.sparse.csr_matrix, unit: np.ndarray, sliding: bool) -> bool:
        """Whether one matrix is symmetric."""
        return cls((matrix.indptr, matrix.indices), unit, sliding).holds(matrix.data)

    def holds(self, values: np.ndarray) -> bool:
        """Whether the matrix with these values is symmetric up to rounding errors."""
        gaps = abs(values - np.append(values, 0.0)[self._mirrored])
        if not gaps.any():
            return True
        sizes, gaps = abs(values * self._units), gaps * self._units
        largest = np.sqrt(np.maximum.reduceat(np.append(sizes, 0.0), self._starts))
        if self._sliding:
            largest[:] = largest.max()
        return bool((gaps <= _ACROSS * largest[self._rows] * largest[self._columns]).all())


class UndampedModes:
    """Modes of stiffness K and mass M.

    Factors of K - x M have one sparsity, whatever x: they count eigenvalues and give vectors. Other
    unknowns of the system have vectors as well; `massive` are the unknowns (free,) with mass.
    """

    def __init__(
        self, K: ConstrainedMatrix, M: ConstrainedMatrix, massive: np.ndarray | None = None
    ):
        K = K.with_data(K.system.data * (abs(K.system.data) > _TINY))
        k, m, free = abs(K.alone.diagonal()), M.alone.diagonal(), K.free
        self._free, heavy = free, m > 0
        massive = heavy if massive is None else np.append(massive, m[free:] >= 0)
        ratios = k[heavy] / m[heavy]
        # Scaled so that stiffnesses are of order 1 and eigenvalues below 1.
        self._unit = unit = ratios.max() or 1.0
        sizes = k + unit * m
        sizes[free:][sizes[free:] == 0] = sizes.max()  # what nothing but others follows
        self._scale = sizes**-0.5
        K, M = K.scaled(self._scale), M.scaled(self._scale)
        self._pencil = Pencil(K, M.with_data(unit * M.system.data), massive)
        # Smaller eigenvalues are rounding errors, even in the softest direction.
        soft = ratios.min(where=ratios > 1e-20 * unit, initial=unit)
        self._least = 1e4 * np.finfo(float).eps * (soft / unit)

    def lowest(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Lowest angular frequencies (n,), which are rigid (n,), and vectors (free, n).

        Frequencies are zero for rigid modes and negative for unstable ones. Modal masses are 1.
        """
        values, rounding, vectors = self._in_slices(n)
        vectors = np.sqrt(self._unit) * (self._scale[:, None] * vectors)[: self._free]
        values, rigid = self._unit * values, abs(values) <= rounding
        return np.where(rigid, 0.0, np.sign(values) * np.sqrt(abs(values))), rigid, vectors

    def count_below(self, square: float) -> int:
        """Number of modes with omega^2 below a value; -1 if the value is an omega^2."""
        return self._pencil.below(square / self._unit)

    def _in_slices(self, n: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The lowest eigenvalues, their rounding errors, and vectors, by slices of four decades."""
        # Each slice has its own shift, since eigenvalues far below a shift are lost to rounding
        # errors. Sylvester's law counts what is missing. A Krylov space may lack copies of multiple
        # eigenvalues; they are found after deflation of the others.
        pencil = self._pencil
        count = functools.cache(pencil.below)
        sizes = 10.0 ** np.arange(np.log10(self._least), 4, 0.25)  # candidates for their bounds
        levels = _levels(count, sizes)

        finite = count(levels[-1])  # the others are infinite, for motions without mass
        n = min(n, finite)
        pencil.set_finite(finite)
        least = levels[levels > 0][0]
        if count(least) == 0 and (all_of_them := self._at_once(n, least)) is not None:
            return all_of_them
        last = levels[bisect.bisect_left(levels, n, key=count)]
        values, rounding, vectors = np.empty(0), np.empty(0), np.empty((len(self._scale), 0))

        def missing(x):
            """Number of eigenvalues below x, and not beside it, that are not found yet."""
            return count(x) - (values - rounding <= x + 1e-8 * abs(x)).sum()

        while missing(last) > 0:
            noise = rounding.max(initial=least)
            highest = np.sort(values)[n - 1 : n]  # none while there are fewer
            if any(missing(x - 2e-8 * abs(x) - 2 * noise) <= 0 for x in highest):
                break  # only its copies are missing, and those above
            bottom = levels[bisect.bisect_left(levels, 1, key=missing)]
            top = min(last, max(1e4 * bottom, 1e-4 * bottom, noise))
            shift = -max(top, -10 * bottom, 10 * noise)  # below the slice, not an eigenvalue
            new = pencil.nearest(min(max(missing(top), 1), 2 * n), shift, vectors)
            new -= vectors @ (vectors.T @ (pencil.M @ new))  # orthogonal to the slices below
            squares, errors, new = pencil.ritz_vectors(new)
            # Vectors above the slice took the place of copies that are not found yet.
            is_here = squares <= max(top + 1e-8 * abs(top), squares[0])
            values = np.append(values, squares[is_here])
            rounding = np.append(rounding, errors[is_here])
            vectors = np.column_stack([vectors, new[:, is_here]])
        order = np.argsort(values)[:n]
        return values[order], rounding[order], vectors[:, order]

    def _at_once(self, n: int, least: float):
        """Results of `_in_slices` if all eigenvalues lie within four decades; otherwise None."""
        new = self._pencil.nearest(n, -least, np.empty((len(self._scale), 0)))
        squares, errors, new = self._pencil.ritz_vectors(new)
        if len(squares) < n or (squares <= errors).any() or squares[-1] > 1e4 * squares[0]:
            return None
        bound = (1 - 1e-8) * squares[-1]  # the last one may have copies
        complete = self._pencil.below(bound) == (squares < bound).sum()
        return (squares, errors, new) if complete else None


def _levels(count: Callable[[float], int], sizes: np.ndarray) -> np.ndarray:
    """Slice bounds of both signs and these sizes, above the rounding error."""
    if count(sizes[-1]) < 1:
        raise SceneError("modes: a part moves freely and has no mass. Give it mass or a support")
    if count(-sizes[-1]) != 0:
        raise SceneError(
            "modes: the state is unstable in a motion without mass, so its growth rate is infinite."
            " Give this part mass, or use a state with less load"
        )
    # The rounding error of a rigid mode of a stiff part may be large compared with a soft part.
    least = next(k for k, x in enumerate(sizes) if min(count(x), count(-x)) >= 0)
    return np.concatenate([-sizes[least:][::-1], sizes[least:]])
