"""C files compiled once for each type of processor: the compiler, the libraries, and structs."""

from __future__ import annotations

import ctypes
import functools
import hashlib
import logging
import math
import os
import platform
import re
import shlex
import shutil
import struct
import subprocess
import sys
import tempfile
import threading
import weakref
from collections.abc import Callable, Mapping, MutableMapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from fx_beam import library_cache
from fx_beam.errors import SceneError

if TYPE_CHECKING:
    from _cffi_backend import FFI, Lib


# -- The C compiler: its command, which one it is, and where it runs ----------------------------


# Environment variables that change what is included, linked or written: they are left out.
_LEFT_OUT = {
    *("CPATH", "C_INCLUDE_PATH", "GCC_EXEC_PREFIX", "COMPILER_PATH", "LIBRARY_PATH", "LD_RUN_PATH"),
    *("CCC_OVERRIDE_OPTIONS", "QA_OVERRIDE_GCC3_OPTIONS"),  # of clang
    *("DEPENDENCIES_OUTPUT", "SUNPRO_DEPENDENCIES"),
}
_DEFAULT = "cc"


def command() -> list[str]:
    """Program of the compiler, with its path if it is found, and the arguments of the command.

    RuntimeError if the environment variable CC is no command.
    """
    text = os.environ.get("CC", "")
    try:
        program, *arguments = shlex.split(text) or [_DEFAULT]
    except ValueError as error:
        raise RuntimeError(
            f"the environment variable CC = {text!r} is no command: {error}. Give the C compiler "
            "and its options, such as CC='gcc -B/opt/tools'"
        ) from None
    place = shutil.which(program, path=os.pathsep.join(_folders()))
    return [os.path.abspath(place) if place else program, *arguments]


def check() -> None:
    """RuntimeError without a C compiler."""
    program = command()[0]
    if not (os.path.isabs(program) and os.access(program, os.X_OK)):
        raise RuntimeError(
            f"there is no C compiler {program!r}, by which each new kind of scene is compiled. "
            "Install one, on Debian by apt-get install gcc libc6-dev, or name another in the "
            "environment variable CC"
        )


def identity() -> str:
    """Text that tells compilers and their versions apart, found once, without a start.

    Any of its words may be a program that starts another of its name, or the default: of each,
    all that are on the path count, by their place, size and time.
    """
    return _facts(tuple(command()), _folders()).identity


def is_clang() -> bool:
    """Whether it is clang, by its name or that of its file, without a start."""
    return sys.platform == "darwin" or _facts(tuple(command()), _folders()).is_clang


class _Facts(NamedTuple):
    identity: str
    is_clang: bool


@functools.cache
def _facts(words: tuple[str, ...], folders: tuple[str, ...]) -> _Facts:
    names = {*words, os.path.basename(words[0]), _DEFAULT}
    files = {os.path.realpath(os.path.join(f, name)) for f in folders for name in names}
    status = [(file, os.stat(file)) for file in sorted(files) if os.path.isfile(file)]
    identity = repr((words, [(file, stat.st_size, stat.st_mtime_ns) for file, stat in status]))
    programs = *words, os.path.realpath(words[0])
    return _Facts(identity, any("clang" in os.path.basename(path) for path in programs))


def run(arguments: Sequence[str], source: str, folder: Path) -> None:
    """Compile a source in a folder, where it also has its temporary files.

    subprocess.CalledProcessError, with what it said, if it fails.
    """
    variables = {name: value for name, value in os.environ.items() if name not in _LEFT_OUT}
    subprocess.run(
        [*command(), *arguments],
        check=True,
        input=source,
        capture_output=True,
        cwd=folder,
        # In English, as a line with "error:" is looked for.
        env=variables | {"LC_ALL": "C", "TMPDIR": str(folder)},
        text=True,
        # As paths, which may be in the source.
        encoding=sys.getfilesystemencoding(),
        errors="surrogateescape",
    )


