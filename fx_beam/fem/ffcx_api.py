"""All use of FFCx and of the C that it generates, which differs between versions.

A `form` here is a `dolfinx_api.CompiledForm`.
"""

from __future__ import annotations

import ctypes
import functools
import inspect
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any, TypeVar

import ffcx
import ffcx.codegeneration
import ffcx.codegeneration.jit
import ffcx.compiler
import ufl
from ffcx.ir.analysis.valuenumbering import ValueNumberer

import cffi
import numpy as np

from fx_beam import c_library, library_cache

T = TypeVar("T")

_FFI = cffi.FFI()
# What later versions call options.
_OPTIONS = "parameters" if find_spec("ffcx.parameters") else "options"
_options = getattr(ffcx, f"get_{_OPTIONS}")
# The name of a parameter.
_PREFIX = (
    {"prefix", "namespace"} & set(inspect.signature(ffcx.compiler.compile_ufl_objects).parameters)
).pop()

# Modules of this process, which Python does not unload.
_loaded: dict[str, Any] = {}
# In the place of a folder: FFCx shall look for a module, and compile nothing.
_SEARCH = Path(os.devnull)


class _Missing(Exception):
    """The cache has no module of this name."""


def from_cache(jit: Callable[[Path], T]) -> T:
    """What FFCx makes in a folder, or has made before."""
    try:
        return jit(_SEARCH)
    except _Missing as missing:
        name = str(missing)

    def search() -> T | None:
        with suppress(_Missing):
            return jit(_SEARCH)
        return None

    def builder(scratch: Path) -> T:
        try:
            made = jit(scratch)
        except Exception:
            c_library.check_compiler()
            raise
        built = (scratch / f"{name}{end}" for end in EXTENSION_SUFFIXES)
        next(filter(Path.exists, built)).rename(scratch / _file(name))
        return made

    return library_cache.build(_file(name), search, builder)


def _file(name: str) -> str:
    """Name of a module's file, with the version of Python and the system."""
    return name + EXTENSION_SUFFIXES[0]


def _from_own_cache(find: Callable) -> Callable:
    """FFCx's search for a compiled module, in the package's own cache where it is asked for."""

    @functools.wraps(find)
    def wrapper(module_name, object_names, cache_dir, timeout):
        if Path(cache_dir) != _SEARCH:
            return find(module_name, object_names, cache_dir, timeout)
        if module_name not in _loaded:
            loader = functools.partial(_module, module_name, object_names)
            module = library_cache.load(_file(module_name), loader)
            if module is None:
                raise _Missing(module_name)
            _loaded[module_name] = module
        module = _loaded[module_name]
        return [getattr(module.lib, name) for name in object_names], module

    return wrapper


def _module(name: str, object_names: list[str], path: Path) -> Any:
    spec = spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    for each in object_names:
        getattr(module.lib, each)
    return module


# In the place of FFCx's own, as dolfinx lets nobody hand it another: that one waits in vain for a
# process that was killed, and loads whatever lies there.
ffcx.codegeneration.jit.get_cached_module = _from_own_cache(
    ffcx.codegeneration.jit.get_cached_module
)


def _symbols_of(numbering: ValueNumberer, expression: Any) -> Any:
    """Symbols of an expression of a graph."""
    return numbering.V_symbols[numbering.G.e2i[expression]]


# In the place of a search through the graph for each expression, a fifth of the time of FFCx.
ValueNumberer.get_node_symbols = _symbols_of


def compile_together(objects: Sequence, scalar: dict[str, Any], settings: dict[str, Any]) -> Any:
    """Compiled forms, or expressions with their points, as one module.

    And the module, and its code if it was not in the cache.
    """
    named: dict[str, Any] = {_OPTIONS: _options(scalar)}
    are_forms = all(isinstance(each, ufl.Form) for each in objects)
    compiler = ffcx.codegeneration.jit
    make = compiler.compile_forms if are_forms else compiler.compile_expressions
    return make(list(objects), **named, **settings)


def _integrals(form) -> list[tuple[int, Any]]:
    """Cell integrals of a compiled form, ordered by subdomain (-1: all cells)."""
    cell, ufcx = 0, form.ufcx  # cell integrals are type 0
    if hasattr(ufcx, "num_integrals"):
        count, ids, of = ufcx.num_integrals(cell), ufcx.integral_ids(cell), ufcx.integrals(cell)
        return [(ids[i], of[i]) for i in range(count)]
    indices = range(*ufcx.form_integral_offsets[cell : cell + 2])
    return [(ufcx.form_integral_ids[i], ufcx.form_integrals[i]) for i in indices]


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


def element_tensors(form, w: np.ndarray, points: Sequence, size: int) -> np.ndarray:
    """Matrices (n, size, size) of a bilinear form for coefficients w (n, width) of one element."""
    (_, integral), *_ = _integrals(form)
    tabulate = integral.tabulate_tensor_float64
    rest = [_FFI.NULL] * (len(_FFI.typeof(tabulate).args) - 4)
    x, A = np.array(points, float), np.zeros((len(w), size, size))
    for values, tensor in zip(w, A, strict=True):
        given = (_FFI.from_buffer("double[]", array) for array in (tensor, values))
        tabulate(*given, _FFI.NULL, _FFI.from_buffer("double[]", x), *rest)
    return A


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
    symbol = _Symbol()
    ctypes.CDLL(None).dladdr(ctypes.c_void_p(address), ctypes.byref(symbol))
    if symbol.address != address:  # the address of an earlier symbol
        raise LookupError("the functions that FFCx generates have no symbol names")
    return symbol.file.decode(), symbol.name.decode()


def _generated(forms: Sequence, prefix: str) -> str:
    """C that FFCx generates for the forms of a module."""
    named: dict[str, Any] = {_PREFIX: prefix, _OPTIONS: _options()}
    # Header and code, or a list of these with file name extensions.
    made: Any = ffcx.compiler.compile_ufl_objects(list(forms), **named)
    return made[1] if isinstance(made[1], str) else made[0][1]
