"""Runs whose steps are chosen by a tolerance: checks of the options, and the run."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.stepping.adaptive_run import AdaptiveRun
from fx_beam.stepping.local_error import order_and_constant
from fx_beam.stepping.recorder import Recorder
from fx_beam.stepping.step_control import StepControl
from fx_beam.stepping.stepper import Stepper
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
        self.tolerance, self._t0, self._t_end = as_float(tolerance), t0, t_end
        given = _LONGEST * (t_end - t0) if dt_max is None else as_float(dt_max)
        self._longest = min(given, t_end - t0)
        self._search = dt is None
        first = (t_end - t0) / 1000 if dt is None else as_float(dt)
        #: Length of the first step to be tried [s].
        self.first = min(first, self._longest)
        least = 1e-9 * (t_end - t0)
        self._breaks = [t for t in np.unique(inner).tolist() if t0 + least < t < t_end - least]

    def run(self, integrator, stepper: Stepper, recorder: Recorder, max_halvings: int):
        """The run of an integrator, from which it can be advanced."""
        order, constant = order_and_constant(stepper.model.scheme)
        span = self._t_end - self._t0
        kinks = stepper.model.has_unseen_kinks
        control = StepControl(self.tolerance, order, constant, span, self._longest, kinks)
        control.begin(self.first)
        breaks = [*self._breaks, self._t_end]
        return AdaptiveRun(
            integrator, stepper.single, recorder, control, breaks, max_halvings, self._search
        )
