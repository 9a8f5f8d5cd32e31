"""Steps that are tried, and what came of them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.results.state import State

from .step_control import StepControl


class Steps(NamedTuple):
    """Steps that are tried."""

    #: Number of the first one; parts of it that are taken already, and parts of a step.
    first: int
    done: int = 0
    parts: int = 1
    #: Limits of their local errors, if these are controlled.
    control: StepControl | None = None
    #: Whether they end before one in which a contact or a law switches.
    watch: bool = False


class StepsResult(NamedTuple):
    """What came of steps of equal length."""

    #: State at the end of the steps that succeeded, and their number.
    state: State
    taken: int
    #: Ratios of error and limit in the last step but one and in the last one, if they are known.
    before: float | None = None
    ratio: float | None = None
    #: Whether Newton's method failed in the step after them; a ratio above 1 rejects the last one.
    failed: bool = False
    #: Whether a contact or a law switches in the step after them; the switches at its end if they
    #: are watched.
    switched: bool = False
    switches: np.ndarray | None = None
    #: Error of a function of time in the step after them.
    error: BaseException | None = None
