"""Whether a state is an equilibrium, at rest in a frame that may turn."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from fx_beam.errors import SceneError
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import COMPONENTS

from .linearisation import Linearisation

# Forces without balance in a state that is called an equilibrium, relative to the largest force;
# rounding errors, relative to stiffness times the size of the scene.
_BALANCED, _ROUNDING = 1e-4, 1e-13
# Amplitude of the motion in it, relative to the size of the scene.
_AT_REST = 1e-3
_ADVICE = (
    "Take the state from static(scene), and for a scene that turns steadily from "
    "static(scene, spin=...)"
)


def check_equilibrium(about: Linearisation, state: Solution | None, what: str) -> None:
    """Refuse the last row of a state in which forces or rates are left; errors say `what` asks."""
    if state is None:
        return
    _check_balance(about, what)
    if not state.stats.static:
        _check_rest(about, state, what)


def _check_balance(about: Linearisation, what: str) -> None:
    model = about.model
    unit = model.unit_of_unknowns[about.unknowns]
    left = abs(about.unbalanced) * unit
    rounding = _ROUNDING * (unit * (abs(about.K) @ unit)).max()
    if left.max() <= _BALANCED * about.largest + rounding:
        return
    worst = int(left.argmax())
    moved = model.to_nodes(abs(about.T[:, [worst]].toarray()[:, 0]) / model.unit)
    if moved[:, 2].any():  # a rotation, which may move other nodes
        moved[:, :2] = 0.0
    node, component = np.unravel_index(moved.argmax(), moved.shape)
    x, y = model.mesh.X[node]
    force, of = left[worst] / unit[worst], "N m" if component == 2 else "N"
    raise SceneError(
        f"{what}: the state is no equilibrium: {force:.3g} {of} in {COMPONENTS[component]} of node "
        f"{node} at ({x:g}, {y:g}) has no balance; the largest force in the state is "
        f"{about.largest / model.mesh.size:.3g} N. {_ADVICE}"
    )


def _check_rest(about: Linearisation, state: Solution, what: str) -> None:
    rates = state.v[-1] if len(state.v) else getattr(state.end, "v", None)
    if rates is None or not rates.any():
        return
    model, T = about.model, about.T
    v = model.from_nodes(rates)
    weighted = T.T @ scipy.sparse.diags(model.unit**-2)
    w = scipy.sparse.linalg.spsolve((weighted @ T).tocsc(), weighted @ v)
    # The amplitude of a vibration that passes with these rates, in units of the scene.
    speed = abs(v / model.unit).max()
    stiffness = abs(w @ (about.K @ w))
    amplitude = speed * np.sqrt(w @ (about.M @ w) / stiffness) if stiffness else np.inf
    if amplitude > _AT_REST:
        raise SceneError(
            f"{what}: the state is no equilibrium, since it moves on, at up to "
            f"{speed * model.mesh.size:.3g} m/s. {_ADVICE}"
        )
