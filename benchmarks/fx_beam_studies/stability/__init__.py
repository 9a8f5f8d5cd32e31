"""Stability of time schemes: a matrix of schemes and cases with a verdict on each run's energy."""

from fx_beam.errors import answer_in_module

from .cases import (
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
    study,
)
from .report import counts, write

__all__ = ["BLOWN_UP", "KEPT", "KINDS", "Case", "Cell", "Drift", "Verdict"]
__all__ += ["classify", "counts", "drift_of", "energy_ratio", "study", "write"]
answer_in_module(globals())
