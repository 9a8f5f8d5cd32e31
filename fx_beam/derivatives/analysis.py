"""Analyses of responses: rows, tapes and numbers of motions and load paths, followed backwards."""

from __future__ import annotations

import functools
import weakref
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

from fx_beam.dual import Dual, MaybeDual, floats
from fx_beam.equilibria.statics import LoadPath, path_of
from fx_beam.errors import SceneError, any_of
from fx_beam.fem.forms import SceneArrays
from fx_beam.motions.dynamics import MotionSeries
from fx_beam.motions.initial_state import rates_with_slopes, reference_state
from fx_beam.motions.motion_setup import (
    MotionSetup,
    Options,
    numbers_in_steps,
    numbers_of_state,
    observed_numbers_of,
    static_numbers_of,
)
from fx_beam.motions.run import Run
from fx_beam.results.records import stats_unchanged
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.functions import with_functions
from fx_beam.scene.outputs import Measured, Output, is_section_force
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model, data_of, fact, massless_dofs, sizes_of
from fx_beam.step.tables import problem_of
from fx_beam.step.tangent_storage import ProblemKind
from fx_beam.step.tape import Tape, static_tape
from fx_beam.step.tape_derivatives import TapeDerivatives

from .observation import Observation, Wanted, node_keys, rates_at, recorded, row_values, values_of
from .output_kinds import needs_of, numbers_of_sections, why_no_losses, why_no_work
from .parametrised import NumbersOf, Parametrised, refuse_others
from .row_output import Needs, numbers_of_outputs

# -- Analysis of a response: its rows, tape and numbers give outputs and derivatives ------------


