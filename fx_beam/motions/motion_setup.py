"""The set-up of a motion: its options, the numbers of its scene, model and stepper."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, Self

import numpy as np

from fx_beam import errors
from fx_beam.dual import MaybeDual, dual_array, floats
from fx_beam.errors import (
    LARGEST,
    SceneError,
    as_float,
    is_flag,
    is_number,
    require,
    shown,
    warn_once,
    whole,
)
from fx_beam.fem.forms import SceneArrays
from fx_beam.fem.functions_of_time import before
from fx_beam.laws.schemes import EnergyMomentum, Scheme, order_and_constant
from fx_beam.results.records import Stats
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.outputs import Output
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.step.forcing import Forcing
from fx_beam.step.full_turns import TurnCounter
from fx_beam.step.model import Model, data_of, fact, keeps_rate_errors, numbers_of, sizes_of
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.program import PROGRAMS, Program
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.step_control import MOST_HALVINGS, Halving
from fx_beam.step.stepper import CompiledLoop, Stepper

from . import initial_state
from .initial_state import Starts, TransferredState, check_joints, end_of, reference_state
from .sweep_context import call_with_arrays

# -- Options of motions: scheme, steps, end and record, checked once ----------------------------


# Limits of the tolerance. Newton's method and rounding disturb smaller errors.
_LEAST, _MOST = 1e-9, 0.1
# Shortest first or largest step that may be given, relative to the whole time.
_SHORTEST = 1e-10
# Largest step by default, relative to the whole time.
_LONGEST = 0.1

#: A function of the time and of outputs by name, which are arrays or numbers.
Condition = Callable[[float, dict[str, Any]], object]
#: Largest number of steps; their times alone take 0.8 GB.
MOST_STEPS = 1e8
_CONDITIONS = "a function of time and outputs, or a dictionary of such functions by names"


@dataclass(frozen=True, kw_only=True)
class CommonOptions:
    """Options of motions and of paths of equilibria.

    SceneError, with the name of `what` asks, for all that can be refused without a scene.
    """

    what: str
    newton: Any = NewtonOptions()
    progress: bool | None = None
    inputs: Mapping[str, object] | None = None

    @classmethod
    def among(cls, arguments: Mapping[str, Any], **replaced: Any) -> Self:
        """Options from the `arguments` of a function, its `locals()`; some are `replaced`."""
        names = cls.__dataclass_fields__.keys() & arguments.keys()
        return cls(**{name: arguments[name] for name in names} | replaced)

    def __post_init__(self):
        if self.newton is None:
            self.__dict__["newton"] = CommonOptions.newton
        errors.check_fields(self, self.what)
        self._require("newton", isinstance(self.newton, NewtonOptions), "an fx_beam.NewtonOptions")
        ok = self.progress is None or is_flag(self.progress)
        self._require("progress", ok, "True, False or None")

    def _require(self, name: str, ok: bool, expected: str) -> None:
        if not ok:
            require(False, f"{self.what}: {name}", getattr(self, name), expected)


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """The options of `simulate`; `Motion`, `Response` and others have a part of them."""

    what: str = "simulate"
    scheme: Any = EnergyMomentum()
    t_end: float = math.nan
    dt: Any = None
    tolerance: float | None = None
    dt_max: float | None = None
    breaks: Sequence[float] = ()
    max_halvings: int = whole(0, MOST_HALVINGS, default=12)
    record: Any = Record()
    #: Conditions by name, also where a single one is given.
    until: Any = None
    outputs: Mapping[str, Output] | None = None

    def __post_init__(self):
        values, expected = self.__dict__, "given with a tolerance only"
        for name in ("scheme", "record"):
            if values[name] is None:
                values[name] = getattr(Options, name)
        super().__post_init__()
        if not isinstance(self.scheme, Scheme):
            raise SceneError(
                f"unknown scheme {shown(self.scheme)}; give an instance such as "
                "fx_beam.EnergyMomentum() or fx_beam.Newmark(), with parentheses, or an "
                "fx_beam.Scheme of your own"
            )
        if self.scheme.rates.at_rest:
            text = f"{self.scheme.name} is a scheme for statics. Use fx_beam.static(scene)"
            raise SceneError(text)
        self._require("record", isinstance(self.record, Record), "an fx_beam.Record")
        if self.tolerance is None:
            self._require("dt_max", self.dt_max is None, expected)
            no_breaks = isinstance(self.breaks, tuple | list) and not self.breaks
            self._require("breaks", no_breaks, expected)
            values["breaks"] = ()
        values.update(
            {name: as_float(values[name]) for name in ("t_end", "dt") if is_number(values[name])}
        )
        if self.until is None:
            self._require("outputs", self.outputs is None, "given with `until` only")
            return
        named = self.until if isinstance(self.until, Mapping) else {"until": self.until}
        ok = all(isinstance(name, str) and callable(condition) for name, condition in named.items())
        self._require("until", ok, _CONDITIONS)
        values["until"] = dict(named)
        if self.record.file is not None:
            text = f"{self.what}: a Record with a file is not possible with until or changes"
            raise SceneError(text)

    def plan(self, t0: float, goes_on: bool) -> StepPlan:
        """The steps from t0 [s] on."""
        require(is_number(self.t_end), "t_end", self.t_end, "a finite number")
        equal = self.tolerance is None
        plan = _equal_steps(self, t0, goes_on) if equal else _chosen_steps(self, t0)
        if (row_times := self.record.times) is not None:
            ok = row_times[-1] >= t0 and row_times[0] <= self.t_end
            expected = f"in part within the run, from {t0:g} to {self.t_end:g} s"
            require(ok, f"{self.what}: the record's times", row_times, expected)
        return plan


class StepPlan(NamedTuple):
    """The steps of a run: all of their ends, or the limits of those that a tolerance chooses."""

    #: Ends of equal steps [s]; with a tolerance the start alone.
    times: np.ndarray
    #: Length of the first step, or of the first one that is tried [s].
    first: float
    #: The tolerance; zero for equal steps.
    tolerance: float = 0.0
    #: The whole time, and the length of the largest step [s].
    span: float = math.nan
    longest: float = math.inf
    #: Whether a better first length is looked for.
    search: bool = False
    #: Times at which steps end and the control begins anew, the last of them the end [s].
    breaks: Sequence[float] = ()


def _chosen_steps(options: Options, t0: float) -> StepPlan:
    """Steps that are controlled by their local errors, checked."""
    tolerance, dt, dt_max, t_end = options.tolerance, options.dt, options.dt_max, options.t_end
    ok = _LEAST <= as_float(tolerance) <= _MOST
    require(ok, "tolerance", tolerance, f"a number from {_LEAST:g} to {_MOST:g}")
    if not t_end - t0 >= 1 / LARGEST:
        since = f"the start at t = {t0:g}" if t0 else "0"
        raise SceneError(f"t_end = {t_end!r} must be after {since}")
    span = t_end - t0
    for name, value in (("dt", dt), ("dt_max", dt_max)):
        ok = value is None or (is_number(value) and as_float(value) >= _SHORTEST * span)
        expected = f"a positive number, at least {_SHORTEST:g} of the whole time"
        require(ok, name, value, expected)
    breaks = errors.real_array(options.breaks)
    ok = breaks.ndim == 1 and bool(np.isfinite(breaks).all())
    require(ok, "breaks", options.breaks, "a sequence of finite times")
    order_and_constant(options.scheme)  # refuses one whose local errors are not known
    longest = min(_LONGEST * span if dt_max is None else as_float(dt_max), span)
    least = 1e-9 * span
    inner = [t for t in np.unique(breaks).tolist() if t0 + least < t < t_end - least]
    first = min(span / 1000 if dt is None else as_float(dt), longest)
    control = span, longest, dt is None, [*inner, t_end]
    return StepPlan(np.array([t0]), first, as_float(tolerance), *control)


def _equal_steps(options: Options, t0: float, goes_on: bool) -> StepPlan:
    """Equal steps; a motion that goes on may end with a part of a step, as events do."""
    dt, t_end = options.dt, options.t_end
    choice = ", or give a tolerance, which chooses the steps" if dt is None else ""
    dt = errors.positive(dt, "dt", f"a positive number{choice}")
    if t_end - t0 < dt * (1e-6 if goes_on else 1 - 1e-6):
        later = f"after the start at t = {t0:g}, by more than a millionth of dt"
        least = later if goes_on else f"at least one step dt = {dt!r}"
        raise SceneError(f"t_end = {t_end!r} must be {least}")
    expected = f"larger: its steps to t_end = {t_end!r} are more than {MOST_STEPS:.0e}"
    require((t_end - t0) / dt <= MOST_STEPS, "dt", dt, expected)
    # A remainder below 1e-6 steps is a rounding error of t_end / dt or of the times, not a step.
    rounding = rounding_of(t0, t_end) / dt
    require(rounding < 0.1, "dt", dt, f"larger, as times near t = {t0:g} s are rounded by as much")
    steps = math.ceil((t_end - t0) / dt - max(rounding, 1e-6))
    times = grid_from(t0, dt)(np.arange(steps + 1))
    times[0], times[-1] = t0, t_end
    return StepPlan(times, float(times[1] - times[0]))


def check_scene(scene: object, caller: str) -> None:
    """Refuse what is no scene."""
    if not isinstance(scene, Scene):
        raise SceneError(f"{caller} needs an fx_beam.Scene, not {shown(scene)}")


# -- Times at which equal steps end --------------------------------------------------------------


@dataclass(frozen=True)
class TimeGrid:
    """Ends of steps of the length dt [s], counted from a state; number `first` is its own."""

    origin: float
    first: int
    dt: float

    def __call__(self, number):
        """Time at the end of a step [s]; step 0 is the start."""
        return self.origin + (self.first + number) * self.dt


def rounding_of(*times: float) -> float:
    """Largest rounding error of the difference of two times [s]."""
    return 4 * math.ulp(max(map(abs, times)))


def grid_from(t: float, dt: float) -> TimeGrid:
    """Ends of steps from t [s] on: where a motion from zero has them, if t is one of them.

    So a motion in parts has the times of a motion as a whole, to the last digit.
    """
    number = round(t / dt)
    is_multiple = abs(number * dt - t) <= rounding_of(t)
    return TimeGrid(0.0, number, dt) if is_multiple else TimeGrid(t, 0, dt)


# -- The numbers of a scene that steps read, with those of its state and of functions of time ---


#: Numbers that no step reads, but outputs; without beams also the positions of nodes.
OF_OUTPUTS = {
    "X",
    "a",
    "forces of columns",
    "forces of joints",
    "forces of lines",
    "driven rates",
    "parameters at the start",
    "amplitudes of the load",
    "work at the start",
    "dissipated_energy at the start",
}
#: Names of numbers of one output have this between what they are and its name.
OF_OUTPUT = " of the output "
#: Numbers with a row for each sub-step: values of functions of time.
OF_STEPS = {"loads", "driven", "follower force", "parameters", "naturals", "driven rates"}
# What steps with mean rates read of the state at the start.
_OF_STATE = "q", "q_previous", "v", "slides", "motors", "internal", "spring_internal", "natural"


def numbers_in_steps(
    model: Model, data: SceneArrays, state: State, t0: np.ndarray, t1: np.ndarray
) -> dict[str, MaybeDual]:
    """All numbers of a scene by name, its initial state, and functions of time in steps.

    The steps, or sub-steps of the scheme, begin at t0 (n,) and end at t1 (n,) [s].
    """
    forcing, (parameters, *_), followers = Forcing(model, data), data.forms, data.forms.followers
    step_numbers = {"loads": forcing.loads(t0, t1)}
    step_numbers["driven"] = forcing.series(t1) + data.before_motors
    if parameters.names:
        step_numbers["parameters"] = parameters.over_steps(t0, t1, model.scheme.rates.level)
        step_numbers["parameters at the start"] = parameters.series(t0[:1])[0]
    if len(followers):
        step_numbers["follower force"] = followers.series(t0, t1)
    if data.natural:
        step_numbers["naturals"] = forcing.naturals(t1)
    return numbers_of(model, data) | _arrays(step_numbers) | numbers_of_state(data, state)


def observed_numbers_of(
    model: Model,
    data: SceneArrays,
    state: State,
    times: np.ndarray,
    lengths: np.ndarray,
    at_start: bool,
) -> dict[str, MaybeDual]:
    """Numbers that only outputs read: rates of driven motions.

    They are at `times` (n,), by steps of the `lengths` (n,) that end there [s]. With
    `at_start` also accelerations and forces at the start.
    """
    sizes = fact(model, sizes_of)
    joints, columns = sizes["joints"], sizes["constraints"]
    observed: dict[str, Any] = {}
    if at_start:
        observed["a"] = state.a
        observed["forces of columns"] = _or_zeros(state.constraint_forces, (columns,))
        observed["forces of joints"] = _or_zeros(state.joint_forces, (joints, 3))
        if state.line_forces is None:
            observed["forces of lines"] = np.zeros(sizes["lines"])
    if model.fits_rates:
        rates = Forcing(model, data).end_rates(times, lengths)
        if state.driven_rates is not None:  # those at the start are of the motion before
            rates = dual_array([state.driven_rates, *rates[1:]])
        observed["driven rates"] = rates
    return _arrays(observed)


def are_of_outputs(names: Iterable[str]) -> bool:
    """Whether no step reads numbers of some names, but outputs."""
    return all(name in OF_OUTPUTS or OF_OUTPUT in name for name in names)


def _or_zeros(values: np.ndarray | None, shape: tuple[int, ...]) -> np.ndarray:
    return np.zeros(shape) if values is None else values


def static_numbers_of(
    model: Model, data: SceneArrays, time: float, factors: np.ndarray
) -> dict[str, MaybeDual]:
    """All numbers from the reference configuration, in steps to load factors at a time [s]."""
    forcing, (parameters, *_), followers = Forcing(model, data), data.forms, data.forms.followers
    rows, t = len(factors), np.array([time])
    goal = forcing.series(t)[0]
    step_numbers = {
        "loads": factors[:, None, None] * np.repeat(data.loads.series(t)[None], 2, axis=1),
        "driven": np.stack([factor * goal for factor in factors]) + data.before_motors,
    }
    if parameters.names:
        values = parameters.over_steps(t, t, 1.0)[0, 0]
        step_numbers["parameters"] = np.broadcast_to(values, (rows, 2, len(parameters.names)))
    if len(followers):
        step_numbers["follower force"] = np.repeat(followers.series(t, t), rows, axis=0)
    if data.natural:
        step_numbers["naturals"] = factors[:, None] * forcing.naturals(t)
    state_numbers = numbers_of_state(data, reference_state(model, data.scene))
    return numbers_of(model, data) | _arrays(step_numbers) | state_numbers


def numbers_of_state(data: SceneArrays, state: State) -> dict[str, Any]:
    """Numbers of the state at the start, by name."""
    state_numbers = {name: getattr(state, name) for name in _OF_STATE}
    state_numbers["work at the start"] = state.work
    state_numbers["motors"] = state.motors + data.before_motors[len(data.scene.prescribed) :]
    named = {name.replace("_", " "): values for name, values in state_numbers.items()}
    named |= {"dissipated_energy at the start": state.dissipated}
    return _arrays(named | {"forces of lines": state.line_forces})


def _arrays(numbers: dict[str, Any]) -> dict[str, MaybeDual]:
    return {name: dual_array(values) for name, values in numbers.items() if values is not None}


# -- The model of a motion, and the stepper that takes its steps from the first state on --------


# Energy that is round-off, relative to the sizes of its parts.
_ROUND_OFF = 1e-11


class MotionSetup:
    """The model of a scene and the steps of its motion."""

    def __init__(self, model: Model, options: Options):
        self.model, self.turn_counter = model, TurnCounter(model)
        self._begin_run()
        #: The compiled loop.
        self.loop = CompiledLoop(self.forcing, options.newton, self.stats)
        self._begin_steps(options)

    def _begin_run(self) -> None:
        damping = self.model.data.forms.friction_damping
        self.stats = stats_of(self.model, solver="", friction_damping=damping)
        #: Dead loads and driven motions.
        self.forcing = Forcing(self.model)
        # Those from the reference that `first_of_run` has found, by its other arguments.
        self._first_states: dict[tuple[float, bool], State] = {}

    def _begin_steps(self, options: Options) -> None:
        #: What was asked for when the scene was prepared.
        self.options = options
        dt = options.dt if options.tolerance is None else None
        #: What takes the steps of the loop.
        self.stepper = Stepper(self.loop, Halving(options.max_halvings, dt), self.turn_counter)

    def restart(self, scene: Scene, options: Options) -> None:
        """Begin anew with another scene of this structure, in the same memory.

        OtherStructureError if it, or what is asked for, differs in more; nothing is set then.
        """
        assert self.model.program is not None, "it must be prepared as owned"
        last = self.options
        if (options.scheme, options.newton) != (last.scheme, last.newton):
            raise OtherStructureError("another scheme, or other options")
        self.model.set_numbers(data_of(self.model, scene))
        self.turn_counter.removed = np.zeros(self.model.size)
        self._begin_run()
        self.loop.restart(self.forcing, self.stats)
        self._begin_steps(options)

    def first_state(self, dt: float, start: Solution | None, accelerations: bool = True) -> State:
        """Initial state of a motion by steps of the length dt [s].

        Without `accelerations` it has them only if steps need them.
        """
        model = self.model
        start_state = None if start is None else state_of(model, start)
        if start is not None and start.stats.linear:
            raise SceneError(
                "start: a solution of first order is in no balance in its shape, and would spring "
                "back. Start from fx_beam.static(scene)"
            )
        if start is None or start_state is None or start.stats.static:
            return self.state_from(start_state, dt, accelerations)
        start_state = replace(
            start_state, work=start_state.work + _come_and_gone(model, start, start_state)
        )
        if start_state.fitted is None:
            same_scheme = start.stats.scheme == model.scheme.name
            state = Starts(model, self.forcing, dt).resumed(start_state, same_scheme)
        else:
            state = self.state_from(start_state, dt, accelerations)
            from fx_beam.step.state_vector import energy_of

            supplied, lost = state.work - start_state.work, energy_of(model, start_state)
            lost += supplied - energy_of(model, state)
            state = replace(state, impact=state.impact + lost)
        self.stepper.load(state)
        return state

    def first_of_run(self, dt: float, start: Solution | None, accelerations: bool) -> State:
        """As `first_state`; without a start it is found, and loaded, once for a run."""
        if start is not None:
            return self.first_state(dt, start, accelerations)
        key = dt, accelerations
        if key not in self._first_states:
            self._first_states[key] = self.first_state(dt, None, accelerations)
        return self._first_states[key]

    def recorded_state(
        self, recorder: Recorder, dt: float, start: Solution | None, accelerations: bool = False
    ) -> State:
        """First state for a recorder, which may find its accelerations when they are read."""
        model, rates = self.model, self.options.record.rates
        later = start is None and fact(model, initial_state.finds_accelerations_later)
        state = self.first_of_run(dt, start, accelerations or (rates and not later))
        if rates and later and not accelerations:
            starts = Starts(model, self.forcing, dt)
            recorder.late_accelerations = starts.late_accelerations(state)
        return state

    def state_from(self, start: State | None, dt: float, accelerations: bool = True) -> State:
        """First state from an equilibrium, or from the reference configuration."""
        state = Starts(self.model, self.forcing, dt).initial(start, accelerations)
        state = self._with_smooth_start(state, dt)
        self.stepper.load(state)
        return state

    @property
    def _smooths(self) -> bool:
        many = len(self.model.scheme.fractions) > 1
        return many and self.model.fits_rates and self.options.tolerance is None

    def smooths_start(self, start: Solution | None) -> bool:
        """Whether a step finds the slow part of the first state of a motion."""
        start_state = None if start is None or start.stats.static else state_of(self.model, start)
        return self._smooths and (start_state is None or start_state.fitted is not None)

    def _with_smooth_start(self, state: State, dt: float) -> State:
        """The state of initial rates with the slow part, found by a step of the length dt [s].

        The same state for schemes without sub-steps, whose forces are of order two.
        """
        model = self.model
        if not self._smooths:
            return state
        from fx_beam.step.fitted_rates import rate_fit

        end = self.stepper.trial(state, state.t + dt).state
        if end is None:
            return state
        fits = rate_fit(model)
        driven = floats(self.forcing.end_rates(np.array([end.t]), np.array([dt])))
        swing = fits.fit(end.q[None], end.v[None], end.slides[None], driven).corrections
        # The slow part is the mean of both ends, as the start fits; at the start it is normal to
        # what joints allow there.
        at_rest = np.zeros((1, model.couplings.driven))
        slow = fits.fit(state.q[None], swing / 2, state.slides[None], at_rest).corrections[0]
        # Driven motions give it; as the record has their work, that at the start is zero.
        supplied = state.v @ (model.masses.matrix @ slow) if model.couplings.driven else 0.0
        return replace(state, v=state.v + slow, work=state.work + supplied)


_KEPT_ERRORS = (
    "{}: accelerations of bodies that turn on joints, and forces of joints there, may be wrong by "
    "more than their size, whatever the step, as nothing damps their errors; displacements are "
    "right. Take EnergyMomentum() or HHT() for forces"
)


def prepare(scene: Scene, options: Options, owned: bool = False) -> MotionSetup:
    """A prepared scene with memory of its own; one that is `owned` serves other scenes later."""
    if options.scheme.built_in:
        model, reason = PROGRAMS.model_of(scene, options.scheme, owned)
    else:
        model, reason = Model(scene, options.scheme), "the first scene"
        if owned:
            model = Program(model).model_of(scene)
    prepared = MotionSetup(model, options)
    prepared.stats.setup_reason = reason
    if fact(model, keeps_rate_errors):
        warn_once(_KEPT_ERRORS.format(options.scheme.name))
    return prepared


def model_for(
    scene: Scene,
    scheme: Scheme,
    own: dict[str, Model] | None = None,
    name: str = "",
    **options: bool,
) -> Model:
    """A model of a scene, by `options` of `Model`.

    That of a `name` among models of the caller's `own`, if the scene has its structure: these get
    the numbers of scene after scene.
    """
    call_with_arrays(scene)
    if own is None:
        return PROGRAMS.model_of(scene, scheme, **options)[0]
    if (model := own.get(name)) is not None:
        try:
            model.set_numbers(data_of(model, scene))
        except OtherStructureError:
            pass
        else:
            return model
    own[name] = PROGRAMS.model_of(scene, scheme, owned=True, **options)[0]
    return own[name]


def _come_and_gone(model: Model, start: Solution, state: State) -> float:
    """Energy [J] that came or went with what was added to a scene, taken away, or changed.

    Energies of a solution may contain work of driven motions that made the rates fit.
    """
    end, energy = end_of(start), start.energy
    if start.t[-1] != end.t:
        return 0.0  # the record has no row of the end
    from fx_beam.step.state_vector import energy_of

    change = energy_of(model, state) - float(energy.total[-1] - (energy.work[-1] - end.work))
    parts = energy.kinetic, energy.strain, energy.potential, energy.springs
    return change if abs(change) > _ROUND_OFF * sum(abs(part[-1]) for part in parts) else 0.0


def state_of(model: Model, start: Solution) -> State:
    """Last state of a solution as vectors; SceneError if it does not fit."""
    changed, known = initial_state.scene_has_changed(model, start), model.forms.parameters
    state = TransferredState(model, start).state() if changed else _same(model, start)
    values = known.values_at(before(state.t)) if len(known) else None
    check_joints(model, state := replace(state, parameters=values))
    return state


def _same(model: Model, start: Solution) -> State:
    """The state of a scene with the same members, joints and supports."""
    end = end_of(start)
    for owner, has, needs in (
        ("sections", end.internal, model.forms.internal_shape),
        ("springs", end.spring_internal, (model.points.width,)),
    ):
        differs = needs[-1] > 0 if has is None else has.shape != needs
        if differs:
            raise SceneError(
                f"start: the solution has other internal variables than the {owner} of the scene"
            )
    state = end.reshaped(-1)
    natural, forces = state.natural if model.data.natural else None, state.constraint_forces
    if model.data.natural and natural is None:
        natural = np.zeros(model.data.natural.shape)
    if forces is not None and len(forces) != model.reduction.columns - model.reduction.free:
        forces = None  # other supports
    driven = state.driven_forces
    if driven is not None and len(driven) != model.reduction.driven:
        driven = None  # other supports
    pulls = state.line_forces
    if pulls is not None and len(pulls) != model.scene.force_count:
        pulls = None  # other forces between points
    # Accelerations of other rules keep what joints do not allow; the energy of that is work.
    v = state.v if state.fitted is None or model.scheme.rates.mean_based else state.fitted
    state = replace(state, natural=natural, constraint_forces=forces, line_forces=pulls)
    state = replace(state, driven_forces=driven)
    return replace(state, v=v, fitted=None)


def stats_of(model: Model, **members: Any) -> Stats:
    """Statistics of a run that has not begun."""
    return Stats(
        scheme=model.scheme.name,
        level=model.scheme.rates.level,
        unknowns=model.couplings.free - len(model.couplings.closures),
        compiled=[] if model.forms.beams is None else [*model.forms.beams.names],
        assembled=model.masses.assembled,
        **members,
    )
