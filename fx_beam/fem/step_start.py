"""The start of a step, as far as forces depend on it, and a completed step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from fx_beam.laws.interval import Interval

_NONE = np.empty(0)


class StepStart(NamedTuple):
    """Configuration, rates and memory at the start of a step."""

    #: Displacements and rotations (size,), their rates and accelerations; these may be left out if
    #: nothing depends on them.
    q: np.ndarray
    v: np.ndarray = _NONE
    a: np.ndarray = _NONE
    #: Start of the last step, q by default, and `Step.memory`.
    q_previous: np.ndarray | None = None
    memory: float = 0.0
    #: Internal variables (cells, degree, width) of beams.
    internal: np.ndarray | None = None
    #: Slides and their rates (joints,), zero by default, and internal variables of springs.
    slides: np.ndarray = _NONE
    slide_rates: np.ndarray = _NONE
    spring_internal: np.ndarray | None = None
    #: Parameters (n,) at the scheme's level, where they are not functions of time.
    parameters: np.ndarray | None = None
    #: Natural strains (cells, degree, 3) at the start and at the end of the step, if there are any.
    natural: tuple[np.ndarray, np.ndarray] | None = None


class Part(NamedTuple):
    """A completed step, or a part of a halved one."""

    interval: Interval
    #: Increment (size,).
    D: np.ndarray
    #: Its start; rates only if resultants depend on them.
    start: StepStart
