"""Derivatives of the energies of forces at points, by all that these are given."""

from __future__ import annotations

import itertools

import numpy as np

from .compiled_points import CompiledPoints
from .point_forces import PointForces


def energy_by(
    compiled_points: CompiledPoints,
    q: np.ndarray,
    slides: np.ndarray,
    internal: np.ndarray,
    parameters: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Derivatives (k, ...) of `energy` in k configurations, with values of the parameters.

    By "q", "slides", "spring internal", "points" (numbers) and "parameters"; with contact of
    members also by "members", their numbers, and the positions "X" of nodes.
    """
    points = compiled_points.points
    given = np.empty((len(q), len(points.given)))
    for i, of_row in enumerate(zip(q, slides, internal, strict=True)):
        if parameters is not None:
            compiled_points.set_parameters(parameters[i])
        compiled_points.energy(*of_row)  # which places all forces
        given[i] = points.given
    sums = _sums(points, "energy", given, q.shape[1], slides.shape[1])
    if points.members is not None:
        from .member_slopes import energy_by as energy_of_members

        sums |= energy_of_members(points.members, q, internal, sums)
    return sums


def losses_by(
    points: PointForces, given: np.ndarray, size: int, joints: int
) -> dict[str, np.ndarray]:
    """Derivatives (k, ...) of energy lost at mean rates, from k rows of `given_with`.

    By "q" and "slides" at the start, their "increment" and "slide increment", and the others
    as `energy_by`. Losses of members that touch are left out.
    """
    return _sums(points, "loss", given, size, joints)


def _sums(
    points: PointForces, quantity: str, given: np.ndarray, size: int, joints: int
) -> dict[str, np.ndarray]:
    """Derivatives (k, ...) of the sum of an energy of all forces by what they are given."""
    sizes = {"q": size, "slides": joints}
    if quantity == "loss":
        sizes |= {"increment": size, "slide increment": joints}
    sizes |= {"spring internal": points.width, "parameters": len(points.parameters)}
    sizes["points"] = sum(len(placed.numbers) for placed in points.placed)
    sums = {name: np.zeros((len(given), size)) for name, size in sizes.items()}
    ends = itertools.accumulate((len(placed.given) for placed in points.placed), initial=0)
    for placed, (begin, end) in zip(points.placed, itertools.pairwise(ends), strict=True):
        if getattr(placed.law.law, quantity) is not None:
            for name, entries, values in placed.slopes(quantity, given[:, begin:end]):
                if name in sums:
                    sums[name][:, entries] += values
    return sums


def by_load_factor(points: PointForces) -> np.ndarray:
    """Derivatives (numbers,) of the numbers of all forces by the load factor."""
    counts = [len(placed.numbers) for placed in points.placed]
    by_factor = np.zeros(sum(counts))
    by_factor[np.cumsum(counts, dtype=int)[points.external] - 1] = 1.0
    return by_factor
