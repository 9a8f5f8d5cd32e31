"""Forces along one line between points: values of their laws at given states, and derivatives."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from fx_beam.laws.point_laws import StepRule, arguments

from .line_laws import laws_of_forces
from .point_forces import PlacedForce, PointForces, Role

#: Forces at an instant, from places and rates at the start of a step.
AN_INSTANT = StepRule(0.0, turning=False, at_rest=False, instant=True)
_MOTION = "q", "increment", "v"


class LineSteps(NamedTuple):
    """What forces along a line read of k steps, or of k states if nothing moves."""

    #: Displacements (k, size) at the start, increments, and rates at the start.
    q: np.ndarray
    D: np.ndarray
    v: np.ndarray
    #: Times (k,) at the scheme's level, lengths, and load factors.
    t: np.ndarray
    dt: np.ndarray
    factor: np.ndarray
    #: Internal variables (k, width) of springs at the start, and parameters (k, n).
    internal: np.ndarray
    parameters: np.ndarray

    @staticmethod
    def of_states(
        q: np.ndarray, internal: np.ndarray | None, parameters: np.ndarray | None
    ) -> LineSteps:
        """States (k, ...)."""
        count, none = len(q), np.zeros_like(q)
        few = [np.zeros((count, 0)) if x is None else x for x in (internal, parameters)]
        return LineSteps(q, none, none, np.zeros(count), np.ones(count), np.ones(count), *few)


class LineSlopes(NamedTuple):
    """Derivatives (k, e) of a value of a force by entries of what it reads, by its name there."""

    name: str
    entries: np.ndarray
    by: np.ndarray


class LineValues:
    """The "pull" or stored "energy" of all forces along a line, or its "length" or "rate".

    The pull is that in steps, or by a `rule` of its own.
    """

    def __init__(self, points: PointForces, line: int, quantity: str, rule: StepRule | None = None):
        self._of, self._points = quantity, points
        forces = [
            placed for placed in points.along(line) if getattr(placed.law.law, quantity) is not None
        ]
        if quantity in ("length", "rate"):
            forces = forces[:1]  # all have them
        laws = [placed.law for placed in forces]
        if rule is not None and laws:
            laws = laws_of_forces([law.law for law in laws], rule)
        self._forces = [*zip(forces, laws, strict=True)]

    def values(self, steps: LineSteps) -> np.ndarray:
        """The values (k,)."""
        total = np.zeros(len(steps.q))
        for placed, law in self._forces:
            total += law.function(self._of).in_rows(self._given(placed, law, steps))[:, 0]
        return total

    def slopes(self, steps: LineSteps) -> Iterator[LineSlopes]:
        """Their derivatives by "q", "increment", "v", "spring internal", "points", "parameters"."""
        for placed, law in self._forces:
            slopes = law.derivatives(self._of).in_rows(self._given(placed, law, steps))
            size, first = law.law.size, 3 * law.law.size + 2
            internal, last = law.law.internal, arguments(law.law)
            numbers = last - law.law.numbers
            # A node may be there twice.
            dofs = np.array(placed.force.dofs)
            entries = np.unique(dofs[dofs >= 0])
            places = (dofs == entries[:, None]).T.astype(float)
            motion = (slopes[:, i : i + size] @ places for i in (0, size, 2 * size))
            parts = [
                *((name, entries, values) for name, values in zip(_MOTION, motion, strict=True)),
                ("spring internal", placed.variables, slopes[:, first : first + internal]),
                (
                    "points",
                    placed.first_number + np.arange(last - numbers),
                    slopes[:, numbers:last],
                ),
                ("parameters", self._points.parameters_of(law), slopes[:, last:]),
            ]
            yield from (LineSlopes(*part) for part in parts if part[2].any())

    def _given(self, placed: PlacedForce, law: Any, steps: LineSteps) -> np.ndarray:
        """What a law is given (k, given); nothing of an iteration before."""
        force, numbers = placed.force, np.tile(placed.numbers, (len(steps.q), 1))
        if force.role == Role.EXTERNAL:
            numbers[:, -1] = steps.factor
        dofs = np.array(force.dofs)
        motion = (np.where(dofs < 0, 0.0, x[:, dofs]) for x in (steps.q, steps.D, steps.v))
        remembered = np.zeros((len(steps.q), law.law.iteration_memory))
        of_time = np.column_stack([steps.t, steps.dt])
        columns = [*motion, of_time, steps.internal[:, placed.variables], remembered, numbers]
        return np.hstack([*columns, steps.parameters[:, self._points.parameters_of(law)]])
