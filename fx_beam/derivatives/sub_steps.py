"""The sub-steps of a tape, as outputs that are not linear in the states see them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

import numpy as np

from fx_beam.content_cache import cached_property
from fx_beam.dual import floats
from fx_beam.laws.interval import INSTANT, StepBatch
from fx_beam.step.full_turns import without_turns
from fx_beam.step.model import Model
from fx_beam.step.tape import Tape

from .gradient import DerivativeBlock

# Arrays that forms read at the starts of sub-steps.
_AT_START = "q", "v", "slides", "natural", "internal", "spring internal"
# A term of what forms read: an array, places (k,) in it, None for all of it, and a factor; and a
# term with the indices (k,) of the sub-steps that have it.
_Term = tuple[str, np.ndarray | None, float]
_Source = tuple[np.ndarray, *_Term]
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
        has_places: bool = True,
        reads_forces: bool = False,
    ):
        self.model, self.tape, self.boundaries = model, tape, boundaries
        #: Whether derivatives by the positions of nodes are wanted.
        self.has_places = has_places
        #: Name of the rates of nodes.
        self.rates = "rates" if model.fits_rates else "v"
        parameters, self._level = model.forms.parameters, model.scheme.rates.level
        #: Values of the parameters (sub-steps, 2, n) at the level of the scheme and at the ends.
        self._parameters = None
        if len(parameters):
            times = tape.times
            rows = parameters.signals.over_steps(times.starts, times.ends, self._level)
            self._parameters = floats(rows)
            self._start_parameters = parameters.values_at(float(times.starts[0]))[None]
        # Length of the short step for the resultants at the start [s], and 1 if these, or all
        # forces of elements that are wanted, depend on rates, else 0.
        self._short, beams = INSTANT * tape.times.first_length, model.forms.beams
        moves = beams is not None and (
            beams.depend_on_rates if reads_forces else beams.facts.resultants_move
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

    def states_at(self, boundaries: np.ndarray) -> dict[str, np.ndarray]:
        """States (k, ...) by name, with the parameters at their times."""
        places = np.searchsorted(self.boundaries, boundaries)
        rows = {name: values[places] for name, values in self.states.items()}
        if self._parameters is not None:
            rows["parameters"] = self._parameters[boundaries - 1, 1]
            rows["parameters"][boundaries == 0] = self._start_parameters
        return rows

    def parts(self, steps: np.ndarray) -> StepBatch:
        """Sub-steps by their numbers; -1 for the start of the run."""
        tape, model, states, starts = self.tape, self.model, self.states, steps < 0
        first, (begins, ends, _) = np.maximum(steps, 0), self.places(steps)
        q, dt = states["q"][begins], np.where(starts, self._short, tape.times.lengths[first])
        D = without_turns(model, states["q"][ends] - q)
        D[starts] = self._moves * self._short * states["v"][begins[starts]]
        q[starts] -= self._level * D[starts]
        arrays = {name: states[name][begins] for name in ("internal", "natural")}
        arrays["q_previous"] = states["q previous"][begins]
        arrays["natural_end"] = states["natural"][np.where(starts, begins, ends)]
        if self._parameters is not None:
            arrays["parameters"] = self._parameters[first, 0]
            arrays["parameters"][starts] = self._start_parameters
        if model.forms.needs_previous:
            arrays["memory"] = np.where(starts, 0.0, tape.memories[first])
        return StepBatch(tape.times.starts[first] + self._level * dt * ~starts, dt, D, q, **arrays)

    def point_steps(self, steps: np.ndarray) -> StepBatch:
        """Sub-steps with what forces at points read."""
        begins, ends, _ = self.places(steps)
        names = "v", "slides", "spring internal"
        v, slides, internal = (self.states[name][begins] for name in names)
        factors = np.ones(len(steps))
        if self.model.scheme.rates.at_rest:
            factors = self.tape.memories[steps]
        return self.parts(steps)._replace(
            v=v,
            load_factor=factors,
            spring_internal=internal,
            slides=slides,
            slide_increments=self.states["slides"][ends] - slides,
        )

    # -- Derivatives of rows, from those by what belongs to states or sub-steps --------------------

    def kinds(self, steps: np.ndarray) -> Iterator[np.ndarray]:
        """Groups of indices: of the start of the run, and of sub-steps.

        In a group no two read the same state: the first sub-step is alone if forms read the step
        before.
        """
        first = (steps == 0) & self.model.forms.needs_previous
        return filter(len, map(np.flatnonzero, (steps < 0, first, (steps >= 0) & ~first)))

    def at_states(
        self, boundaries: np.ndarray, blocks: Iterable[DerivativeBlock]
    ) -> Iterator[DerivativeBlock]:
        """Blocks, from those by what `at` gives, and by numbers of the scene."""
        places = np.searchsorted(self.boundaries, boundaries)
        count = len(self.model.forms.parameters)
        for block in blocks:
            if block.name != "parameters":
                yield block._replace(places=places if block.name in self.states else None)
                continue
            for which in self.kinds(boundaries - 1):
                name, steps = _parameters_of(boundaries[which] - 1)
                entries = np.arange(count)[block.entries] + (0 if steps is None else count)
                part = block._replace(name=name, entries=entries, places=steps)
                yield part._replace(rows=part.rows[which], derivatives=part.derivatives[which])

    def in_steps(
        self, steps: np.ndarray, blocks: Iterable[DerivativeBlock]
    ) -> Iterator[DerivativeBlock]:
        """Blocks, from those by what forms read of sub-steps, or of the start."""
        sources = self._sources(steps)
        for block in blocks:
            if (name_terms := sources.get(block.name)) is None:
                yield block
                continue
            for which, array, places, factor in name_terms:
                part = block._replace(name=array, rows=block.rows[which], places=places)
                yield part._replace(derivatives=block.derivatives[which]).times(factor)

    def _sources(self, steps: np.ndarray) -> dict[str, list[_Source]]:
        """Terms whose sum forms read of sub-steps, by name.

        Their arrays are those of states, or of numbers with a row for each sub-step.
        """
        sources: dict[str, list[_Source]] = {}
        all_places, moved = self.places(steps), self._moves * self._short
        for which in self.kinds(steps):
            (begins, ends, earlier), first = all_places[:, which], steps[which[0]]
            starts: list[_Term] = [("q", begins, 1.0)]
            increments = [("q", ends, 1.0), ("q", begins, -1.0)]
            if first < 0:
                starts.append(("v", begins, -self._level * moved))
                increments = [("v", begins, moved)]
            has_previous = first == 0 and self.tape.memories[0]  # of what came before
            previous = ("q previous", None) if has_previous else ("q", earlier)
            terms = {name: [(name, begins, 1.0)] for name in _AT_START}
            terms |= {"start": starts, "increment": increments, "q_previous": [(*previous, 1.0)]}
            terms["slide increment"] = [("slides", ends, 1.0), ("slides", begins, -1.0)]
            terms["natural_end"] = [("natural", begins if first < 0 else ends, 1.0)]
            terms["parameters"] = [(*_parameters_of(steps[which]), 1.0)]
            for name, name_terms in terms.items():
                sources.setdefault(name, []).extend(
                    (which, *term) for term in name_terms if term[2]
                )
        return sources


def _parameters_of(steps: np.ndarray) -> tuple[str, np.ndarray | None]:
    """Name of the parameters in steps of a kind, and these if they have a row for each."""
    return ("parameters at the start", None) if steps[0] < 0 else ("parameters", steps)
