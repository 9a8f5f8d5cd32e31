"""The model of a motion, and the stepper that takes its steps from the first state on."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from fx_beam.dual import floats
from fx_beam.errors import SceneError
from fx_beam.fem.parameter_values import before
from fx_beam.laws.schemes import Scheme
from fx_beam.results.records import Stats
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.step.forcing import Forcing
from fx_beam.step.full_turns import TurnCounter
from fx_beam.step.loop import CompiledLoop
from fx_beam.step.model import Model, data_of, fact
from fx_beam.step.program import PROGRAMS, Program
from fx_beam.step.recorder import Recorder
from fx_beam.step.stepper import Stepper
from fx_beam.step.substeps import Halving

from .initial_state import Starts, check_joints, end_of, finds_accelerations_later
from .options import Options
from .surroundings import call_with_arrays

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
            from fx_beam.step.state_values import energy_of

            supplied, lost = state.work - start_state.work, energy_of(model, start_state)
            lost += supplied - energy_of(model, state)
            state = replace(state, impact=state.impact + lost)
        self.stepper.load(state)
        return state

    def recorded_state(
        self, recorder: Recorder, dt: float, start: Solution | None, accelerations: bool = False
    ) -> State:
        """First state for a recorder, which may find its accelerations when they are read."""
        model, rates = self.model, self.options.record.rates
        later = start is None and fact(model, finds_accelerations_later)
        state = self.first_state(dt, start, accelerations or (rates and not later))
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
    from fx_beam.step.state_values import energy_of

    change = energy_of(model, state) - float(energy.total[-1] - (energy.work[-1] - end.work))
    parts = energy.kinetic, energy.strain, energy.potential, energy.springs
    return change if abs(change) > _ROUND_OFF * sum(abs(part[-1]) for part in parts) else 0.0


def state_of(model: Model, start: Solution) -> State:
    """Last state of a solution as vectors; SceneError if it does not fit."""
    from .transferred_state import TransferredState, scene_has_changed

    state = (
        TransferredState(model, start).state()
        if scene_has_changed(model, start)
        else _same(model, start)
    )
    parameters = model.forms.parameters
    state = replace(
        state, parameters=parameters.values_at(before(state.t)) if len(parameters) else None
    )
    check_joints(model, state)
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
    pulls = state.line_forces
    if pulls is not None and len(pulls) != model.scene.force_count:
        pulls = None  # other forces between points
    # Accelerations of other rules keep what joints do not allow; the energy of that is work.
    v = state.v if state.fitted is None or model.scheme.rates.mean_based else state.fitted
    state = replace(state, natural=natural, constraint_forces=forces, line_forces=pulls)
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
