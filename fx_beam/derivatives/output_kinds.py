"""The kinds of outputs: energies, work, nodes, joints, beams, lines and section forces."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from fx_beam.dual import Dual, dual_array, floats
from fx_beam.errors import SceneError, all_of
from fx_beam.fem.beam_forms import BeamSlopes
from fx_beam.fem.functions_of_time import LoadedBeams
from fx_beam.fem.mass import masses_of_points
from fx_beam.fem.point_values import PointValues, energy_slopes_of_members
from fx_beam.laws.interval import StepBatch, just_inside
from fx_beam.motions.element_balance import ElementLoads, components, directions
from fx_beam.motions.motion_setup import OF_OUTPUT
from fx_beam.results.records import AT_NODE, BeamBalance
from fx_beam.scene.beam import Beam, BeamPlace, lagrange
from fx_beam.scene.loads import Load
from fx_beam.scene.outputs import Measured, Output, Read, Slope, is_section_force
from fx_beam.scene.scene import Scene
from fx_beam.step.fitted_rates import Arrays
from fx_beam.step.forcing import Forcing
from fx_beam.step.full_turns import without_turns
from fx_beam.step.model import Model
from fx_beam.step.recorded_rows import driven_of, driven_terms
from fx_beam.step.tape import Tape

from .parametrised import (
    Chosen,
    DerivativeBlock,
    DualArrays,
    Gradient,
    jvp,
    of_names,
    of_rows,
    vjp,
)
from .row_output import Needs, RowOutput, RowPlaces, SubSteps, numbers_of_output

# -- Energies, work and losses as outputs: their derivatives by states and by numbers of the scene
# The work of dead loads and driven motions is a sum over the steps, of any scheme. In each step
# of a scheme that conserves energy E + dissipated - work stays the same: so what is dissipated
# follows from the work, or other works follow from the energy and what is dissipated. Where both
# are unknown, or energy is not conserved, what is dissipated is a sum over the steps as well.


#: Derivatives (k, ...) in rows by states, with parameters and natural strains there, and by
#: numbers, by name.
Derivatives = dict[str, np.ndarray]


def by_mass_entries(model: Model, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Derivatives (..., entries) of x.M y by the entries of M."""
    row_of = np.repeat(np.arange(model.size), np.diff(model.masses.matrix.indptr))
    return x.take(row_of, axis=-1) * y.take(model.masses.matrix.indices, axis=-1)


def _momenta(model: Model, v: np.ndarray) -> np.ndarray:
    """v.M of rows (k, size); M is symmetric, and from the left it needs no transposed copy."""
    return (model.masses.matrix @ v.T).T


def _kinetic(sub_steps: SubSteps, rows: Arrays) -> Derivatives:
    """v.M v / 2."""
    model = sub_steps.model
    if model.scheme.rates.at_rest:
        return {}
    v = rows["v"]
    return {"v": _momenta(model, v), "mass": by_mass_entries(model, v, v) / 2}


def _of_fit(sub_steps: SubSteps, rows: Arrays) -> Derivatives:
    """v*.M (v* - v), the work of driven motions on the impulses with which rates v* fit."""
    model = sub_steps.model
    if "rates" not in rows or not model.couplings.driven:
        return {}
    v, rates = rows["v"], rows["rates"]
    fitting, mass_slopes = _momenta(model, rates), by_mass_entries(model, rates, rates - v)
    return {"v": -fitting, "rates": 2 * fitting - _momenta(model, v), "mass": mass_slopes}


def _strain(sub_steps: SubSteps, rows: Arrays) -> Derivatives:
    beams = sub_steps.model.forms.beams
    if beams is None:
        return {}
    names, ones = ("q", "internal", "natural", "parameters"), np.ones(len(rows["q"]))
    arrays = {name: rows[name] for name in names if name in rows}
    return BeamSlopes(beams).energy(StepBatch(ones, ones, **arrays), sub_steps.has_places)


def _potential(sub_steps: SubSteps, rows: Arrays) -> Derivatives:
    q, weight = rows["q"], sub_steps.model.masses.weight
    return {} if weight is None else {"q": np.broadcast_to(-weight, q.shape), "weight": -q}


