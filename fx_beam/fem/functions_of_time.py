"""Parameters, loads and natural strains of a scene over time, and functions of place in it."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.content_cache import shallow_copy
from fx_beam.dual import Dual, MaybeDual, dual_array, floats, scene_number
from fx_beam.errors import SceneError, all_of, any_of, warn_once
from fx_beam.laws.interval import Interval, just_inside
from fx_beam.scene.beam import Beam, BeamPlace, Node, gauss_rule, lagrange, lagrange_and_slopes
from fx_beam.scene.body import Members
from fx_beam.scene.functions import (
    Accelerogram,
    ArrayCalls,
    Signal,
    SignalAlong,
    constant,
    evaluate,
)
from fx_beam.scene.loads import NAMES, ON_MASSES, Load, values_along
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError

from .mesh import Mesh

# -- The parameters of a scene at one time: one array, which forms and laws read ----------------


class ParameterFunctions:
    """The parameters of a scene as functions of time, in its order."""

    def __init__(self, scene: Scene):
        functions = scene.parameters.functions
        self.names, self.functions = [*functions], [*functions.values()]
        self._arrays = scene.array_calls

    def check(self, other: ParameterFunctions) -> None:
        """OtherStructureError if others vary that do not here, or conversely."""
        pairs = zip(self.functions, other.functions, strict=True)
        if any([a.is_constant != b.is_constant for a, b in pairs]):
            raise OtherStructureError("parameters that were constant vary in time, or conversely")

    def values_at(self, t: float) -> np.ndarray:
        """The values (n,) at a time [s]; StepError if a function fails."""
        pairs = zip(self.functions, self.names, strict=True)
        return np.array([evaluate(f, t, f"parameter {name!r}")[0] for f, name in pairs])

    def series(self, times: np.ndarray) -> MaybeDual:
        """Values (times, n) at some times [s]."""
        pairs = zip(self.functions, self.names, strict=True)
        rows = [f.series(times, f"parameter {name!r}", self._arrays) for f, name in pairs]
        return np.hstack(rows) if rows else np.empty((len(times), 0))

    def over_steps(self, t0: np.ndarray, t1: np.ndarray, level: float) -> MaybeDual:
        """Values (steps, 2, n) at the level of steps and at their ends."""
        return np.stack([self.series(t0 + level * (t1 - t0)), self.series(before(t1))], axis=1)


class ParameterValues:
    """Present values of all parameters of a scene; forms and laws are told of changes."""

    def __init__(self, signals: ParameterFunctions):
        self.signals, self.names = signals, signals.names
        #: Present values (n,).
        self.values = np.zeros(len(self.names))
        self._readers: list[Callable[[np.ndarray], None]] = []
        #: Whether stored energies depend on values that vary.
        self.energies_vary = False
        self._held = False
        self.set_functions(signals)

    def set_functions(self, signals: ParameterFunctions) -> None:
        """Take the values of the same parameters of a scene, by their functions of time."""
        if self.names:
            self.signals, self._held = signals, False
            self.use(self.values_at(0.0))

    def in_block(self, block: Any) -> ParameterValues:
        """Parameters whose values are in the block of a run; what reads them is to be added."""
        if not self.names:
            return self
        other = shallow_copy(self)
        other.values, other._readers = block.view(self.values), []
        return other

    def __len__(self):
        return len(self.names)

    @property
    def functions(self) -> list[Signal]:
        """Their functions of time."""
        return self.signals.functions

    @property
    def vary(self) -> bool:
        """Whether any changes in time."""
        return not (self._held or all(f.is_constant for f in self.functions))

    def check_constant(self, name: str, subject: str) -> None:
        """SceneError if there is no such parameter, or if it varies in time."""
        value = dict(zip(self.names, self.functions, strict=True)).get(name)
        if value is None or not value.is_constant:
            lacks = "is not in the scene" if value is None else "varies in time"
            raise SceneError(
                f"{subject}: the parameter {name!r} {lacks}. Give it a number by "
                f"scene.add_parameter(fx_beam.Parameter({name!r}, ...))"
            )

    def indices(self, names: Sequence[str]) -> list[int]:
        """Indices of some parameters."""
        return [self.names.index(name) for name in names]

    def add_energies(self, names: Sequence[str]) -> None:
        """Note the parameters on which some stored energies depend."""
        varies = (self.functions[i] for i in self.indices(names))
        self.energies_vary |= not all(function.is_constant for function in varies)

    def add_reader(self, read: Callable[[np.ndarray], None]) -> None:
        """Add a function of the values (n,), which is called after each change of them."""
        if self.names:
            self._readers.append(read)
            read(self.values)

    def hold(self, t: float) -> None:
        """Keep the values at a time [s], as in statics."""
        if self.names:
            self.use(self.signals.values_at(t))
            self._held = True

    def set_step_values(self, level: float, values: np.ndarray | None = None) -> None:
        """Set the values of a step: at the time of its level [s], or `values` (n,)."""
        self.use(self.values_at(level) if values is None else values)

    def use(self, values: np.ndarray | None) -> None:
        """Set the values (n,)."""
        if self.names:
            self.values[:] = values
            for reader in self._readers:
                reader(self.values)

    def values_at(self, t: float) -> np.ndarray:
        """The values (n,) at a time [s]; StepError if a function fails."""
        return self.values.copy() if self._held else self.signals.values_at(t)

    def at_times(self, times: np.ndarray) -> MaybeDual:
        """The values (times, n) at some times [s]."""
        if self._held or not self.names:
            return np.tile(self.values, (len(times), 1))
        return self.signals.series(times)


def before(t):
    """Times just before some [s], but not before 0: a jump at that very time has yet to come."""
    return np.maximum(t - 4 * np.spacing(t), np.minimum(t, 0.0))


# -- Values of functions of place at the Gauss points of elements, which may jump inside these --


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


# -- The loads and natural strains of a scene over time, as sums of unit loads ------------------


# The function of time of a load that is constant in time.
_ONE = constant(np.ones(1))


def line_forces(
    mesh: Mesh, X: np.ndarray, number: int, rule: int, projected: bool = False
) -> scipy.sparse.csc_matrix:
    """Forces (size, 2 n) at the nodes of a beam of unit loads along x and y at its n Gauss points.

    They are the weights of a Gauss rule times the Lagrange polynomials of the nodes. Loads are per
    arc length, or per length `projected` across each.
    """
    elements = mesh.elements[mesh.cells[number]]
    degree = elements.shape[1] - 1
    weights, shape, slope = element_rule(degree, rule)
    tangent = slope @ X[elements]  # (elements, rule, 2)
    stretch = np.repeat(np.linalg.norm(tangent, axis=-1, keepdims=True), 2, axis=-1)
    lengths = abs(tangent[..., ::-1]) if projected else stretch
    forces = (weights[:, None] * lengths)[..., None] * shape[:, None]  # (..., 2, degree + 1)
    rows = mesh.dofs[elements, :2].swapaxes(1, 2)  # (elements, 2, degree + 1)
    rows = np.broadcast_to(rows[:, None], forces.shape)
    starts = np.arange(0, forces.size + 1, degree + 1)
    parts = forces.ravel(), rows.ravel(), starts
    return scipy.sparse.csc_matrix(parts, (mesh.dofs.size, len(starts) - 1))


@functools.cache
def element_rule(degree: int, points: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Weights (points,), and polynomials of equidistant nodes (points, degree + 1), and slopes."""
    gauss_points, weights = gauss_rule(points)
    return weights, *lagrange_and_slopes(np.linspace(0.0, 1.0, degree + 1), gauss_points)


