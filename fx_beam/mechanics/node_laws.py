"""Forces at single nodes in UFL: drag, and forces that turn with the section."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import ufl

from .point_laws import TINY, Found, Motion, PointLaw


def _against_velocity(motion: Motion, v: list[Any]) -> list[Any]:
    linear, quadratic = motion.numbers
    along = linear + quadratic * ufl.sqrt(v[0] * v[0] + v[1] * v[1] + TINY)
    return [along * v[0], along * v[1]]


def _against_spin(motion: Motion, v: list[Any]) -> list[Any]:
    return [motion.numbers[0] * v[0]]


def _drag(name: str, size: int, numbers: int, against: Callable, path: Callable) -> PointLaw:
    """Forces `against` rates, from the increments with which they do work, the `path`."""

    def mean(motion: Motion) -> list[Any]:
        return [motion.mean_rate(path(motion, D)) for D in motion.increment]

    def forces(motion: Motion) -> Found:
        rates = zip(motion.rates, mean(motion), strict=True)
        return Found(against(motion, [motion.rate_at_level(v0, v) for v0, v in rates]))

    def loss(motion: Motion) -> Any:
        v = mean(motion)
        return sum(f * x for f, x in zip(against(motion, v), v, strict=True)) * motion.dt

    return PointLaw(name, size, numbers, forces, loss=loss)


def _follower(motion: Motion) -> Found:
    psi = motion.at_level(motion.start[2], motion.increment[2])
    x, y, factor = motion.numbers
    c, s = factor * ufl.cos(psi), factor * ufl.sin(psi)
    return Found([s * y - c * x, -s * x - c * y, ufl.as_ufl(0.0)])


#: (linear + quadratic |v|) v at the velocity of the scheme's level; numbers: linear, quadratic.
DRAG = _drag("drag", 2, 2, _against_velocity, lambda motion, D: D)
#: A moment against the spin; number: its coefficient.
SPIN_DRAG = _drag("drag of the spin", 1, 1, _against_spin, Motion.path)
#: R(psi) F, with psi and F at the scheme's level; numbers: F, load factor. It has no potential,
#: and its tangent is not symmetric.
FOLLOWER = PointLaw("follower force", 3, 3, _follower)