def check_whole(library: Path) -> None:
    """OSError for a library (ELF, of 64 bits) that ends before what is mapped of it.

    A process that loads it would be killed.
    """
    content = library.read_bytes()
    if content[:5] != b"\x7fELF\2" or len(content) < 64:
        return  # the loader refuses what it cannot read
    order = "<" if content[5] == 1 else ">"
    (table,) = struct.unpack_from(f"{order}Q", content, 32)
    size, count = struct.unpack_from(f"{order}2H", content, 54)
    for k in range(count):
        place = table + k * size
        if place + size <= len(content):
            offset, _, _, mapped = struct.unpack_from(f"{order}4Q", content, place + 8)
            if offset + mapped <= len(content):
                continue
        raise OSError(f"{library.name} is incomplete: it has only {len(content)} bytes")


def _folders() -> tuple[str, ...]:
    """Folders in which programs are looked for: none that is relative to the current one."""
    return tuple(filter(os.path.isabs, os.get_exec_path()))


# -- C files compiled once for each type of processor, kept in a cache; members of their structs


T = TypeVar("T")

_log = logging.getLogger("fx_beam")
#: Folder of the C files.
SOURCES = Path(__file__).parent / "step" / "c"
_FLAGS = [
    *("-O3", "-fno-math-errno", "-fno-trapping-math", "-shared", "-fPIC"),
    # Functions of one file may be inlined, though a library exports them.
    "-fno-semantic-interposition",
]
_IS_X86 = platform.machine() == "x86_64"
_GCC_FLAGS = [
    # The full vector width: by default, compilers use half of it on some processors.
    *(["-mprefer-vector-width=512"] if _IS_X86 else []),
    # GCC would merge sin and cos of one angle into a complex function, which it cannot vectorise.
    *("-fno-builtin-sin", "-fno-builtin-cos"),
]
_HAS_GLIBC = "CS_GNU_LIBC_VERSION" in os.confstr_names and bool(os.confstr("CS_GNU_LIBC_VERSION"))
_CLANG_FLAGS = [
    "-ffp-contract=fast",  # as GCC does
    # It knows the vector functions of glibc for four numbers, not for eight.
    *(["-mprefer-vector-width=256", "-fveclib=libmvec"] if _IS_X86 and _HAS_GLIBC else []),
]
#: What nothing needs of a library's code is dropped; clang does so only in a link.
WHOLE_PROGRAM = "-fwhole-program"
#: Long functions without branches: GCC orders them for few registers on x86, too.
SCHEDULED = "-fschedule-insns", "-fsched-pressure"
# Compiler option for the processor, on architectures where it accepts "native".
_OPTION = {"x86_64": "-march", "aarch64": "-mcpu"}.get(platform.machine())

# Extensions of a processor that compilers may use.
_X86 = "SSE4.2 AVX AVX2 BMI2 FMA FMA4 XOP AVX-512F AVX-512VL AVX-512DQ AVX-512BW".split()
_ARM = {"ATOMICS": (8, "atomic instructions (LSE)"), "SVE": (22, "SVE")}
_QUESTION = '#ifdef __%s\n  if (!(%s)) return "%s";\n#endif\n'
_QUESTIONS = [
    *(
        _QUESTION % (f"{x.replace('.', '_')}__", f'__builtin_cpu_supports("{x.lower()}")', name)
        for name, x in ((name, name.replace("-", "")) for name in _X86)
    ),
    *(
        _QUESTION % (f"ARM_FEATURE_{x}", f"getauxval(AT_HWCAP) & 1UL << {bit}", name)
        for x, (bit, name) in _ARM.items()
    ),
]
_MISSING = "const char *fx_missing(void)"
# The name of what the processor lacks, or an empty one; the function itself runs on any processor.
_ASKS = f"""
#if defined __aarch64__ && defined __linux__
#include <sys/auxv.h>
#endif
#ifdef __x86_64__
__attribute__((target("arch=x86-64")))
#endif
#if __has_attribute(externally_visible)
__attribute__((externally_visible))
#endif
{_MISSING} {{
{"".join(_QUESTIONS)}  return "";
}}
"""
# What C takes arrays of numbers as.
_NUMBERS = {"int": np.int32, "double": np.float64}


