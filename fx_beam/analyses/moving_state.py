"""Mass, damping and stiffness of small deviations from a state at rest or in motion."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.mechanics.interval import Interval
from fx_beam.mechanics.schemes import EnergyMomentum
from fx_beam.model.model import Model
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.beam import Node
from fx_beam.scene.joints import GROUND
from fx_beam.scene.scene import Scene
from fx_beam.stepping.forcing import Drive
from fx_beam.stepping.held_inputs import HeldInputs, Hold, Ramp
from fx_beam.stepping.initial_state import acceleration_of, reference_state
from fx_beam.validation import Constant

from .engine import end_of, state_of

# Length of steps in which nothing moves, but rates are seen [s].
_MOMENT = 1e-30
# Largest increment, in units of the scene, of the steps that give the stiffness of a moving state:
# its square is their error, and damping over their length a rounding error. Internal variables
# evolve meanwhile: with them the steps are short [s].
_SMALL, _SHORT = 1e-5, 1e-6
# The same between the points of differences of order six, and their weights.
_APART = 0.02
_FIRST, _SECOND = (3 / 4, -3 / 20, 1 / 60), (3 / 2, -3 / 20, 1 / 90)


class Deviations(NamedTuple):
    """M z'' + C z' + K z = 0 for small deviations z of the unknowns and of driven motion."""

    model: Model
    held: HeldInputs
    drive: Drive
    #: The state, in the numbering of the model, and its rates (columns,) of z.
    state: State
    rates: np.ndarray
    #: Mass, damping and stiffness (columns, columns), those of the unknowns first.
    M: np.ndarray
    C: np.ndarray
    K: np.ndarray
    #: Coupling (size, columns), and its derivative by time.
    T: np.ndarray
    dT: np.ndarray


def deviations(scene: Scene, at: Solution | None, what: str) -> Deviations:
    """Deviations from the last row of a solution, or from the reference without loads.

    T^T (M x'' + f(x, x') - F) = 0 with x = g(z) and T = dg/dz; rates and accelerations of the state
    are kept while its equations are differentiated.
    """
    held = HeldInputs(scene)
    if at is None:
        end_factor = 0.0
        held.scene.loads = [
            load
            if isinstance(load.value, Hold)
            else replace(load, value=Constant(0 * load.value(0.0)))
            for load in held.scene.loads
        ]
    else:
        end_of(at)
        end_factor = float(at.t[-1]) if at.stats.static else 1.0
    model = Model(held.scene, EnergyMomentum())
    if not model.reduction.free:
        raise SceneError(
            f"{what}: the scene has no unknowns: supports, joints and motors fix all degrees of "
            "freedom. Release one of them"
        )
    drive = Drive(model)
    state = reference_state(model)
    if at is not None:
        state = state_of(model, at)
        held.resume(drive, state, state.inputs)
    coupling = _Coupling(model, state)
    n, T = coupling.count, coupling.T
    w = rates_of(model, model.to_nodes(state.q), model.to_nodes(state.v), state.slides)
    dT, ddT = coupling.derivatives(w)
    f, K, C = _forces(model, state)
    model.actuators.begin(state.q, state.slides, _MOMENT)
    model.actuators.set_internal(state.spring_internal, _MOMENT)
    springs = [
        part[..., :n][:n] if part.ndim == 2 else part[:n]
        for part in model.actuators.linear(state.q, state.v, state.slides, model.reduction.columns)
    ]
    mass = model.mass
    dead = end_factor * drive.forces(Interval(state.t, state.t))[0]
    a = _accelerations(model, drive, state, T, mass @ (dT @ w) + f - dead, springs[2], dT @ w)
    r = f - dead + mass @ (T @ a + dT @ w)
    turning, _ = coupling.derivatives(a)
    return Deviations(
        model,
        held,
        drive,
        state,
        w,
        M=T.T @ (mass @ T),
        C=T.T @ (C @ T + 2 * (mass @ dT)) + springs[1],
        K=T.T @ (K @ T + C @ dT + mass @ (turning + ddT)) + coupling.of_forces(r) + springs[0],
        T=T,
        dT=dT,
    )


def rates_of(model: Model, q: np.ndarray, v: np.ndarray, slides: np.ndarray) -> np.ndarray:
    """Rates of z from displacements and rates (nodes, 3) and slides (joints,)."""
    along = np.zeros(len(slides))
    for joint in model.scene.joints:
        if joint.axis is None:
            continue
        (qa, va), (_, vb) = (_at(joint.a, q, v), _at(joint.b, q, v))
        c, s = np.cos(qa[2]), np.sin(qa[2])
        x, y = vb[:2] - va[:2]
        # The velocity of b relative to its position on a, in the frame of a.
        arm = joint.offset + slides[joint.number] * joint.axis
        seen = np.array([c * x + s * y + va[2] * arm[1], c * y - s * x - va[2] * arm[0]])
        along[joint.number] = seen @ joint.axis
    unknowns = model.couplings.unknowns(model.from_nodes(v), along)
    return np.concatenate([unknowns, driven_of(model, v, along)])


