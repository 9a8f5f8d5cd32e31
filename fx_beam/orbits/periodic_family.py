"""Families of periodic motions by the pseudo-arc length, and those that begin with a mode."""

from __future__ import annotations

import contextlib
import functools
import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fx_beam.equilibria.arc_length import Stretch, follow, root_between
from fx_beam.errors import SceneError, StepError, is_whole, require
from fx_beam.linear.linearisation import linearised
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.results.vibrations import PeriodicFamily, PeriodicMotion, first_of_largest
from fx_beam.scene.scene import Scene

from . import shooting as method
from .shooting import Closed, Condition, NotClosed, Period, Shooting, close, plane, turning_point

# -- Families of periodic motions, followed by the pseudo-arc length ----------------------------


# Multipliers that are larger than 1 by less are round-off.
_NEUTRAL = 1e-5

# Most iterations after which steps become longer, most of all, and damping in them; factors of
# longer and shorter steps, and the shortest one.
_FEW, _MOST, _DAMPED = 5, 11, 1e-6
_LONGER, _SHORTER, _SHORTEST = 1.5, 0.4, 1e-4
# Error of the place of a change of stability, relative to the step in which it is.
_PLACE = 1e-6
# How far a motion may lie beside the end of a step, relative to it, and how little the directions
# at both ends may agree (cosine).
_BENT, _STRAIGHT = 0.5, 0.7


def multipliers_of(closed: Closed) -> np.ndarray:
    """Multipliers (n,), largest first, of changes of the state that steps resolve.

    Changes that alternate, or turn by more than a quarter in the first step, are left out.
    """
    independent = closed.directions.independent
    unit = closed.directions.matrix[independent]
    values, vectors = np.linalg.eig(np.linalg.solve(unit, closed.monodromy[independent]))
    stepped = np.linalg.solve(unit, closed.first_step[independent]) @ vectors
    cosines = np.real(np.einsum("ij,ij->j", vectors.conj(), stepped))
    slow = values[(cosines > 0) | (abs(values) < _NEUTRAL)]
    return slow[np.lexsort((-slow.imag, -abs(slow)))]


def instability_of(multipliers: np.ndarray, trivial: int) -> str:
    """How a motion is unstable, by the largest multiplier; empty if it is stable.

    Some multipliers are `trivial`: 1 for shifts in time, and for the energy of a family.
    """
    remaining = without_trivial(multipliers, trivial)
    growing = remaining[abs(remaining) > 1 + _NEUTRAL]
    if not len(growing):
        return ""
    largest = growing[np.argmax(abs(growing))]
    if abs(largest.imag) > _NEUTRAL:
        return "Neimark-Sacker"
    return "fold" if largest.real > 0 else "period doubling"


def without_trivial(multipliers: np.ndarray, trivial: int) -> np.ndarray:
    """Multipliers (n,) without the `trivial` many that are nearest to 1."""
    return np.delete(multipliers, np.argsort(abs(multipliers - 1))[:trivial])


# Losses in a period that are round-off, relative to the energy of the motion; how far from 1 errors
# move a multiplier of which two are 1.
_NO_LOSS, _FAMILY = 1e-12, 2e-3


class Cycle(NamedTuple):
    """How a periodic motion was found: what its derivatives need."""

    period: Period
    options: method.PeriodicOptions
    free: bool
    #: What chooses it among its neighbours: "period", "frequency", "energy", "amplitude", "" for
    #: nothing, "arc" for its place in a family, or the kind of a change of stability there.
    chosen_by: str
    #: Number of multipliers that are 1 in each motion of its kind.
    trivial: int
    #: The degree of freedom whose amplitude chooses it, and the state from which it is measured.
    held: int
    state: Solution | None


def motion_of(
    shooting: Shooting,
    closed: Closed,
    free: bool,
    chosen_by: str = "period",
    held_dof: int = 0,
    state: Solution | None = None,
) -> PeriodicMotion:
    """Periodic motion for users."""
    method.warn_of_round_off(shooting, [closed.left_over])
    period = closed.period
    energy, multipliers = shooting.variables.energy(period.start), multipliers_of(closed)
    second = np.sort(abs(multipliers - 1))[1:2]  # of a cycle that forces drive it is any
    conserves = period.lost <= _NO_LOSS * abs(energy) and bool((second < _FAMILY).all())
    trivial = free * (1 + conserves)
    length, error = float(period.length), float(period.error)
    instability = instability_of(multipliers, trivial)
    cycle = Cycle(period, shooting.options, free, chosen_by, trivial, held_dof, state)
    run = functools.partial(shooting.solution, period)
    return PeriodicMotion(
        length, energy, multipliers, instability, error, closed.iterations, run, cycle
    )


