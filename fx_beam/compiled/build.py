"""C of our own, built once for each kind of processor and kept in the user's cache."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import logging
import os
import platform
import shlex
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cffi

from fx_beam.errors import SceneError
from fx_beam.fem import dolfinx_api

_log = logging.getLogger("fx_beam")
_SOURCES = Path(__file__).parent / "c"
_FLAGS = [
    *("-O3", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC"),
    # The whole width of vectors, which compilers of some processors leave half empty.
    *(["-mprefer-vector-width=512"] if platform.machine() == "x86_64" else []),
    # GCC would join sin and cos of one angle in one complex number, of which it has no vectors.
    *("-fno-builtin-sin", "-fno-builtin-cos"),
]
# The compiler's option that chooses a processor, where it knows "native".
_OPTION = {"x86_64": "-march", "aarch64": "-mcpu"}.get(platform.machine())


class LoopUnavailable(Exception):
    """Why a scene cannot run in the compiled loop."""


@functools.cache
def load_library(*definitions: str) -> tuple[Any, Any]:
    """The interface (cffi.FFI) and the library of the loop, for what problem.h declares.

    `definitions` are macros, such as PHASES to measure where time goes.
    """
    ffi = cffi.FFI()
    ffi.cdef((_SOURCES / "problem.h").read_text().replace("#pragma once", ""))
    source = (_SOURCES / "loop.c").read_text()
    source = "".join(f"#define {name}\n" for name in definitions) + source
    return ffi, ffi.dlopen(str(_build("the loop over time steps", source, lambda: source)))


def load_batches(name: str, form, ufl_form, size: int, width: int, places: int) -> list[int]:
    """Addresses of a ``Batch`` of problem.h for each integral of a form: several elements at once.

    `size`, `width`, `places`: entries of an element tensor, coefficients, coordinates.
    """
    numbers = f"{size}, {max(width, 1)}, {places}"

    def source() -> str:
        text, functions, parameters = dolfinx_api.element_functions(form, ufl_form)
        unused = ", 0" * (parameters - 4)
        return "\n".join(
            [
                '#include "batch.h"',
                *(f"INLINED ufcx_tabulate_tensor_float64 {name};" for name in functions),
                "#define for UNROLLED for",
                text,
                "#undef for",
                *(f"BATCH(batch_{i}, {f}, {numbers}{unused})" for i, f in enumerate(functions)),
                "",
            ]
        )

    # What FFCx generates besides is dropped, as nothing outside can ask for it.
    flags = ["-fwhole-program", f"-I{dolfinx_api.ufcx_folder()}"]
    key = dolfinx_api.signature(form) + numbers
    path = _build(f"{name!r} for several elements", key, source, flags)
    library = ctypes.CDLL(str(path))
    functions = [library[f"batch_{i}"] for i in range(len(dolfinx_api.integrals(form)))]
    return [ctypes.cast(function, ctypes.c_void_p).value or 0 for function in functions]


def _build(what: str, key: str, source: Callable[[], str], more: Sequence[str] = ()) -> Path:
    """A shared object from a C source, which is asked for only where the cache does not have it."""
    headers = [path.read_text() for path in sorted(_SOURCES.glob("*.h"))]
    target, flags = target_flags()
    flags = [*flags, *more]
    # What is built for a name serves all machines, what is "native" those with this one's flags.
    machine = _processor() if target == "native" else []
    digest = hashlib.sha256("\n".join([key, *headers, *flags, *machine]).encode())
    cache = cache_directory()
    library = cache / f"{digest.hexdigest()[:32]}.so"
    try:
        if not library.exists():
            _log.info("compiling %s, once", what)
            cache.mkdir(parents=True, exist_ok=True)
            # Renamed when it is whole, as several processes may build it.
            with tempfile.TemporaryDirectory(dir=cache) as scratch:
                out = Path(scratch) / "built.so"
                command = [*compiler(), *flags, f"-I{_SOURCES}", "-x", "c", "-"]
                command += ["-o", str(out), "-lm"]
                subprocess.run(command, check=True, capture_output=True, text=True, input=source())
                out.replace(library)
    except (OSError, LookupError, subprocess.CalledProcessError) as error:
        if isinstance(error, subprocess.CalledProcessError):
            _check_target(target, flags)
        said = str(getattr(error, "stderr", None) or error)
        _warn(next((line for line in said.splitlines() if "error" in line), said))
        raise LoopUnavailable("it cannot be built") from error
    return library


@functools.cache
def _warn(reason: str) -> None:
    """Say once why."""
    _log.warning("the compiled loop cannot be built, steps run in Python: %s", reason)


def cache_directory() -> Path:
    """Where the library is kept, beside the forms that FEniCSx compiles."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "fx_beam"


def compiler() -> list[str]:
    """The compiler of FFCx's own functions, which is not named cc everywhere."""
    return shlex.split(os.environ.get("CC") or "cc")


def target_flags() -> tuple[str, list[str]]:
    """Processor to compile for (none where the compiler has no word for it), and all flags."""
    target = os.environ.get("FX_BEAM_MARCH") or ("native" if _OPTION else "")
    return target, [*_FLAGS, f"{_OPTION or '-march'}={target}"] if target else _FLAGS


def _check_target(target: str, flags: list[str]) -> None:
    """Refuse a processor that was asked for and that the compiler does not know."""
    command = [*compiler(), *flags, "-x", "c", "-", "-o", os.devnull]
    if (
        os.environ.get("FX_BEAM_MARCH")
        and subprocess.run(command, capture_output=True, text=True, input="").returncode
    ):
        raise SceneError(
            f"FX_BEAM_MARCH = {target!r} is no processor that the compiler knows; give a name "
            f"that its option {_OPTION or '-march'} takes, such as 'native' or 'x86-64-v3'"
        )


def _processor() -> list[str]:
    """What the compiler looks at for "native"."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return []
    return [line for line in lines if line.startswith(("flags", "Features"))][:1]
