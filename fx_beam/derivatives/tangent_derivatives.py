"""Derivatives of stiffness, damping and mass about an equilibrium by all numbers of its scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.laws.schemes import EnergyMomentum, Equilibrium
from fx_beam.linear.linearisation import Linearisation
from fx_beam.motions.numbers import static_numbers_of
from fx_beam.results.solution import Solution
from fx_beam.scene.inputs import with_values
from fx_beam.scene.joints import slides_at_start
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError, Structure
from fx_beam.step.adjoint import Adjoint
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.forward import Forward
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.sparse_lu import pivoted_lu
from fx_beam.step.static_tape import static_tape
from fx_beam.step.tables import Problem

from .built_scenes import refuse_others

# A difference of order six along a direction: points, and weights over the distance. The distance
# is relative to a motion of the size of the scene, or of a radian.
_POINTS, _WEIGHTS = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60
_DISTANCE = 4e-3
# Forces that remain of a system that is solved, relative to its right side.
_SOLVED = 1e-6


class Square(NamedTuple):
    """stiffness * d.K d + damping * d.C d + mass * d.M d, with a direction d (free,).

    The steps that tell damping have a `time` [s] like that of the vibration.
    """

    direction: np.ndarray
    stiffness: float
    damping: float
    mass: float
    time: float

    def along(self, direction: np.ndarray, sign: int = 1) -> Square:
        """The same along another direction, or its negative."""
        of = (sign * self.stiffness, sign * self.damping, sign * self.mass)
        return Square(direction, *of, self.time)


class _Steps(NamedTuple):
    """Steps from the state: increments (n, free), weights of residuals and of ends, lengths [s]."""

    moves: np.ndarray
    of_equations: np.ndarray
    of_ends: np.ndarray
    lengths: np.ndarray


class TangentDerivatives:
    """The equilibria of linearised scenes, whose forces are followed backwards beside them.

    The derivative of d.K d is that of the work d.r of the residual, along d: r is evaluated at
    states beside the equilibrium by the same laws, blocks and Jacobians of elements as of motions.
    """

    def __init__(self, damped: bool):
        self._damped = damped
        # The model of the steps with its problem and adjoint, and that of other scenes' numbers.
        self._model: Model | None = None
        self._problem: Problem
        self._adjoint: Adjoint
        self._slides = list[float]()
        self._other: Model | None = None

    def begin(self, about: Linearisation, state: Solution | None) -> None:
        """Take the tangent about a state, or about the reference."""
        if reason := _why_not(about):
            raise SceneError(f"ModalResponse: no derivatives: {reason}")
        self._start, self._follows = about.start, state is not None
        self._factor, self._inputs = 0.0, None
        if state is not None and state.end is not None:
            self._factor, self._inputs = float(state.t[-1]), state.end.inputs
        last = self._model
        self._model = model = self._refilled(last, about.scene) if self._damped else about.model
        slides = slides_at_start(model.scene).tolist()
        if model is last:
            self._problem.refill()
        else:
            self._problem = Problem(model, NewtonOptions())
        if model is not last or slides != self._slides:
            self._adjoint, self._slides = Adjoint(self._problem), slides
        self._problem.c.at_rest = 1  # forces that depend on rates, without inertia
        self._forcing = LoadForcing(model, about.start.t)
        self._structure = Structure(about.scene)

    def _refilled(self, model: Model | None, scene: Scene) -> Model:
        """The model of the tangent, or that of steps which tell damping, for another scene."""
        scene = with_values(scene, self._inputs)
        try:
            if model is not None:
                model.refill(scene)
                return model
        except OtherStructureError:
            pass
        if self._damped:
            return Model(scene, EnergyMomentum(), instant=True)
        return Model(scene, Equilibrium(), mobile=True)

    def numbers_of(self, scene: Scene) -> dict[str, np.ndarray]:
        """The numbers of this equilibrium for another scene; OtherStructureError if it differs."""
        self._structure.check(scene)
        self._other = self._refilled(self._other, scene)
        forcing = LoadForcing(self._other, self._forcing.time)
        return static_numbers_of(self._other, forcing, np.array([self._factor]))

    def of_sums(
        self,
        about: Linearisation,
        sums: Sequence[Sequence[Square]],
        changes: Mapping[str, np.ndarray],
    ) -> np.ndarray:
        """Derivatives (n, m) of sums of squares by x, with which numbers change (m, ...)."""
        forward, of = Forward(self._adjoint), self._adjoint.layout.of
        refuse_others(changes, forward.names, "ModalResponse")
        mass = about.model.mass
        rows = np.repeat(np.arange(mass.shape[0]), np.diff(mass.indptr))
        by_mass, steps, ends = np.zeros((len(sums), mass.nnz)), list[_Steps](), list[int]()
        for of_sum, squares in zip(by_mass, sums, strict=True):
            for square in squares:
                full = about.T @ square.direction
                of_sum += square.mass * full[rows] * full[mass.indices]
                steps += self._steps(about, square, mass @ full)
            ends.append(sum(len(part.lengths) for part in steps))
        joined = _Steps(*map(np.concatenate, zip(*steps, strict=True)))
        x, of_step, by_state = self._followed(joined, ends)
        free = slice(of["Y"].start, of["Y"].start + by_state.shape[1])
        if self._follows:
            weights, none = -_solved(about, by_state), np.zeros((len(sums), len(about.start.q)))
            single = _Steps(0 * weights, weights, none, np.ones(len(sums)))
            by_forces, of_forces, _ = self._followed(single, [*range(1, len(sums) + 1)])
            x, of_step = x + by_forces, of_step + of_forces
        x[:, free] = 0.0 if self._follows else by_state
        masses = changes["mass"].reshape(len(changes["mass"]), -1)
        return forward.along(changes, x, of_step) + by_mass @ masses.T

    def _steps(self, about: Linearisation, square: Square, momentum: np.ndarray) -> list[_Steps]:
        """Steps along the direction d, with M d of the nodes (size,)."""
        d, stiffness, damping, of_mass, time = square
        size = _DISTANCE / abs(d / about.model.unit_of_unknowns[about.unknowns]).max()
        moves, weights = size * _POINTS[:, None] * d, _WEIGHTS[:, None] / size
        of_ends, lengths = 2 * of_mass * weights * momentum, np.ones(len(moves))
        if not self._damped:
            return [_Steps(moves, stiffness * weights * d, of_ends, 0 * lengths)]
        # The force of a step with an increment D is K D / 2 + C D / length, that of a length
        # less that of its double C D / (2 length).
        short, long = 2 * time * damping - 2 * stiffness, 4 * stiffness - 2 * time * damping
        return [
            _Steps(moves, short * weights * d, of_ends, time * lengths),
            _Steps(moves, long * weights * d, 0 * of_ends, 2 * time * lengths),
        ]

    def _followed(self, steps: _Steps, ends: list[int]) -> tuple[np.ndarray, ...]:
        """Derivatives of sums by the vector of `Layout`, numbers of the step, and the state."""
        state = replace(self._start, t=self._factor)
        tape = static_tape(self._problem, state, [state], self._forcing)
        tape.repeat(steps.moves, steps.lengths)
        weights = steps.of_equations, steps.of_ends
        x, of_steps, by_unknowns = self._adjoint.vjp_of_equations(tape, ends, *weights)
        first = [0, *ends[:-1]]
        return x, np.add.reduceat(of_steps, first), np.add.reduceat(by_unknowns, first)


def _solved(about: Linearisation, by_state: np.ndarray) -> np.ndarray:
    """Weights (n, free) of forces whose derivatives by the state are these."""
    K = about.K.T
    try:
        weights = pivoted_lu(K).solve(by_state.T)
    except RuntimeError:
        weights = np.full(by_state.T.shape, np.nan)
    left = abs(K @ weights - by_state.T).max(axis=0)
    if not (left <= _SOLVED * abs(by_state).max(axis=1)).all():
        raise SceneError(
            "ModalResponse: no derivatives: the tangent of the state is singular, so that it "
            "does not follow from the numbers. Support the scene, or take a state beside a "
            "critical point"
        )
    return weights.T


def _why_not(about: Linearisation) -> str:
    """Why there are none; empty if there are."""
    model = about.model
    if about.coriolis is not None:
        return "a frame that turns (spin) has none"
    if len(about.unknowns) != model.reduction.free:
        return "scenes with closed loops have none. Close them by stiff springs"
    if model.couplings.sliding or model.points.members is not None:
        return "nodes that slide on beams and contact with members have none"
    if model.flows:
        return "members or springs with internal variables have none"
    return ""