def _springs(sub_steps: SubSteps, rows: Arrays) -> Derivatives:
    points = sub_steps.model.points
    if not points.any:
        return {}
    q, internal, ones = rows["q"], rows["spring internal"], np.ones(len(rows["q"]))
    arrays = {name: rows[name] for name in ("q", "slides", "parameters") if name in rows}
    states = StepBatch(0 * ones, ones, spring_internal=internal, **arrays)
    slopes = PointValues(points, "energy").summed_slopes(states)
    if points.members is not None:
        for name, member_slope in energy_slopes_of_members(points.members, q, internal).items():
            slopes[name] = slopes.get(name, 0.0) + member_slope
    return slopes


_PARTS: dict[str, list[Callable[[SubSteps, Arrays], Derivatives]]] = {
    "kinetic": [_kinetic, _of_fit],
    "strain": [_strain],
    "potential": [_potential],
    "springs": [_springs],
    "total": [_kinetic, _of_fit, _strain, _potential, _springs],
    # That of the steps themselves, and what driven motions do besides.
    "energy of steps": [_kinetic, _strain, _potential, _springs],
    "work of rates that fit": [_of_fit],
}


def energy_blocks(
    sub_steps: SubSteps, parts: str, ends: np.ndarray, rows: np.ndarray
) -> Iterator[DerivativeBlock]:
    """Derivatives of an energy in rows (k,), which are at `ends` (n,) among the states."""
    boundaries = sub_steps.boundaries[ends[rows]]
    for group in sub_steps.groups(boundaries):
        numbers = boundaries[group]
        states = sub_steps.states_at(numbers)
        for part in _PARTS[parts]:
            blocks = of_names(rows[group], part(sub_steps, states))
            yield from sub_steps.at_states(numbers, blocks)


class EnergyOutput(RowOutput):
    """An energy of the scene at the rows of a run."""

    def __init__(self, places: RowPlaces, name: str, measured: Measured):
        super().__init__(places, name, measured)
        self._parts = measured.quantity.of

    @classmethod
    def needs(cls, model: Model, measured: Measured) -> Needs:
        """As of `RowOutput`."""
        return Needs(rates=model.fits_rates and measured.quantity.of in ("kinetic", "total"))

    def blocks(self, rows: np.ndarray) -> Iterator[DerivativeBlock]:
        """As of `RowOutput`."""
        return energy_blocks(self._sub_steps, self._parts, self._places.ends, rows)


def why_no_losses(model: Model) -> str:
    """Why losses have no derivatives step by step; empty if they have."""
    members = model.points.members
    if members is not None and any(law.law.loss for law in members.laws):
        return "members touch with friction or losses"
    return "friction follows the force of a joint" if len(model.points.normal_forces) else ""


def losses_in_steps(sub_steps: SubSteps, rows: np.ndarray) -> Iterator[DerivativeBlock]:
    """Derivatives of the energy lost in sub-steps of a part of a tape, for `rows` among 1 to k."""
    model = sub_steps.model
    # In statics the first step leads to the equilibrium without loads, which loses nothing.
    counting = rows[rows > int(model.scheme.rates.at_rest)]
    numbers = sub_steps.tape.present.first + counting - 1
    for group in sub_steps.groups(numbers):
        steps, parts = numbers[group], sub_steps.parts(numbers[group])
        beams = model.forms.beams
        for slopes in (
            [] if beams is None else BeamSlopes(beams).losses(parts, sub_steps.has_places)
        ):
            yield from sub_steps.in_steps(steps, of_names(counting[group], slopes))
        if model.points.any_have("loss"):
            losses = PointValues(model.points, "loss")
            slopes = losses.summed_slopes(sub_steps.point_steps(steps))
            yield from sub_steps.in_steps(steps, of_names(counting[group], slopes))


#: Quantities of scenes that add up over the steps.
SINCE_START = "work", "dissipated_energy"


class Sum(NamedTuple):
    """Signs of energy, work and losses, whose sum is a quantity since the start."""

    energy: int = 0
    steps: int = 0
    losses: int = 0


def sum_of(model: Model, quantity: str) -> Sum:
    """The parts of a quantity; none of one that is not summed since the start."""
    other_work, loses = bool(_other_work(model)), model.forms.dissipate
    if quantity == "work":
        return Sum(energy=1, losses=int(loses)) if other_work else Sum(steps=1)
    if quantity not in SINCE_START or not loses:
        return Sum()
    if model.scheme.balances_energy and not other_work:
        return Sum(energy=-1, steps=1)
    return Sum(losses=1)