class Path:
    """Periodic motions one after the other, by steps along the curve of states and parameters.

    A length of 1 is a change of the state by the size of the motion, or of the parameter by e.
    """

    def __init__(self, shooting: Shooting, free: bool):
        self._shooting, self._free, self._longest = shooting, free, shooting.options.step
        #: The last step: the motion before it, the direction there, and its length.
        self.last_step: tuple[Closed, np.ndarray, float]

    def follow(self, first: Closed, towards: np.ndarray) -> Iterator[Closed]:
        """Motions after the first one, towards a change (rows + 1,) of rows and the parameter."""
        Point = tuple[Closed, np.ndarray]

        def advance(point: Point, step: float) -> tuple[Point, float]:
            new = self._next(*point, step)
            self.last_step = *point, step
            longer = step * (_LONGER if new[0].iterations <= _FEW else 1.0)
            return new, min(self._longest, longer)

        def shorter(point: Point, step: float, reason: Exception) -> float:
            if (step := _SHORTER * step) < _SHORTEST:
                raise NotClosed(
                    f"{self._shooting.what}: the family could not be followed beyond the period "
                    f"of {point[0].period.length:.6g} s: {reason}"
                ) from reason
            return step

        start = first, _tangent(first, towards)
        for new, _ in follow(start, self._longest / 2, advance, shorter, (NotClosed, StepError)):
            yield new

    def _next(self, closed: Closed, tangent: np.ndarray, step: float) -> tuple[Closed, np.ndarray]:
        """The motion after a step, and the direction there; NotClosed if the curve bends away."""
        period, scale, shooting = closed.period, closed.directions.scale, self._shooting
        variables = shooting.variables
        amounts = step * tangent * np.append(np.full(len(tangent) - 1, period.size), 1.0)
        state = variables.moved(period.start, closed.directions, amounts[:-1])
        parameter = period.parameter * np.exp(amounts[-1])
        rows = variables.rows_of(state)
        ahead = _in_rows(closed, tangent)
        normal = ahead * np.append(np.ones(len(scale)), period.size)
        arc = plane(shooting, scale, normal, rows, parameter)
        phase = turning_point(shooting, period) if self._free else None
        new = close(shooting, state, parameter, phase, (arc,), most=_MOST, damping=_DAMPED)
        onwards = _tangent(new, ahead)
        apart = (variables.rows_of(new.period.start) - rows) / scale / period.size
        apart = np.append(apart, np.log(new.period.parameter / parameter))
        direction = _in_rows(new, onwards)
        cosine = direction @ ahead / np.linalg.norm(direction)
        if np.linalg.norm(apart) / step > _BENT or cosine < _STRAIGHT:
            raise NotClosed("the curve bends more than steps can follow")
        return new, onwards

    def family(self, motions: Iterator[Closed]) -> PeriodicFamily:
        """Family for users, of motions along this path."""
        members, critical = list[PeriodicMotion](), dict[int, functools.partial[PeriodicMotion]]()
        chosen_by = "arc" if self._free else "frequency"
        left_over = list[float]()
        for closed in itertools.islice(motions, self._shooting.options.most):
            left_over.append(closed.left_over)
            closed = closed._replace(left_over=0.0)  # told for all of them below
            motion = motion_of(self._shooting, closed, self._free, chosen_by)
            if members and motion.instability != members[-1].instability:
                critical[len(members)] = functools.partial(self._critical, *self.last_step, motion)
            members.append(motion)
        method.warn_of_round_off(self._shooting, left_over)
        return PeriodicFamily(members, self._free, critical)

    def _critical(
        self, start: Closed, tangent: np.ndarray, step: float, end: PeriodicMotion
    ) -> PeriodicMotion:
        """The motion of a step at which the largest multiplier comes to the unit circle.

        Else that at its end: of free motions, and where two kinds of instability follow each other.
        """
        stretch = Stretch(lambda part: self._next(start, tangent, part * step)[0], {0.0: start})

        def beyond(part: float) -> float:
            return float(abs(multipliers_of(stretch.point_at(part))).max()) - 1

        if self._free:
            return end
        try:
            closed = stretch.point_at(root_between(beyond, 0.0, 1.0, _PLACE))
        except (NotClosed, StepError, ValueError):  # ValueError: the same sign at both ends
            return end
        kind = end.instability or instability_of(multipliers_of(start), 0)
        return motion_of(self._shooting, closed, self._free, kind)


