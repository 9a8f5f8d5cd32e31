"""Dead loads, prescribed motions, motors and turning frames of a model as functions of time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse

from fx_beam.dual import MaybeDual, floats
from fx_beam.errors import SceneError
from fx_beam.fem.forms import SceneArrays
from fx_beam.fem.functions_of_time import before
from fx_beam.laws.interval import Interval, just_inside
from fx_beam.results.state import State
from fx_beam.scene.beam import COMPONENTS
from fx_beam.scene.coordinate import Locked
from fx_beam.scene.functions import Signal, constant, evaluate
from fx_beam.scene.loads import damping_of
from fx_beam.scene.scene import Scene

from .model import Model

# -- A frame that turns at a constant spin, in which a scene is at rest -------------------------


def check_turns(scene: Scene, caller: str) -> None:
    """Refuse a scene with forces that do not turn with it; errors name the `caller`."""
    for present, name in (
        (scene.gravity is not None and any(scene.gravity), "gravity"),
        (any(load.target is None for load in scene.loads), "an acceleration of all masses"),
        (bool(scene.drags), "drag in air at rest"),
        (damping_of(scene)[0] > 0, "damping in proportion to the mass"),
    ):
        if present:
            raise SceneError(
                f"{caller}: {name} does not turn with the scene, so that it has no steady turn. "
                "Leave it out, or simulate the motion"
            )


class TurningFrame:
    r"""Forces in a frame that turns about a pivot, x = p + R(t) xi, from the load factor 1 on.

    The mass has :math:`M (\ddot\xi + 2 \Omega S \dot\xi + \Omega^2 S^2 \xi)`, with S the quarter
    turn of displacements. At a load factor l the spin is :math:`\sqrt{l} \Omega`.
    """

    def __init__(self, model: Model, spin: float, pivot: Sequence[float]):
        self.spin, self.pivot = spin, np.array(pivot, dtype=float)
        self._X, self._turns = model.mesh.X, model.mesh.turns
        #: Mass (size, size) of displacements, in the sparsity of all.
        self.mass = model.masses.matrix.copy()
        self.mass.data[self.mass.indices % 3 == 2] = 0.0
        quarter = scipy.sparse.csr_matrix([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
        #: S (size, size): displacements turned by a quarter, no rotations.
        self.quarter_turn = scipy.sparse.kron(scipy.sparse.eye(len(self._X)), quarter, "csr")

    def arms(self, q: np.ndarray) -> np.ndarray:
        """Places (size,) seen from the pivot; zero for rotations."""
        arms = q.copy().reshape(-1, 3)
        arms[:, :2] += self._X - self.pivot
        arms[:, 2] = 0.0
        return arms.ravel()

    def force(self, q: np.ndarray) -> np.ndarray:
        """Centrifugal force (size,) at the full spin."""
        return self.spin**2 * (self.mass @ self.arms(q))

    def rates(self, q: np.ndarray, factor: float) -> np.ndarray:
        """Rates (size,) of the turn at a load factor."""
        rates = self.quarter_turn @ self.arms(q)
        rates[self._turns] = 1.0
        return np.sqrt(factor) * self.spin * rates

    def seen(
        self, q: np.ndarray, v: np.ndarray, factor: float, duration: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Displacements and rates (size,) seen in the frame after it turned for a duration [s]."""
        spin = np.sqrt(factor) * self.spin
        quarter, turns = self.quarter_turn, self._turns
        c, s = np.cos(spin * duration), np.sin(spin * duration)
        v, arms = v - self.rates(q, factor), self.arms(q)
        back = q + (c - 1) * arms - s * (quarter @ arms)
        back[turns] -= spin * duration
        rates = c * v - s * (quarter @ v)
        rates[turns] = v[turns]
        return back, rates

    @property
    def gyroscopic(self) -> scipy.sparse.csr_matrix:
        """Coriolis forces by rates (size, size)."""
        return 2 * self.spin * (self.mass @ self.quarter_turn)


# -- Dead loads, prescribed motions and motors of a model as functions of time ------------------


# Weights of the differences of five positions, backwards in time, in the rate at the first one.
_OF_DIFFERENCES = np.array([-25, 23, -13, 3]) / 12
# Places near a start, and weights of six of them in a row that leave of a smooth function nothing
# but rounding errors: those of its fifth divided differences, relative to the largest.
_PLACES = 0, 1, 2, 5, 10, 20, 30, 100, 200, 300
_TO_NOISE = np.zeros((3, len(_PLACES)))
for _i, _near in enumerate(_PLACES[i : i + 6] for i in range(3)):
    _TO_NOISE[_i, _i : _i + 6] = [np.prod([1.0 / (x - y) for y in _near if y != x]) for x in _near]
