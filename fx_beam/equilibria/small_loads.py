"""Small loads: derivatives by the load factor, geometric stiffness, first-order statics."""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.sparse import csr_matrix

from fx_beam.coupling.graph import joints_with_arms
from fx_beam.dual import floats
from fx_beam.errors import SceneError
from fx_beam.fem.mesh import Mesh, rotation_of
from fx_beam.laws.interval import Interval, Rest
from fx_beam.motions.element_balance import ElementLoads, components, directions
from fx_beam.motions.evaluation import solution_of
from fx_beam.results.records import BeamBalance, BeamResultants, Energy, Stats
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.beam import Node, gauss_rule, lagrange_and_slopes
from fx_beam.scene.joints import GROUND
from fx_beam.step.constrained_matrix import ConstrainedMatrix
from fx_beam.step.model import Model
from fx_beam.step.recorded_rows import RowSteps, histories_of
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.stepper import StepFailed

from .load_steps import LoadStepper
from .path_equations import PathEquations, Tangent

# -- Axes and virtual strains at the Gauss points of beams: what section forces do work on ------


class Axes(NamedTuple):
    """Axes at the Gauss points of all elements in some configurations (..., cells, points)."""

    #: Weights (points,) of an element; shape functions (points, nodes) and their slopes.
    weights: np.ndarray
    values: np.ndarray
    slopes: np.ndarray
    #: J phi' (..., 2), J that of the reference axis, and directions of N and Q.
    dphi: np.ndarray
    t: np.ndarray
    n: np.ndarray

    @classmethod
    def of(cls, mesh: Mesh, q: np.ndarray) -> Axes:
        """Axes for displacements and rotations q (..., size)."""
        nodes = mesh.elements
        points, weights = gauss_rule(nodes.shape[1] - 1)
        values, slopes = lagrange_and_slopes(np.linspace(0, 1, nodes.shape[1]), points)
        moved = q.reshape(*q.shape[:-1], -1, 3)[..., nodes, :]
        dX = np.einsum("ga,eai->egi", slopes, mesh.X[nodes])  # J times the tangent
        x, y = np.moveaxis(dX / np.linalg.norm(dX, axis=-1, keepdims=True), -1, 0)
        psi = moved[..., 2] @ values.T
        c, s = np.cos(psi), np.sin(psi)
        t = np.stack([c * x - s * y, s * x + c * y], axis=-1)
        n = np.stack([-t[..., 1], t[..., 0]], axis=-1)
        dphi = dX + np.einsum("ga,...eai->...egi", slopes, moved[..., :2])
        return cls(weights, values, slopes, dphi, t, n)

    def forces(self, resultants: np.ndarray) -> np.ndarray:
        """Forces (..., cells, nodes, 3) of elements by N, Q and M (..., cells, points, 3)."""
        N, Q, M = (part * self.weights for part in np.moveaxis(resultants, -1, 0))
        pull = N[..., None] * self.t + Q[..., None] * self.n
        lever = N * (self.n * self.dphi).sum(axis=-1) - Q * (self.t * self.dphi).sum(axis=-1)
        forces = np.einsum("...gi,ga->...ai", pull, self.slopes)
        moments = lever @ self.values + M @ self.slopes
        return np.concatenate([forces, moments[..., None]], axis=-1)


# -- States at small loads, by which derivatives by the load factor are found -------------------


# Largest rotation [rad] and strain of these states. Their loads are these parts of the largest: the
# error of a derivative is that of a polynomial of degree 8.
_LARGEST, _PARTS = 0.05, np.array([4, 3, 2, 1, -4, -3, -2, -1]) / 4
# Of the polynomial through values in all states: its coefficients of the first two orders.
_FIRST, _SECOND = np.linalg.inv(np.vander(np.append(0.0, _PARTS), increasing=True))[1:3]
# Error of first-order equilibrium above which smaller states are tried, how much smaller they are,
# and the part of the error that is worth it.
_ACCURATE, _SMALLER, _LESS = 1e-10, 0.01 ** np.arange(4), 0.1
# Error that is round-off if it is no smaller in smaller states.
_ROUNDED = 1e-3
# Error below which no correction is made, the largest number of corrections, and the part of the
# last one that is worth another.
_EXACT, _MOST, _WORTH = 1e-12, 20, 0.5
# Least part of these loads that is tried where laws switch, or of loads that move a node by
# `_LARGEST` of the scene's size.
_NEAREST = 1e-4


