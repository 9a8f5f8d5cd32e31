"""The first step from a bifurcation along a branch.

Beside the path that is known, the branch leaves along a null vector of the tangent. The first state
on it lies in a plane normal to this vector, at a distance from the bifurcation: neither the known
path nor the bifurcation itself meets this plane, and the equations are regular there.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from fx_beam.results.state import State
from fx_beam.step.step_failures import StepFailed

from .arc_length import ArcLength
from .path_equations import Tangent

# Length of the first step, as the root mean square over the nodes in units of the scene.
_FIRST = 0.02
# No step is shorter.
_LEAST = 1e-9
# Largest deviation of the first step from the mode, relative to its length: not through a wall.
_NEAR = 0.3


def first_step(
    arc: ArcLength, state: State, shape: np.ndarray, steps: int, max_cuts: int
) -> tuple[State, Tangent, float]:
    """State, tangent and length of the first step along a null vector (size,) of a bifurcation.

    It changes the load factor by at most 1/`steps`, and goes at most half the way to 1. StepFailed
    if it fails after so many cuts.
    """
    path, model = arc.stepper.path, arc.model
    path.begin(state)
    path.balance(np.zeros(model.reduction.free), 0.0)
    y = unknowns_of(model, shape)
    D = path.spread(y, 0.0)
    length = path.length(D, 0.0)
    across = Tangent(y / length, D / length, 0.0)
    half_way = 2 / (1 - state.t) if state.t < 1 else 0.0
    distance, cuts = _FIRST, 0
    while True:
        try:
            new, ahead = arc.step(state, across, distance)
            if arc.stepper.deviation > _NEAR and cuts < max_cuts:
                raise StepFailed("off the path", "the step leaves the mode", new.q - state.q, [])
        except StepFailed:
            if cuts == max_cuts:
                raise
            arc.stepper.stats.halvings, cuts = arc.stepper.stats.halvings + 1, cuts + 1
            distance /= 2
            continue
        # The load factor changes with the distance or its square.
        rise = new.t - state.t
        excess = max(steps * abs(rise), half_way * rise)
        if excess <= 1 or distance <= _LEAST:
            return new, ahead, distance
        distance *= min(0.5, excess**-0.5)


def is_equilibrium(arc: ArcLength, state: State) -> bool:
    """Whether the loads and internal forces of a state are in balance."""
    path, model = arc.stepper.path, arc.model
    path.begin(state)
    balance, _, _ = path.balance(np.zeros(model.reduction.free), 0.0)
    left = abs(balance.residual[: model.reduction.free] * model.unit_of_unknowns)
    return bool(left.max(initial=0.0) <= 1e-5 * abs(balance.f * model.unit).max())


def unknowns_of(model, shape: np.ndarray) -> np.ndarray:
    """Unknowns (free,) nearest to a small motion (size,) of all degrees of freedom."""
    reduction = model.reduction
    columns = reduction.independent
    T = reduction.coupling()[:, columns]
    weighted = T.T @ scipy.sparse.diags(model.unit**-2)
    w = np.zeros(reduction.columns)
    w[columns] = scipy.sparse.linalg.spsolve((weighted @ T).tocsc(), weighted @ shape)
    return reduction.completed(w)[: reduction.free]
