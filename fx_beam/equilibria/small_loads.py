"""States at small loads, by which derivatives by the load factor are found."""

from __future__ import annotations

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.laws.interval import Interval, Rest
from fx_beam.motions.evaluation import solution_of
from fx_beam.results.state import State
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.step_failures import StepFailed

from .load_steps import LoadStepper
from .path_equations import PathEquations

# Largest rotation [rad] and strain of these states. Their loads are these parts of the largest: the
# error of a derivative is that of a polynomial of degree 8.
_LARGEST, _PARTS = 0.05, np.array([4, 3, 2, 1, -4, -3, -2, -1]) / 4
# Of the polynomial through values in all states: its coefficients of the first two orders.
_FIRST, _SECOND = np.linalg.inv(np.vander(np.append(0.0, _PARTS), increasing=True))[1:3]
# Error of first-order equilibrium above which smaller states are tried, how much smaller they are,
# and the part of the error that is worth it.
_ACCURATE, _SMALLER, _LESS = 1e-10, 0.01 ** np.arange(4), 0.1
# Least part of these loads that is tried where laws switch, or of loads that move a node by
# `_LARGEST` of the scene's size.
_NEAREST = 1e-4


class SmallStates:
    """States at u = l u_1 beside a state, in which nodes on arms go straight as well.

    By displacements u_1 of the unknowns y (free,) and of all nodes D (size,), under forces l f_1 on
    the unknowns (free,).
    """

    def __init__(
        self,
        name: str,
        path: PathEquations,
        state: State,
        y: np.ndarray,
        D: np.ndarray,
        forces: np.ndarray,
    ):
        self._what, self._path, self._loop, self._model = name, path, path.loop, path.model
        self.state, self.y, self.D, self._forces = state, y, D, forces
        #: Error of first-order equilibrium by the states, relative to forces and displacements.
        self.error = np.inf
        moved = abs(D / self._model.units.nodes).max(initial=0.0)
        largest = self._without_switch(_LARGEST / (self.size() or moved or 1.0), moved)
        for part in _SMALLER:  # lines and beams that guide may be short beside displacements
            found, error = self._found_states(part * largest)
            if not error >= _LESS * self.error:
                #: The states, from that without l on.
                self.states = found
                self._largest, self.error = part * largest, error
            if self.error < _ACCURATE:
                break

    def balanced(self, load: float) -> tuple[np.ndarray, State]:
        """Residual forces (unknowns,) at l, and the state there."""
        raise NotImplementedError

    def _without_switch(self, largest: float, moved: float) -> float:
        """A load factor up to which, in both directions, no stop or other law switches.

        Nodes move by so much of the size of the scene by the load factor.
        """
        model, start = self._model, self.state
        if not (sum(model.points.switch_counts) or model.points.members):
            return largest
        path, members = self._path, model.points.members
        start_signs, touched = np.sign(model.kinks.switches(start)), members and members.touched
        path.begin(start)

        def switched(load: float) -> bool:
            y = load * self.y
            slides = start.slides + model.couplings.free_slides(y, len(start.slides))
            values = model.forms.compiled_points.switches(start.q + path.expand(y, load), slides)
            return (
                bool((np.sign(values) != start_signs).any())
                or (members and members.touched) != touched
            )

        least = _NEAREST * min(largest, _LARGEST / (moved or 1.0))
        for most in np.geomspace(largest, least, 20).tolist():
            if not any(map(switched, (most * _PARTS).tolist())):
                return most
        raise SceneError(
            f"{self._what}: a stop, a contact or a law of springs switches where the scene is at "
            "rest: its stiffness depends on the direction of the load. Take fx_beam.static"
        )

    def size(self) -> float:
        """Largest rotation or strain by the load factor."""
        mesh, D = self._model.mesh, self.D.reshape(-1, 3)
        first, last = mesh.points[:, 0], mesh.points[:, 1]
        length = np.hypot(*(mesh.X[last] - mesh.X[first]).T)
        strains = np.hypot(*(D[last, :2] - D[first, :2]).T) / length
        return float(max(abs(D[:, 2]).max(initial=0.0), strains.max(initial=0.0)))

    def _found_states(self, largest: float) -> tuple[list[State], float]:
        """States up to a load factor, and the error of first-order equilibrium by them."""
        model, start = self._model, self.state
        states, residuals, bends = [], [], []
        for load in (0.0, *(largest * _PARTS).tolist()):
            residual, new = self.balanced(load)
            straight = start.q + load * self.D
            residuals.append(residual)
            bends.append(new.q - straight)
            states.append(new.changed(q=straight))
        chosen, node_unit = model.reduction.independent, model.units.nodes
        unit = model.units.unknowns[chosen]
        pairs = (
            (residuals * unit, self._forces[chosen] * unit),
            (bends / node_unit, self.D / node_unit),
        )
        error = sum(
            abs(_FIRST @ rows / largest).max(initial=0.0) / (abs(slopes).max(initial=0.0) or 1.0)
            for rows, slopes in pairs
        )
        return [start, *states[1:]], float(error)

    def slope(self, rows: np.ndarray) -> np.ndarray:
        """Derivative by the load factor of values (n + 1, ...) in all states."""
        return np.tensordot(_FIRST, rows, axes=1) / self._largest

    def at_ends(self, rows: np.ndarray) -> np.ndarray:
        """Values (2, ...) without and with all loads, from values (n + 1, ...) in all states."""
        return np.stack([rows[0], rows[0] + self.slope(rows)])


