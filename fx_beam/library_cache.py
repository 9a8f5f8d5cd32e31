"""The cache of compiled libraries: many processes may share it, and it repairs itself.

Who builds a library holds a lock, which ends with the process, and builds in a folder of its own.
The library then enters the cache by one renaming, with a checksum at its end. It is loaded only if
it is complete and no other user could have written it, or have put another folder in the place of
one that holds it.
"""

from __future__ import annotations

import fcntl
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

from fx_beam.errors import warn_once

T = TypeVar("T")

_log = logging.getLogger("fx_beam")
_DIGEST = 16
# Free space without which nothing is compiled [bytes].
_ROOM = 1 << 22
# Prefix of folders in which libraries are built; age [s] from which one is left over and removed.
_SCRATCH, _FORGOTTEN = "building-", 86400.0
#: Largest size of all libraries [bytes]; the ones unused for the longest time go first.
LARGEST = 1 << 28
# Write permission of others than the owner.
_OTHERS_WRITE = 0o022
# Of each folder of libraries, by its device and inode; they stay open, as for the loader of
# libraries a path that it has loaded always means the same one.
_descriptors: dict[tuple[int, int], int] = {}


def folder() -> Path:
    """The cache folder, without links; places that are relative to the current one are none."""
    places = os.environ.get("XDG_CACHE_HOME", ""), os.path.expanduser("~/.cache")
    place = next(filter(os.path.isabs, places), None)
    return _substitute() if place is None else Path(os.path.realpath(place), "fx_beam")


def _substitute() -> Path:
    """The folder of libraries if the folder of the cache cannot be written."""
    return Path(os.path.realpath(tempfile.gettempdir()), f"fx_beam-{os.geteuid()}")


def load_cached(name: str, loader: Callable[[Path], T], place: Path | None = None) -> T | None:
    """Result of the loader for a library of the cache; None if there is none that it can load."""
    try:
        path = _checked(place or folder()) / name
        with open(path, "rb", opener=_without_waiting) as file:
            status = os.fstat(file.fileno())
            whole = stat.S_ISREG(status.st_mode) and _is_ours(status) and file.read()
        if whole and whole[-_DIGEST:] == _checksum(whole[:-_DIGEST]):
            library = loader(path)
            with suppress(OSError):
                os.utime(path)  # it has been used
            return library
    except Exception as error:  # whatever is wrong with it, it can be built again
        _log.debug("not loaded: %s", error)
    return None


def _without_waiting(path: str, flags: int) -> int:
    """Open what may be no file; links are refused."""
    return os.open(path, flags | os.O_NOFOLLOW | os.O_NONBLOCK, 0o644)


def _checked(place: Path) -> Path:
    """The path of a folder by its descriptor; OSError if another user can write or exchange it."""
    trusted = 0, os.geteuid(), os.stat("/").st_uid  # in a container the last may have another name
    for holder in place.parents:
        status = holder.lstat()
        # In a sticky folder nobody else can move or replace what is ours.
        shared = status.st_mode & _OTHERS_WRITE and not status.st_mode & stat.S_ISVTX
        if shared or status.st_uid not in trusted:
            raise PermissionError(f"another user can write {holder}")
    descriptor = os.open(place, os.O_DIRECTORY | os.O_NOFOLLOW)
    status = os.fstat(descriptor)
    first = _descriptors.setdefault((status.st_dev, status.st_ino), descriptor)
    if first != descriptor:
        os.close(descriptor)
    if not _is_ours(status):
        raise PermissionError("another user can write it")
    path = Path(f"/proc/self/fd/{first}")
    with suppress(OSError):
        if os.path.samestat(path.stat(), status):
            return path
    return place  # without /proc, or after the descriptors were closed


def loaded(name: str, loader: Callable[[Path], T], builder: Callable[[Path], T]) -> T:
    """Result of the loader for a library of the cache.

    If there is none, what the builder returns, which makes it in a folder.
    """
    library = load_cached(name, loader)
    if library is not None:
        return library
    place = _writable_folder()
    with _one_at_a_time(place / f"{name}.lock"):
        # It is in the substitute, or another process has built it meanwhile.
        library = load_cached(name, loader, place)
        return _built(place, name, builder) if library is None else library


