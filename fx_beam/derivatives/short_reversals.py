"""Warning of friction whose rate reverses in too few steps, which their derivatives do not see."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fx_beam.scene.coordinate import SmoothFriction
from fx_beam.scene.measured import Measured, Read
from fx_beam.scene.outputs import Output
from fx_beam.scene.scene import Scene
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
    frictions, X = [*_frictions(model.scene)], model.mesh.X.reshape(-1)
    present, lengths = tape.present, tape.times.lengths
    if model.scheme.rates.at_rest or not (frictions and tape.is_whole and len(lengths)):
        return
    paths = []
    for first in range(present.first, present.end, _AT_ONCE):
        rows = np.arange(first, min(first + _AT_ONCE, present.end) + 1)
        states = tape.states(rows, "q", "slides")

        def read(array: str, entries: np.ndarray, states: dict = states) -> np.ndarray:
            return X[entries] if array == "X" else states[array][:, entries]

        coordinates = [friction.coordinate(read) for friction in frictions]
        paths.append(np.diff(coordinates, axis=1))
    rates = np.concatenate(paths, axis=1) / lengths
    for friction, rate in zip(frictions, rates, strict=True):
        fast = np.flatnonzero(abs(rate) > _SMALL * friction.speed)
        a, b = fast[:-1], fast[1:]
        short = (rate[a] * rate[b] < 0) & (b - a <= _NEEDED)
        for i in np.flatnonzero(short)[:1]:
            yield int(a[i]), int(b[i] - a[i] - 1), friction.owner, friction.speed


class _Friction(NamedTuple):
    """Friction with the smooth sign of a rate: below the speed it is viscous."""

    #: What of the scene it belongs to, as text.
    owner: str
    speed: float
    #: Its coordinate, as a sum of outputs with weights.
    terms: list[tuple[float, Measured]]

    def coordinate(self, read: Read) -> np.ndarray:
        """Values (n,) of the coordinate in n states."""
        return sum(weight * measured.values(read) for weight, measured in self.terms)


def _frictions(scene: Scene) -> Iterator[_Friction]:
    """All friction with the smooth sign of a rate."""
    quantities = {"slide": "slide", "rotation": "angle"}
    for joint in scene.joints:
        for name, coordinate in joint.coordinates.items():
            if isinstance(friction := coordinate.friction, SmoothFriction):
                terms = [(1.0, Measured(Output(quantities[name], joint)))]
                yield _Friction(f"joint {joint.number} {name}", float(friction.speed), terms)
    for gear in scene.gears:
        if isinstance(friction := gear.friction, SmoothFriction):
            outputs = [(term, Output(quantities[term.name], term.joint)) for term in gear.terms]
            terms = [(float(term.weight), Measured(output)) for term, output in outputs]
            yield _Friction(str(gear), float(friction.speed), terms)
    for line in scene.forces_between:
        if isinstance(friction := line.on.friction, SmoothFriction):
            terms = [(1.0, Measured(Output("length", line)))]
            yield _Friction(str(line), float(friction.speed), terms)
