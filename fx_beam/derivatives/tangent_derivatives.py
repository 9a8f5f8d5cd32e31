"""Derivatives of stiffness, damping and mass about an equilibrium by all numbers of its scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy.linalg
import scipy.sparse

from fx_beam.errors import SceneError
from fx_beam.linear.linearisation import Linearisation
from fx_beam.motions.numbers import numbers_of_state, static_numbers_of
from fx_beam.results.solution import Solution
from fx_beam.scene.inputs import with_values
from fx_beam.scene.joints import slides_at_start
from fx_beam.scene.scene import Scene
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.sparse_lu import pivoted_lu
from fx_beam.step.tables import Problem
from fx_beam.step.tape import Tape, static_tape
from fx_beam.step.tape_derivatives import TapeDerivatives

from .built_scenes import refuse_others
from .static_derivatives import OtherScenes, StateChange

# Differences of order six along a direction, and second ones: points, and weights over the distance
# or its square. The distance is relative to a motion of the size of the scene, or of a radian.
_FIRST = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60
_SECOND = np.arange(-3, 4), np.array([2, -27, 270, -490, 270, -27, 2]) / 180
_DISTANCE = 4e-3
# It is halved down to this one where a contact opens or closes on the way.
_NEAREST = 1e-8
# Numbers of a state that follow from the load steps before, where something flows.
_OF_STATE = {"q", "slides", "internal", "spring internal"}
# What is left of a direction of length 1 that is a sum of others.
_ALIKE = 1e-11
# Forces that remain of a system that is solved, relative to its right side.
_SOLVED = 1e-6
# Numbers that are followed forwards at once, and memory [bytes] of what is found in steps.
_GROUP, _MEMORY = 4, 1e8


class Product(NamedTuple):
    """Real parts (n,) of sums of k l.K r + c l.C r + m l.M r over motions r, each with n motions l.

    And of forces times the motions T l and T r of the nodes. All may be complex. The steps that
    tell damping have `times` [s] like those of the vibrations.
    """

    #: Motions r (p, free), and l (p, n, free); None for r itself.
    right: np.ndarray
    left: Any
    #: Factors k, c and m, each one number or (p,).
    stiffness: Any
    damping: Any = 0.0
    mass: Any = 0.0
    times: Any = 1.0
    #: Forces (size,) times T l, and (p, n, size) times T r.
    on_left: Any = 0.0
    on_right: Any = 0.0


class Weighted(NamedTuple):
    """Derivatives of n sums by the vector of `Layout`, the numbers of a step, and the mass."""

    by_vector: np.ndarray
    of_step: np.ndarray
    by_mass: np.ndarray

    def __add__(self, other: Any) -> Weighted:
        return Weighted(*(one + more for one, more in zip(self, other, strict=True)))


class _Along(NamedTuple):
    """Directions (d, free), and weights (d, n, ...) of forces and of motions of the nodes."""

    directions: np.ndarray
    stiffness: np.ndarray
    damping: np.ndarray
    ends: np.ndarray

    def weights(self, parts: np.ndarray) -> list[np.ndarray]:
        """Weights (n, r, ...) along r directions, of which these are parts (d, r)."""
        return [np.einsum("dr,dni->nri", parts, by).real for by in self[1:]]


class _Directions(NamedTuple):
    """Those of a sum, its derivatives by the mass (n, entries), and a time [s] like those of it."""

    along: list[_Along]
    by_mass: np.ndarray
    time: float


class _Steps(NamedTuple):
    """Steps from the state: increments (k, free), lengths (k,), weights of n sums.

    Those (n, k, ...) of residuals and of ends.
    """

    moves: np.ndarray
    lengths: np.ndarray
    of_equations: np.ndarray
    of_ends: np.ndarray


class TangentDerivatives:
    """The equilibria of linearised scenes, whose forces are followed backwards beside them.

    The derivative of d.K d is that of the work d.r of the residual, along d: r is evaluated at
    states beside the equilibrium by the same laws, blocks and Jacobians of elements as of motions.
    """

    def __init__(self, what: str):
        self._what = what
        # The problem of the steps, their derivatives, and other scenes with their numbers.
        self._problem: Any = None
        self._derivatives: TapeDerivatives
        self._others: OtherScenes
        self._slides = list[float]()

    def begin(self, about: Linearisation, state: Solution | None, damped: bool = False) -> None:
        """Take the tangent about a state, or about the reference."""
        if about.model.points.any_have("sticks"):
            raise SceneError(f"{self._what}: no derivatives: friction that sticks has none")
        # Where something flows, the state follows from all load steps before.
        flows, self._start = about.model.flows, about.start
        self._follows = state is not None and not flows
        # Steps that tell damping hold what flows, too.
        self._damped = damped or flows
        self._factor, self._inputs = 0.0, None
        if state is not None and state.end is not None:
            self._factor, self._inputs = float(state.t[-1]), state.end.inputs
        model = about.damped_model if self._damped else about.model
        problem = Problem.of(model, NewtonOptions(), about.frame is not None)
        problem.hand_over_frame(about.frame)
        slides = slides_at_start(model.scene).tolist()
        if problem is not self._problem or slides != self._slides:
            self._derivatives, self._slides = TapeDerivatives(problem), slides
            kind = {"instant" if self._damped else "mobile": True}
            self._others = OtherScenes(model.scene, model.scheme, **kind)
        self._problem, p = problem, problem.c
        # Whether motions of the nodes for those of the unknowns depend on the state.
        self._couples = p.entries > p.equal or p.closures or p.sliders
        p.at_rest = 1  # forces that depend on rates, without inertia
        self._forcing = LoadForcing(model, about.start.t)
        self._unknowns = about.unknowns

    def numbers_of(
        self, scene: Scene, moved: tuple[StateChange, Any] | None = None
    ) -> dict[str, np.ndarray]:
        """The numbers of this equilibrium for another scene; OtherStructureError if it differs.

        With those of its state if this has `moved`, by a change of x.
        """
        model = self._others.model_of(with_values(scene, self._inputs))
        forcing = LoadForcing(model, self._forcing.time)
        numbers = static_numbers_of(model, forcing, np.array([self._factor]))
        if self._damped and model.natural:  # a step that tells damping also begins in the state
            columns, factors = model.natural.unit_loads, numbers["naturals"][0]
            of = np.repeat(np.arange(columns.shape[1]), np.diff(columns.indptr))
            values = numbers["natural columns"] * factors[of]
            numbers["natural"] = np.bincount(columns.indices, values, model.natural.size)
        if moved is not None:
            start, by = moved
            of_state = numbers_of_state(model, start.at(model, by))
            numbers |= {name: of_state[name] for name in _OF_STATE & of_state.keys()}
        return numbers

    def by_factor(self) -> dict[str, np.ndarray]:
        """Derivatives of the numbers by the load factor, of the names that depend on it."""
        forcing, factor = self._forcing, self._factor
        model = forcing.model
        rows = static_numbers_of(model, forcing, np.array([factor - 1, factor + 1]))
        names = {"loads", "driven", "naturals"} & rows.keys()
        numbers = {name: (rows[name][1:] - rows[name][:1]) / 2 for name in names}
        if model.weight is not None:  # the factor multiplies it
            numbers["weight"] = model.weight / factor
        return numbers | {"points": model.points.by_load_factor}

    def of_sums(
        self,
        about: Linearisation,
        sums: Sequence[Product],
        changes: Mapping[str, np.ndarray],
    ) -> np.ndarray:
        """Derivatives (n, m) of sums by x, with which numbers change (m, ...).

        Forwards if the sums are so many that these are fewer steps.
        """
        products = [self.directions(about, of) for of in sums]
        if len(sums) > 1 and not self._problem.c.closures:
            every = [one.directions for along, _, _ in products for one in along]
            unit = about.model.unit_of_unknowns
            basis, parts = _basis(np.concatenate(every) / unit)
            steps = sum(len(by_mass) * len(along[0].directions) for along, by_mass, _ in products)
            if steps > len(basis) * np.ceil(len(changes["X"]) / _GROUP):
                return self._forwards(about, products, changes, basis * unit, parts)
        weighted, by_state = self.products(about, products)
        if self._follows:
            weighted += self.forces(-self._solved(about.K.T, by_state))
        else:
            unknowns = self._derivatives.layout.at["Y"][self._unknowns]
            weighted.by_vector[:, unknowns] = by_state
        return self.along(weighted, changes)

    def products(
        self, about: Linearisation, products: Sequence[_Directions], curved: bool = False
    ) -> tuple[Weighted, np.ndarray]:
        """Derivatives of sums by numbers in a fixed state, and by the state (., free).

        The n rows of each sum after those of the one before. If `curved` those of the second
        derivatives of the sums along the directions r, twice.
        """
        steps = [
            _joined([self._steps(about, one, time, curved) for one in along])
            for along, _, time in products
        ]
        by_vector, of_step, by_state = self._followed(steps)
        by_mass = np.concatenate([of_mass for _, of_mass, _ in products])
        return Weighted(by_vector, of_step, by_mass), by_state

    def _forwards(
        self,
        about: Linearisation,
        products: Sequence[_Directions],
        changes: Mapping[str, np.ndarray],
        basis: np.ndarray,
        parts: np.ndarray,
    ) -> np.ndarray:
        """Derivatives (n, m) by changes of K, C and T along a basis (r, free), with all numbers."""
        refuse_others(changes, self._derivatives.names, self._what)
        time = float(np.exp(np.mean([np.log(time) for _, _, time in products])))
        lengths, by_state = np.array([time, 2 * time] if self._damped else [0.0]), None
        count, free = len(changes["X"]), basis.shape[1]
        if self._follows:
            tape = self._tape()
            tape.repeat(np.zeros((1, free)), np.ones(1))
            held = np.zeros((count, free))
            changed = self._derivatives.jvp_of_equations(tape, changes, held)
            by_state = -self._solved(about.K, changed["equations"][0])
        moves, sizes = self._moves(about, basis, _FIRST[0])
        most = max(1, int(_MEMORY / (8 * len(lengths) * moves[0].size * count)))
        of_basis = list[list[np.ndarray]]()
        for some in (slice(k, k + most) for k in range(0, len(basis), most)):
            tape, steps = self._tape(), moves[some].reshape(-1, free)
            tape.repeat(np.tile(steps, (len(lengths), 1)), lengths.repeat(len(steps)))
            changed = self._derivatives.jvp_of_equations(tape, changes, by_state)
            shape = len(lengths), len(moves[some]), moves.shape[1], count, -1
            rows = (changed[name].reshape(shape) for name in ("equations", "q"))
            weights = _FIRST[1] / sizes[some]
            forces, ends = (np.einsum("dp,ldpmi->lmdi", weights, of) for of in rows)
            K, C = forces[0], 0 * forces[0]
            if self._damped:  # as of `_steps`
                K, C = 4 * forces[1] - 2 * forces[0], 2 * time * (forces[0] - forces[1])
            of_basis.append([K, C, ends[0]])
        slopes = [np.hstack(of).reshape(count, -1) for of in zip(*of_basis, strict=True)]
        masses, of_sums = changes["mass"].reshape(count, -1), list[np.ndarray]()
        for along, by_mass, _ in products:
            of_sums.append(by_mass @ masses.T)
            for one in along:
                its_parts, parts = np.split(parts, [len(one.directions)])
                for by, of in zip(one.weights(its_parts), slopes, strict=True):
                    of_sums[-1] += by.reshape(len(by), -1) @ of.T
        return np.concatenate(of_sums)

    def directions(self, about: Linearisation, of: Product) -> _Directions:
        """Directions r, and those l on which motions of the nodes depend."""
        mass, right = about.model.mass, of.right[:, None]
        left = right if of.left is None else of.left
        k, c, m = (np.reshape(by, (-1, 1, 1)) for by in (of.stiffness, of.damping, of.mass))
        moved, motion = _times(about.T, left), _times(about.T, right)
        of_nodes = _times(mass, moved)
        by, on_right = m * motion, m * of_nodes + of.on_right
        if about.frame is not None:  # Coriolis forces are the mass times these
            turn = 2 * np.sqrt(self._factor) * about.frame.spin * about.frame.quarter_turn
            by, on_right = by + c * _times(turn, motion), on_right + c * _times(turn.T, of_nodes)
        rows = np.repeat(np.arange(mass.shape[0]), np.diff(mass.indptr))
        by_mass = (moved[..., rows] * by[..., mass.indices]).real.sum(axis=0)
        on_left = _times(mass, by) + of.on_left
        if of.left is None:
            on_right = on_right + on_left
        along = [_Along(of.right, k * left, c * left, on_right)]
        if of.left is not None and self._couples:
            count, free = left.shape[1:]
            ends = (np.eye(count)[..., None] * on_left[:, None]).reshape(-1, count, mass.shape[0])
            none = np.zeros((len(ends), count, free))
            along.append(_Along(left.reshape(-1, free), none, none, ends))
        return _Directions(along, by_mass, float(np.exp(np.mean(np.log(of.times)))))

    def forces(self, weights: np.ndarray) -> Weighted:
        """Derivatives of weights (n, free) times the residual by numbers in the state."""
        none = np.zeros((len(weights), 1, len(self._start.q)))
        steps = _Steps(0 * weights[:1], np.ones(1), weights[:, None], none)
        by_vector, of_step, _ = self._followed([steps])
        return Weighted(by_vector, of_step, np.zeros((1, 1)))

    def along(self, weighted: Weighted, changes: Mapping[str, np.ndarray]) -> np.ndarray:
        """Derivatives (n, m) by x, with which numbers change (m, ...), of what is weighted."""
        refuse_others(changes, self._derivatives.names, self._what)
        by_vector, of_step, by_mass = weighted
        masses = changes["mass"].reshape(len(changes["mass"]), -1)
        by_x = self._derivatives.along(changes, by_vector, of_step)
        return by_x + (by_mass @ masses.T if by_mass.any() else 0.0)

    def _steps(self, about: Linearisation, along: _Along, time: float, curved: bool) -> _Steps:
        """Steps along directions, and the sums of their weights."""
        unit = about.model.unit_of_unknowns[about.unknowns]
        points, weights = _SECOND if curved else _FIRST
        basis, parts = _basis(along.directions / unit)
        if curved:  # which is not linear in the directions
            basis, parts = along.directions.real / unit, np.eye(len(along.directions))
        moves, sizes = self._moves(about, basis * unit, points)
        moves = moves.reshape(-1, len(unit))
        of = (weights / sizes ** (1 + curved))[..., None]
        every = (of * by[:, :, None] for by in along.weights(parts))
        k, c, e = (by.reshape(len(by), len(moves), -1) for by in every)
        if not self._damped:
            return _Steps(moves, np.zeros(len(moves)), k, e)
        # The force of a step with an increment D is K D / 2 + C D / length, that of a length
        # less that of its double C D / (2 length).
        lengths = np.full(len(moves), time)
        short = _Steps(moves, lengths, 2 * time * c - 2 * k, e)
        return _joined([short, _Steps(moves, 2 * lengths, 4 * k - 2 * time * c, 0 * e)])

    def _moves(
        self, about: Linearisation, directions: np.ndarray, points: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Increments (d, k, free) at points along directions, whose unit has the sizes (d, 1)."""
        largest = abs(directions / about.model.unit_of_unknowns[about.unknowns]).max(axis=1)
        distances = [self._distance(about, of) for of in directions / largest[:, None]]
        sizes = (distances / largest)[:, None]
        return (sizes * points)[..., None] * directions[:, None], sizes

    def _distance(self, about: Linearisation, direction: np.ndarray) -> float:
        """Distance of steps along a direction (free,), within which no contact opens or closes."""
        model, start, distance = about.model, about.start, _DISTANCE
        if not model.points.conditions:
            return distance
        move = _FIRST[0][-1] * direction
        slides = model.couplings.free_slides(about.columns @ move, len(start.slides))
        nodes, at_start = about.T @ move, model.switches(start)

        def switches(by: float) -> bool:
            there = model.points.switches(start.q + by * nodes, start.slides + by * slides)
            return bool((there * at_start < 0).any())

        while distance > _NEAREST and (switches(distance) or switches(-distance)):
            distance /= 2
        return distance

    def _followed(self, steps: list[_Steps]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Derivatives of all sums by the vector of `Layout`, numbers of the step, and the state.

        The first ones in a fixed state.
        """
        tape = self._tape()
        rows = [
            (of.moves, of.lengths, *weights)
            for of in steps
            for weights in zip(of.of_equations, of.of_ends, strict=True)
        ]
        moves, lengths, of_equations, of_ends = map(np.concatenate, zip(*rows, strict=True))
        unknowns, free = self._unknowns, self._problem.c.free
        if len(unknowns) < free:  # others follow them
            moves, of_equations = (_spread(of, unknowns, free) for of in (moves, of_equations))
        tape.repeat(moves, lengths)
        counts = [len(row[0]) for row in rows]
        ends = np.cumsum(counts)
        x, of_steps, by_unknowns = self._derivatives.vjp_of_equations(
            tape, ends.tolist(), of_equations, of_ends
        )
        first = ends - counts
        x[:, self._derivatives.layout.at["Y"]] = 0.0
        by_state = np.add.reduceat(by_unknowns, first)[:, unknowns]
        return x, np.add.reduceat(of_steps, first), by_state

    def _tape(self) -> Tape:
        """The state as a step from itself."""
        state = replace(self._start, t=self._factor)
        tape = static_tape(self._problem, state, [state], self._forcing)
        tape.c.apart = True
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


def _joined(steps: Sequence[_Steps]) -> _Steps:
    """The steps of some one after the other, with the same sums."""
    moves, lengths, *weights = zip(*steps, strict=True)
    return _Steps(np.concatenate(moves), np.concatenate(lengths), *map(np.hstack, weights))


def _basis(directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Real directions (r, n), and complex factors (k, r), whose products are those given (k, n).

    Motions at near frequencies are much alike: r is less than k.
    """
    sizes = np.linalg.norm(directions, axis=1)[:, None]
    rows = directions / np.where(sizes > 0, sizes, 1.0)
    rows = np.vstack([rows.real, rows.imag])
    if len(directions) == 1:
        there = rows.any(axis=1)
        return rows[there], sizes * np.array([[1.0, 1j]])[:, there]
    q, factors, order = scipy.linalg.qr(rows.T, mode="economic", pivoting=True)
    count = int((abs(np.diagonal(factors)) > _ALIKE).sum())
    parts = np.empty((len(rows), count))
    parts[order] = factors[:count].T
    real, imaginary = np.split(parts, 2)
    return q[:, :count].T, sizes * (real + 1j * imaginary)


def _times(matrix: scipy.sparse.csr_matrix, vectors: np.ndarray) -> np.ndarray:
    """A matrix times vectors (p, n, columns)."""
    rows = vectors.reshape(-1, vectors.shape[-1])
    return (matrix @ rows.T).T.reshape(*vectors.shape[:2], -1)


def _spread(rows: np.ndarray, columns: np.ndarray, count: int) -> np.ndarray:
    """Rows (n, count) with some columns, and zeros in the others."""
    wide = np.zeros((len(rows), count))
    wide[:, columns] = rows
    return wide
