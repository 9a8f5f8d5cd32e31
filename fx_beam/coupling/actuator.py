"""A spring, damper and friction on the free coordinate of a joint."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from fx_beam.scene.coordinate import Friction
from fx_beam.scene.joints import Joint

from .damper_laws import DamperLaw
from .graph import Entry
from .spring_laws import SpringLaw


@dataclass
class Actuator:
    """Spring, damper and friction on one coordinate, with their values in the current step."""

    joint: Joint
    #: Stiffness, rest and viscosity.
    k: float
    rest: float
    c: float
    friction: Friction | None
    law: DamperLaw | None
    #: Stored energy of its own, the place of its internal variables among all, and what the
    #: `SpringLaw` is given and finds.
    elastic: SpringLaw | None
    inside: slice
    #: Rotations of a and b (-1 for the ground); None for a slide.
    turns: tuple[int, int] | None
    #: Columns and signs of the coordinate; for a rotation those of a (subtracted) and of b.
    columns: tuple[list[Entry], list[Entry]]
    start: float = 0.0
    rate: float = 0.0
    change: float = 0.0
    force: float = 0.0
    dissipated: float = 0.0
    slopes: tuple[float, float] = (0.0, 0.0)
    #: Friction in the last iteration: rate / speed, force / magnitude, and derivative.
    last: tuple[float, float, float] | None = None
    given: np.ndarray = field(init=False)
    found: np.ndarray = field(init=False)
    #: Change of the coordinate, force and slope of the own energy, where the tangent is from.
    tangent: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self):
        if self.elastic is not None:
            self.given = np.zeros(3 + self.elastic.variables)

    def spring(self, level: float) -> tuple[float, float]:
        """Force of the spring at a scheme's level of the step, and its derivative."""
        force, slope = self.k * (self.start + level * self.change - self.rest), level * self.k
        if self.elastic is not None:
            self.given[0] = self.start - self.rest
            self.given[1] = self.given[0] + self.change
            self.found = self.elastic(self.given)
            force, slope = force + self.found[0], slope + self.found[1]
        return float(force), float(slope)

    def remember(self) -> None:
        """Keep the tangent of the own energy for `deviation`."""
        self.tangent = self.change, float(self.found[0]), float(self.found[1])

    def deviation(self, back: float) -> float:
        """Force of the own energy minus that by the tangent, at a change smaller by `back`."""
        assert self.elastic is not None
        change, force, slope = self.tangent
        given, now = self.given.copy(), self.change + back
        given[1] = given[0] + now
        return float(self.elastic(given)[0]) - force - slope * (now - change)

    def stored(self, place: float, internal: np.ndarray | None) -> float:
        """Energy stored in the spring [J] at a coordinate, with internal variables of all."""
        stretch = place - self.rest
        energy = self.k / 2 * stretch**2
        if self.elastic is not None:
            given = np.array(
                [stretch, stretch, 1.0, *(() if internal is None else internal[self.inside])]
            )
            energy += float(self.elastic(given)[3])
        return energy

    def resistance(self, rate: float) -> float:
        """Force of damper and friction at a rate."""
        force = self.c * rate if self.law is None else self.c * rate + self.law(rate)[0]
        if self.friction is not None:
            force += self.friction.force * math.tanh(rate / self.friction.speed)
        return force

    def steepness(self, rate: float) -> float:
        """Derivative of the resistance for the next iteration."""
        slope = self.c if self.law is None else self.c + self.law(rate)[1]
        if self.friction is not None:
            self.last = friction_slope(rate / self.friction.speed, self.last)
            slope += self.friction.force / self.friction.speed * self.last[2]
        return slope


def friction_slope(x: float, last: tuple[float, float, float] | None) -> tuple[float, float, float]:
    """x, y = tanh(x), and a derivative with which Newton's method does not jump to and fro.

    With s = x / y the friction is s y = x, whose linear form has the derivative (1 - y s') / s. For
    y it takes what the last iteration expected, limited to 1 (Chan, Golub and Mulet 1999, doi
    10.1137/S1064827596299767). Where both agree it is that of tanh.
    """
    if last is not None and x == last[0]:
        return last  # the same iteration
    y = math.tanh(x)
    near = abs(x) < 1e-4
    s, bend = (1.0, 2 * x / 3) if near else (x / y, (1 - (1 - y * y) * x / y) / y)
    expected = y
    if last is not None:
        expected = min(1.0, max(-1.0, last[1] + last[2] * (x - last[0])))
    return x, y, (1 - expected * bend) / s
