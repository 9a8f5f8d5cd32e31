"""The start of MPI, which dolfinx needs also in a single process, and of PETSc."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from typing import Any

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


def _name_missing_folder() -> None:
    """Warn where Open MPI, which ends the process then, could write no files of its session."""
    names = "TMPDIR", "TEMP", "TMP"
    name = next((name for name in names if os.environ.get(name)), None)
    folder = os.environ[name] if name else "/tmp"
    there = folder
    while not os.path.exists(there):  # it makes what is missing
        there = os.path.dirname(there) or "."
    if not os.access(there, os.W_OK | os.X_OK):
        logging.getLogger("fx_beam").warning(
            "%s cannot be written, and Open MPI needs a folder for its session: set %s to one",
            folder,
            name or "TMPDIR",
        )


_name_missing_folder()
with _no_search_for_networks():
    from mpi4py import MPI

if "mpi4py.futures" in sys.modules and find_spec("petsc4py"):
    # dolfinx may start PETSc, on all processes at once, but those of a pool wait for calls.
    import petsc4py

    petsc4py.init(comm=MPI.COMM_SELF)


def under_mpirun() -> bool:
    """Whether mpirun started this process."""
    return _SIZE in os.environ or MPI.COMM_WORLD.size > 1


def rank_and_size() -> tuple[int, int]:
    """Number of this process, and number of processes, among those that mpirun started."""
    return MPI.COMM_WORLD.rank, MPI.COMM_WORLD.size


def world() -> Any:
    """All processes that mpirun started."""
    return MPI.COMM_WORLD


def petsc(what: str = "a scene on several processes") -> Any:
    """The module PETSc of petsc4py; RuntimeError if it is missing."""
    if find_spec("petsc4py") is None:
        raise RuntimeError(
            f"{what} needs PETSc, which is not installed. Install petsc4py (Debian's "
            "python3-petsc4py), or start the script without mpirun"
        )
    from petsc4py import PETSc

    return PETSc