# What this process has compiled or loaded: declarations, libraries, forms and laws. What contains
# functions of a user is forgotten when nothing refers to it.
_things: dict[object, Any] = {}
_user_things: weakref.WeakValueDictionary[object, Any] = weakref.WeakValueDictionary()


class CannotBuild(RuntimeError):
    """A C file cannot be compiled, or its library not be loaded."""


def compiled(key: object, make: Callable[[], T], user_defined: bool = False) -> T:
    """The result of `make` for a key, made once, also if several threads ask at the same time."""
    results: MutableMapping[object, T] = _user_things if user_defined else _things
    if (result := results.get(key)) is None:
        result = results.setdefault(key, make())
    return result


def declared(header: str, definitions: tuple[str, ...]) -> FFI:
    """The cffi.FFI with the declarations of a header, in which `definitions` are macros.

    It is kept in the cache: cffi's parser takes longer than all else of a first call.
    """
    return compiled((declared, header, definitions), lambda: _declared(header, definitions))


def _declared(header: str, definitions: tuple[str, ...]) -> FFI:
    text = declarations(header)
    for macro, _, value in (definition.partition(" ") for definition in definitions):
        text = re.sub(rf"\b{macro}\b", value, text)
    text = f"{text}\n{_MISSING};"
    name = f"{hashlib.sha256(text.encode()).hexdigest()[:32]}.types"

    def loader(path: Path) -> FFI:
        return _ffi_of(library_cache.content(path))

    def builder(folder: Path) -> FFI:
        from cffi import FFI
        from cffi.recompiler import make_py_source

        parser = FFI()
        parser.cdef(text)
        parser.set_source("types", None)
        make_py_source(parser, "types", str(folder / name))
        return _ffi_of((folder / name).read_bytes())

    return library_cache.loaded(name, loader, builder)


def _ffi_of(code: bytes) -> FFI:
    """The cffi.FFI that a module of declarations makes."""
    namespace: dict[str, FFI] = {}
    exec(code, namespace)
    return namespace["ffi"]


def open_library(
    title: str,
    file: str,
    header: str,
    definitions: tuple[str, ...] = (),
    library_macros: tuple[str, ...] = (),
    flags: tuple[str, ...] = (),
) -> tuple[FFI, Lib]:
    """The cffi.FFI with the declarations of a header, and the library of a C file; see `load`.

    `definitions` are macros of both, `library_macros` of the library alone: several may share their
    structs. The library says by `fx_missing` what the processor lacks.
    """
    arguments = title, file, header, definitions, library_macros, flags
    return compiled((open_library, *arguments), lambda: _opened(*arguments))


def _opened(title, file, header, definitions, library_macros, flags) -> tuple[FFI, Lib]:
    ffi, source = declared(header, definitions), with_macros(file, *definitions, *library_macros)

    def loader(path: Path) -> Lib:
        # cffi itself takes no path that the locale cannot write.
        library = ctypes.CDLL(str(path))
        return ffi.dlopen(ffi.cast("void *", library._handle))

    library = load(title, source, lambda: source, loader, flags)
    if missing := ffi.string(library.fx_missing()).decode():
        raise SceneError(
            f"FX_BEAM_MARCH = {target_flags()[0]!r} is for processors with {missing}, which this "
            "one does not have. Give 'native', or a processor that both machines support"
        )
    return ffi, library


def begin_to_build(
    title: str, file: str, macros: tuple[str, ...], flags: tuple[str, ...] = ()
) -> None:
    """Compile a library beside all else, if the cache lacks it."""

    def build() -> None:
        source = with_macros(file, *macros)
        with suppress(RuntimeError, SceneError):  # who loads it is told why
            load(title, source, lambda: source, lambda _: True, flags)

    def start() -> threading.Thread:
        thread = threading.Thread(target=build)
        thread.start()
        return thread

    compiled((begin_to_build, file, macros, flags), start)


