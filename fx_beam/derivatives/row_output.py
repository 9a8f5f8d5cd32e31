"""Outputs of a response: what each reads of rows and sub-steps, and its derivatives."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, NamedTuple

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.dual import MaybeDual, dual_array, floats
from fx_beam.laws.interval import INSTANT, StepBatch
from fx_beam.motions.motion_setup import OF_OUTPUT
from fx_beam.results.state import HISTORIES
from fx_beam.scene.beam import BeamPlace, Node
from fx_beam.scene.outputs import (
    STRESSES,
    Measured,
    Output,
    is_section_force,
    numbers_of,
    section_weights,
)
from fx_beam.step.fitted_rates import Arrays
from fx_beam.step.full_turns import without_turns
from fx_beam.step.model import Model
from fx_beam.step.step_control import WholeSteps
from fx_beam.step.tape import Tape

from .parametrised import DerivativeBlock, Gradient, jvp, vjp

# -- The sub-steps of a tape, as outputs that are not linear in the states see them -------------


# Arrays that forms read at the starts of sub-steps.
_AT_START = "q", "v", "slides", "natural", "internal", "spring internal"
# A term of what forms read: an array, places (k,) in it, None for all of it, and a factor; and a
# term with the indices (k,) of the sub-steps that have it.
_Term = tuple[str, np.ndarray | None, float]
_Source = tuple[np.ndarray, *_Term]
# Degrees of freedom of the sub-steps that are evaluated at once.
_MOST = 2**16


class SubSteps:
    """The sub-steps of a tape, with the states before some of them, `boundaries`.

    Rows, and sub-steps or boundaries of each, are one of `groups`.
    """

    def __init__(
        self,
        model: Model,
        tape: Tape,
        boundaries: np.ndarray,
        has_places: bool = True,
        reads_forces: bool = False,
    ):
        self.model, self.tape, self.boundaries = model, tape, boundaries
        #: Whether derivatives by the positions of nodes are wanted.
        self.has_places = has_places
        #: Name of the rates of nodes.
        self.rates = "rates" if model.fits_rates else "v"
        parameters, self._level = model.forms.parameters, model.scheme.rates.level
        #: Values of the parameters (sub-steps, 2, n) at the level of the scheme and at the ends.
        self._parameters = None
        if len(parameters):
            times = tape.times
            rows = parameters.signals.over_steps(times.starts, times.ends, self._level)
            self._parameters = floats(rows)
            self._start_parameters = parameters.values_at(float(times.starts[0]))[None]
        # 1 if resultants at the start, or all forces of elements that are wanted, depend on rates,
        # else 0.
        beams = model.forms.beams
        moves = beams is not None and (
            beams.depend_on_rates if reads_forces else beams.facts.resultants_move
        )
        self._moves = float(moves)

    @cached_property
    def _short(self) -> float:
        """Length of the short step for the resultants at the start [s]."""
        return INSTANT * self.tape.times.first_length

    @cached_property
    def states(self) -> dict[str, np.ndarray]:
        """The states (n, ...), which are read if an output is not linear in them."""
        return self.tape.states(self.boundaries)

    def groups(self, steps: np.ndarray) -> Iterator[slice]:
        """Sub-steps or boundaries that are evaluated at once."""
        most = max(1, _MOST // self.model.size)
        return (slice(i, i + most) for i in range(0, len(steps), most))

    def places(self, steps: np.ndarray) -> np.ndarray:
        """Places (3, k) of states before and after sub-steps, and of those a sub-step earlier."""
        first = np.maximum(steps, 0)
        return np.searchsorted(self.boundaries, [first, first + 1, np.maximum(first - 1, 0)])

    def states_at(self, boundaries: np.ndarray) -> dict[str, np.ndarray]:
        """States (k, ...) by name, with the parameters at their times."""
        places = np.searchsorted(self.boundaries, boundaries)
        rows = {name: values[places] for name, values in self.states.items()}
        if self._parameters is not None:
            rows["parameters"] = self._parameters[boundaries - 1, 1]
            rows["parameters"][boundaries == 0] = self._start_parameters
        return rows

    def parts(self, steps: np.ndarray) -> StepBatch:
        """Sub-steps by their numbers; -1 for the start of the run."""
        tape, model, states, starts = self.tape, self.model, self.states, steps < 0
        first, (begins, ends, _) = np.maximum(steps, 0), self.places(steps)
        q, dt = states["q"][begins], np.where(starts, self._short, tape.times.lengths[first])
        D = without_turns(model, states["q"][ends] - q)
        D[starts] = self._moves * self._short * states["v"][begins[starts]]
        q[starts] -= self._level * D[starts]
        arrays = {name: states[name][begins] for name in ("internal", "natural")}
        arrays["q_previous"] = states["q previous"][begins]
        arrays["natural_end"] = states["natural"][np.where(starts, begins, ends)]
        if self._parameters is not None:
            arrays["parameters"] = self._parameters[first, 0]
            arrays["parameters"][starts] = self._start_parameters
        if model.forms.needs_previous:
            arrays["memory"] = np.where(starts, 0.0, tape.memories[first])
        return StepBatch(tape.times.starts[first] + self._level * dt * ~starts, dt, D, q, **arrays)

    def point_steps(self, steps: np.ndarray) -> StepBatch:
        """Sub-steps with what forces at points read."""
        begins, ends, _ = self.places(steps)
        names = "v", "slides", "spring internal"
        v, slides, internal = (self.states[name][begins] for name in names)
        factors = np.ones(len(steps))
        if self.model.scheme.rates.at_rest:
            factors = self.tape.memories[steps]
        return self.parts(steps)._replace(
            v=v,
            load_factor=factors,
            spring_internal=internal,
            slides=slides,
            slide_increments=self.states["slides"][ends] - slides,
        )

    # -- Derivatives of rows, from those by what belongs to states or sub-steps --------------------

    def kinds(self, steps: np.ndarray) -> Iterator[np.ndarray]:
        """Groups of indices: of the start of the run, and of sub-steps.

        In a group no two read the same state: the first sub-step is alone if forms read the step
        before.
        """
        first = (steps == 0) & self.model.forms.needs_previous
        return filter(len, map(np.flatnonzero, (steps < 0, first, (steps >= 0) & ~first)))

    def at_states(
        self, boundaries: np.ndarray, blocks: Iterable[DerivativeBlock]
    ) -> Iterator[DerivativeBlock]:
        """Blocks, from those by what `at` gives, and by numbers of the scene."""
        places = np.searchsorted(self.boundaries, boundaries)
        count = len(self.model.forms.parameters)
        for block in blocks:
            if block.name != "parameters":
                yield block._replace(places=places if block.name in self.states else None)
                continue
            for which in self.kinds(boundaries - 1):
                name, steps = _parameters_of(boundaries[which] - 1)
                entries = np.arange(count)[block.entries] + (0 if steps is None else count)
                part = block._replace(name=name, entries=entries, places=steps)
                yield part._replace(rows=part.rows[which], derivatives=part.derivatives[which])

    def in_steps(
        self, steps: np.ndarray, blocks: Iterable[DerivativeBlock]
    ) -> Iterator[DerivativeBlock]:
        """Blocks, from those by what forms read of sub-steps, or of the start."""
        sources = self._sources(steps)
        for block in blocks:
            if (name_terms := sources.get(block.name)) is None:
                yield block
                continue
            for which, array, places, factor in name_terms:
                part = block._replace(name=array, rows=block.rows[which], places=places)
                yield part._replace(derivatives=block.derivatives[which]).times(factor)

    def _sources(self, steps: np.ndarray) -> dict[str, list[_Source]]:
        """Terms whose sum forms read of sub-steps, by name.

        Their arrays are those of states, or of numbers with a row for each sub-step.
        """
        sources: dict[str, list[_Source]] = {}
        all_places, moved = self.places(steps), self._moves * self._short
        for which in self.kinds(steps):
            (begins, ends, earlier), first = all_places[:, which], steps[which[0]]
            starts: list[_Term] = [("q", begins, 1.0)]
            increments = [("q", ends, 1.0), ("q", begins, -1.0)]
            if first < 0:
                starts.append(("v", begins, -self._level * moved))
                increments = [("v", begins, moved)]
            has_previous = first == 0 and self.tape.memories[0]  # of what came before
            previous = ("q previous", None) if has_previous else ("q", earlier)
            terms = {name: [(name, begins, 1.0)] for name in _AT_START}
            terms |= {"start": starts, "increment": increments, "q_previous": [(*previous, 1.0)]}
            terms["slide increment"] = [("slides", ends, 1.0), ("slides", begins, -1.0)]
            terms["natural_end"] = [("natural", begins if first < 0 else ends, 1.0)]
            terms["parameters"] = [(*_parameters_of(steps[which]), 1.0)]
            for name, name_terms in terms.items():
                sources.setdefault(name, []).extend(
                    (which, *term) for term in name_terms if term[2]
                )
        return sources


def _parameters_of(steps: np.ndarray) -> tuple[str, np.ndarray | None]:
    """Name of the parameters in steps of a kind, and these if they have a row for each."""
    return ("parameters at the start", None) if steps[0] < 0 else ("parameters", steps)


# -- An output of a response: its values, what it reads of a run, and its derivatives, by blocks


def numbers_of_output(name: str) -> str:
    """The numbers of an output; of a section force the part of its element, and its length."""
    return "numbers" + OF_OUTPUT + name


def numbers_of_outputs(
    outputs: Mapping[str, Any], known: Mapping[str, object]
) -> dict[str, MaybeDual]:
    """Numbers of outputs, at places in the elements of those that are known."""
    numbers = dict[str, MaybeDual]()
    for name, output in known.items():
        if not isinstance(output, Output) or isinstance(output.of, Node):
            continue  # it has none
        if isinstance(output.of, BeamPlace):
            place, (element, _) = outputs[name].of, output.of.element
            start, end = place.beam.s[element : element + 2]
            part, length = (place.s - start) / (end - start), end - start
            values = dual_array([part, length] if is_section_force(output) else [part])
            if output.quantity in STRESSES:
                values = dual_array([part, length, *section_weights(outputs[name])])
        else:
            values = numbers_of(outputs[name])
        if values.size:
            numbers[numbers_of_output(name)] = values
    return numbers


class Needs(NamedTuple):
    """Needs of outputs besides the states at their rows."""

    #: Rates that fit the joints, or forces; accelerations or forces at the start.
    rates: bool = False
    start: bool = False
    #: States around the sub-steps that end in the rows, or around all since the start.
    steps: bool = False
    all_steps: bool = False
    #: A tape that has all steps in memory.
    whole: bool = False


class RowPlaces(NamedTuple):
    """Places of the rows of outputs among the states of a run, and what is known of it."""

    sub_steps: SubSteps
    #: Numbers of the scene, and of its outputs, by name.
    numbers: Arrays
    #: Rows (n,) among the states, and the starts of the steps that end there.
    ends: np.ndarray
    starts: np.ndarray
    #: Numbers of the rows that are the end of a step, and of those at the start of the run.
    moved: np.ndarray
    at_start: np.ndarray
    #: Those steps, and the places of their sub-steps among those of the forces.
    steps: WholeSteps
    forces: np.ndarray
    #: The only entries that the states have, by name; empty if they have all.
    entries: Arrays
    #: Gives forces (k, columns) of columns in all sub-steps on the tape.
    column_forces: Callable[[], np.ndarray]

    def means(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows (k,), sub-steps (k,) and shares (k,) of means over the steps; -1 for the start."""
        steps, start = self.steps, self.at_start
        sub_steps = np.append(steps.sub_steps, -np.ones(len(start), dtype=int))
        return np.append(steps.of, start), sub_steps, np.append(steps.shares, np.ones(len(start)))


