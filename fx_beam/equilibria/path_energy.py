"""Energies of the states of a path, and what the loads do between them."""

from __future__ import annotations

import numpy as np

from fx_beam.results.state import State
from fx_beam.step.load_loop import LoadLoop
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.row_steps import RowSteps


class PathEnergy:
    """Energies and member forces of states, and work in the steps between them [J]."""

    def __init__(self, loop: LoadLoop):
        self._loop, self._model = loop, loop.model

    def work_and_gain(self, old: State, new: State, D: np.ndarray) -> tuple[float, float, float]:
        """Work of the loads in a step, energy that the scene gains, and round-off of both."""
        model = self._model
        weight = 0.0 if model.masses.weight is None else float(model.masses.weight @ D)
        start, end = self.energy(old), self.energy(new)
        # Natural strains do work on forces whose rounding errors are those of places, not strains.
        sizes = abs(old.q) + abs(D) + model.units.nodes * bool(model.data.natural)
        rounding = 1e-14 * self._loop.change_of_sizes(D, sizes)
        rounding += 1e-12 * (max(abs(start), abs(end)) + abs(new.work) + abs(weight))
        return new.work - old.work + weight, end - start, rounding

    def energy(self, state: State) -> float:
        """Stored and dissipated energy of a state."""
        model = self._model
        stored = model.forms.strain_energy(state.q, state.internal, state.natural)
        springs = model.forms.compiled_points.energy(state.q, state.slides, state.spring_internal)
        return stored + springs + state.dissipated

    def largest_force(self, state: State) -> float:
        """The largest force in a member, times the size of the scene, or couple."""
        beams, recorder = self._model.forms.beams, Recorder(self._model, np.zeros(1), Record())
        if beams is None:
            return 0.0
        self._loop.record(state, recorder)
        with self._model.lock:
            N, Q, M = np.moveaxis(abs(beams.resultants(RowSteps(recorder).batch())), -1, 0)
        return float(max(self._model.mesh.size * max(N.max(), Q.max()), M.max()))
