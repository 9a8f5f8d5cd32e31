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
# Times whose values are read at once: those of more would not stay in the processor's cache.
_BATCH = 50
# Error of the integral over a piece of an element, relative to that of the largest value over the
# element. Parts into which each element is divided at first, at least, all of a beam together, and
# each piece with a larger error; both ends of a piece.
_TOLERANCE, _PARTS, _ENDS = 1e-12, (4, 64, 32), np.array([1e-11, 1 - 1e-11])

# Values (n, size) of a function at n places.
_Values = Callable[[np.ndarray], MaybeDual]


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
        #: Places (elements * rule,) of the points.
        self.points = (ends[:-1, None] + self._lengths[:, None] * self._rule[0]).ravel()

    def of(self, function: _Values, part: Sequence[float] | None = None) -> MaybeDual:
        """Values of a function, which is zero outside a part between two places."""
        if part is not None or self.is_rough(function):
            return self.divided(function, part)
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

    def divided(self, function: _Values, part: Sequence[float] | None = None) -> MaybeDual:
        """Values of a function that jumps: elements are divided until they meet the jumps."""
        count = len(self._lengths)
        parts = max(_PARTS[0], -(-_PARTS[1] // count))
        first, last = (self._ends[0], self._ends[-1]) if part is None else part
        start, end = (
            np.clip((place - self._ends[:-1]) / self._lengths, 0.0, 1.0) for place in (first, last)
        )
        cells = np.flatnonzero(end > start)
        start, width = start[cells], (end - start)[cells]
        total: MaybeDual = np.zeros(())
        largest = 0.0
        while len(cells):
            width = np.repeat(width / parts, parts)
            start = np.repeat(start, parts) + width * np.tile(np.arange(parts), len(cells))
            cells = np.repeat(cells, parts)
            integrals, errors, size = self._integrated(function, cells, start, width)
            largest = max(largest, size)
            converged = errors <= _TOLERANCE * largest
            numbers = integrals[0].size
            places = cells[converged, None] * numbers + np.arange(numbers)
            values = integrals[converged].reshape(-1)
            total = total + np.bincount(places.ravel(), values, count * numbers)
            left = ~converged
            cells, start, width, parts = cells[left], start[left], width[left], _PARTS[2]
        return total.reshape(len(self.points), -1)

    def _integrated(
        self, function: _Values, cells: np.ndarray, start: np.ndarray, width: np.ndarray
    ) -> tuple[MaybeDual, np.ndarray, float]:
        """Integrals over pieces of elements, their errors, and the size of the largest value.

        The error is the width times that of an extrapolation to just inside both ends.
        """
        points, element_weights = self._rule
        inner, weights, end_weights = self._piece_rule
        fractions = start[:, None] + width[:, None] * np.concatenate([inner, _ENDS])
        places = self._ends[cells, None] + self._lengths[cells, None] * fractions
        values = function(places.ravel()).reshape(*places.shape, -1)
        polynomials = lagrange(points, fractions[:, :-2].ravel()) / element_weights
        polynomials = polynomials.reshape(len(cells), len(inner), -1)
        polynomials = polynomials * (width[:, None] * weights)[..., None]
        inner_values, ends = values[:, :-2], floats(values)[:, -2:]
        missed = abs(end_weights @ floats(inner_values) - ends).max(axis=(1, 2))
        largest = float(abs(floats(values)).max())
        return _integrals(polynomials, inner_values), width * missed, largest


def _integrals(polynomials: np.ndarray, values: MaybeDual) -> MaybeDual:
    """Integrals (n, k, size) of values at points of n pieces, with slopes that they have."""
    if isinstance(values, Dual):
        slopes = np.einsum("npk,npsm->nksm", polynomials, values.slopes)
        return Dual(_integrals(polynomials, values.values), slopes)
    return np.einsum("npk,nps->nks", polynomials, values)


class ValuesOverTime(Signal):
    """The nearest values of a function of place and time as a function of time (points size,).

    Between the points the function is looked at ever more rarely, and where its values there leave
    a doubt. Once it is rough, its elements are divided at all times.
    """

    def __init__(self, function: SignalAlong, nearest: NearestValues):
        super().__init__(function, len(nearest.points) * function.size)
        self._nearest, self._values_at = nearest, function.at
        self._is_rough, self._calls, self._next_look = False, 0, 0

    def __call__(self, *arguments: float) -> np.ndarray:
        """The values at a time [s]."""
        return scene_number(self._at([*arguments], lambda function, t: function(t))[0])

    def series(self, times: np.ndarray, name: str, arrays: ArrayCalls | None = None) -> MaybeDual:
        """Values (n, ...) at n times; StepError if the function fails."""
        call = functools.partial(evaluate, name=name)
        parts = (times[k : k + _BATCH].tolist() for k in range(0, len(times), _BATCH))
        return np.concatenate([self._at(part, call) for part in parts])

    def _at(self, times: list[float], call: Callable) -> MaybeDual:
        values_at, nearest = self._values_at, self._nearest

        def at_points(t: float) -> MaybeDual:
            return values_at(nearest.points, t)

        def is_rough(t: float) -> bool:
            return nearest.is_rough(lambda places: values_at(places, t))

        def divided(t: float) -> MaybeDual:
            return nearest.divided(lambda places: values_at(places, t))

        if not self._is_rough:
            rows = dual_array([call(at_points, t) for t in times])
            self._is_rough = any(call(is_rough, times[k]) for k in self._looks(floats(rows)))
        if self._is_rough:
            rows = dual_array([call(divided, t) for t in times])
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
