"""Stress resultants as outputs: their derivatives by states and by numbers of the scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from fx_beam.fem.step_start import Part, StepStart
from fx_beam.laws.interval import Interval, instant
from fx_beam.scene.beam import Beam
from fx_beam.step.full_turns import without_turns
from fx_beam.step.model import Model
from fx_beam.step.tape import Part as TapePart
from fx_beam.step.tape import Tape

from .gradient import Gradient
from .linear_outputs import Places
from .natural_gradients import NaturalRows

# Length of the short step for the resultants at the start, relative to the first step.
_SHORT = 1e-9
#: Of natural strains of a sub-step, that before which they are; -1 stands for the start of the run.
NATURAL = {"natural": lambda k: max(k, 0), "natural_end": lambda k: k + 1}
_OF_NUMBERS = {"stiffness": "stiffness", "times": "retardation"}


class SubSteps:
    """The sub-steps of a tape, for which resultants are evaluated.

    `boundaries` are the sub-steps before which there are `states`.
    """

    def __init__(
        self,
        model: Model,
        tape: Tape,
        boundaries: np.ndarray,
        states: Mapping[str, np.ndarray],
        parameters: np.ndarray | None,
        natural: NaturalRows | None,
    ):
        self.natural = natural
        self.model, self._tape, self._states = model, tape, states
        self._boundaries = boundaries
        #: Values of the parameters (sub-steps, n) at the level of the scheme.
        self._parameters = parameters

    @classmethod
    def of(
        cls, model: Model, tape: Tape, boundaries: np.ndarray, states: Mapping[str, np.ndarray]
    ) -> SubSteps:
        """Those with the parameters and natural strains of a model."""
        values, of_scene, level = None, model.forms.parameters, model.scheme.rates.level
        if len(of_scene):
            t0 = tape.starts
            values = of_scene.over_steps(t0, t0 + tape.lengths, level)[:, 0]
        natural = NaturalRows(model, tape) if model.natural else None
        return cls(model, tape, boundaries, states, values, natural)

    @property
    def present(self) -> TapePart:
        """The sub-steps that are on the tape now."""
        return self._tape.present

    def load(self, k: int) -> tuple[float, float]:
        """Load factor at the end of load step k, and its increment in it."""
        return float(self._tape.memories[k]), float(self._tape.lengths[k])

    def places(self, k: int) -> tuple[int, int, int]:
        """Of the states before and after sub-step k, and of that a sub-step earlier."""
        before, after, earlier = np.searchsorted(self._boundaries, [k, k + 1, max(k - 1, 0)])
        return int(before), int(after), int(earlier)

    def part(self, k: int) -> Part:
        """Sub-step number k; -1 for the start of the run."""
        tape, model, states = self._tape, self.model, self._states
        first, i = max(k, 0), self.places(max(k, 0))
        q, internal = states["q"][i[0]], states["internal"][i[0]]
        shape = model.forms.internal_shape
        start = StepStart(q, internal=internal.reshape(shape) if internal.size else None)
        if self._parameters is not None:
            start = start._replace(parameters=self._parameters[first])
        if self.natural is not None:
            strains = self.natural.at(first), self.natural.at(k + 1)
            start = start._replace(natural=strains)
        t, dt = float(tape.starts[first]), float(tape.lengths[first])
        if k < 0:
            dt = _SHORT * tape.first_length
            return Part(instant(t, dt), self.moves * dt * states["v"][i[0]], start)
        D = without_turns(model, states["q"][i[1]] - q)
        beams = model.forms.beams
        if beams is not None and beams.needs_before:
            back = without_turns(model, q - states["q"][i[2]])
            start = start._replace(before=q - back, memory=float(tape.memories[k]))
        return Part(Interval(t, t + dt), D, start)

    @property
    def moves(self) -> float:
        """1 if the resultants at the start depend on rates, else 0."""
        beams = self.model.forms.beams
        return float(beams is not None and beams.resultants_move)


class ResultantOutput:
    """N, Q or M (n, points) of a beam at the rows (n,) of a run: means over their steps."""

    def __init__(self, of: SubSteps, beam: Beam, quantity: str, places: Places):
        self._of, model = of, of.model
        assert model.forms.beams is not None  # there is this one
        self._derivatives = model.forms.beams.derive_resultants()
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

    def pull(self, weights: np.ndarray, to: Gradient) -> None:
        """Add the derivatives of the sum of weights (n, points) times the resultant."""
        of, shape = self._of, self._of.model.forms.internal_shape
        for row, k, share in self._parts:
            if not weights[row].any():
                continue
            of_cells = np.zeros((*shape[:2], 3))
            of_cells[self._cells, :, self._component] = share * weights[row].reshape(-1, shape[1])
            part = of.part(k)
            by = self._derivatives.pull(part, of_cells)
            before, after, earlier = of.places(max(k, 0))
            q, D = to.at("q"), by.pop("increment", np.zeros(1))
            n = len(D)
            if k >= 0:
                q[after, :n] += D
                q[before, :n] -= D
            elif of.moves:
                to.at("v")[before, :n] += part.interval.length * D
            for name, place in (("start", before), ("before", earlier)):
                if name in by:
                    q[place, :n] += by.pop(name)
            if "internal" in by:
                to.at("internal")[before] += by.pop("internal").ravel()
            for name, boundary in NATURAL.items():
                if of.natural is not None and name in by:
                    of.natural.pull(boundary(k), by.pop(name), to)
            for i, value in zip(self._parameters, by.pop("parameters", ()), strict=False):
                to.add_number(*self._parameter(k, int(i)), float(value))
            for name, values in by.items():
                to.add_numbers(_OF_NUMBERS.get(name, name), values)

    def push(
        self, rows: int, of_state: Mapping[str, np.ndarray], changes: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Changes (rows, points, m) from those of the states and of the numbers of the scene."""
        of, shape, count = self._of, self._of.model.forms.internal_shape, len(changes["X"])
        found = np.zeros((rows, len(self._cells) * shape[1], count))
        for row, k, share in self._parts:
            part = of.part(k)
            before, after, earlier = of.places(max(k, 0))
            for j in range(count):
                q = of_state["q"][:, j]
                own: dict[str, Any] = {"start": q[before], "before": q[earlier]}
                own["increment"] = q[after] - q[before]
                if k < 0:
                    length = of.moves * part.interval.length
                    own["increment"] = length * of_state["v"][before, j]
                own["internal"] = of_state["internal"][before, j]
                own |= {n: changes[to][j] for n, to in _OF_NUMBERS.items() if to in changes}
                own["X"] = changes["X"][j]
                if of.natural is not None:
                    natural = of.natural
                    own |= {n: natural.push(at(k), changes, j) for n, at in NATURAL.items()}
                at = [self._parameter(k, int(i)) for i in self._parameters]
                values = [changes[name][j].ravel()[i] for name, i in at]
                own["parameters"] = np.array(values)
                change = self._derivatives.push(part, own)[self._cells, :, self._component]
                found[row, :, j] += share * change.ravel()
        return found

    def _parameter(self, k: int, i: int) -> tuple[str, int]:
        """Name and index of a parameter in a sub-step among the numbers."""
        if k < 0:
            return "parameters at the start", i
        return "parameters", 2 * k * self._of.model.sizes["parameters"] + i