def _other_work(model: Model) -> str:
    """Names of what does work beside dead loads and driven motions; empty for nothing."""
    forms = model.forms
    sources = {
        "natural strains": model.data.natural,
        "added virtual works or follower forces": forms.has_added,
        "parameters of stored energies that vary": forms.parameters.energies_vary,
    }
    return ", ".join(name for name, works in sources.items() if works)


def check_work(model: Model, measured: Measured, name: str, start_reason: str) -> None:
    """Refuse work and dissipated energy that are neither sums over steps nor given by a balance.

    And those since an equilibrium before the motion, if `start_reason` says why.
    """
    parts, other_work, refusal = sum_of(model, measured.name), _other_work(model), start_reason
    if model.scheme.rates.at_rest:
        reason = why_no_work(model) if measured.name == "work" else ""
        if parts.losses and (loss_refusal := why_no_losses(model)):
            reason = f"where {loss_refusal}"
        refusal = reason and f"has no derivatives in equilibria {reason}"
    elif parts.energy and not model.scheme.balances_energy:
        refusal = (
            f"follows from the balance of energy where {other_work} do work, which is not exact "
            f"with {model.scheme.name}. Use EnergyMomentum"
        )
    elif parts.losses and (reason := why_no_losses(model)):
        advice = f", as {other_work} do work" if other_work else ". Use EnergyMomentum"
        refusal = f"is the sum of the losses of steps, without derivatives where {reason}{advice}"
    if refusal:
        raise SceneError(f"the output {name!r}, {measured.output}, {refusal}")


def why_no_work(model: Model) -> str:
    """Why the work in load steps has no derivatives; empty if it has."""
    if other_work := _other_work(model):
        return f"where {other_work} do work"
    return "of a mechanism, which also depends on how it settles" if model.mechanism else ""


class WorkOutput(EnergyOutput):
    """Work or dissipated energy since the start, at the rows of a run in a part of a tape."""

    is_sum = True

    def __init__(self, places: RowPlaces, name: str, measured: Measured):
        super().__init__(places, name, measured)
        sub_steps, model, quantity = self._sub_steps, self._sub_steps.model, measured.name
        part = sub_steps.tape.present
        self._signs = sum_of(model, quantity)
        #: Numbers of the sub-steps of the part before the rows, and of all.
        self._ends = sub_steps.boundaries[places.ends] - part.first
        self._count = part.end - part.first
        #: The energy that counts at the rows, with its sign: what no sum has; empty for none.
        self._parts, self._sign = "", self._signs.energy or 1
        if self._signs.energy:
            # Losses are those of the steps, without rates that fit.
            self._parts = "total" if quantity == "work" else "energy of steps"
        elif quantity == "work" and model.couplings.driven and model.fits_rates:
            self._parts = "work of rates that fit"
        #: Name of the sum at the start of the run, if this is in the part; else empty.
        self._start_sum = ""
        if not part.first and not model.scheme.rates.at_rest:
            self._start_sum = f"{quantity} at the start"
        #: Derivatives of the work in the steps, if it counts.
        self._work = list[DerivativeBlock]()
        if self._signs.steps:
            self._work = [*work_in_steps(sub_steps, places.column_forces())]

    @classmethod
    def needs(cls, model: Model, measured: Measured) -> Needs:
        """As of `RowOutput`."""
        driven, signs = bool(model.couplings.driven), sum_of(model, measured.name)
        return Needs(
            rates=model.fits_rates and driven and measured.name == "work",
            all_steps=bool(signs.steps or signs.losses),
            whole=bool(model.forms.needs_previous and signs.losses),
        )

    def blocks(self, rows: np.ndarray) -> Iterator[DerivativeBlock]:
        """Blocks of what is not a sum, in some of the rows."""
        if self._parts:
            yield from (block.times(self._sign) for block in super().blocks(rows))

    def _of_steps(self, steps: np.ndarray) -> Iterator[DerivativeBlock]:
        """Blocks that some steps add to all later rows, at first those of the start (number 0)."""
        first = np.zeros(1, dtype=int)
        if self._start_sum:
            yield of_rows(self._start_sum, first, np.ones(1))
            if sign := self._signs.energy:
                start = energy_blocks(self._sub_steps, "energy of steps", first, first)
                yield from (block.times(-sign) for block in start)
        yield from (block.times(self._signs.steps) for block in self._work)
        if sign := self._signs.losses:
            yield from (block.times(sign) for block in losses_in_steps(self._sub_steps, steps))

    def vjp(self, weights: np.ndarray, later: float, gradient: Gradient) -> None:
        """As of `RowOutput`."""
        # Sums of the weights of all rows from the start on, and from after each step on. Of no rows
        # `bincount` gives integers, to which parts of numbers cannot be added.
        ends, row_weights = np.append(self._ends, self._count), np.append(weights, later)
        step_weights = np.bincount(ends, row_weights, self._count + 1)[::-1].cumsum()[::-1]
        vjp(self._of_steps(np.flatnonzero(step_weights)), step_weights, gradient)
        super().vjp(weights, later, gradient)

    def jvp(
        self, rows: int, earlier: np.ndarray, state_changes: Arrays, changes: Arrays
    ) -> np.ndarray:
        """As of `RowOutput`."""
        steps = np.arange(self._count + 1)
        sums = jvp(self._of_steps(steps), (len(steps),), state_changes, changes)
        sums[0] += earlier
        sums = sums.cumsum(axis=0)
        earlier[:] = sums[-1]
        return sums[self._ends] + super().jvp(rows, earlier, state_changes, changes)


