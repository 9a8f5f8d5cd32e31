"""Resultants and strain energy of the rows of a solution, where a user has replaced them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fx_beam.results.records import BeamResultants
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import arc_lengths, gauss_rule
from fx_beam.step.recorder import Recorder

from .assembly import Assembly

# Place in a row of energies.
_STRAIN, _DISSIPATED = 1, 5


class ReplacedRows:
    """Resultants (cells, points, 3) at the rows of a record, if they are replaced."""

    def __init__(self, assembly: Assembly, recorder: Recorder):
        self._assembly, self._recorder = assembly, recorder
        self._rows: list[np.ndarray] = []

    def follow(self, update: Callable[[], object] | None = None) -> float:
        """Have resultants of the last step, and energies after an `update`, in a new row.

        Returns the energy that was lost in the step [J].
        """
        form, rows = self._assembly.form, self._recorder.rows
        is_new = form.replaced and rows > len(self._rows)
        if is_new:
            self._rows.append(self._assembly.resultants())
        if update is not None:
            update()
        lost = form.dissipated() if update is not None else 0.0
        if is_new:
            self._recorder.arrays["energies"][rows - 1, _STRAIN] = form.strain_energy()
            self._recorder.arrays["energies"][rows - 1, _DISSIPATED] += lost
        return lost

    def in_solution(self, solution: Solution) -> Solution:
        """The solution with the resultants of these rows."""
        if not self._assembly.form.replaced:
            return solution
        rows, model = np.array(self._rows), self._assembly.model
        pairs = zip(model.scene.beams, model.mesh.cells, strict=True)
        beams = {beam.name: (beam, cells) for beam, cells in pairs}

        def resultants(name: str) -> BeamResultants:
            beam, cells = beams[name]
            N, Q, M = np.moveaxis(rows[:, cells].reshape(len(rows), -1, 3), -1, 0)
            return BeamResultants(arc_lengths(beam, gauss_rule(beam.degree)[0]).ravel(), N, Q, M)

        solution.resultants_of_beam, solution.has_own_energy = resultants, True
        return solution
