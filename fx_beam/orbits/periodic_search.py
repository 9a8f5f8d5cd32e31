"""Periodic motions: of a period, of modes and of harmonic loads, and their families."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from fx_beam.errors import LARGEST, SceneError, check_takes, is_whole, positive, real_array, require
from fx_beam.laws.schemes import Scheme
from fx_beam.motions.initial_state import end_of
from fx_beam.motions.motion_setup import prepare
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.results.vibrations import PeriodicFamily, PeriodicMotion
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.step.newton import NewtonOptions

from . import shooting as method
from .periodic_family import ModeFamily, Path, holds_energy, motion_of
from .shooting import NO_SHIFT, STEP, Closed, Period, PeriodicOptions, Shooting, at_rest, close

# Periods after which the search for a forced motion begins again.
_SETTLING = 3, 10, 30

Build = Callable[[float], Scene]


def periodic(
    scene: Scene,
    start: Solution | None = None,
    *,
    mode: int | None = None,
    amplitude: float | None = None,
    energy: float | None = None,
    period: float | None = None,
    state: Solution | None = None,
    steps: int = 201,
    scheme: Scheme | None = None,
    tolerance: float = 1e-9,
    newton: NewtonOptions | None = None,
) -> PeriodicMotion:
    """Find a motion that repeats itself, by shooting.

    Newton's method finds the state that is the same after one period, with the derivatives of the
    computed steps. Forced motions, of a scene whose loads or motors are functions of time, have the
    period of these functions. Free motions have a period of their own.

    Parameters
    ----------
    scene : Scene
        The scene.
    start : Solution, optional
        Solution at whose end the search begins; by default the initial state of the scene. For a
        free motion without a `period` it is a motion that comes back near to its end.
    mode : int, optional
        Number of the mode, as of `modes`, from which the search for a free motion begins.
    amplitude : float, optional
        With a mode: the amplitude at the start [m] of that component of a node which moves most in
        the mode (a rotation [rad] if nodes only turn).
    energy : float, optional
        Energy of a free motion [J], including the potential of constant loads; zero in the
        reference configuration.
    period : float, optional
        Period [s]: for a forced motion that of its loads, or a multiple of it; for a free motion
        the one that is wanted.
    state : Solution, optional
        Equilibrium about which the mode vibrates, such as ``static(scene)``; by default the
        reference configuration without loads.
    steps : int
        Odd number of equal steps in a period; with an odd number, parts of the rates that alternate
        from step to step, as at joints, cannot be periodic.
    scheme : Scheme, optional
        Time scheme; `EnergyMomentum()` by default.
    tolerance : float
        Largest distance of the states before and after the period, relative to the motion. For
        motions below 1e-5 of the size of the scene it is 1e-14 of this size, which is round-off.
        Where round-off in stiff scenes leaves more, up to 1e-6, a warning says so.
    newton : NewtonOptions, optional
        Convergence criteria of the steps.

    Returns
    -------
    PeriodicMotion
        The motion over a period, its multipliers and stability.

    Raises
    ------
    SceneError
        For a scene without derivatives (see `Response`), loads that do not repeat after the period,
        options that contradict each other, or derivatives that grow without bound.
    StepError
        If a step of the first motion fails.
    RuntimeError
        If no periodic motion is found.

    Examples
    --------
    A pendulum of a stiff massless bar that swings to 90 degrees on either side, from a motion over
    somewhat more than a period: this is 1.18034 times that of small swings.

    >>> import math, fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -9.81))
    >>> bar = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e6))
    >>> scene.pin(bar.start)
    >>> mass = scene.add_mass(bar.end, 1.0)
    >>> motion = fb.simulate(scene, dt=0.01, t_end=3.0)
    >>> swing = fb.periodic(scene, start=motion, energy=0.0)
    >>> swing.stable, round(swing.period / (2 * math.pi / math.sqrt(9.81)), 2)
    (True, 1.18)
    """
    what = "periodic"
    options = PeriodicOptions.among(locals())
    if period is not None:
        period = positive(period, f"{what}: period", "a positive number of seconds")
    shooting = Shooting(scene, options)
    if mode is None:
        for name, unused in (("amplitude", amplitude), ("state", state)):
            if unused is not None:
                raise SceneError(f"{what}: {name} is that of a mode. Give mode=0, for example")
        return _from_state(shooting, start, period)
    for name, unused in (("start", start), ("period", period)):
        if unused is not None:
            raise SceneError(
                f"{what}: a motion is found from a mode, with amplitude or energy, or from {name}, "
                "but not from both"
            )
    family = ModeFamily(shooting, scene, state, mode)
    chosen_by = "energy" if amplitude is None else "amplitude"
    return motion_of(shooting, family.last(), True, chosen_by, family.most, state)


def _from_state(shooting: Shooting, start: Solution | None, period: float | None) -> PeriodicMotion:
    caller, energy = shooting.what, shooting.options.energy
    dt = 1e-3 if period is None else period / shooting.steps
    first = shooting.first_state(start, dt)
    free = not shooting.depends_on_time(first, _span(start) if period is None else period)
    if not free and period is None:
        raise SceneError(
            f"{caller}: loads, motors or parameters depend on time. Give their period, or a "
            "multiple of it"
        )
    if period is not None:
        if energy is not None:
            raise SceneError(f"{caller}: give the energy or the period: each sets the other")
        shooting.check_repeats(first, period)
        if (rest := at_rest(shooting, first, period)) is not None:
            return motion_of(shooting, rest, False)
        if free:
            shooting.check_free()
        return motion_of(shooting, settle_and_close(shooting, first, period, free), free)
    shooting.check_free()
    length = _period_in(start, caller)
    conditions = tuple[method.Condition, ...]()
    if energy is not None:
        size = abs(energy - shooting.variables.energy(shooting.first_state(None, dt)))
        conditions = (holds_energy(shooting, energy, size or 1.0),)
    closed = close(shooting, first, length, NO_SHIFT, conditions)
    return motion_of(shooting, closed, True, "energy" if conditions else "")


def settle_and_close(shooting: Shooting, first: State, parameter: float, free: bool) -> Closed:
    """The motion of a period, or of a frequency of loads.

    The search begins again after a motion has settled for some time.
    """
    phase = NO_SHIFT if free else None
    if shooting.variables.remembers:
        first = shooting.settled(first, parameter, 1)
    for periods in () if free else _SETTLING:
        try:
            return close(shooting, first, parameter, phase, varies=False)
        except method.NotClosed:
            first = shooting.settled(first, parameter, periods)
    return close(shooting, first, parameter, phase, varies=False)


def _span(start: Solution | None) -> float:
    return 1.0 if start is None or len(start.t) < 2 else float(np.ptp(start.t)) or 1.0


def _period_in(start: Solution | None, caller: str) -> float:
    """Time since a motion was last near to its end [s]."""
    advice = "Give start a motion over more than one period, or mode, or period"
    if start is None or not start.has_motion or not start.has_rates or start.stats.static:
        raise SceneError(f"{caller}: nothing says how long a period is. {advice}")
    end_of(start)
    parts = [part[::-1].reshape(len(start.t), -1) for part in (start.q, start.v)]
    rows = np.hstack([part / (np.linalg.norm(np.ptp(part, axis=0)) or 1.0) for part in parts])
    return_row = method.nearest_return(rows)
    if return_row is None:
        raise SceneError(f"{caller}: the motion of start does not come back to its end. {advice}")
    times = start.t[-1] - start.t[::-1]
    return float(np.interp(return_row, np.arange(len(times)), times))


def backbone(
    scene: Scene,
    mode: int = 0,
    *,
    amplitude: float | None = None,
    energy: float | None = None,
    state: Solution | None = None,
    step: float = STEP,
    most: int = 200,
    steps: int = 101,
    scheme: Scheme | None = None,
    tolerance: float = 1e-9,
    newton: NewtonOptions | None = None,
) -> PeriodicFamily:
    """Follow the free periodic motions of a mode, from a small amplitude on.

    The curve of frequency over amplitude, or over energy, is the backbone of the resonances. It is
    followed by the pseudo-arc length, also where amplitude or frequency turn back.

    Parameters
    ----------
    scene : Scene
        The scene.
    mode : int
        Number of the mode, as of `modes`.
    amplitude : float, optional
        Amplitude at the start [m], as of `periodic`, at which the family ends.
    energy : float, optional
        Energy [J] at which the family ends, in the place of an amplitude.
    state : Solution, optional
        Equilibrium about which the mode vibrates; by default the reference configuration without
        loads.
    step : float
        Longest step: change of the state over the size of the motion, or of the period over itself.
    most : int
        Largest number of motions.
    steps : int
        Odd number of steps in a period.
    scheme : Scheme, optional
        Time scheme; `EnergyMomentum()` by default.
    tolerance : float
        As of `periodic`.
    newton : NewtonOptions, optional
        Convergence criteria of the steps.

    Returns
    -------
    PeriodicFamily
        The motions, by growing arc length; the last one has the amplitude or energy.

    Raises
    ------
    SceneError
        As of `periodic`.
    RuntimeError
        If the family cannot be followed so far.

    Examples
    --------
    A mass on a spring that hardens: with stiffness 1 + x^2 the frequency grows with the amplitude.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> body = scene.add_body((0, 0), mass=1.0, inertia=1.0)
    >>> spring = fb.Spring(stiffness=1.0, strain_energy=lambda x: x**4 / 4)
    >>> joint = scene.add_joint(
    ...     fb.Prismatic(fb.GROUND, body.centre, axis=(1, 0), spring=spring)
    ... )
    >>> family = fb.backbone(scene, amplitude=1.0)
    >>> (family.frequencies * 6.2832).round(2)[[0, -1]]
    array([1.  , 1.32])
    """
    shooting = Shooting(scene, PeriodicOptions.among(locals(), what="backbone"))
    path, family = Path(shooting, True), ModeFamily(shooting, scene, state, mode)
    return path.family(family.motions_along(path))


class _OverFrequency(Shooting):
    """Motions over some periods of loads; the parameter is the frequency of these [Hz]."""

    def __init__(self, build: Build, frequency: float, periods: int, options: PeriodicOptions):
        self._build, self._periods = build, periods
        self._now = frequency
        super().__init__(_scene(build, frequency), options, partial(prepare, owned=True))

    def length_of(self, parameter: float) -> float:
        return self._periods / parameter

    def run(self, state: State, parameter: float) -> Period:
        self._restart(parameter)
        return super().run(state, parameter)

    def solution(self, period: Period) -> Solution:
        # The numbers of the search go on to other frequencies.
        prepared = prepare(_scene(self._build, period.parameter), self.prepared.options)
        return self._solution_of(*self._recorded(prepared, period))

    def _restart(self, parameter: float) -> None:
        """Set the numbers of the scene at a frequency [Hz]."""
        if parameter != self._now:
            try:
                self.prepared.restart(_scene(self._build, parameter), self.prepared.options)
            except OtherStructureError as other:
                raise SceneError(
                    f"{self.what}: the scene at {parameter:.6g} Hz has another structure than at "
                    f"{self._now:.6g} Hz: {other}. Let build change numbers only"
                ) from other
            self._now = parameter


def _scene(build: Build, frequency: float) -> Scene:
    scene = build(frequency)
    require(isinstance(scene, Scene), "forced_response: what build gives", scene, "a Scene")
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
        of the scene. For a scene with static loads take their equilibrium.
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
    ends = real_array(frequencies)
    differ = ends.shape == (2,) and ends[0] != ends[1]
    is_valid = differ and all(1 / LARGEST <= f <= LARGEST for f in ends)
    expected = "the first and the last one, positive [Hz]"
    require(is_valid, f"{what}: frequencies", frequencies, expected)
    require(is_whole(periods, 1), f"{what}: periods", periods, "a whole number from 1 on")
    first, last = map(float, ends)
    shooting = _OverFrequency(build, first, periods, PeriodicOptions.among(locals()))
    state = shooting.first_state(start, shooting.length_of(first) / steps)
    shooting.check_repeats(state, shooting.length_of(first))
    path = Path(shooting, False)
    return path.family(_between(shooting, state, (first, last), path))


def _between(
    shooting: Shooting, state: State, ends: tuple[float, float], path: Path
) -> Iterator[Closed]:
    """Motions from the first frequency on, until the curve leaves the range."""
    first, last = ends
    begin = settle_and_close(shooting, state, first, False)
    # The derivative by the frequency, which the first motion has been found without.
    column = shooting.parameter_slope(begin.period)
    begin = begin._replace(equations=np.column_stack([begin.equations[:, :-1], column]))
    yield begin
    towards = np.append(np.zeros(len(begin.directions.scale)), np.sign(last - first))
    for closed in path.follow(begin, towards):
        frequency = closed.period.parameter
        if not min(ends) <= frequency <= max(ends):
            end = min(max(frequency, min(ends)), max(ends))
            yield settle_and_close(shooting, closed.period.start, end, False)
            return
        yield closed
