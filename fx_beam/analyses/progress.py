"""What users see of long work, and what is kept when they stop it."""

from __future__ import annotations

from tqdm import tqdm

from fx_beam.errors import Failure, StepError
from fx_beam.results.solution import Solution

# Seconds after which a bar is shown to those who have not asked for it.
_SOON = 2.0
_KEPT = (
    "fx_beam: the steps so far are in the attribute `solution` of this KeyboardInterrupt. In a "
    "script: `except KeyboardInterrupt as stop: solution = stop.solution`; at a prompt: "
    "`import sys; solution = sys.last_value.solution`"
)


def progress_bar(total: float, asked: bool | None, **look) -> tqdm:
    """A bar that vanishes at the end; by default on a terminal, when the work takes long."""
    # tqdm takes None as: only on a terminal.
    hidden = None if asked is None else not asked
    return tqdm(total=total, disable=hidden, delay=0 if asked else _SOON, leave=False, **look)


def failure_of(stop: StepError | KeyboardInterrupt, time: float) -> Failure:
    """Why a run ended early, at a time or load factor."""
    if isinstance(stop, StepError):
        return stop.failure
    return Failure("interrupted", "interrupted", time)


def keep(stop: StepError | KeyboardInterrupt, solution: Solution | None) -> None:
    """Give what ended a run the solution up to there, and say so where it is not expected."""
    stop.solution = solution  # type: ignore[union-attr]
    if solution is not None and isinstance(stop, KeyboardInterrupt):
        stop.add_note(_KEPT)