class UnitLoad(NamedTuple):
    """Columns (values, rows, and entries of each) of unit loads with one function of time."""

    function: Signal
    #: What it is, for messages.
    what: str
    values: MaybeDual
    rows: np.ndarray
    counts: np.ndarray


class SumOfLoads:
    """A sum of unit loads of a scene, which are constant columns, each times a function of time."""

    def __init__(self, loads: list[UnitLoad], shape: tuple[int, ...], arrays: ArrayCalls | None):
        self._loads, self._arrays = loads, arrays
        #: Shape of the sum, and the number of all values in it.
        self.shape, self.size = shape, math.prod(shape)
        ends = np.cumsum([0, *(len(load.counts) for load in loads)]).tolist()
        columns = itertools.starmap(slice, itertools.pairwise(ends))
        #: Columns of unit loads with their functions of time.
        self.functions = list(zip(columns, (load.function for load in loads), strict=True))
        counts = np.concatenate([np.zeros(1, dtype=int), *(load.counts for load in loads)])
        #: Entries of the columns, with slopes that the scene has; their rows; starts of columns.
        self.entries: MaybeDual = np.concatenate([np.empty(0), *(load.values for load in loads)])
        self.rows = np.concatenate([np.empty(0, dtype=int), *(load.rows for load in loads)])
        self.starts = np.cumsum(counts)

    @property
    def unit_loads(self) -> scipy.sparse.csc_matrix:
        """Unit loads, as a matrix (size, n)."""
        parts = floats(self.entries), self.rows, self.starts
        return scipy.sparse.csc_matrix(parts, (self.size, len(self.starts) - 1))

    def check(self, other_loads: SumOfLoads) -> None:
        """OtherStructureError if others act on other degrees of freedom."""
        pairs = (self.rows, other_loads.rows), (self.starts, other_loads.starts)
        if not all(len(a) == len(b) and all_of(a == b) for a, b in pairs):
            raise OtherStructureError("loads act on other degrees of freedom")

    @property
    def constant(self) -> bool:
        """Whether all loads are constant in time."""
        return all(function.is_constant for _, function in self.functions)

    def sum_at(self, t: float) -> np.ndarray:
        """Their sum at the time t [s]; StepError if a function fails."""
        if not self.functions:
            return np.zeros(self.shape)
        return floats(self._sum(floats(self.entries), [*map(floats, self._factors(t))]))

    def numbers_at(self, t: float) -> MaybeDual:
        """The sum at the time t [s], with slopes that the scene has."""
        return self._sum(self.entries, [*map(dual_array, self._factors(t))])

    def _sum(self, entries: MaybeDual, factors: list[MaybeDual]) -> MaybeDual:
        columns = np.repeat(np.arange(len(self.starts) - 1), np.diff(self.starts))
        values = entries * np.concatenate(factors)[columns]
        return np.bincount(self.rows, values, self.size).reshape(self.shape)

    def _factors(self, t: float) -> list[np.ndarray]:
        return [evaluate(load.function, t, load.what) for load in self._loads]

    def series(self, times: np.ndarray) -> MaybeDual:
        """Factors (m, n) of the columns at m times [s]; StepError if a function fails."""
        values = [load.function.series(times, load.what, self._arrays) for load in self._loads]
        if len(values) == 1 and isinstance(values[0], Dual):
            return values[0]
        return np.concatenate([np.empty((len(times), 0)), *values], axis=1)

    def in_steps(self, t0: np.ndarray, t1: np.ndarray, by_means: bool) -> MaybeDual:
        """Factors (m, 2, n) of the columns at the starts and ends of m steps from t0 to t1 [s].

        Where a step goes over samples of a record, its mean over the step at both, if `by_means`.
        """
        if not self:
            return np.empty((len(t0), 2, 0))
        starts, ends = just_inside(t0, t1)
        both = self.series(np.stack([starts, ends], axis=1).ravel())
        values = both.reshape(len(t0), 2, len(self.starts) - 1)
        for columns, function in self.functions if by_means else ():
            if isinstance(function, Accelerogram):
                over = function.goes_over_samples(starts, ends)
                means = function.means(t0, np.where(over, t1, t0 + 1.0))[:, None, None]
                of_record = np.arange(len(self.starts) - 1) == columns.start
                values = np.where(over[:, None, None] & of_record, means, values)
        return values

    def __bool__(self):
        return bool(self.functions)


