"""The cache of compiled libraries: many processes may share it, and it repairs itself.

Who builds a library holds a lock, which ends with the process, and builds in a folder of its own.
The library then enters the cache by one renaming, with a checksum at its end. It is loaded only if
it is complete and no other user could have written it.
"""

from __future__ import annotations

import fcntl
import functools
import hashlib
import logging
import multiprocessing
import os
import shutil
import stat
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TypeVar

T = TypeVar("T")

_log = logging.getLogger("fx_beam")
_DIGEST = 16
# Free space without which nothing is compiled [bytes].
_ROOM = 1 << 22
# Folders in which libraries are built; those of processes that were killed go after so long [s].
_SCRATCH, _FORGOTTEN = "building-", 86400.0
#: Largest size of all libraries; those that were not used for longest go first [bytes].
LARGEST = 1 << 28
# Write permission of others than the owner.
_OTHERS_WRITE = 0o022


def folder() -> Path:
    """The cache folder, without links."""
    place = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    return (place / "fx_beam").resolve()


def _folders() -> Iterator[Path]:
    """The cache folder, and the one for when it cannot be written, if there is any."""
    yield folder()
    with suppress(FileNotFoundError):
        place = Path(tempfile.gettempdir()).resolve()
        status = place.stat()
        # In a sticky folder nobody else can move or replace what is ours: names are safe there.
        if status.st_mode & stat.S_ISVTX and not status.st_uid or _is_ours(place):
            yield place / f"fx_beam-{os.geteuid()}"


def load(name: str, loader: Callable[[Path], T]) -> T | None:
    """What the loader makes of a library of the cache; None if there is none that it can load."""
    for place in _folders():
        path = place / name
        try:
            whole = _is_ours(place) and _is_ours(path) and path.read_bytes()
            if whole and whole[-_DIGEST:] == _checksum(whole[:-_DIGEST]):
                library = loader(path)
                with suppress(OSError):
                    os.utime(path)  # it has been used
                return library
        except Exception as error:  # whatever is wrong with it, it can be built again
            _log.debug("not loaded: %s", error)
    return None


def loaded(name: str, loader: Callable[[Path], T], builder: Callable[[Path], T]) -> T:
    """What the loader makes of a library of the cache.

    If there is none, what the builder returns, which makes it in a folder.
    """
    library = load(name, loader)
    if library is not None:
        return library
    place = _writable_folder()
    with _one_at_a_time(place / f"{name}.lock"):
        library = load(name, loader)  # another process may have built it meanwhile
        return _built(place, name, builder) if library is None else library


def _is_ours(path: Path) -> bool:
    """Whether no other user but the administrator can write a file or in a folder; no link is."""
    status = path.lstat()
    return status.st_uid in (0, os.geteuid()) and not status.st_mode & _OTHERS_WRITE


def content(path: Path) -> bytes:
    """What the builder of a file wrote."""
    return path.read_bytes()[:-_DIGEST]


def _checksum(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_DIGEST).digest()


def _writable_folder() -> Path:
    """The first folder in which libraries can be built; OSError if there is none."""
    unusable, advice = "", "Set XDG_CACHE_HOME to a folder that you alone can write"
    for place in _folders():
        try:
            folder = _prepared(place)
        except OSError as error:
            unusable += f" {place} cannot be used ({error.strerror or error})."
            continue
        if unusable:
            _warn(f"the cache folder{unusable} What is compiled goes to {place}. {advice}")
        return folder
    raise OSError(f"nothing can be compiled:{unusable} {advice}")


def _prepared(place: Path) -> Path:
    place.mkdir(mode=0o755, parents=True, exist_ok=True)
    status = place.lstat()
    if status.st_uid == os.geteuid() and status.st_mode & _OTHERS_WRITE:
        place.chmod(status.st_mode & 0o7777 & ~_OTHERS_WRITE)
    if not _is_ours(place):
        raise PermissionError("another user can write it")
    with tempfile.TemporaryFile(dir=place) as file:
        os.posix_fallocate(file.fileno(), 0, _ROOM)
    return place


@functools.cache
def _warn(sentence: str) -> None:
    """Warn once, and not in each worker process of a sweep."""
    if multiprocessing.parent_process() is None:
        _log.warning("%s", sentence)


@contextmanager
def _one_at_a_time(path: Path) -> Iterator[None]:
    """Let other processes wait, except where the file system has no locks.

    The file is removed before the lock ends: who waited for it looks for the library first.
    """
    with open(path, "w") as file:
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def _built(place: Path, name: str, builder: Callable[[Path], T]) -> T:
    for old in place.glob(f"{_SCRATCH}*"):
        with suppress(OSError):
            if time.time() - old.stat().st_mtime > _FORGOTTEN:
                shutil.rmtree(old)
    # On NFS a library that is in use cannot be removed.
    folder = tempfile.TemporaryDirectory(prefix=_SCRATCH, dir=place, ignore_cleanup_errors=True)
    with folder as scratch:
        library = builder(Path(scratch))
        content = Path(scratch, name).read_bytes()
        complete = Path(scratch, "complete")
        try:
            complete.write_bytes(content + _checksum(content))
            complete.chmod(0o755)
            complete.replace(place / name)
            _remove_unused(place)
        except OSError as error:  # this process has what it needs
            _log.debug("not kept: %s", error)
    return library


def _remove_unused(place: Path) -> None:
    """Take away what was not used for longest, if there is too much."""
    files = [(file, file.stat()) for file in place.iterdir() if file.suffix in (".so", ".types")]
    left = sum(status.st_size for _, status in files)
    for file, status in sorted(files, key=lambda one: one[1].st_mtime):
        if left <= LARGEST:
            break
        file.unlink(missing_ok=True)
        left -= status.st_size