def _in_rows(closed: Closed, tangent: np.ndarray) -> np.ndarray:
    """A direction (rows + 1,) over the size of the motion, from one of variables (n + 1,)."""
    return np.append(closed.directions.matrix @ tangent[:-1], tangent[-1])


def _tangent(closed: Closed, ahead: np.ndarray) -> np.ndarray:
    """Direction (n + 1,) of the family, over the size of the motion, with one of rows ahead."""
    size, n = closed.period.size, closed.equations.shape[1]
    matrix = closed.equations * np.append(np.full(n - 1, size), 1.0) / size
    onwards = np.append(ahead[:-1] @ closed.directions.matrix, ahead[-1])
    right = np.append(np.zeros(len(matrix)), 1.0)
    direction = method.least_squares(np.vstack([matrix, onwards]), right)
    return direction / np.linalg.norm(_in_rows(closed, direction))


# -- Free motions that begin with a mode: that of an amplitude or energy, and those on the way --


# Smallest part of a displacement in a mode that moves nodes, in units of the scene.
_MOVES = 1e-6


# Longest motion, in periods of a mode, in which its period with an amplitude is looked for.
_LONGEST = 1.6
# Iterations before the family is followed, and the largest number of motions on the way; parts of
# the amplitude with which it may begin.
_PATIENCE, _FAR = 24, 60
_SMALL = 0.05, 0.005, 0.0005
# Largest speed at the start, relative to that of a vibration with the amplitude.
_AT_REST = 0.01


