"""What is around a motion: the sweep whose worker calls, and other processes."""

from __future__ import annotations

import functools
import logging
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from fx_beam.fem.mpi import rank_and_size
from fx_beam.scene.scene import Scene

if TYPE_CHECKING:
    from fx_beam.parallel.process_group import ProcessGroup

_log = logging.getLogger("fx_beam")
#: Elements from which on a scene is divided among processes: smaller ones take longer on several.
SMALLEST = 10_000


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
    outer_series, _THREAD.series = _THREAD.series, series
    try:
        yield
    finally:
        _THREAD.series = outer_series


def call_with_arrays(scene: Scene) -> None:
    """Call functions of a scene with arrays where they accept them, if a sweep's worker calls."""
    if scene.array_calls is None and (series := thread_series()) is not None:
        scene.array_calls = series.array_calls


def _leading_team() -> ProcessGroup | None:
    """The processes that this one leads; what starts them loads their module."""
    module = sys.modules.get("fx_beam.parallel.process_group")
    return None if module is None else module.ProcessGroup.leading


def warn_of_equal_work() -> None:
    """Warn once, on rank 0, that every rank computes the scene; not where a sweep calls."""
    # `python -m mpi4py.futures` runs the script on one rank; the others wait for cases.
    if thread_series() is None and "mpi4py.futures" not in sys.modules and _leading_team() is None:
        _warn()


def waiting_team(scene: Scene) -> ProcessGroup | None:
    """Processes that wait for parts of a scene; None without any, in a sweep, or if it is small."""
    team = _leading_team() if thread_series() is None else None
    if team is None:
        return None
    elements = sum(beam.elements for beam in scene.beams)
    if elements >= SMALLEST:
        return team
    _log.info(
        "%d elements: the first of %d processes computes them alone, which is faster below %d",
        *(elements, team.size, SMALLEST),
    )
    return None


@functools.cache
def _warn() -> None:
    rank, number = rank_and_size()
    if rank == 0 and number > 1:
        _log.warning(
            "mpirun started %d processes: each of them computes the whole scene and writes the "
            "same files. Start the script without mpirun, or by mpirun -n %d python -m fx_beam, "
            "where each computes a part; for many scenes on many processes use fx_beam.sweep with "
            "an executor, see its documentation",
            *(number, number),
        )