_TO_NOISE /= abs(_TO_NOISE).max(axis=1, keepdims=True)
# Places just behind a start. A motion that differs there from the start by more than so many of
# its rounding errors, and almost by as much at both, jumps.
_BEHIND, _ROUND_OFFS = (1e-5, 1e-3), 100


class Forcing:
    """Evaluates dead loads, prescribed motions and motors."""

    #: In statics, the time at which functions of time are evaluated [s].
    time = 0.0
    turning: TurningFrame | None = None

    def __init__(self, model: Model, data: SceneArrays | None = None):
        self.model, self.data = model, (data := data or model.data)
        scene = data.scene
        #: The functions of time of prescribed motions and motors, and their names for messages.
        self.functions: list[Signal] = [*scene.prescribed.values()]
        self.functions += [getattr(joint, name).motor for joint, name in data.motors]
        places = [f"{COMPONENTS[part]} of {scene.nodes[node]}" for node, part in scene.prescribed]
        self.names = [f"prescribed {place}" for place in places]
        self.names += [f"motor of {joint}" for joint, _ in data.motors]
        #: Which of them are inputs of a motion (driven,): these go straight in a step.
        self.straight = np.array([function.ramps for function in self.functions], dtype=bool)
        #: Numbers of those that are locked.
        self._held = [i for i, f in enumerate(self.functions) if isinstance(f, Locked)]

    def forces(self, step: Interval) -> tuple[np.ndarray, np.ndarray]:
        """Dead forces (size,) at the start and at the end of a step, weight included [N, N m]."""
        start, end = just_inside(step.start, step.end)
        at_start = self.dead(start)
        return at_start, at_start if self.data.loads.constant else self.dead(end)

    def positions(self, t: float) -> np.ndarray:
        """Prescribed motions and positions of motors (driven,) at a time [m, rad]."""
        pairs = zip(self.functions, self.names, strict=True)
        return np.array([evaluate(function, t, name)[0] for function, name in pairs])

    def natural(self, t: float) -> np.ndarray | None:
        """Natural strains (cells, degree, 3) at the end of a step [s]; None without any."""
        natural = self.data.natural
        return natural.sum_at(float(before(t))) if natural else None

    def derivatives(self, t: float, h: float) -> tuple[np.ndarray, np.ndarray]:
        """First and second derivatives (driven,) of driven motion, from steps of length h [s].

        Behind a jump at t, if there is one: it is a part of the first step.
        """
        if not self.functions:
            return np.empty(0), np.empty(0)
        # One-sided differences of second order: a motion need not be defined before the start.
        # Differences to the start have no rounding error if the motion is constant.
        near, further, *others = self.series(t + h * np.array([*_BEHIND, *_PLACES]))
        f = np.stack(others)
        jump, later = (abs(floats(value - f[0])) for value in (near, further))
        size = np.spacing(np.maximum(abs(floats(near)), abs(floats(f[0]))))
        jumps = (jump > _ROUND_OFFS * size) & (jump > later / 2)
        behind = near - (further - near) * (_BEHIND[0] / (_BEHIND[1] - _BEHIND[0]))
        _, d1, d2, _, e1, e2, e3, far, g2, g3 = differences = f - np.where(jumps, behind, f[0])
        noise = abs(_TO_NOISE @ floats(differences)).max(axis=0)
        # Rates below the errors of these differences are set to zero: of these formulas, and of
        # rounding, of which a kink close to the start is not told apart.
        rates, error = (4 * d1 - d2) / 2, np.maximum(1e-5 * abs(floats(far)), 20 * noise)
        # Second differences use longer steps, since rounding errors are divided by h^2, and still
        # longer ones where both agree but for these errors. Values below them are set to zero.
        short, wide = 4 * e2 - 5 * e1 - e3, 4 * g2 - 5 * far - g3
        wide = np.where(abs(wide) <= 10 * np.finfo(float).eps * (abs(f[0]) + abs(g3)), 0.0, wide)
        bend = np.where(abs(wide / 100 - short) < 60 * noise, wide / 100, short)
        return np.where(abs(rates) < error, 0.0, rates) / h, bend / (10 * h) ** 2

    def end_rates(self, ends: np.ndarray, lengths: np.ndarray) -> MaybeDual:
        """Rates (n, driven) of driven motion at the ends of steps, from values in these steps.

        By differences of order four; steps of negative length start at these times.
        """
        times = (ends[:, None] - lengths[:, None] / 8 * np.arange(5)).ravel()
        positions = self.series(times).reshape(len(ends), 5, len(self.functions))
        return 8 * _OF_DIFFERENCES @ (positions[:, 1:] - positions[:, :-1]) / lengths[:, None]

    def naturals(self, ends: np.ndarray) -> MaybeDual:
        """Factors (steps, n) of the unit natural strains at the ends of steps."""
        return self.data.natural.series(before(ends))

    def loads(self, t0: np.ndarray, t1: np.ndarray) -> MaybeDual:
        """Factors (steps, 2, loads) of the unit loads at the starts and ends of steps."""
        return self.data.loads.in_steps(t0, t1, self.model.scheme.rates.mean_based)

    def series(self, times: np.ndarray) -> np.ndarray:
        """Prescribed motions and positions of motors (n, driven) at several times [m, rad]."""
        pairs, arrays = zip(self.functions, self.names, strict=True), self.data.scene.array_calls
        positions = [signal.series(times, name, arrays) for signal, name in pairs]
        return np.concatenate([np.empty((len(times), 0)), *positions], axis=1)

    def current(self, state: State) -> np.ndarray:
        """Prescribed motions and positions of motors (driven,) in a state [m, rad]."""
        return np.concatenate([state.q[self.model.prescribed], state.motors])

    def hold(self, state: State) -> None:
        """Let locked joints keep the coordinates of a state."""
        current = self.current(state)
        for i in self._held:
            self.functions[i] = constant(current[i : i + 1].copy())

    def check_start(self, state: State) -> None:
        """Refuse prescribed motions and motors that would jump at the start."""
        if not self.functions:
            return
        self.hold(state)
        positions = self.positions(state.t)
        # A unit motion is the size of the scene, or a radian.
        turns = [component == 2 for _, component in self.model.scene.prescribed]
        turns += [name == "rotation" for _, name in self.model.data.motors]
        allowed = 1e-9 * (np.where(turns, 1.0, self.model.mesh.size) + abs(positions))
        for value, start, most, name in zip(
            positions, self.current(state), allowed, self.names, strict=True
        ):
            if abs(value - start) > most:
                raise SceneError(
                    f"{name} is {value:g} at t = {state.t:g}, but the motion starts from "
                    f"{start:g}. Let the function have this value then; or bring the scene to its "
                    f"value by static(scene, t={state.t:g}), and start from this solution"
                )

    def dead(self, t: float) -> np.ndarray:
        """Dead forces (size,) at a time, weight included [N, N m]."""
        force = self.data.loads.sum_at(t)
        return force if self.model.masses.weight is None else force + self.model.masses.weight


