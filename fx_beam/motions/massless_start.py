"""Where parts without mass start: in equilibrium with the loads at the start."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import scipy.sparse.linalg

from fx_beam.laws.interval import instant
from fx_beam.results.state import State
from fx_beam.step.equations import Balance, Equations
from fx_beam.step.model import Model

_log = logging.getLogger("fx_beam")

# Last correction, in units of the scene, and one that may be the last if no smaller one follows.
_TOLERANCE, _STALLED = 1e-10, 1e-6
_MOST_CORRECTIONS, _MOST_HALVINGS = 30, 10
# Longest turn of a node in a correction [rad].
_LONGEST_TURN = 0.5


def settled(model: Model, force: np.ndarray, state: State, dt: float) -> State:
    """The state with its massless parts in equilibrium under dead forces (size,).

    In a time so short that mass and dampers hold all others. The state itself if that fails, or
    with internal variables, whose flow would depend on the way.
    """
    if state.internal is not None or state.spring_internal is not None:
        return state
    settling = _Settling(model, force, dt)
    zero = np.zeros(model.size)
    start = now = replace(state, v=zero, a=zero)
    unloaded = settling.balance(start).residual[: model.reduction.free]
    step, reached, halvings = 1.0, 0.0, 0
    while reached < 1:
        solution = settling.solved(now, (1 - min(1.0, reached + step)) * unloaded)
        if solution is not None:
            now, reached = solution, min(1.0, reached + step)
            continue
        step, halvings = step / 2, halvings + 1
        if halvings > _MOST_HALVINGS:
            _log.warning(
                "no equilibrium was found at the start for nodes without mass under the loads "
                "there. Their motion may alternate from step to step. Let the loads begin at zero, "
                "or start from static(scene)"
            )
            return state
    return replace(state, q=now.q, slides=now.slides)


class _Settling:
    """Newton's method for the positions of massless parts."""

    def __init__(self, model: Model, force: np.ndarray, dt: float):
        self._model, self._force, self._length = model, force, 1e-9 * dt
        self._equations = Equations(model)

    def balance(self, state: State) -> Balance:
        """The equations of a short step from a state, at its start."""
        self._equations.begin(instant(state.t, self._length), state)
        return self._equations.at_start(self._force)

    def solved(self, state: State, hold: np.ndarray) -> State | None:
        """The equilibrium near a state under forces (free,) that hold; None if none is found."""
        model, reduction, last = self._model, self._model.reduction, np.inf
        for _ in range(_MOST_CORRECTIONS):
            balance = self.balance(state)
            residual = balance.residual[: reduction.free] - hold
            tangent = self._equations.tangent(balance.r).tocsc()
            try:
                # The tangent is that of the scheme's level in the step.
                factors = scipy.sparse.linalg.splu(tangent)
            except RuntimeError:  # it is singular
                return None
            y = -model.scheme.rates.level * factors.solve(residual)
            D = reduction.expand(y, np.zeros(reduction.driven))
            turn = abs(D[model.turns]).max()
            if turn > _LONGEST_TURN:
                y *= _LONGEST_TURN / turn
                D = reduction.expand(y, np.zeros(reduction.driven))
            size = abs(D / model.unit).max()
            if not np.isfinite(size):
                return None
            slides = state.slides + model.couplings.free_slides(y, len(state.slides))
            state = replace(state, q=state.q + D, slides=slides)
            if size <= _TOLERANCE or _STALLED >= size > 0.5 * last:
                return state
            last = size
        return None
