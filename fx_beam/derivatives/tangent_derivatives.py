"""Derivatives of stiffness, damping and mass about an equilibrium by all numbers of its scene."""

from __future__ import annotations

import functools
from collections.abc import Callable, Set
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix

from fx_beam.dual import Dual, MaybeDual
from fx_beam.equilibria.statics import path_of
from fx_beam.errors import SceneError, check_takes, require
from fx_beam.fem.point_values import friction_sticks, slopes_by_load_factor
from fx_beam.linear.linearisation import Linearisation, linearised
from fx_beam.motions.motion_setup import numbers_of_state, static_numbers_of
from fx_beam.results.records import Stats
from fx_beam.results.solution import Solution
from fx_beam.scene.functions import with_values
from fx_beam.scene.law import switches
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import expressions_of
from fx_beam.step.fitted_rates import Arrays
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.model import Model, data_of
from fx_beam.step.sparse_lu import pivoted_lu
from fx_beam.step.tables import ProblemInC, problem_of
from fx_beam.step.tangent_storage import ProblemKind
from fx_beam.step.tape import Tape, repeated, static_tape
from fx_beam.step.tape_derivatives import TapeDerivatives

from .analysis import StateChange, StaticDerivatives
from .output_kinds import by_mass_entries
from .parametrised import Parametrised, along as linear_change, refuse_others

# -- Steps from an equilibrium, whose forces tell stiffness and damping along directions --------


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


class DirectionSteps(NamedTuple):
    """Steps from the state: increments (k, free), lengths (k,) [s] and load factors (k,).

    And the number (k,) of the row [length][direction] of each, and its share of that.
    """

    moves: np.ndarray
    lengths: np.ndarray
    factors: np.ndarray
    rows: np.ndarray
    shares: np.ndarray


