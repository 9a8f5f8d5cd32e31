"""Mass, damping and stiffness of small deviations from a state at rest or in motion."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse
from scipy.sparse import csr_matrix

from fx_beam.dual import floats
from fx_beam.errors import SceneError
from fx_beam.laws.interval import instant
from fx_beam.laws.schemes import EnergyMomentum
from fx_beam.motions.initial_state import drawn_state
from fx_beam.motions.motion_setup import model_for, state_of
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.functions import InputSignal, constant
from fx_beam.scene.loads import damping_of
from fx_beam.scene.scene import Scene
from fx_beam.step.equations import Equations, Residual, acceleration_of
from fx_beam.step.fitted_rates import rate_fit
from fx_beam.step.forcing import Forcing, TurningFrame
from fx_beam.step.model import Model
from fx_beam.step.state_vector import added_force
from fx_beam.step.step_inputs import HeldInputs

from .linearisation import (
    INSTANT,
    check_damping,
    check_finite,
    check_unknowns,
    dead_loads,
    settled_reference,
    turning_frame_of,
)

_log = logging.getLogger("fx_beam")

# Rates that differ from those of a turn by less, relative to it, are rigid.
_RIGID = 1e-2
# Weight of rates without mass, relative to the largest.
_LITTLE = 1e-10
# Change of an input, relative to it, or of strains by it. Increment, in units of the scene, in the
# steps that give the stiffness of a moving state: in a smaller one damping over the length hides
# the stiffness. The least rate that limits this length [1/s].
_SMALL, _SHORT, _REST = 1e-5, 3e-5, 3e-11
# Rounding errors of damping, relative to the tangents of which it is a difference.
_NO_DAMPING = 1e-13
# Increment between the points of differences of order six, in units of the scene, or of the
# shortest element if nodes slide; the least one, near ends of elements on which nodes slide.
# Weights of these differences.
_APART, _LEAST_APART = 0.01, 1e-4
_FIRST, _SECOND = (3 / 4, -3 / 20, 1 / 60), (3 / 2, -3 / 20, 1 / 90)
# Half of the time over which a natural strain is seen to change, relative to the last step of the
# motion, and at least relative to the time; at the time zero before the first step [s]. The largest
# difference of its changes before and behind, relative to them; round-off of it.
_MOMENT, _OF_TIME, _AT_ZERO, _KINK, _ROUNDING = 1e-3, 1e-9, 1e-6, 1e-3, 1e-13
# Least step of second differences of driven motions, relative to the time: they would be round-off
# where the last step of a motion is very short.
_BENT = 1e-8
# Forces without balance in the reference, relative to the largest, that are no round-off.
_UNBALANCED = 1e-9
_NONE = np.empty(0)


@dataclass(frozen=True, eq=False)
class Deviations:
    """M z'' + C z' + K z = 0 for small deviations z of the unknowns and of driven motion."""

    model: Model
    held: HeldInputs
    forcing: Forcing
    #: The state, and the rates (columns,) in it.
    state: State
    rates: np.ndarray
    #: Numbers (free,) in the model of the unknowns in z; others follow to close loops.
    unknowns: np.ndarray
    #: Mass, damping and stiffness (columns, columns), those of the unknowns first.
    M: csr_matrix
    C: csr_matrix
    K: csr_matrix
    #: Coupling (size, columns) of the nodes, and its derivative by time.
    T: csr_matrix
    dT: csr_matrix
    #: Matrix (all, columns) of all columns of the model by z, and its derivative by time.
    S: csr_matrix
    dS: csr_matrix
    #: The frame in which the state is at rest and z is measured, if it turns, and the load factor.
    frame: TurningFrame | None
    factor: float

    @property
    def rates_from(self) -> np.ndarray:
        """R (columns, size): z' = R v for rates v of the nodes."""
        return _rates_from(self.model, self.T.toarray())


