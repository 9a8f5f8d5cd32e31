"""The loads and natural strains of a scene over time, as sums of unit loads."""

from __future__ import annotations

import copy
import functools
import itertools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.dual import Dual, MaybeDual, dual_array, floats
from fx_beam.errors import all_of, any_of, warn_once
from fx_beam.laws.interval import Interval, just_inside
from fx_beam.scene.beam import Beam, BeamPlace, Node, gauss_rule, lagrange_and_slopes
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
        return cls(copy.copy(scene.beams), tuple(scene.loads), scene.gravity, scene.array_calls)


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
    from .nearest_values import NearestValues, ValuesOverTime

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
    from .nearest_values import NearestValues, ValuesOverTime

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