def with_macros(file: str, *macros: str) -> str:
    """Text of a C file after the definition of some macros, with `fx_missing`."""
    defined = "".join(f"#define {macro}\n" for macro in macros)
    return f"{defined}{(SOURCES / file).read_text()}{_ASKS}"


def load(
    title: str,
    key: str,
    source: Callable[[], str],
    loader: Callable[[Path], T],
    extra_flags: Sequence[str] = (),
) -> T:
    """Result of the loader for a compiled library; `source` is called only to compile it.

    CannotBuild, with the reason, if it cannot be compiled or loaded.
    """
    target, flags = target_flags()
    flags = [*flags, *_known_flags(extra_flags)]
    # Libraries for "native" are valid only for processors with the same features.
    headers, processor = compiled((_origin,), _origin)
    machine = [processor] if target == "native" else []
    parts = [key, headers, *flags, *machine, identity()]
    digest = hashlib.sha256("\n".join(parts).encode("utf-8", "surrogateescape"))
    name = f"{digest.hexdigest()[:32]}.so"

    def builder(folder: Path) -> T:
        _log.info("compiling %s, once", title)
        headers = "-iquote", str(SOURCES)
        arguments = [*flags, *headers, "-x", "c", "-", "-o", str(folder / name), "-lm"]
        run(arguments, source(), folder)
        check_whole(folder / name)
        return loader(folder / name)

    try:
        return library_cache.loaded(name, loader, builder)
    except (OSError, LookupError, AttributeError, subprocess.CalledProcessError) as error:
        if isinstance(error, subprocess.CalledProcessError):
            _check_target(target, flags)
        text = str(getattr(error, "stderr", None) or error)
        text = text.encode(errors="surrogateescape").decode(errors="replace")  # in any encoding
        reason = next((line for line in text.splitlines() if "error:" in line), text)
        raise CannotBuild(
            f"{title} cannot be built: {reason}. Check the C compiler (environment variable CC) "
            f"and the cache folder {library_cache.folder()}"
        ) from error


class Functions(list[int]):
    """Addresses of functions of a library, which is closed when nothing has them any more."""


def functions_of(
    title: str, key: str, source: Callable[[], str], names: Sequence[str], flags: Sequence[str]
) -> Functions:
    """Some functions of a compiled library; see `load`."""

    def loader(path: Path) -> Functions:
        library = ctypes.CDLL(str(path))
        addresses = [ctypes.cast(library[name], ctypes.c_void_p).value or 0 for name in names]
        functions, close = Functions(addresses), ctypes.CDLL(None).dlclose
        handle = ctypes.c_void_p(library._handle)
        weakref.finalize(functions, close, handle).atexit = False  # others may run until the end
        return functions

    return load(title, key, source, loader, flags)


def target_flags() -> tuple[str, list[str]]:
    """Target processor, empty for the compiler's default, and all compiler flags."""
    target = os.environ.get("FX_BEAM_MARCH") or ("native" if _OPTION else "")
    flags = [*_FLAGS, *(_CLANG_FLAGS if is_clang() else _GCC_FLAGS)]
    return target, [*flags, f"{_OPTION or '-march'}={target}"] if target else flags


def _known_flags(flags: Sequence[str]) -> Sequence[str]:
    """The flags that the compiler knows. Clang optimises no single functions: it does all."""
    if not is_clang():
        return flags
    unknown = WHOLE_PROGRAM, *SCHEDULED
    return ["-O2" if flag == "-O1" else flag for flag in flags if flag not in unknown]


def _check_target(target: str, flags: list[str]) -> None:
    """SceneError if the compiler does not know the processor in FX_BEAM_MARCH."""
    if not os.environ.get("FX_BEAM_MARCH"):
        return
    try:
        with tempfile.TemporaryDirectory() as folder:
            run([*flags, "-x", "c", "-", "-o", "empty"], "", Path(folder))
    except subprocess.CalledProcessError:
        raise SceneError(
            f"FX_BEAM_MARCH = {target!r} is not known to the compiler. Give a value of its option "
            f"{_OPTION or '-march'}, such as 'native' or 'x86-64-v3'"
        ) from None


