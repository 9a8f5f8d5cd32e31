"""Values of functions of place at the Gauss points of elements, which may jump inside these."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from fx_beam.dual import Dual, MaybeDual, dual_array, floats, scene_number
from fx_beam.scene.beam import gauss_rule, lagrange
from fx_beam.scene.functions import ArrayCalls, Signal, SignalAlong, evaluate

# Places at which a function is looked at: of each element, and at least of a beam.
_LOOKS = 10, 160
# A fourth difference of values at these places, relative to the largest value, which smooth loads
# of 1.3 elements a wave do not have; a jump of 3 % of the largest value has it.
_ROUGH = 0.1
# The same of second differences of values at the points of the rule, which lead to a look.
_SUSPECT = 0.5
# Calls at which a function is looked at in any case; so it is at the last of many at once.
_REGULAR_LOOKS = frozenset([0, *(16**k for k in range(10))])
# Times whose values are read at once, and parts of elements at these times: those of more would not
# stay in the processor's cache.
_BATCH, _MOST_PARTS = 50, 20_000
# Error of the integral over a piece of an element, relative to that of the largest value over the
# element. Parts into which each element is divided at first, at least, all of a beam together, and
# each piece with a larger error; both ends of a piece.
_TOLERANCE, _PARTS, _ENDS = 1e-12, (4, 64, 32), np.array([1e-11, 1 - 1e-11])
# Places in a piece among which a jump or kink is sought, and how often those beside it are divided.
_SEEK, _SEEKS = np.linspace(0.0, 1.0, 33), 10
# Divisions, by number, at what is sought so; others are into equal parts.
_AT_CORNERS = 0, 2

# Values (n, size) of a function at n places; of several functions, by number.
_Values = Callable[[np.ndarray], MaybeDual]
_ValuesOf = Callable[[np.ndarray, int], MaybeDual]


class NearestValues:
    """Values (elements * rule, size) at the Gauss points of elements that end at some places.

    Those of a function that is smooth are its own. Those of others are values of the nearest
    polynomials, so that the rule is right for their integrals times all polynomials of its degree.
    """

    def __init__(self, ends: np.ndarray, rule: int):
        self._ends, self._lengths, self._rule = ends, np.diff(ends), gauss_rule(rule)
        # Gauss points of a piece, weights of the integral, and weights of values at its ends.
        x, weights = gauss_rule(rule + 3)
        self._piece_rule = x, weights, lagrange(x, _ENDS)
        #: Number of parts into which all elements together are divided first.
        self.parts = max(_PARTS[0], -(-_PARTS[1] // len(self._lengths))) * len(self._lengths)
        #: Places (elements * rule,) of the points.
        self.points = (ends[:-1, None] + self._lengths[:, None] * self._rule[0]).ravel()

    def of(self, function: _Values, part: Sequence[float] | None = None) -> MaybeDual:
        """Values of a function, which is zero outside a part between two places."""
        if part is not None or self.is_rough(function):
            return self.divided(lambda places, _: function(places), 1, part)[0]
        return function(self.points)

    def is_rough(self, function: _Values) -> bool:
        """Whether a function jumps or varies within elements."""
        count = max(_LOOKS[0] * len(self._lengths), _LOOKS[1])
        looks = self._ends[0] + (np.arange(count) + 0.5) / count * (self._ends[-1] - self._ends[0])
        v = floats(function(looks))
        difference = v[4:] + v[:-4] - 4 * (v[3:-1] + v[1:-3]) + 6 * v[2:-2]
        return abs(difference).max() > _ROUGH * abs(v).max()

    def is_suspect(self, values: np.ndarray) -> np.ndarray:
        """Whether values (n, points, size) at n times look so (n,)."""
        size, v = values.shape[2], values.reshape(len(values), -1)
        if values.shape[1] < 3:
            return np.zeros(len(v), bool)
        difference = v[:, 2 * size :] - 2 * v[:, size:-size] + v[:, : -2 * size]
        return abs(difference).max(axis=1) > _SUSPECT * abs(v).max(axis=1)

    def divided(
        self, functions: _ValuesOf, number: int, part: Sequence[float] | None = None
    ) -> MaybeDual:
        """Values (number, ...) of functions that jump: elements are divided where they do."""
        count = len(self._lengths)
        parts = self.parts // count
        first, last = (self._ends[0], self._ends[-1]) if part is None else part
        start, end = (
            np.clip((place - self._ends[:-1]) / self._lengths, 0.0, 1.0) for place in (first, last)
        )
        cells = np.flatnonzero(np.tile(end > start, number))  # of one function after the other
        start, width = start[cells % count], (end - start)[cells % count]
        start, width = _uniform(start, width, parts)
        cells = np.repeat(cells, parts)
        total: MaybeDual = np.zeros(())
        largest = np.zeros(number)
        division = 0
        while len(cells):
            integrals, errors, sizes = self._integrated(functions, cells, start, width)
            np.maximum.at(largest, cells // count, sizes)
            converged = errors <= _TOLERANCE * largest[cells // count]
            numbers = integrals[0].size
            places = cells[converged, None] * numbers + np.arange(numbers)
            values = integrals[converged].reshape(-1)
            total = total + np.bincount(places.ravel(), values, number * count * numbers)
            left = ~converged
            cells, start, width = cells[left], start[left], width[left]
            # A piece ends at a jump or kink; if this does not help, as at two, it is divided.
            if division in _AT_CORNERS:
                before = self._corners(functions, cells, start, width) - start
                start = np.column_stack([start, start + before]).ravel()
                width = np.column_stack([before, width - before]).ravel()
                cells = np.repeat(cells, 2)
            else:
                start, width = _uniform(start, width, _PARTS[2])
                cells = np.repeat(cells, _PARTS[2])
            division += 1
        return total.reshape(number, len(self.points), -1)

    def _at(self, functions: _ValuesOf, cells: np.ndarray, fractions: np.ndarray) -> MaybeDual:
        """Values (n, m, size) at fractions (n, m) of cells (n,), of the function of each."""
        numbers, element = np.divmod(cells, len(self._lengths))
        places = self._ends[element, None] + self._lengths[element, None] * fractions
        numbers, first = np.unique(numbers, return_index=True)
        groups = zip(np.split(places, first[1:]), numbers.tolist(), strict=True)
        values = np.concatenate([functions(group.ravel(), k) for group, k in groups])
        return values.reshape(*places.shape, -1)

    def _corners(
        self, functions: _ValuesOf, cells: np.ndarray, start: np.ndarray, width: np.ndarray
    ) -> np.ndarray:
        """Places (n,) of the largest jump, or kink, in pieces of elements, as fractions."""
        for _ in range(_SEEKS * bool(len(cells))):
            values = floats(self._at(functions, cells, start[:, None] + width[:, None] * _SEEK))
            largest = abs(np.diff(values, 2, axis=1)).max(axis=2).argmax(axis=1)
            start, width = start + width * _SEEK[largest], width * _SEEK[2]
        return start + width / 2

    def _integrated(
        self, functions: _ValuesOf, cells: np.ndarray, start: np.ndarray, width: np.ndarray
    ) -> tuple[MaybeDual, np.ndarray, np.ndarray]:
        """Integrals over pieces of elements, their errors, and the sizes of the largest values.

        The error is the width times that of an extrapolation to just inside both ends.
        """
        points, element_weights = self._rule
        inner, weights, end_weights = self._piece_rule
        fractions = start[:, None] + width[:, None] * np.concatenate([inner, _ENDS])
        values = self._at(functions, cells, fractions)
        polynomials = lagrange(points, fractions[:, :-2].ravel()) / element_weights
        polynomials = polynomials.reshape(len(cells), len(inner), -1)
        polynomials = polynomials * (width[:, None] * weights)[..., None]
        inner_values, ends = values[:, :-2], floats(values)[:, -2:]
        missed = abs(end_weights @ floats(inner_values) - ends).max(axis=(1, 2))
        sizes = abs(floats(values)).max(axis=(1, 2))
        return _integrals(polynomials, inner_values), width * missed, sizes


def _uniform(start: np.ndarray, width: np.ndarray, parts: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts and widths of equal parts of pieces."""
    width = np.repeat(width / parts, parts)
    return np.repeat(start, parts) + width * np.tile(np.arange(parts), len(start)), width


