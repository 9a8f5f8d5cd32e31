"""The work of natural strains: what changes them works against the stress resultants."""

from __future__ import annotations

from typing import Any

from .decaying import DecayingResultants
from .kinematics import Step
from .resultants import WeightedResultants, work_of


def actuation(step: Step, r: Any):
    """Work per length -N.DE* of natural strains that change by DE* over a step.

    With N.D(E - E*), the increment of the stored energy, it gives the work N.DE on the motion.
    """
    if isinstance(r, WeightedResultants):
        r = r._replace(level=0.5)
    elif isinstance(r, DecayingResultants):
        r = r.mean
    return -work_of((r.N, r.Q, r.M), step.natural_increments)
