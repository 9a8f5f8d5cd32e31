"""Outputs under forces of inertia beside a state, to first order."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from fx_beam.equilibria.path_equations import PathEquations
from fx_beam.equilibria.small_loads import SmallForces
from fx_beam.errors import SceneError
from fx_beam.laws.interval import Rest
from fx_beam.motions.evaluation import solution_of
from fx_beam.motions.prepared import stats_of
from fx_beam.results.state import State
from fx_beam.scene.outputs import Output, check_linear
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.load_loop import LoadLoop
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import Record, Recorder

from .linearisation import Linearisation

# Error of first-order equilibrium from which on forces are not those of the stiffness.
_AGREE = 1e-6


def inertia_outputs(
    about: Linearisation, accelerations: np.ndarray, outputs: Mapping[str, Output]
) -> dict[str, np.ndarray]:
    """Changes (n, ...) of outputs, by name, under forces -M a, a (n, n_node, 3)."""
    check_linear(about.scene, outputs, "spectrum")
    if about.frame is not None:
        raise SceneError("spectrum: the state turns. Take modes of a state at rest")
    model, start = about.model, replace(about.start, t=about.factor)
    with model.lock:
        stats = stats_of(model, solver="sparse lu", static=True)
        forcing = LoadForcing(model, about.start.t)
        forcing.stay(start)
        loop = LoadLoop(forcing, NewtonOptions(), stats)
        path = PathEquations(loop)
        small = [_small_forces(about, path, start, a.ravel()) for a in accelerations]
        # Of each its states but that without forces, which all share.
        states = [start, *(state for each in small for state in each.states[1:])]
        recorder = Recorder(model, np.arange(len(states), dtype=float), Record())
        for state in states:
            loop.record(state, recorder)
    rest = Rest(forcing.time, np.full(len(states), start.t))
    solution = solution_of(recorder, stats, lambda: start, rest=rest)
    rows = np.insert(np.reshape(np.arange(1, len(states)), (len(small), -1)), 0, 0, axis=1)
    pairs, changes = [*zip(small, rows, strict=True)], dict[str, np.ndarray]()
    for name, output in outputs.items():
        values = solution.value(output)
        changes[name] = np.array([each.slope(values[numbers]) for each, numbers in pairs])
    return changes


def _small_forces(
    about: Linearisation, path: PathEquations, start: State, a: np.ndarray
) -> SmallForces:
    """The states under small parts of the forces of accelerations a (size,)."""
    force = -(about.model.masses.matrix @ a)
    x = about.stiffness.solve(about.unknown_forces(force))
    y, D = (about.columns @ x)[: path.model.reduction.free], about.at_nodes(x[:, None])[:, 0]
    small = SmallForces("spectrum", path, start, about.loads, y, D, force, a)
    if not small.error < _AGREE:
        raise SceneError(
            "spectrum: small motions there and back from the state differ, as friction slips, or "
            "a material yields. Take another state, or simulate the scene"
        )
    return small
