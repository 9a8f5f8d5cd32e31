"""Resultants and strain energy of the rows of a solution, where a user has replaced them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fx_beam.results.records import BeamResultants
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import arc_lengths, gauss_rule
from fx_beam.step.recorder import Recorder

from .assembly import Assembly


class ReplacedRows:
    """Resultants (cells, points, 3) at the rows of a record, if they are replaced."""

    def __init__(self, assembly: Assembly, recorder: Recorder):
        self._assembly, self._recorder = assembly, recorder
        self._rows: list[np.ndarray] = []

    def follow(self, update: Callable[[], object] | None = None) -> None:
        """Have resultants of the last step, and the energy after an `update`, in a new row."""
        form, rows = self._assembly.form, self._recorder.rows
        is_new = form.replaced and rows > len(self._rows)
        if is_new:
            self._rows.append(self._assembly.resultants())
        if update is not None:
            update()
        if is_new:
            self._recorder.arrays["energies"][rows - 1, 1] = form.strain_energy()

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

        solution.resultants_of_beam = resultants
        return solution
