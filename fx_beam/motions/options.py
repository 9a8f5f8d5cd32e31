"""Options of motions: scheme, steps, end and record, checked once."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from fx_beam.errors import (
    LARGEST,
    SceneError,
    as_float,
    check_fields,
    is_flag,
    is_number,
    positive,
    real_array,
    require,
    shown,
    whole,
)
from fx_beam.laws.schemes import EnergyMomentum, Scheme, order_and_constant
from fx_beam.scene.outputs import Output
from fx_beam.scene.scene import Scene
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import Record
from fx_beam.step.substeps import MOST_HALVINGS

# Limits of the tolerance. Newton's method and rounding disturb smaller errors.
_LEAST, _MOST = 1e-9, 0.1
# Shortest first or largest step that may be given, relative to the whole time.
_SHORTEST = 1e-10
# Largest step by default, relative to the whole time.
_LONGEST = 0.1

#: A function of the time and of outputs by name, which are arrays or numbers.
Condition = Callable[[float, dict[str, Any]], object]
#: Largest number of steps; their times alone take 0.8 GB.
MOST_STEPS = 1e8
_CONDITIONS = "a function of time and outputs, or a dictionary of such functions by names"


@dataclass(frozen=True, kw_only=True)
class CommonOptions:
    """Options of motions and of paths of equilibria.

    SceneError, with the name of `what` asks, for all that can be refused without a scene.
    """

    what: str
    newton: Any = NewtonOptions()
    progress: bool | None = None
    inputs: Mapping[str, object] | None = None

    @classmethod
    def among(cls, arguments: Mapping[str, Any], **replaced: Any) -> Self:
        """Options from the `arguments` of a function, its `locals()`; some are `replaced`."""
        names = cls.__dataclass_fields__.keys() & arguments.keys()
        return cls(**{name: arguments[name] for name in names} | replaced)

    def __post_init__(self):
        if self.newton is None:
            self.__dict__["newton"] = CommonOptions.newton
        check_fields(self, self.what)
        self._require("newton", isinstance(self.newton, NewtonOptions), "an fx_beam.NewtonOptions")
        ok = self.progress is None or is_flag(self.progress)
        self._require("progress", ok, "True, False or None")

    def _require(self, name: str, ok: bool, expected: str) -> None:
        if not ok:
            require(False, f"{self.what}: {name}", getattr(self, name), expected)


@dataclass(frozen=True, kw_only=True)
class Options(CommonOptions):
    """The options of `simulate`; `Motion`, `Response` and others have a part of them."""

    what: str = "simulate"
    scheme: Any = EnergyMomentum()
    t_end: float = math.nan
    dt: Any = None
    tolerance: float | None = None
    dt_max: float | None = None
    breaks: Sequence[float] = ()
    max_halvings: int = whole(0, MOST_HALVINGS, default=12)
    record: Any = Record()
    #: Conditions by name, also where a single one is given.
    until: Any = None
    outputs: Mapping[str, Output] | None = None

    def __post_init__(self):
        values, expected = self.__dict__, "given with a tolerance only"
        for name in ("scheme", "record"):
            if values[name] is None:
                values[name] = getattr(Options, name)
        super().__post_init__()
        if not isinstance(self.scheme, Scheme):
            raise SceneError(
                f"unknown scheme {shown(self.scheme)}; give an instance such as "
                "fx_beam.EnergyMomentum() or fx_beam.Newmark(), with parentheses, or an "
                "fx_beam.Scheme of your own"
            )
        if self.scheme.rates.at_rest:
            text = f"{self.scheme.name} is a scheme for statics. Use fx_beam.static(scene)"
            raise SceneError(text)
        self._require("record", isinstance(self.record, Record), "an fx_beam.Record")
        if self.tolerance is None:
            self._require("dt_max", self.dt_max is None, expected)
            no_breaks = isinstance(self.breaks, tuple | list) and not self.breaks
            self._require("breaks", no_breaks, expected)
            values["breaks"] = ()
        values.update(
            {name: as_float(values[name]) for name in ("t_end", "dt") if is_number(values[name])}
        )
        if self.until is None:
            self._require("outputs", self.outputs is None, "given with `until` only")
            return
        named = self.until if isinstance(self.until, Mapping) else {"until": self.until}
        ok = all(isinstance(name, str) and callable(condition) for name, condition in named.items())
        self._require("until", ok, _CONDITIONS)
        values["until"] = dict(named)
        if self.record.file is not None:
            text = f"{self.what}: a Record with a file is not possible with until or changes"
            raise SceneError(text)

    def plan(self, t0: float, goes_on: bool) -> StepPlan:
        """The steps from t0 [s] on."""
        require(is_number(self.t_end), "t_end", self.t_end, "a finite number")
        equal = self.tolerance is None
        plan = _equal_steps(self, t0, goes_on) if equal else _chosen_steps(self, t0)
        if (row_times := self.record.times) is not None:
            ok = row_times[-1] >= t0 and row_times[0] <= self.t_end
            expected = f"in part within the run, from {t0:g} to {self.t_end:g} s"
            require(ok, f"{self.what}: the record's times", row_times, expected)
        return plan


class StepPlan(NamedTuple):
    """The steps of a run: all of their ends, or the limits of those that a tolerance chooses."""

    #: Ends of equal steps [s]; with a tolerance the start alone.
    times: np.ndarray
    #: Length of the first step, or of the first one that is tried [s].
    first: float
    #: The tolerance; zero for equal steps.
    tolerance: float = 0.0
    #: The whole time, and the length of the largest step [s].
    span: float = math.nan
    longest: float = math.inf
    #: Whether a better first length is looked for.
    search: bool = False
    #: Times at which steps end and the control begins anew, the last of them the end [s].
    breaks: Sequence[float] = ()


def _chosen_steps(options: Options, t0: float) -> StepPlan:
    """Steps that are controlled by their local errors, checked."""
    tolerance, dt, dt_max, t_end = options.tolerance, options.dt, options.dt_max, options.t_end
    ok = _LEAST <= as_float(tolerance) <= _MOST
    require(ok, "tolerance", tolerance, f"a number from {_LEAST:g} to {_MOST:g}")
    if not t_end - t0 >= 1 / LARGEST:
        since = f"the start at t = {t0:g}" if t0 else "0"
        raise SceneError(f"t_end = {t_end!r} must be after {since}")
    span = t_end - t0
    for name, value in (("dt", dt), ("dt_max", dt_max)):
        ok = value is None or (is_number(value) and as_float(value) >= _SHORTEST * span)
        expected = f"a positive number, at least {_SHORTEST:g} of the whole time"
        require(ok, name, value, expected)
    breaks = real_array(options.breaks)
    ok = breaks.ndim == 1 and bool(np.isfinite(breaks).all())
    require(ok, "breaks", options.breaks, "a sequence of finite times")
    order_and_constant(options.scheme)  # refuses one whose local errors are not known
    longest = min(_LONGEST * span if dt_max is None else as_float(dt_max), span)
    least = 1e-9 * span
    inner = [t for t in np.unique(breaks).tolist() if t0 + least < t < t_end - least]
    first = min(span / 1000 if dt is None else as_float(dt), longest)
    control = span, longest, dt is None, [*inner, t_end]
    return StepPlan(np.array([t0]), first, as_float(tolerance), *control)


def _equal_steps(options: Options, t0: float, goes_on: bool) -> StepPlan:
    """Equal steps; a motion that goes on may end with a part of a step, as events do."""
    dt, t_end = options.dt, options.t_end
    choice = ", or give a tolerance, which chooses the steps" if dt is None else ""
    dt = positive(dt, "dt", f"a positive number{choice}")
    if t_end - t0 < dt * (1e-6 if goes_on else 1 - 1e-6):
        later = f"after the start at t = {t0:g}, by more than a millionth of dt"
        least = later if goes_on else f"at least one step dt = {dt!r}"
        raise SceneError(f"t_end = {t_end!r} must be {least}")
    expected = f"larger: its steps to t_end = {t_end!r} are more than {MOST_STEPS:.0e}"
    require((t_end - t0) / dt <= MOST_STEPS, "dt", dt, expected)
    # A remainder below 1e-6 steps is a rounding error of t_end / dt or of the times, not a step.
    rounding = rounding_of(t0, t_end) / dt
    require(rounding < 0.1, "dt", dt, f"larger, as times near t = {t0:g} s are rounded by as much")
    steps = math.ceil((t_end - t0) / dt - max(rounding, 1e-6))
    times = grid_from(t0, dt)(np.arange(steps + 1))
    times[0], times[-1] = t0, t_end
    return StepPlan(times, float(times[1] - times[0]))


def check_scene(scene: object, caller: str) -> None:
    """Refuse what is no scene."""
    if not isinstance(scene, Scene):
        raise SceneError(f"{caller} needs an fx_beam.Scene, not {shown(scene)}")


# -- Times at which equal steps end --------------------------------------------------------------


@dataclass(frozen=True)
class TimeGrid:
    """Ends of steps of the length dt [s], counted from a state; number `first` is its own."""

    origin: float
    first: int
    dt: float

    def __call__(self, number):
        """Time at the end of a step [s]; step 0 is the start."""
        return self.origin + (self.first + number) * self.dt


def rounding_of(*times: float) -> float:
    """Largest rounding error of the difference of two times [s]."""
    return 4 * math.ulp(max(map(abs, times)))


def grid_from(t: float, dt: float) -> TimeGrid:
    """Ends of steps from t [s] on: where a motion from zero has them, if t is one of them.

    So a motion in parts has the times of a motion as a whole, to the last digit.
    """
    number = round(t / dt)
    is_multiple = abs(number * dt - t) <= rounding_of(t)
    return TimeGrid(0.0, number, dt) if is_multiple else TimeGrid(t, 0, dt)