class _Way(NamedTuple):
    """Changes of the unknowns (free,), of all nodes (size,), and of the load factor."""

    y: np.ndarray
    D: np.ndarray
    load: float


class _Block(NamedTuple):
    """States along a way, and slopes along it."""

    way: _Way
    states: list[State]
    #: The largest state, as a part of the way.
    largest: float
    #: Slopes of the residual (free,), of that at nodes (size,), and of the forces of beams in it.
    residual: np.ndarray
    at_nodes: np.ndarray
    of_beams: np.ndarray
    #: Error of first-order equilibrium, relative to the loads.
    error: float


def _without_switch(name: str, path: PathEquations, start: State, way: _Way) -> float:
    """A part of a way up to which, in both directions, no stop or other law switches."""
    model = path.model
    moved = abs(way.D / model.units.nodes).max(initial=0.0)
    largest = _LARGEST / (_size(model, way.D) or moved or 1.0)
    if not (sum(model.points.switch_counts) or model.points.members):
        return largest
    members = model.points.members
    start_signs, touched = np.sign(model.kinks.switches(start)), members and members.touched
    path.set_start(start)

    def switched(part: float) -> bool:
        y = part * way.y
        slides = start.slides + model.couplings.free_slides(y, len(start.slides))
        q = start.q + path.expand(y, part * way.load)
        values = model.forms.compiled_points.switches(q, slides)
        return (
            bool((np.sign(values) != start_signs).any()) or (members and members.touched) != touched
        )

    least = _NEAREST * min(largest, _LARGEST / (moved or 1.0))
    for most in np.geomspace(largest, least, 20).tolist():
        if not any(map(switched, (most * _PARTS).tolist())):
            return most
    raise SceneError(
        f"{name}: a stop, a contact or a law of springs switches where the scene is at "
        "rest: its stiffness depends on the direction of the load. Take fx_beam.static"
    )


def _size(model: Model, D: np.ndarray) -> float:
    """Largest rotation or strain in displacements (size,)."""
    mesh, D = model.mesh, D.reshape(-1, 3)
    first, last = mesh.points[:, 0], mesh.points[:, 1]
    length = np.hypot(*(mesh.X[last] - mesh.X[first]).T)
    strains = np.hypot(*(D[last, :2] - D[first, :2]).T) / length
    return float(max(abs(D[:, 2]).max(initial=0.0), strains.max(initial=0.0)))


