"""Steps from an equilibrium, whose forces tell stiffness and damping along directions."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from fx_beam.linear.linearisation import Linearisation
from fx_beam.scene.law import switches
from fx_beam.scene.structure import expressions_of
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.tables import ProblemInC, problem_of
from fx_beam.step.tangent_storage import ProblemKind
from fx_beam.step.tape import Tape, repeated, static_tape

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
