"""Newton's method for the increment of a step: when it stops, in C (c/newton.h) and here."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fx_beam.errors import between, check_fields, whole

# A correction that rotates a node further than this [rad] is shortened to it. The first correction
# overshoots if the axial force makes the tangent nearly singular. For the pinned beam at dt 0.02
# this avoids halving every tenth step and costs no iteration.
LONGEST_TURN = 0.5
# Rounding error of the energy, relative to the energy of the step.
ENERGY_FLOOR = 4 * np.finfo(float).eps
# Largest next correction, relative to the tolerance, that is left out. It is predicted by quadratic
# convergence.
NEGLIGIBLE = 1e-6
# Largest number of searches for the members that points come near in a step.
SEARCHES = 8
_TURN = "a number between 0 and pi, a half turn [rad]"


@dataclass(frozen=True)
class NewtonOptions:
    """When Newton's method stops.

    Parameters
    ----------
    tolerance : float
        Largest entry of the last correction: displacements divided by the size of the scene (1 m
        for a single node), and rotations in radians. Convergence is quadratic: the remaining error
        is far smaller. In a stiff scene a small correction may do much work. Therefore the work of
        the last correction must also be at most 1e-4 times the tolerance times the energy of the
        step: for the whole scene, and for each beam and body with its own energy. The last
        correction may be larger if the next one, predicted by quadratic convergence, would be at
        most 1e-6 times the tolerance, and if its work is at most the tolerance times twice the
        kinetic energy, again for the whole scene and for each part.
    max_iterations : int
        Largest number of corrections; the step fails if it has not converged by then.
    max_turn : float
        Largest increment of a nodal rotation in a step [rad], below pi: the mid-point rule uses
        the tangent of half the increment, which is valid for less than a half turn.

    Raises
    ------
    SceneError
        If a value is out of range; the message names it.

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.NewtonOptions(tolerance=1e-8)
    NewtonOptions(tolerance=1e-08, max_iterations=40, max_turn=2.0)
    """

    tolerance: float = between(0, 1, default=1e-10)
    max_iterations: int = whole(1, default=40)
    max_turn: float = between(0, math.pi, _TURN, default=2.0)

    def __post_init__(self):
        check_fields(self)


def newton(
    correct: Callable[[], tuple[float, bool]], tolerance: float, most: int
) -> tuple[int, str]:
    """Number of corrections, and the criterion that ended them: "increment", "round-off", "".

    `correct` gives the size of a correction, and whether it may be round-off, as it is if the size
    is more than half of the last one.
    """
    last = np.inf
    for k in range(1, most + 1):
        size, may_be_round_off = correct()
        stuck = may_be_round_off and size > 0.5 * last
        if size <= tolerance or stuck:
            return k, "round-off" if stuck else "increment"
        last = size
    return most, ""