def _integrals(polynomials: np.ndarray, values: MaybeDual) -> MaybeDual:
    """Integrals (n, k, size) of values at points of n pieces, with slopes that they have."""
    if isinstance(values, Dual):
        slopes = np.einsum("npk,npsm->nksm", polynomials, values.slopes)
        return Dual(_integrals(polynomials, values.values), slopes)
    return np.einsum("npk,nps->nks", polynomials, values)


class ValuesOverTime(Signal):
    """The nearest values of a function of place and time as a function of time (points size,).

    The function is evaluated between the points in some calls (`_REGULAR_LOOKS`), and where its
    values at the points may belong to a jump. After a jump the elements are divided at all times.
    """

    def __init__(self, function: SignalAlong, nearest: NearestValues):
        super().__init__(function, len(nearest.points) * function.size)
        self._nearest, self._values_at = nearest, function.values_at
        self._is_rough, self._calls, self._next_look = False, 0, 0

    def __call__(self, *arguments: float) -> np.ndarray:
        """The values at a time [s]."""
        return scene_number(self._at([*arguments], lambda function, t: function(t))[0])

    def series(self, times: np.ndarray, name: str, arrays: ArrayCalls | None = None) -> MaybeDual:
        """Values (n, ...) at n times; StepError if the function fails."""
        call = functools.partial(evaluate, name=name)
        batch = max(1, min(_BATCH, _MOST_PARTS // self._nearest.parts))
        parts = (times[k : k + batch].tolist() for k in range(0, len(times), batch))
        return np.concatenate([self._at(part, call) for part in parts])

    def _at(self, times: list[float], call: Callable) -> MaybeDual:
        values_at, nearest = self._values_at, self._nearest

        def at_points(t: float) -> MaybeDual:
            return values_at(nearest.points, t)

        def is_rough(t: float) -> bool:
            return nearest.is_rough(lambda places: values_at(places, t))

        def at_places(places: np.ndarray, k: int) -> MaybeDual:
            return call(lambda t: values_at(places, t), times[k])

        if not self._is_rough:
            rows = dual_array([call(at_points, t) for t in times])
            self._is_rough = any(call(is_rough, times[k]) for k in self._looks(floats(rows)))
        if self._is_rough:
            rows = nearest.divided(at_places, len(times))
        return rows.reshape(len(times), -1)

    def _looks(self, rows: np.ndarray) -> Iterator[int]:
        """Of times with values (n, points, size) those at which to look between the points."""
        first, self._calls = self._calls, self._calls + len(rows)
        # The last of many is looked at, else a load that comes is seen late.
        last = len(rows) - 1 if len(rows) >= _BATCH // 2 else -1
        for k, suspect in enumerate(self._nearest.is_suspect(rows).tolist()):
            call = first + k
            if call in _REGULAR_LOOKS or k == last or (suspect and call >= self._next_look):
                yield k
                if suspect:
                    self._next_look = 2 * call + 1