def work_in_steps(sub_steps: SubSteps, forces: np.ndarray) -> Iterator[DerivativeBlock]:
    """Derivatives of the work of loads and driven motions in a part of a tape, in rows 1 to k.

    It is F . w, with the mean F of the loads at both ends and the path w, and the forces of driven
    columns (k, columns) times their paths. The last states are those of its k sub-steps.
    """
    model, part = sub_steps.model, sub_steps.tape.present
    columns = model.data.loads.unit_loads
    numbers, first = np.arange(*part), len(sub_steps.boundaries) - 1 - (part.end - part.first)
    states = {name: sub_steps.states[name][first:] for name in ("q", "slides")}
    tape, at_rest = sub_steps.tape, model.scheme.rates.at_rest
    t0, t1, steps = tape.times.starts[numbers], tape.times.ends[numbers], np.arange(len(numbers))
    rows = 1 + steps
    D = without_turns(model, np.diff(states["q"], axis=0))
    path, slope = model.scheme.rates.work_increment(D, model.mesh.turns)
    slides = np.diff(states["slides"], axis=0)
    driven = forces[:, : model.couplings.driven]
    # Means (k, loads) of the factors of the loads.
    if at_rest:
        # Loads and forces are those at the ends of steps. The first one, to the equilibrium without
        # loads, does not count.
        path[:1], slope[:1], slides[:1] = 0.0, 0.0, 0.0
        factors = _with_last(tape.memories[:, None] * floats(model.data.loads.series(t1)))
        driven = _with_last(driven)
        driven[:1] = 0.0
    else:
        factors = floats(Forcing(model).loads(t0, t1)).mean(axis=1)
    # Paths (k, driven) of driven motions, and derivatives by the increments along the path.
    paths, slide_slopes = driven_of(model, path, slides), np.zeros_like(slides)
    path_slopes = (columns @ factors.T).T
    slopes_of = {"q": path_slopes, "slides": slide_slopes}
    for name, i, entry, sign in driven_terms(model):
        slopes_of[name][:, entry] += sign * driven[:, i]
    increment_slopes = path_slopes * slope
    if at_rest and model.masses.weight is not None:
        # All of its work is potential energy, but for what the load factor leaves out.
        missing = _with_last(tape.memories[:, None]) - 1
        increment_slopes += missing * model.masses.weight * slope
        yield of_rows("weight", rows, missing * path)
    if (hold := tape.hold) is not None:
        # Its means at both ends, times the increments of the unknowns.
        y = model.couplings.unknowns(np.diff(states["q"], axis=0), slides)
        means = _with_last(hold[numbers])
        y[:1] = means[:1] = 0.0
        columns_of_dofs, dofs, slide_columns, joints = model.couplings.free_columns
        increment_slopes[:, dofs] += means[:, columns_of_dofs]
        slide_slopes[:, joints] += means[:, slide_columns]
        yield of_rows("hold", rows, y / 2, numbers)
        yield of_rows("hold", rows[1:], y[1:] / 2, numbers[:-1])
    for name, slopes in (("q", increment_slopes), ("slides", slide_slopes)):
        if slopes.size:
            starts, ends = slice(first, first + len(steps)), slice(first + 1, None)
            yield of_rows(name, rows, slopes, ends)
            yield of_rows(name, rows, -slopes, starts)
    works, loads = path @ columns, columns.shape[1]
    for name, last, slopes, places in (
        ("constraints", 0, paths, steps),
        ("loads", loads, works, numbers),
    ):
        if not slopes.size:
            continue
        if at_rest:  # the means of forces and loads at both ends
            yield of_rows(name, rows, slopes / 2, places, last)
            yield of_rows(name, rows[1:], slopes[1:] / 2, places[:-1], last)
        elif name == "loads":
            yield of_rows(name, rows, np.tile(slopes / 2, 2), places)
        else:
            yield of_rows(name, rows, slopes, places)
    load_of_entry = np.repeat(np.arange(loads), np.diff(columns.indptr))
    yield of_rows("columns", rows, factors[:, load_of_entry] * path[:, columns.indices])


