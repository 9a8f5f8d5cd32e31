"""The sub-steps of a tape, as outputs that are not linear in the states see them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.laws.interval import Interval, Part, StepStart, instant
from fx_beam.step.full_turns import without_turns
from fx_beam.step.model import Model
from fx_beam.step.tape import Tape

from .gradient import Block, of_row

#: States (n, ...) before some sub-steps, by the names of the derivatives by them.
StatesAt = Callable[[np.ndarray], dict[str, np.ndarray]]
# Length of the short step for the resultants at the start, relative to the first step.
_SHORT = 1e-9
#: Of natural strains of a sub-step, that before which they are; -1 stands for the start of the run.
NATURAL: dict[str, Callable[[int], int]] = {
    "natural": lambda k: max(k, 0),
    "natural_end": lambda k: k + 1,
}
#: Numbers and internal variables of forces at points by their names in laws.
OF_POINTS = {"internal": "spring internal", "numbers": "points"}


class NaturalRows:
    """The natural strains of a run before some sub-steps, or at its end."""

    def __init__(self, model: Model, tape: Tape):
        self._strains = model.natural
        times = np.append(tape.times.starts, tape.times.ends[-1])
        if model.scheme.rates.at_rest:  # in proportion to the load
            times, factors = times[-1:], np.append(0.0, tape.memories)
            self._factors = factors[:, None] * self._strains.series(times)
        else:
            self._factors = self._strains.series(times)
        columns = self._strains.unit_loads
        #: Of each value of the columns its strain and its column.
        self._rows = columns.indices
        self._of = np.repeat(np.arange(columns.shape[1]), np.diff(columns.indptr))

    def at(self, boundary: int) -> np.ndarray:
        """The strains (cells, degree, 3) before a sub-step."""
        return (self._strains.unit_loads @ self._factors[boundary]).reshape(self._strains.shape)

    def blocks(self, row: int, boundary: int, by: np.ndarray) -> Iterator[Block]:
        """Derivatives of a row by numbers, from those by the strains before a sub-step."""
        if boundary == 0:
            yield of_row("natural", row, by)
            return
        of_values, columns = by.ravel()[self._rows], self._strains.unit_loads
        yield of_row("natural columns", row, of_values * self._factors[boundary][self._of])
        of_columns = np.bincount(self._of, of_values * columns.data, columns.shape[1])
        yield of_row("naturals", row, of_columns, boundary - 1)

    def jvp(self, boundary: int, changes: Mapping[str, np.ndarray]) -> np.ndarray:
        """The changes (m, values) of the strains before a sub-step."""
        if boundary == 0:
            return changes["natural"]
        columns, factors = self._strains.unit_loads, self._factors[boundary]
        of_values = changes["natural columns"] * factors[self._of]
        changed = [np.bincount(self._rows, of, columns.shape[0]) for of in of_values]
        more = changes["naturals"].reshape(len(changed), -1, len(factors))[:, boundary - 1]
        return np.array(changed) + (columns @ more.T).T


class SubSteps:
    """The sub-steps of a tape, with the states before some of them, `boundaries`."""

    def __init__(self, model: Model, tape: Tape, boundaries: np.ndarray, states_at: StatesAt):
        self.model, self.tape, self.boundaries, self._states_at = model, tape, boundaries, states_at
        of_scene, level = model.forms.parameters, model.scheme.rates.level
        #: Values of the parameters (sub-steps, 2, n) at the level of the scheme and at the ends.
        self._parameters = None
        if len(of_scene):
            self._parameters = of_scene.over_steps(tape.times.starts, tape.times.ends, level)
            self._at_start = of_scene.at(float(tape.times.starts[0]))
        self.natural = NaturalRows(model, tape) if model.natural else None
        # Length of the short step for the resultants at the start [s], and 1 if these depend on
        # rates, else 0.
        self._short, beams = _SHORT * tape.first_length, model.forms.beams
        self._moves = float(beams is not None and beams.facts.resultants_move)

    @cached_property
    def states(self) -> dict[str, np.ndarray]:
        """The states (n, ...), which are read if an output is not linear in them."""
        return self._states_at(self.boundaries)

    def places(self, k: int) -> tuple[int, int, int]:
        """Of the states before and after sub-step k, and of that a sub-step earlier."""
        first = max(k, 0)
        at = np.searchsorted(self.boundaries, [first, first + 1, max(first - 1, 0)])
        return int(at[0]), int(at[1]), int(at[2])

    def row(self, place: int) -> dict[str, np.ndarray]:
        """A state by name, with the parameters and natural strains at this time."""
        row = {name: values[place] for name, values in self.states.items()}
        boundary = int(self.boundaries[place])
        if self._parameters is not None:
            row["parameters"] = self._parameters[boundary - 1, 1] if boundary else self._at_start
        if self.natural is not None:
            row["natural"] = self.natural.at(boundary)
        return row

    def part(self, k: int) -> Part:
        """Sub-step number k; -1 for the start of the run."""
        tape, model, states = self.tape, self.model, self.states
        first, i = max(k, 0), self.places(k)
        q, internal = states["q"][i[0]], states["internal"][i[0]]
        shape = model.forms.internal_shape
        start = StepStart(q, internal=internal.reshape(shape) if internal.size else None)
        if self._parameters is not None:
            start = start._replace(parameters=self._parameters[first, 0])
        if self.natural is not None:
            strains = self.natural.at(first), self.natural.at(k + 1)
            start = start._replace(natural=strains)
        t, dt = float(tape.times.starts[first]), float(tape.times.lengths[first])
        if k < 0:
            dt = self._short
            return Part(instant(t, dt), self._moves * dt * states["v"][i[0]], start)
        D = without_turns(model, states["q"][i[1]] - q)
        beams = model.forms.beams
        if beams is not None and beams.facts.needs_previous:
            back = without_turns(model, q - states["q"][i[2]])
            start = start._replace(q_previous=q - back, memory=float(tape.memories[k]))
        return Part(Interval(t, t + dt), D, start)

    # -- Derivatives of a row, from those by what belongs to a state or a sub-step -----------------

    def at_state(self, row: int, place: int, by: Mapping[str, np.ndarray]) -> Iterator[Block]:
        """From those by what `row` has of a state, and by numbers of the scene."""
        boundary, given = int(self.boundaries[place]), _there(by)
        if (values := given.pop("parameters", None)) is not None:
            yield self.of_parameters(row, boundary - 1, values, 1)
        if (values := given.pop("natural", None)) is not None and self.natural is not None:
            yield from self.natural.blocks(row, boundary, values)
        for name, values in given.items():
            yield of_row(name, row, values, place if name in self.states else None)

    def sources(self, k: int) -> Iterator[tuple[str, str, int, float]]:
        """What forms read of sub-step k, or of the start of the run, as sums of states.

        Its name, the array and its place, and a factor.
        """
        before, after, earlier = self.places(k)
        if k >= 0:
            yield from (("increment", "q", after, 1.0), ("increment", "q", before, -1.0))
        else:
            yield "increment", "v", before, self._moves * self._short
        yield from (("start", "q", before, 1.0), ("q_previous", "q", earlier, 1.0))
        yield from ((name, name, before, 1.0) for name in ("internal", "spring internal"))

    def in_step(self, row: int, k: int, by: Mapping[str, np.ndarray]) -> Iterator[Block]:
        """From those by what forms read of sub-step k, or of the start of the run."""
        given, read = _there(by), set()
        for name, array, place, factor in self.sources(k):
            read.add(name)
            if name in given and factor:
                yield of_row(array, row, factor * given[name], place)
        given = {name: values for name, values in given.items() if name not in read}
        for name, boundary in NATURAL.items():
            if name in given and self.natural is not None:
                yield from self.natural.blocks(row, boundary(k), given.pop(name))
        if (values := given.pop("parameters", None)) is not None:
            yield self.of_parameters(row, k, values)
        for name, values in given.items():
            yield of_row(name, row, values)

    @staticmethod
    def of_parameters(row: int, k: int, values: np.ndarray, at_end: int = 0) -> Block:
        """From those by the parameters (n,) at the level or the end of sub-step k."""
        if k < 0:
            return of_row("parameters at the start", row, values)
        return of_row("parameters", row, values, k, at_end * values.size)


def _there(by: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Derivatives that are not empty."""
    return {name: values for name, values in by.items() if values.size}
