"""Which of the processes that mpirun started this one is."""

from __future__ import annotations

import os
import sys
from importlib.util import find_spec
from typing import Any

#: Variables by which launchers of Open MPI, MPICH, MVAPICH and SLURM number a process. MPI itself
#: sets others that begin alike, and processes that are started later inherit them.
RANKS = "OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "MV2_COMM_WORLD_RANK"


def under_mpirun() -> bool:
    """Whether mpirun started this process, and mpi4py is there: SLURM numbers lone ones as well."""
    numbered = any(rank in os.environ for rank in RANKS) and find_spec("mpi4py") is not None
    started = "mpi4py.MPI" in sys.modules or numbered
    return started and (_world().size > 1 or "OMPI_COMM_WORLD_SIZE" in os.environ)


def rank_and_size() -> tuple[int, int]:
    """Number of this process, and number of processes, among those that mpirun started."""
    return (_world().rank, _world().size) if under_mpirun() else (0, 1)


def _world() -> Any:
    from mpi4py import MPI

    return MPI.COMM_WORLD
