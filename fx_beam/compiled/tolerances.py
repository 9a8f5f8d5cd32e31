"""Tolerances and limits of Newton's method for the compiled loop."""

from __future__ import annotations

from typing import Any

from fx_beam.stepping.line_search import OVERSHOOT, SEARCHES
from fx_beam.stepping.newton import (
    ENERGY_FLOOR,
    ENERGY_SHARE,
    LONGEST_TURN,
    NEGLIGIBLE,
    PREDICTOR_ERROR,
    NewtonOptions,
)
from fx_beam.stepping.substeps import LARGE_TURN


def hand_over_tolerances(problem: Any, options: NewtonOptions) -> None:
    """Set those of a C struct Problem."""
    p, tolerance = problem, options.tolerance
    p.tolerance, p.negligible = tolerance, NEGLIGIBLE * tolerance
    p.energy_tolerance, p.energy_floor = ENERGY_SHARE * tolerance, ENERGY_FLOOR
    p.max_turn, p.longest_turn, p.large_turn = options.max_turn, LONGEST_TURN, LARGE_TURN
    p.max_iterations, p.predictor_error = options.max_iterations, PREDICTOR_ERROR
    p.overshoot, p.searches = OVERSHOOT, SEARCHES
