"""Accelerations of the base of a scene, as functions of time or as records."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.dual import floats
from fx_beam.errors import SceneError, real_array

from .functions import Accelerogram, Signal, check_takes_time
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