class SmallLoads:
    r"""Displacements u_1 = K_0^-1 f about a state, and states at u = l u_1 under loads l f.

    Also nodes on arms go straight in them, so that energies are quadratic.

    Strains of stiff members have the round-off of displacements. Section forces with it are taken
    as they are, and all other forces follow from them in the shape of the state. What is missing
    in the balance is the load of a correction, whose round-off is far smaller, and so on.
    """

    def __init__(self, name: str, stepper: LoadStepper, state: State):
        self._what, self._stepper, self.state = name, stepper, state
        reduction = stepper.model.reduction
        path, y = stepper.path, np.zeros(reduction.free)
        path.set_start(state)
        self._column = path.balance(y, 0.0)[2]
        self._unit = stepper.model.units.unknowns[: reduction.free]
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
        way = _Way(tangent.y / tangent.load, tangent.D / tangent.load, 1.0)
        #: Forces (size,) of supports and joints in the state. Their changes have a row alone.
        self._still = stepper.loop.balance(state, state.t).r.copy()
        self._block = block = self._refined(self._largest_states(way))
        #: Displacements (size,) of all nodes by the load factor.
        self.D = block.way.D
        #: A record of all states, and a solution with them as its rows.
        self.recorder = Recorder(stepper.model, np.zeros(1), Record())
        stepper.loop.record(state, self.recorder)
        self._factors, self._weights = [state.t], np.zeros(1)
        # If section forces were corrected, slopes of N, Q and M (cells, points, 3), and of the
        # forces of elements (cells, nodes, 3).
        self._resultants: np.ndarray | None = None
        self._forces = np.empty(0)
        #: Error of the balance of all forces, relative to the loads.
        self.error = self._record_corrected()
        rest = Rest(stepper.loop.forcing.time, np.array(self._factors))
        self.solution = solution_of(self.recorder, stepper.stats, lambda: state, rest=rest)

    def _largest_states(self, way: _Way) -> _Block:
        """States along the way of the loads, as large as their error is small."""
        largest = _without_switch(self._what, self._stepper.path, self.state, way)
        blocks, least = list[_Block](), np.inf
        for part in _SMALLER:  # lines and beams that guide may be short beside displacements
            block = self._states(way, part * largest)
            if not block.error >= _LESS * least:
                blocks, least = [block], block.error
            elif least < _ROUNDED:
                break
            if least < _ACCURATE:
                break
        return blocks[0]

    def _refined(self, block: _Block) -> _Block:
        """States along the way that their residual corrects, as long as corrections fall."""
        last = np.inf
        for _ in range(_MOST if block.error > _ACCURATE else 0):
            y, dy = block.way.y, self._correction(block.residual).y
            whole, size = (abs(part / self._unit).max(initial=0.0) for part in (y, dy))
            if size < _ACCURATE * whole or not size < _WORTH * last:
                break
            way, last = _Way(y + dy, self._stepper.path.spread(y + dy, 1.0), 1.0), size
            block = self._states(way, block.largest)
        return block

    def _correction(self, residual: np.ndarray) -> _Way:
        """The way at constant loads by which a residual (free,) goes away."""
        path, still = self._stepper.path, np.zeros(len(residual))
        path.set_start(self.state)
        path.balance(still.copy(), 0.0)
        normal = Tangent(still, np.zeros(self._stepper.model.size), 1.0)
        dy, _ = path.solve(self._column, normal, -residual, 0.0)
        return _Way(dy, path.spread(dy, 0.0), 0.0)

    def _record_corrected(self) -> float:
        """Record states, and corrections of forces; the error that is left."""
        beams = self._stepper.model.forms.beams
        self._record(block := self._block)
        residual, at_nodes, of_beams, last = *block[3:6], np.inf
        error, forces = block.error, at_nodes
        for trial in range(_MOST + 1 if error > _ACCURATE else 0):
            missing, forces = residual, at_nodes
            if beams is not None and not beams.has_external:
                rounding = self._forces_by_sections() - of_beams
                missing, forces = residual + self._reduced(rounding), at_nodes + rounding
            error = self._error(missing)
            if error <= _EXACT or not error < _WORTH * last or trial == _MOST:
                break
            way, last = self._correction(missing), error
            largest = _without_switch(self._what, self._stepper.path, self.state, way)
            self._record(block := self._states(way, largest))
            slopes = zip((residual, at_nodes, of_beams), block[3:6], strict=True)
            residual, at_nodes, of_beams = (known + new for known, new in slopes)
        self._record_forces(forces)
        return error

    def _record(self, block: _Block) -> None:
        """Record states, which count in slopes."""
        recorder, first = self.recorder, self.recorder.rows
        recorder.plan(first, np.arange(first, first + len(_PARTS), dtype=float), last=True)
        for state in block.states:
            self._stepper.loop.record(state, recorder)
        self._factors += (self.state.t + block.way.load * block.largest * _PARTS).tolist()
        weights = _FIRST / block.largest
        self._weights[0] += weights[0]
        self._weights = np.append(self._weights, weights[1:])

    def _record_forces(self, at_nodes: np.ndarray) -> None:
        """Record changes of forces of supports and joints by those (size,) at their nodes."""
        recorder, loop, t = self.recorder, self._stepper.loop, self.state.t
        recorder.plan(recorder.rows, np.arange(3.0) + recorder.rows, last=True)
        # The first one only stands before the others, which are alike but for these forces.
        for part in (0.0, 1.0, 0.0):
            still = np.zeros(self._stepper.model.reduction.free)
            new = loop.finished(self.state, Interval(t, t), still, part * at_nodes)
            loop.record(new, recorder)
        self._factors += [t, t, t]
        self._weights = np.append(self._weights, [0.0, 1.0, -1.0])

    def _forces_by_sections(self) -> np.ndarray:
        """Slopes of the forces (size,) of beams, by section forces in the shape of the state."""
        model, beams = self._stepper.model, self._stepper.model.forms.beams
        assert beams is not None
        batch, mesh = RowSteps(self.recorder).batch(), model.mesh
        resultants = beams.resultants(batch)
        self._resultants = self.slope(resultants)
        self._forces = Axes.of(mesh, self.state.q).forces(self._resultants)
        if resultants[0].any():  # they turn with the elements
            axes = Axes.of(mesh, self.recorder.arrays["q"][: self.recorder.rows])
            self._forces += self.slope(axes.forces(resultants[:1]))
        return np.bincount(mesh.dofs[mesh.elements].ravel(), self._forces.ravel(), model.size)

    def slopes_at_points(self, beam: str) -> np.ndarray:
        """Slopes of N, Q and M (3, points) at the Gauss points of a beam."""
        if self._resultants is None:
            resultants = self.solution.resultants_of_beam(beam)
            return np.array([self.slope(getattr(resultants, name)) for name in "NQM"])
        # No second evaluation: that of compiled code may round otherwise.
        scene, mesh = self._stepper.model.scene, self._stepper.model.mesh
        return self._resultants[mesh.cells[scene.beams.number_of(beam)]].reshape(-1, 3).T

    def slopes_at_ends(self, beam: str, ends: np.ndarray) -> np.ndarray | None:
        """Slopes of N, Q and M (elements, 2, 3) at ends of elements, `ends` in the state.

        None if they need no corrections.
        """
        if self._resultants is None:
            return None
        model, t = self._stepper.model, np.array([self._stepper.loop.forcing.time])
        mesh, loads = model.mesh, ElementLoads(model, model.data.loaded_beams, model.mesh.X)
        own = (floats(loads.dead.series(t)) @ loads.dead.unit_loads.T)[0]
        if loads.weight is not None:
            own = own + floats(loads.weight)
        cells = mesh.cells[model.scene.beams.number_of(beam)]
        nodes = mesh.elements[cells]
        turned, turns = (x[mesh.turns][nodes[:, [0, -1]]] for x in (self.D, self.state.q))
        forces = (self._forces - own.reshape(self._forces.shape))[cells][:, [0, -1]]
        slopes = components(forces * [[-1.0], [1.0]], directions(mesh.X[nodes]) + turns)
        slopes[..., 0] += turned * ends[..., 1]
        slopes[..., 1] -= turned * ends[..., 0]
        return slopes

    def _reduced(self, forces: np.ndarray) -> np.ndarray:
        """Forces (free,) on the unknowns by those (size,) at nodes, in the state."""
        maps = self._stepper.model.reduction.maps
        self._stepper.motions.extended(self.state)  # the couplings are then those of this state
        reduced = maps.reduced_force(forces) - maps.reduced_force(0 * forces)
        return reduced[: len(self._unit)]

    def _error(self, residual: np.ndarray) -> float:
        """Size of a residual (free,) relative to the loads."""
        chosen, parts = self._stepper.model.reduction.independent, (residual, self._column)
        left, loads = (abs(part * self._unit)[chosen].max(initial=0.0) for part in parts)
        return float(left / (loads or 1.0))

    def size(self) -> float:
        """Largest rotation or strain by the load factor."""
        return _size(self._stepper.model, self.D)

    def _states(self, way: _Way, largest: float) -> _Block:
        """States along a way, up to a part of it."""
        model, path, start = self._stepper.model, self._stepper.path, self.state
        weight, points = model.masses.weight, model.forms.compiled_points
        still = self._stepper.loop.forcing.first - (0.0 if weight is None else weight)
        states, turned, bends, nodes, points_rows = [], [], [], [], []
        for part in (0.0, *(largest * _PARTS).tolist()):
            path.set_start(start)
            y, load = part * way.y, part * way.load
            balance = path.balance(y, load)[0]
            # Forces in the state turn with the joints.
            turned.append(model.reduction.maps.reduced_force(self._still)[: len(y)])
            at_points = np.zeros(model.size)
            points.add_force(balance.D, at_points)
            nodes.append(balance.r.copy())
            points_rows.append(at_points)
            interval = Interval(start.t, start.t + load)
            new = self._stepper.loop.finished(start, interval, y, self._still)
            straight = start.q + part * way.D
            bends.append(new.q - straight)
            work = new.work + (1 - load / 2) * path.held @ y - still @ bends[-1]
            states.append(new.changed(q=straight, work=float(work)))
        residual, bend, at_nodes, of_points = (
            _FIRST @ rows / largest for rows in (turned, bends, nodes, points_rows)
        )
        residual += self._reduced(at_nodes) + way.load * path.held
        of_beams = at_nodes - of_points + way.load * self._stepper.loop.forcing.rise
        node_unit = model.units.nodes
        bent = abs(bend / node_unit).max(initial=0.0)
        error = self._error(residual) + bent / (abs(way.D / node_unit).max(initial=0.0) or 1.0)
        return _Block(way, states[1:], largest, residual, at_nodes, of_beams, float(error))

    def slope(self, rows: np.ndarray) -> np.ndarray:
        """Derivative by the load factor of values (n + 1, ...) in all states."""
        # As np.tensordot, which takes longer than the product where a beam has few elements.
        return np.dot(self._weights[None], rows.reshape(len(rows), -1)).reshape(rows.shape[1:])

    def at_ends(self, rows: np.ndarray) -> np.ndarray:
        """Values (2, ...) without and with all loads, from values (n + 1, ...) in all states."""
        return np.array([rows[0], rows[0] + self.slope(rows)])

    def curvature(self, rows: np.ndarray) -> np.ndarray:
        """Half of the second derivative likewise, by the states along the way of the loads."""
        first = rows[: len(_SECOND)]
        return np.tensordot(_SECOND, first, axes=1) / self._block.largest**2


