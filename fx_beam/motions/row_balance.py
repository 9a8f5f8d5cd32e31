"""Section forces in the last row of a motion that is recorded, from the balance of elements."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fx_beam.scene.outputs import Output, section_value
from fx_beam.step.model import Model
from fx_beam.step.recorder import Recorder
from fx_beam.step.row_steps import RowSteps

from .element_balance import ElementBalance, ElementLoads


class RowBalance:
    """The balance of the elements in the present state, which is computed once for all outputs.

    `now` gives what identifies the state, its record, and its accelerations (size,).
    """

    def __init__(self, model: Model, now: Callable[[], tuple[Any, Recorder, np.ndarray]]):
        self._model, self._now, self._state = model, now, None
        self._loads = ElementLoads(model, model.data.loaded_beams, model.mesh.X)
        self._balance: ElementBalance
        self._gauss: np.ndarray

    def value_of(self, output: Output) -> Callable[[], float]:
        """A function that reads an output at a place."""
        place: Any = output.of
        number = self._model.scene.beams.number_of(place.beam.name)
        cells = self._model.mesh.cells[number]

        def read() -> float:
            self._renew()
            gauss = self._gauss[:, cells].reshape(1, -1, 3)
            _, *forces = self._balance.of_beam(number).forces_at(gauss, place.s, "after")
            return float(section_value(output, *(force[0, 0] for force in forces)))

        return read

    def _renew(self) -> None:
        state, recorder, a = self._now()
        if state is self._state:
            return
        model, last, beams = self._model, recorder.rows - 1, self._model.forms.beams
        assert beams is not None  # as an output is of one
        with model.lock:
            steps = RowSteps(recorder, last)
            self._gauss = steps.means(beams.resultants(steps.batch()))
            self._balance = ElementBalance(
                recorder,
                model.data.loaded_beams,
                a[None].copy(),
                first=last,
                own_loads=self._loads,
            )
        self._state = state
