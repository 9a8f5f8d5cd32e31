"""All use of FFCx and of the C that it generates, which differs between versions."""

from __future__ import annotations

import ctypes
import functools
import inspect
import logging
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import ffcx
import ffcx.codegeneration
import ffcx.codegeneration.jit
import ffcx.compiler
import ufl
from ffcx.ir.analysis.valuenumbering import ValueNumberer
from ufl.algorithms.analysis import extract_coefficients, extract_constants
from ufl.algorithms.check_arities import ArityMismatch

from fx_beam import c_library, library_cache

T = TypeVar("T")

_log = logging.getLogger("fx_beam")
# What later versions call options.
_OPTIONS = "parameters" if find_spec("ffcx.parameters") else "options"
_options = getattr(ffcx, f"get_{_OPTIONS}")
# The name of a parameter.
_PREFIX = (
    {"prefix", "namespace"} & set(inspect.signature(ffcx.compiler.compile_ufl_objects).parameters)
).pop()

#: Flags of all compilations. Vector instructions of a single law or element would read pairs of
#: numbers that were just written one by one, for which processors wait long. The loop computes
#: several elements at once instead.
FLAGS = "-O2", "-g0", "-fno-math-errno", "-fno-tree-slp-vectorize"
#: More for forms of which only functions of several elements are called, which are compiled again.
ONLY_IN_BATCHES = ("-O0",)
#: Errors of UFL and FFCx for an invalid form; ArityMismatch is not always an Exception.
REFUSALS: tuple[type[BaseException], ...] = (Exception, ArityMismatch)

# Modules of this process, which Python does not unload.
_loaded: dict[str, Any] = {}
# In the place of a folder: FFCx shall look for a module, and compile nothing.
_SEARCH = Path(os.devnull)


class _Missing(Exception):
    """The cache has no module of this name."""


class CompiledForm(NamedTuple):
    """A form, or an expression with its points, that was compiled for all meshes of its kind."""

    name: str
    form: Any
    ufcx: Any
    #: FFCx's module, which must stay in memory, and its source if it has just been compiled.
    module: Any
    code: Any
    #: All forms of the module.
    together: tuple[Any, ...]


def compile_together(forms: Mapping[str, Any], flags: Sequence[str] = ()) -> list[CompiledForm]:
    """Compile UFL forms, or expressions with their points, by name, as one module.

    For those always used together, with further flags of the C compiler. Those that were not in
    the cache are logged.
    """
    together = tuple(forms.values())
    are_forms = all(isinstance(each, ufl.Form) for each in together)
    compiler = ffcx.codegeneration.jit
    make: Any = compiler.compile_forms if are_forms else compiler.compile_expressions
    flags = [*FLAGS, *flags]

    def jit(folder: Path) -> Any:
        given = {"cffi_extra_compile_args": flags, "cffi_debug": False}
        return make(list(together), cache_dir=folder, **given)

    with _quiet():
        objects, module, code = _from_cache(jit)
    for name in forms if any(code) else ():
        _log.info("compiled the form %r, once", name)
    return [
        CompiledForm(name, form, ufcx, module, code, together)
        for (name, form), ufcx in zip(forms.items(), objects, strict=True)
    ]


def compile_form(form: Any, name: str) -> CompiledForm:
    """The same for a single form."""
    return compile_together({name: form})[0]


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep the compiler's lines out of the user's log.

    The JIT logs command lines at INFO on the root logger, and changes its level and handlers. What
    other threads say meanwhile on loggers of their own is not lost.
    """
    root = logging.getLogger()
    level, handlers = root.level, root.handlers[:]
    loggers = root, logging.getLogger("ffcx"), logging.getLogger("UFL")
    for logger in loggers:
        logger.addFilter(_is_warning)
    try:
        yield
    finally:
        root.setLevel(level)
        root.handlers[:] = handlers
        for logger in loggers:
            logger.removeFilter(_is_warning)


def _is_warning(record: logging.LogRecord) -> bool:
    return record.levelno > logging.INFO


def _from_cache(jit: Callable[[Path], T]) -> T:
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


def symbols(compiled: CompiledForm) -> tuple[list[Any], list[Any]]:
    """UFL's coefficients and constants of a form or expression, in the order of its code."""
    form, ufcx = compiled.form, compiled.ufcx
    if isinstance(form, ufl.Form):
        coefficients, constants = form.coefficients(), form.constants()
    else:
        coefficients, constants = extract_coefficients(form[0]), extract_constants(form[0])
    plural = "original_coefficient_position" + "s" * hasattr(ufcx, "original_coefficient_positions")
    at = getattr(ufcx, plural)
    return [coefficients[at[i]] for i in range(ufcx.num_coefficients)], list(constants)


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


def integral_functions(form) -> list[int]:
    """Address of the C function of each integral."""
    return [_address(form, integral) for _, integral in _integrals(form)]


def signature(form) -> str:
    """Identifier of a compiled form, with the version of its compiler."""
    return (
        form.module.ffi.string(form.ufcx.signature).decode() + ffcx.codegeneration.get_signature()
    )


def ufcx_folder() -> str:
    """Folder of the header that generated C includes."""
    return ffcx.codegeneration.get_include_path()


def element_functions(form) -> tuple[str, list[str], int]:
    """C source of a form's element tensors, a function name for each integral, parameter count.

    Raises LookupError if the compiled form does not give these names.
    """
    modules, names = zip(*map(_symbol, integral_functions(form)), strict=True)
    _, source = form.code  # empty unless it has just been compiled
    if not source:
        # Function names derive from the module's name, so they are the same again.
        source = _generated(form.together, Path(modules[0]).name.partition(".")[0])
    function = form.module.ffi.typeof("ufcx_tabulate_tensor_float64 *")
    return source, [*names], len(function.args)


def expression_function(compiled) -> int:
    """Address of the C function of a compiled expression."""
    return _address(compiled, compiled.ufcx)


def _address(form, ufcx) -> int:
    return int(form.module.ffi.cast("uintptr_t", ufcx.tabulate_tensor_float64))


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