def deviations(scene: Scene, solution: Solution | None, caller: str) -> Deviations:
    """Deviations from the last row of a solution, or from the reference without loads.

    T^T (M x'' + f(x, x') - F) = 0 with x = g(z) and T = dg/dz; rates and accelerations of the state
    are kept while its equations are differentiated. A static state that turns rests in its frame.
    """
    inputs, factor = HeldInputs(scene), 1.0
    if solution is None:
        factor = 0.0
        for i, load in enumerate(inputs.scene.loads):
            if not isinstance(load.value, InputSignal):
                inputs.scene.loads[i] = replace(load, value=constant(0 * load.value(0.0)))
    elif solution.stats.static:
        factor = float(solution.t[-1])
    model, frame = model_for(inputs.scene, EnergyMomentum(), instant=True, released=True), None
    check_unknowns(model, caller)
    forcing = Forcing(model)
    if solution is None:
        state = drawn_state(model)
    else:
        state = state_of(model, solution)
        inputs.resume(forcing, state)
        state = _with_fitted_rates(model, state, solution)
        frame = turning_frame_of(model, solution, caller)
    if frame is not None:
        state = replace(state, v=0 * state.v, a=0 * state.a)
    coupling = _Coupling(model, state)
    if singularity := model.reduction.singularity:
        raise SceneError(f"{caller}: {singularity}. Take a state beside it")
    T, S = coupling.parts(coupling.X)
    unknowns = coupling.columns[: coupling.count - model.couplings.released]
    w = _rates_of(model, forcing, state, T)
    (dT, dS), (ddT, _) = map(coupling.parts, coupling.derivatives(w))
    _warn_of_turn(model, state, T, dT, caller)
    strained = None
    if solution is not None and not solution.stats.static:
        strained = _natural_rates(model, state, caller)
    steps = _Steps(model, state, S @ w, strained)
    steps.equations.set_load(factor)
    mass, residual = model.masses.matrix, steps.residual()
    added = added_force(model, state, factor, state.t)
    dead = dead_loads(model, state, factor, frame, added)
    if solution is None and steps.are_unbalanced(residual):
        settled = settled_reference(scene, caller)
        if settled is not None:
            return deviations(scene, settled, caller)
    if frame is not None:
        dead += factor * frame.force(state.q)
    dead -= mass @ (dT @ w)
    a = _accelerations(model, forcing, state, T, residual - T.T @ dead, dT @ w)
    turning, _ = coupling.parts(coupling.derivatives(a)[0])
    K, C = steps.slopes(dead - mass @ (T @ a))
    steps.equations.set_load(1.0)
    check_finite(K.data, residual, caller)
    if not factor:  # loads that depend on rates damp, as in `modes`
        _, C = steps.slopes(dead)
    K = K + T.T @ (mass @ (turning + ddT))
    C = C + 2 * T.T @ (mass @ dT)
    if frame is not None:
        K = K - factor * frame.spin**2 * (T.T @ frame.mass @ T)
        C = C + np.sqrt(factor) * T.T @ frame.gyroscopic @ T
    return Deviations(
        model=model,
        held=inputs,
        forcing=forcing,
        state=state,
        rates=w,
        unknowns=unknowns,
        M=(T.T @ (mass @ T)).tocsr(),
        C=C.tocsr(),
        K=K.tocsr(),
        T=T,
        dT=dT,
        S=S,
        dS=dS,
        frame=frame,
        factor=factor,
    )


def _warn_of_turn(model: Model, state: State, T: csr_matrix, dT: csr_matrix, caller: str) -> None:
    """Warn where the scene turns as a whole, but z is measured in space."""
    v = state.v.reshape(-1, 3)
    spin = float(np.median(v[:, 2]))
    if not spin:
        return
    x = (model.mesh.X + state.q.reshape(-1, 3)[:, :2]) @ [1, 1j]
    rates = v @ [1, 1j, 0]
    pivot = np.mean(x + 1j * rates / spin)
    frame = TurningFrame(model, spin, (pivot.real, pivot.imag))
    apart = abs(state.v - frame.rates(state.q, 1.0)) / model.units.nodes
    turned = frame.spin * (frame.quarter_turn @ T.toarray())
    space_share = abs(turned - dT.toarray()).max(initial=0.0)
    if apart.max() < _RIGID * abs(spin) and space_share > _RIGID * abs(spin):
        _log.warning(
            "%s: the scene turns as a whole, at %.4g rad/s about (%.4g, %.4g), but the linear "
            "system is that of the instant, in places measured in space: its eigenvalues are not "
            "the frequencies seen in the turn. Take the state from static(scene, spin=...)",
            *(caller, spin, pivot.real, pivot.imag),
        )