class LoadForcing(Forcing):
    """Loads and driven motions at one time [s], scaled by the load factor in place of time.

    And centrifugal forces, if the scene rests in a frame that turns.
    """

    def __init__(self, model: Model, time: float, turning: TurningFrame | None = None):
        super().__init__(model)
        self.time, self.turning = time, turning
        model.forms.parameters.hold(time)
        #: Rise of dead loads (size,) [N, N m], and how far driven motions go (driven,) [m, rad].
        self.rise, self.goal = super().dead(time), self.series(np.array([time]))[0]
        #: Dead loads at load factor 0.
        self.first = np.zeros(model.size)
        self._origin = np.zeros(len(self.goal))
        #: Natural strains in full, and those from which they go.
        self._full = super().natural(time)
        self._first_natural: np.ndarray | float = 0.0

    def start_from(self, state: State, loads: np.ndarray) -> None:
        """Let loads (size,), driven motions and natural strains start from those of a state."""
        self.first[:], self.rise = loads, self.rise - loads
        if state.natural is not None:
            self._first_natural = state.natural
        origin = self.current(state)
        self.goal[self._held] = (origin - self._origin)[self._held]
        self._origin, self.goal = origin, self._origin + self.goal - origin

    def keep_start(self) -> None:
        """Let all that the state to start from has stay, and the rest act beside it."""
        self.rise = self.rise + self.first
        if self._full is not None:
            self._full = self._full + self._first_natural
        moves = np.ones(len(self.goal), dtype=bool)
        moves[self._held] = False
        self.goal[moves] += self._origin[moves]

    def stay(self, state: State) -> None:
        """Let driven motions and natural strains stay as in a state; only `first` forces act."""
        self.rise, self._origin, self.goal = 0 * self.rise, self.current(state), 0 * self.goal
        if self._full is not None:
            self._full = self._first_natural = (
                0 * self._full if state.natural is None else state.natural
            )

    def dead(self, factor: float) -> np.ndarray:
        """Dead forces (size,) at a load factor [N, N m]."""
        return self.first + factor * self.rise

    def positions(self, t: float) -> np.ndarray:
        """Prescribed motions and positions of motors (driven,) at a load factor [m, rad]."""
        return self._origin + t * self.goal

    def natural(self, t: float) -> np.ndarray | None:
        """Natural strains (cells, degree, 3) at a load factor; None without any."""
        full, first = self._full, self._first_natural
        return None if full is None else first + t * (full - first)
