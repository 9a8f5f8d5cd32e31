"""A spring, damper, friction and stops on the free coordinate of a joint."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from fx_beam.mechanics.impact import friction_slope, push
from fx_beam.scene.coordinate import Friction
from fx_beam.scene.joints import Joint
from fx_beam.scene.stop import Stop

from .damper_laws import DamperLaw
from .graph import Entry
from .spring_laws import SpringLaw

# A limit that no coordinate reaches; differences of infinities would be undefined.
_FAR = 1e300


@dataclass
class Actuator:
    """Spring, damper, friction, stops of one coordinate, with their values in the current step."""

    joint: Joint
    #: Stiffness, rest and viscosity.
    k: float
    rest: float
    c: float
    friction: Friction | None
    stop: Stop | None
    #: Dissipative part of the stops' force, relative to the elastic part.
    loss: float
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
    #: The same for the loss of the stops; the sum of both stops' forces, and its derivative.
    last_stop: tuple[float, float, float] | None = None
    stop_force: tuple[float, float] = (0.0, 0.0)
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
        if self.stop is not None:
            pushed, by_change = self._stop_forces(level)
            force, slope = force + pushed[1] - pushed[0], slope + by_change[1] - by_change[0]
            self.stop_force = float(pushed.sum()), float(by_change.sum())
        return float(force), float(slope)

    def _stop_forces(self, level: float) -> tuple[np.ndarray, np.ndarray]:
        """Forces (2,) of the lower and the upper stop, and their derivatives."""
        assert self.stop is not None
        signs, limits = np.array([1.0, -1.0]), limits_of(self.stop)
        start, end = (signs * (x - limits) for x in (self.start, self.start + self.change))
        pushed, slopes = push(self.stop.stiffness, start, end, level)
        return pushed, signs * slopes

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

    def switches(self, place: float) -> list[float]:
        """Distances from the stops at a coordinate, and the switches of the own energy."""
        found: list[float] = []
        if self.stop is not None:
            low, high = limits_of(self.stop)
            found += [place - low, high - place]
        if self.elastic is not None:
            found += self.elastic.switches(place - self.rest)
        return found

    def stored(self, place: float, internal: np.ndarray | None) -> float:
        """Energy stored in the spring [J] at a coordinate, with internal variables of all."""
        stretch = place - self.rest
        energy = self.k / 2 * stretch**2
        if self.elastic is not None:
            given = np.array(
                [stretch, stretch, 1.0, *(() if internal is None else internal[self.inside])]
            )
            energy += float(self.elastic(given)[3])
        if self.stop is not None:
            low, high = limits_of(self.stop)
            energy += self.stop.stiffness / 2 * max(low - place, place - high, 0.0) ** 2
        return energy

    def resistance(self, rate: float) -> float:
        """Force of damper, friction and the loss of stops at a rate."""
        force = self.c * rate if self.law is None else self.c * rate + self.law(rate)[0]
        if self.friction is not None:
            force += self.friction.force * math.tanh(rate / self.friction.speed)
        if self.loss:
            force += self.loss * self.stop_force[0] * self._sense(rate)
        return force

    def _sense(self, rate: float) -> float:
        assert self.stop is not None
        return math.tanh(rate / (self.stop.speed or 1.0))

    def tangent_stiffness(self, rate: float) -> float:
        """Derivative of the resistance by the coordinate: the loss of stops grows with them."""
        return self.loss * self.stop_force[1] * self._sense(rate) if self.loss else 0.0

    def tangent_damping(self, rate: float) -> float:
        """Derivative of the resistance for the next iteration."""
        slope = self.c if self.law is None else self.c + self.law(rate)[1]
        if self.friction is not None:
            self.last = friction_slope(rate / self.friction.speed, self.last)
            slope += self.friction.force / self.friction.speed * self.last[2]
        if self.loss:
            assert self.stop is not None
            speed = self.stop.speed or 1.0
            self.last_stop = friction_slope(rate / speed, self.last_stop)
            slope += self.loss * self.stop_force[0] / speed * self.last_stop[2]
        return slope


def limits_of(stop: Stop) -> np.ndarray:
    """Lower and upper limit (2,); out of reach where there is none."""
    low = -_FAR if stop.lower is None else stop.lower
    return np.array([low, _FAR if stop.upper is None else stop.upper])
