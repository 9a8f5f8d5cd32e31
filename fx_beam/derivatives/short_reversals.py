"""Warning of friction whose rate reverses in too few steps, which their derivatives do not see."""

from __future__ import annotations

import logging
from collections.abc import Iterator

import numpy as np

from fx_beam.fem.frictions import smooth_signs_of
from fx_beam.step.model import Model
from fx_beam.step.tape import Tape

_log = logging.getLogger("fx_beam")
# Steps with a smaller rate than this part of the speed that derivatives need.
_NEEDED, _SMALL = 3, 2.0
# Configurations that are looked at together.
_AT_ONCE = 2**12


def warn_of_short_reversals(model: Model, tape: Tape) -> bool:
    """Warn of the first reversal of smooth friction in too few steps; whether there is one.

    Friction that sticks knows the times of its reversals (step/reversals.py).
    """
    first = min(_first_reversals(model, tape), default=None)
    if first is None:
        return False
    step, slow_steps, owner, speed = first
    _log.warning(
        "Response: SmoothFriction of %s: at t = %.6g its rate reverses with %d steps below %g "
        "times its speed %g. Derivatives behind are those of these steps and depend on where they "
        "fall, by up to their own size, if there are less than %d. Take shorter steps, a larger "
        "speed, or Coulomb friction, whose derivatives know the times of reversals",
        *(owner, tape.times.ends[step], slow_steps, _SMALL, speed, _NEEDED),
    )
    return True


def _first_reversals(model: Model, tape: Tape) -> Iterator[tuple[int, int, str, float]]:
    """For each friction: last step before a reversal, number of slow steps, name, and speed."""
    frictions = smooth_signs_of(model.points)
    present, lengths = tape.present, tape.times.lengths
    if not frictions or not tape.is_whole or not len(lengths):
        return
    paths = []
    for first in range(present.first, present.end, _AT_ONCE):
        rows = np.arange(first, min(first + _AT_ONCE, present.end) + 1)
        states = tape.states(rows, "q", "slides")
        coordinates = [sign.coordinate(states["q"], states["slides"]) for sign in frictions]
        paths.append(np.diff(coordinates, axis=1))
    rates = np.concatenate(paths, axis=1) / lengths
    for sign, rate in zip(frictions, rates, strict=True):
        fast = np.flatnonzero(abs(rate) > _SMALL * sign.speed)
        a, b = fast[:-1], fast[1:]
        short = (rate[a] * rate[b] < 0) & (b - a <= _NEEDED)
        for i in np.flatnonzero(short)[:1]:
            yield int(a[i]), int(b[i] - a[i] - 1), sign.owner, sign.speed
