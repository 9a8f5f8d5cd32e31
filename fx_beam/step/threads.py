"""How many threads share the work of a large scene."""

from __future__ import annotations

import os

from fx_beam.errors import SceneError
from fx_beam.mpi import under_mpirun

# More are not faster: they wait for memory.
_MOST = 4
_VARIABLE = "FX_BEAM_THREADS"


def thread_count() -> int:
    """Number of threads: by default that of the cores that the process may use, at most four.

    One for each process of mpirun. SceneError if the environment variable is no such number.
    """
    if text := os.environ.get(_VARIABLE, ""):
        if not (text.isdecimal() and 1 <= int(text) <= 64):
            raise SceneError(f"{_VARIABLE} = {text!r} must be a number of threads from 1 to 64")
        return int(text)
    if under_mpirun():
        return 1
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return min(cores or 1, _MOST)
