"""Derivatives of stiffness, damping and mass about an equilibrium by all numbers of its scene."""

from __future__ import annotations

from collections.abc import Mapping, Set
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse

from fx_beam.dual import Dual
from fx_beam.errors import SceneError
from fx_beam.linear.linearisation import Linearisation
from fx_beam.motions.numbers import numbers_of_state, static_numbers_of
from fx_beam.results.solution import Solution
from fx_beam.scene.inputs import with_values
from fx_beam.scene.law import switches
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import expressions_of
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.numbers import data_of
from fx_beam.step.sparse_lu import pivoted_lu
from fx_beam.step.tables import Problem
from fx_beam.step.tape import Tape, static_tape
from fx_beam.step.tape_derivatives import TapeDerivatives

from .built_scenes import refuse_others
from .energy_outputs import by_mass_entries
from .gradient import along
from .static_derivatives import StateChange

# Differences of order six along a direction, and second ones: points, and weights over the distance
# or its square. The distance is relative to a motion of the size of the scene, or of a radian, and
# less than a short spring or a small circle. Round-off of second ones needs a longer one.
_FIRST = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60
# The same for damping that is nonlinear in the rate: they leave out |v| v, the quadratic drag at
# rest, and steps take so many times longer that their rates are near zero. Forces of damping then
# have so many times the round-off: drag, of which little is left, takes fewer.
_NONLINEAR = (
    np.array([-4, -3, -2, -1, 1, 2, 3, 4]),
    np.array([9, -56, 144, -216, 216, -144, 56, -9]) / 120,
)
_SLOW, _SLOW_DRAG = 1e4, 1e2
_SECOND = np.arange(-3, 4), np.array([2, -27, 270, -490, 270, -27, 2]) / 180
_DISTANCE, _OF_SECOND = 1e-3, 4e-3
# The same where functions of the user have pieces, which may meet near the state, and their names.
_IN_PIECES, _FUNCTIONS = 1e-6, {"strain_energy", "force", "virtual work"}
# The least one where a contact opens or closes on the way, and where a node slides off its element.
_NEAREST, _ON_ELEMENT = 1e-8, 1e-5
# Numbers of a state that follow from the load steps before, where something flows.
_OF_STATE = {"q", "slides", "internal", "spring internal"}
# What is left of a direction of length 1 that is a sum of others.
_ALIKE = 1e-11
# Forces that remain of a system that is solved, relative to its right side.
_SOLVED = 1e-6
# Memory [bytes] of what is found forwards at once.
_MEMORY = 1e8


class Pairs(NamedTuple):
    """Sums (n,) of k l.K r + c l.C r + m l.M r of pairs of motions l and r, which may be complex.

    And of forces times the motions T l and T r of the nodes. The steps that tell damping have
    `times` [s] like those of the vibrations.
    """

    #: Motions r (p, free), and l (n, free); the number (n,) of the motion r of each.
    right: np.ndarray
    left: np.ndarray
    of: np.ndarray
    #: Factors k, c and m, each one number or (n,).
    stiffness: Any
    damping: Any = 0.0
    mass: Any = 0.0
    times: Any = 1.0
    #: Forces (size,) times T l, and (n, size) times T r.
    on_left: Any = 0.0
    on_right: Any = 0.0
    #: Motion (size,) of the nodes that is added to T r in m l.M r; None for none.
    base: np.ndarray | None = None


class _Along(NamedTuple):
    """Directions (d, free), with times [s] like those of the vibrations, and what n sums have.

    Of each the number (n,) of its direction r, and weights (n, free) of K r and C r. Matrices A
    with weights (n, size) of the mass times A r. Numbers with weights (n, size) of motions T r.
    A motion (size,) of the base, and weights (n, size) of the mass times it; or None.
    """

    directions: np.ndarray
    times: np.ndarray
    of: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    by_mass: list[tuple[scipy.sparse.csr_matrix, np.ndarray]]
    ends: list[tuple[np.ndarray, np.ndarray]]
    base: tuple[np.ndarray, np.ndarray] | None


class _Steps(NamedTuple):
    """Steps from the state: increments (k, free), lengths (k,) [s] and load factors (k,).

    And the number (k,) of the row [length][direction] of each, and its share of that.
    """

    moves: np.ndarray
    lengths: np.ndarray
    factors: np.ndarray
    rows: np.ndarray
    shares: np.ndarray


