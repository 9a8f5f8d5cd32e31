"""Forces at single nodes in UFL: drag, and forces that turn with the section."""

from __future__ import annotations

import functools
import itertools
from typing import Any

import ufl

from .point_laws import TINY, Found, Motion, PointLaw

_PARTS_OF_DRAG = "linear", "quadratic", "rotation"


@functools.cache
def drag(linear: bool, quadratic: bool, rotation: bool) -> PointLaw:
    """(linear + quadratic |v|) v and a moment against the spin, at the scheme's level.

    The law is given only the numbers, and the coordinates, of what it has: without a quadratic part
    there is no root, and no derivative by the other component.
    """
    moves = linear or quadratic

    def against(motion: Motion, v: list[Any]) -> list[Any]:
        numbers, forces = iter(motion.numbers), []
        if moves:
            along = next(numbers) if linear else ufl.as_ufl(0.0)
            if quadratic:
                along += next(numbers) * ufl.sqrt(v[0] * v[0] + v[1] * v[1] + TINY)
            forces += [along * v[0], along * v[1]]
        return [*forces, next(numbers) * v[-1]] if rotation else forces

    def mean(motion: Motion) -> list[Any]:
        paths = list(motion.increment)
        if rotation:
            paths[-1] = motion.path(paths[-1])
        return [motion.mean_rate(path) for path in paths]

    def forces(motion: Motion) -> Found:
        rates = zip(motion.rates, mean(motion), strict=True)
        return Found(against(motion, [motion.rate_at_level(v0, v) for v0, v in rates]))

    def loss(motion: Motion) -> Any:
        v = mean(motion)
        return sum(f * x for f, x in zip(against(motion, v), v, strict=True)) * motion.dt

    name = "drag " + ", ".join(itertools.compress(_PARTS_OF_DRAG, (linear, quadratic, rotation)))
    return PointLaw(name, 2 * moves + rotation, linear + quadratic + rotation, forces, loss=loss)


def _follower(motion: Motion) -> Found:
    psi = motion.at_level(motion.start[2], motion.increment[2])
    x, y, factor = motion.numbers
    c, s = factor * ufl.cos(psi), factor * ufl.sin(psi)
    return Found([s * y - c * x, -s * x - c * y, ufl.as_ufl(0.0)])


#: R(psi) F, with psi and F at the scheme's level; numbers: F, load factor. It has no potential,
#: and its tangent is not symmetric.
FOLLOWER = PointLaw("follower force", 3, 3, _follower)