class TangentSteps:
    """Steps from the state of a linearised scene, at a load factor.

    By the problem in C of the `last` call, if the models are the same with other numbers.
    """

    def __init__(
        self, linear: Linearisation, factor: float, damped: bool, last: ProblemInC | None = None
    ):
        self._linear, self._start, self._factor = linear, linear.start, factor
        #: Sizes (free,) of motions of all unknowns by the size of the scene, or by a radian.
        self.unit = linear.model.units.unknowns[linear.unknowns]
        # Steps that tell damping hold what flows, too.
        self.damped = (damped and linear.may_be_damped) or linear.model.kinks.flows
        model = linear.damped_model if self.damped else linear.model
        # Internal variables are held in these steps.
        losing = (law for law in model.points.laws if law.loss and not law.internal)
        nonlinear = any(law.iteration_memory or law.user_defined for law in losing)
        quadratic = any(drag.quadratic.any() for drag in model.scene.drags)
        #: Points and weights of differences, and how much longer than `times` steps take.
        self._first, self.slow = _FIRST, 1.0
        if self.damped and (nonlinear or quadratic):
            self._first, self.slow = _NONLINEAR, _SLOW if nonlinear else _SLOW_DRAG
        functions = (f for name, f in expressions_of(model.scene) if name in _FUNCTIONS)
        self._distance_at_most = _IN_PIECES if any(map(switches, functions)) else _DISTANCE
        # At the reference forces that depend on the motion count for damping, not for stiffness.
        loads = model.points.placed[model.points.external]
        unloaded = self.damped and factor == 0.0 and bool(loads)
        self._factors = [0.0, 1.0] if unloaded else [factor]
        # Forces that depend on rates, without inertia.
        kind = ProblemKind(turns=linear.frame is not None, inert=False)
        if last is not None and last.model is model and last.kind == kind:
            last.restart()  # with the numbers of this scene
        else:
            last = problem_of(model, kind)
        self.problem = last
        self.problem.set_frame(linear.frame)
        self.forcing = LoadForcing(model, linear.start.t)

    def of_lengths(
        self, stiffness: np.ndarray, damping: np.ndarray, time: float
    ) -> list[np.ndarray]:
        """Weights (n, free) of residuals of steps of each length, from those of K r and C r.

        The force of a step with an increment D is K D / 2 + C D / length, that of a length less
        that of its double C D / (2 length). Of steps without loads and with them, if these count
        for damping only, the first tell K and the others C.
        """
        K, C = stiffness, 2 * time * damping
        if len(self._factors) > 1:
            return [-2 * K, 4 * K, C, -C]
        return [C - 2 * K, 4 * K - C] if self.damped else [K]

    def one_step(self, free: int) -> DirectionSteps:
        """A step that remains in the state."""
        unit_array, factor = np.ones(1), np.array([self._factor])
        return DirectionSteps(np.zeros((1, free)), unit_array, factor, np.zeros(1, int), unit_array)

    def along(self, directions: np.ndarray, time: float, curved: bool = False) -> DirectionSteps:
        """Steps along directions (r, free), also of twice the time if they tell damping.

        And both with loads, if these count for damping only.
        """
        points, weights = _SECOND if curved else self._first
        largest = abs(directions / self.unit).max(axis=1)
        most = _OF_SECOND if curved else self._distance_at_most
        distances, model = np.full(len(directions), most), self._linear.model
        if sum(model.points.switch_counts) or model.couplings.sliding:
            columns = directions / largest[:, None] @ self._linear.columns.T
            distances[:] = [self._distance(moved, most) for moved in columns]
        sizes = (distances / largest)[:, None]
        moves = ((sizes * points)[..., None] * directions[:, None]).reshape(-1, directions.shape[1])
        times = [time, 2 * time] if self.damped else [0.0]
        kinds = [(length, factor) for factor in self._factors for length in times]
        lengths, factors = np.repeat(kinds, len(moves), axis=0).T
        rows = np.arange(len(kinds) * len(sizes)).repeat(len(points))
        moves, shares = np.tile(moves, (len(kinds), 1)), weights / sizes ** (1 + curved)
        return DirectionSteps(moves, lengths, factors, rows, np.tile(shares.ravel(), len(kinds)))

    def _distance(self, columns: np.ndarray, most: float) -> float:
        """Distance of steps that move `columns` (n,), within which no contact opens or closes.

        And no node slides off its element, or along a member that it touches to another piece.
        """
        model, start = self._linear.model, self._start
        reduction, points = model.reduction, self._first[0]
        driven = np.zeros(reduction.driven)
        reach = reduction.reach(start.slides, points[-1] * columns)
        distance = max(min(most, 0.9 * reach), _ON_ELEMENT)
        at_start, members = model.kinks.switches(start), model.points.members
        touched = members and members.touched
        reduction.set_start(start.q, start.slides)

        def switched(factor: float) -> bool:
            y = factor * columns[: reduction.free]
            q = start.q + reduction.increment(y, driven)
            slides = start.slides + model.couplings.free_slides(y, len(start.slides))
            passed = (model.forms.compiled_points.switches(q, slides) * at_start < 0).any()
            return bool(passed) or (members and members.touched) != touched

        while distance > _NEAREST and any(map(switched, distance * points)):
            distance /= 2
        return distance

    def spread(self, rows: np.ndarray) -> np.ndarray:
        """Rows (n, free) of the model from rows of the unknowns; other columns are zero."""
        wide = np.zeros((len(rows), self.problem.c.tables.free))
        wide[:, self._linear.unknowns] = rows
        return wide

    def tape(self, steps: DirectionSteps) -> Tape:
        """Steps from the state."""
        state = replace(self._start, t=self._factor)
        tape = static_tape(self.problem, state, [state], self.forcing)
        tape.c.apart = True
        return repeated(tape, self.spread(steps.moves), steps.lengths, steps.factors)


# -- Derivatives of stiffness, damping and mass about an equilibrium by all numbers of its scene


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
    owner: np.ndarray
    #: Factors k, c and m, each one number or (n,).
    stiffness: ArrayLike
    damping: ArrayLike = 0.0
    mass: ArrayLike = 0.0
    times: ArrayLike = 1.0
    #: Forces (size,) times T l, and (n, size) times T r.
    left_forces: np.ndarray | float = 0.0
    right_forces: np.ndarray | float = 0.0
    #: Motion (size,) of the nodes that is added to T r in m l.M r; None for none.
    base: np.ndarray | None = None


