"""What beams, drag, forces at points and the scheme take in each step, and its derivatives."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from fx_beam.step.model import Model

from .gradient import Gradient, along, sums_after, weights_of_steps
from .resultant_outputs import NATURAL, SubSteps


def why_no_losses(model: Model) -> str:
    """Why losses have no derivatives step by step; empty if they have."""
    members = model.points.members
    lose = members is not None and any(law.law.loss for law in members.laws)
    if lose:
        return "members touch with friction or losses"
    return "friction follows the force of a joint" if model.points.follow_joints else ""


@dataclass
class _Derivatives:
    """Those of the loss of a step: by states before some sub-steps, and by numbers."""

    of_state: list[tuple[str, int, np.ndarray]] = field(default_factory=list)
    of_numbers: list[tuple[str, np.ndarray]] = field(default_factory=list)
    picked: list[tuple[str, int, float]] = field(default_factory=list)
    #: By natural strains before a sub-step.
    natural: list[tuple[int, np.ndarray]] = field(default_factory=list)


class StepLosses:
    """Energies that are lost in the k sub-steps of a part of a tape, from the number `first` on.

    `ends` (n,) are the numbers of sub-steps of the part before the rows.
    """

    def __init__(self, of: SubSteps, states: Mapping[str, np.ndarray], ends: np.ndarray):
        self._of, self._states, self._part = of, states, of.present
        #: As those of `StepWork`.
        self.ends = ends
        # In statics the first one leads to the equilibrium without loads, which loses nothing.
        self._skipped = int(of.model.scheme.rates.at_rest)

    def _derivatives(self, k: int) -> _Derivatives:
        """Those of the loss of sub-step number k."""
        of, model, found = self._of, self._of.model, _Derivatives()
        part, (before, after, earlier) = of.part(k), of.places(k)
        forms = model.forms
        if model.scheme.rates.at_rest:
            forms.set_load(*of.load(k))
        if forms.beams is not None:
            for by in forms.beams.losses_by(part):
                D = by.pop("increment")
                found.of_state += [("q", after, D), ("q", before, -D)]
                for name, place in (("start", before), ("before", earlier)):
                    if name in by:
                        found.of_state.append(("q", place, by.pop(name)))
                if "internal" in by:
                    found.of_state.append(("internal", before, by.pop("internal").ravel()))
                for name, boundary in NATURAL.items():
                    if name in by:
                        found.natural.append((boundary(k), by.pop(name)))
                self._pick(k, by.pop("parameters", np.empty(0)), found)
                names = {"times": "retardation"}
                found.of_numbers += [(names.get(name, name), values) for name, values in by.items()]
        if model.points.any_have("loss"):
            self._add_points(k, found)
        return found

    def _add_points(self, k: int, found: _Derivatives) -> None:
        """Add the derivatives of what forces at points lose."""
        of, points, states = self._of, self._of.model.points, self._states
        part, (before, after, _) = of.part(k), of.places(k)
        start = {name: states[name][before] for name in ("v", "slides")}
        start["spring_internal"] = states["spring internal"][before]
        of.model.forms.parameters.use(part.start.parameters)
        points.begin(part.interval, part.start._replace(**start))
        by = points.losses_by(part.D, states["slides"][after] - start["slides"])
        for name, increment in (("q", "increment"), ("slides", "slide increment")):
            D = by[increment]
            found.of_state += [(name, before, by[name] - D), (name, after, D)]
        found.of_state.append(("spring internal", before, by["internal"]))
        found.of_numbers.append(("points", by["numbers"]))
        self._pick(k, by["parameters"], found)

    def _pick(self, k: int, by_parameters: np.ndarray, found: _Derivatives) -> None:
        """Add derivatives by the parameters (n,) at the level of a sub-step."""
        first = 2 * k * len(by_parameters)
        found.picked += [
            ("parameters", first + i, float(value)) for i, value in enumerate(by_parameters)
        ]

    def pull(self, weights: np.ndarray, later: float, to: Gradient) -> None:
        """Add the derivatives of the sum of weights (n,) times the losses, and `later` all."""
        first, end = self._part
        of_steps = weights_of_steps(self.ends, weights, later, end - first)
        of_steps[: self._skipped] = 0.0
        for i in np.flatnonzero(of_steps).tolist():
            weight, by = float(of_steps[i]), self._derivatives(first + i)
            for name, place, values in by.of_state:
                if values.size:
                    to.at(name)[place, : len(values)] += weight * values
            for name, values in by.of_numbers:
                to.add_numbers(name, weight * values)
            for name, index, value in by.picked:
                to.add_number(name, index, weight * value)
            for boundary, values in by.natural:
                assert self._of.natural is not None
                self._of.natural.pull(boundary, weight * values, to)

    def push(
        self, of_state: Mapping[str, np.ndarray], changes: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Changes (k + 1, m) of the losses before the first sub-step, and after each."""
        (first, end), count = self._part, len(changes["X"])
        of_steps = np.zeros((end - first, count))
        for row, k in zip(
            of_steps[self._skipped :], range(first + self._skipped, end), strict=True
        ):
            by = self._derivatives(k)
            for name, place, values in by.of_state:
                if values.size:
                    row += of_state[name][place][:, : len(values)] @ values
            for name, values in by.of_numbers:
                row += along(changes[name], values)
            for name, index, value in by.picked:
                row += value * changes[name].reshape(count, -1)[:, index]
            for boundary, values in by.natural:
                natural = self._of.natural
                assert natural is not None
                row += [(values * natural.push(boundary, changes, j)).sum() for j in range(count)]
        return sums_after(of_steps)
