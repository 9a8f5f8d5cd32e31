"""Line search: corrections of Newton's method that are far too long are shortened."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from .equations import Balance
from .model import Model

# A correction is too long if the residual does work against it at its end, by more than this part
# of that at its start. At most so many shorter ones are tried.
OVERSHOOT, SEARCHES = 0.1, 20


def line_search(
    model: Model,
    y: np.ndarray,
    step: np.ndarray,
    gained: float,
    balance: Balance,
    at: Callable[[np.ndarray], Balance],
) -> tuple[np.ndarray, Balance]:
    """Unknowns (free,) and equations where the residual does no more work on the last correction.

    Where a contact closes, or elements or springs unload that have flowed, the tangent is far too
    soft.
    """
    start = y + step
    if not model.may_overshoot_anywhere:
        # Springs alone: stiff members that turn do work as well, which does not count here.
        moved = np.zeros(model.reduction.columns)
        moved[: len(step)] = step
        correction = model.reduction.spread(moved)

        def of_springs(part: float) -> float:
            return gained * (1 - part) + model.points.deviation(correction, moved, part)

        part = _part(of_springs, gained, of_springs(1.0))
        return (y, balance) if part == 1 else (start - part * step, at(start - part * step))

    def work(part: float) -> float:
        nonlocal y, balance
        y = start - part * step
        balance = at(y)
        return float(balance.residual @ step)

    _part(work, gained, float(balance.residual @ step))
    return y, balance


def _part(work: Callable[[float], float], gained: float, at_end: float) -> float:
    """Part of a correction where the residual does no more work on it, by regula falsi."""
    part, low, high = 1.0, (0.0, gained), (1.0, at_end)
    if not 0 < OVERSHOOT * gained < -at_end:
        return part
    for _ in range(SEARCHES):
        part = (low[0] * high[1] - high[0] * low[1]) / (high[1] - low[1])
        at_part = work(part)
        if abs(at_part) <= OVERSHOOT * gained:
            break
        if at_part > 0:
            low, high = (part, at_part), (high[0], high[1] / 2)
        else:
            low, high = (low[0], low[1] / 2), (part, at_part)
    return part