class TangentDerivatives:
    """The equilibria of linearised scenes, beside which forces are followed backwards or forwards.

    The derivative of d.K d is that of the work d.r of the residual, along d: r is evaluated at
    states beside the equilibrium by the same laws, blocks and Jacobians of elements as of motions.
    """

    def __init__(self, what: str):
        self._what = what
        # The problem of the steps, and their derivatives.
        self._problem: Any = None
        self._derivatives: TapeDerivatives
        #: Changes (m, ...) of the numbers by x.
        self.changes: Mapping[str, np.ndarray]

    def begin(self, about: Linearisation, state: Solution | None, damped: bool = False) -> None:
        """Take the tangent about a state, or about the reference."""
        if about.model.points.friction_sticks(about.start.q, about.start.slides):
            raise SceneError(f"{self._what}: no derivatives: friction that sticks has none")
        self._about, self._unit = about, about.model.unit_of_unknowns[about.unknowns]
        # Where something flows, the state follows from all load steps before.
        flows, self._start = about.model.flows, about.start
        self._follows = state is not None and not flows
        # Steps that tell damping hold what flows, too.
        self._damped = (damped and about.may_be_damped) or flows
        self._factor, self._inputs = 0.0, None
        if state is not None and state.end is not None:
            self._factor, self._inputs = float(state.t[-1]), state.end.inputs
        model = about.damped_model if self._damped else about.model
        # Internal variables are held in these steps.
        losing = (law for law in model.points.laws if law.loss and not law.internal)
        nonlinear = any(law.iteration_memory or law.user_defined for law in losing)
        quadratic = any(drag.quadratic.any() for drag in model.scene.drags)
        self._first, self._slow = _FIRST, 1.0
        functions = (of for name, of in expressions_of(model.scene) if name in _FUNCTIONS)
        self._distance_at_most = _IN_PIECES if any(map(switches, functions)) else _DISTANCE
        if self._damped and (nonlinear or quadratic):
            self._first, self._slow = _NONLINEAR, _SLOW if nonlinear else _SLOW_DRAG
        # At the reference forces that depend on the motion count for damping, not for stiffness.
        unloaded = self._damped and self._factor == 0.0 and model.points.has_external
        self._factors = [0.0, 1.0] if unloaded else [self._factor]
        # Forces that depend on rates, without inertia.
        given = NewtonOptions(), about.frame is not None, True, False, False, 1.0, False
        problem = Problem.of(model, *given)
        problem.set_frame(about.frame)
        if problem is not self._problem:
            self._derivatives = TapeDerivatives(problem)
        self._problem = problem
        self._forcing = LoadForcing(model, about.start.t)
        self._unknowns = about.unknowns

    def take(self, changes: Mapping[str, np.ndarray], changing: Set[str]) -> None:
        """Take changes (m, ...) of the numbers by x; those not `changing` are zero."""
        refuse_others(changes, self._derivatives.names, self._what)
        self.changes = changes
        self._changing = {name: of for name, of in changes.items() if name in changing}

    def numbers_of(
        self, scene: Scene, change: Any = None, start: StateChange | None = None
    ) -> dict[str, np.ndarray]:
        """The numbers of this equilibrium for another scene; OtherStructureError if it differs.

        With those of its state if this has a start, which changes with x.
        """
        model, time = self._problem.model, self._forcing.time
        scene = with_values(scene, self._inputs)
        # Without slopes it may be a scene that all calls share, with other numbers since.
        same = scene is model.scene and isinstance(change, Dual)
        data = model.data if same else data_of(model, scene)
        numbers = static_numbers_of(model, data, time, np.array([self._factor]))
        if self._damped and data.natural:  # a step that tells damping also begins in the state
            numbers["natural"] = self._factor * data.natural.numbers_at(time)
        if start is not None:
            of_state = numbers_of_state(data, start.at(data, change))
            numbers |= {name: of_state[name] for name in _OF_STATE & of_state.keys()}
        return numbers

    def by_factor(self) -> dict[str, np.ndarray]:
        """Derivatives of the numbers by the load factor, of the names that depend on it."""
        model, factor, time = self._problem.model, self._factor, self._forcing.time
        rows = static_numbers_of(model, model.data, time, np.array([factor - 1, factor + 1]))
        names = {"loads", "driven", "naturals"} & rows.keys()
        numbers = {name: (rows[name][1:] - rows[name][:1]) / 2 for name in names}
        if model.weight is not None:  # the factor multiplies it
            numbers["weight"] = model.weight / factor
        return numbers | {"points": model.points.by_load_factor}

    def of_sums(self, pairs: Pairs, weights: np.ndarray) -> np.ndarray:
        """Derivatives (s, m) by x of real parts of weights (s, n) times sums.

        Several are followed forwards, where this can be.
        """
        motions = self.along_motions(pairs)
        if len(weights) > 1 and not self._problem.c.loops.closures:
            return (weights @ self._forwards(motions)).real
        sums = np.zeros((len(weights), len(self.changes["X"])))
        for row, of_sum in zip(sums, weights, strict=True):
            by, by_state = self.followed(motions, of_sum)
            row += self.by_x(by)
            if self._follows:
                row -= self.by_x(self.forces(self._solved(self._about.K.T, by_state[None])[0]))
        return sums

    def by_x(self, by: Mapping[str, np.ndarray], changes: Any = None) -> np.ndarray:
        """Derivatives (m,) by x of what has some by numbers, whose changes may be others."""
        changes, none = changes or self._changing, np.zeros(len(self.changes["X"]))
        return sum((along(changes[name], of) for name, of in by.items() if name in changes), none)

    def along_motions(self, of: Pairs) -> _Along:
        """The motions r of pairs as directions; also l, if motions of nodes depend on the state."""
        about, right, left, mass = self._about, of.right, of.left, self._about.model.mass
        k, c, m = (np.reshape(by, (-1, 1)) for by in (of.stiffness, of.damping, of.mass))
        T, moved, directions = about.T, _times(about.T, left), right
        by_mass, turns = [(T, m * moved)], list[tuple[Any, np.ndarray]]()
        if about.frame is not None:  # Coriolis forces are the mass times these
            turn = 2 * np.sqrt(self._factor) * about.frame.spin * about.frame.quarter_turn
            by_mass.append((turn @ T, c * moved))
            turns.append((turn, c))
        times, ends = np.broadcast_to(of.times, len(right)), list[tuple[np.ndarray, np.ndarray]]()
        if self._derivatives.places_depend:
            motion, of_nodes = _times(T, right)[of.of], _times(mass, moved)
            moving = sum((by * _times(turn, motion) for turn, by in turns), m * motion)
            turned = (by * _times(turn.T, of_nodes) for turn, by in turns)
            ends = [(of.of, sum(turned, of.on_right + m * of_nodes))]
            ends += [(len(right) + np.arange(len(left)), _times(mass, moving) + of.on_left)]
            directions, times = np.vstack([right, left]), np.append(times, times[of.of])
        base = None if of.base is None else (of.base, m * moved)
        return _Along(directions, times, of.of, k * left, c * left, by_mass, ends, base)

    def followed(
        self, along: _Along, weights: np.ndarray, curved: bool = False
    ) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Derivatives by numbers, and by the state, of the real part of weights (n,) times sums.

        If `curved`, with the second derivatives of forces along the direction r in place of K r.
        """
        numbers = [of[weights != 0] for of in (along.of, *(of for of, _ in along.ends))]
        used = np.unique(np.concatenate(numbers[: 1 if curved else None]))
        basis, of_used = _basis(along.directions[used], self._unit)
        parts = np.zeros((len(along.directions), len(basis)), complex)
        parts[used] = of_used ** (1 + curved)
        time = self._slow * _mean(along.times[used])

        def weighted(of: np.ndarray, by: np.ndarray) -> np.ndarray:
            """Weights (r, ...) along the basis."""
            return ((weights[:, None] * parts[of]).T @ by).real

        on_forces = np.vstack([weighted(along.of, by) for by in self._of_lengths(along, time)])
        on_ends = np.zeros((len(on_forces), len(self._start.q)))
        on_ends[: len(basis)] = sum(weighted(*of) for of in along.ends)
        by, by_state = self._backwards(self._steps(basis, time, curved), on_forces, on_ends)
        for A, of_mass in along.by_mass if "mass" in by else []:
            pairs = zip(weighted(along.of, of_mass), _times(A, basis), strict=True)
            of_pairs = (by_mass_entries(self._problem.model, *pair) for pair in pairs)
            by["mass"] = sum(of_pairs, by["mass"])
        if along.base is not None and "mass" in by:
            motion, of_motion = along.base
            on_base = weights @ of_motion
            for pair in ((on_base.real, motion.real), (-on_base.imag, motion.imag)):
                by["mass"] = by["mass"] + by_mass_entries(self._problem.model, *pair)
        return by, by_state

    def _of_lengths(self, along: _Along, time: float) -> list[np.ndarray]:
        """Weights (n, free) of residuals of steps of each length, that tell stiffness and damping.

        The force of a step with an increment D is K D / 2 + C D / length, that of a length less
        that of its double C D / (2 length). Of steps without loads and with them, if these count
        for damping only, the first tell K and the others C.
        """
        K, C = along.stiffness, 2 * time * along.damping
        if len(self._factors) > 1:
            return [-2 * K, 4 * K, C, -C]
        return [C - 2 * K, 4 * K - C] if self._damped else [K]

    def _forwards(self, along: _Along) -> np.ndarray:
        """Derivatives (n, m) of sums by changes of K, C, M and T along a basis."""
        changes, mass = self.changes, self._problem.model.mass
        basis, parts = _basis(along.directions, self._unit)
        time, by_state = self._slow * _mean(along.times), None
        count, free = len(changes["X"]), basis.shape[1]
        if self._follows:
            forces, _ = self._pushed(self._one_step(free), np.zeros((count, free)))
            by_state = -self._solved(self._about.K, forces[0])
        sums, on_forces = np.zeros((len(along.of), count), complex), self._of_lengths(along, time)

        def add(rows: np.ndarray, of: np.ndarray, by: np.ndarray, x: Any = slice(None)) -> None:
            """Add weights (n, size) times rows (r, m, size) along some of the basis."""
            columns = np.ascontiguousarray(by.T, complex).view(float)
            products = (rows.reshape(-1, len(columns)) @ columns).view(complex)
            products = products.reshape(*rows.shape[:2], -1)
            sums[:, x] += np.einsum("nr,rmn->nm", parts[of][:, some], products)

        masses = changes["mass"].reshape(count, -1)
        heavy = np.flatnonzero(masses.any(axis=1))
        for motion, of_motion in [] if along.base is None else [along.base]:
            for i in heavy:
                changed = scipy.sparse.csr_matrix((masses[i], mass.indices, mass.indptr))
                sums[:, i] += of_motion @ (changed @ motion)
        most = max(1, int(_MEMORY / (8 * len(on_forces) * free * count)))
        for some in (slice(k, k + most) for k in range(0, len(basis), most)):
            forces, ends = self._pushed(self._steps(basis[some], time), by_state)
            for rows, by in zip(np.split(forces, len(on_forces)), on_forces, strict=True):
                add(rows, along.of, by)
            for of, by in along.ends:
                add(ends[: len(basis[some])], of, by)
            for A, by in along.by_mass if len(heavy) else []:
                moved = A @ basis[some].T
                pattern = mass.indices, mass.indptr
                changed = (scipy.sparse.csr_matrix((masses[i], *pattern)) for i in heavy)
                add(np.array([(M @ moved).T for M in changed]).swapaxes(0, 1), along.of, by, heavy)
        return sums

    def forces(self, weights: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives of weights (free,) times the residual by numbers in the state."""
        step, none = self._one_step(len(weights)), 0 * self._start.q[None]
        return self._backwards(step, weights[None], none)[0]

    def _one_step(self, free: int) -> _Steps:
        """A step that remains in the state."""
        one, factor = np.ones(1), np.array([self._factor])
        return _Steps(np.zeros((1, free)), one, factor, np.zeros(1, int), one)

    def _steps(self, directions: np.ndarray, time: float, curved: bool = False) -> _Steps:
        """Steps along directions (r, free), also of twice the time if they tell damping.

        And both with loads, if these count for damping only.
        """
        points, weights = _SECOND if curved else self._first
        largest = abs(directions / self._unit).max(axis=1)
        most = _OF_SECOND if curved else self._distance_at_most
        distances = [self._distance(of, most) for of in directions / largest[:, None]]
        sizes = (distances / largest)[:, None]
        moves = ((sizes * points)[..., None] * directions[:, None]).reshape(-1, directions.shape[1])
        times = [time, 2 * time] if self._damped else [0.0]
        kinds = [(length, factor) for factor in self._factors for length in times]
        lengths, factors = np.repeat(kinds, len(moves), axis=0).T
        rows = np.arange(len(kinds) * len(sizes)).repeat(len(points))
        moves, shares = np.tile(moves, (len(kinds), 1)), weights / sizes ** (1 + curved)
        return _Steps(moves, lengths, factors, rows, np.tile(shares.ravel(), len(kinds)))

    def _distance(self, direction: np.ndarray, most: float) -> float:
        """Distance of steps along a direction (free,), within which no contact opens or closes.

        And no node slides off its element, or along a member that it touches to another piece.
        """
        about, model, start = self._about, self._about.model, self._start
        if not (model.points.conditions or model.couplings.sliding):
            return most
        reduction, points = model.reduction, self._first[0]
        columns, driven = about.columns @ direction, np.zeros(reduction.driven)
        reach = reduction.sliders.reach(start.slides, points[-1] * columns)
        distance = max(min(most, 0.9 * reach), _ON_ELEMENT)
        at_start, members = model.switches(start), model.points.members
        touched = members and members.touched
        reduction.begin(start.q, start.slides)

        def switched(by: float) -> bool:
            y = by * columns[: reduction.free]
            q = start.q + reduction.increment(y, driven)
            slides = start.slides + model.couplings.free_slides(y, len(start.slides))
            passed = (model.points.switches(q, slides) * at_start < 0).any()
            return bool(passed) or (members and members.touched) != touched

        while distance > _NEAREST and any(map(switched, distance * points)):
            distance /= 2
        return distance

    def _pushed(self, steps: _Steps, by_state: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
        """Changes (rows, m, ...) of residuals and ends of steps, with all numbers and the state."""
        given = self._tape(steps), self.changes, by_state, steps.rows, steps.shares
        return self._derivatives.jvp_of_equations(*given)

    def _backwards(
        self, steps: _Steps, weights: np.ndarray, of_ends: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Derivatives of weighted residuals and ends of steps, by numbers and by the state.

        Those by numbers hold the state, if this follows from other numbers.
        """
        given = self._tape(steps), steps.rows, steps.shares, self._spread(weights), of_ends
        of_state, names = self._unknowns[: 0 if self._follows else None], self._changing.keys()
        by, by_unknowns = self._derivatives.vjp_of_equations(*given, of_state, names)
        return by, by_unknowns[self._unknowns]

    def _spread(self, rows: np.ndarray) -> np.ndarray:
        """Rows (n, free) of the model from those of the unknowns, with zeros for the others."""
        wide = np.zeros((len(rows), self._problem.c.free))
        wide[:, self._unknowns] = rows
        return wide

    def _tape(self, steps: _Steps) -> Tape:
        """Steps from the state."""
        state = replace(self._start, t=self._factor)
        tape = static_tape(self._problem, state, [state], self._forcing)
        tape.c.apart = True
        tape.repeat(self._spread(steps.moves), steps.lengths, steps.factors)
        return tape

    def _solved(self, K: scipy.sparse.csr_matrix, by_state: np.ndarray) -> np.ndarray:
        """Solutions (n, free) of the tangent K, or of its transpose, for right sides."""
        try:
            weights = pivoted_lu(K).solve(by_state.T)
        except RuntimeError:
            weights = np.full(by_state.T.shape, np.nan)
        left = abs(K @ weights - by_state.T).max(axis=0)
        if not (left <= _SOLVED * abs(by_state).max(axis=1)).all():
            raise SceneError(
                f"{self._what}: no derivatives: the tangent of the state is singular, so that it "
                "does not follow from the numbers. Support the scene, or take a state beside a "
                "critical point"
            )
        return weights.T


def _basis(directions: np.ndarray, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Real directions (r, n), and complex factors (k, r), whose products are those given (k, n).

    They are orthogonal in units (n,). Motions at near frequencies are much alike: r is less than k.
    """
    directions = directions / unit
    sizes = np.linalg.norm(directions, axis=1)[:, None]
    rows = directions / np.where(sizes > 0, sizes, 1.0)
    rows = np.vstack([rows.real, rows.imag])
    # As `scipy.linalg.qr` with pivoting, but for columns that are sums of those before.
    factors, _, scales, *_ = scipy.linalg.lapack.dgeqp3(rows.T, lwork=34 * len(rows) + 32)
    count = int(np.sum(abs(factors.diagonal()) > _ALIKE))
    basis, *_ = scipy.linalg.lapack.dorgqr(factors[:, :count], scales[:count])
    real, imaginary = np.split(rows @ basis, 2)
    return unit * basis.T, sizes * (real + 1j * imaginary)


def _times(matrix: scipy.sparse.csr_matrix, vectors: np.ndarray) -> np.ndarray:
    """A matrix times vectors (n, columns)."""
    return np.ascontiguousarray((matrix @ vectors.T).T)


def _mean(times: np.ndarray) -> float:
    """Their geometric mean."""
    return float(np.exp(np.log(times).mean()))
