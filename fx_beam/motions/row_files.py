"""Rows of a motion that go to files for ParaView as they come, in place of memory."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.results.fields import RESULTANTS, at_ends
from fx_beam.results.files import replacing, replacing_all, writable
from fx_beam.results.paraview import Grid, write_collection
from fx_beam.results.solution import Solution
from fx_beam.step.recorded_histories import RecordedHistories
from fx_beam.step.recorder import Recorder
from fx_beam.step.row_steps import RowSteps, histories_of

from .evaluation import check_rates, variables_along
from .prepared import MotionSetup

# Which part of the time the solution so far may take to be saved.
_SHARE = 0.05


class _Written(NamedTuple):
    """Rows in files, which a single assignment replaces."""

    times: list[float] = []
    names: list[str] = []
    #: Blocks of the histories that stay in memory.
    small: list[dict[str, np.ndarray]] = []
    #: Rates that fit the joints at the last row, if those of steps do not.
    fitted: np.ndarray | None = None


class RowFiles:
    """Takes rows from a recorder and writes them; what a solution has besides stays in memory."""

    def __init__(self, prepared: MotionSetup, recorder: Recorder, file: Path | str):
        self._model, self._recorder = prepared.model, recorder
        if not self._model.scene.beams:
            raise SceneError("Record: a file for ParaView needs beams, and the scene has none")
        check_rates(recorder)
        self._path = writable(file, ("pvd",)).resolve()
        self._folder = self._path.with_suffix("")
        self._folder.mkdir(exist_ok=True)
        mesh = self._model.mesh
        self._grid = Grid(mesh.X, mesh.elements, mesh.beam_of_cell)
        self._written = _Written()
        self._saved, self._took = time.monotonic(), 0.0
        #: Whether a file could not be written.
        self._broken = False

    # -- Writing ------------------------------------------------------------------------------

    def write_rows(self) -> None:
        """Write the rows that the recorder has, which forgets them."""
        recorder, written = self._recorder, self._written
        new = len(written.times) - recorder.gone  # the recorder has the last two rows still
        if new >= recorder.rows or self._broken:
            return
        histories = histories_of(recorder)
        times = histories["t"][new:].tolist()
        try:
            names = self._write(histories, new)
            with replacing(self._path, durable=False) as file:
                times, names = written.times + times, written.names + names
                write_collection(file, times, names)
        except OSError:
            self._broken = True
            raise
        small = histories.small_rows(new) | {"t_level": histories["t_level"][new:]}
        fitted = histories.at_end(times[-1]).get("fitted")
        self._written = _Written(times, names, [*written.small, small], fitted)
        recorder.forget()

    def save(self, last: Callable[[RecordedHistories], Solution], always: bool = False) -> None:
        """Save the solution by a function of the last row, if this does not take too much time."""
        start = time.monotonic()
        if self._broken or not (always or start - self._saved > self._took / _SHARE):
            return
        last(self.histories(last=True)).save(self._folder / "end.npz")
        self._saved = time.monotonic()
        self._took = self._saved - start

    def _write(self, histories: RecordedHistories, new: int) -> list[str]:
        """Write the rows from one on; the names of their files beside the collection."""
        q, v, resultants = histories["q"], histories["v"], self._along(histories, new)
        first, folder = len(self._written.times), self._folder.name
        names = [f"{folder}_{first + i:05d}.vtu" for i in range(len(q) - new)]
        with replacing_all([self._folder / name for name in names]) as files:
            self._grid.write(files, q[new:], v[new:] if len(v) == len(q) else None, resultants)
        return [f"{folder}/{name}" for name in names]

    def _along(self, histories: RecordedHistories, new: int) -> dict[str, np.ndarray]:
        """Resultants and internal variables (rows, elements, points) of the rows from one on."""
        model, recorder = self._model, self._recorder
        beams = model.forms.beams
        assert beams is not None
        steps = RowSteps(recorder, new)
        values = steps.means(beams.resultants(steps.batch()))
        resultants = dict(zip(RESULTANTS, np.moveaxis(values, -1, 0), strict=True))
        forces = self._section_forces(histories["a"], new, values)
        for _, cells, name, history, column in variables_along(model):
            cell_values = resultants.setdefault(name, np.zeros_like(resultants["N"]))
            cell_values[:, cells] = histories[history][new:, cells][..., column]
        return {name: at_ends(values) for name, values in resultants.items()} | forces

    def _section_forces(self, a: np.ndarray, new: int, gauss: np.ndarray) -> dict[str, np.ndarray]:
        """N, Q and M (rows, elements, points) by the balance of elements, where that is known."""
        from .element_balance import ElementBalance

        recorder, mesh = self._recorder, self._model.mesh
        if len(a) < recorder.rows:
            return {}
        points = np.linspace(0.0, 1.0, mesh.elements.shape[1])
        values = np.empty((3, *gauss.shape[:2], len(points)))
        accelerations = a[new:].reshape(len(gauss), -1).copy()
        with suppress(ValueError):
            balance = ElementBalance(
                recorder, self._model.data.loaded_beams, accelerations, first=new
            )
            for number, cells in enumerate(mesh.cells):
                beam_points = gauss[:, cells].reshape(len(gauss), -1, 3)
                values[:, :, cells] = balance.of_beam(number).in_elements(beam_points, points)
            return dict(zip(RESULTANTS, values, strict=True))
        return {}

    @property
    def has_rows(self) -> bool:
        """Whether any rows are in files; else the recorder has all."""
        return bool(self._written.small)

    # -- What stays ---------------------------------------------------------------------------

    def histories(self, last: bool = False) -> RecordedHistories:
        """The histories of all rows, or of the last one, without those of the motion."""
        parts, written = slice(-1 if last else 0, None), self._written
        small = {
            name: np.concatenate([block[name][parts] for block in written.small[parts]])
            for name in written.small[0]
        }
        t, levels, rates = np.array(written.times[parts]), small.pop("t_level"), written.fitted
        fitted = None if rates is None else lambda: small | {"v": rates[None]}
        impact = self._recorder.first.impact
        return RecordedHistories(self._model, small, fitted, {}, t, lambda: levels, impact)