def declarations(header: str) -> str:
    """Text of a header and of the headers that it includes, without directives."""
    lines = (SOURCES / header).read_text().splitlines()
    included = [line.split('"')[1] for line in lines if line.startswith('#include "')]
    plain = [line for line in lines if not line.startswith("#")]
    return "\n".join([*map(declarations, included), *plain])


class _Origin(NamedTuple):
    """Text of the headers that each library includes, and features of this processor."""

    headers: str
    #: What "native" means.
    processor: str


def _origin() -> _Origin:
    headers = "\n".join(path.read_text() for path in sorted(SOURCES.glob("*.h")))
    lines = list[str]()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    features = (line for line in lines if line.startswith(("flags", "Features")))
    return _Origin(headers, next(features, ""))


def array_at(ffi: FFI, pointer: FFI.CData, *shape: int) -> np.ndarray:
    """Array in C's memory, where a pointer to numbers points."""
    kind, count = np.dtype(_NUMBERS[ffi.typeof(pointer).item.cname]), math.prod(shape)
    if not count:
        return np.empty(shape, kind)
    return np.frombuffer(ffi.buffer(pointer, count * kind.itemsize), kind).reshape(shape)


class Structs:
    """Sets members of C structs, and keeps the data to which they point.

    A member takes, by its declaration, a number, an array, the address of a function or of data, a
    dict for a struct, also one to which a pointer points already, or a list of dicts for a pointer
    to new structs. Others are zero.
    """

    def __init__(self, ffi: FFI):
        self._ffi = ffi
        self._arrays = {name: ffi.typeof(f"{name}[]") for name in _NUMBERS}
        self._referenced: list[object] = []

    def set(self, struct: FFI.CData, **values: Any) -> None:
        """Set members of a struct, or of the one to which a pointer points."""
        members = _types(self._type(struct))
        for name, value in values.items():
            kind = members[name]
            if kind.kind == "primitive":
                setattr(struct, name, value)
            elif kind.kind == "array":
                getattr(struct, name)[0 : len(value)] = list(value)
            elif isinstance(value, Mapping):
                self.set(getattr(struct, name), **value)
            elif value is None or (isinstance(value, int) and value == 0):
                setattr(struct, name, self._ffi.NULL)
            else:
                setattr(struct, name, self._pointer(kind, value))

    def _type(self, struct: FFI.CData) -> FFI.CType:
        kind = self._ffi.typeof(struct)
        return kind.item if kind.kind == "pointer" else kind

    def _pointer(self, kind: FFI.CType, value: Any) -> FFI.CData:
        if kind.kind == "function" or isinstance(value, int):
            return self._ffi.cast(kind, value)
        if kind.item.kind == "struct":
            return self._array(kind.item, value)
        expected = _NUMBERS.get(kind.item.cname, np.uintp)  # else addresses of functions
        value = np.asarray(value)
        other = value.dtype != expected
        if other and value.size and not np.can_cast(value.dtype, expected, "same_kind"):
            raise TypeError(f"an array of {value.dtype} for C's {kind.cname}")
        value = np.asarray(value, expected, "C")
        self._referenced.append(value)
        if expected is np.uintp:
            return self._ffi.cast(kind, value.ctypes.data)
        return self._ffi.from_buffer(self._arrays[kind.item.cname], value)

    def _array(self, kind: FFI.CType, rows: Sequence[Mapping[str, object]]) -> FFI.CData:
        array = self._ffi.new(self._ffi.getctype(kind, "[]"), len(rows))
        self._referenced.append(array)
        for number, row in enumerate(rows):
            self.set(array[number], **row)
        return array


@functools.cache
def _types(kind: FFI.CType) -> dict[str, FFI.CType]:
    """Types of the members of a struct."""
    return {name: field.type for name, field in kind.fields}
