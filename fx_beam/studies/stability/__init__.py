"""Stability of time schemes: a matrix of schemes and cases with a verdict on each run's energy."""

from .case import (
    BLOWN_UP,
    KEPT,
    KINDS,
    Case,
    Cell,
    Drift,
    Verdict,
    classify,
    drift_of,
    energy_ratio,
)
from .report import counts, write
from .runner import study

__all__ = ["BLOWN_UP", "KEPT", "KINDS", "Case", "Cell", "Drift", "Verdict"]
__all__ += ["classify", "counts", "drift_of", "energy_ratio", "study", "write"]
