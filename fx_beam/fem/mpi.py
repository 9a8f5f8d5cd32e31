"""The start of MPI, which dolfinx needs also in a single process."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

# Open MPI's variable for how messages are sent; mpirun and the user may have set it.
_WAY = "OMPI_MCA_pml"
# And that with which mpirun says how many processes there are.
_SIZE = "OMPI_COMM_WORLD_SIZE"


@contextmanager
def _no_search_for_networks() -> Iterator[None]:
    """Spare Open MPI the search for fast networks, which takes 0.2 s; afterwards nothing is set."""
    chosen = not os.environ.keys().isdisjoint((_WAY, _SIZE))
    if not chosen:
        os.environ[_WAY] = "ob1"
    try:
        yield
    finally:
        if not chosen:
            del os.environ[_WAY]


with _no_search_for_networks():
    from mpi4py import MPI

if "mpi4py.futures" in sys.modules:
    # PETSc would start on all processes at once, but those of a pool wait for calls.
    import petsc4py

    petsc4py.init(comm=MPI.COMM_SELF)


def under_mpirun() -> bool:
    """Whether mpirun started this process."""
    return _SIZE in os.environ or MPI.COMM_WORLD.size > 1


def rank_and_size() -> tuple[int, int]:
    """Number of this process, and number of processes, among those that mpirun started."""
    return MPI.COMM_WORLD.rank, MPI.COMM_WORLD.size
