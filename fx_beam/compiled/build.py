"""Compiles the C files once for each type of processor and keeps the libraries in a cache."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import logging
import os
import platform
import shlex
import subprocess
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import cffi

from fx_beam import library_cache
from fx_beam.errors import SceneError
from fx_beam.fem import ffcx_api

T = TypeVar("T")

_log = logging.getLogger("fx_beam")
_SOURCES = Path(__file__).parent / "c"
_FLAGS = [
    *("-O3", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC"),
    # The full vector width: by default, compilers use half of it on some processors.
    *(["-mprefer-vector-width=512"] if platform.machine() == "x86_64" else []),
    # GCC would merge sin and cos of one angle into a complex function, which it cannot vectorise.
    *("-fno-builtin-sin", "-fno-builtin-cos"),
]
# Compiler option for the processor, on architectures where it accepts "native".
_OPTION = {"x86_64": "-march", "aarch64": "-mcpu"}.get(platform.machine())
# Addresses in the libraries that this process has loaded, which Python does not unload.
_loaded: dict[tuple[str, ...], list[int]] = {}


class LoopUnavailable(Exception):
    """The compiled loop cannot run a scene; the message is the reason."""


@functools.cache
def declarations() -> str:
    """The declarations of problem.h."""
    return (_SOURCES / "problem.h").read_text().replace("#pragma once", "")


@functools.cache
def load_library(*definitions: str) -> tuple[Any, Any]:
    """The cffi.FFI with the declarations of problem.h, and the compiled library of the loop.

    `definitions` are macros, such as PHASES, which measures the time of each phase.
    """
    ffi = cffi.FFI()
    ffi.cdef(declarations())
    source = (_SOURCES / "loop.c").read_text()
    source = "".join(f"#define {name}\n" for name in definitions) + source
    library = _library(
        "the loop over time steps", source, lambda: source, lambda path: ffi.dlopen(str(path))
    )
    _check_processor(ffi.string(library.fx_missing()).decode())
    return ffi, library


def load_batches(
    name: str, key: str, source: Callable[[], str], functions: int, numbers: tuple[int, int, int]
) -> list[int]:
    """Addresses of a ``Batch`` of problem.h for each C function of a source.

    The functions of one element, element_0, element_1, ..., have these numbers of tensor entries,
    coefficients and coordinates.
    """
    sizes = ", ".join(str(max(number, 1)) for number in numbers)
    asked = key, sizes, *target_flags()[1]
    if asked in _loaded:
        return _loaded[asked]
    names = [f"batch_{i}" for i in range(functions)]
    batches = [f"BATCH({batch}, element_{i}, {sizes})" for i, batch in enumerate(names)]

    def text() -> str:
        return "\n".join(['#include "batch.h"', source(), *batches, ""])

    def loader(path: Path) -> list[int]:
        library = ctypes.CDLL(str(path))
        return [ctypes.cast(library[batch], ctypes.c_void_p).value or 0 for batch in names]

    # -fwhole-program drops the unused part of FFCx's code.
    flags = ["-fwhole-program", f"-I{ffcx_api.ufcx_folder()}"]
    _loaded[asked] = _library(f"{name!r} for several elements", key + sizes, text, loader, flags)
    return _loaded[asked]


def _library(
    what: str,
    key: str,
    source: Callable[[], str],
    loader: Callable[[Path], T],
    more: Sequence[str] = (),
) -> T:
    """What the loader makes of a compiled library; `source` is called only to compile it."""
    target, flags = target_flags()
    flags = [*flags, *more]
    # Libraries for "native" are valid only for processors with the same features.
    machine = [_processor()] if target == "native" else []
    digest = hashlib.sha256("\n".join([key, _headers(), *flags, *machine]).encode())
    name = f"{digest.hexdigest()[:32]}.so"

    def builder(folder: Path) -> T:
        _log.info("compiling %s, once", what)
        command = [*compiler(), *flags, f"-I{_SOURCES}", "-x", "c", "-"]
        command += ["-o", str(folder / name), "-lm"]
        subprocess.run(command, check=True, capture_output=True, text=True, input=source())
        return loader(folder / name)

    def search() -> T | None:
        return library_cache.load(name, loader)

    try:
        found = search()
        return library_cache.build(name, search, builder) if found is None else found
    except (OSError, LookupError, AttributeError, subprocess.CalledProcessError) as error:
        if isinstance(error, subprocess.CalledProcessError):
            _check_target(target, flags)
        said = str(getattr(error, "stderr", None) or error)
        _warn(next((line for line in said.splitlines() if "error" in line), said))
        raise LoopUnavailable("it cannot be built") from error


@functools.cache
def _warn(reason: str) -> None:
    """Warn once for each reason."""
    _log.warning(
        "the compiled loop cannot be built: %s. Steps run in Python, which is slower. Check the C "
        "compiler (environment variable CC) and the cache folder %s",
        reason,
        library_cache.folder(),
    )


def compiler() -> list[str]:
    """Command of the C compiler; the same as FFCx uses."""
    return shlex.split(os.environ.get("CC") or "cc")


def target_flags() -> tuple[str, list[str]]:
    """Target processor, empty for the compiler's default, and all compiler flags."""
    target = os.environ.get("FX_BEAM_MARCH") or ("native" if _OPTION else "")
    return target, [*_FLAGS, f"{_OPTION or '-march'}={target}"] if target else _FLAGS


def _check_target(target: str, flags: list[str]) -> None:
    """SceneError if the compiler does not know the processor in FX_BEAM_MARCH."""
    command = [*compiler(), *flags, "-x", "c", "-", "-o", os.devnull]
    if (
        os.environ.get("FX_BEAM_MARCH")
        and subprocess.run(command, capture_output=True, text=True, input="").returncode
    ):
        raise SceneError(
            f"FX_BEAM_MARCH = {target!r} is not known to the compiler. Give a value of its option "
            f"{_OPTION or '-march'}, such as 'native' or 'x86-64-v3'"
        )


def _check_processor(missing: str) -> None:
    """SceneError if the library may use what this processor does not have."""
    if missing:
        raise SceneError(
            f"FX_BEAM_MARCH = {target_flags()[0]!r} is for processors with {missing}, which this "
            "one does not have. Give 'native', or a processor that both machines support"
        )


@functools.cache
def _headers() -> str:
    """Text of the headers that each library includes."""
    return "\n".join(path.read_text() for path in sorted(_SOURCES.glob("*.h")))


@functools.cache
def _processor() -> str:
    """Features of this processor, which decide what "native" means."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return ""
    return next((line for line in lines if line.startswith(("flags", "Features"))), "")
