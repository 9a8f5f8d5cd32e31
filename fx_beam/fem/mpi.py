"""MPI and PETSc, which only the processes of mpirun need."""

from __future__ import annotations

import os
import sys
from glob import glob
from importlib.util import find_spec
from typing import Any

# Variables by which launchers of Open MPI, MPICH, MVAPICH and SLURM number a process. MPI itself
# sets others that begin alike, and processes that are started later inherit them.
_RANKS = {"OMPI_COMM_WORLD_RANK", "PMI_RANK", "PMIX_RANK", "MV2_COMM_WORLD_RANK"}
# Debian's packages of its own Python, and where petsc4py is. The link by which this Python finds it
# comes with PETSc's package for developers only. Other Pythons could not import it.
_OF_DEBIAN = "/usr/lib/python3/dist-packages"
_PETSC_OF_DEBIAN = "/usr/lib/petscdir/petsc*/*-real/lib/python3/dist-packages"


def under_mpirun() -> bool:
    """Whether mpirun started this process, and mpi4py is there: SLURM numbers lone ones as well."""
    numbered = not _RANKS.isdisjoint(os.environ) and find_spec("mpi4py") is not None
    started = "mpi4py.MPI" in sys.modules or numbered
    return started and (world().size > 1 or "OMPI_COMM_WORLD_SIZE" in os.environ)


def rank_and_size() -> tuple[int, int]:
    """Number of this process, and number of processes, among those that mpirun started."""
    return (world().rank, world().size) if under_mpirun() else (0, 1)


def world() -> Any:
    """All processes that mpirun started."""
    from mpi4py import MPI

    return MPI.COMM_WORLD


def has_petsc() -> bool:
    """Whether petsc4py is installed, also where Debian has put it."""
    if find_spec("petsc4py") is None and _OF_DEBIAN in sys.path:
        sys.path += sorted(glob(_PETSC_OF_DEBIAN))[-1:]
    return find_spec("petsc4py") is not None


def petsc() -> Any:
    """The module PETSc of petsc4py; RuntimeError if it is missing."""
    if not has_petsc():
        raise RuntimeError(
            "a scene on several processes needs PETSc, which is not installed. Install petsc4py "
            "(Debian's python3-petsc4py), or start the script without mpirun"
        )
    from petsc4py import PETSc

    return PETSc
