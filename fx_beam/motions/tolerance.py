"""What a run is given whose steps are chosen by a tolerance."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.validation import LARGEST, as_float, is_number, numbers, require

# Limits of the tolerance. Newton's method and rounding disturb smaller errors.
_LEAST, _MOST = 1e-9, 0.1
# Shortest first or largest step that may be given, relative to the whole time.
_SHORTEST = 1e-10
# Largest step by default, relative to the whole time.
_LONGEST = 0.1


class Tolerance:
    """The options of a run with controlled steps, checked."""

    def __init__(
        self,
        tolerance: float,
        dt: float | None,
        dt_max: float | None,
        breaks: Sequence[float],
        times: tuple[float, float],
    ):
        t0, t_end = times[0], as_float(times[1])
        fits = _LEAST <= as_float(tolerance) <= _MOST
        require(fits, "tolerance", tolerance, f"a number from {_LEAST:g} to {_MOST:g}")
        require(is_number(times[1]), "t_end", times[1], "a finite number")
        if not t_end - t0 >= 1 / LARGEST:
            since = f"the start at t = {t0:g}" if t0 else "0"
            raise SceneError(f"t_end = {t_end!r} must be after {since}")
        shortest = _SHORTEST * (t_end - t0)
        for name, value in (("dt", dt), ("dt_max", dt_max)):
            fits = value is None or (is_number(value) and as_float(value) >= shortest)
            wanted = f"a positive number, at least {_SHORTEST:g} of the whole time"
            require(fits, name, value, wanted)
        inner = numbers(breaks)
        fits = inner.ndim == 1 and bool(np.isfinite(inner).all())
        require(fits, "breaks", breaks, "a sequence of finite times")
        #: The tolerance, and the whole time [s].
        self.value, self.span = as_float(tolerance), t_end - t0
        given = _LONGEST * self.span if dt_max is None else as_float(dt_max)
        #: Length of the largest step, and of the first one that is tried [s].
        self.longest = min(given, self.span)
        self.first = min(self.span / 1000 if dt is None else as_float(dt), self.longest)
        #: Whether a better first length is looked for.
        self.search = dt is None
        least = 1e-9 * self.span
        inside = [t for t in np.unique(inner).tolist() if t0 + least < t < t_end - least]
        #: Times at which steps end and the control begins anew, the last of them the end [s].
        self.breaks = [*inside, t_end]
