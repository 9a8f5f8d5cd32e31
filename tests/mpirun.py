"""How mpirun is called."""

import functools
import subprocess


@functools.cache
def mpirun(number):
    """The command that starts so many processes, which Open MPI wants to be told are too many."""
    version = subprocess.run(["mpirun", "--version"], capture_output=True, text=True).stdout
    return ["mpirun", "-n", str(number), *["--oversubscribe"] * ("Open MPI" in version)]
