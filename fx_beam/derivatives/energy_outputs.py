"""Energies, work and losses as outputs: their derivatives by states and by numbers of the scene.

The work of dead loads and driven motions is a sum over the steps, of any scheme. In each step of a
scheme that conserves energy E + dissipated - work stays the same: so what is dissipated follows
from the work, or other works follow from the energy and what is dissipated. Where both are unknown,
or energy is not conserved, what is dissipated is a sum over the steps as well.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from fx_beam.dual import floats
from fx_beam.errors import SceneError
from fx_beam.fem.beam_slopes import BeamSlopes
from fx_beam.fem.point_values import PointValues, energy_slopes_of_members
from fx_beam.laws.interval import StepBatch
from fx_beam.scene.measured import Measured
from fx_beam.step.forcing import Forcing
from fx_beam.step.full_turns import without_turns
from fx_beam.step.layout import Arrays
from fx_beam.step.model import Model
from fx_beam.step.recorded_histories import driven_of, driven_terms

from .gradient import DerivativeBlock, Gradient, jvp, of_names, of_rows, vjp
from .row_output import Needs, RowOutput, RowPlaces
from .sub_steps import SubSteps

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
