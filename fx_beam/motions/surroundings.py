"""Surroundings of a motion: the sweep whose worker calls, and the processes of mpirun."""

from __future__ import annotations

import functools
import logging
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from fx_beam.mpi import rank_and_size
from fx_beam.scene.scene import Scene

_log = logging.getLogger("fx_beam")


# `own` is the `MotionSeries` of a worker of a sweep, whose scenes of equal structure share a model,
# and `series` the same while it calls a function of the user.
_THREAD = threading.local()


def thread_series() -> Any:
    """The series that a sweep's worker has set for this thread; None outside of sweeps."""
    return getattr(_THREAD, "series", None)


@contextmanager
def simulating_in_series(make: Callable[[], Any]) -> Iterator[None]:
    """In this block, which only workers of a sweep have, `simulate` uses the thread's series."""
    _THREAD.own = getattr(_THREAD, "own", None) or make()
    outer_series, _THREAD.series = thread_series(), _THREAD.own
    try:
        yield
    finally:
        _THREAD.series = outer_series


def forget_series() -> None:
    """Give up the series of this thread, as its sweep has ended."""
    _THREAD.own = None


def call_with_arrays(scene: Scene) -> None:
    """Call functions of a scene with arrays where they accept them, if a sweep's worker calls."""
    if scene.array_calls is None and (series := thread_series()) is not None:
        scene.array_calls = series.array_calls


def warn_of_equal_work() -> None:
    """Warn once, on rank 0, that every rank computes the scene; not where a sweep calls."""
    # `python -m mpi4py.futures` runs the script on one rank; the others wait for cases.
    if thread_series() is None and "mpi4py.futures" not in sys.modules:
        _warn()


@functools.cache
def _warn() -> None:
    rank, number = rank_and_size()
    if rank == 0 and number > 1:
        _log.warning(
            "mpirun started %d processes: each of them computes the whole scene and writes the "
            "same files. Start the script without mpirun: threads share a large scene; for many "
            "scenes on many processes use fx_beam.sweep with an executor, see its documentation",
            number,
        )
