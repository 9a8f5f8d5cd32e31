"""A function of the user for many cases, on all cores or on other executors, as a table."""

from __future__ import annotations

import fcntl
import functools
import json
import logging
import zlib
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping
from concurrent.futures import Executor
from contextlib import closing, suppress
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, check_takes, is_whole, positive, require, shown
from fx_beam.motions.progress import progress_bar
from fx_beam.results import export
from fx_beam.results.files import of_numpy, writable

from . import workers

# Columns of a row besides the case and the results of the function.
_OWN = "seconds", "error"


def sweep(
    function: Callable[[dict], Any],
    cases: Iterable[Mapping[str, Any]],
    executor: Executor | int | None = None,
    results: Path | str | None = None,
    chunksize: int | None = None,
    timeout: float | None = None,
    threads: int | None = None,
):
    """Call a function for each case, several at a time, and collect the results in a table.

    The first case runs alone, so that forms are compiled once; then all workers start. If a case
    fails, its row has the message of the error. In a script, write the call below
    ``if __name__ == "__main__":``, as worker processes import the script.

    Parameters
    ----------
    function : callable
        ``function(case)`` gives the results of a case: a dict, whose entries become columns, or a
        value, which becomes the column "result". Worker processes must be able to import it:
        define it at the top level of a module.
    cases : iterable of dict, or pandas.DataFrame
        Cases: parameters by name, or the rows of a table.
    executor : concurrent.futures.Executor or int, optional
        What runs the cases: any executor, or the number of processes; by default one process with
        one thread for each core. If one of these is killed, its case is repeated after all others,
        alone, and fails if its process dies again; with your own executor this depends on the
        executor. Under ``mpirun -n N python -m mpi4py.futures`` give an
        ``mpi4py.futures.MPIPoolExecutor``.
    results : path, optional
        File to which each row is appended as it finishes, a line of JSON with "case", "result",
        "seconds" and "error". Cases in the file, also failed ones, are not run again: so you can
        continue a sweep that was interrupted.
    chunksize : int, optional
        Number of rows of a table. The sweep then gives an iterator of tables, and computes one
        when it is asked for: of a million cases, only those of one table are in memory. `cases` may
        be a generator. Workers wait for the last case of each table: choose many more cases than
        workers.
    timeout : float, optional
        Longest time for a case [s], that in which its forms are compiled included. A case that
        takes longer fails, and its process is ended. Not with an executor of your own.
    threads : int, optional
        Number of threads of this process that run the cases, in the place of processes. The
        function may be any one, also a local one, and needs no ``if __name__ == "__main__"``; it
        is called by several threads at the same time. Scenes of one structure share a program, and
        take their steps at once; Python runs in one thread at a time.

    Returns
    -------
    pandas.DataFrame or list of dict, or an iterator of them
        A row for each case, in their order: the case, the results, the run time in "seconds", and
        "error", which is empty if there is none. A list if pandas is not installed. With
        `chunksize`, an iterator of such tables.

    Raises
    ------
    SceneError
        If an argument is invalid, or if the worker processes cannot start.
    KeyboardInterrupt
        If interrupted, after all worker processes, or the cases that run in threads, have ended.
        Its attribute `rows` has the rows that were finished before, with `chunksize` those of the
        table that was begun.
    concurrent.futures.BrokenExecutor
        If an executor of your own breaks. It has the attribute `rows` as well.

    Examples
    --------
    The lowest frequency of arms of several lengths.

    >>> import fx_beam as fb
    >>> def lowest(case):
    ...     scene = fb.Scene()
    ...     section = fb.Section(EA=1e6, GA=1e6, EI=100.0, rhoA=1.0)
    ...     scene.clamp(scene.add_beam([(0, 0), (case["length"], 0)], section).start)
    ...     return {"frequency": fb.modes(scene, n=1).frequencies[0]}
    >>> cases = [{"length": 1.0}, {"length": 2.0}, {"length": 0.0}]
    >>> table = fb.sweep(lowest, cases, threads=2)
    >>> bool(table["frequency"][0] > 3.9 * table["frequency"][1])
    True
    >>> print(table["error"][2])
    beam 'beam 1': the points 0 and 1 coincide at (0, 0). Remove one of them
    """
    check_takes(function, "case", "sweep: function")
    if timeout is not None:
        timeout = positive(timeout, "sweep: timeout", "a positive number of seconds")
    options = executor, results, timeout, threads
    entries = map(_checked, _entries(cases))
    if chunksize is None:
        if not (chunk := list(entries)):
            raise SceneError("a sweep needs cases; none are given")
        (table,) = _tables(function, [chunk], *options)
        return table
    require(is_whole(chunksize, 1), "sweep: chunksize", chunksize, "a whole number from 1 on")
    chunks = iter(lambda: list(islice(entries, int(chunksize))), [])
    return _tables(function, chunks, *options)


def _tables(
    function, chunks: Iterable[list[dict]], executor, results, timeout, threads
) -> Iterator:
    """The table of each chunk of cases."""
    if executor is None and threads is None:
        executor = workers.cores()
    with (
        closing(Journal(results)) as journal,
        closing(workers.open_workers(function, executor, timeout, threads)) as crew,
    ):
        for cases in chunks:
            yield _table_of(cases, crew, journal)