def _with_fitted_rates(model: Model, state: State, solution: Solution) -> State:
    """The state with rates that fit the joints: those of the last row, if they were recorded."""
    if solution.has_rates and solution.t[-1] == state.t:
        state = replace(state, v=solution.v[-1].flatten())
    if not model.fits_rates:
        return state
    none = np.empty((1, 0))
    fit = rate_fit(model).fit(state.q[None], state.v[None], state.slides[None], none)
    return replace(state, v=fit.rates[0])


def _rates_from(model: Model, T: np.ndarray) -> np.ndarray:
    """Matrix R (columns, size): z' = R v has T z' nearest to rates v of the nodes.

    Rates of nodes without mass count little: they are means over the last step.
    """
    weight = model.masses.matrix.diagonal() * model.units.nodes**2
    root = np.sqrt(weight + _LITTLE * (weight.max(initial=0.0) or 1.0)) / model.units.nodes
    return np.linalg.pinv(root[:, None] * T) * root


def _rates_of(model: Model, forcing: Forcing, state: State, T: csr_matrix) -> np.ndarray:
    """Rates z' (columns,): of driven motions as the step ended, of unknowns by the nodes."""
    if not state.v.any():
        return np.zeros(T.shape[1])
    T, free = T.toarray(), T.shape[1] - model.couplings.released
    w = _rates_from(model, T) @ state.v
    if model.couplings.released and state.length:
        known = floats(forcing.end_rates(np.array([state.t]), np.array([state.length])))[0]
        w[free:] = np.where(forcing.straight, w[free:], known)
        w[:free] = _rates_from(model, T[:, :free]) @ (state.v - T[:, free:] @ w[free:])
    return w


class _Coupling:
    """X(z) = (T; S), T (size, columns) of the nodes, S of the model's columns; its derivatives.

    z has the independent unknowns, then the driven columns.
    """

    def __init__(self, model: Model, state: State):
        self._model, self._reduction, self._state = model, model.reduction, state
        model.reduction.set_start(state.q, state.slides)
        #: Numbers (count,) of the columns z.
        self.columns = model.reduction.independent
        self.count = len(self.columns)
        self.X = self._at(np.zeros(self.count))

    def parts(self, X: csr_matrix) -> tuple[csr_matrix, csr_matrix]:
        """The rows of nodes and of columns."""
        return X[: self._model.size], X[self._model.size :]

    def _at(self, z: np.ndarray) -> csr_matrix:
        moved = np.zeros(self._reduction.free)
        moved[self.columns] = z
        self._reduction.increment(moved, _NONE)
        parts = self._reduction.maps.coupling(), self._reduction.maps.dependence_matrix()
        return scipy.sparse.vstack(parts, "csr")[:, self.columns]

    def derivatives(self, z: np.ndarray) -> tuple[csr_matrix, csr_matrix]:
        """First and second derivative of X along z."""
        size = abs(self.parts(self.X)[0] @ z / self._model.units.nodes).max(initial=0.0)
        first = second = csr_matrix(self.X.shape)
        if not (self._model.scene.joints and size):
            return first, second
        h = _APART / size
        if self._reduction.couplings.sliding:
            # Nodes of an element move against each other, which bends and turns it.
            h *= min(self._model.mesh.shortest) / self._model.mesh.size
        # All points are in one element of a beam on which a node slides.
        self._reduction.set_start(self._state.q, self._state.slides)
        reach = self._reduction.reach(self._state.slides, self.parts(self.X)[1] @ z)
        h = min(h, max(reach / 4, _LEAST_APART / size))
        for k, (odd, even) in enumerate(zip(_FIRST, _SECOND, strict=True), start=1):
            # Constant entries have differences of zero, without rounding errors.
            ahead, back = self._at(k * h * z), self._at(-k * h * z)
            first = first + odd / h * (ahead - back)
            second = second + even / h**2 * ((ahead - self.X) + (back - self.X))
        return first, second


