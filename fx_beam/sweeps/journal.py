"""The file to which a sweep appends its rows as they finish, and from which it goes on."""

from __future__ import annotations

import fcntl
import json
import logging
import zlib
from array import array
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.results.files import of_numpy, writable

_log = logging.getLogger("fx_beam")
# How each line begins, and the checksum (CRC-32) of what is before it, with which it ends.
_START, _SUM = b'{"case": ', b', "checksum": '


class Journal:
    """Rows of finished cases, a line of JSON each; without a path they are kept nowhere.

    Of the rows in a file only places are in memory, by the hash of their case: 17 bytes for each.
    """

    def __init__(self, path: Path | str | None):
        self._file = None
        self._hashes = np.empty(0, dtype=np.int64)
        self._places = np.empty(0, dtype=np.int64)
        self._given = np.empty(0, dtype=bool)
        if path is None:
            return
        try:
            self._file = open(writable(path), "a+b")
        except (OSError, ValueError) as error:
            raise SceneError(f"results = {str(path)!r} cannot be written: {error}") from error
        try:
            self._lock(path)
            self._read(path)
        except SceneError:
            self.close()
            raise

    def _lock(self, path: Path | str) -> None:
        """Keep other sweeps away, except where the file system has no locks."""
        assert self._file is not None
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise SceneError(f"another sweep writes to {path}") from None
        except OSError:
            pass

    def _read(self, path: Path | str) -> None:
        """Places of rows by case. A last line that was cut off is taken away."""
        assert self._file is not None
        self._file.seek(0)
        hashes, places, end, damaged = array("q"), array("q"), 0, list[int]()
        for number, line in enumerate(self._file, 1):
            if not line.endswith(b"\n") and (line.startswith(_START) or _START.startswith(line)):
                break
            try:
                row = _VALUE(line.decode())
                of = hash(key(row["case"]))
                _ = row["result"], row["seconds"], row["error"]
                whole = _is_whole(line)
            except (ValueError, LookupError, TypeError, SceneError) as error:
                if not line.startswith(_START) and _SUM not in line:
                    text = f"line {number} of {path} is not a row of a sweep"
                    raise SceneError(text) from error
                whole = False
            if whole:
                hashes.append(of)
                places.append(end)
            else:
                damaged.append(number)
            end += len(line)
        if damaged:
            _log.warning(
                "sweep: %d damaged rows of %s are computed again, as line %d",
                *(len(damaged), path, damaged[0]),
            )
        self._file.truncate(end)
        known = np.frombuffer(hashes, dtype=np.int64)
        order = np.argsort(known, kind="stable")
        self._hashes, self._places = known[order], np.frombuffer(places, dtype=np.int64)[order]
        self._given = np.zeros(len(known), dtype=bool)

    def finished(self, case: Mapping[str, Any]) -> dict | None:
        """The row of a case, which is given once; None if the case has not been run."""
        if self._file is None:
            return None
        text = key(case)
        wanted = hash(text)
        first, stop = (int(self._hashes.searchsorted(wanted, side)) for side in ("left", "right"))
        k = first + int(np.count_nonzero(self._given[first:stop]))  # those of one hash in order
        if k == stop:
            return None
        self._given[k] = True
        self._file.seek(self._places[k])
        row = _VALUE(self._file.readline().decode())
        row.pop("checksum", None)
        return row if key(row["case"]) == text else None

    def append(self, row: dict) -> dict:
        """Write a row at once. Gives it as it is read back."""
        if self._file is None:
            return row
        try:
            line = _TEXT(row)
        except (TypeError, ValueError) as error:
            refused = f"what the function gives cannot be written to a file: {error}"
            row = row | {"result": None, "error": refused}
            line = _TEXT(row)
        text = line.encode()[:-1]
        self._file.write(b"%s%s%d}\n" % (text, _SUM, zlib.crc32(text)))
        self._file.flush()
        return _VALUE(line)

    def close(self) -> None:
        """Close the file, so that another sweep may write to it."""
        if self._file is not None:
            with suppress(OSError):  # a disk that is full has said so before
                self._file.close()


def _is_whole(line: bytes) -> bool:
    """Whether a row is as it was written."""
    text, _, checksum = line.rpartition(_SUM)
    return checksum == b"%d}\n" % zlib.crc32(text)


def key(case: Mapping[str, Any]) -> str:
    """Text that identifies a case."""
    try:
        return _SORTED(case)
    except (TypeError, ValueError) as error:
        raise SceneError(
            f"the case {case!r:.80} cannot be written to a file: {error}. With `results`, cases "
            "are made of numbers, texts and lists"
        ) from error


# Made once: json.dumps makes one at each call.
_TEXT = json.JSONEncoder(default=of_numpy).encode
_SORTED = json.JSONEncoder(default=of_numpy, sort_keys=True).encode
_VALUE = json.JSONDecoder().decode