class _Terms(NamedTuple):
    """Terms of n sums along directions (d, free), and their times [s].

    Of each the number (n,) of its direction r, and weights (n, free) of K r and C r. Weights
    (n, size) of the mass times motions (n, size). Numbers with weights (n, size) of motions T r.
    """

    directions: np.ndarray
    times: np.ndarray
    owner: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    masses: list[tuple[np.ndarray, np.ndarray]]
    ends: list[tuple[np.ndarray, np.ndarray]]


class TangentDerivatives:
    """The equilibria of linearised scenes, beside which forces are followed backwards or forwards.

    The derivative of d.K d is that of the work d.r of the residual, along d: r is evaluated at
    states beside the equilibrium by the same laws, blocks and Jacobians of elements as of motions.
    """

    def __init__(self, caller: str):
        self._what = caller
        # The last problem of steps, and their derivatives.
        self._problem: ProblemInC | None = None
        self._derivatives: TapeDerivatives
        #: Changes (m, ...) of the numbers by x.
        self.changes: Arrays

    def set_state(
        self, linear: Linearisation, state: Solution | None, damped: bool = False
    ) -> None:
        """Take the tangent about a state, or about the reference."""
        if friction_sticks(linear.model.forms.compiled_points, linear.start.q, linear.start.slides):
            raise SceneError(f"{self._what}: no derivatives: friction that sticks has none")
        end = None if state is None else state.end
        self._factor = 0.0 if state is None or end is None else float(state.t[-1])
        self._inputs = None if end is None else end.inputs
        # Whether the state follows from x by r = 0; where something flows, it follows from all load
        # steps before.
        self._state_follows = state is not None and not linear.model.kinks.flows
        self._linear = linear
        self._steps = TangentSteps(linear, self._factor, damped, self._problem)
        problem = self._steps.problem
        if problem is not self._problem:
            self._derivatives = TapeDerivatives(problem)
        self._problem = problem

    def set_changes(self, changes: Arrays, changing: Set[str]) -> None:
        """Take changes (m, ...) of the numbers by x; those not `changing` are zero."""
        refuse_others(changes, self._derivatives.names, self._what)
        self.changes = changes
        self._changing = {name: rows for name, rows in changes.items() if name in changing}

    def numbers_of(
        self,
        scene: Scene,
        change: np.ndarray | Dual | None = None,
        start: StateChange | None = None,
    ) -> dict[str, MaybeDual]:
        """The numbers of this equilibrium for another scene; OtherStructureError if it differs.

        With those of its state if this has a start, which changes with x.
        """
        scene = with_values(scene, self._inputs)
        model, forcing = self._steps.problem.model, self._steps.forcing
        # Without slopes it may be a scene that all calls share, with other numbers since.
        is_same_scene = scene is model.scene and isinstance(change, Dual)
        data = model.data if is_same_scene else data_of(model, scene)
        numbers = static_numbers_of(model, data, forcing.time, np.array([self._factor]))
        # A step that tells damping also begins in the state.
        if self._steps.damped and data.natural:
            numbers["natural"] = self._factor * data.natural.numbers_at(forcing.time)
        if start is not None and change is not None:
            state_numbers = numbers_of_state(data, start.equilibrium_at(data, change))
            numbers |= {name: state_numbers[name] for name in _OF_STATE & state_numbers.keys()}
        return numbers

    def by_factor(self) -> dict[str, np.ndarray]:
        """Derivatives of the numbers by the load factor, of the names that depend on it."""
        forcing, model, factor = self._steps.forcing, self._steps.forcing.model, self._factor
        rows = static_numbers_of(
            model, model.data, forcing.time, np.array([factor - 1, factor + 1])
        )
        names = {"loads", "driven", "naturals"} & rows.keys()
        numbers = {name: (rows[name][1:] - rows[name][:1]) / 2 for name in names}
        if model.masses.weight is not None:  # the factor multiplies it
            numbers["weight"] = model.masses.weight / factor
        return numbers | {"points": slopes_by_load_factor(model.points)}

    def of_sums(self, pairs: Pairs, weights: np.ndarray) -> np.ndarray:
        """Derivatives (s, m) by x of real parts of weights (s, n) times sums.

        Several are followed forwards, where this can be.
        """
        motions = self.along_motions(pairs)
        if len(weights) > 1 and not self._steps.problem.c.tables.loops.closures:
            return (weights @ self._forwards(motions)).real
        sums = np.zeros((len(weights), len(self.changes["X"])))
        for row, sum_weights in zip(sums, weights, strict=True):
            number_slopes, state_slopes = self.sum_derivatives(motions, sum_weights)
            row += self.by_x(number_slopes)
            if self._state_follows:  # dy/dx = -K^-1 r_x
                (force_weights,) = self._solved(self._linear.K.T, state_slopes[None])
                row -= self.by_x(self.forces(force_weights))
        return sums

    def by_x(self, slopes: Arrays, changes: Arrays | None = None) -> np.ndarray:
        """Derivatives (m,) by x from `slopes` by numbers and `changes` (m, ...) of the numbers."""
        changes, none = changes or self._changing, np.zeros(len(self.changes["X"]))
        pairs = ((changes[name], slopes[name]) for name in sorted(slopes) if name in changes)
        return sum((linear_change(*pair) for pair in pairs), none)

    def along_motions(self, pairs: Pairs) -> _Terms:
        """The motions r of pairs as directions; also l, if motions of nodes depend on the state."""
        linear, right, left = self._linear, pairs.right, pairs.left
        k, c, m = (np.reshape(x, (-1, 1)) for x in (pairs.stiffness, pairs.damping, pairs.mass))
        T, mass_of = linear.T, linear.model.masses.matrix
        moved, directions, motion = _times(T, left), right, _times(T, right)[pairs.owner]
        masses, turns = [(m * moved, motion)], list[tuple[csr_matrix, np.ndarray]]()
        if linear.frame is not None:  # Coriolis forces are the mass times these
            turn = 2 * np.sqrt(self._factor) * linear.frame.spin * linear.frame.quarter_turn
            masses.append((c * moved, _times(turn, motion)))
            turns.append((turn, c))
        if pairs.base is not None:
            masses.append((m * moved, np.broadcast_to(pairs.base, motion.shape)))
        times = np.broadcast_to(pairs.times, len(right))
        ends = list[tuple[np.ndarray, np.ndarray]]()
        if self._derivatives.places_depend:
            node_forces = _times(mass_of, moved)
            moving = sum((factor * _times(turn, motion) for turn, factor in turns), m * motion)
            turned = (factor * _times(turn.T, node_forces) for turn, factor in turns)
            left_numbers = len(right) + np.arange(len(left))
            ends.append((pairs.owner, sum(turned, pairs.right_forces + m * node_forces)))
            ends.append((left_numbers, _times(mass_of, moving) + pairs.left_forces))
            directions, times = np.vstack([right, left]), np.append(times, times[pairs.owner])
        return _Terms(directions, times, pairs.owner, k * left, c * left, masses, ends)

    def sum_derivatives(
        self, terms: _Terms, weights: np.ndarray, curved: bool = False
    ) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Derivatives by numbers, and by the state, of the real part of weights (n,) times sums.

        If `curved`, with the second derivatives of forces along the direction r in place of K r.
        """
        numbers = [k[weights != 0] for k in (terms.owner, *(k for k, _ in terms.ends))]
        used = np.unique(np.concatenate(numbers[: 1 if curved else None]))
        basis, factors = _basis(terms.directions[used], self._steps.unit)
        parts = np.zeros((len(terms.directions), len(basis)), complex)
        parts[used] = factors ** (1 + curved)
        time = self._steps.slow * _mean(terms.times[used])

        def weighted(indices: np.ndarray, values: np.ndarray) -> np.ndarray:
            """Weights (r, ...) along the basis."""
            return ((weights[:, None] * parts[indices]).T @ values).real

        length_weights = self._steps.of_lengths(terms.stiffness, terms.damping, time)
        force_weights = np.vstack([weighted(terms.owner, values) for values in length_weights])
        end_weights = np.zeros((len(force_weights), len(self._linear.start.q)))
        end_weights[: len(basis)] = sum(weighted(*end) for end in terms.ends)
        steps = self._steps.along(basis, time, curved)
        number_slopes, state_slopes = self._backwards(steps, force_weights, end_weights)
        if "mass" in number_slopes:
            model, chosen = self._steps.problem.model, np.flatnonzero(weights)
            most = max(1, int(_MEMORY / (16 * max(1, model.masses.matrix.nnz))))
            for n in (chosen[k : k + most] for k in range(0, len(chosen), most)):
                pairs = ((mass_weights[n], motions[n]) for mass_weights, motions in terms.masses)
                derivatives = sum(by_mass_entries(model, *pair) for pair in pairs)
                number_slopes["mass"] = number_slopes["mass"] + (weights[n] @ derivatives).real
        return number_slopes, state_slopes

    def _forwards(self, terms: _Terms) -> np.ndarray:
        """Derivatives (n, m) of sums by changes of K, C, M and T along a basis."""
        changes, sums = self.changes, np.zeros((len(terms.owner), len(self.changes["X"])), complex)
        basis, parts = _basis(terms.directions, self._steps.unit)
        time = self._steps.slow * _mean(terms.times)
        state_changes = None
        if self._state_follows:
            held = np.zeros((sums.shape[1], len(self._linear.unknowns)))
            force_changes, _ = self._pushed(self._steps.one_step(held.shape[1]), held)
            state_changes = -self._solved(self._linear.K, force_changes[0])
        force_weights = self._steps.of_lengths(terms.stiffness, terms.damping, time)

        def add(rows: np.ndarray, k: np.ndarray, weights: np.ndarray) -> None:
            """Add weights (n, size) times rows (r, m, size) along some of the basis."""
            columns = np.ascontiguousarray(weights.T, complex).view(float)
            products = (rows.reshape(-1, len(columns)) @ columns).view(complex)
            products = products.reshape(*rows.shape[:2], -1)
            sums[:] += np.einsum("nr,rmn->nm", parts[k][:, group], products)

        if "mass" in self._changing:
            masses = changes["mass"].reshape(sums.shape[1], -1)
            mass = self._steps.problem.model.masses.matrix
            for i in np.flatnonzero(masses.any(axis=1)):
                changed = csr_matrix((masses[i], mass.indices, mass.indptr))
                for mass_weights, motions in terms.masses:
                    sums[:, i] += (mass_weights * _times(changed, motions)).sum(axis=1)
        size = 8 * len(force_weights) * basis.shape[1] * sums.shape[1]
        most = max(1, int(_MEMORY / size))
        for group in (slice(k, k + most) for k in range(0, len(basis), most)):
            forces, ends = self._pushed(self._steps.along(basis[group], time), state_changes)
            for rows, w in zip(np.split(forces, len(force_weights)), force_weights, strict=True):
                add(rows, terms.owner, w)
            for k, w in terms.ends:
                add(ends[: len(basis[group])], k, w)
        return sums

    def forces(self, weights: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives of weights (free,) times the residual by numbers in the state."""
        step, none = self._steps.one_step(len(weights)), 0 * self._linear.start.q[None]
        return self._backwards(step, weights[None], none)[0]

    def _pushed(
        self, steps: DirectionSteps, state_changes: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Changes (rows, m, ...) of residuals and ends of steps, with all numbers and the state."""
        tape = self._steps.tape(steps)
        return self._derivatives.jvp_of_equations(
            tape, self.changes, state_changes, steps.rows, steps.shares
        )

    def _backwards(
        self, steps: DirectionSteps, weights: np.ndarray, end_weights: np.ndarray
    ) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Derivatives of weighted residuals and ends of steps, by numbers and by the state.

        Those by numbers hold the state, if this follows from other numbers.
        """
        unknowns, tape = self._linear.unknowns, self._steps.tape(steps)
        spread = self._steps.spread(weights)
        chosen, names = unknowns[: 0 if self._state_follows else None], self._changing.keys()
        number_slopes, unknown_slopes = self._derivatives.vjp_of_equations(
            tape, steps.rows, steps.shares, spread, end_weights, chosen, names
        )
        return number_slopes, unknown_slopes[unknowns]

    def _solved(self, K: csr_matrix, right_sides: np.ndarray) -> np.ndarray:
        """Solutions (n, free) of the tangent K, or of its transpose, for right sides."""
        try:
            weights = pivoted_lu(K).solve(right_sides.T)
        except RuntimeError:
            weights = np.full(right_sides.T.shape, np.nan)
        left = abs(K @ weights - right_sides.T).max(axis=0)
        if not (left <= _SOLVED * abs(right_sides).max(axis=1)).all():
            raise SceneError(
                f"{self._what}: no derivatives: the tangent of the state is singular, so that it "
                "does not follow from the numbers. Support the scene, or take a state beside a "
                "critical point"
            )
        return weights.T


def _basis(directions: np.ndarray, unit: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Real R (r, n) and complex factors F (k, r) with F R = `directions` (k, n).

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


def _times(matrix: csr_matrix, vectors: np.ndarray) -> np.ndarray:
    """A matrix times vectors (n, columns)."""
    return np.ascontiguousarray((matrix @ vectors.T).T)


def _mean(times: np.ndarray) -> float:
    """Geometric mean of times (n,) [s]."""
    return float(np.exp(np.log(times).mean()))


# -- Small motions about the reference or a static state, of scenes of parameters ---------------


class TangentAnalysis:
    """Stiffness, damping and mass about equilibria of scenes of parameters, for a `caller`.

    Messages of calls name the `analysis`. Damping counts if `damped`.
    """

    def __init__(
        self,
        parameters: Parametrised,
        caller: str,
        analysis: str,
        state: Callable[[Scene], Solution] | None,
        damped: bool,
    ):
        if state is not None:
            check_takes(state, "scene", f"{caller}: state")
        self.parameters, self._caller, self._analysis = parameters, caller, analysis
        self._state, self._damped = state, damped
        #: The linearised scene of the last call.
        self.linear: Linearisation
        self._models: dict[str, Model] = {}
        self._tangent = TangentDerivatives(caller)
        self._changes: dict[str, np.ndarray] | None = None

    def run(
        self, x: np.ndarray, take: Callable[[Linearisation], None] = lambda linear: None
    ) -> Linearisation:
        """Linearise about the equilibrium of the scene of parameters; `take` gets it first."""

        def linearise(x: np.ndarray | Dual) -> Linearisation:
            take(linear := self._linearised(x))
            return linear

        self._changes = None
        self.linear = self.parameters.scenes.serve(x, linearise, self._state is None)
        return self.linear

    def _linearised(self, x: np.ndarray | Dual) -> Linearisation:
        scene = self.parameters.build_and_keep(x)
        self._end = self._state and self._state(scene)
        self._path = path_of(self._end, scene)
        is_static = self._state is None or self._path is not None
        expected = "a solution of fx_beam.static(scene)"
        require(is_static, f"{self._caller}: state(scene)", self._end, expected)
        linear = linearised(scene, self._end, self._analysis, self._models)
        scheme, unknowns = linear.model.scheme, len(linear.unknowns)
        self.parameters.stats = Stats(scheme.name, scheme.rates.level, "", unknowns, static=True)
        if self._damped and linear.may_be_damped:
            _ = linear.damped_model  # which has the slopes of the scene as well
        return linear

    def changes(self) -> dict[str, np.ndarray]:
        """Derivatives (m, ...) by x of all numbers of the last call."""
        if self._changes is None:
            self._tangent.set_state(self.linear, self._end, self._damped)
            start: StateChange | None = None
            derivatives = self.parameters.derivatives
            if self._path is not None and self.linear.model.kinks.flows:
                start = StaticDerivatives(self._path).change_of_end(derivatives, self._caller)
            self._changes = derivatives(functools.partial(self._tangent.numbers_of, start=start))
        return self._changes

    def of_sums(self, pairs: Pairs, weights: np.ndarray) -> np.ndarray:
        """Derivatives (s, m) of real parts of weights (s, n) times sums; `changes` comes before."""
        assert self._changes is not None
        self._tangent.set_changes(self._changes, self.parameters.scenes.changing)
        return self._tangent.of_sums(pairs, weights)
