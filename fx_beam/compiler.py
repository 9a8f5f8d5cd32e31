"""The C compiler: its command, which one it is, and where it runs."""

from __future__ import annotations

import functools
import os
import shlex
import shutil
import struct
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

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
