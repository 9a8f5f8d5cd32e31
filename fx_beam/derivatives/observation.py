"""Outputs of a run, their values in rows, and derivatives by its states and forces."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.dual import floats
from fx_beam.equilibria.critical_points import first_critical_point
from fx_beam.errors import SceneError, require
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Node
from fx_beam.scene.outputs import CRITICAL_LOAD, PERIOD, Measured, Output, is_section_force
from fx_beam.scene.scene import Scene
from fx_beam.step.fitted_rates import Arrays, RateDerivatives, rate_fit
from fx_beam.step.forcing import Forcing
from fx_beam.step.model import Model, fact, sizes_of
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.step_control import WholeSteps
from fx_beam.step.tape import Tape

from .output_kinds import LocalOutput, check_work, kind_of, needs_of
from .parametrised import Gradient
from .row_output import RowPlaces, SubSteps

# -- Values of outputs in solutions and in recorded rows, and what of a record they need --------


#: An output: a quantity of a node, joint, beam or scene, or a function of the solution.
Wanted = Output | Callable[[Solution], ArrayLike]


def is_at_node(output: Wanted, scene: Scene) -> bool:
    """Whether it is an output of a node that a scene has."""
    if not isinstance(output, Output) or not isinstance(node := output.of, Node):
        return False
    return node.scene is scene and node.number not in scene.gone


def node_keys(outputs: Mapping[str, Wanted]) -> list[tuple[str, str, str | None, int]]:
    """Name, quantity, component and node of each output; empty if one is not of a node."""
    keys = []
    for name, output in outputs.items():
        if not isinstance(output, Output) or not isinstance(node := output.of, Node):
            return []
        keys.append((name, output.quantity, output.component, node.number))
    return keys


def recorded(requested: Record, last: Record, measured: Iterable[Measured]) -> Record:
    """The `requested` record, reduced to what the outputs need; the `last` one if it is equal."""
    kinds = {kind_of(output).record_of(output) for output in measured}
    rates, forces = requested.rates and "rates" in kinds, requested.forces and "forces" in kinds
    is_same = (last.rates, last.forces) == (rates, forces)
    return last if is_same else replace(requested, rates=rates, forces=forces)


def values_of(solution: Solution, output: Wanted, name: str) -> np.ndarray:
    """Values (n, ...) of an output."""
    if not isinstance(output, Output):
        values = np.asarray(output(solution))
        expected = "a number or an array of numbers"
        require(values.dtype.kind in "iufb", f"Response: the output {name!r}", values, expected)
        return values
    expected = "that of a PeriodicResponse: other motions and equilibria have no period"
    require(output.quantity != PERIOD, f"Response: the output {name!r}", str(output), expected)
    if output.quantity == CRITICAL_LOAD:
        return np.array(first_critical_point(solution).load_factor)
    return solution.value(output)


def row_values(model: Model, recorder: Recorder, measured: Measured) -> np.ndarray | None:
    """Values (n, ...) of an output of a node that rows have as it is, else None; a copy of them."""
    array, rows = measured.quantity.of, recorder.rows
    is_of_node = isinstance(measured.place, Node) and array in ("q", "v")
    fitted = bool(recorder.turns) or (array == "v" and model.fits_rates)
    if not is_of_node or fitted or array in recorder.serving or array not in recorder.arrays:
        return None
    arrays = {"X": model.mesh.X.reshape(1, -1), array: recorder.arrays[array][:rows]}
    return measured.values(lambda name, entries: arrays[name][:, entries])


# -- Outputs of a run as functions of its states and forces, and their derivatives --------------


#: Outputs by name.
Outputs = Mapping[str, Measured]
# Rates that fit the joints, and the impulses that make them fit, by their names as states.
_FITTED = "rates", "rates of slides", "impulses of joints", "impulses of columns"
# Where no output needs the steps that end in its rows.
_NO_STEPS = WholeSteps(*[np.empty(0, dtype=int)] * 5)


def check_outputs(model: Model, tape: Tape, outputs: Outputs, start: Mapping[str, str]) -> None:
    """SceneError for outputs without derivatives.

    `start` says why those since the start have none, by quantity.
    """
    for name, measured in outputs.items():
        if kind_of(measured).is_sum:
            check_work(model, measured, name, start.get(measured.name, ""))
        if kind_of(measured).needs(model, measured).whole and not tape.is_whole:
            raise SceneError(
                f"the output {name!r}, {measured.output}, has derivatives only if all steps are in "
                "memory. Give Response more memory"
            )


def read_entries(model: Model, outputs: Outputs) -> dict[str, np.ndarray]:
    """The only entries of states that outputs read, by name; empty if they may read all."""
    listed = outputs.values()
    is_linear = all(
        measured.is_constant and kind_of(measured) is LocalOutput for measured in listed
    )
    if not is_linear or (model.fits_rates and needs_of(model, listed).rates):
        return {}
    entries: dict[str, set[int]] = {"q": set(), "v": set(), "slides": set()}
    for array, numbers in itertools.chain(*(measured.needs for measured in listed)):
        entries.get("v" if array == "a" else array, set()).update(numbers.tolist())
    return {name: np.array(sorted(chosen)) for name, chosen in entries.items() if chosen}


def summed(outputs: Outputs) -> list[str]:
    """Names of those that add up over the steps."""
    return [name for name, measured in outputs.items() if kind_of(measured).is_sum]


class Observation:
    """Outputs by name at the rows of a run that end before some sub-steps, `boundaries` (n,).

    They are in the part that is on the tape, in whose sub-steps `forces` gives those of columns.
    """

    def __init__(
        self,
        model: Model,
        tape: Tape,
        forces: Callable[[], np.ndarray],
        entries: Arrays,
        has_places: bool,
        numbers: Arrays,
        outputs: Outputs,
        boundaries: np.ndarray,
    ):
        self._model, self._tape, self._rows = model, tape, len(boundaries)
        needs, (first, end) = needs_of(model, outputs.values()), tape.present
        reads_steps = needs.rates or needs.steps
        steps = tape.times.steps_to(boundaries) if reads_steps else _NO_STEPS
        lists = [boundaries]
        if needs.rates and not model.scheme.rates.at_rest:
            lists.append(steps.starts)
        if needs.steps:
            step_numbers = steps.sub_steps if boundaries.all() else np.append(steps.sub_steps, 0)
            lists += [step_numbers, step_numbers + 1, np.maximum(step_numbers - 1, 0)]
        if summed(outputs) and not first:
            lists.append(np.zeros(1, dtype=int))
        self.sub_steps = steps.sub_steps if needs.rates else steps.sub_steps[:0]
        if needs.all_steps:
            lists.append(np.arange(first, end + 1))
            if model.couplings.driven:
                self.sub_steps = np.arange(first, end)
        #: Boundaries at which outputs need states; in `sub_steps` they need forces.
        self.boundaries = np.unique(np.concatenate(lists)) if len(lists) > 1 else boundaries
        reads_forces = any(is_section_force(measured.output) for measured in outputs.values())
        sub_steps = SubSteps(model, tape, self.boundaries, has_places, reads_forces)
        ends = self.boundaries.searchsorted(boundaries)
        starts = self.boundaries.searchsorted(steps.starts)
        forces_at = self.sub_steps.searchsorted(steps.sub_steps)
        rows = boundaries.nonzero()[0], (boundaries == 0).nonzero()[0]
        places = RowPlaces(
            sub_steps, numbers, ends, starts, *rows, steps, forces_at, entries, forces
        )
        #: Rates that fit the joints, and their derivatives.
        self._fit = None
        if model.fits_rates and needs.rates:
            driven = floats(Forcing(model).end_rates(*rates_at(tape, self.boundaries)))
            q, v, slides = (sub_steps.states[name] for name in ("q", "v", "slides"))
            self._fit = RateDerivatives(rate_fit(model), q, v, slides, driven)
            sub_steps.states["rates"] = self._fit.rates
        self._entries = entries
        self._outputs = {
            name: kind_of(measured)(places, name, measured) for name, measured in outputs.items()
        }

    def vjp(
        self, weights: Arrays, later: Mapping[str, float], number_slopes: Arrays
    ) -> dict[str, np.ndarray]:
        """Derivatives of the sum of weights (n, ...) times outputs by states and forces.

        Derivatives by numbers are added to `number_slopes`. `later` are sums of the weights of
        outputs that add up over the steps, in later parts.
        """
        model, n, k = self._model, len(self.boundaries), len(self.sub_steps)
        sizes_of_state = fact(model, sizes_of)
        columns, joints = sizes_of_state["constraints"], 3 * sizes_of_state["joints"]
        sizes = {name: (n, width) for name, width in self._tape.widths.items()}
        sizes |= {name: (n, len(entries)) for name, entries in self._entries.items()}
        widths = model.size, joints // 3, joints, columns
        sizes |= {name: (n, width) for name, width in zip(_FITTED, widths, strict=True)}
        sizes |= {"constraints": (k, columns), "joints": (k, joints)}
        gradient = Gradient(sizes, number_slopes)
        for name, output in self._outputs.items():
            output.vjp(weights[name], later.get(name, 0.0), gradient)
        if self._fit is not None:
            all_entries = slice(None)
            state_slopes, shape_slopes = self._fit.vjp(
                {name: gradient.derivative_by(name) for name in _FITTED}
            )
            driven = state_slopes.pop("driven rates")
            for name, values in state_slopes.items():
                gradient.derivative_by(name)[:] += values
            for name, values in shape_slopes.items():
                gradient.add(name, all_entries, None, values.reshape(1, -1))
            gradient.add("driven rates", all_entries, self.boundaries, driven)
        return gradient.state_slopes

    def jvp(self, state_changes: dict, changes: Arrays, earlier: Arrays) -> dict[str, np.ndarray]:
        """Changes (n, ..., m) of all outputs from those of states, forces and numbers.

        Of outputs that add up over the steps, `earlier` (m,) are sums of earlier parts, to which
        those of this part are added.
        """
        if self._fit is not None:
            states = {name: state_changes[name] for name in ("q", "v", "slides")}
            states["driven rates"] = changes["driven rates"][:, self.boundaries].swapaxes(0, 1)
            state_changes |= self._fit.jvp(states, changes)
        return {
            name: output.jvp(self._rows, earlier.get(name, np.empty(0)), state_changes, changes)
            for name, output in self._outputs.items()
        }


def rates_at(tape: Tape, boundaries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times before some sub-steps, and lengths of the steps that end there [s].

    At the start, that of the first step, negative.
    """
    lengths = tape.times.steps_to(boundaries).lengths
    times = np.append(tape.times.starts, tape.times.ends[-1])[boundaries]
    return times, np.where(boundaries > 0, lengths, -tape.times.first_length)