class SmallForces:
    """States under small forces f on nodes (size,), which give them accelerations a (size,).

    They are at u = l u_1, by displacements u_1 of the unknowns y (free,) and of all nodes (size,)
    D; nodes on arms go straight as well. Loads (size,) on nodes stay.
    """

    def __init__(
        self,
        path: PathEquations,
        state: State,
        loads: np.ndarray,
        y: np.ndarray,
        D: np.ndarray,
        force: np.ndarray,
        a: np.ndarray,
    ):
        self._path, self._start, self._way = path, state, _Way(y, D, 0.0)
        self._loads, self._force, self._a = loads, force, a
        #: Error of first-order equilibrium by the states, relative to forces and displacements.
        self.error = np.inf
        largest = _without_switch("spectrum", path, state, self._way)
        for part in _SMALLER:  # lines and beams that guide may be short beside displacements
            found, error = self._found_states(part * largest)
            if not error >= _LESS * self.error:
                #: The states, from that without forces on.
                self.states = found
                self._largest, self.error = part * largest, error
            if self.error < _ACCURATE:
                break

    def _found_states(self, largest: float) -> tuple[list[State], float]:
        """States up to a part of the forces, and the error of first-order equilibrium by them."""
        path, start, (y, D, _) = self._path, self._start, self._way
        model, states, residuals, bends = path.model, [], [], []
        for part in (0.0, *(largest * _PARTS).tolist()):
            path.loop.forcing.first[:] = self._loads + part * self._force
            path.set_start(start)
            balance = path.balance(part * y, 0.0)[0]
            residuals.append(balance.residual[model.reduction.independent])
            new = path.loop.finished(start, Interval(start.t, start.t), part * y, balance.r)
            straight = start.q + part * D
            bends.append(new.q - straight)
            states.append(new.changed(q=straight, a=part * self._a))
        chosen, node_unit = model.reduction.independent, model.units.nodes
        unit = model.units.unknowns[chosen]
        forces = model.reduction.maps.reduced_force(self._force)
        pairs = ((residuals * unit, forces[chosen] * unit), (bends / node_unit, D / node_unit))
        error = sum(
            abs(_FIRST @ rows / largest).max(initial=0.0) / (abs(size).max(initial=0.0) or 1.0)
            for rows, size in pairs
        )
        return states, float(error)

    def slope(self, rows: np.ndarray) -> np.ndarray:
        """Derivative by the forces of values (n + 1, ...) in all states."""
        return np.tensordot(_FIRST, rows, axes=1) / self._largest


