"""Accelerations of the base of a scene, as functions of time or as records."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.dual import MaybeDual, dual_array, floats
from fx_beam.errors import SceneError, real_array

from .functions import ArrayCalls, Signal, check_takes_time
from .inputs import Input, TimeValue, time_function
from .loads import Load


class Shaking(NamedTuple):
    """The acceleration of the base of a scene along x and y; None where there is none.

    Returned by `Scene.shake`.

    Parameters
    ----------
    x, y : Load or None
        Each as `Scene.change` and `Scene.remove` take it.

    Examples
    --------
    >>> import math, fx_beam as fb
    >>> scene = fb.Scene()
    >>> shaking = scene.shake(y=lambda t: 3.0 * math.sin(20 * t))
    >>> print(shaking.y, shaking.x)
    shaking along y None
    """

    x: Load | None = None
    y: Load | None = None


class Accelerogram(Signal):
    """Values (1,) at times [s], with straight lines between, and zero before and after."""

    def __init__(self, times: np.ndarray, values: np.ndarray, name: str):
        super().__init__(self._at, 1, name)
        self.times, self.values = times, values

    def _at(self, t: MaybeDual) -> MaybeDual:
        times, places = floats(dual_array(self.times)), floats(t)
        is_recorded = (places >= times[0]) & (places <= times[-1])
        interpolated = np.interp(t, dual_array(self.times), dual_array(self.values))
        return np.where(is_recorded, interpolated, 0.0)

    def each(self, rows: MaybeDual, arrays: ArrayCalls | None = None, run: str = "") -> MaybeDual:
        """Values (n, 1) at times (n, 1) [s], by one call for all."""
        return self._at(rows)

    @property
    def spacing(self) -> float:
        """The median time between two samples [s]."""
        lengths = np.diff(floats(self.times))
        return float(np.median(lengths[lengths > 0]))

    def means(self, t0: np.ndarray, t1: np.ndarray) -> MaybeDual:
        """Mean values (n,) over intervals from t0 to t1 (n,) [s], whose lengths are not zero."""
        return (self._integral(t1) - self._integral(t0)) / (t1 - t0)

    def goes_over_samples(self, t0: np.ndarray, t1: np.ndarray) -> np.ndarray:
        """Flags (n,) of the intervals from t0 to t1 (n,) [s] that have a sample inside."""
        samples = floats(self.times)
        return np.searchsorted(samples, t0, "right") != np.searchsorted(samples, t1, "right")

    def _integral(self, t: np.ndarray) -> MaybeDual:
        """Its integral up to the times t (n,) [s]: trapezes to the sample before, and a rest."""
        times, values = dual_array(self.times), dual_array(self.values)
        areas = np.cumsum((values[1:] + values[:-1]) / 2 * np.diff(times))
        t = np.minimum(np.maximum(t, times[0]), times[-1])
        piece = np.searchsorted(floats(times)[1:-1], floats(t), "right")
        rest = (values[piece] + self._at(t)) / 2 * (t - times[piece])
        return np.append(0.0, areas)[piece] + rest


def acceleration(value: TimeValue, name: str) -> Signal:
    """An acceleration (1,) over time: a constant, a function, an `Input` or a record."""
    if not isinstance(value, list | tuple | np.ndarray) or getattr(value, "ndim", 1) == 0:
        if not isinstance(value, Input):
            check_takes_time(value, name)
        return time_function(value, 1, name)
    parts = [real_array(part) for part in value]
    ok = len(parts) == 2 and parts[0].ndim == 1 and parts[0].shape == parts[1].shape
    ok = ok and len(parts[0]) > 1 and bool(np.isfinite([floats(part) for part in parts]).all())
    if not ok:
        raise SceneError(
            f"{name}: a record has two lists of the same length, of at least two finite numbers: "
            "times [s] and accelerations [m/s^2]; or give a function of time"
        )
    steps = np.diff(floats(parts[0]))
    if (steps < 0).any() or not steps.any():
        late = int(np.argmax(steps < 0))
        raise SceneError(
            f"{name}: the times of a record must rise, but {floats(parts[0])[late + 1]:g} s comes "
            f"after {floats(parts[0])[late]:g} s. Sort it: order = np.argsort(times)"
        )
    return Accelerogram(parts[0], parts[1], name)
