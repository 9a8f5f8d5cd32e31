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
from fx_beam.validation import is_number, require

# Limits of the tolerance. Newton's method and rounding disturb smaller errors.
_LEAST, _MOST = 1e-9, 0.1
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
        t0, t_end = times
        fits = is_number(tolerance) and _LEAST <= tolerance <= _MOST
        require(fits, "tolerance", tolerance, f"a number from {_LEAST:g} to {_MOST:g}")
        require(is_number(t_end), "t_end", t_end, "a finite number")
        if t_end <= t0:
            since = f"the start at t = {t0:g}" if t0 else "0"
            raise SceneError(f"t_end = {t_end!r} must be after {since}")
        for name, value in (("dt", dt), ("dt_max", dt_max)):
            fits = value is None or (is_number(value) and value > 0)
            require(fits, name, value, "a positive number")
        try:
            inner = sorted(float(t) for t in breaks)
        except (TypeError, ValueError):
            inner = [np.nan]
        require(bool(np.isfinite(inner).all()), "breaks", breaks, "a sequence of finite times")
        self.tolerance, self._t0, self._t_end = tolerance, t0, float(t_end)
        self._longest = min(dt_max or _LONGEST * (t_end - t0), t_end - t0)
        self._search = dt is None
        #: Length of the first step to be tried [s].
        self.first = min(dt or (t_end - t0) / 1000, self._longest)
        least = 1e-9 * (t_end - t0)
        self._breaks = [t for t in dict.fromkeys(inner) if t0 + least < t < t_end - least]

    def run(self, integrator, stepper: Stepper, recorder: Recorder, max_halvings: int):
        """The run of an integrator, from which it can be advanced."""
        order, constant = order_and_constant(stepper.model.scheme)
        span = self._t_end - self._t0
        control = StepControl(self.tolerance, order, constant, span, self._longest)
        control.begin(self.first)
        breaks = [*self._breaks, self._t_end]
        return AdaptiveRun(
            integrator, stepper.single, recorder, control, breaks, max_halvings, self._search
        )
