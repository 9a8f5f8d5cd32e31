"""The sub-steps of a tape, as outputs that are not linear in the states see them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.dual import floats
from fx_beam.laws.interval import INSTANT, StepBatch
from fx_beam.step.full_turns import without_turns
from fx_beam.step.model import Model
from fx_beam.step.tape import Tape

from .gradient import Block, of_rows


class Source(NamedTuple):
    """A term of a field `name` that forms read, in the sub-steps `which` (k,)."""

    name: str
    which: np.ndarray
    #: An array of states, or of numbers with a row for each sub-step, and places (k,) in it; or
    #: without places all numbers of this name.
    array: str
    places: np.ndarray | None = None
    factor: float = 1.0


# Degrees of freedom of the sub-steps that are evaluated at once.
_MOST = 2**16


class SubSteps:
    """The sub-steps of a tape, with the states before some of them, `boundaries`.

    Rows, and sub-steps or boundaries of each, are one of `groups`.
    """

    def __init__(
        self,
        model: Model,
        tape: Tape,
        boundaries: np.ndarray,
        by_places: bool = True,
        of_forces: bool = False,
    ):
        self.model, self.tape, self.boundaries = model, tape, boundaries
        #: Whether derivatives by the positions of nodes are wanted.
        self.by_places = by_places
        #: Name of the rates of nodes.
        self.rates = "rates" if model.fits_rates else "v"
        of_scene, self._level = model.forms.parameters, model.scheme.rates.level
        #: Values of the parameters (sub-steps, 2, n) at the level of the scheme and at the ends.
        self._parameters = None
        if len(of_scene):
            times = tape.times
            arguments = times.starts, times.ends, self._level
            self._parameters = floats(of_scene.of_time.over_steps(*arguments))
            self._at_start = of_scene.at(float(times.starts[0]))[None]
        # Length of the short step for the resultants at the start [s], and 1 if these, or all
        # forces of elements that are wanted, depend on rates, else 0.
        self._short, beams = INSTANT * tape.times.first_length, model.forms.beams
        moves = beams is not None and (
            beams.depend_on_rates if of_forces else beams.facts.resultants_move
        )
        self._moves = float(moves)

    @cached_property
    def states(self) -> dict[str, np.ndarray]:
        """The states (n, ...), which are read if an output is not linear in them."""
        return self.tape.states(self.boundaries)

    def groups(self, steps: np.ndarray) -> Iterator[slice]:
        """Sub-steps or boundaries that are evaluated at once."""
        most = max(1, _MOST // self.model.size)
        return (slice(i, i + most) for i in range(0, len(steps), most))

    def places(self, steps: np.ndarray) -> np.ndarray:
        """Places (3, k) of states before and after sub-steps, and of those a sub-step earlier."""
        first = np.maximum(steps, 0)
        return np.searchsorted(self.boundaries, [first, first + 1, np.maximum(first - 1, 0)])

    def at(self, boundaries: np.ndarray) -> dict[str, np.ndarray]:
        """States (k, ...) by name, with the parameters at their times."""
        places = np.searchsorted(self.boundaries, boundaries)
        rows = {name: values[places] for name, values in self.states.items()}
        if self._parameters is not None:
            rows["parameters"] = self._parameters[boundaries - 1, 1]
            rows["parameters"][boundaries == 0] = self._at_start
        return rows

    def parts(self, steps: np.ndarray) -> StepBatch:
        """Sub-steps by their numbers; -1 for the start of the run."""
        tape, model, states, starts = self.tape, self.model, self.states, steps < 0
        first, (before, after, _) = np.maximum(steps, 0), self.places(steps)
        q, dt = states["q"][before], np.where(starts, self._short, tape.times.lengths[first])
        D = without_turns(model, states["q"][after] - q)
        D[starts] = self._moves * self._short * states["v"][before[starts]]
        q[starts] -= self._level * D[starts]
        arrays = {name: states[name][before] for name in ("internal", "natural")}
        arrays["q_previous"] = states["q previous"][before]
        arrays["natural_end"] = states["natural"][np.where(starts, before, after)]
        if self._parameters is not None:
            arrays["parameters"] = self._parameters[first, 0]
            arrays["parameters"][starts] = self._at_start
        if model.forms.needs_previous:
            arrays["memory"] = np.where(starts, 0.0, tape.memories[first])
        return StepBatch(tape.times.starts[first] + self._level * dt * ~starts, dt, D, q, **arrays)

    # -- Derivatives of rows, from those by what belongs to states or sub-steps --------------------

    def kinds(self, steps: np.ndarray) -> Iterator[np.ndarray]:
        """Groups of indices: of the start of the run, and of sub-steps.

        In a group no two read the same state: the first sub-step is alone if forms read the step
        before.
        """
        first = (steps == 0) & self.model.forms.needs_previous
        return filter(len, map(np.flatnonzero, (steps < 0, first, (steps >= 0) & ~first)))

    def at_states(
        self, rows: np.ndarray, boundaries: np.ndarray, derivatives: Mapping[str, np.ndarray]
    ) -> Iterator[Block]:
        """Blocks, from derivatives (k, ...) by what `at` gives, and by numbers of the scene."""
        nonempty, places = _there(derivatives), np.searchsorted(self.boundaries, boundaries)
        for name, values in nonempty.items():
            if name != "parameters":
                yield of_rows(name, rows, values, places if name in self.states else None)
        for which in self.kinds(boundaries - 1) if "parameters" in nonempty else ():
            name, steps = _parameters_of(boundaries[which] - 1)
            values = nonempty["parameters"][which]
            begin = 0 if steps is None else values.shape[1]
            yield of_rows(name, rows[which], values, steps, begin)

    def sources(self, steps: np.ndarray) -> Iterator[Source]:
        """What forms read of sub-steps, or of the start of the run, as sums of what there is."""
        all_places, moved = self.places(steps), self._moves * self._short
        for which in self.kinds(steps):
            (before, after, earlier), first = all_places[:, which], steps[which[0]]
            if first < 0:
                yield Source("increment", which, "v", before, moved)
                yield Source("start", which, "v", before, -self._level * moved)
            else:
                yield Source("increment", which, "q", after)
                yield Source("increment", which, "q", before, -1.0)
            yield Source("start", which, "q", before)
            if first == 0 and self.tape.memories[0]:  # of what came before
                yield Source("q_previous", which, "q previous")
            else:
                yield Source("q_previous", which, "q", earlier)
            yield Source("natural_end", which, "natural", before if first < 0 else after)
            for name in ("natural", "internal", "spring internal"):
                yield Source(name, which, name, before)
            yield Source("parameters", which, *_parameters_of(steps[which]))

    def in_steps(
        self, rows: np.ndarray, steps: np.ndarray, derivatives: Mapping[str, np.ndarray]
    ) -> Iterator[Block]:
        """Blocks, from derivatives (k, ...) by what forms read of sub-steps, or of the start."""
        nonempty, read = _there(derivatives), set()
        for name, which, array, places, factor in self.sources(steps):
            read.add(name)
            if name in nonempty and factor:
                yield of_rows(array, rows[which], factor * nonempty[name][which], places)
        yield from (of_rows(name, rows, nonempty[name]) for name in nonempty.keys() - read)


def _parameters_of(steps: np.ndarray) -> tuple[str, np.ndarray | None]:
    """Name of the parameters in steps of a kind, and these if they have a row for each."""
    return ("parameters at the start", None) if steps[0] < 0 else ("parameters", steps)


def _there(derivatives: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Derivatives that are not empty."""
    return {name: values for name, values in derivatives.items() if values.size}