# -- The geometric stiffness of forces that small loads cause, in the shape of a state ----------


def check_forces(model: Model) -> None:
    """SceneError for forces whose geometric stiffness is not known."""
    scene, unsupported = model.scene, ""
    if scene.virtual_works or any(line.force for line in scene.forces_between):
        unsupported = "forces with a law of their own"
    if len(model.points.followers):
        unsupported = "loads that follow the motion, so that stability depends on masses"
    if scene.contacts or model.couplings.sliding:
        unsupported = "contact" if scene.contacts else "nodes that slide on beams"
    if unsupported:
        raise SceneError(
            f"buckling: the scene has {unsupported}. Take fx_beam.static, which finds "
            "critical_points"
        )


def geometric_stiffness(small: SmallLoads, model: Model, K: ConstrainedMatrix) -> ConstrainedMatrix:
    """dK/dlambda by forces alone, of the kind of the stiffness K of the last state."""
    parts = _beam_part(small, model) + _line_part(small, model) + _joint_part(small, model)
    return K.weighted(parts, model.reduction)


def _assembled(dofs: np.ndarray, blocks: np.ndarray, size: int) -> csr_matrix:
    """Matrix (size, size) of blocks (n, k, k) by their degrees of freedom (n, k)."""
    rows = np.repeat(dofs, dofs.shape[1], axis=1).ravel()
    columns = np.tile(dofs, dofs.shape[1]).ravel()
    return csr_matrix((blocks.ravel(), (rows, columns)), (size, size))