class LoadedBeams(NamedTuple):
    """Beams of a scene and what acts on them, as they are when its numbers are set."""

    beams: Members[Beam]
    loads: tuple[Load, ...]
    gravity: np.ndarray | None
    array_calls: ArrayCalls | None

    @classmethod
    def of(cls, scene: Scene) -> LoadedBeams:
        """Beams and loads that a scene has now."""
        return cls(scene.beams.copy(), tuple(scene.loads), scene.gravity, scene.array_calls)


def dead_loads(
    scene: Scene | LoadedBeams,
    mesh: Mesh,
    X: np.ndarray,
    weights: Callable[[tuple[float, float]], MaybeDual],
    chosen: Sequence[Load] | None = None,
) -> SumOfLoads:
    """Dead loads, all or those chosen, at nodes X (n, 2), with weights by accelerations."""
    loads = [
        _unit_load(scene, mesh, X, load) if load.target else _on_masses(mesh, load, weights)
        for load in (scene.loads if chosen is None else chosen)
        if not load.follower
    ]
    return SumOfLoads(loads, (mesh.dofs.size,), scene.array_calls)


def _on_masses(
    mesh: Mesh, load: Load, weights: Callable[[tuple[float, float]], MaybeDual]
) -> UnitLoad:
    """By the weights of unit accelerations; those of a base act the other way."""
    directions, sign = ON_MASSES[load.kind]
    columns, rows = mesh.dofs[:, directions], mesh.dofs[:, directions].T.ravel()
    values = sign * weights((1.0, 1.0))[rows]
    if not any_of(floats(values)):
        warn_once(f"{load} acts on no mass. Give sections rho or rhoA, or add masses")
    return UnitLoad(load.value, str(load), values, rows, np.full(columns.shape[1], len(columns)))


