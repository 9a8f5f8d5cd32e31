"""What beams, drag, forces at points and the scheme take in each step, and its derivatives."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from fx_beam.laws.interval import Part
from fx_beam.step.model import Model

from .gradient import Block, of_row
from .sub_steps import OF_POINTS, SubSteps


def why_no_losses(model: Model) -> str:
    """Why losses have no derivatives step by step; empty if they have."""
    members = model.points.members
    lose = members is not None and any(law.law.loss for law in members.laws)
    if lose:
        return "members touch with friction or losses"
    return "friction follows the force of a joint" if model.points.follow_joints else ""


class StepLosses:
    """Energies that are lost in the k sub-steps of a part of a tape, in the rows 1 to k."""

    def __init__(self, of: SubSteps):
        self._of = of

    def blocks(self, rows: np.ndarray) -> Iterator[Block]:
        """Their derivatives in some of the rows."""
        of, model = self._of, self._of.model
        # In statics the first step leads to the equilibrium without loads, which loses nothing.
        for row in rows[rows > int(model.scheme.rates.at_rest)].tolist():
            k = of.present.first + row - 1
            part = of.part(k)
            if model.scheme.rates.at_rest:
                model.forms.set_load(*of.load(k))
            for by in [] if model.forms.beams is None else model.forms.beams.losses_by(part):
                yield from of.in_step(row, k, by)
            if model.points.any_have("loss"):
                yield from self._of_points(row, k, part)

    def _of_points(self, row: int, k: int, part: Part) -> Iterator[Block]:
        """Derivatives of what forces at points lose."""
        of, points, states = self._of, self._of.model.points, self._of.states
        before, after, _ = of.places(k)
        start = {name: states[name][before] for name in ("v", "slides")}
        start["spring_internal"] = states["spring internal"][before]
        of.model.forms.parameters.use(part.start.parameters)
        points.begin(part.interval, part.start._replace(**start))
        by = points.losses_by(part.D, states["slides"][after] - start["slides"])
        for name, increment in (("q", "increment"), ("slides", "slide increment")):
            D = by.pop(increment)
            if D.size:
                yield of_row(name, row, by.pop(name) - D, before)
                yield of_row(name, row, D, after)
        yield from of.in_step(row, k, {OF_POINTS.get(name, name): by[name] for name in by})
