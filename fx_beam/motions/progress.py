"""Progress bars, and the partial solution of a run that ended early."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import ParamSpec

from tqdm import tqdm

from fx_beam.errors import Failure, StepError, add_hint
from fx_beam.results.solution import Solution
from fx_beam.step.interrupts import without_ctrl_c

from .sweep_context import is_in_sweep

_P = ParamSpec("_P")

# Delay of a progress bar that was not requested [s].
_SOON = 2.0
_KEPT = (
    "fx_beam: the steps so far are in the attribute `solution` of this KeyboardInterrupt. In a "
    "script: `except KeyboardInterrupt as stop: solution = stop.solution`; at a prompt: "
    "`import sys; solution = sys.last_value.solution`. To go on: `simulate(..., start=solution)`"
)


class _NoBar:
    """In the place of a bar that is not drawn: quick."""

    #: What is done, of which the one who draws takes the difference.
    n = 0.0

    def __enter__(self) -> _NoBar:
        return self

    def __exit__(self, *_) -> None:
        pass

    def update(self, increment: float = 1) -> None:
        """Count only."""
        self.n += increment


def progress_bar(total: float, choice: bool | None, **look) -> tqdm | _NoBar:
    """A progress bar, removed at the end; by default only on a terminal and for long runs.

    In a sweep only if it is asked for: several workers would draw over one another.
    """
    error = sys.stderr
    if error is None or getattr(error, "closed", False):
        return _NoBar()
    if not (not is_in_sweep() and error.isatty() if choice is None else choice):
        return _NoBar()
    return tqdm(total=total, delay=0 if choice else _SOON, leave=False, **look)


def failure_of(stop: BaseException, time: float) -> Failure:
    """The cause of an early end, at a time or load factor."""
    if isinstance(stop, StepError):
        return stop.failure
    cause = "" if isinstance(stop, KeyboardInterrupt) else f" by {stop!r}"
    return Failure("interrupted", f"interrupted{cause}", time)


def attach(stop: BaseException, solution: Callable[[], Solution]) -> None:
    """Attach the partial solution to an exception; a note tells users of Ctrl-C about it."""
    with without_ctrl_c():
        stop.solution = solution()  # type: ignore[attr-defined]
    if isinstance(stop, KeyboardInterrupt):
        stop.add_note(_KEPT)


def attach_partial_result(function: Callable[_P, Solution]) -> Callable[_P, Solution]:
    """An analysis that says so if Ctrl-C comes before its first step."""

    @functools.wraps(function)
    def run(*arguments: _P.args, **named: _P.kwargs) -> Solution:
        try:
            return function(*arguments, **named)
        except BaseException as stop:
            if isinstance(stop, TypeError):
                add_hint(stop, function, named)
            if not hasattr(stop, "solution"):
                stop.solution = None  # type: ignore[attr-defined]
            if isinstance(stop, KeyboardInterrupt) and stop.solution is None:  # type: ignore[attr-defined]
                stop.add_note(f"fx_beam: {function.__name__} was interrupted before its first step")
            raise

    return run
