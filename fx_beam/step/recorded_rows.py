"""Recorded rows, read: histories by their names, and the sub-steps before each row."""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable, Iterator, Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.dual import floats
from fx_beam.fem.mesh import rotation_of
from fx_beam.laws.interval import INSTANT, StepBatch
from fx_beam.results.records import Energy
from fx_beam.results.state import ARRAYS, FORCES, HISTORIES, ROWS
from fx_beam.scene.joints import GROUND

from .forcing import Forcing
from .model import Model, fact, need_rates, sizes_of
from .recorder import Recorder

if TYPE_CHECKING:
    from .fitted_rates import Fit


# -- The histories of a record by their names in a solution, with rates that fit the joints -----
# Each is made when it is first read.


# What a solution has besides.
_OTHERS = "energy", "internal", "spring_internal", "natural"
# Rows that depend on fitted rates.
_FITTED = {"v", "a", "joint_forces", "constraint_forces"}
#: Means over a step, by the parts of a fit that change in it.
MEANS = {"a": "corrections", "joint_forces": "joints", "constraint_forces": "constraints"}
# Energies of a row, in their order.
_ENERGIES = [field.name for field in fields(Energy) if field.name != "impact"]
# Which energies have the work of driven motions.
_BY_DRIVEN = [float(name in ("kinetic", "work")) for name in _ENERGIES]
# Arrays that belong together, and arrays by name.
_Rows = tuple[np.ndarray, ...]
_ByName = Mapping[str, np.ndarray]


