"""The file to which a sweep appends its rows as they finish, and from which it goes on."""

from __future__ import annotations

import fcntl
import json
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.results.files import writable

# How each line begins.
_START = b'{"case": '


class Journal:
    """Rows of finished cases, a line of JSON each; without a path they are kept nowhere."""

    def __init__(self, path: Path | str | None):
        self._file = None
        self._rows: dict[str, list[dict]] = {}
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
        """Rows by case. A last line that was cut off is taken away."""
        assert self._file is not None
        self._file.seek(0)
        *lines, rest = self._file.read().split(b"\n")
        if not (rest.startswith(_START) or _START.startswith(rest)):
            lines.append(rest)  # which no sweep has written
        for number, line in enumerate(lines, 1):
            try:
                row = json.loads(line)
                self._rows.setdefault(key(row["case"]), []).append(row)
                _ = row["result"], row["seconds"], row["error"]
            except (ValueError, LookupError, TypeError) as error:
                raise SceneError(f"line {number} of {path} is not a row of a sweep") from error
        self._file.truncate(self._file.tell() - len(rest))

    def finished(self, case: Mapping[str, Any]) -> dict | None:
        """The row of a case, which is given once; None if the case has not been run."""
        rows = self._rows.get(key(case)) if self._file else None
        return rows.pop(0) if rows else None

    def append(self, row: dict) -> dict:
        """Write a row at once. Gives it as it is read back."""
        if self._file is None:
            return row
        try:
            line = _text(row)
        except (TypeError, ValueError) as error:
            refused = f"what the function gives cannot be written to a file: {error}"
            row = row | {"result": None, "error": refused}
            line = _text(row)
        self._file.write(line.encode() + b"\n")
        self._file.flush()
        return json.loads(line)

    def close(self) -> None:
        """Close the file, so that another sweep may write to it."""
        if self._file is not None:
            with suppress(OSError):  # a disk that is full has said so before
                self._file.close()


def key(case: Mapping[str, Any]) -> str:
    """Text that identifies a case."""
    try:
        return _text(case, sort_keys=True)
    except (TypeError, ValueError) as error:
        raise SceneError(
            f"the case {case!r:.80} cannot be written to a file: {error}. With `results`, cases "
            "are made of numbers, texts and lists"
        ) from error


def _text(value: Any, **options) -> str:
    return json.dumps(value, default=_of_numpy, **options)


def _of_numpy(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{value!r:.40} is a {type(value).__name__}, which JSON cannot hold")