def _beam_part(small: SmallLoads, model: Model) -> csr_matrix:
    """Part (size, size) of N and Q: the second variation of N eps + Q gamma (eqs 9 and 10)."""
    # With t and n along and across the section: N (2 n.du' dpsi - t.phi' dpsi^2) and
    # -Q (2 t.du' dpsi + n.phi' dpsi^2).
    mesh, size = model.mesh, model.size
    if not model.scene.beams:
        return csr_matrix((size, size))
    weights, values, slopes, dphi, t, n = Axes.of(mesh, small.state.q)
    nodes, count = mesh.elements, mesh.elements.shape[1]
    forces = [small.slopes_at_points(beam.name)[:2] for beam in model.scene.beams]
    N, Q = np.concatenate(forces, axis=1).reshape(2, len(mesh.elements), -1, 1)
    turned = -((N * t + Q * n) * dphi).sum(axis=-1)
    # du' is a slope by J, and the integral has the weight J.
    mixed = np.einsum("g,ga,egi,gb->eaib", weights, slopes, N * n - Q * t, values)
    blocks = np.zeros((len(nodes), count, 3, count, 3))
    blocks[:, :, :2, :, 2] = mixed
    blocks[:, :, 2, :, :2] = mixed.transpose(0, 3, 1, 2)
    blocks[:, :, 2, :, 2] = np.einsum("g,eg,ga,gb->eab", weights, turned, values, values)
    width = 3 * count
    return _assembled(mesh.dofs[nodes].reshape(-1, width), blocks.reshape(-1, width, width), size)


def _line_part(small: SmallLoads, model: Model) -> csr_matrix:
    """Part (size, size) of lines and ropes: F / l across each straight part of length l."""
    # What holds nodes to the ground has a fixed direction.
    lines, size = [line for line in model.scene.forces_between if not line.to_ground], model.size
    if not lines:
        return csr_matrix((size, size))
    forces = small.slope(small.solution.recorded("line_forces"))
    positions = model.mesh.X + small.state.q.reshape(-1, 3)[:, :2]
    # The degrees of freedom of a fixed point are behind all others, and left out at the end.
    fixed = np.full(2, size)
    dofs, blocks = [], []
    for line in lines:
        points, node_dofs = line.points, model.mesh.dofs[:, :2]
        places = [positions[p.number] if isinstance(p, Node) else p.position for p in points]
        numbers = [node_dofs[p.number] if isinstance(p, Node) else fixed for p in points]
        for k, arm in enumerate(line.straight(np.diff(places, axis=0))):
            length = np.hypot(*arm)
            normal = np.eye(2) - np.outer(arm, arm) / length**2
            blocks.append(forces[line.number] / length * np.kron([[1, -1], [-1, 1]], normal))
            dofs.append(np.concatenate(numbers[k : k + 2]))
    return _assembled(np.array(dofs), np.array(blocks), size + 1)[:size, :size]


