"""The sub-steps of a tape, as outputs that are not linear in the states see them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.laws.interval import INSTANT, Parts
from fx_beam.step.full_turns import without_turns
from fx_beam.step.model import Model
from fx_beam.step.tape import Tape

from .gradient import Block, of_rows

#: States (n, ...) before some sub-steps, by the names of the derivatives by them.
StatesAt = Callable[[np.ndarray], dict[str, np.ndarray]]
# Degrees of freedom of the sub-steps that are evaluated at once.
_MOST = 2**16


class SubSteps:
    """The sub-steps of a tape, with the states before some of them, `boundaries`.

    Rows, and sub-steps or boundaries of each, are one of `groups`.
    """

    def __init__(self, model: Model, tape: Tape, boundaries: np.ndarray, states_at: StatesAt):
        self.model, self.tape, self.boundaries, self._states_at = model, tape, boundaries, states_at
        of_scene, self._level = model.forms.parameters, model.scheme.rates.level
        #: Values of the parameters (sub-steps, 2, n) at the level of the scheme and at the ends.
        self._parameters = None
        if len(of_scene):
            times = tape.times
            self._parameters = of_scene.over_steps(times.starts, times.ends, self._level)
            self._at_start = of_scene.at(float(times.starts[0]))[None]
        # Length of the short step for the resultants at the start [s], and 1 if these depend on
        # rates, else 0.
        self._short, beams = INSTANT * tape.first_length, model.forms.beams
        self._moves = float(beams is not None and beams.facts.resultants_move)

    @cached_property
    def states(self) -> dict[str, np.ndarray]:
        """The states (n, ...), which are read if an output is not linear in them."""
        return self._states_at(self.boundaries)

    def groups(self, steps: np.ndarray) -> Iterator[np.ndarray]:
        """Indices of sub-steps or boundaries that are evaluated at once.

        The start of the run is one; where something is read before them, also the first sub-step.
        """
        most = max(1, _MOST // self.model.size)
        first = (steps == 0) & (self.model.forms.needs_previous or self._parameters is not None)
        for group in (steps < 0, first, (steps >= 0) & ~first):
            indices = np.flatnonzero(group)
            yield from (indices[i : i + most] for i in range(0, len(indices), most))

    def places(self, steps: np.ndarray) -> np.ndarray:
        """Places (3, k) of states before and after sub-steps, and of those a sub-step earlier."""
        first = np.maximum(steps, 0)
        return np.searchsorted(self.boundaries, [first, first + 1, np.maximum(first - 1, 0)])

    def at(self, boundaries: np.ndarray) -> dict[str, np.ndarray]:
        """States (k, ...) by name, with the parameters at their times."""
        places = np.searchsorted(self.boundaries, boundaries)
        rows = {name: values[places] for name, values in self.states.items()}
        if self._parameters is not None:
            at_end = boundaries[0] > 0
            rows["parameters"] = self._parameters[boundaries - 1, 1] if at_end else self._at_start
        return rows

    def parts(self, steps: np.ndarray) -> Parts:
        """Sub-steps by their numbers; -1 for the start of the run."""
        tape, model, states = self.tape, self.model, self.states
        first, (before, after, _) = np.maximum(steps, 0), self.places(steps)
        q, dt, of_start = states["q"][before], tape.times.lengths[first], steps[0] < 0
        if of_start:
            dt = np.full(len(steps), self._short)
            D = self._moves * self._short * states["v"][before]
            q = q - self._level * D
        else:
            D = without_turns(model, states["q"][after] - q)
        given = {name: states[name][before] for name in ("internal", "natural")}
        given["q_previous"] = states["q previous"][before]
        given["natural_end"] = states["natural"][before if of_start else after]
        if self._parameters is not None:
            given["parameters"] = self._at_start if of_start else self._parameters[first, 0]
        if model.forms.needs_previous:
            given["memory"] = 0 * dt if of_start else tape.memories[steps]
        return Parts(tape.times.starts[first] + self._level * dt * (steps >= 0), dt, D, q, **given)

    # -- Derivatives of rows, from those by what belongs to states or sub-steps --------------------

    def at_states(
        self, rows: np.ndarray, boundaries: np.ndarray, by: Mapping[str, np.ndarray]
    ) -> Iterator[Block]:
        """From those (k, ...) by what `at` has of states, and by numbers of the scene."""
        given, places = _there(by), np.searchsorted(self.boundaries, boundaries)
        for name in [name for name in given if name in self.states]:
            yield of_rows(name, rows, given.pop(name), places)
        yield from self._by_numbers(rows, boundaries - 1, given, at_end=1)

    def sources(self, steps: np.ndarray) -> Iterator[tuple[str, str, np.ndarray, float]]:
        """What forms read of sub-steps, or of the start of the run, as sums of states.

        Its name, the array and its places (k,), and a factor.
        """
        before, after, earlier = self.places(steps)
        if steps[0] >= 0:
            yield from (("increment", "q", after, 1.0), ("increment", "q", before, -1.0))
        else:
            moved = self._moves * self._short
            yield "increment", "v", before, moved
            yield "start", "v", before, -self._level * moved
        yield "start", "q", before, 1.0
        if steps[0] or not self.tape.memories[0]:  # else it is a number, of what came before
            yield "q_previous", "q", earlier, 1.0
        yield "natural_end", "natural", after if steps[0] >= 0 else before, 1.0
        for name in ("natural", "internal", "spring internal"):
            yield name, name, before, 1.0

    def in_steps(
        self, rows: np.ndarray, steps: np.ndarray, by: Mapping[str, np.ndarray]
    ) -> Iterator[Block]:
        """From those (k, ...) by what forms read of sub-steps, or of the start of the run."""
        given, read = _there(by), set()
        for name, array, places, factor in self.sources(steps):
            read.add(name)
            if name in given and factor:
                yield of_rows(array, rows, factor * given[name], places)
        numbers = {name.replace("_", " "): of for name, of in given.items() if name not in read}
        yield from self._by_numbers(rows, steps, numbers)

    @staticmethod
    def _by_numbers(
        rows: np.ndarray, steps: np.ndarray, by: Mapping[str, np.ndarray], at_end: int = 0
    ) -> Iterator[Block]:
        """Those by numbers, of which parameters are at the level of sub-steps, or at their ends."""
        for name, values in by.items():
            if name != "parameters":
                yield of_rows(name, rows, values)
            elif steps[0] < 0:
                yield of_rows("parameters at the start", rows, values)
            else:
                yield of_rows(name, rows, values, steps, at_end * values.shape[1])


def _there(by: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Derivatives that are not empty."""
    return {name: values for name, values in by.items() if values.size}