def _is_ours(status: os.stat_result) -> bool:
    """Whether no other user but the administrator can write a file or in a folder."""
    return status.st_uid in (0, os.geteuid()) and not status.st_mode & _OTHERS_WRITE


def content(path: Path) -> bytes:
    """Bytes that the builder of a file wrote."""
    return path.read_bytes()[:-_DIGEST]


def _checksum(content: bytes) -> bytes:
    return hashlib.blake2b(content, digest_size=_DIGEST).digest()


def _writable_folder() -> Path:
    """The first folder in which libraries can be built; OSError if there is none."""
    unusable, advice = "", "Set XDG_CACHE_HOME to a folder that you alone can write"
    for find in (folder, _substitute):
        place: Path | str = "for temporary files"
        try:
            place = find()
            _prepare(place)
        except OSError as error:
            unusable += f" {place} cannot be used ({error.strerror or error})."
            continue
        if unusable and multiprocessing.parent_process() is None:  # not in workers of a sweep
            warn_once(f"the cache folder{unusable} What is compiled goes to {place}. {advice}")
        return place
    raise OSError(f"nothing can be compiled:{unusable} {advice}")


def _prepare(place: Path) -> None:
    """Make a folder that nobody else can write; OSError if it cannot be used."""
    for holder in reversed(place.parents):
        holder.mkdir(mode=0o700, exist_ok=True)
    place.mkdir(mode=0o755, exist_ok=True)
    descriptor = os.open(place, os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        status = os.fstat(descriptor)
        if status.st_uid == os.geteuid() and status.st_mode & _OTHERS_WRITE:
            os.fchmod(descriptor, status.st_mode & 0o7777 & ~_OTHERS_WRITE)
    finally:
        os.close(descriptor)
    _checked(place)
    with tempfile.TemporaryFile(dir=place) as file:
        os.posix_fallocate(file.fileno(), 0, _ROOM)


@contextmanager
def _one_at_a_time(path: Path) -> Iterator[None]:
    """Let other processes wait, except where the file system has no locks.

    The file is removed before the lock ends: who waited for it looks for the library first.
    """
    try:
        file = open(path, "w", opener=_without_waiting)
    except OSError:  # something else is there
        _remove(path)
        file = open(path, "w", opener=_without_waiting)
    with file:
        with suppress(OSError):
            fcntl.flock(file, fcntl.LOCK_EX)
        try:
            yield
        finally:
            path.unlink(missing_ok=True)


def _built(place: Path, name: str, builder: Callable[[Path], T]) -> T:
    for old in place.glob(f"{_SCRATCH}*"):
        with suppress(OSError):
            if time.time() - old.lstat().st_mtime > _FORGOTTEN:
                _remove(old)
    for lock in place.glob("*.lock"):  # of processes that were killed
        with suppress(OSError), open(lock, opener=_without_waiting) as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            lock.unlink()
    # On NFS a library that is in use cannot be removed.
    folder = tempfile.TemporaryDirectory(prefix=_SCRATCH, dir=place, ignore_cleanup_errors=True)
    with folder as scratch:
        library = builder(Path(scratch))
        content = Path(scratch, name).read_bytes()
        complete = Path(scratch, "complete")
        try:
            complete.write_bytes(content + _checksum(content))
            complete.chmod(0o755)
            if (place / name).is_dir():
                _remove(place / name)
            complete.replace(place / name)
            _remove_unused(place)
        except OSError as error:  # this process has what it needs
            _log.debug("not kept: %s", error)
    return library


def _remove(path: Path) -> None:
    """Take away a file, a link, or a folder with all that is in it."""
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _remove_unused(place: Path) -> None:
    """Take away what was not used for longest, if there is too much."""
    files = [(file, file.stat()) for file in place.iterdir() if file.suffix in (".so", ".types")]
    left = sum(status.st_size for _, status in files)
    for file, status in sorted(files, key=lambda pair: pair[1].st_mtime):
        if left <= LARGEST:
            break
        file.unlink(missing_ok=True)
        left -= status.st_size