def _joint_part(small: SmallLoads, model: Model) -> csr_matrix:
    """Part (size, size) of forces f on b in joints: f.d2r, with b at x_a + r, r = R (arm + s axis).

    Forces change by the loads as they are seen from a, like N and Q of a stiff member.
    """
    # With r_ across r: dr = r_ dpsi + R axis ds gives d2r = r dpsi^2 + 2 dr_ dpsi, whatever slides.
    arm_joints = joints_with_arms(model.couplings, model.scene)  # of the present scene
    joints = [joint for joint in arm_joints if joint.a is not GROUND]
    state, dofs, size = small.state, model.mesh.dofs, model.size
    forces = small.solution.recorded("joint_forces")[..., :2]
    slopes, columns, blocks = small.slope(forces), [], np.zeros((len(joints), 5, 5))
    for joint, block in zip(joints, blocks, strict=True):
        turn, number = rotation_of(joint.a), joint.number
        (x, y), psi = forces[0, number], state.q[turn]
        f = slopes[number] - small.D[turn] * np.array([-y, x])
        arm = joint.offset
        if joint.axis is not None:
            arm = arm + state.slides[number] * joint.axis
        across = np.array([f[1], -f[0]])
        turned = np.array([[np.cos(psi), -np.sin(psi)], [np.sin(psi), np.cos(psi)]])
        block[2] = block[:, 2] = [*-across, f @ turned @ arm, *across]
        # The ground is behind all others, and left out at the end.
        b = np.full(2, size) if joint.b is GROUND else dofs[joint.b.number, :2]
        columns.append([*dofs[joint.a.number], *b])
    return _assembled(np.reshape(columns, (-1, 5)).astype(int), blocks, size + 1)[:size, :size]


# -- First-order statics: small displacements about the reference, as of a frame program --------


_log = logging.getLogger("fx_beam")
# Error of the balance of forces, relative to the loads, of which a warning tells.
_OUT_OF_BALANCE = 1e-8


class _Histories(dict[str, object]):
    """Histories by name, of which no motion goes on."""

    def at_end(self, t: float) -> dict[str, np.ndarray]:
        """Nothing that a next step would need."""
        return {}


def first_order(
    stepper: LoadStepper, start: State, stats: Stats, end: Callable[[State], State]
) -> Solution:
    """The solution of two rows, without loads and with all loads, from a state without loads.

    Every history is linear in the load factor; energies and work are quadratic.
    """
    small = SmallLoads("static: linear", stepper, start)
    close, recorder = small.solution, small.recorder
    histories = _Histories(histories_of(recorder))
    for name, rows in histories.items():
        if isinstance(rows, np.ndarray) and len(rows) == len(close.t):
            histories[name] = small.at_ends(rows)
        elif isinstance(rows, Energy):
            parts = (
                [part[0], part[0] + small.slope(part) + small.curvature(part)]
                for part in vars(rows).values()
            )
            histories[name] = Energy(*map(np.array, parts))
    histories.update({"t": np.array([0.0, 1.0]), "t_level": np.array([0.0, 1.0])})
    last = end(start.changed(t=1.0, q=start.q + small.D))
    solution = solution_of(recorder, stats, lambda: last, stored=histories)

    def resultants_of_beam(name: str) -> BeamResultants:
        beam = close.resultants_of_beam(name)
        starts, slopes = (beam.N[0], beam.Q[0], beam.M[0]), small.slopes_at_points(name)
        N, Q, M = (np.array([x, x + dx]) for x, dx in zip(starts, slopes, strict=True))
        return BeamResultants(beam.s, N, Q, M, lambda: balance_of(name, beam))

    def balance_of(name: str, beam: BeamResultants) -> BeamBalance:
        balance = beam.balanced()
        ends, jumps = map(small.at_ends, (balance.ends, balance.jumps))
        if (slopes := small.slopes_at_ends(name, ends[0])) is not None:
            ends[1] = ends[0] + slopes
        return BeamBalance(balance.s, ends, balance.places, jumps)

    solution.resultants_of_beam = resultants_of_beam
    if small.error > _OUT_OF_BALANCE:
        _log.warning(
            "static: linear: few correct digits, if any: forces are out of balance by %.0e of the "
            "loads by rounding errors. Beams are far stiffer in tension or shear than in bending, "
            "or have very many elements. Take fewer elements, or smaller EA and GA",
            small.error,
        )
    return solution
