"""The library of the compiled loop: built once, from loop.c, and kept in the user's cache."""

from __future__ import annotations

import functools
import hashlib
import logging
import os
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import cffi

_log = logging.getLogger("fx_beam")
_FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-shared", "-fPIC")


class LoopUnavailable(Exception):
    """Why a scene cannot run in the compiled loop."""


def load_library() -> tuple[Any, Any]:
    """The loop's interface and library.

    Returns
    -------
    tuple of cffi.FFI and library
        For the functions and structures of loop.h.

    Raises
    ------
    LoopUnavailable
        If it cannot be built.
    """
    library = built()
    if library is None:
        raise LoopUnavailable("it cannot be built")
    return library


@functools.cache
def built() -> tuple[Any, Any] | None:
    """The library, compiled once for each kind of processor; none, with a warning, if it fails."""
    here = Path(__file__).parent
    header, source = ((here / name).read_text() for name in ("loop.h", "loop.c"))
    key = hashlib.sha256("\n".join([header, source, *_FLAGS, _processor()]).encode()).hexdigest()
    cache = cache_directory()
    library = cache / f"loop-{key[:16]}.so"
    try:
        if not library.exists():
            _log.info("compiling the loop over time steps, once")
            cache.mkdir(parents=True, exist_ok=True)
            # Renamed when it is whole, as several processes may build it.
            with tempfile.TemporaryDirectory(dir=cache) as scratch:
                out = Path(scratch) / "loop.so"
                command = ["cc", *_FLAGS, str(here / "loop.c"), "-o", str(out), "-lm"]
                subprocess.run(command, check=True, capture_output=True, text=True)
                out.replace(library)
        ffi = cffi.FFI()
        ffi.cdef(header)
        return ffi, ffi.dlopen(str(library))
    except (OSError, subprocess.CalledProcessError) as error:
        reason = getattr(error, "stderr", None) or error
        _log.warning("the compiled loop cannot be built, steps run in Python: %s", reason)
        return None


def cache_directory() -> Path:
    """Where the library is kept, beside the forms that FEniCSx compiles."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fx_beam"


def _processor() -> str:
    """What -march=native looks at."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return ""
    return next((line for line in lines if line.startswith(("flags", "Features"))), "")
