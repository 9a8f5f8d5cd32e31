"""Numbers in pictures: as many digits as one reads, and times in a fitting unit."""

from __future__ import annotations

import math
from collections.abc import Sequence

_UNITS = (1e-3, 1e6, r"$\mu$s"), (1e-2, 1e3, "ms"), (math.inf, 1.0, "s")


def three_digits(value: float) -> str:
    """A number with three digits; up to 100 000 those before the point are all kept."""
    if 1000 <= abs(value) < 1e5:
        return f"{value:.0f}"
    return f"{float(f'{value:.3g}'):g}"


def time_unit(largest: float) -> tuple[float, str]:
    """Factor from seconds to a unit for times up to this one [s], and its name."""
    return next((factor, name) for limit, factor, name in _UNITS if largest < limit)


def clock(times: Sequence[float]) -> list[str]:
    """Times with their unit, all with the decimals that tell them apart."""
    factor, name = time_unit(max(times))
    shortest = min((b - a for a, b in zip(times[:-1], times[1:], strict=True) if b > a), default=0)
    decimals = 0
    while decimals < 6 and abs(math.remainder(factor * shortest, 10.0**-decimals)) > 1e-6:
        decimals += 1
    return [f"t = {factor * t:.{min(decimals, 4)}f} {name}" for t in times]
