"""Where within a step a contact or stop opens or closes, or the law of a spring switches."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import brentq

# How close behind the event the end of a step lies, relative to the step in which it was noticed.
_CLOSE = 1e-5
# How often the end is put further behind the event if rounding hides it.
_TRIES = 10


def switched(before: np.ndarray, after: np.ndarray) -> bool:
    """Whether one of some values has changed its sign."""
    return bool(((before < 0) != (after < 0)).any())


def end_behind_event(
    first: np.ndarray, values: Callable[[float], np.ndarray | None], t0: float, t1: float
) -> float | None:
    """End of a step [s] just behind the first change of a sign in a longer one from t0 to t1.

    `first` are the values at the start; `values` gives those after a step to a time, or where one
    of its sub-steps has changed a sign, and None if the step fails. Then the result is None.
    """

    def distance(t: float) -> float:
        """Positive before the first event, negative behind it."""
        if t == t0:
            return float(np.finfo(float).tiny)
        now = values(t)
        if now is None:
            raise ArithmeticError
        behind = (now < 0) != (first < 0)
        return float(-abs(now[behind]).max() if behind.any() else abs(now).min())

    close = _CLOSE * (t1 - t0)
    try:
        end = brentq(distance, t0, t1, xtol=close, rtol=1e-15)
        for number in range(_TRIES):
            end = min(end + 2**number * close, t1)
            if distance(end) <= 0:
                return end
    except (ArithmeticError, ValueError):  # the latter from brentq, without a change of the sign
        return None
    return t1
