"""Section forces at places as outputs: their derivatives, by the balance of an element."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from fx_beam.dual import Dual, dual_array, floats
from fx_beam.fem.beam_slopes import BeamSlopes
from fx_beam.fem.loads import LoadedBeams
from fx_beam.fem.mass import masses_of_points
from fx_beam.laws.interval import StepBatch, just_inside
from fx_beam.motions.element_balance import ElementLoads, components, directions
from fx_beam.motions.numbers import OF_OUTPUT
from fx_beam.results.section_forces import AT_NODE, BeamBalance
from fx_beam.scene.beam import BeamPlace, lagrange
from fx_beam.scene.loads import Load
from fx_beam.scene.measured import Measured
from fx_beam.scene.outputs import Output, is_section_force
from fx_beam.scene.scene import Scene
from fx_beam.step.layout import Arrays
from fx_beam.step.model import Model
from fx_beam.step.tape import Tape

from .gradient import DerivativeBlock, DualArrays, of_names, of_rows
from .row_output import Needs, RowOutput, RowPlaces, numbers_of_output

# Numbers of a section force: masses (points,) at Gauss points of its element; directions (2 + m,)
# at its ends and where m forces and couples act inside; these (sub-steps + 1, m, 3), and dead loads
# (sub-steps + 1, width) on it, the last at the start.
_MASSES, _DIRECTIONS, _INSIDE, _DEAD = "masses", "directions", "forces inside", "dead loads"
# Components of N, Q and M that an output of a section has.
_COMPONENTS = {"N": [0], "Q": [1], "M": [2], "stress": [0, 2], "shear_stress": [1]}
# Step of differences of polynomials of the fourth degree, which are exact.
_STEP = 1e-2


def numbers_of_sections(
    model: Model, tape: Tape, rest_time: float | None, scene: Scene, known: Mapping[str, object]
) -> DualArrays:
    """Numbers of a scene in the sub-steps of a tape; equilibria have their loads at one time."""
    mesh, level, times = model.mesh, model.scheme.rates.level, tape.times
    X = mesh.positions_of(scene)
    loaded_beams = LoadedBeams.of(scene)
    loads = ElementLoads(model, loaded_beams, X)
    # Factors of the weight and of loads in the sub-steps, and at the start.
    if rest_time is not None:
        weight_factors = np.append(tape.memories, 0.0)[:, None]
        factors = weight_factors * loads.dead.series(np.array([rest_time]))
    else:
        t0, t1 = (np.append(t, times.starts[:1]) for t in (times.starts, times.ends))
        both_ends = loads.dead.in_steps(t0, t1, model.scheme.rates.mean_based)
        factors = (1 - level) * both_ends[:, 0] + level * both_ends[:, 1]
        weight_factors = np.ones((len(t0), 1))

    def in_steps(load: Load) -> np.ndarray | Dual:
        """A force or couple (sub-steps + 1, 3)."""

        def values(t: np.ndarray) -> np.ndarray | Dual:
            return load.value.series(t, str(load), scene.array_calls)

        if rest_time is not None:
            parts = weight_factors * values(np.array([rest_time]))
        else:
            start, end = just_inside(t0, t1)
            parts = (1 - level) * values(start) + level * values(end)
        none = np.zeros((len(weight_factors), 3 - parts.shape[1]))
        return np.concatenate([parts, none] if load.kind == "force" else [none, parts], axis=1)

    numbers: DualArrays = {}
    for name, output in known.items():
        if not (isinstance(output, Output) and is_section_force(output)):
            continue
        place = output.of
        assert isinstance(place, BeamPlace)
        cell = _cell(model, place)
        inside = loads.inside(place.beam.name)
        inside = [load for load in inside if _cell(model, load.target) == cell]
        known_places = dual_array([load.target.element[1] for load in inside])
        angles = directions(X[mesh.elements[[cell]]], [0.0, 1.0, *floats(known_places)])[0]
        forces = [np.zeros((len(weight_factors), 0)), *map(in_steps, inside)]
        numbers |= {
            _MASSES + OF_OUTPUT + name: dual_array(loads.masses)[cell],
            _DIRECTIONS + OF_OUTPUT + name: angles,
            _INSIDE + OF_OUTPUT + name: np.concatenate(forces, axis=1),
            _DEAD + OF_OUTPUT + name: _on_element(loads, cell, factors, weight_factors),
        }
        if inside:  # by which nothing has derivatives
            numbers[f"places of loads in the element of {name!r}"] = known_places
    return numbers


def _cell(model: Model, place: BeamPlace) -> int:
    """Number of the element of a place."""
    names = [beam.name for beam in model.scene.beams]
    return int(model.mesh.cells[names.index(place.beam.name)][place.element[0]])


def _on_element(
    loads: ElementLoads, cell: int, factors: np.ndarray | Dual, weight_factors: np.ndarray
) -> np.ndarray | Dual:
    """Dead loads (sub-steps + 1, width) on an element."""
    dofs, dead = loads.torn.unknowns.dofs[cell], loads.dead
    width, columns = len(dofs), len(dead.starts) - 1
    place = np.full(loads.torn.dofs.size, -1)
    place[dofs] = np.arange(width)
    there = np.flatnonzero(place[dead.rows] >= 0)
    column = np.repeat(np.arange(columns), np.diff(dead.starts))[there]
    flat = column * width + place[dead.rows[there]]
    unit = np.bincount(flat, dead.entries[there], columns * width).reshape(columns, width)
    total = factors @ unit
    if loads.weight is not None:
        total = total + weight_factors * loads.weight[dofs]
    return total


def _shares(component: int, degree: int, x: float, h: float, inside: np.ndarray) -> np.ndarray:
    """Shares (6 + 3 m + degree,) in N, Q or M at a place x of an element of the length h.

    Of N, Q, M at both ends, of jumps at places `inside` (m,), and of values at Gauss points.
    """
    first = 6 + 3 * len(inside)
    units = np.eye(first + degree)
    gauss = np.zeros((len(units), degree, 3))
    gauss[..., component] = units[:, first:]
    ends, jumps = units[:, :6].reshape(-1, 1, 2, 3), units[:, 6:first].reshape(len(units), -1, 3)
    balance = BeamBalance(np.array([0.0, h]), ends, inside * h, jumps)
    return balance.in_elements(gauss, np.array([x]), AT_NODE * h)[component].ravel()


class _Element(NamedTuple):
    """The element of an output of a section."""

    cell: int
    #: Degrees of freedom (width,) of its nodes, and of their rotations (degree + 1,).
    dofs: np.ndarray
    turns: np.ndarray
    #: Places (m,) from 0 to 1 of forces and couples inside; shares (2 + m, degree + 1) of nodes in
    #: rotations at the ends and there.
    inside: np.ndarray
    turn_shares: np.ndarray
    #: Places (2, 3) of the forces at its ends in those of all its nodes.
    end_places: np.ndarray

    @classmethod
    def of(cls, model: Model, measured: Measured) -> _Element:
        """The element of an output."""
        cell, mesh, beam = _cell(model, measured.place), model.mesh, measured.place.beam
        dofs, ends = mesh.unknowns.dofs[cell], mesh.dofs[mesh.elements[cell, [0, -1]]]
        end_places = np.argsort(dofs)[np.searchsorted(np.sort(dofs), ends)]
        loads = (load.target for load in model.scene.loads if isinstance(load.target, BeamPlace))
        own = [at for at in loads if at.beam.name == beam.name and _cell(model, at) == cell]
        inside, turns = np.array([at.element[1] for at in own]), mesh.dofs[mesh.elements[cell], 2]
        places = np.concatenate([[0.0, 1.0], floats(inside)])
        shares = lagrange(np.linspace(0.0, 1.0, len(turns)), places)
        return cls(cell, dofs, turns, inside, shares, end_places)


class SectionOutput(RowOutput):
    """N, Q or M at a place, or a stress as their sum, at the rows (n,) of a run."""

    record = "rates"

    def __init__(self, places: RowPlaces, name: str, measured: Measured):
        super().__init__(places, name, measured)
        self._name, model = name, self._sub_steps.model
        assert model.forms.beams is not None
        self._beams = model.forms.beams
        self._element = _Element.of(model, measured)
        #: Components of N, Q and M in it.
        self._components = _COMPONENTS[measured.name]
        self._rows, self._steps, self._shares = places.means()
        self._read(places.numbers)

    @classmethod
    def needs(cls, model: Model, measured: Measured) -> Needs:
        """As of `RowOutput`."""
        return Needs(rates=True, start=True, steps=True, whole=True)

    def _read(self, numbers: Arrays) -> None:
        """Find the forces of the element, and how the output follows from what it depends on."""
        element, places = self._element, self._places
        model, count, degree = self._sub_steps.model, len(places.ends), self._beams.kind.degree
        kinds = _MASSES, _DEAD, _INSIDE
        masses, dead, loads_inside = (numbers[self._number(kind)] for kind in kinds)
        widths = len(element.dofs), 2 + len(element.inside), 3 * len(element.inside)
        forces, turns, inside = (np.zeros((count, size)) for size in widths)
        gauss = np.zeros((count, degree, 3))
        for group, parts in self._batches(np.arange(len(self._steps))):
            rows, share = self._rows[group], self._shares[group, None]
            node_forces = self._beams.forces_of_cells(parts)[:, element.cell]
            np.add.at(forces, rows, share * (node_forces - dead[self._steps[group]]))
            level = parts.q + model.scheme.rates.level * parts.D
            np.add.at(turns, rows, share * (level[:, element.turns] @ element.turn_shares.T))
            np.add.at(inside, rows, share * loads_inside[self._steps[group]])
            points = self._beams.resultants(parts)[:, element.cell]
            np.add.at(gauss, rows, share[..., None] * points)
        mass = None
        if not model.scheme.rates.at_rest:
            a = self._accelerations(numbers)
            mass = np.tensordot(masses, masses_of_points(degree), 1)
            forces += a @ mass
        signs, angles = np.array([[-1.0], [1.0]]), numbers[self._number(_DIRECTIONS)] + turns
        # Of what acts at the ends, and of jumps inside.
        acting = [signs * forces[:, element.end_places], -inside.reshape(count, -1, 3)]
        ends = components(np.concatenate(acting, axis=1), angles)
        x, h, *weights = numbers[numbers_of_output(self._name)]
        if not weights:  # of N, Q or M itself
            weights = np.eye(3)[self._components[0]]
        flat, first = ends.reshape(count, -1), ends[0].size
        values = [np.hstack([flat, gauss[..., k]]) for k in self._components]

        def all_shares(x: float, h: float) -> list[np.ndarray]:
            return [_shares(k, degree, x, h, element.inside) for k in self._components]

        def slope(change: np.ndarray) -> np.ndarray:
            """Along a change of x and h: shares are polynomials of the fourth degree at most."""
            points = zip(*(all_shares(*((x, h) + k * change)) for k in (-2, -1, 1, 2)), strict=True)
            parts = zip(self._components, values, points, strict=True)
            differences = np.array([1.0, -8.0, 8.0, -1.0]) / 12
            return sum(weights[k] * (v @ np.array(p).T @ differences) for k, v, p in parts)

        # Not over a place at which M bends.
        step = min(abs(element.inside - x) / 3, default=_STEP)
        steps = np.diag([min(step, _STEP) or _STEP, _STEP * h])
        number_slopes = np.zeros((count, len(numbers[numbers_of_output(self._name)])))
        number_slopes[:, :2] = np.stack([slope(step) for step in steps], axis=1) / np.diag(steps)
        shares, own = np.zeros(first), np.zeros((degree, 3))
        for k, component_values, component_shares in zip(
            self._components, values, all_shares(x, h), strict=True
        ):
            shares += weights[k] * component_shares[:first]
            own[:, k] = weights[k] * component_shares[first:]
            if number_slopes.shape[1] > 2:
                number_slopes[:, 2 + k] = component_values @ component_shares
        end_shares = shares.reshape(-1, 3)
        angle_slopes = end_shares[:, 0] * ends[..., 1] - end_shares[:, 1] * ends[..., 0]
        c, s, (N, Q, M) = np.cos(angles), np.sin(angles), end_shares.T
        end_slopes = np.stack([c * N - s * Q, s * N + c * Q, np.broadcast_to(M, c.shape)], axis=-1)
        #: Derivatives by forces (n, width) on the nodes and (n, 3 m) inside, angles (n, 2 + m), and
        #: values (degree, 3) at the Gauss points; blocks of those that are no sums over sub-steps.
        self._inside_slopes = -end_slopes[:, 2:].reshape(count, -1)
        self._force_slopes, self._angle_slopes = np.zeros_like(forces), angle_slopes
        self._gauss_slopes = own
        self._force_slopes[:, element.end_places] = signs * end_slopes[:, :2]
        every = np.arange(count)
        self._row_blocks = [of_rows(numbers_of_output(self._name), every, number_slopes)]
        self._row_blocks.append(of_rows(self._number(_DIRECTIONS), every, angle_slopes))
        if mass is not None:
            point_slopes = np.einsum("nw,pwv->npv", self._force_slopes, masses_of_points(degree))
            point_slopes = np.einsum("npv,nv->np", point_slopes, a)
            self._row_blocks.append(of_rows(self._number(_MASSES), every, point_slopes))
            self._row_blocks += self._by_accelerations(self._force_slopes @ mass)

    def _number(self, kind: str) -> str:
        """The name of numbers of a kind."""
        return kind + OF_OUTPUT + self._name

    def _accelerations(self, numbers: Arrays) -> np.ndarray:
        """Forces (n, width) on the nodes of the element: means over the steps."""
        places, dofs, moved = self._places, self._element.dofs, self._places.moved
        v = self._sub_steps.states[self._sub_steps.rates][:, dofs]
        a = np.zeros((len(places.ends), len(dofs)))
        change = v[places.ends[moved]] - v[places.starts[moved]]
        a[moved] = change / places.steps.lengths[moved, None]
        if len(places.at_start):
            a[places.at_start] = numbers["a"][dofs]
        return a

    def _batches(self, chosen: np.ndarray) -> Iterator[tuple[np.ndarray, StepBatch]]:
        """Sub-steps, some of all, in groups."""
        for group in self._sub_steps.groups(chosen):
            numbers, tape = chosen[group], self._sub_steps.tape
            parts = self._sub_steps.parts(self._steps[numbers])
            if self._sub_steps.model.scheme.rates.at_rest:
                parts = parts._replace(load_factor=tape.memories[self._steps[numbers]])
            yield numbers, parts

    def blocks(self, rows: np.ndarray) -> Iterator[DerivativeBlock]:
        """Derivatives of the output in some of the rows."""
        for chosen, parts in self._batches(np.flatnonzero(np.isin(self._rows, rows))):
            yield from self._of_steps(chosen, parts)
        yield from self._row_blocks

    def _of_steps(self, chosen: np.ndarray, parts: StepBatch) -> Iterator[DerivativeBlock]:
        """By what forms read of some sub-steps, and by dead loads in them."""
        sub_steps, element = self._sub_steps, self._element
        steps, rows, shares = self._steps[chosen], self._rows[chosen], self._shares[chosen, None]
        model, weights = sub_steps.model, shares * self._force_slopes[rows]
        beams = BeamSlopes(self._beams)
        by_name = beams.forces(parts, sub_steps.has_places, weights, element.cell)
        for k in self._components:
            if not self._gauss_slopes[:, k].any():
                continue
            blocks = beams.resultants(parts, sub_steps.has_places, k)
            for name, entries, point_values in blocks:
                values = self._gauss_slopes[:, k] @ point_values[:, element.cell]
                block = DerivativeBlock(name, entries[element.cell], rows, shares * values)
                yield from sub_steps.in_steps(steps, [block])
        for name, factor in (("increment", model.scheme.rates.level), ("start", 1.0)):
            turned = by_name.setdefault(name, np.zeros((len(chosen), model.size)))
            angle_slopes = self._angle_slopes[rows] @ element.turn_shares
            turned[:, element.turns] += factor * shares * angle_slopes
        yield from sub_steps.in_steps(steps, of_names(rows, by_name))
        loads = np.where(steps < 0, len(sub_steps.tape), steps)
        yield of_rows(self._number(_DEAD), rows, -weights, loads)
        yield of_rows(self._number(_INSIDE), rows, shares * self._inside_slopes[rows], loads)

    def _by_accelerations(self, slopes: np.ndarray) -> Iterator[DerivativeBlock]:
        """By rates and accelerations at the start, from derivatives (n, width) by means."""
        places, moved = self._places, self._places.moved
        dofs, rates = self._element.dofs, self._sub_steps.rates
        rate_slopes = slopes[moved] / places.steps.lengths[moved, None]
        for states, sign in ((places.ends, 1.0), (places.starts, -1.0)):
            yield DerivativeBlock(rates, dofs, moved, sign * rate_slopes, states[moved])
        if len(places.at_start):
            yield DerivativeBlock("a", dofs, places.at_start, slopes[places.at_start])