class RowOutput:
    """An output at rows (n,) of a run, whose states are at some `places`."""

    #: Lengths of a row.
    shape: tuple[int, ...] = ()
    #: What of a `Record` it needs if no history has it.
    record = ""
    #: Whether it adds up over the steps since the start.
    is_sum = False

    def __init__(self, places: RowPlaces, name: str, measured: Measured):
        self._sub_steps, self._places = places.sub_steps, places

    @classmethod
    def record_of(cls, measured: Measured) -> str:
        """Part of a `Record` that has it: "motion", "rates" or "forces"; empty for nothing."""
        recorded = HISTORIES.get(measured.quantity.of)
        return cls.record if recorded is None else recorded.record

    @classmethod
    def needs(cls, model: Model, measured: Measured) -> Needs:
        """Its needs in a run of a model."""
        record = cls.record_of(measured)
        start = record == "forces" or measured.quantity.of == "a"
        return Needs(rates=record in ("rates", "forces"), start=start)

    def blocks(self, rows: np.ndarray) -> Iterable[DerivativeBlock]:
        """Its derivatives in some of the rows, or in all."""
        raise NotImplementedError

    def vjp(self, weights: np.ndarray, later: float, gradient: Gradient) -> None:
        """Add the derivatives of the sum of weights (n, ...) times the output.

        `later` is the sum of the weights of rows in later parts of a tape.
        """
        counting = np.flatnonzero(weights.any(axis=tuple(range(1, weights.ndim))))
        vjp(self.blocks(counting), weights, gradient)

    def jvp(
        self, rows: int, earlier: np.ndarray, state_changes: Arrays, changes: Arrays
    ) -> np.ndarray:
        """Changes (rows, ..., m) from those of the states and of the numbers of the scene.

        `earlier` (m,) is the sum over earlier parts of a tape, to which this one adds.
        """
        return jvp(self.blocks(np.arange(rows)), (rows, *self.shape), state_changes, changes)