def _with_last(values: np.ndarray) -> np.ndarray:
    """Means (k, ...) of each row and the one before; of the first row itself."""
    return (values + np.concatenate([values[:1], values[:-1]])) / 2


# -- Outputs of nodes, joints, beams and lines: derivatives by states, forces and numbers -------


#: Forces in steps, at the start, and of rates that fit, by the names of arrays in `State`.
_FORCES = {
    "joint_forces": ("joints", "forces of joints", "impulses of joints"),
    "constraint_forces": ("constraints", "forces of columns", "impulses of columns"),
}
# Slopes of what has entries of a state as components.
_UNITS = np.eye(3)
# Pulls (lines,) at the start of a run.
_AT_START = "forces of lines"


class LocalOutput(RowOutput):
    """An output of a node, a place, a joint or a line, whose `Measured` has it and its slopes.

    Rates that fit the joints are "rates" of the states.
    """

    def __init__(self, places: RowPlaces, name: str, measured: Measured):
        super().__init__(places, name, measured)
        sub_steps, self._model = self._sub_steps, self._sub_steps.model
        self._rates, self._name = sub_steps.rates, name
        #: Lengths of a row.
        self.shape = measured.shape

        def read(array: str, entries: np.ndarray) -> np.ndarray:
            if array == "X":
                return np.tile(self._model.mesh.X.reshape(-1)[entries], (len(places.ends), 1))
            states = sub_steps.states[self._rates if array == "v" else array]
            return states[places.ends][:, entries]

        spans, counted = self._model.points.spans_of(measured), None
        if spans is not None:
            counted = sub_steps.states["spring internal"][places.ends][:, spans]
        at_rest = self._model.scheme.rates.at_rest and measured.quantity.of in ("v", "a")
        slopes = () if at_rest or not len(places.ends) else self._slopes_of(measured, read, counted)
        self._blocks = [block for slope in slopes for block in self._blocks_of(*slope)]

    def _slopes_of(
        self, measured: Measured, read: Read, counted: np.ndarray | None
    ) -> Iterable[Slope]:
        if (joint := measured.sliding) is not None:
            return [Slope("rates of slides", np.array([joint.number]), np.ones((1, 1, 1)))]
        return measured.slopes(read, counted)

    def blocks(self, rows: np.ndarray) -> list[DerivativeBlock]:
        """Derivatives of the output, in all rows."""
        return self._blocks

    def _blocks_of(
        self, array: str, entries: np.ndarray, slopes: np.ndarray
    ) -> Iterator[DerivativeBlock]:
        """Derivatives (n, components, e) by entries of states, forces and numbers."""
        if (columns := self._model.force_columns.get(array)) is not None:
            columns = columns.reshape(-1)[entries]
            have_column = columns >= 0
            array, entries = "constraint_forces", columns[have_column]
            slopes = slopes[..., have_column]
        every, ends = np.arange(len(self._places.ends)), self._places.ends
        if array == "a":
            yield from self._change(self._rates, entries, slopes)
            yield from self._blocks_at("a", entries, self._places.at_start, slopes)
        elif array in _FORCES:
            yield from self._force(*_FORCES[array], entries, slopes)
        elif not array:
            yield from self._blocks_at(numbers_of_output(self._name), entries, every, slopes)
        elif array == "X":
            if self._sub_steps.has_places:
                yield from self._blocks_at(array, entries, every, slopes)
        else:
            name = self._rates if array == "v" else array
            yield from self._blocks_at(name, self._at(name, entries), every, slopes, ends)

    @staticmethod
    def _blocks_at(
        name: str,
        entries: np.ndarray,
        rows: np.ndarray,
        slopes: np.ndarray,
        places: np.ndarray | None = None,
        factors: np.ndarray | None = None,
    ) -> Iterator[DerivativeBlock]:
        """Derivatives in rows (k,): those of each are in `slopes`, or are the same in all."""
        n, count, width = slopes.shape
        if not (len(rows) and width):
            return
        values = slopes if n == 1 else slopes[rows]
        if factors is not None:
            values = values * factors[:, None, None]
        values = np.broadcast_to(values, (len(rows), count, width))
        is_square = count == width <= len(_UNITS)
        are_entries = n == 1 and is_square and all_of(slopes[0] == _UNITS[:count, :count])
        if are_entries or count == width == 1:
            parts = np.arange(count)  # each component by its own entry
            yield DerivativeBlock(name, entries, rows, values[:, parts, parts], places, parts)
            return
        for part in range(count):
            yield DerivativeBlock(name, entries, rows, values[:, part], places, part)

    def _at(self, name: str, entries: np.ndarray) -> np.ndarray:
        known = self._places.entries.get(name)
        return entries if known is None else np.searchsorted(known, entries)

    def _change(
        self, name: str, entries: np.ndarray, slopes: np.ndarray
    ) -> Iterator[DerivativeBlock]:
        """The change over the steps, by their lengths."""
        places, rows = self._places, self._places.moved
        entries, rate_factor = self._at(name, entries), 1 / places.steps.lengths[rows]
        for boundaries, factor in ((places.ends, rate_factor), (places.starts, -rate_factor)):
            yield from self._blocks_at(name, entries, rows, slopes, boundaries[rows], factor)

    def _force(
        self, name: str, at_start: str, impulse: str, entries: np.ndarray, slopes: np.ndarray
    ) -> Iterator[DerivativeBlock]:
        """A mean force over the steps, with what rates that fit add to it."""
        steps, forces = self._places.steps, self._places.forces
        yield from self._blocks_at(name, entries, steps.of, slopes, forces, steps.shares)
        yield from self._blocks_at(at_start, entries, self._places.at_start, slopes)
        if self._model.fits_rates:
            yield from self._change(impulse, entries, slopes)


