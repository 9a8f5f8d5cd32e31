"""First-order equations of small deviations, with inputs and without massless unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
import scipy.linalg

from fx_beam.errors import SceneError
from fx_beam.fem.loads import columns_of
from fx_beam.scene.beam import Node
from fx_beam.step.held_inputs import Ramp

from .moving_state import Deviations, driven_of, forces_inside

# Relative size below which a mass or a damping of a combination of unknowns is round-off.
_NONE = 1e-12


class InputColumns:
    """Forces F (columns, m) of the inputs and of their rates, positions and rates of driven ones.

    Positions p (k) of driven inputs move the driven columns by `of_positions` (columns, k); their
    rates are `rates` (k, m) times the inputs.
    """

    def __init__(self, about: Deviations, names: Sequence[str]):
        held, free, count = about.held, len(about.unknowns), about.T.shape[1]
        forces: list[np.ndarray] = []
        of_driven: list[np.ndarray] = []
        of_rates: dict[int, np.ndarray] = {}
        driven: list[int] = []
        #: Name of each input; with its component where it has two.
        self.labels: list[str] = []
        #: Number and factor of the first driven motion of each position.
        self.driven: list[tuple[int, float]] = []
        model = about.model
        #: Inputs whose rates have forces: number, place in all inputs, and value in the state.
        self.straining: list[tuple[int, int, float]] = []
        first = dict(zip(held.widths, np.cumsum([0, *held.widths.values()]), strict=False))
        inside = [*model.forms.parameters.functions, *(of for _, of in model.natural.functions)]
        for name in names:
            parts, width = held.parts_of(name), held.widths[name]
            if any(part is of for of in inside for part in parts):
                force, of_rate = forces_inside(about, name)
                if of_rate.any():
                    of_rates[len(forces)] = of_rate
                    self.straining.append((len(forces), first[name], float(held.values[name][0])))
                forces.append(force)
                self.labels.append(name)
                continue
            if isinstance(parts[0], Ramp):
                ramps = [
                    (i, function.factor)
                    for i, function in enumerate(about.forcing.functions)
                    if isinstance(function, Ramp) and function.name == name
                ]
                column = np.zeros(count)
                for i, factor in ramps:
                    column[free + i] = factor
                self.driven.append(ramps[0])
                driven.append(len(forces))
                forces.append(np.zeros(count))
                of_driven.append(column)
                self.labels.append(name)
                continue
            for k, unit in enumerate(np.eye(width)):
                forces.append(about.T.T @ _force(about, parts, unit))
                self.labels.append(name if width == 1 else f"{name}.{'xy'[k]}")
        self.forces = np.array(forces).reshape(-1, count).T
        self.forces_of_rates = np.zeros_like(self.forces)
        for number, of_rate in of_rates.items():
            self.forces_of_rates[:, number] = of_rate
        self.of_positions = np.array(of_driven).reshape(-1, count).T
        self.rates = np.eye(len(forces))[driven]


def _force(about: Deviations, parts: list, unit: np.ndarray) -> np.ndarray:
    """Nodal forces (size,) of a unit of an input."""
    model = about.model
    force, column = np.zeros(model.size), 0
    for load in model.scene.loads:
        value = next((part.of(unit) for part in parts if id(part) == id(load.value)), None)
        if load.follower:
            if value is not None:
                assert isinstance(load.target, Node)  # only forces on nodes turn
                x, y, turn = model.mesh.dofs[load.target.number]
                c, s = np.cos(about.state.q[turn]), np.sin(about.state.q[turn])
                force[x] += c * value[0] - s * value[1]
                force[y] += s * value[0] + c * value[1]
            continue
        width = columns_of(load)
        if value is not None:
            force += model.loads.unit_loads[:, column : column + width] @ value
        column += width
    return force


class FirstOrder:
    """First-order equations of the deviations, without those of massless unknowns.

    All quantities are rows over the states and the inputs (x, u). Where the rate of an input has a
    force G u', the rates of masses are v + M^-1 G u and what has damping only is at x + C^-1 G u:
    so the states v and x have no force of u', and do not jump with u.
    """

    def __init__(self, about: Deviations, inputs: InputColumns, what: str):
        self._about, self._inputs = about, inputs
        free = len(about.unknowns)
        V, masses, damped = _kinds(about.M[:free, :free], about.C[:free, :free], what)
        y = slice(free)
        M, C, K = ((V.T @ part[y, y] @ V) for part in (about.M, about.C, about.K))
        of_positions = inputs.of_positions
        Mp, Cp, Kp = (V.T @ part[y] @ of_positions for part in (about.M, about.C, about.K))
        F, G = V.T @ inputs.forces[y], inputs.rates
        of_rates = V.T @ inputs.forces_of_rates[y]
        one, a, b = slice(masses), slice(masses, masses + damped), slice(masses + damped, free)
        k, m = G.shape
        counts = np.cumsum([0, masses, damped, k, masses, m])
        eye = np.eye(counts[-1])
        y1, ya, p, s, u = (eye[i:j] for i, j in zip(counts[:-1], counts[1:], strict=True))
        solve = scipy.linalg.solve
        dp = G @ u
        self.moved = solve(M[one, one], Mp[one]) if masses else Mp[one]
        #: Jumps of what has damping only, and of the rates of masses, with the inputs.
        self.shifts = solve(C[a, a], of_rates[a]) if damped else of_rates[a]
        impulses = of_rates[one] - C[one, a] @ self.shifts
        self.kicks = solve(M[one, one], impulses) if masses else impulses
        dy1 = s + self.kicks @ u - self.moved @ dp
        ya = ya + self.shifts @ u
        try:
            held = solve(K[b, b], np.column_stack([F[b], K[b, one], K[b, a], Kp[b]]))
        except np.linalg.LinAlgError as error:
            raise SceneError(
                f"{what}: a part without mass and damping moves freely. Give it mass or a support"
            ) from error
        jump, by_1, by_a, by_p = np.split(held, np.cumsum([m, masses, damped]), axis=1)
        yb = jump @ u - by_1 @ y1 - by_a @ ya - by_p @ p

        def force(rows: slice) -> np.ndarray:
            elastic = K[rows, one] @ y1 + K[rows, a] @ ya + K[rows, b] @ yb + Kp[rows] @ p
            return F[rows] @ u - elastic - C[rows, one] @ dy1 - Cp[rows] @ dp

        dya = solve(C[a, a], force(a)) if damped else eye[:0]
        ds = solve(M[one, one], force(one) - C[one, a] @ dya) if masses else s
        dyb = -by_1 @ dy1 - by_a @ dya - by_p @ dp
        self.dx = np.vstack([dy1, dya, dp, ds])
        moved = np.zeros((len(of_positions), counts[-1]))
        moved[y] = V @ np.vstack([y1, ya, yb])
        self.z = moved + of_positions @ p
        rates = np.zeros_like(moved)
        rates[y] = V @ np.vstack([dy1, dya, dyb])
        self.dz = rates + of_positions @ dp
        #: Jumps (free, m) of the unknowns with the inputs.
        self.jumps = V[:, a] @ self.shifts + V[:, b] @ (jump - by_a @ self.shifts)
        self._inverse, self._one, self._a = np.linalg.inv(V), one, a
        #: Matrix (n, states) that gives the states of this system.
        self._states = np.eye(len(self.dx))
        #: Shape of nodal motions, and number of joints.
        self.shape, self.joints = (len(about.model.mesh.X), 3), about.model.scene.joint_count

    def projected(self, W: np.ndarray) -> FirstOrder:
        """With fewer states, W (n, states) times these."""
        fewer = copy(self)
        fewer._states = W @ self._states
        return fewer

    def deviation(
        self, q: np.ndarray, v: np.ndarray, slides: np.ndarray, t: float, inputs: np.ndarray | None
    ) -> np.ndarray:
        """States of a motion: displacements (nodes, 3), rates, slides (joints,), and time [s].

        Also the values of all inputs, where the force of a rate of theirs is known.
        """
        about, model = self._about, self._about.model
        free, state = len(about.unknowns), about.state
        q, v = model.from_nodes(q), model.from_nodes(v)
        if about.frame is not None:
            q, v = about.frame.seen(q, v, about.factor, t - state.t)
        D = q - state.q
        y = model.couplings.unknowns(D, slides - state.slides)[about.unknowns]
        changes = driven_of(model, model.to_nodes(D), slides - state.slides)
        z = np.concatenate([y, changes])
        known = about.T @ about.rates + about.dT @ z
        rates = about.rates_from @ (v - known)
        p, dp = (
            np.array([values[number] / factor for number, factor in self._inputs.driven])
            for values in (changes, rates[free:])
        )
        dy = rates[:free]
        y, dy = self._inverse @ y, self._inverse @ dy
        u = np.zeros(self.kicks.shape[1])
        if inputs is not None:
            for number, place, value in self._inputs.straining:
                u[number] = inputs[place] - value
        slow = y[self._a] - self.shifts @ u
        rates_of_masses = dy[self._one] + self.moved @ dp - self.kicks @ u
        return self._states @ np.concatenate([y[self._one], slow, p, rates_of_masses])


def _kinds(M: np.ndarray, C: np.ndarray, what: str) -> tuple[np.ndarray, int, int]:
    """A basis (free, free): unknowns with mass, with damping only, with neither; how many."""
    heavy, light = (np.flatnonzero(mask) for mask in (M.diagonal() > 0, M.diagonal() <= 0))
    with_mass, without = _split(M, np.eye(len(M))[:, heavy])
    rest = np.hstack([without, np.eye(len(M))[:, light]])
    damped, neither = _split((C + C.T) / 2, rest)
    left = max(abs(C @ neither).max(initial=0), abs(neither.T @ C).max(initial=0))
    if left > 1e-9 * abs(C).max(initial=0.0):
        raise SceneError(
            f"{what}: forces that depend on rates drive a part without mass. Give it mass"
        )
    return np.hstack([with_mass, damped, neither]), with_mass.shape[1], damped.shape[1]


def _split(A: np.ndarray, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Parts of a basis (n, k) in which a matrix without negative values is positive, and zero.

    The basis itself where it is all of one kind.
    """
    a = basis.T @ A @ basis
    diagonal = a.diagonal()
    if not (diagonal > 0).any():
        return basis[:, :0], basis
    scale = np.where(diagonal > 0, 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1)), 1.0)
    values, vectors = scipy.linalg.eigh(scale[:, None] * a * scale)
    none = values <= _NONE * values.max()
    if not none.any():
        return basis, basis[:, :0]
    vectors = basis @ (scale[:, None] * vectors)
    return vectors[:, ~none], vectors[:, none]