class Analysis:
    """Runs scenes of parameters; derivatives of its rows follow a tape of its steps."""

    #: The quantity of the whole run that an output may be, a single number; empty for none.
    single = ""
    #: Whether derivatives of a sum of outputs are taken from those of all rows.
    forwards = False
    #: The equilibrium from which the last run started, if it was computed for it.
    path: LoadPath | None = None
    #: Times or load factors (n,) of the rows of the last run.
    t: np.ndarray
    #: The time of the loads of equilibria [s]; functions of time of the inputs of the scene.
    rest_time: float | None = None
    inputs: Mapping[str, object] | None = None
    #: Accelerations (size,) at the start, if an output has them.
    start_accelerations: np.ndarray | None = None

    def __init__(self, parameters: Parametrised):
        self.parameters = parameters
        # The last outputs, what tells those of nodes, and what measures them.
        self._measured_outputs: tuple[object, list, dict[str, Measured]] = None, [], {}

    @property
    def outputs(self) -> dict[str, Wanted]:
        """Outputs of the last scene by name."""
        return self.parameters.besides or {}

    @property
    def measured_by_name(self) -> dict[str, Measured]:
        """Outputs of the last scene that are no functions; the same dict for the same nodes."""
        outputs, (known, keys, by_name) = self.outputs, self._measured_outputs
        if known is not outputs:
            if not (last := node_keys(outputs)) or last != keys:
                chosen = {name: each for name, each in outputs.items() if isinstance(each, Output)}
                by_name = {name: Measured(output) for name, output in chosen.items()}
            self._measured_outputs = outputs, last, by_name
        return by_name

    @property
    def measured(self) -> list[Measured]:
        """The same in their order."""
        return [*self.measured_by_name.values()]

    def run(self, x: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Times or load factors (n,) and outputs for parameters."""
        raise NotImplementedError

    def tape_of_last_run(self, method: str) -> tuple[Model, Tape, TapeDerivatives]:
        """The model of the last run, the tape of its steps, and their derivatives."""
        raise NotImplementedError

    def boundaries(self, tape: Tape) -> np.ndarray:
        """Numbers (n,) of the sub-steps after the rows of the last run."""
        return tape.times.boundaries(self.t)

    def value(self, solution: Solution, name: str) -> np.ndarray:
        """Values (n, ...) of an output in a solution, or its only value."""
        return values_of(solution, self.outputs[name], name)

    def read(self, solution: Solution) -> dict[str, np.ndarray]:
        """The outputs (n, ...) of a solution."""
        return {name: self.value(solution, name) for name in self.outputs}

    def changes(self) -> dict[str, np.ndarray]:
        """Derivatives (m, ...) by x of all numbers of the last run."""
        raise NotImplementedError

    def numbers_of_outputs(
        self, scene: Scene, outputs: Mapping[str, Any], known: Mapping[str, Any]
    ) -> dict[str, Any]:
        """Numbers of a scene that its outputs read; those `known` are of the last scene."""
        numbers = numbers_of_outputs(outputs, known)
        if any(map(is_section_force, known.values())):
            model, tape, _ = self.tape_of_last_run("derivatives")
            scene = with_functions(scene, self.inputs, "Response: inputs")
            numbers |= numbers_of_sections(model, tape, self.rest_time, scene, known)
        return numbers

    def known_numbers(self) -> dict[str, np.ndarray]:
        """Numbers of the last scene that its outputs read."""
        outputs = self.outputs
        numbers = self.numbers_of_outputs(self.parameters.scene, outputs, outputs)
        if self.start_accelerations is not None:
            numbers["a"] = self.start_accelerations
        return {name: floats(values) for name, values in numbers.items()}

    def of_single(self) -> np.ndarray:
        """Derivatives (m,) by x of the single quantity."""
        raise NotImplementedError

    def of_length(self, names: Iterable[str]) -> dict[str, np.ndarray]:
        """Derivatives (n, ..., m) of outputs by a length of steps that depends on x."""
        return {}


# -- Derivatives of the states of a load path by the numbers of its scene -----------------------


#: Derivatives (m, ...) by x of numbers of scenes.
DerivativesOf = Callable[[NumbersOf], dict[str, np.ndarray]]
# Internal variables that round-off may leave at a contact without a force.
_ROUNDING = 1e-12


def why_not(path: LoadPath) -> str:
    """Why a path has no derivatives; empty if it has."""
    model, first = path.model, path.states[0]
    if path.forcing.turning is not None:
        return "a frame that turns (spin) has none"
    if not path.from_rest and model.kinks.flows:
        return "parts with internal variables that start from another solution have none"
    if model.mechanism and model.kinks.flows:
        return (
            "a mechanism that its loads hold, with internal variables, has none: these depend on "
            "how it settles"
        )
    variables = [values for values in (first.internal, first.spring_internal) if values is not None]
    if first.spring_internal is not None:  # forces that friction follows are no states
        variables[-1] = np.delete(first.spring_internal, model.points.normal_forces)
    if any(abs(values).max(initial=0.0) > _ROUNDING for values in variables):
        return "springs are under tension, and change internal variables before the loads act"
    return ""


def why_no_sums(path: LoadPath | None) -> dict[str, str]:
    """Why work and losses of a motion have no derivatives if it starts from a path, by quantity."""
    if path is None or why_not(path):  # nothing came before, or differences have it
        return {}
    model = path.model
    reasons = {"work": why_no_work(model)}
    if model.forms.dissipate:
        lossless = why_no_losses(model)
        reasons["dissipated_energy"] = lossless and f"where {lossless}"
    if not path.from_rest:
        reasons = {quantity: "if it began at another solution" for quantity in reasons}
    refusal = "has no derivatives since the equilibrium from which each motion starts has none"
    return {quantity: f"{refusal} {reason}" for quantity, reason in reasons.items() if reason}


class StaticDerivatives:
    """The load steps of a path on a tape, and their derivatives."""

    def __init__(self, path: LoadPath):
        if reason := why_not(path):
            raise SceneError(f"the equilibria have no derivatives: {reason}")
        self.path, self.model = path, (model := path.model)
        #: The states that are followed. Of what began at another solution these are the last alone,
        #: which is an equilibrium of this scene whatever it began from.
        self.states, start = path.states, reference_state(model)
        if not path.from_rest:
            start, self.states = path.states[-2], path.states[-1:]
        self.factors = np.array([state.t for state in self.states])
        problem = problem_of(model, ProblemKind())
        holding_forces = path.held if path.from_rest else 0 * path.held
        if holding_forces.any():
            problem.set(work={"statics": {"holds": model.reduction.free}})
        self.derivatives = TapeDerivatives(problem)
        self.tape = static_tape(problem, start, self.states, path.forcing)
        if holding_forces.any():
            self.tape.hold = (1 - self.factors)[:, None] * holding_forces

    def numbers_of(self, scene: Scene, change: MaybeDual) -> dict[str, MaybeDual]:
        """The numbers of these load steps for another scene; OtherStructureError if it differs."""
        return self._numbers_at(self.factors, scene, change)

    def _numbers_at(
        self, factors: np.ndarray, scene: Scene, change: MaybeDual
    ) -> dict[str, MaybeDual]:
        scene = with_functions(scene, self.path.options.inputs, "static: inputs")
        data = data_of(self.model, scene)
        return static_numbers_of(self.model, data, self.path.forcing.time, factors)

    def changes(self, derivatives: DerivativesOf) -> dict[str, np.ndarray]:
        """Changes (m, ...) of all numbers with x, by `derivatives` of the numbers of scenes."""
        if self.tape.hold is None:
            return derivatives(self.numbers_of)
        # What holds the springs is what is left without it in the reference.
        first, problem = self.states[0], self.derivatives.problem
        tape = static_tape(problem, first, [first], self.path.forcing)
        at_rest = derivatives(functools.partial(self._numbers_at, np.zeros(1)))
        rows, shares = np.zeros(1, dtype=int), np.ones(1)
        held_forces, _ = self.derivatives.jvp_of_equations(tape, at_rest, None, rows, shares)
        hold = (1 - self.factors)[None, :, None] * held_forces[0][:, None]
        return derivatives(self.numbers_of) | {"hold": hold}

    def change_of_end(
        self, derivatives: DerivativesOf, name: str, pulls: Sequence[Measured] = ()
    ) -> StateChange:
        """Changes of the last state with x, by `derivatives` of the numbers of scenes.

        With those of some `pulls` of lines.
        """
        changes = self.changes(derivatives)
        refuse_others(changes, self.derivatives.names, name)
        boundaries = np.arange(len(self.tape) + 1)
        rows = self.derivatives.jvp(self.tape, changes, boundaries, boundaries[:-1])
        names = {"q": "q", "slides": "slides"}
        names |= {"constraint_forces": "constraints", "joint_forces": "joints"}
        at_end = {name: rows[array][-1] for name, array in names.items()}
        count, sums = len(changes["X"]), self._summed()
        outputs = {str(pull.place.number): pull for pull in pulls}
        outputs |= {name: Measured(Output(name, self.model.scene)) for name in sums}
        forces = functools.partial(self.derivatives.constraint_forces, self.tape)
        last = boundaries[-1:]
        observed = Observation(self.model, self.tape, forces, {}, True, {}, outputs, last)
        for name, values in rows.items():
            is_force = name in ("constraints", "joints")
            rows[name] = values[observed.sub_steps if is_force else observed.boundaries]
        outputs_at_end = observed.jvp(rows, changes, {name: np.zeros(count) for name in sums})
        at_end["line_forces"] = np.zeros((count, fact(self.model, sizes_of)["lines"]))
        for pull in pulls:
            number = pull.place.number
            at_end["line_forces"][:, number] = outputs_at_end[str(number)][0]
        for name in sums:
            at_end[name.removesuffix("_energy")] = outputs_at_end[name][0]
        return StateChange(self, at_end | self.derivatives.at_end)

    def _summed(self) -> list[str]:
        """The outputs with derivatives that add up over the load steps."""
        names, model = list[str](), self.model
        if self.path.from_rest and not why_no_work(model):
            names.append("work")
        if self.path.from_rest and model.forms.dissipate and not why_no_losses(model):
            names.append("dissipated_energy")
        return names


class StateChange:
    """Changes (m, ...) of an equilibrium, from which a motion starts."""

    def __init__(self, derivatives: StaticDerivatives, changes: dict[str, np.ndarray]):
        self._path, self._state, self._changes = derivatives.path, derivatives.states[-1], changes
        #: Those of the configuration (m, size).
        self.node_changes = changes["q"]

    def equilibrium_at(self, data: SceneArrays, change: MaybeDual) -> State:
        """The equilibrium with a change of the numbers (m,), for those of a scene.

        It has slopes if the change has.
        """
        moved = {
            name: values
            + (change @ self._changes[name].reshape(len(change), -1)).reshape(np.shape(values))
            for name in self._changes
            if (values := getattr(self._state, name)) is not None
        }
        if data.natural:
            natural = data.natural.numbers_at(self._path.forcing.time)
            moved["natural"] = natural if isinstance(change, Dual) else floats(natural)
        return replace(self._state, t=self._path.forcing.time, parameters=None, **moved)


# -- Motions of scenes of parameters: their outputs, and derivatives of their numbers -----------


# Length of the step that tells the accelerations at the start, relative to the others: its mean
# loads are those just after the start, which accelerations have.
_INSTANT = 2e-12


class MotionAnalysis(Analysis):
    """Motions one after the other, the last of which is on a tape if outputs have derivatives."""

    def __init__(
        self,
        options: Options,
        start: Solution | Callable[[Scene], Solution] | None,
        memory: float,
        parameters: Parametrised,
    ):
        super().__init__(parameters)
        self._options, self._record, self._start = options, options.record, start
        self.inputs = options.inputs
        # Several processes have no derivatives.
        self._series = MotionSeries(memory)
        self._tape_derivatives: TapeDerivatives | None = None
        # Outputs of the last run that are no functions.
        self._measured: dict[str, Measured] = {}
        # The last run whose rows only this object has.
        self._last_run: Run | None = None

    def run(self, x: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Times and outputs for parameters."""
        # Functions of the user's, which have read a scene before, may take plain floats alone.
        plain = callable(self._start) or any(map(callable, self.outputs.values()))
        run: Run = self.parameters.scenes.serve(x, self._begun, not plain)
        try:
            rows = run.take_steps(lambda: self._rows_of(run) or run.solution())
        except BaseException:
            self._series.is_kept = True  # by the error, which has a solution
            raise
        self.parameters.stats = run.prepared.stats
        if self._series.tape is not None:
            self._series.tape.last = run.prepared.loop.state.read()
        if isinstance(rows, Solution):
            self.t, y = rows.t, self.read(rows)
            recorder = weakref.ref(run.recorder)
            del run, rows
            # A function of the user may have kept the solution, which then reads the record.
            self._series.is_kept = recorder() is not None
            return self.t, y
        self._last_run, self.t = run, run.recorder.t
        return self.t.copy(), rows

    def _begun(self, x: Any) -> Run:
        """A run of the scene of x that is to take its steps."""
        scene = self.parameters.build_and_keep(x)
        if (measured := self.measured_by_name) is not self._measured:
            self._set_outputs(measured)
        start, old, self._last_run = self._start_of(scene), self._last_run, None
        return self._series.begun(scene, self._options, start, old)

    def _set_outputs(self, measured: dict[str, Measured]) -> None:
        """Record what the outputs of the scene need."""
        record, last, self._measured = self._record, self._options.record, measured
        # Functions may read all, and a look at ropes on pulleys needs their forces.
        if len(measured) == len(self.outputs) and not self._has_pulleys():
            record = recorded(record, last, measured.values())
        if record is not last:
            self._options = replace(self._options, record=record)
        self._series.tapes = bool(measured)

    def _rows_of(self, run: Run) -> dict[str, np.ndarray]:
        """The outputs from the rows of a run; empty if these are not all, or places need a look."""
        options, model = self._options, run.prepared.model
        looks = self.parameters.scene.contacts or model.kinks.has_contact
        looks = looks or self._has_pulleys()
        looks = looks or len(self._measured) < len(self.outputs)  # functions of the solution
        if looks or options.tolerance is not None or options.record.times is not None:
            return {}
        y = {}
        for name, measured in self._measured.items():
            if (rows := row_values(model, run.recorder, measured)) is None:
                return {}
            y[name] = rows
        return y

    def _has_pulleys(self) -> bool:
        """Whether a rope may leave a pulley."""
        return any(line.has_pulleys for line in self.parameters.scene.forces_between)

    def _start_of(self, scene: Scene) -> Solution | None:
        self.path = None
        if not callable(self._start):
            return self._start
        clock, solution = perf_counter(), self._start(scene)
        path = path_of(solution, scene)
        if path is not None and path.began >= clock:
            self.path = path
        return solution

    def tape_of_last_run(self, method: str) -> tuple[Model, Tape, TapeDerivatives]:
        """As of `Analysis`."""
        series = self._series
        prepared, tape = series.prepared, series.tape
        if prepared is None or tape is None:
            raise SceneError(
                f"Response.{method}: the steps of this motion were not compiled "
                f"({self.parameters.stats.solver}), and have no derivatives"
            )
        loop = prepared.loop
        assert loop is not None  # only it has a tape
        if self._tape_derivatives is None or self._tape_derivatives.problem is not loop.problem:
            way = "JVP" if method == "jacobian" else "VJP"
            self._tape_derivatives = TapeDerivatives(loop.problem, way)
        return prepared.model, tape, self._tape_derivatives

    def changes(self) -> dict[str, np.ndarray]:
        """As of `Analysis`."""
        tape, start = self._series.tape, None
        assert tape is not None  # `followed` comes first
        # Without derivatives of the equilibrium before, differences compute it for other x.
        if self.path is not None and not why_not(self.path):
            derivatives = self.parameters.derivatives
            lines = [measured for measured in self.measured if measured.law_quantity == "pull"]
            start = StaticDerivatives(self.path).change_of_end(derivatives, "Response", lines)
        first = self._options.dt if self._options.tolerance is None else tape.times.first_length
        assert self._series.prepared is not None  # as the tape
        needs = needs_of(self._series.prepared.model, self.measured)
        accelerations = self._accelerations_by_x(first) if needs.start else None
        numbers_of = functools.partial(self._numbers_of, needs, tape, first, start, accelerations)
        return self.parameters.derivatives(numbers_of)

    def _accelerations_by_x(self, first: float) -> np.ndarray | None:
        """Changes (m, size) of those at the start, by a very short step; None if not from rest."""
        (model, _, derivatives), prepared = self.tape_of_last_run("vjp"), self._series.prepared
        moving = model.scene.velocities, model.couplings.driven, self._start is not None
        other_steps = self._options.tolerance is not None or len(model.scheme.fractions) > 1
        # Round-off of the rates of natural strains would be large in such a step.
        if any(moving) or other_steps or model.data.natural:
            return None
        assert prepared is not None  # it has the model
        tape, short = Tape(derivatives.problem), _INSTANT * first
        with stats_unchanged(prepared.stats):
            state = prepared.first_of_run(short, None, accelerations=False)
            if prepared.stepper.trial(state, state.t + short, tape=tape).state is None:
                return None  # such a step may fail with unknowns that have no mass
        numbers_of = functools.partial(self._numbers_of_steps, tape, short, None, False)
        changes = self.parameters.derivatives(lambda scene, change: numbers_of(scene, change)[2])
        rates = derivatives.jvp(tape, changes, np.ones(1, int))["v"][0]
        return np.where(fact(model, massless_dofs), 2, 1) * rates / short  # those are means

    def _numbers_of_steps(
        self, tape: Tape, first: float, start: Any, at_start: bool, scene: Scene, change: Any
    ) -> tuple[MotionSetup, State, dict[str, Any]]:
        """Another scene, prepared, with its first state; numbers of the steps and of this state."""
        base, t0 = self.parameters.scene, tape.times.starts
        other = prepared_for(self._series, self._options, base, scene, change)
        model, t1 = other.model, tape.times.ends
        data = model.data
        if start is None:
            start_state = self._start_of(scene)
            if isinstance(change, Dual) and other.smooths_start(start_state):
                raise TypeError("a start that is found by a step has no slopes")
            state = other.first_of_run(first, start_state, at_start)
        else:
            state = other.state_from(start.equilibrium_at(data, floats(change)), first, at_start)
        numbers: dict[str, Any] = numbers_in_steps(model, data, state, t0, t1)
        if self._start is None and isinstance(change, Dual):
            if model.data.natural:
                numbers["natural"] = model.data.natural.numbers_at(state.t)
            numbers["v"] = rates_with_slopes(
                model, other.forcing, state, first, numbers, change.count
            )
        if start is not None and isinstance(change, Dual):
            for name, values in numbers_of_state(data, start.equilibrium_at(data, change)).items():
                if isinstance(values, Dual):
                    numbers[name] = Dual(floats(numbers[name]), values.slopes)
        return other, state, numbers

    def _numbers_of(
        self,
        needs: Needs,
        tape: Tape,
        first: float,
        start: Any,
        a_by_x: Any,
        scene: Scene,
        change: Any,
    ) -> dict[str, Any]:
        """Numbers of steps and state for another scene, and of outputs that have rates.

        Accelerations have the changes `a_by_x` (m, size) as their slopes.
        """
        other, state, numbers = self._numbers_of_steps(
            tape, first, start, needs.start, scene, change
        )
        if not needs.rates:
            return numbers
        if not any_of(floats(change)):
            self.start_accelerations = floats(state.a)
        rates = rates_at(tape, np.arange(len(tape) + 1))
        numbers |= observed_numbers_of(other.model, other.model.data, state, *rates, needs.start)
        if a_by_x is not None and isinstance(change, Dual):
            # Nodes without mass have none by definition, but those that others carry.
            has = ~fact(other.model, massless_dofs) | (state.a != 0)
            numbers["a"] = Dual(state.a, a_by_x.T * has[:, None])
        return numbers


def prepared_for(
    series: MotionSeries, options: Options, base: Scene, scene: Scene, change: Any
) -> MotionSetup:
    """Prepared motion as of a base, with the numbers of another scene, but no loop.

    Of the base it is that of the motion, if it has slopes.
    """
    # Without slopes it may be a scene that all calls share, with other numbers since.
    if scene is base and isinstance(change, Dual) and (last := series.prepared):
        return last
    return series.alike(with_functions(scene, options.inputs, "Response: inputs"), options)