def driven_of(model: Model, values: np.ndarray, slides: np.ndarray) -> np.ndarray:
    """Prescribed motions and coordinates of motors (driven,), from values (nodes, 3)."""
    found = [values[key] for key in model.scene.prescribed]
    for joint, name in model.motors:
        if name == "slide":
            found.append(slides[joint.number])
        else:
            (a,), (b,) = (_at(node, values) for node in (joint.a, joint.b))
            found.append(b[2] - a[2])
    return np.array(found)


def _at(node: Node, *values: np.ndarray) -> list[np.ndarray]:
    """Rows (3,) of a node; zero on the ground."""
    return [np.zeros(3) if node is GROUND else rows[node.number] for rows in values]


class _Coupling:
    """T and its derivatives along motions of z, for the free and driven columns."""

    def __init__(self, model: Model, state: State):
        self._model, self._reduction = model, model.reduction
        self._free = model.reduction.free
        self.count = self._free + model.reduction.driven
        model.reduction.begin(state.q, state.slides, 1.0)
        self.T = self._at(np.zeros(self.count))

    def _at(self, z: np.ndarray) -> np.ndarray:
        self._reduction.expand(z[: self._free], z[self._free :])
        return self._reduction.coupling().toarray()[:, : self.count]

    def derivatives(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """First and second derivative of T along z."""
        size = abs(self.T @ z / self._model.unit).max(initial=0.0)
        if self._model.couplings.is_index or not size:
            return np.zeros_like(self.T), np.zeros_like(self.T)
        h = _APART / size
        first, second = np.zeros_like(self.T), np.zeros_like(self.T)
        for k, (odd, even) in enumerate(zip(_FIRST, _SECOND, strict=True), start=1):
            # Constant entries have differences of zero, without rounding errors.
            ahead, back = self._at(k * h * z), self._at(-k * h * z)
            first += odd / h * (ahead - back)
            second += even / h**2 * ((ahead - self.T) + (back - self.T))
        self._at(np.zeros(self.count))
        return first, second

    def of_forces(self, r: np.ndarray) -> np.ndarray:
        """Derivative of T^T r, for constant forces r (size,)."""
        out = np.zeros((self.count, self.count))
        # The second derivatives of x are symmetric: T depends on the columns that change with it.
        changing, _ = self.derivatives(np.cos(np.arange(self.count) ** 2))
        for j in np.flatnonzero(changing.any(axis=0)):
            out[:, j] = self.derivatives(np.eye(self.count)[j])[0].T @ r
        return out


def _forces(model: Model, state: State):
    """Internal forces (size,), their stiffness and their damping, without those of joints."""
    forms, q, v = model.forms, state.q, state.v
    forms.set_internal(state.internal)

    def step(dt: float, rates: np.ndarray, shift: float = 0.0):
        forms.set_step(state.t - shift * dt, dt, q - shift * dt * rates, v, state.a)
        D = dt * rates
        f = forms.internal_force(D).copy()
        forms.assemble_stiffness()
        return f, forms.stiffness.copy()

    moving = forms.has_added or forms.drags or forms.resultants_move
    if not moving:
        f, half = step(_MOMENT, np.zeros(model.size))
        return f, 2 * half, 0 * half
    f, at_once = step(_MOMENT, v)
    C = 2 * _MOMENT * (at_once - step(2 * _MOMENT, v)[1])
    size = abs(v / model.unit).max()
    h = _SMALL / size if size else 1.0
    if state.internal is not None:
        h = min(h, _SHORT)
    K = 2 * (step(h, v, 0.5)[1] - C / h)
    if not (np.isfinite(K.data).all() and np.isfinite(C.data).all()):
        raise SceneError(
            "linearise: the damping in this state is not finite, since the derivative of an added "
            "virtual work by the velocity is not. Smooth it there, such as "
            "ufl.sqrt(v**2 + 1e-12) for the speed"
        )
    return f, K, C


def _accelerations(
    model: Model,
    drive: Drive,
    state: State,
    T: np.ndarray,
    r: np.ndarray,
    of_springs: np.ndarray,
    turning: np.ndarray,
) -> np.ndarray:
    """Accelerations of z: of the unknowns by the equations; of driven motions as in the last step.

    Those of inputs are zero: they go straight.
    """
    free, mass = model.reduction.free, model.mass
    a = np.zeros(T.shape[1])
    if model.reduction.driven and state.a.any():
        unit = model.unit
        a = np.linalg.lstsq(T / unit[:, None], (state.a - turning) / unit, rcond=None)[0]
        a[:free] = 0.0
    for i, function in enumerate(drive.functions):
        if isinstance(function, Ramp):
            a[free + i] = 0.0
    force = -(T.T @ (r + mass @ (T @ a)) + of_springs)[:free]
    a[:free] = acceleration_of((T.T @ (mass @ T))[:free, :free], force)
    return a
