"""How `simulate` finds the series of motions of the sweep that calls it."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from fx_beam.array_calls import calling_with_arrays


class _OfThread(threading.local):
    """What each thread has by itself."""

    #: The `MotionSeries` of the worker that calls a function of the user here; None outside sweeps.
    series: Any = None


_THREAD = _OfThread()


def thread_series() -> Any:
    """The series that a sweep's worker has set for this thread; None outside of sweeps."""
    return _THREAD.series


@contextmanager
def simulating_by(series: Any) -> Iterator[None]:
    """In this block, which only workers of a sweep have, `simulate` uses their series."""
    before, _THREAD.series = _THREAD.series, series
    try:
        with calling_with_arrays(series.calls):
            yield
    finally:
        _THREAD.series = before