class RecordedHistories(Mapping):
    """Histories of n rows; empty if not recorded.

    `rows` are the recorded ones; `fitted` gives them with rates that fit the joints, and is None
    where those of steps do. `late_accelerations` gives those of row 0, if they are not recorded.
    `turns` are the full turns that are missing in rows from a number on.
    """

    def __init__(
        self,
        model: Model,
        rows: _ByName,
        fitted: Callable[[], _ByName] | None,
        turns: Mapping[int, np.ndarray],
        t: np.ndarray,
        t_level: Callable[[], np.ndarray],
        impact: float,
        late_accelerations: Callable[[], np.ndarray] | None = None,
    ):
        self._model, self._rows, self._turns = model, rows, turns
        self._fitted_rows, self._t_level, self._impact = fitted, t_level, impact
        self._known: dict[str, object] = {"t": t}
        self._late_accelerations = late_accelerations

    def __getitem__(self, name: str) -> Any:
        if name not in self._known:
            self._known[name] = self._made(name)
        return self._known[name]

    def __iter__(self) -> Iterator[str]:
        return iter(dict.fromkeys([*HISTORIES, *_OTHERS]))

    def __len__(self) -> int:
        return len([*self])

    def of_node(self, name: str, number: int) -> np.ndarray | None:
        """Rows (n, 3) of a node; None if they are not recorded, or known already."""
        rows = self._recorded(name)
        if rows is None or self._turns or name in self._known:
            return None
        return rows[:, self._model.mesh.dofs[number]]

    def at_end(self, t: float) -> dict[str, np.ndarray]:
        """Forces of the last row by name, if it is at this time [s]; else nothing.

        Also the rates that fit the joints, and accelerations, if the rates of steps do not fit, and
        those of driven motions, if they are known: where they jump, they are others from there on.
        """
        if self["t"][-1] != t:
            return {}
        state = dict[str, np.ndarray]()
        for name in FORCES if self._fitted_rows is None else (*FORCES, "a", "v"):
            if (rows := self._recorded(name)) is not None:
                shape = ARRAYS[name].lengths(fact(self._model, sizes_of))
                state["fitted" if name == "v" else name] = rows[-1].reshape(shape).copy()
        if self._fitted_rows and not np.isnan(driven := self._fitted["driven_rates"][-1]).any():
            state["driven_rates"] = driven.copy()
        return state

    def small_rows(self, first: int) -> dict[str, np.ndarray]:
        """Rows from one on of what does not grow with the number of nodes."""
        nodal_names = {name for name, row in ROWS.items() if row.record in ("motion", "rates")}
        names = (self._fitted.keys() & {*ROWS, "driven_rates"}) - nodal_names
        return {name: self._fitted[name][first:].copy() for name in sorted(names)}

    @cached_property
    def _fitted(self) -> _ByName:
        if self._fitted_rows is None:
            return self._rows
        with self._model.lock:
            return self._fitted_rows()

    def fit(self) -> None:
        """Fit the rates now: they depend on the joints of the scene, which may be changed."""
        _ = self._fitted

    def _recorded(self, name: str) -> np.ndarray | None:
        if name not in self._rows:
            return None
        if name == "a" and self._late_accelerations is not None:
            with self._model.lock:
                if self._late_accelerations is not None:  # no other thread was first
                    self._rows["a"][0] = self._late_accelerations()
                    self._late_accelerations = None
        return (self._fitted if name in _FITTED else self._rows)[name]

    def _made(self, name: str) -> object:
        if name == "t_level":
            return self._t_level()
        if name == "energy":
            energies = self._fitted["energies"]
            parts = dict(zip(_ENERGIES, energies.T, strict=True))
            return Energy(**parts, impact=np.full(len(energies), self._impact))
        if name in ("linear_momentum", "angular_momentum"):
            return self._fitted["momenta"][:, 2 if name == "angular_momentum" else slice(2)]
        if name in self._model.force_columns:
            return self._by_columns(name)
        model, quantity = self._model, ROWS[name]
        is_nodal = quantity.shape == ("dofs",)
        lengths = (len(model.mesh.X), 3) if is_nodal else quantity.lengths(fact(model, sizes_of))
        rows = self._recorded(name)
        values = np.empty((0, *lengths)) if rows is None else rows.reshape(len(rows), *lengths)
        if is_nodal:
            values = values.copy()
        if name == "q" and self._turns and len(values):
            for first, stop in itertools.pairwise([*self._turns, len(values)]):
                values[first:stop] += self._turns[first].reshape(lengths)
        if name == "slides" and model.couplings.missing:
            values = values.copy()
            values[:, model.couplings.missing] = np.nan
        if name in _OTHERS and not values.size:
            return None
        return values

    def _by_columns(self, name: str) -> np.ndarray:
        """Forces of supports on nodes, or of motors, from rows of all constraint forces."""
        model, forces = self._model, self._recorded("constraint_forces")
        if forces is None:
            forces = np.empty((0, *ROWS["constraint_forces"].lengths(fact(model, sizes_of))))
        return np.append(forces, np.zeros((len(forces), 1)), axis=1)[:, model.force_columns[name]]


# -- Rates that fit the joints, with the accelerations and forces that belong to them --------------


def fitted(
    model: Model, rows: _ByName, starts: _Rows | None, grid: _Rows, driven: np.ndarray | None
) -> dict[str, np.ndarray]:
    """Rows (n, ...) of a record with fitted rates; row 0 is the start.

    `starts` are q and v where the steps start that end with the other rows; None if these are the
    rows before. `grid` has the times at the ends of all steps, and the steps of the rows; `driven`
    are the rates at the start.
    """
    times, steps = grid
    histories, slides = dict(rows), rows.get("slides", np.empty((len(steps), 0)))
    end_fit = _fit(model, grid, (rows["q"], rows["v"], slides), starts is None, driven)
    if starts is None:
        start_fit = type(end_fit)(*(values[:-1] for values in end_fit))
    else:
        start_slides = slides_near(model, starts[0], slides[1:])
        start_fit = _fit(model, (times, steps[1:] - 1), (*starts, start_slides), False, driven)
    histories["v"], histories["driven_rates"] = end_fit.rates, end_fit.driven
    impulses = (model.masses.matrix @ end_fit.corrections.T).T
    histories["momenta"] = rows["momenta"] + sums_of(model, rows["q"], impulses)
    if model.couplings.driven:  # at rates that fit, other impulses do no work
        work = np.einsum("ni,ni->n", end_fit.rates, impulses)
        histories["energies"] = rows["energies"] + np.outer(work, _BY_DRIVEN)
    step_ends = type(end_fit)(*(values[1:] for values in end_fit))
    for name in MEANS.keys() & rows.keys():
        lengths = _lengths(times, steps)[1:, None]
        means = fitted_mean(name, rows[name][1:], start_fit, step_ends, lengths)
        histories[name] = np.concatenate([rows[name][:1], means])
    return histories


