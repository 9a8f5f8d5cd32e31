"""Values of states of a model: energies, rates of slides, and starts of steps from them."""

from __future__ import annotations

import numpy as np

from fx_beam.laws.interval import Interval, StepBatch
from fx_beam.results.state import State
from fx_beam.scene.joints import joints_by_number

from .model import Model


def energy_of(model: Model, state: State) -> float:
    """Kinetic, stored and potential energy [J]."""
    forms, weight = model.forms, model.masses.weight
    forms.parameters.use(state.parameters)
    strained = forms.strain_energy(state.q, state.internal, state.natural)
    stored = forms.compiled_points.energy(state.q, state.slides, state.spring_internal)
    potential = 0.0 if weight is None else -(weight @ state.q)
    kinetic = state.v @ (model.masses.matrix @ state.v) / 2 if state.v.any() else 0.0
    return float(sum((kinetic, strained, potential, stored)))


def start_of(model: Model, state: State, length: float) -> StepBatch:
    """The start of a step of some length [s] from a state, for the forces.

    Natural strains do not change in the step.
    """
    # At mid-step forces at points depend on mean rates alone.
    needed = model.scheme.rates.level != 0.5 and not model.scheme.rates.at_rest
    rates = slide_rates(model, state) if needed else 0 * state.slides
    return StepBatch.single(
        state.t,
        length,
        q=state.q,
        v=state.v,
        a=state.a,
        q_previous=state.q if state.q_previous is None else state.q_previous,
        memory=np.array(state.memory(length)),
        internal=state.internal,
        slides=state.slides,
        slide_rates=rates,
        spring_internal=state.spring_internal,
        natural=state.natural,
        natural_end=state.natural,
    )


def added_force(model: Model, state: State, factor: float, time: float) -> np.ndarray:
    """Followers and added virtual works (size,) of a state at a load factor [N, N m]."""
    zero, forms = np.zeros(model.size), model.forms
    if not forms.has_added:
        return zero
    forms.set_load(factor)
    forces = forms.begin_step(Interval(time, time), start_of(model, state, 0.0))
    forces.internal(zero)
    return forces.added()


def slide_rates(model: Model, state: State) -> np.ndarray:
    """Rates (joints,) of the slides on which forces act; zero for others."""
    rates = np.zeros(len(state.slides))
    if len(model.points.slides):
        motion = model.mesh.motion(model.scene, q=state.q[None], v=state.v[None])
        joints = joints_by_number(model.scene)
        for number in set(model.points.slides.tolist()):
            kinematics = joints[number].kinematics
            (rates[number],) = kinematics.rate(motion, state.slides[[number]])
    return rates