def _natural_rates(model: Model, state: State, caller: str) -> np.ndarray | None:
    """Rates (cells, degree, 3) of natural strains [1/s], which damp; None without any."""
    if not model.data.natural:
        return None
    t = state.t
    h = max(_MOMENT * state.length, _OF_TIME * abs(t)) or _AT_ZERO
    values = np.array([model.data.natural.sum_at(t + k * h) for k in range(-2, 3)])
    # Over twice the time a smooth function bends four times as much, one with a kink twice.
    weights = [[0, -1, 0, 1, 0], [0, 1, -2, 1, 0], [-1, 4, -6, 4, -1]]
    differences = np.tensordot(weights, values, 1)
    sizes = abs(differences) * (1.0, 1.0, model.mesh.size)
    damped = damping_of(model.scene)[1] > 0
    for beam, cells in zip(model.scene.beams, model.mesh.cells, strict=True):
        change, bend, jump = sizes[:, cells].max(axis=(1, 2, 3))
        if (beam.section.damped or damped) and jump > _KINK * change + bend + _ROUNDING:
            raise SceneError(
                f"{caller}: beam {beam.name!r} has retardation, and a natural strain whose rate "
                f"jumps at t = {t:g}, and with it a force. Take a state before or behind it"
            )
    return differences[0] / (2 * h)


class _Steps:
    """Steps through a state, half of each before it and half behind, and their forces.

    Of rates (all,) of all columns; natural strains may be `strained` at rates (cells, degree, 3).
    """

    def __init__(
        self, model: Model, state: State, rates: np.ndarray, strained: np.ndarray | None = None
    ):
        self._model, self._state, self._strained = model, state, strained
        self._rates = rates[: model.reduction.free]
        speed = 0.0 if strained is None else abs(strained).max()
        if model.forms.depend_on_rates:
            speed = max(speed, abs(state.v / model.units.nodes).max())
        else:
            self._rates = 0 * self._rates
        #: Lengths of steps that tell damping, and stiffness [s]. In an instant strains of round-off
        #: would have large rates, and damping hides the stiffness.
        self.instant, self.short = INSTANT / max(speed, 1.0), _SHORT / max(speed, _REST)
        self.equations = Equations(model, natural=lambda end: self._strains, inert=False)

    def balance(self, h: float, force: np.ndarray) -> Residual:
        """Forces of a step of the length h [s], which may go back, under dead loads `force`."""
        model, state, half = self._model, self._state, h / 2 * self._rates
        model.reduction.set_start(state.q, state.slides)
        q = state.q + model.reduction.increment(-half, _NONE)
        slides = state.slides - model.couplings.free_slides(half, len(state.slides))
        start = replace(state, q=q, slides=slides, parameters=None)  # those of the inputs
        self._strains = state.natural
        if state.natural is not None and self._strained is not None:
            change = h / 2 * self._strained
            start.natural, self._strains = state.natural - change, state.natural + change
        self.equations.set_start(instant(state.t, h), start)
        self._last = self.equations.evaluate(2 * half, _NONE, force)
        return self._last

    def _limit(self, value_of: Callable[[float], Any]) -> Any:
        """A value for steps of no length, from two lengths; where nothing flows also of steps back.

        Of these the mean has an error that grows with the square of the length.
        """
        h = self.short
        if not self._rates.any() and self._strained is None:
            return value_of(h)
        if self._model.kinks.flows:
            return 2 * value_of(h) - value_of(2 * h)
        near, far = (value_of(length) + value_of(-length) for length in (h, 2 * h))
        return (4 * near - far) / 6

    def residual(self) -> np.ndarray:
        """All forces (columns,), without dead loads and inertia."""
        columns, none = self._model.reduction.independent, np.zeros(self._model.size)
        return self._limit(lambda h: self.balance(h, none).residual[columns])

    def are_unbalanced(self, residual: np.ndarray) -> bool:
        """Whether forces on unknowns are more than round-off of the last ones at nodes."""
        units, driven = self._model.units, self._model.couplings.released
        columns = self._model.reduction.independent[: len(residual) - driven]
        largest = abs(self._last.f * units.nodes).max(initial=0.0)
        left = abs(residual[: len(columns)] * units.unknowns[columns])
        return bool(left.max(initial=0.0) > _UNBALANCED * largest)

    def _tangent(self, h: float, force: np.ndarray) -> csr_matrix:
        """Derivative (columns, columns) by the end of a step: K / 2 + C / h."""
        self.balance(h, force)
        return self.equations.tangent()

    def slopes(self, force: np.ndarray) -> tuple[csr_matrix, csr_matrix]:
        """Derivatives (columns, columns) of all forces by z and z', by exact tangents of steps.

        The derivatives by the ends of a step and of one back are half of that by z.
        """
        dt = self.instant
        if not self._model.forms.depend_on_rates:
            half = self._tangent(dt, force)
            return 2 * half, 0 * half
        # Without what grows with the motion in a step, and without rounding errors of the
        # stiffness: they would damp what has no mass.
        a, b, c = (self._tangent(multiple * dt, force) for multiple in (1, 2, 4))
        C, terms = (4 / 3 * dt * (2 * a - 3 * b + c)).tocoo(), np.sqrt(abs(dt * a.diagonal()))
        C.data[abs(C.data) <= _NO_DAMPING * terms[C.row] * terms[C.col]] = 0.0
        C = C.tocsr()

        K = 2 * self._limit(lambda h: self._tangent(h, force) - C / h)
        check_damping(np.append(K.data, C.data), "linearise: the damping in this state")
        return K, C