def _table_of(cases: list[dict], crew: workers.Workers, journal: Journal):
    """The table of some cases; cases that are not in the file are run."""
    rows: dict[int, dict] = {}
    try:
        for index, case in enumerate(cases):
            if (row := journal.finished(case)) is not None:
                rows[index] = row
        left = [index for index in range(len(cases)) if index not in rows]
        with (
            progress_bar(len(cases), None, desc="cases", initial=len(rows)) as bar,
            closing(crew.run([cases[index] for index in left])) as outcomes,
        ):
            for k, outcome in outcomes:
                rows[left[k]] = journal.append(_row(cases[left[k]], outcome))
                bar.update()
        return _table(rows)
    except BaseException as stop:
        stop.rows = _table(rows)  # type: ignore[attr-defined]
        raise


def _entries(cases: Any) -> Iterator:
    """The cases one by one; SceneError for what is no sequence of them."""
    try:
        # A table of pandas; other things with such a method are none.
        rows = cases.to_dict("records") if hasattr(cases, "to_dict") else cases
        entries = iter(rows)
        len(rows) if hasattr(rows, "__len__") else None
    except Exception:  # numbers, arrays without axes and UFL expressions have none
        entries = None
    if entries is None or isinstance(cases, Mapping | str):
        raise SceneError(f"cases must be a sequence of dicts or a table, not {shown(cases)}")
    return entries


def _checked(case: Any) -> dict:
    """A case as a dict."""
    if not isinstance(case, Mapping):
        raise SceneError(f"the case {shown(case)} must be a dict of parameters by name")
    if reserved := [name for name in _OWN if name in case]:
        raise SceneError(f"{reserved[0]!r} is a column of the results; rename it in the cases")
    return dict(case)


def _row(case: dict, outcome: workers.Outcome) -> dict:
    """A row as the file has it."""
    value, seconds, error = outcome
    result = dict(value) if isinstance(value, Mapping) else {"result": value}
    twice = [name for name in result if name in (*case, *_OWN)]
    if twice and not error:
        clash = "a column of its own" if twice[0] in _OWN else "a parameter of the case"
        error = f"the function gives {twice[0]!r}, which is {clash}; give it another name"
    return {"case": case, "result": None if error else result, "seconds": seconds, "error": error}


def _table(rows: dict[int, dict]):
    table = [
        {**row["case"], **(row["result"] or {}), **{name: row[name] for name in _OWN}}
        for _, row in sorted(rows.items())
    ]
    return export.of_rows(table)


# -- The file of results -------------------------------------------------------------------------

_log = logging.getLogger("fx_beam")
# Start of each line, and name of the checksum (CRC-32) of the line before it, at its end.
_START, _SUM = b'{"case": ', b', "checksum": '


class Journal:
    """Rows of finished cases, a line of JSON each; without a path they are kept nowhere.

    Of the rows in a file only offsets are in memory, by the hash of their case: 17 bytes for each.
    """

    def __init__(self, path: Path | str | None):
        self._file: Any = None
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
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise SceneError(f"another sweep writes to {path}") from None
        except OSError:
            pass

    def _read(self, path: Path | str) -> None:
        """Offsets of rows by case. A last line that was cut off is taken away."""
        self._file.seek(0)
        hashes, offsets, end, damaged = array("q"), array("q"), 0, list[int]()
        for number, line in enumerate(self._file, 1):
            if not line.endswith(b"\n") and (line.startswith(_START) or _START.startswith(line)):
                break
            try:
                row = _VALUE(line.decode())
                case_hash = hash(key(row["case"]))
                _ = row["result"], row["seconds"], row["error"]
                text, _, checksum = line.rpartition(_SUM)
                whole = checksum == b"%d}\n" % zlib.crc32(text)
            except (ValueError, LookupError, TypeError, SceneError) as error:
                if not line.startswith(_START) and _SUM not in line:
                    message = f"line {number} of {path} is not a row of a sweep"
                    raise SceneError(message) from error
                whole = False
            if whole:
                hashes.append(case_hash)
                offsets.append(end)
            else:
                damaged.append(number)
            end += len(line)
        if damaged:
            _log.warning(
                "sweep: %d damaged rows of %s are computed again, as line %d",
                *(len(damaged), path, damaged[0]),
            )
        self._file.truncate(end)
        stored = np.frombuffer(hashes, dtype=np.int64)
        order = np.argsort(stored, kind="stable")
        self._hashes, self._offsets = stored[order], np.frombuffer(offsets, dtype=np.int64)[order]
        self._given = np.zeros(len(stored), dtype=bool)

    def finished(self, case: Mapping[str, Any]) -> dict | None:
        """The row of a case, which is given once; None if the case has not been run."""
        if self._file is None:
            return None
        text = key(case)
        search = functools.partial(self._hashes.searchsorted, hash(text))
        first, stop = (int(search(side)) for side in ("left", "right"))
        k = first + int(np.count_nonzero(self._given[first:stop]))  # those of one hash in order
        if k == stop:
            return None
        self._given[k] = True
        self._file.seek(self._offsets[k])
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
