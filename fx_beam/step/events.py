"""Where within a step a contact or stop opens or closes, or the law of a spring switches."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

# How close behind the event the end of a step lies, relative to the step in which it was noticed.
_CLOSE = 1e-5
# Largest number of trials.
_TRIALS = 60


def switched(earlier: np.ndarray, later: np.ndarray) -> bool:
    """Whether one of some values has changed its sign."""
    return bool(((earlier < 0) != (later < 0)).any())


def end_behind_event(
    first: np.ndarray, values: Callable[[float], np.ndarray | None], t0: float, t1: float
) -> float | None:
    """End of a step [s] just behind the first change of a sign in a longer one from t0 to t1.

    `first` are the values at the start; `values` gives those after a step to a time, or where one
    of its sub-steps has changed a sign, and None if the step fails. Then the result is None.
    """
    current = values(t1)
    if current is None or not switched(first, current):
        return None
    # The motion is smooth up to the event; a stiff contact bends it behind.
    known_points, end, close = [(t0, first)], t1, _CLOSE * (t1 - t0)
    changing, last = (first < 0) != (current < 0), np.inf
    for _ in range(_TRIALS):
        start = known_points[-1][0]
        if end - start < 2 * close:
            break
        t = _zero([(time, value[changing]) for time, value in known_points]) + close / 2
        if len(known_points) > 2 and abs(t - end) < close / 4:  # just behind the event, as it seems
            t = end - close
        if not start < t < end - close / 4 or t == last:
            t = (start + end) / 2
        current, last = values(t), t
        if current is None:
            return None
        if switched(first, current):
            changing |= (first < 0) != (current < 0)
            end = t
        else:
            known_points = [*known_points[-2:], (t, current)]
    return end


def _zero(points: list[tuple[float, np.ndarray]]) -> float:
    """Time of the next zero of the parabolas through values at times; inf without one."""
    times, values = map(np.array, zip(*points, strict=True))
    if len(times) < 2:
        return np.inf
    unit = times[-1] - times[0]
    zeros = [
        root.real
        for column in values.T
        for root in np.roots(np.polyfit((times - times[-1]) / unit, column, len(times) - 1))
        if abs(root.imag) < 1e-6 and root.real > 0
    ]
    return times[-1] + unit * min(zeros, default=np.inf)
