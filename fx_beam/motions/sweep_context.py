"""Surroundings of a motion: the sweep whose worker calls, and the processes of mpirun."""

from __future__ import annotations

import functools
import logging
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from fx_beam.mpi import rank_and_size
from fx_beam.scene.functions import ArrayCalls
from fx_beam.scene.scene import Scene

_log = logging.getLogger("fx_beam")


# `array_calls`: which functions of scenes accept arrays, as a worker of a sweep knows; set while it
# calls the user's function.
_THREAD = threading.local()


def is_in_sweep() -> bool:
    """Whether a worker of a sweep calls in this thread."""
    return getattr(_THREAD, "array_calls", None) is not None


@contextmanager
def in_sweep(array_calls: ArrayCalls) -> Iterator[None]:
    """A block of a worker of a sweep, which knows which functions of scenes accept arrays."""
    outer, _THREAD.array_calls = getattr(_THREAD, "array_calls", None), array_calls
    try:
        yield
    finally:
        _THREAD.array_calls = outer


def call_with_arrays(scene: Scene) -> None:
    """Call functions of a scene with arrays where they accept them, if a sweep's worker calls."""
    if scene.array_calls is None and is_in_sweep():
        scene.array_calls = _THREAD.array_calls


def warn_of_equal_work() -> None:
    """Warn once, on rank 0, that every rank computes the scene; not where a sweep calls."""
    # `python -m mpi4py.futures` runs the script on one rank; the others wait for cases.
    if not is_in_sweep() and "mpi4py.futures" not in sys.modules:
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
