"""What scenes of one structure share, and what each run has of its own."""

from __future__ import annotations

from collections.abc import Hashable
from threading import RLock
from typing import Any

from fx_beam.scene.scene import Scene

from .block import Block, BlockPlan, twin
from .form_tables import aligned_zeros
from .full_turns import TurnCounter
from .model import Model, massless_dofs, once, sizes_of, sticks, widths_of
from .numbers import data_of
from .tables import Problem


class Program:
    """A model that no run changes, and the problems in C of it, which are patterns of others.

    Any number of runs and threads use it at once.
    """

    def __init__(self, model: Model):
        self.model, self._lock = model, RLock()
        # By what they are for: problems, and the places of what changes in them.
        self._problems: dict[Hashable, tuple[Problem, BlockPlan]] = {}
        once(model, massless_dofs)
        once(model, sizes_of)
        once(model, widths_of)
        #: Counts full turns.
        self.turn_counter = TurnCounter(model)
        structs, arrays = model.memory
        #: Places of what changes in a model.
        self.plan = BlockPlan(_ffi_of(model), structs, arrays)

    @staticmethod
    def serves(model: Model) -> bool:
        """Whether a model can be shared."""
        return True

    def model_of(self, scene: Scene) -> Model:
        """The model of a scene; OtherStructureError if it differs in more than numbers."""
        if sticks(scene):
            with self._lock:  # joints of this model are moved
                data = data_of(self.model, scene)
        else:
            data = data_of(self.model, scene)
        block = self.plan.block(aligned_zeros)
        model = self.model.of(data, block, self)
        model.block = block
        return model

    def problem_of(self, model: Model, kind: Any) -> Problem:
        """A problem of a model that `model_of` made, with a block of its own."""
        if (known := self._problems.get(kind)) is None:
            with self._lock:
                if (known := self._problems.get(kind)) is None:
                    pattern = twin(self.model)
                    pattern.scene = model.scene  # the first one may have more by now
                    problem = Problem(pattern, kind)
                    known = self._problems[kind] = problem, problem.plan(self.plan)
        problem, plan = known
        outer: Block = model.block
        return problem.of_run(model, plan.block(aligned_zeros, outer))


def _ffi_of(model: Model) -> Any:
    from fx_beam.c_library import declared
    from fx_beam.results.state import MACROS

    return declared("problem.h", MACROS)