class ModeFamily:
    """Free motions that begin with a mode about an equilibrium, by default the reference.

    The last one has an amplitude [m or rad] or an energy [J].
    """

    def __init__(self, shooting: Shooting, scene: Scene, state: Solution | None, mode: int):
        self._shooting, options = shooting, shooting.options
        self._begin(scene, state, mode)
        if options.energy is not None:
            self._amplitude, self._end = self._small_vibration(options.energy)
        elif options.amplitude is not None:
            self._amplitude, self._end = options.amplitude, self._holds(options.amplitude)
        else:
            raise SceneError(
                f"{shooting.what}: a mode has a family of motions. Give the amplitude or "
                "the energy of the one that is wanted"
            )

    def _begin(self, scene: Scene, state: Solution | None, mode: int) -> None:
        """Find the mode; SceneError if it does not vibrate freely about an equilibrium."""
        shooting, model, caller = self._shooting, self._shooting.model, self._shooting.what
        require(is_whole(mode, 0), f"{caller}: mode", mode, "the number of a mode, from 0 on")
        shooting.check_free()
        if state is None and shooting.prepared.forcing.dead(0.0).any():
            raise SceneError(
                f"{caller}: the scene has loads. Give the equilibrium about which the mode "
                "vibrates, such as state=fx_beam.static(scene)"
            )
        linear = linearised(scene, state, caller)
        if state is None and linear.start.q.any():
            raise SceneError(
                f"{caller}: springs are under tension in the scene as it is drawn. Give the "
                "equilibrium about which the mode vibrates, such as state=fx_beam.static(scene)"
            )
        omega, rigid, vectors = linear.undamped_modes.lowest(mode + 1)
        if mode >= len(omega) or rigid[mode] or omega[mode] <= 0:
            raise SceneError(
                f"{caller}: mode {mode} does not vibrate: fx_beam.modes(scene) shows which do"
            )
        moved, columns = linear.T @ vectors[:, mode], linear.columns @ vectors[:, mode]
        #: Period of the mode [s] for small amplitudes, and the state at rest.
        self._period = 2 * np.pi / float(omega[mode])
        rest = shooting.first_state(state, self._period / shooting.steps)
        if shooting.depends_on_time(rest, self._period):
            raise SceneError(
                f"{caller}: loads, motors or parameters depend on time, so that the motion is "
                "forced: it has their period. Give period=, without a mode"
            )
        self._rest = rest.changed(v=0 * rest.v, a=0 * rest.a)
        sizes = abs(moved / model.units.nodes)
        sizes[model.mesh.turns] *= _MOVES  # rotations count if nothing else moves
        #: The degree of freedom that moves most, of which the vector (free,) has 1.
        self.most = first_of_largest(sizes)
        self._vector = columns[: model.couplings.free] / moved[self.most]

    def _start(self, amplitude: float) -> State:
        """The state at rest with an amplitude [m or rad] of this degree of freedom."""
        return self._shooting.variables.shifted(self._rest, amplitude * self._vector)

    def _holds(self, amplitude: float) -> Condition:
        """Condition for the amplitude [m or rad] of the start."""
        unit, most = self._shooting.model.units.nodes[self.most], self.most

        def error(period: Period) -> float:
            return float(period.start.q[most] - self._rest.q[most] - amplitude) / unit

        def slopes(period: Period, directions: method.Directions) -> np.ndarray:
            return np.append(directions.changes["q"][:, most], 0.0) / unit

        return Condition(error, slopes)

    def _small_vibration(self, energy: float) -> tuple[float, Condition]:
        """Amplitude of a small vibration with an energy, and the condition that holds it."""
        shooting, least = self._shooting, self._shooting.variables.energy(self._rest)
        excess = energy - least
        if excess <= 0:
            raise SceneError(
                f"{shooting.what}: energy = {energy:g} J must be above that at rest, {least:g} J"
            )
        small = 1e-4 * shooting.model.units.nodes[self.most]
        energy_of_small = shooting.variables.energy(self._start(small)) - least
        amplitude = small * float(np.sqrt(excess / energy_of_small))
        return amplitude, holds_energy(shooting, energy, excess)

    def _at(self, amplitude: float, condition: Condition) -> Closed:
        """The motion that meets a condition, from the mode with an amplitude.

        NotClosed if it repeats itself within the period, or passes the amplitude at some speed.
        """
        shooting, state = self._shooting, self._start(amplitude)
        length = shooting.first_return(state, _LONGEST * self._period) or self._period
        phase = turning_point(shooting, shooting.run(state, length))
        closed = close(shooting, state, length, phase, (condition,), most=_PATIENCE)
        start, length, most = closed.period.start, closed.period.length, self.most
        amplitude = abs(start.q[most] - self._rest.q[most])
        moves = abs(start.v[most]) * length / (2 * np.pi) > _AT_REST * amplitude
        if moves or shooting.repeats_within(start, length):
            raise NotClosed(
                f"{shooting.what}: no motion of one period was found that begins at rest. "
                "Use more steps, or a smaller amplitude"
            )
        return closed

    def last(self) -> Closed:
        """The motion of the amplitude or energy."""
        try:
            return self._at(self._amplitude, self._end)
        except (NotClosed, StepError):
            path = Path(self._shooting, True)
            *_, last = itertools.islice(self.motions_along(path), _FAR)
            missing = abs(self._end.error(last.period))
            if missing > max(self._shooting.options.tolerance, method.ROUND_OFF):
                raise NotClosed(
                    f"{self._shooting.what}: no motion with this amplitude or energy was found, "
                    f"nor does the family of the mode come to it in {_FAR} motions. See how far "
                    "it goes by fx_beam.backbone, or use more steps"
                ) from None
            return last

    def _first(self) -> Closed:
        """A motion of a small amplitude."""
        for part in _SMALL:
            amplitude = part * self._amplitude
            with contextlib.suppress(NotClosed, StepError):
                return self._at(amplitude, self._holds(amplitude))
        raise NotClosed(
            f"{self._shooting.what}: no motion of the mode with {_SMALL[-1]:g} of the amplitude "
            "was found, with which its family begins: there is none if energy is lost. Else use "
            "more steps"
        )

    def motions_along(self, path: Path) -> Iterator[Closed]:
        """Motions from a small amplitude on, up to the last one, along a path."""
        shooting, first = self._shooting, self._first()
        variables = shooting.variables
        yield (shown := first)
        rows = variables.rows_of(first.period.start) - variables.rows_of(self._rest)
        towards = np.append(rows / first.directions.scale / first.period.size, 0.0)
        for closed in path.follow(first, towards):
            earlier, last = shown.period, closed.period
            if (excess := self._end.error(last)) >= 0:
                # From `last`, the search may find a larger motion that begins on its way.
                part = 1 / (1 - excess / self._end.error(earlier))
                rows = variables.rows_of(last.start) - variables.rows_of(earlier.start)
                y = part * rows[: shooting.model.couplings.free]
                start = variables.shifted(earlier.start, y)
                length = earlier.length + part * (last.length - earlier.length)
                yield close(shooting, start, length, turning_point(shooting, last), (self._end,))
                return
            yield (shown := closed)


def holds_energy(shooting: Shooting, energy: float, unit: float) -> Condition:
    """Condition for the energy [J] of a motion."""

    def error(period: Period) -> float:
        return (shooting.variables.energy(period.start) - energy) / unit

    def slopes(period: Period, directions: method.Directions) -> np.ndarray:
        return np.append(shooting.variables.slope_of_energy(period.start, directions), 0.0) / unit

    return Condition(error, slopes)
