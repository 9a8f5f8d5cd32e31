"""The compiled libraries of the loop, and of the functions of several elements that it calls."""

from __future__ import annotations

import platform
from collections.abc import Callable
from typing import Any

from fx_beam import c_library
from fx_beam.results.state import MACROS

# Of what FFCx writes, and of features that scenes lack.
_FLAGS = [c_library.WHOLE_PROGRAM]
# Half the time of compilation, and the same speed: functions marked as HOT are optimised in full.
# Not for derivatives forwards, whose time is spent in many places.
_QUICKLY = ["-O1", "-fstrict-aliasing"]
# Vectors of steps are short: many are read soon after their numbers were stored one by one.
_SHORT = ["-mprefer-vector-width=256"] if platform.machine() == "x86_64" else []
_WHAT = {
    "": "the loop over time steps",
    "VJP": "derivatives of time steps, backwards",
    "JVP": "derivatives of time steps, forwards",
    "FIT": "rates that fit joints",
}


def load_library(features: str = "CHAIN", derivatives: str = "") -> tuple[Any, Any]:
    """The cffi.FFI with the declarations of problem.h, and a compiled library of the loop.

    It serves scenes with some features (c/scene_features.h); or has `derivatives` of steps in their
    place, "VJP" or "JVP".
    """
    title, macros, flags = _asked(features, derivatives)
    return c_library.open_library(title, "loop.c", "problem.h", MACROS, macros, flags)


def _asked(features: str, derivatives: str) -> tuple[str, tuple[str, ...], tuple[str, ...]]:
    """Title of a library, its macros, and its flags."""
    macros = f"FEATURES {features}", *filter(None, [derivatives])
    flags = {"": [*_QUICKLY, *_SHORT], "JVP": []}.get(derivatives, _QUICKLY)
    return _WHAT[derivatives], macros, (*_FLAGS, *flags)


def begin_to_build(features: str, derivatives: str = "") -> None:
    """Compile the same library beside all else, if the cache lacks it."""
    title, macros, flags = _asked(features, derivatives)
    c_library.begin_to_build(title, "loop.c", (*MACROS, *macros), flags)


def load_batches(
    name: str,
    key: str,
    source: Callable[[], str],
    functions: int,
    numbers: tuple[int, int, int],
    loaded: dict[tuple[str, ...], c_library.Functions],
) -> list[int]:
    """Addresses of a ``Batch`` of tables.h for each C function of a source.

    The functions of one element, element_0, element_1, ..., have these numbers of tensor entries,
    coefficients and coordinates. They stay as long as they are among those that are `loaded`.
    """
    sizes = ", ".join(str(max(number, 1)) for number in numbers)
    flags = [*_FLAGS, "-freciprocal-math", "-fno-signed-zeros", *c_library.SCHEDULED]
    cache_key = key, sizes, *c_library.target_flags()[1], *flags
    if cache_key in loaded:
        return loaded[cache_key]
    names = [f"batch_{i}" for i in range(functions)]
    batches = [f"BATCH({batch}, element_{i}, {sizes})" for i, batch in enumerate(names)]

    def text() -> str:
        state = [f"#define {definition}" for definition in MACROS]
        return "\n".join([*state, '#include "batch.h"', source(), *batches, ""])

    title = f"{name!r} for several elements"
    loaded[cache_key] = c_library.functions_of(title, key + sizes, text, names, flags)
    return loaded[cache_key]
