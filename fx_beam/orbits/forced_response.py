"""Periodic motions under loads of a frequency, over this frequency."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.laws.schemes import Scheme
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.results.vibrations import PeriodicFamily
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.step.newton import NewtonOptions
from fx_beam.validation import LARGEST, check_takes, is_whole, numbers, require, shown

from .closing import Closed
from .mode_family import STEP
from .periodic_family import Path, motion_of
from .periodic_search import check_tolerance, longest_step, of_period
from .shooting import Period, Shooting

Build = Callable[[float], Scene]


class _OverFrequency(Shooting):
    """Motions over some periods of loads; the parameter is the frequency of these [Hz]."""

    def __init__(self, build: Build, frequency: float, periods: int, options: tuple):
        self._build, self._periods, self._options = build, periods, options
        self._now = frequency
        super().__init__(_scene(build, frequency), *options)

    def length_of(self, parameter: float) -> float:
        return self._periods / parameter

    def run(self, state: State, parameter: float) -> Period:
        if parameter != self._now:
            try:
                self.prepared.refill(_scene(self._build, parameter))
            except OtherStructureError as other:
                raise SceneError(
                    f"{self.what}: the scene at {parameter:.6g} Hz has another structure than at "
                    f"{self._now:.6g} Hz: {other}. Let build change numbers only"
                ) from other
            self._now = parameter
        return super().run(state, parameter)

    def solution(self, period: Period) -> Solution:
        # Later frequencies have changed the numbers of this scene.
        scene = _scene(self._build, period.parameter)
        return Shooting(scene, *self._options).solution(period)


def _scene(build: Build, frequency: float) -> Scene:
    scene = build(frequency)
    if not isinstance(scene, Scene):
        raise SceneError(f"forced_response: build must give a scene, not {shown(scene)}")
    return scene


def forced_response(
    build: Callable[[float], Scene],
    frequencies: Sequence[float],
    *,
    start: Solution | None = None,
    periods: int = 1,
    step: float = STEP,
    most: int = 400,
    steps: int = 101,
    scheme: Scheme | None = None,
    tolerance: float = 1e-9,
    newton: NewtonOptions | None = None,
) -> PeriodicFamily:
    """Follow the periodic motions of a scene over the frequency of its loads.

    The curve is followed by the pseudo-arc length, also through folds, between which a motion is
    unstable and no simulation finds it. For small vibrations it is that of `frequency_response`.

    Parameters
    ----------
    build : callable
        ``build(f)`` gives the scene whose loads, motors or parameters have the frequency f [Hz].
        Only numbers may depend on f.
    frequencies : (first, last)
        Frequencies [Hz] at which the curve begins and ends, rising or falling.
    start : Solution, optional
        Solution at whose end the search for the first motion begins; by default the initial state
        of the scene. Of a scene with static loads it is their equilibrium.
    periods : int
        Number of periods of the loads after which a motion repeats itself: 2 after a period
        doubling.
    step : float
        Longest step: change of the state over the size of the motion, or of the frequency over
        itself.
    most : int
        Largest number of motions.
    steps : int
        Odd number of steps in a period of the motion.
    scheme : Scheme, optional
        Time scheme; `EnergyMomentum()` by default.
    tolerance : float
        As of `periodic`.
    newton : NewtonOptions, optional
        Convergence criteria of the steps.

    Returns
    -------
    PeriodicFamily
        The motions along the curve.

    Raises
    ------
    SceneError
        As of `periodic`; if `build` gives no scene, or scenes that differ in more than numbers.
    RuntimeError
        If no first motion is found, or the curve cannot be followed.

    Examples
    --------
    A damped body on a spring that hardens: three motions at one frequency, one of them unstable.

    >>> import math, fx_beam as fb
    >>> def build(f):
    ...     scene = fb.Scene()
    ...     body = scene.add_body((0, 0), mass=1.0, inertia=1.0)
    ...     spring = fb.Spring(stiffness=1.0, strain_energy=lambda x: x**4 / 4)
    ...     damper = fb.Damper(0.1)
    ...     scene.add_joint(
    ...         fb.Prismatic(fb.GROUND, body.centre, (1, 0), spring=spring, damper=damper)
    ...     )
    ...     scene.add_force(body.centre, lambda t: (0.3 * math.cos(2 * math.pi * f * t), 0))
    ...     return scene
    >>> curve = fb.forced_response(build, (0.05, 0.4))
    >>> [motion.instability for motion in curve if not motion.stable][0]
    'fold'
    """
    what = "forced_response"
    check_takes(build, "f", f"{what}: build")
    ends = numbers(frequencies)
    fits = ends.shape == (2,) and ends[0] != ends[1]
    fits = fits and all(1 / LARGEST <= f <= LARGEST for f in ends)
    require(fits, f"{what}: frequencies", frequencies, "the first and the last one, positive [Hz]")
    require(is_whole(periods, 1), f"{what}: periods", periods, "a whole number from 1 on")
    step = longest_step(what, step, most)
    check_tolerance(what, tolerance)
    first, last = map(float, ends)
    shooting = _OverFrequency(build, first, periods, (scheme, steps, newton, what))
    state = shooting.first_state(start, shooting.length_of(first) / steps)
    shooting.check_repeats(state, shooting.length_of(first))
    motions = []
    for closed in _between(shooting, state, (first, last), step, tolerance):
        motions.append(motion_of(shooting, closed, False))
        if len(motions) == most:
            break
    return PeriodicFamily(motions, free=False)


def _between(
    shooting: Shooting,
    state: State,
    ends: tuple[float, float],
    step: float,
    tolerance: float,
) -> Iterator[Closed]:
    """Motions from the first frequency on, until the curve leaves the range."""
    first, last = ends
    begin = of_period(shooting, state, first, tolerance, False)
    # The derivative by the frequency, which the first motion has been found without.
    column = shooting.by_parameter(begin.period)
    begin = begin._replace(equations=np.column_stack([begin.equations[:, :-1], column]))
    yield begin
    towards = np.append(np.zeros(len(begin.by.scale)), np.sign(last - first))
    for closed in Path(shooting, tolerance, False, step).follow(begin, towards):
        at = closed.period.parameter
        if not min(ends) <= at <= max(ends):
            end = min(max(at, min(ends)), max(ends))
            yield of_period(shooting, closed.period.start, end, tolerance, False)
            return
        yield closed