class SmallLoads(SmallStates):
    """Displacements u_1 = K_0^-1 f about a state, and states at u = l u_1 under loads l f.

    Energies are quadratic in them.
    """

    def __init__(self, name: str, stepper: LoadStepper, state: State):
        reduction, path = stepper.model.reduction, stepper.path
        y, loop = np.zeros(reduction.free), path.loop
        path.begin(state)
        column = path.balance(y, 0.0)[2]
        #: Whether anything changes with the load factor.
        self.acts = bool(loop.forcing.rise.any() or column.any())
        try:
            tangent = path.with_the_load(y, 0.0)
        except StepFailed as failure:
            raise SceneError(
                f"{name}: {failure.reason}. Check for a part without support, and the sizes of "
                "stiffnesses and offsets"
            ) from failure
        if not (tangent.load and np.isfinite(tangent.y).all()):
            raise SceneError(f"{name}: the state is at a critical point already. Reduce its loads")
        weight = stepper.model.masses.weight
        self._still = loop.forcing.first - (0.0 if weight is None else weight)
        slopes = tangent.y / tangent.load, tangent.D / tangent.load
        super().__init__(name, path, state, *slopes, column)
        #: A record of all states, and a solution with them as its rows.
        self.recorder = Recorder(stepper.model, np.arange(len(self.states), dtype=float), Record())
        for row_state in self.states:
            loop.record(row_state, self.recorder)
        rest = Rest(loop.forcing.time, state.t + self._largest * np.append(0.0, _PARTS))
        self.solution = solution_of(self.recorder, stepper.stats, lambda: state, rest=rest)

    def balanced(self, load: float) -> tuple[np.ndarray, State]:
        """As of `SmallStates`."""
        path, start, y = self._path, self.state, load * self.y
        path.begin(start)
        balance = path.balance(y, load)[0]
        residual = balance.residual[self._model.reduction.independent]
        new = self._loop.finished(start, Interval(start.t, start.t + load), y, balance.r)
        bend = new.q - (start.q + load * self.D)
        work = new.work + (1 - load / 2) * path.held @ y - self._still @ bend
        return residual, new.changed(work=float(work))

    def curvature(self, rows: np.ndarray) -> np.ndarray:
        """Half of the second derivative by the load factor of values (n + 1, ...) likewise."""
        return np.tensordot(_SECOND, rows, axes=1) / self._largest**2


class SmallForces(SmallStates):
    """States under small forces f on nodes (size,), which give them accelerations a (size,).

    Loads (size,) on nodes stay, and so does all else that the path has.
    """

    def __init__(
        self,
        name: str,
        path: PathEquations,
        state: State,
        loads: np.ndarray,
        y: np.ndarray,
        D: np.ndarray,
        force: np.ndarray,
        a: np.ndarray,
    ):
        self._loads, self._force, self._a = loads, force, a
        super().__init__(name, path, state, y, D, path.model.reduction.maps.reduced_force(force))

    def balanced(self, load: float) -> tuple[np.ndarray, State]:
        """As of `SmallStates`."""
        start, y, path = self.state, load * self.y, self._path
        self._loop.forcing.first[:] = self._loads + load * self._force
        path.begin(start)
        balance = path.balance(y, 0.0)[0]
        residual = balance.residual[self._model.reduction.independent]
        new = self._loop.finished(start, Interval(start.t, start.t), y, balance.r)
        return residual, new.changed(a=load * self._a)
