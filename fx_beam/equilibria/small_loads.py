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


class SmallLoads:
    r"""Displacements u_1 = K_0^-1 f about a state, and states at u = l u_1 under loads l f.

    Also nodes on arms go straight in them, so that energies are quadratic.
    """

    def __init__(self, name: str, stepper: LoadStepper, state: State):
        self._what, self._stepper, self.state = name, stepper, state
        reduction = stepper.model.reduction
        path, y = stepper.path, np.zeros(reduction.free)
        path.begin(state)
        self._column = path.balance(y, 0.0)[2]
        #: Whether anything changes with the load factor.
        self.acts = bool(stepper.loop.forcing.rise.any() or self._column.any())
        try:
            tangent = path.with_the_load(y, 0.0)
        except StepFailed as failure:
            raise SceneError(
                f"{name}: {failure.reason}. Check for a part without support, and the sizes of "
                "stiffnesses and offsets"
            ) from failure
        if not (tangent.load and np.isfinite(tangent.y).all()):
            raise SceneError(f"{name}: the state is at a critical point already. Reduce its loads")
        #: Displacements (free,) of the unknowns by the load factor, and (size,) of all nodes.
        self.y, self.D = tangent.y / tangent.load, tangent.D / tangent.load
        largest, least = self._without_switch(_LARGEST / (self.size() or 1.0)), np.inf
        for part in _SMALLER:  # lines and beams that guide may be short beside displacements
            found, error = self._found_states(part * largest)
            if not error >= _LESS * least:
                states, self._largest, least = found, part * largest, error
            if least < _ACCURATE:
                break
        #: A record of all states, and a solution with them as its rows.
        self.recorder = Recorder(stepper.model, np.arange(len(states), dtype=float), Record())
        for row_state in states:
            stepper.loop.record(row_state, self.recorder)
        rest = Rest(stepper.loop.forcing.time, state.t + self._largest * np.append(0.0, _PARTS))
        self.solution = solution_of(self.recorder, stepper.stats, lambda: state, rest=rest)

    def _without_switch(self, largest: float) -> float:
        """A load factor up to which, in both directions, no stop or other law switches."""
        model, start = self._stepper.model, self.state
        if not (sum(model.points.switch_counts) or model.points.members):
            return largest
        path, members = self._stepper.path, model.points.members
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

        moved = abs(self.D / model.units.nodes).max(initial=0.0)
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
        mesh, D = self._stepper.model.mesh, self.D.reshape(-1, 3)
        first, last = mesh.points[:, 0], mesh.points[:, 1]
        length = np.hypot(*(mesh.X[last] - mesh.X[first]).T)
        strains = np.hypot(*(D[last, :2] - D[first, :2]).T) / length
        return float(max(abs(D[:, 2]).max(initial=0.0), strains.max(initial=0.0)))

    def _found_states(self, largest: float) -> tuple[list[State], float]:
        """States up to a load factor, and the error of first-order equilibrium by them."""
        model, path, start = self._stepper.model, self._stepper.path, self.state
        weight = model.masses.weight
        still = self._stepper.loop.forcing.first - (0.0 if weight is None else weight)
        states, residuals, bends = [], [], []
        for load in (0.0, *(largest * _PARTS).tolist()):
            path.begin(start)
            y = load * self.y
            balance = path.balance(y, load)[0]
            residuals.append(balance.residual[model.reduction.independent])
            interval = Interval(start.t, start.t + load)
            new = self._stepper.loop.finished(start, interval, y, balance.r)
            straight = start.q + load * self.D
            bends.append(new.q - straight)
            work = new.work + (1 - load / 2) * path.held @ y - still @ bends[-1]
            states.append(new.changed(q=straight, work=float(work)))
        chosen, node_unit = model.reduction.independent, model.units.nodes
        unit = model.units.unknowns[chosen]
        pairs = (
            (residuals * unit, self._column[chosen] * unit),
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

    def curvature(self, rows: np.ndarray) -> np.ndarray:
        """Half of the second derivative likewise."""
        return np.tensordot(_SECOND, rows, axes=1) / self._largest**2
