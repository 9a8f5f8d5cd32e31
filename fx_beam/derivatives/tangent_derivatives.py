"""Derivatives of stiffness and mass about an equilibrium by all numbers of its scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.laws.schemes import EnergyMomentum, Equilibrium
from fx_beam.linear.linearisation import Linearisation
from fx_beam.motions.numbers import OF_OUTPUTS, OF_STEPS, static_numbers_of
from fx_beam.results.state import State
from fx_beam.scene.inputs import with_values
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import ElsewhereError
from fx_beam.step.adjoint import Adjoint
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.sparse_lu import pivoted_lu
from fx_beam.step.static_tape import static_tape
from fx_beam.step.tables import Problem

from .gradient import along

# A difference of order six along a direction: points, and weights over the distance. The distance
# is relative to a motion of the size of the scene, or of a radian.
_POINTS, _WEIGHTS = np.array([-3, -2, -1, 1, 2, 3]), np.array([-1, 9, -45, 45, -9, 1]) / 60
_DISTANCE = 4e-3
# Forces that remain of a system that is solved, relative to its right side.
_SOLVED = 1e-6


class Square(NamedTuple):
    """stiffness * d.K d + damping * d.C d + mass * d.M d, with a direction d (free,)."""

    direction: np.ndarray
    stiffness: float
    damping: float
    mass: float


class _Steps(NamedTuple):
    """Steps from the state: increments (n, free), weights of residuals and of ends, lengths [s]."""

    moves: np.ndarray
    of_equations: np.ndarray
    of_ends: np.ndarray
    lengths: np.ndarray


class TangentDerivatives:
    """The equilibrium of a linearised scene, whose forces are followed backwards beside it.

    The derivative of d.K d is that of the work d.r of the residual, along d: r is evaluated at
    states beside the equilibrium by the same laws, blocks and Jacobians of elements as of motions.
    """

    def __init__(
        self,
        about: Linearisation,
        factor: float,
        inputs: Any,
        of: str,
        damped: bool = False,
        other: Model | None = None,
    ):
        if reason := _why_not(about):
            raise SceneError(f"{of}: no derivatives: {reason}")
        self._about, self._factor, self._inputs, self._of = about, factor, inputs, of
        self._damped = damped
        model = self._model = self._new(about.scene) if damped else about.model
        self._problem = Problem(model, NewtonOptions())
        self._problem.c.at_rest = 1  # forces that depend on rates, without inertia
        self._adjoint = Adjoint(self._problem)
        self._forcing = LoadForcing(model, about.start.t)
        self._state: State = replace(about.start, t=factor)
        #: A model for other numbers.
        self.other = other

    def _new(self, scene: Scene) -> Model:
        """As the model of the tangent, or that of steps which tell damping."""
        if self._damped:
            return Model(scene, EnergyMomentum(), instant=True)
        return Model(scene, Equilibrium(), mobile=True)

    def numbers_of(self, scene: Scene) -> dict[str, np.ndarray]:
        """The numbers of this equilibrium for another scene; OtherStructureError if it differs."""
        scene = with_values(scene, self._inputs)
        if self.other is None:
            self.other = self._new(self._model.scene)
        try:
            self.other.refill(scene)
        except ElsewhereError:
            self.other = self._new(scene)
        forcing = LoadForcing(self.other, self._forcing.time)
        return static_numbers_of(self.other, forcing, np.array([self._factor]))

    def of_squares(
        self, squares: Sequence[Square], follows: bool, time: float = 1.0
    ) -> dict[str, np.ndarray]:
        """Derivatives of a sum of squares by all numbers.

        The state `follows` from its loads; else it is the reference. With damping, steps have a
        `time` [s] like that of a vibration.
        """
        about, T, mass = self._about, self._about.T, self._model.mass
        unit = self._model.unit_of_unknowns[about.unknowns]
        rows = np.repeat(np.arange(mass.shape[0]), np.diff(mass.indptr))
        by_mass, steps = np.zeros(mass.nnz), list[_Steps]()
        for d, stiffness, damping, of_mass in squares:
            size = _DISTANCE / abs(d / unit).max()
            moves, weights, full = size * _POINTS[:, None] * d, _WEIGHTS[:, None] / size, T @ d
            of_ends = 2 * of_mass * weights * (mass @ full)
            by_mass += of_mass * full[rows] * full[mass.indices]
            if not self._damped:
                steps.append(_Steps(moves, stiffness * weights * d, of_ends, np.zeros(len(moves))))
                continue
            # The force of a step with an increment D is K D / 2 + C D / length, that of a length
            # less that of its double C D / (2 length).
            long, short = 4 * stiffness - 2 * time * damping, 2 * time * damping - 2 * stiffness
            for length, share, at_end in ((time, short, 1.0), (2 * time, long, 0.0)):
                lengths = np.full(len(moves), length)
                steps.append(_Steps(moves, share * weights * d, at_end * of_ends, lengths))
        joined = _Steps(*map(np.concatenate, zip(*steps, strict=True)))
        by_numbers, by_unknowns = self._followed(joined)
        by_numbers["mass"] = by_numbers["mass"] + by_mass
        by_state = by_unknowns.sum(axis=0)
        if follows:
            for name, values in self.of_forces(-self._solved(by_state)).items():
                by_numbers[name] = by_numbers[name] + values
        else:
            for joint, column in self._model.couplings.slides.items():
                if column < len(by_state):
                    by_numbers["slides"][joint] += by_state[column]
        return by_numbers

    def refuse_others(
        self, changes: Mapping[str, np.ndarray], known: Mapping[str, np.ndarray]
    ) -> None:
        """SceneError if numbers change of which there are no derivatives."""
        for name in changes.keys() - known.keys() - OF_OUTPUTS:
            if changes[name].any():
                number = int(changes[name].reshape(len(changes[name]), -1).any(axis=1).argmax())
                raise SceneError(
                    f"{self._of}: x[{number}] changes {name!r} of the scene, by which there are no "
                    "derivatives"
                )

    def of_forces(self, weights: np.ndarray) -> dict[str, np.ndarray]:
        """Derivatives of weights (free,) times the residual of the equilibrium by all numbers."""
        none = np.zeros((1, self._model.size))
        return self._followed(_Steps(0 * weights[None], weights[None], none, np.ones(1)))[0]

    def _followed(self, steps: _Steps) -> tuple[dict[str, np.ndarray], np.ndarray]:
        states = [self._state] * len(steps.moves)
        given = self._problem, self._state, states, self._forcing, steps.moves, steps.lengths
        weights = steps.of_equations, steps.of_ends
        named, by_unknowns = self._adjoint.vjp_of_equations(static_tape(*given), *weights)
        for name, values in named.items():  # of which some are written over by the next ones
            named[name] = values.sum(axis=0, keepdims=True) if name in OF_STEPS else values.copy()
        named["slides"][:] = 0.0  # the state is given
        return named, by_unknowns

    def _solved(self, by_state: np.ndarray) -> np.ndarray:
        """Weights of forces whose derivatives by the state are these."""
        K = self._about.K.T
        try:
            weights = pivoted_lu(K).solve(by_state)
        except RuntimeError:
            weights = np.full(len(by_state), np.nan)
        left = K @ weights - by_state
        if not (abs(left) <= _SOLVED * abs(by_state).max(initial=0.0)).all():
            raise SceneError(
                f"{self._of}: no derivatives: the tangent of the state is singular, so that it "
                "does not follow from the numbers. Support the scene, or take a state beside a "
                "critical point"
            )
        return weights


def total(changes: Mapping[str, np.ndarray], by_numbers: Mapping[str, np.ndarray]) -> np.ndarray:
    """Derivatives (m,) from changes (m, ...) of numbers and derivatives by these."""
    known = changes.keys() & by_numbers.keys()
    return np.sum([along(changes[name], by_numbers[name]) for name in known], axis=0)


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
