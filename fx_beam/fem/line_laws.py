"""Laws of lines over points: compiled laws of their length, and their pieces (line_law.h)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from fx_beam.laws.point_laws import TINY, PointLaw, StepRule, arguments

from .compiled_laws import CompiledLaw, PointFunction, compiled_laws


class _Pieces(NamedTuple):
    """Vectors (k, pieces, 2) of a line in k rows: unit vectors, and slopes of the rate."""

    start: np.ndarray
    end: np.ndarray
    of_rate: np.ndarray
    #: What the law of the length is given (k, ...).
    given: np.ndarray


class LineLaw:
    """The law of a line over points in the steps of a rule, as a `CompiledLaw` of all points."""

    def __init__(self, law: PointLaw, of_length: CompiledLaw, level: float):
        self.law, self._of_length, self._level = law, of_length, level
        self.parameters, self.conditions = of_length.parameters, of_length.conditions
        numbers = np.arange(law.size, dtype=np.int32)
        #: Rows and columns (n, 2) of the entries of the tangent: all.
        self.entries = np.stack(np.meshgrid(numbers, numbers, indexing="ij"), -1).reshape(-1, 2)
        self.values = law.size + len(self.entries) + law.internal + law.iteration_memory
        #: Number of values that its functions are given.
        self.given = arguments(law) + len(self.parameters)
        self.address, self.check_at_zero = of_length.address, of_length.check_at_zero
        # Where the coordinates of each point begin, -1 of those that are fixed.
        moves = np.array(law.moves)
        self._moves = np.where(moves, 2 * np.cumsum(moves) - 2, -1)

    @property
    def members(self) -> dict[str, Any]:
        """Members of it that structs in C have."""
        (row, column), length = self.entries.T, self._of_length
        own_members = {
            "entries": len(row),
            "entry_row": row,
            "entry_column": column,
            "level": self._level,
        }
        own_members |= {"pieces": len(self._moves) - 1, "moves": self._moves}
        numbers = length.law.numbers + len(self.parameters)
        return (
            length.members
            | own_members
            | {"length_entries": len(length.entries), "others": numbers}
        )

    @property
    def slopes_address(self) -> int:
        """Address of the slopes of the law of the length."""
        return self._of_length.slopes.address

    @property
    def slopes_size(self) -> int:
        """Number of slopes of all forces and internal variables (`slopes_of`)."""
        law = self.law
        wide = 2 * law.size + law.internal + law.numbers + len(self.parameters)
        return (law.size + law.internal) * wide

    def function(self, name: str) -> _LineValues:
        """One of the functions of the law besides its forces."""
        return _LineValues(self, self._of_length.function(name))

    def derivatives(self, name: str) -> _LineDerivatives:
        """Derivatives of one of its functions by all given."""
        return _LineDerivatives(self, self._of_length.derivatives(name))

    def pieces(self, inputs: np.ndarray) -> _Pieces:
        """The pieces for what the law is given (k, given)."""
        n, last = self.law.size, arguments(self.law)
        count, first = len(self._moves) - 1, last - self.law.numbers
        start, D, rates = (self._ways(inputs[:, i * n : (i + 1) * n]) for i in range(3))
        start += inputs[:, first : first + 2 * count].reshape(-1, count, 2)
        sizes, units = zip(*map(_sized, (start, start + D)), strict=True)
        rate = np.sum(units[0] * rates, axis=2)
        of_rate = (rates - units[0] * rate[..., None]) / sizes[0][..., None]
        of_length = [sizes[0], sizes[1] - sizes[0], rate]
        sums = np.stack([values.sum(axis=1) for values in of_length], axis=1)
        rest = [inputs[:, 3 * n : first], inputs[:, first + 2 * count :]]
        return _Pieces(units[0], units[1], of_rate, np.hstack([sums, *rest]))

    def _ways(self, values: np.ndarray) -> np.ndarray:
        """Vectors (k, pieces, 2) between points, of coordinates (k, n)."""
        columns = self._moves[:, None] + np.arange(2)
        return np.diff(np.where(self._moves[:, None] < 0, 0.0, values[:, columns]), axis=1)

    def on_points(self, of_pieces: np.ndarray) -> np.ndarray:
        """Derivatives (k, n) by the coordinates from those (k, pieces, 2) by the pieces."""
        none = np.zeros_like(of_pieces[:, :1])
        of_points = -np.diff(np.concatenate([none, of_pieces, none], axis=1), axis=1)
        return of_points[:, self._moves >= 0].reshape(len(of_pieces), -1)


class _LineValues(NamedTuple):
    """Values of a function of the length."""

    law: LineLaw
    of_length: PointFunction

    def in_rows(self, inputs: np.ndarray) -> np.ndarray:
        """Values (k, size) of what the law is given (k, given)."""
        return self.of_length.in_rows(self.law.pieces(inputs).given)


class _LineDerivatives(NamedTuple):
    """Derivatives of a function of the length by all that the law of the line is given."""

    law: LineLaw
    of_length: PointFunction

    def in_rows(self, inputs: np.ndarray) -> np.ndarray:
        """Derivatives (k, given) for what the law is given (k, given)."""
        law, pieces = self.law, self.law.pieces(inputs)
        slopes = self.of_length.in_rows(pieces.given)
        start, path, rate = (slopes[:, i, None, None] for i in range(3))
        at_start = (start - path) * pieces.start + path * pieces.end + rate * pieces.of_rate
        motion = at_start, path * pieces.end, rate * pieces.start
        numbers = 5 + law.law.internal + law.law.iteration_memory
        of_ways = at_start.reshape(len(slopes), -1)
        middle, rest = slopes[:, 3:numbers], slopes[:, numbers:]
        return np.hstack([*map(law.on_points, motion), middle, of_ways, rest])


def _sized(vectors: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lengths (k, pieces) of vectors (k, pieces, 2), and unit vectors."""
    sizes = np.sqrt(np.sum(vectors * vectors, axis=2) + TINY)
    return sizes, vectors / sizes[..., None]


def laws_of_forces(laws: Sequence[PointLaw], rule: StepRule) -> list[Any]:
    """Compiled laws of forces at points, also of lines over points."""
    compiled = compiled_laws([law.of_length or law for law in laws], rule)
    return [
        LineLaw(law, compiled_law, rule.level) if law.of_length else compiled_law
        for law, compiled_law in zip(laws, compiled, strict=True)
    ]