def forces_inside(about: Deviations, name: str) -> tuple[np.ndarray, np.ndarray]:
    """Forces F, G (columns,) of F u + G u', for an input u of parameters or natural strains.

    G is not zero where it strains a material that damps.
    """
    inputs, natural, state, model = about.held, about.model.data.natural, about.state, about.model
    value, h = inputs.values[name], _SMALL * (abs(inputs.values[name][0]) or 1.0)
    forces, strains = [], []

    def strained(values: np.ndarray) -> np.ndarray:
        inputs.set({name: values})
        inputs.arrive()
        return natural.sum_at(state.t) if natural else np.zeros(3)

    try:
        change = abs(strained(value + 1.0) - strained(value)) * (1.0, 1.0, model.mesh.size)
        if change.any():
            h = max(h, _SMALL / change.max())
        for changed in (value - h, value + h):
            strains.append(strained(changed))
            if natural:
                state = replace(state, natural=strains[-1])
            steps = _Steps(model, state, about.S @ about.rates)
            forces.append(-steps.residual())
    finally:
        inputs.set({name: value})
        inputs.arrive()
    force = (forces[1] - forces[0]) / (2 * h)
    if not natural or not about.model.forms.depend_on_rates:
        return force, np.zeros_like(force)
    rate = (strains[1] - strains[0]) / (2 * h)
    still = replace(about.state, v=0 * about.state.v)  # without the round-off of other rates
    ahead, back = (_Steps(model, still, 0 * about.S @ about.rates, sign * rate) for sign in (1, -1))
    return force, (back.residual() - ahead.residual()) / 2


def _accelerations(
    model: Model,
    forcing: Forcing,
    state: State,
    T: csr_matrix,
    residual: np.ndarray,
    turning: np.ndarray,
) -> np.ndarray:
    """Accelerations z'': of unknowns by the equations, of driven motions as the step ended.

    The forces without M T z'' leave a `residual` (columns,). Inputs have no acceleration.
    """
    driven, mass = model.couplings.released, model.masses.matrix
    a, free = np.zeros(T.shape[1]), T.shape[1] - driven
    unknowns = model.reduction.independent[:free]
    if driven and state.length:  # `State.a` is that of the middle of the step
        h = max(_MOMENT * state.length, _BENT * abs(state.t))
        a[free:] = forcing.derivatives(state.t, -h)[1]
    elif driven and state.a.any():
        unit = model.units.nodes
        scaled = T.toarray() / unit[:, None]
        a = np.linalg.lstsq(scaled, (state.a - turning) / unit, rcond=None)[0]
        a[:free] = 0.0
    for i, function in enumerate(forcing.functions):
        if function.ramps:
            a[free + i] = 0.0
    M, unit = (T.T @ (mass @ T)).tocsr(), model.units.unknowns[unknowns]
    a[:free] = acceleration_of(M[:free, :free], -(residual + M @ a)[:free], unit)
    return a
