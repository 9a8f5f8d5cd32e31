"""Forces along one line between points: values of their laws at given states, and derivatives."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from fx_beam.laws.point_laws import StepRule

from .line_laws import laws_of_forces
from .point_forces import PlacedForce, PointForces, Role

#: Forces at an instant, from places and rates at the start of a step.
AN_INSTANT = StepRule(0.0, turning=False, at_rest=False, instant=True)


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
        self._of = quantity
        along = [placed for placed in points.placed if placed.force.line == line]
        forces = [x for x in along if getattr(x.law.law, quantity) is not None]
        if quantity in ("length", "rate"):
            forces = forces[:1]  # all have them
        if rule is not None and forces:
            laws = laws_of_forces([placed.law.law for placed in forces], rule)
            places = [np.array(points.parameters.indices(law.parameters), int) for law in laws]
            triples = zip(forces, laws, places, strict=True)
            forces = [placed._replace(law=law, parameters=x) for placed, law, x in triples]
        self._forces = forces

    def values(self, steps: LineSteps) -> np.ndarray:
        """The values (k,)."""
        total = np.zeros(len(steps.q))
        for placed in self._forces:
            total += placed.law.function(self._of).in_rows(_given(placed, steps))[:, 0]
        return total

    def slopes(self, steps: LineSteps) -> Iterator[LineSlopes]:
        """Their derivatives by "q", "increment", "v", "spring internal", "points", "parameters"."""
        for placed in self._forces:
            parts = placed.slopes(self._of, _given(placed, steps))
            yield from (LineSlopes(*part) for part in parts if part[2].any())


def _given(placed: PlacedForce, steps: LineSteps) -> np.ndarray:
    """What the law of a force is given (k, given); nothing of an iteration before."""
    force, numbers = placed.force, np.tile(placed.numbers, (len(steps.q), 1))
    if force.role == Role.EXTERNAL:
        numbers[:, -1] = steps.factor
    dofs = np.array(force.dofs)
    motion = (np.where(dofs < 0, 0.0, x[:, dofs]) for x in (steps.q, steps.D, steps.v))
    remembered = np.zeros((len(steps.q), placed.law.law.iteration_memory))
    of_time = np.column_stack([steps.t, steps.dt])
    columns = [*motion, of_time, steps.internal[:, placed.variables], remembered, numbers]
    return np.hstack([*columns, steps.parameters[:, placed.parameters]])
