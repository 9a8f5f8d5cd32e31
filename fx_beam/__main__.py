"""`python -m fx_beam`: `info` for bug reports; `warm` compiles the usual kinds of scenes."""

from __future__ import annotations

import argparse
import os
import platform
import shlex
import subprocess
import sys
from contextlib import suppress
from importlib import import_module, metadata
from importlib.util import find_spec
from pathlib import Path

from fx_beam import c_library, library_cache
from fx_beam.errors import SceneError
from fx_beam.step import build
from fx_beam.sweeps import usual_kinds

#: Distributions of the imported packages; for FEniCSx with a prefix before the package's name.
_PREFIX = "fenics-"
_DISTRIBUTIONS = (
    *("fenics-ffcx", "fenics-basix", "fenics-ufl", "fenics-dolfinx", "petsc4py", "mpi4py"),
    *("numpy", "scipy", "matplotlib", "pyvista"),
)


def info() -> dict[str, str]:
    """Versions, where they lie, what can solve, the compiler and the cache."""
    rows = {"Python": f"{platform.python_version()}, {sys.executable}", "system": _system()}
    rows["fx_beam"] = f"{sys.modules['fx_beam'].__version__}, {Path(__file__).parent}"
    rows |= {name.removeprefix(_PREFIX): _package(name) for name in _DISTRIBUTIONS}
    rows["compiled loop"] = _loop()
    rows["compiler"] = _compiler()
    with suppress(RuntimeError):  # it is no command, as the row above says
        target, flags = c_library.target_flags()
        rows["compiled for"] = f"{target or 'the compiler default'}, {' '.join(flags)}"
        warm = "compiled" if usual_kinds.are_compiled() else "not yet (python -m fx_beam warm)"
        rows["usual kinds"] = f"{warm}: {usual_kinds.TEXT}"
    rows["cache"] = _folder(library_cache.folder())
    return rows


def _system() -> str:
    try:
        name = platform.freedesktop_os_release()["PRETTY_NAME"]
    except (OSError, KeyError):
        name = platform.system()
    return f"{name}, {platform.machine()}"


def _package(distribution: str) -> str:
    name = distribution.removeprefix(_PREFIX)
    spec = find_spec(name)
    if spec is None:
        return "not installed"
    place = Path(spec.origin).parent if spec.origin else "?"
    try:
        return f"{metadata.version(distribution)}, {place}"
    except metadata.PackageNotFoundError:  # such as dolfinx, which comes in the wheel of another
        return f"{getattr(import_module(name), '__version__', 'version unknown')}, {place}"


def _loop() -> str:
    try:
        build.load_library()
    except (RuntimeError, SceneError) as error:
        return f"not available: {error}"
    return "available"


def _compiler() -> str:
    try:
        command = c_library.command()
    except RuntimeError as error:
        return f"not available: {error}"
    version = subprocess.getoutput(shlex.join([*command, "--version"])).partition("\n")[0]
    return f"{' '.join(command)}: {version}"


def _folder(path: Path) -> str:
    sizes = []
    for file in path.glob("*"):
        with suppress(FileNotFoundError):  # the lock of another process may go meanwhile
            sizes += [file.stat().st_size] if file.is_file() else []
    largest = library_cache.LARGEST / 1e6
    return f"{path}, {len(sizes)} files, {sum(sizes) / 1e6:.0f} MB of {largest:.0f}"


def main() -> None:
    """Do what the first argument says."""
    parser = argparse.ArgumentParser(prog="python -m fx_beam")
    parser.add_argument(
        "what",
        choices=["info", "warm"],
        help="info: versions, compiler and cache, for bug reports; warm: compile usual kinds of "
        "scenes, for quick first calls",
    )
    if parser.parse_args().what == "warm":
        return usual_kinds.compile_usual_kinds()
    lines = info()
    width = max(map(len, lines)) + 2
    if sys.stdout is None:
        return
    try:
        sys.stdout.writelines(f"{name + ':':{width}}{value}\n" for name, value in lines.items())
        sys.stdout.flush()
    except OSError as error:  # a pipe that is closed, a full disk
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())  # for what is left
        sys.exit(f"the output cannot be written: {error}")


if __name__ == "__main__":
    main()
