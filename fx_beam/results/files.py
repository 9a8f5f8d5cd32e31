"""Files that users ask to be written."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import numpy as np

from fx_beam.errors import shown

# What formulas begin with.
_FORMULAS = tuple("=+-@\t\r")


def of_numpy(value: object) -> object:
    """A number or an array of NumPy as JSON has it; ValueError for what JSON does not know."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise ValueError(f"{value!r:.80} is a {type(value).__name__}, which JSON cannot hold")


def in_table(value: object) -> object:
    """A value in a table that a spreadsheet may open, where no text is run as a formula."""
    if not isinstance(value, str) or not value.startswith(_FORMULAS):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"  # for spreadsheets the mark of a text
    return value


def named(path: Path | str) -> Path:
    """The path of a file; ValueError for what is no name."""
    if not isinstance(path, str | Path) or not str(path) or "\0" in str(path):
        raise ValueError(f"path = {shown(path)} must be the name of a file, or a Path")
    return Path(path)


def writable(path: Path | str, endings: Sequence[str] = ()) -> Path:
    """The path of a file to be written; ValueError for a missing folder or an unknown ending."""
    file = named(path)
    if not file.parent.is_dir():
        raise ValueError(f"cannot write {file}: make the folder {file.parent} first")
    if endings and file.suffix.lower().lstrip(".") not in endings:
        raise ValueError(f"cannot write {file}: its name must end with .{', .'.join(endings)}")
    return file


@contextmanager
def replacing(path: Path | str, durable: bool = True) -> Iterator[Path]:
    """A new file to be written, which takes the place of `path` at the end of the block.

    An earlier file is whole until then, and after a failure. Links are followed, permissions kept.
    With `durable` the file is on the disk, also after a power cut.
    """
    target = Path(os.path.realpath(writable(path)))
    if target.is_dir():
        raise ValueError(f"cannot write {path}: it is a folder")
    if target.exists() and not target.is_file():  # such as /dev/stdout
        yield target
        return
    if target.exists() and not os.access(target, os.W_OK):
        raise PermissionError(f"cannot write {path}: the file is write-protected")
    new = target.with_name(f".{target.stem[:50]}-{secrets.token_hex(8)}{target.suffix}")
    try:
        new.touch(exist_ok=False)
        if target.exists():
            old = target.stat()
            with suppress(OSError):  # where the owner may not be changed
                os.chown(new, old.st_uid, old.st_gid)
            new.chmod(old.st_mode & 0o777)
        yield new
        if durable:
            with open(new, "rb") as file:
                os.fsync(file.fileno())
        new.replace(target)
    finally:
        new.unlink(missing_ok=True)


@contextmanager
def replacing_all(paths: Sequence[Path]) -> Iterator[list[str]]:
    """Many files at once as by `replacing`, not `durable`; most are not there yet."""
    token = secrets.token_hex(8)
    with ExitStack() as earlier:
        files, moves = list[str](), list[tuple[str, Path]]()
        for number, path in enumerate(paths):
            if os.path.lexists(path):
                file = str(earlier.enter_context(replacing(path, durable=False)))
            else:
                file = os.path.join(path.parent, f".{token}-{number}{path.suffix}")
                moves.append((file, path))
            files.append(file)
        try:
            yield files
            for file, path in moves:
                os.replace(file, path)
        except BaseException:
            for file, _ in moves:
                with suppress(FileNotFoundError):
                    os.unlink(file)
            raise