class ResultantOutput(RowOutput):
    """N, Q or M (n, points) of a beam at the rows (n,) of a run: means over their steps."""

    record = "rates"  # on which they may depend

    def __init__(self, places: RowPlaces, name: str, measured: Measured):
        super().__init__(places, name, measured)
        model = self._sub_steps.model
        assert model.forms.beams is not None
        self._beams = model.forms.beams
        self._cells = model.mesh.cells[model.scene.beams.number_of(measured.place.name)]
        self._component = "NQM".index(measured.name)
        self.shape = (len(self._cells) * model.forms.internal_shape[1],)
        self._rows, self._steps, self._shares = places.means()

    @classmethod
    def needs(cls, model: Model, measured: Measured) -> Needs:
        """As of `RowOutput`."""
        return Needs(steps=True, whole=True)

    def blocks(self, rows: np.ndarray) -> Iterator[DerivativeBlock]:
        """As of `RowOutput`."""
        sub_steps, counting = self._sub_steps, np.flatnonzero(np.isin(self._rows, rows))
        for group in sub_steps.groups(counting):
            chosen = counting[group]
            steps = self._steps[chosen]
            yield from sub_steps.in_steps(steps, self._by_fields(chosen, sub_steps.parts(steps)))

    def _by_fields(self, chosen: np.ndarray, parts: StepBatch) -> Iterator[DerivativeBlock]:
        """Derivatives by what forms read of some sub-steps."""
        rows, shares, cells = self._rows[chosen], self._shares[chosen, None], self._cells
        beams, has_places = BeamSlopes(self._beams), self._sub_steps.has_places
        for name, dofs, slopes in beams.resultants(parts, has_places, self._component):
            points, entries = slopes.shape[2], dofs[cells]
            slopes = np.ascontiguousarray(np.moveaxis(slopes[:, cells], (2, 3), (0, 1)))
            components = np.arange(len(cells) * points).reshape(-1, points).T
            if name == "parameters":  # which all elements share
                for (point, k), component in np.ndenumerate(components):
                    values = shares * slopes[point, :, :, k].T
                    yield DerivativeBlock(name, entries[k], rows, values, part=int(component))
                continue
            point_components, cell_entries = ([*map(_evenly, x)] for x in (components, entries.T))
            for point, number in np.ndindex(slopes.shape[:2]):
                values, part = shares * slopes[point, number], point_components[point]
                yield DerivativeBlock(name, cell_entries[number], rows, values, part=part)


