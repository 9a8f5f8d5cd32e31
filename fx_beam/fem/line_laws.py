"""Laws of lines over points: compiled laws of their length, and their pieces (line_law.h)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from fx_beam.laws.point_laws import TINY, PointLaw, StepRule, arguments

from .compiled_laws import CompiledLaw, compiled_laws


class _Pieces(NamedTuple):
    """Vectors (k, pieces, 2) of a line in k rows: unit vectors, and slopes of the rate."""

    start: np.ndarray
    end: np.ndarray
    rate_slopes: np.ndarray
    #: Inputs (k, ...) of the law of the length.
    inputs: np.ndarray


class LineLaw:
    """The law of a line over points in the steps of a rule, as a `CompiledLaw` of all points."""

    def __init__(self, law: PointLaw, length: CompiledLaw, level: float):
        self.law, self._length, self._level = law, length, level
        self.parameters, self.conditions = length.parameters, length.conditions
        numbers = np.arange(law.size, dtype=np.int32)
        #: Rows and columns (n, 2) of the entries of the tangent: all.
        self.entries = np.stack(np.meshgrid(numbers, numbers, indexing="ij"), -1).reshape(-1, 2)
        self.size = law.size + len(self.entries) + law.internal + law.iteration_memory
        #: Number of values that its functions are given.
        self.input_count = arguments(law) + len(self.parameters)
        self.address, self.check_at_zero = length.address, length.check_at_zero
        # Where the coordinates of each point begin, -1 of those that are fixed.
        moves = np.array(law.moves)
        self._moves = np.where(moves, 2 * np.cumsum(moves) - 2, -1)

    @property
    def members(self) -> dict[str, object]:
        """Members of it that structs in C have."""
        (row, column), length = self.entries.T, self._length
        return {
            **length.members,
            "entries": len(row),
            "entry_row": row,
            "entry_column": column,
            "level": self._level,
            "pieces": len(self._moves) - 1,
            "moves": self._moves,
            "length_entries": len(length.entries),
            "others": length.law.numbers + len(self.parameters),
        }

    @property
    def slopes_address(self) -> int:
        """Address of the derivatives of the law of the length."""
        return self._length.slopes_address

    @property
    def slopes_size(self) -> int:
        """Number of the derivatives of all forces and internal variables."""
        law = self.law
        wide = 2 * law.size + law.internal + law.numbers + len(self.parameters)
        return (law.size + law.internal) * wide

    def values(self, quantity: str, inputs: np.ndarray) -> np.ndarray:
        """Values (k, m) of a function of the length for inputs (k, n)."""
        return self._length.values(quantity, self._pieces(inputs).inputs)

    def slopes(self, quantity: str, inputs: np.ndarray) -> np.ndarray:
        """Derivatives (k, n) of a function of the length by inputs (k, n)."""
        pieces = self._pieces(inputs)
        slopes = self._length.slopes(quantity, pieces.inputs)
        start, path, rate = (slopes[:, i, None, None] for i in range(3))
        start_slopes = (start - path) * pieces.start + path * pieces.end + rate * pieces.rate_slopes
        motion = start_slopes, path * pieces.end, rate * pieces.start
        end = 5 + self.law.internal + self.law.iteration_memory
        vectors = start_slopes.reshape(len(slopes), -1)
        middle, rest = slopes[:, 3:end], slopes[:, end:]
        return np.hstack([*map(self._point_slopes, motion), middle, vectors, rest])

    def _pieces(self, inputs: np.ndarray) -> _Pieces:
        """The pieces for inputs (k, n)."""
        n, last = self.law.size, arguments(self.law)
        count, first = len(self._moves) - 1, last - self.law.numbers
        start, D, rates = (self._vectors(inputs[:, i * n : (i + 1) * n]) for i in range(3))
        start += inputs[:, first : first + 2 * count].reshape(-1, count, 2)
        sizes, units = zip(*map(_sized, (start, start + D)), strict=True)
        rate = np.sum(units[0] * rates, axis=2)
        rate_slopes = (rates - units[0] * rate[..., None]) / sizes[0][..., None]
        lengths = [sizes[0], sizes[1] - sizes[0], rate]
        sums = np.stack([values.sum(axis=1) for values in lengths], axis=1)
        rest = [inputs[:, 3 * n : first], inputs[:, first + 2 * count :]]
        return _Pieces(units[0], units[1], rate_slopes, np.hstack([sums, *rest]))

    def _vectors(self, values: np.ndarray) -> np.ndarray:
        """Vectors (k, pieces, 2) between points, of coordinates (k, n)."""
        columns = self._moves[:, None] + np.arange(2)
        return np.diff(np.where(self._moves[:, None] < 0, 0.0, values[:, columns]), axis=1)

    def _point_slopes(self, piece_slopes: np.ndarray) -> np.ndarray:
        """Derivatives (k, n) by the coordinates from those (k, pieces, 2) by the pieces."""
        none = np.zeros_like(piece_slopes[:, :1])
        slopes = -np.diff(np.concatenate([none, piece_slopes, none], axis=1), axis=1)
        return slopes[:, self._moves >= 0].reshape(len(piece_slopes), -1)


def _sized(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lengths (k, pieces) of vectors (k, pieces, 2), and unit vectors."""
    sizes = np.sqrt(np.sum(vectors * vectors, axis=2) + TINY)
    return sizes, vectors / sizes[..., None]


def laws_of_forces(laws: Sequence[PointLaw], rule: StepRule) -> list[CompiledLaw | LineLaw]:
    """Compiled laws of forces at points, also of lines over points."""
    compiled = compiled_laws([law.length_law or law for law in laws], rule)
    return [
        LineLaw(law, compiled_law, rule.level) if law.length_law else compiled_law
        for law, compiled_law in zip(laws, compiled, strict=True)
    ]
