"""A start from which what joints leave in the rates of steps does not alternate.

Rates of steps keep a part b that joints do not allow (joints.md). From step to step it jumps to and
fro about a part that changes slowly. From rates without it, as they are given, it swings between
zero and twice this part; what that leaves in the motion makes forces be of order three where all
else is of order four. A motion that begins with the slow part has no swing.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np

from fx_beam.results.audit import Stats
from fx_beam.results.state import State
from fx_beam.step.forcing import Forcing
from fx_beam.step.model import Model
from fx_beam.step.stepper import Stepper


def smooth_start(
    model: Model, forcing: Forcing, stepper: Stepper, stats: Stats, state: State, dt: float
) -> State:
    """The state of initial rates with the slow part, found by a step of the length dt [s].

    The same state for schemes without sub-steps, whose forces are of order two.
    """
    if len(model.scheme.fractions) == 1 or (fits := model.fitted_rates) is None:
        return state
    counts = copy(vars(stats)) | {"ended_by": dict(stats.ended_by)}
    end = stepper.trial(state, state.t + dt).state
    vars(stats).update(counts)
    if end is None:
        return state
    driven = forcing.end_rates(np.array([end.t]), np.array([dt]))
    swing = fits.fit(end.q[None], end.v[None], end.slides[None], driven).corrections
    # The slow part is the mean of both ends, as the start fits; at the start it is normal to what
    # joints allow there.
    at_rest = np.zeros((1, model.couplings.driven))
    slow = fits.fit(state.q[None], swing / 2, state.slides[None], at_rest).corrections[0]
    # Driven motions give it; as the record has their work, that at the start is zero.
    given = state.v @ (model.mass @ slow) if model.couplings.driven else 0.0
    return replace(state, v=state.v + slow, work=state.work + given)
