"""Free motions that begin with a mode: that of an amplitude or energy, and those on the way."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Iterator

import numpy as np

from fx_beam.errors import SceneError, StepError, is_whole, require
from fx_beam.linear.linearisation import linearised
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.results.vibrations import first_of_largest
from fx_beam.scene.scene import Scene

from .closing import ROUND_OFF, Closed, Condition, NotClosed, close, turning_point
from .periodic_family import Path
from .shooting import Period, Shooting
from .variables import Directions

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

        def slopes(period: Period, directions: Directions) -> np.ndarray:
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
            if missing > max(self._shooting.options.tolerance, ROUND_OFF):
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

    def slopes(period: Period, directions: Directions) -> np.ndarray:
        return np.append(shooting.variables.slope_of_energy(period.start, directions), 0.0) / unit

    return Condition(error, slopes)
