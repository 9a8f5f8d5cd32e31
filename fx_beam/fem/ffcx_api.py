"""All use of FFCx and of the C that it generates, which differs between versions.

A `form` here is a `dolfinx_api.CompiledForm`.
"""

from __future__ import annotations

import ctypes
import functools
import inspect
import os
import time
from collections.abc import Callable, Sequence
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import ffcx
import ffcx.codegeneration
import ffcx.codegeneration.jit
import ffcx.compiler

import cffi

_FFI = cffi.FFI()
# What later versions call options.
_OPTIONS = "parameters" if find_spec("ffcx.parameters") else "options"
_options = getattr(ffcx, f"get_{_OPTIONS}")
# The name of a parameter.
_PREFIX = (
    {"prefix", "namespace"} & set(inspect.signature(ffcx.compiler.compile_ufl_objects).parameters)
).pop()

# C files that this process has made and compiles, or has compiled.
_begun: set[Path] = set()


def _loaded_once(find: Callable) -> Callable:
    """FFCx's search for a compiled module, once for each, without reading the whole cache folder.

    `find` waits for a module that another process compiles, and begins one that is missing.
    """
    found: dict[tuple[str, str], Any] = {}  # nothing that Python would unload

    @functools.wraps(find)
    def wrapper(module_name, object_names, cache_dir, timeout):
        key, path = (module_name, str(cache_dir)), Path(cache_dir, module_name)
        until = time.monotonic() + timeout
        objects, module = found.get(key) or _ready(path, object_names)
        while module is None and path.with_suffix(".c").exists() and time.monotonic() < until:
            time.sleep(0.01)  # `find` itself would look again after a second
            objects, module = _ready(path, object_names)
        if module is None:
            left = max(1, round(until - time.monotonic()))
            objects, module = find(module_name, object_names, cache_dir, left)
        if module is not None:
            found[key] = objects, module
        else:  # it is to be compiled
            _begun.add(path.with_suffix(".c"))
        return objects, module

    return wrapper


def _ready(path: Path, names: list[str]) -> tuple[list | None, Any]:
    """Objects and module of a complete entry of the cache; None without it."""
    library = next(filter(os.path.exists, (f"{path}{end}" for end in EXTENSION_SUFFIXES)), None)
    if library is None or not path.with_suffix(".c.cached").exists():
        return None, None
    spec = spec_from_file_location(path.name, library)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return [getattr(module.lib, name) for name in names], module


def discard_unfinished() -> None:
    """Remove from the cache what this process began and did not finish: others would wait."""
    for source in _begun:
        if not source.with_suffix(".c.cached").exists():
            source.unlink(missing_ok=True)
    _begun.clear()


# In the place of FFCx's own, as dolfinx lets nobody hand it another.
ffcx.codegeneration.jit.get_cached_module = _loaded_once(ffcx.codegeneration.jit.get_cached_module)


def compile_forms(forms: Sequence, scalar: dict[str, Any], settings: dict[str, Any]) -> Any:
    """Compiled forms of one module, the module, and its code if it was not in the cache."""
    named: dict[str, Any] = {_OPTIONS: _options(scalar)}
    return ffcx.codegeneration.jit.compile_forms(list(forms), **named, **settings)


def _integrals(form) -> list[tuple[int, Any]]:
    """Cell integrals of a compiled form, ordered by subdomain (-1: all cells)."""
    cell, ufcx = 0, form.ufcx  # cell integrals are type 0
    if hasattr(ufcx, "num_integrals"):
        count, ids, of = ufcx.num_integrals(cell), ufcx.integral_ids(cell), ufcx.integrals(cell)
        return [(ids[i], of[i]) for i in range(count)]
    places = range(*ufcx.form_integral_offsets[cell : cell + 2])
    return [(ufcx.form_integral_ids[i], ufcx.form_integrals[i]) for i in places]


def integrals(form) -> list[int]:
    """Subdomain of each integral of a compiled form (-1: all cells)."""
    return [subdomain for subdomain, _ in _integrals(form)]


def signature(form) -> str:
    """Identifier of a compiled form, with the version of its compiler."""
    return _FFI.string(form.ufcx.signature).decode() + ffcx.codegeneration.get_signature()


def ufcx_folder() -> str:
    """Folder of the header that generated C includes."""
    return ffcx.codegeneration.get_include_path()


def element_functions(form) -> tuple[str, list[str], int]:
    """C source of a form's element tensors, a function name for each integral, parameter count.

    Raises LookupError if the compiled form does not give these names.
    """
    functions = [integral.tabulate_tensor_float64 for _, integral in _integrals(form)]
    module, names = "", []
    for function in functions:
        module, name = _symbol(_address(function))
        names.append(name)
    _, source = form.code  # empty unless it has just been compiled
    if not source:
        # Function names derive from the module's name, so they are the same again.
        source = _generated(form.together, Path(module).name.partition(".")[0])
    return source, names, len(_FFI.typeof(functions[0]).args)


def expression_function(compiled) -> int:
    """Address of the C function of a compiled expression."""
    return _address(compiled.ufcx.tabulate_tensor_float64)


def _address(function) -> int:
    return int(_FFI.cast("uintptr_t", function))


class _Symbol(ctypes.Structure):
    _fields_ = [
        ("file", ctypes.c_char_p),
        ("base", ctypes.c_void_p),
        ("name", ctypes.c_char_p),
        ("address", ctypes.c_void_p),
    ]


def _symbol(address: int) -> tuple[str, str]:
    """File and name of a function, from the linker."""
    found = _Symbol()
    ctypes.CDLL(None).dladdr(ctypes.c_void_p(address), ctypes.byref(found))
    if found.address != address:  # the address of an earlier symbol
        raise LookupError("the functions that FFCx generates have no symbol names")
    return found.file.decode(), found.name.decode()


def _generated(forms: Sequence, prefix: str) -> str:
    """C that FFCx generates for the forms of a module."""
    named: dict[str, Any] = {_PREFIX: prefix, _OPTIONS: _options()}
    # Header and code, or a list of these with file name extensions.
    made: Any = ffcx.compiler.compile_ufl_objects(list(forms), **named)
    return made[1] if isinstance(made[1], str) else made[0][1]
