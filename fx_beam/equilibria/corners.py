"""Corners of a path: where plastic flow starts, a contact closes or a law of springs has a kink.

A step round a corner consists of a part along the tangent before it and one along that behind it.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.laws.interval import Interval
from fx_beam.results.state import State
from fx_beam.step.load_loop import StepSolution
from fx_beam.step.step_failures import StepFailed

from .path_equations import PathEquations, Tangent

# Largest part of an increment beside the two tangents of a corner.
_BESIDE = 0.1
# Largest deviation of half of the path behind a corner from its tangent.
_BENT = 0.1


class Corner(NamedTuple):
    """Lengths of a step along the tangents before and behind a corner."""

    first: float
    last: float


def corner_in(
    path: PathEquations, D: np.ndarray, load: float, first: Tangent, last: Tangent
) -> Corner | None:
    """The corner round which an increment (D, l) goes; None if it is not a sum of two tangents.

    Only paths of scenes in which forces may have kinks have corners.
    """
    if not path.model.kinks.any:
        return None
    # Imported here: most paths have no corner, and the import takes time.
    from scipy.optimize import nnls

    root = np.append(np.sqrt(path.weight), 1.0)
    tangents = np.column_stack([root * np.append(t.D, t.load) for t in (first, last)])
    step = root * np.append(D, load)
    lengths, _ = nnls(tangents, step)
    rest = step - tangents @ lengths
    # Displacements alone as well: those of stiff scenes are small beside the load factor.
    fits = (np.linalg.norm(rest[:n]) <= _BESIDE * np.linalg.norm(step[:n]) for n in (-1, None))
    return Corner(*lengths) if all(fits) else None


def has_corner(path: PathEquations, old: State, new: State, step: StepSolution) -> bool:
    """Whether the path has a corner in a load step, and is straight on both sides of it.

    A step round the corner and half of the way behind it must be on the path as well, and the
    determinant of the tangent must keep its sign.
    """
    load = new.t - old.t
    if not (load and path.model.kinks.any):
        return False
    try:
        path.set_start(old)
        first, last = path.with_the_load(0 * step.y, 0.0), path.with_the_load(step.y, load)
        corner = corner_in(path, step.D, load, first, last)
        if corner is None or first.sense != last.sense:
            return False
        middle = old.t + corner.first * first.load + corner.last / 2 * last.load
        D = path.loop.step(old, Interval(old.t, middle))[1].D
    except StepFailed:
        return False
    half = corner.last / 2 * last.D
    rest = D - corner.first * first.D - half
    return path.is_still(rest) or path.size(rest) <= _BENT * path.size(half)