def _evenly(entries: np.ndarray) -> Chosen:
    """Entries (n,) as a slice, which is quicker, if they are at equal distances."""
    first, step = int(entries[0]), int(entries[-1] - entries[0]) // max(len(entries) - 1, 1)
    even = step > 0 and all_of(entries == first + step * np.arange(len(entries)))
    return slice(first, int(entries[-1]) + 1, step) if even else entries


class LineOutput(RowOutput):
    """Quantities of the laws of a line: its force or energy."""

    def __init__(self, places: RowPlaces, name: str, measured: Measured):
        super().__init__(places, name, measured)
        self._line, self._law = measured.place.number, measured.law_quantity
        self._values = PointValues(self._sub_steps.model.points, self._law, self._line)


class PullOutput(LineOutput):
    """The force of a line at the rows (n,) of a run: the mean over the steps that end there."""

    @classmethod
    def needs(cls, model: Model, measured: Measured) -> Needs:
        """As of `RowOutput`."""
        return super().needs(model, measured)._replace(steps=True)

    def blocks(self, rows: np.ndarray) -> Iterator[DerivativeBlock]:
        """As of `RowOutput`."""
        sub_steps, places = self._sub_steps, self._places
        steps = places.steps
        counting = np.flatnonzero(np.isin(steps.of, rows))
        for group in sub_steps.groups(counting):
            which = counting[group]
            row_numbers, shares = steps.of[which], steps.shares[which, None]
            numbers = steps.sub_steps[which]
            blocks = (
                DerivativeBlock(name, entries, row_numbers, shares * slopes)
                for name, entries, slopes in self._values.slopes(sub_steps.point_steps(numbers))
            )
            yield from sub_steps.in_steps(numbers, blocks)
        if len(places.at_start):
            ones = np.ones(len(places.at_start))
            yield of_rows(_AT_START, places.at_start, ones, first=self._line)


class LineEnergyOutput(LineOutput):
    """The "energy" that a line stores, at the rows (n,) of a run."""

    def blocks(self, rows: np.ndarray) -> Iterator[DerivativeBlock]:
        """As of `RowOutput`."""
        sub_steps = self._sub_steps
        boundaries = sub_steps.boundaries[self._places.ends[rows]]
        for group in sub_steps.groups(boundaries):
            states = sub_steps.states_at(numbers := boundaries[group])
            arrays = {name: states[name] for name in ("q", "parameters") if name in states}
            ones, internal = np.ones(len(numbers)), states["spring internal"]
            steps = StepBatch(0 * ones, ones, spring_internal=internal, **arrays)
            blocks = (
                DerivativeBlock(name, entries, rows[group], slopes)
                for name, entries, slopes in self._values.slopes(steps)
            )
            yield from sub_steps.at_states(numbers, blocks)


# -- Section forces at places as outputs: their derivatives, by the balance of an element -------


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
    cells = model.mesh.cells[model.scene.beams.number_of(place.beam.name)]
    return int(cells[place.element[0]])


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


# -- The kinds of outputs: each has its values, what it reads, and its derivatives in one class -


def kind_of(measured: Measured) -> type[RowOutput]:
    """The class of an output."""
    if isinstance(measured.place, Scene):
        return WorkOutput if measured.name in SINCE_START else EnergyOutput
    if isinstance(measured.place, Beam):
        return ResultantOutput
    if is_section_force(measured.output):
        return SectionOutput
    if measured.law_quantity:
        return PullOutput if measured.law_quantity == "pull" else LineEnergyOutput
    return LocalOutput


def needs_of(model: Model, outputs: Iterable[Measured]) -> Needs:
    """Needs of some outputs together."""
    needs = [Needs(), *(kind_of(measured).needs(model, measured) for measured in outputs)]
    return Needs(*map(any, zip(*needs, strict=True)))