def _unit_load(scene: Scene | LoadedBeams, mesh: Mesh, X: np.ndarray, load: Load) -> UnitLoad:
    """At a node, or at the Gauss points that integrate the interpolation of a beam exactly."""
    function, target = load.value, load.target
    assert target is not None
    if isinstance(target, Node):
        dofs = mesh.dofs[target.number]
        dofs = dofs[:2] if load.kind == "force" else dofs[2:]
        ones = np.ones(len(dofs))
        return UnitLoad(function, str(load), ones, dofs, ones.astype(int))
    if isinstance(target, BeamPlace):
        return _at_place(scene, mesh, load, target)

    beam, rule = target, target.degree + 1
    unit = line_forces(mesh, X, scene.beams.number_of(beam.name), rule, load.projected)
    nearest = NearestValues(beam.s, rule)
    if isinstance(function, SignalAlong):
        function = ValuesOverTime(function, nearest)
    elif function.place:
        rows, arrays = np.unique(unit.indices), scene.array_calls
        line_values = nearest.of(lambda s: values_along(function, s, arrays), load.between).reshape(
            -1
        )
        values: MaybeDual = (unit @ floats(line_values))[rows]
        if isinstance(line_values, Dual):
            values = Dual(values, (unit @ line_values.slopes)[rows])
        return UnitLoad(_ONE, str(load), values, rows, np.array([len(rows)]))
    else:
        share = np.ones((len(nearest.points), 1))
        if load.between is not None:
            share = floats(nearest.of(lambda s: np.ones((len(s), 1)), load.between))
        unit = scipy.sparse.csc_matrix(unit @ np.kron(share, np.eye(2)))
    return UnitLoad(function, str(load), unit.data, unit.indices, np.diff(unit.indptr))


def _at_place(scene: Scene | LoadedBeams, mesh: Mesh, load: Load, place: BeamPlace) -> UnitLoad:
    """At the nodes of an element, by their polynomials there."""
    _, shares = place.shares
    nodes = mesh.elements[mesh.cells[scene.beams.number_of(place.beam.name)][place.element[0]]]
    columns = [0, 1] if load.kind == "force" else [2]
    rows = mesh.dofs[nodes][:, columns].T.ravel()
    values, counts = np.tile(shares, len(columns)), np.full(len(columns), len(shares))
    return UnitLoad(load.value, str(load), values, rows, counts)


def natural_strains(scene: Scene, mesh: Mesh) -> SumOfLoads:
    """Natural strains (cells, degree, 3) at all Gauss points."""
    degree = scene.beams[0].degree if scene.beams else 1
    parts = [(item.beam, *part) for item in scene.natural_strains for part in item.parts.items()]
    strains = [_strain(scene, mesh, degree, *part) for part in parts]
    return SumOfLoads(strains, (len(mesh.beam_of_cell), degree, 3), scene.array_calls)


def _strain(
    scene: Scene, mesh: Mesh, degree: int, beam: Beam, name: str, function: Signal
) -> UnitLoad:

    cells = mesh.cells[scene.beams.number_of(beam.name)]
    points = degree * cells[:, None] + np.arange(degree)
    rows = 3 * points.ravel() + [*NAMES].index(name)
    nearest = NearestValues(beam.s / beam.length, degree)
    counts = np.array([len(rows)])
    values: MaybeDual = np.ones(len(rows))
    subject = f"{NAMES[name]} of beam {beam.name!r}"
    if isinstance(function, SignalAlong):
        function, counts = ValuesOverTime(function, nearest), np.ones(len(rows), dtype=int)
    elif function.place:
        place_function, arrays = function, scene.array_calls
        values = nearest.of(lambda f: values_along(place_function, f, arrays)).reshape(-1)
        function = _ONE
    return UnitLoad(function, subject, values, rows, counts)


class Followers:
    """The follower forces of a scene in the frame of the section, at the level of a step."""

    def __init__(self, scene: Scene, level: float):
        self._loads = [load for load in scene.loads if load.follower]
        self._level, self._arrays = level, scene.array_calls
        #: Whether all forces are constant in time.
        self.constant = all([load.value.is_constant for load in self._loads])

    def __len__(self):
        return len(self._loads)

    def forces_in(self, interval: Interval) -> np.ndarray:
        """Forces (n, 2) [N] in a step."""
        return self.series(np.array([interval.start]), np.array([interval.end]))[0]

    def series(self, t0: np.ndarray, t1: np.ndarray) -> np.ndarray:
        """Forces (steps, n, 2) [N] in each step."""
        start, end = (
            np.stack(
                [load.value.series(times, str(load), self._arrays) for load in self._loads], axis=1
            )
            for times in just_inside(t0, t1)
        )
        return (1 - self._level) * start + self._level * end
