"""Programs: what scenes of one structure share. What a run changes is in blocks of its own."""

from __future__ import annotations

from threading import RLock
from typing import Any

from fx_beam.c_library import declared
from fx_beam.content_cache import shallow_copy
from fx_beam.laws.schemes import Scheme
from fx_beam.results.state import MACROS
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError, Structure

from .block import BlockPlan
from .model import Model, look_at_ends, read_numbers
from .tables import ProblemInC

# Number of purposes, such as options of Newton's method, for which a program has problems in C.
_MOST = 16


class Program:
    """A model that nothing runs on, and problems in C of it: the patterns of those of runs.

    No run changes it: any number of runs and threads use it at once.
    """

    def __init__(self, model: Model):
        self.model, self._lock = model, RLock()
        # Problems by their purpose, with the places of what changes in them.
        self._problems: dict[Any, tuple[ProblemInC, BlockPlan]] = {}
        #: Places of what changes in a model.
        self.plan = BlockPlan(declared("problem.h", MACROS), *model.memory)

    def model_of(self, scene: Scene) -> Model:
        """The model of a scene of this structure; OtherStructureError if other numbers are zero."""
        data = read_numbers(self.model, scene)
        block = self.plan.block() if self.plan.size else None
        model = self.model.in_block(block, self)
        model.set_numbers(data)
        is_one_of_many = scene.array_calls is not None  # such as those of a response
        if not (is_one_of_many or data.lies_as(self.model.data)):
            look_at_ends(scene, model.mesh)
        return model

    def problem_of(self, model: Model, kind: Any) -> ProblemInC:
        """A problem in C of a model that `model_of` made, in a block of its own."""
        known = self._problems.get(kind)
        if known is None:
            with self._lock:
                known = self._problems.get(kind) or self._add(model, kind)
        pattern, plan = known
        return pattern.in_block(plan.block(model.block), model)

    def _add(self, model: Model, kind: Any) -> tuple[ProblemInC, BlockPlan]:
        pattern = shallow_copy(self.model)
        pattern.scene = model.scene  # to the first scene something may have been added since
        problem = ProblemInC(pattern, kind)
        plan = BlockPlan(problem.ffi, *problem.memory, outer=self.plan)
        plan.places = problem.places(plan)
        if len(self._problems) >= _MOST:
            del self._problems[next(iter(self._problems))]
        self._problems[kind] = problem, plan
        return problem, plan


class Programs:
    """The latest programs, by the structure of their scenes; threads may share them.

    At most so many; all of them together have at most `size` degrees of freedom.
    """

    def __init__(self, size: int = 25_000, most: int = 8):
        self.size, self._most = size, most
        # With their keys; the latest one that was used is the last. Scenes of one structure in
        # which other numbers are zero have programs of one key.
        self._entries: list[tuple[tuple, Program]] = []

    def model_of(
        self, scene: Scene, scheme: Scheme, owned: bool = False, **options: bool
    ) -> tuple[Model, str]:
        """The model of a scene, and why it has a new program; empty if an earlier one serves.

        By `options` of `Model`. A large scene has a program only if its model is `owned`: by a
        caller who gives it the numbers of other scenes.
        """
        structure, reason = Structure(scene), ""
        key = structure, scheme, *options.items()
        for entry in self._entries[::-1]:
            if entry[0] == key:
                try:
                    model = entry[1].model_of(scene)
                except OtherStructureError as other:
                    reason = reason or str(other)
                else:
                    self._keep(entry)
                    return model, ""
        model = Model(scene, scheme, structure=structure, **options)
        reason = reason or self._reason(key)
        is_large = model.size > self.size
        if is_large and not owned:
            return model, reason
        program = Program(model)
        if not is_large:
            self._keep((key, program))
        return program.model_of(scene), reason

    def clear(self) -> None:
        """Keep no program; runs that have one go on."""
        self._entries = []

    def _keep(self, latest: tuple[tuple, Program]) -> None:
        """Have a program as the latest, and drop the earliest ones beyond a number and a size."""
        entries = self._entries
        if entries and entries[-1] is latest:
            return
        kept, size = [latest], latest[1].model.size
        # Code of a user's functions goes with the next functions in their place.
        others = [
            entry
            for entry in entries
            if entry is not latest and not latest[0][0].has_other_functions(entry[0][0])
        ]
        for entry in others[: -self._most : -1]:
            if (size := size + entry[1].model.size) > self.size:
                break
            kept.append(entry)
        self._entries = kept[::-1]

    def _reason(self, key: tuple) -> str:
        """Why no program serves: how the latest of a scene with as many parts differs."""
        structure, *kind = key
        for (other, *other_kind), _ in self._entries[::-1]:
            if other_kind == kind and other.counts == structure.counts:
                return other.difference(structure)
        return "the first scene"


PROGRAMS = Programs()
