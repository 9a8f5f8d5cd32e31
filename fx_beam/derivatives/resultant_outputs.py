"""Stress resultants as outputs: their derivatives by states and by numbers of the scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fx_beam.scene.beam import Beam

from .gradient import Gradient, vjp
from .linear_outputs import Places
from .sub_steps import NATURAL, OF_NUMBERS, SubSteps


class ResultantOutput:
    """N, Q or M (n, points) of a beam at the rows (n,) of a run: means over their steps."""

    def __init__(self, of: SubSteps, beam: Beam, quantity: str, places: Places):
        self._of, model = of, of.model
        assert model.forms.beams is not None  # there is this one
        self._derivatives = model.forms.beams.derived_resultants
        names = [own.name for own in model.scene.beams]
        self._cells = model.mesh.cells[names.index(beam.name)]
        self._component = "NQM".index(quantity)
        steps, start = places.steps, places.at_start
        rows, ones = np.append(steps.of, start), np.ones(len(start))
        numbers = np.append(steps.sub_steps, -np.ones(len(start), dtype=int))
        #: Rows, numbers and shares of the sub-steps.
        self._parts = [*zip(rows.tolist(), numbers.tolist(), [*steps.shares, *ones], strict=True)]
        indices = model.forms.beams.parameters[1]
        self._parameters = np.array(indices, dtype=int)

    def vjp(self, weights: np.ndarray, to: Gradient) -> None:
        """Add the derivatives of the sum of weights (n, points) times the resultant."""
        of, shape = self._of, self._of.model.forms.internal_shape
        for row, k, share in self._parts:
            if not weights[row].any():
                continue
            of_cells = np.zeros((*shape[:2], 3))
            of_cells[self._cells, :, self._component] = share * weights[row].reshape(-1, shape[1])
            by = self._derivatives.vjp(of.part(k), of_cells)
            if "parameters" in by:
                own, by["parameters"] = by["parameters"], np.zeros(of.model.sizes["parameters"])
                by["parameters"][self._parameters] = own
            vjp(of.in_step(0, k, by), np.ones(1), to)

    def jvp(
        self, rows: int, of_state: Mapping[str, np.ndarray], changes: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Changes (rows, points, m) from those of the states and of the numbers of the scene."""
        of, shape, count = self._of, self._of.model.forms.internal_shape, len(changes["X"])
        found = np.zeros((rows, len(self._cells) * shape[1], count))
        for row, k, share in self._parts:
            part, read = of.part(k), dict[str, Any]()
            for name, array, place, factor in of.sources(k):
                if array in of_state:
                    read[name] = read.get(name, 0.0) + factor * of_state[array][place]
            for j in range(count):
                own = {name: values[j] for name, values in read.items()}
                own |= {n: changes[to][j] for n, to in OF_NUMBERS.items() if to in changes}
                own["X"] = changes["X"][j]
                if of.natural is not None:
                    natural = of.natural
                    own |= {n: natural.jvp(at(k), changes, j) for n, at in NATURAL.items()}
                if self._parameters.size:
                    name = "parameters at the start" if k < 0 else "parameters"
                    values = changes[name][j] if k < 0 else changes[name][j, k, 0]
                    own["parameters"] = values[self._parameters]
                change = self._derivatives.jvp(part, own)[self._cells, :, self._component]
                found[row, :, j] += share * change.ravel()
        return found