def fitted_mean(
    name: str, means: np.ndarray, start: Fit, end: Fit, lengths: float | np.ndarray
) -> np.ndarray:
    """Means over steps with what fits at their starts and ends add: impulses over the lengths."""
    change = getattr(end, MEANS[name]) - getattr(start, MEANS[name])
    return means + change.reshape(means.shape) / lengths


def _lengths(times: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Lengths (n,) of steps by their number; for number 0 that of the first step, negative."""
    return times[steps] - times[np.where(steps, steps - 1, len(times[:2]) - 1)]


def _fit(
    model: Model, grid: _Rows, states: _Rows, successive: bool, first: np.ndarray | None = None
) -> Fit:
    """Rates that fit at ends or starts of steps, whose `states` are q, v and slides.

    Inputs go straight in a step, over which their rates are if the rows are `successive`.
    """
    # Rates of driven motion that are not known are NaN; `first` are those at step 0, if known.
    from .fitted_rates import rate_fit

    (times, steps), (q, v, slides) = grid, states
    lengths, forcing = _lengths(times, steps), Forcing(model)
    driven = np.full((len(steps), model.couplings.driven), np.nan)
    straight = forcing.straight
    if lengths.all() and driven.size:
        driven[:] = floats(forcing.end_rates(times[steps], lengths))
    driven[:, straight] = np.nan
    if successive and straight.any():
        means = driven_increments(model, q, slides) / lengths[1:, None]
        driven[1:, straight] = means[:, straight]
    if first is not None:
        driven[steps == 0] = first
    return rate_fit(model).fit(q, v, slides, driven)


def driven_of(model: Model, q: np.ndarray, slides: np.ndarray) -> np.ndarray:
    """Prescribed motions and coordinates of motors (n, driven)."""
    count, arrays = len(model.prescribed) + len(model.data.motors), {"q": q, "slides": slides}
    positions = np.zeros((len(q), count))
    for name, i, entry, sign in driven_terms(model):
        positions[:, i] += sign * arrays[name][:, entry]
    return positions


def driven_terms(model: Model) -> Iterator[tuple[str, int, int, int]]:
    """Terms of driven motions: "q" or "slides", number of the motion, entry and sign."""
    yield from (("q", i, dof, 1) for i, dof in enumerate(model.prescribed))
    for i, (joint, name) in enumerate(model.data.motors, start=len(model.prescribed)):
        if name == "slide":
            yield "slides", i, joint.number, 1
            continue
        for node, sign in ((joint.b, 1), (joint.a, -1)):
            if node is not GROUND:
                yield "q", i, rotation_of(node), sign


def driven_increments(model: Model, q: np.ndarray, slides: np.ndarray) -> np.ndarray:
    """Increments (n - 1, driven) of driven motions from row to row, without full turns."""
    increments = np.diff(driven_of(model, q, slides), axis=0)
    turns = [component == 2 for _, component in model.scene.prescribed]
    turns += [name == "rotation" for _, name in model.data.motors]
    return increments - np.where(turns, 2 * np.pi * np.round(increments / (2 * np.pi)), 0.0)


def sums_of(model: Model, q: np.ndarray, p: np.ndarray) -> np.ndarray:
    """Sums (n, 3) of nodal momenta p (n, size): in x and y, and about the origin."""
    x, p = model.mesh.X + q[:, model.mesh.dofs[:, :2]], p[:, model.mesh.dofs]
    turning = x[..., 0] * p[..., 1] - x[..., 1] * p[..., 0] + p[..., 2]
    sums = np.empty((len(p), 3))
    sums[:, :2], sums[:, 2] = p[..., :2].sum(axis=1), turning.sum(axis=1)
    return sums


def slides_near(model: Model, q: np.ndarray, slides: np.ndarray) -> np.ndarray:
    """Slides (n, joints) [m] at q (n, ...), from ones near by."""
    nearest, motion = slides.copy(), model.mesh.motion(model.scene, q=q)
    for joint in model.scene.joints:
        nearest[:, joint.number] = joint.kinematics.slide(motion, slides[:, joint.number])
    return nearest


# -- Recorded rows, read: their histories, and the sub-steps before them, which have the forces -


def histories_of(recorder: Recorder) -> RecordedHistories:
    """Histories of the rows so far by their names in `Solution`."""
    model, n, fit = recorder.model, recorder.rows, None
    arrays = recorder.arrays.items()  # views would take more memory than small arrays
    rows = {name: array if len(array) == n else array[:n] for name, array in arrays}
    times, steps = recorder.grid.times, recorder.grid.steps[:n]
    if model.fits_rates:
        first, starts = recorder.starts.up_to_row[:n][:-1], None
        if recorder.grid.every > 1:
            starts = tuple(recorder.starts.arrays[f"start_{name}"][first] for name in "qv")
        driven = None if steps[0] else recorder.first.driven_rates
        fit = functools.partial(fitted, model, rows, starts, (times, steps), driven)
    t, impact = recorder.t, recorder.first.impact
    recorded = {name: array for name, array in rows.items() if name not in recorder.serving}

    def t_level() -> np.ndarray:
        return t - (1 - model.scheme.rates.level) * RowSteps(recorder).lengths()

    late = recorder.late_accelerations
    return RecordedHistories(model, recorded, fit, recorder.turns, t, t_level, impact, late)


class RowSteps:
    """The sub-steps before each row of a recorder, from a first row on.

    Of each sub-step: the row, the share in its step, and whether the start is stored. If not, it is
    a whole step, which starts at the row before.
    """

    def __init__(self, recorder: Recorder, first: int = 0):
        self._recorder, self._first = recorder, first
        stored = recorder.starts
        counts = np.diff(stored.up_to_row[: recorder.rows], prepend=0)[first:]
        repeats, rows = np.maximum(counts, 1), np.arange(first, recorder.rows)
        self._row, self._stored = np.repeat(rows, repeats), np.repeat(counts > 0, repeats)
        #: Rows of starts that are stored.
        self._starts = slice(stored.before_row(first), stored.before_row(recorder.rows))
        self._shares = np.ones(len(self._row))
        self._shares[self._stored] = stored.arrays["share"][self._starts]

    def lengths(self) -> np.ndarray:
        """Length (n,) of the step or last part that a row's forces belong to; 0 for row 0."""
        t1, t0 = self._ends(np.arange(self._first, self._recorder.rows))
        return (t1 - t0) * np.bincount(self._row - self._first, self._shares)

    def means(self, values: np.ndarray) -> np.ndarray:
        """Forces (n, ...) of rows, from those of the sub-steps: means over the steps."""
        if len(values) == self._recorder.rows - self._first:  # one sub-step before each row
            return values
        row = self._row - self._first
        weights = self._shares / np.bincount(row, self._shares)[row]
        begins = np.flatnonzero(np.diff(row, prepend=-1))
        return np.add.reduceat(weights.reshape(-1, *[1] * (values.ndim - 1)) * values, begins)

    def batch(self, moves: bool = False) -> StepBatch:
        """The sub-steps, for which forces of rows are evaluated.

        Row 0 has a single one, so short that its forces depend on the rates, but not on a motion;
        with its rates if resultants have some, or if it `moves`.
        """
        recorder, row, stored = self._recorder, self._row, self._stored
        model, arrays, starts = recorder.model, recorder.arrays, recorder.starts.arrays
        beams, at_start = model.forms.beams, not self._first
        assert beams is not None
        previous, last = np.maximum(row - 1, 0), np.flatnonzero(np.diff(row, append=recorder.rows))
        rows, counts, rest = row[last], np.diff(last, prepend=-1), self._shares.copy()

        def begins(name: str) -> np.ndarray:
            values = arrays[name][previous]
            values[stored] = starts[f"start_{name}"][self._starts]
            return values

        def ends(begins: np.ndarray, row_ends: np.ndarray) -> np.ndarray:
            values = np.empty_like(begins)
            values[:-1], values[last] = begins[1:], row_ends
            return values

        for end, count in zip(last[counts > 1], counts[counts > 1], strict=True):
            sub_steps_of_row = slice(end + 1 - count, end + 1)
            rest[sub_steps_of_row] = np.cumsum(rest[sub_steps_of_row][::-1])[::-1]
        t1, t0 = self._ends(row)
        begin = t1 - (t1 - t0) * rest
        dt, level = ends(begin, t1[last]) - begin, model.scheme.rates.level
        t = begin + level * dt
        q = begins("q") + self._missing(np.where(stored, row, previous))
        D = ends(q, arrays["q"][rows] + self._missing(rows)) - q
        if at_start:
            dt[0] = INSTANT * (np.diff(recorder.grid.times[:2]).sum() or 1.0)
            if moves or beams.facts.resultants_move:
                D[0] = dt[0] * recorder.first.v
                q[0] -= level * D[0]
        parts = StepBatch(t, dt, D, q)
        names = [*("v", "a")[: 2 * fact(model, need_rates)]]
        names += ["internal"] * (beams.internal_shape[-1] > 0)
        names += ["natural"] * bool(model.data.natural)
        batch_arrays = {name: begins(name) for name in names}
        if at_start and "a" in batch_arrays:  # there is no motion in row 0
            batch_arrays["a"][0] = 0.0
        if "natural" in batch_arrays:
            batch_arrays["natural_end"] = ends(batch_arrays["natural"], arrays["natural"][rows])
        memory, q_previous = np.zeros(len(row)), q
        if beams.facts.needs_previous:  # all are stored, but for the start
            q_previous = q.copy()
            memory[stored] = starts["memory"][self._starts]
            q_previous[stored] = starts["start_q_previous"][self._starts]
            q_previous[stored] += self._missing(row[stored])
        # Where parameters are inputs of a motion, only the rows know their earlier values.
        if any(function.ramps for function in model.forms.parameters.functions):
            batch_arrays["parameters"] = self._parameters(parts.t)
        return parts._replace(memory=memory, q_previous=q_previous, **batch_arrays)

    def _ends(self, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ends and starts [s] of the steps of rows."""
        times, steps = self._recorder.grid.times, self._recorder.grid.steps[row]
        return times[steps], times[np.maximum(steps - 1, 0)]

    def _missing(self, rows: np.ndarray) -> np.ndarray | float:
        """Full turns (n, size) [rad] that are missing in some rows."""
        if not (turns := self._recorder.turns):
            return 0.0
        turn_rows = np.array([np.zeros(self._recorder.model.size), *turns.values()])
        return turn_rows[np.searchsorted([*turns], rows, side="right")]

    def _parameters(self, t: np.ndarray) -> np.ndarray:
        """Parameters (n, k) at times (n,) in the steps of rows: linear from row to row."""
        recorder, row = self._recorder, self._row
        previous, values = np.maximum(row - 1, 0), recorder.arrays["parameters"]
        t0, t1 = (recorder.grid.times[recorder.grid.steps[rows]] for rows in (previous, row))
        part = (t - t0) / np.where(row > 0, t1 - t0, 1.0)
        return values[previous] + part[:, None] * (values[row] - values[previous])
