"""What scenes of one structure share, and what each run has of its own."""

from __future__ import annotations

from threading import RLock
from typing import Any

from fx_beam.c_library import declared
from fx_beam.results.state import MACROS
from fx_beam.scene.scene import Scene
from fx_beam.shallow_copy import shallow_copy

from .block import BlockPlan
from .model import Model
from .numbers import read_numbers
from .tables import Problem

# Number of purposes, such as options of Newton's method, for which a program has problems in C.
_MOST = 16


class Program:
    """A model that nothing runs on, and problems in C of it: the patterns of those of runs.

    No run changes it: any number of runs and threads use it at once.
    """

    def __init__(self, model: Model):
        self.model, self._lock = model, RLock()
        # Problems by their purpose, with the places of what changes in them.
        self._problems: dict[Any, tuple[Problem, BlockPlan]] = {}
        #: Places of what changes in a model.
        self.plan = BlockPlan(declared("problem.h", MACROS), *model.memory)

    def model_of(self, scene: Scene) -> Model:
        """The model of a scene of this structure; OtherStructureError if other numbers are zero."""
        data = read_numbers(self.model, scene)
        block = self.plan.block() if self.plan.size else None
        model = self.model.in_block(block, self)
        model.set_numbers(data)
        return model

    def problem_of(self, model: Model, kind: Any) -> Problem:
        """A problem in C of a model that `model_of` made, in a block of its own."""
        known = self._problems.get(kind)
        if known is None:
            with self._lock:
                known = self._problems.get(kind) or self._add(model, kind)
        pattern, plan = known
        return pattern.in_block(plan.block(model.block), model)

    def _add(self, model: Model, kind: Any) -> tuple[Problem, BlockPlan]:
        pattern = shallow_copy(self.model)
        pattern.scene = model.scene  # the first one may have more by now
        problem = Problem(pattern, kind)
        entry = problem, BlockPlan(problem.ffi, *problem.memory, outer=self.plan)
        entry[1].places = problem.places(entry[1])
        if len(self._problems) >= _MOST:
            del self._problems[next(iter(self._problems))]
        self._problems[kind] = entry
        return entry
