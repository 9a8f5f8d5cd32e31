"""Time steps on several processes: each evaluates its part, and PETSc solves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from fx_beam.results.audit import Stats
from fx_beam.results.state import State
from fx_beam.step.forcing import Forcing
from fx_beam.step.loop import CompiledLoop, StepInputs, no_inputs
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import Rows
from fx_beam.step.steps_result import Steps, StepsResult

from .team import Team
from .whole import Together


class TeamLoop(CompiledLoop):
    """Takes one step after the other."""

    def __init__(
        self, team: Team, model: Model, forcing: Forcing, options: NewtonOptions, stats: Stats
    ):
        super().__init__(model, forcing, options, stats, alone=False)
        self.together = Together(team, self)
        stats.solver = f"PETSc on {team.size} processes"

    def inputs_ahead(self, t: float, ends: np.ndarray) -> StepInputs:
        """None: functions of time are evaluated in each step."""
        return no_inputs(len(self.model.scheme.fractions))

    def take(
        self,
        state: State,
        ends: np.ndarray,
        inputs: StepInputs,
        steps: Steps,
        recorder: Rows,
        count: Callable[[StepsResult], None],
    ) -> StepsResult:
        """Take the first of some steps or parts, if it succeeds."""
        own = self.inputs(state.t, ends[:1])
        return super().take(state, ends[:1], own, steps, recorder, count)
