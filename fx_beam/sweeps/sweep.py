"""A function of the user for many cases, on workers or executors, as a table."""

from __future__ import annotations

import atexit
import copy
import fcntl
import functools
import json
import logging
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import zlib
from array import array
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import closing, suppress
from itertools import islice
from multiprocessing.connection import Connection
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from fx_beam import mpi
from fx_beam.errors import SceneError, StepError, check_takes, is_whole, positive, require, shown
from fx_beam.motions.progress import progress_bar
from fx_beam.motions.sweep_context import in_sweep
from fx_beam.results import export
from fx_beam.results.export import of_numpy, writable
from fx_beam.scene.functions import ArrayCalls
from fx_beam.step.interrupts import Threads

# -- A function called for many items on workers: processes, threads, or any executor -----------


# Largest number of processes or threads.
_MOST = 10_000
# One thread a worker, whatever BLAS there is; read when numpy is imported.
_ONE_THREAD = dict.fromkeys(
    ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "FX_BEAM_THREADS"), "1"
)
# Longest time that can be waited for, and time for processes to end by themselves [s].
_LONGEST_WAIT, _GRACE = 1e6, 2.0
_DIED = "its worker process died: it was killed, ran out of memory or crashed"
_NO_START = (
    "the worker processes cannot start. They import the script: its calls must stand under "
    "`if __name__ == '__main__':`, and the function at the top of a module. Their own errors are "
    "printed above"
)

# What is known of the functions of scenes in this process.
_ARRAY_CALLS = ArrayCalls()


class Outcome(NamedTuple):
    """Result of a call: a value, or a sentence on why there is none; and its time [s]."""

    value: Any
    seconds: float
    error: str


Outcomes = Generator[tuple[int, Outcome], None, None]


def call(function: Callable, item: Any) -> Outcome:
    """Call the function, in the worker."""
    clock = perf_counter()
    with in_sweep(_ARRAY_CALLS):  # the function may change the item that it is given
        outcome = _tried(lambda: Outcome(function(copy.deepcopy(item)), 0.0, ""), errors=Exception)
    return outcome._replace(seconds=perf_counter() - clock)


def _tried(function: Callable, *arguments: Any, errors: Any = (Exception, SystemExit)) -> Any:
    """The result of a call, or the `Outcome` of a failed item if it raises one of the `errors`."""
    try:
        return function(*arguments)
    except errors as error:
        return Outcome(None, np.nan, _sentence(error))


def open_workers(
    function: Callable, executor: Any, timeout: float | None = None, threads: int | None = None
) -> Workers:
    """Workers of an executor; None: here, one after another; a number: so many processes.

    Or so many `threads` of this process. The first item of all runs alone, so that it compiles for
    all. Nothing is started before it. An item that takes longer than `timeout` [s] is ended, with
    its process.
    """
    if threads is not None:
        expected = f"a whole number from 1 to {_MOST}"
        require(is_whole(threads, 1, _MOST), "threads", threads, expected)
        if executor is not None or timeout is not None:
            raise SceneError("threads are those of this process: give no executor, and no timeout")
        return _OnThreads(int(threads), function)
    if executor is None:
        return _SerialWorker(function)
    if is_whole(executor, 1, _MOST):
        return _OnProcesses(int(executor), function, timeout)
    ok = not isinstance(executor, int) and hasattr(executor, "submit")
    expected = "an executor of concurrent.futures, or the number of processes"
    require(ok, "executor", executor, expected)
    if timeout is not None:
        raise SceneError(
            f"timeout = {timeout:g} needs processes of this machine: give executor their number"
        )
    return _OnExecutor(executor.submit, function, isinstance(executor, ProcessPoolExecutor))


def run(function: Callable, items: Sequence, executor: Executor | int | None) -> Outcomes:
    """Places of the items and outcomes, as they finish. To be closed, which ends what runs."""
    with closing(open_workers(function, executor)) as workers:
        yield from workers.run(items)


class _SerialWorker:
    """The thread that asks, one item after another."""

    def __init__(self, function: Callable):
        self._function = function

    def run(self, items: Sequence) -> Outcomes:
        yield from ((index, call(self._function, item)) for index, item in enumerate(items))

    def close(self) -> None:
        pass


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def _sentence(error: BaseException) -> str:
    if isinstance(error, SceneError | StepError):
        return str(error)
    return f"{type(error).__name__}: {error}".rstrip(": ")


def _check_can_start(function: Callable, items: Sequence) -> None:
    """Refuse what processes cannot be sent, and to start some within others."""
    _check_pickles(function, items)
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        sys.exit(1)  # a worker that imports a script without a main guard; the parent says so
    if mpi.under_mpirun():
        raise SceneError(
            "under mpirun give executor=mpi4py.futures.MPIPoolExecutor(), and start the script "
            "by `mpirun -n 3 python -m mpi4py.futures script.py`"
        )


def _check_pickles(function: Callable, items: Sequence) -> None:
    try:
        pickle.dumps((function, *items[:1]))
    except Exception as error:
        raise SceneError(
            f"worker processes cannot be sent what they need: {error}. Define functions with `def` "
            "at the top of a module; functools.partial gives them further arguments"
        ) from error
    main = sys.modules["__main__"]
    inner = getattr(function, "func", function)
    prompt = not hasattr(main, "__file__") and main.__spec__ is None
    if getattr(inner, "__module__", "") == "__main__" and prompt:
        raise SceneError(
            f"{inner!r} is defined at a prompt, where worker processes cannot find it: put it into "
            "a file and import it"
        )


# -- An executor of the user ---------------------------------------------------------------------


class _OnExecutor:
    """Any executor, which its owner closes."""

    def __init__(self, submit: Callable[..., Future], function: Callable, pickles: bool = False):
        self._submit, self._function, self._pickles = submit, function, pickles
        self._begun = False

    def run(self, items: Sequence) -> Outcomes:
        first = 0 if self._begun else min(1, len(items))
        if first and self._pickles:
            _check_pickles(self._function, items)
        yield from self._batch(items, range(first))
        self._begun |= bool(first)
        yield from self._batch(items, range(first, len(items)))

    def _batch(self, items: Sequence, places: Iterable[int]) -> Outcomes:
        """Items that may be called at the same time."""
        futures: dict[Future, int] = {}
        try:
            for index in places:
                futures[self._submit(call, self._function, items[index])] = index
            for future in as_completed([*futures]):
                yield _outcome(futures, future)
        except GeneratorExit:
            raise
        except BaseException:
            # Futures that end together come in any order: the finished are not lost.
            for future in [future for future in futures if _is_finished(future)]:
                yield _outcome(futures, future)
            raise
        finally:
            for future in futures:
                future.cancel()

    def close(self) -> None:
        pass


def _outcome(futures: dict[Future, int], future: Future) -> tuple[int, Outcome]:
    """Index and outcome of a future, which is taken out of `futures`; errors that end the sweep."""
    index = futures.pop(future)
    if isinstance(error := future.exception(), BrokenExecutor):
        raise error
    return index, _tried(future.result)


def _is_finished(future: Future) -> bool:
    """Whether a future has a result, or an error of its own case."""
    if not future.done() or future.cancelled():
        return False
    error = future.exception()
    return not isinstance(error, KeyboardInterrupt | BrokenExecutor)


class _OnThreads(_OnExecutor):
    """Threads of this process."""

    def __init__(self, number: int, function: Callable):
        self._executor = Threads(number)
        super().__init__(self._executor.submit, function)

    def close(self) -> None:
        """Wait for the items that are being called."""
        self._executor.shutdown(cancel_futures=True)


# -- Processes of this machine -------------------------------------------------------------------


class _OnProcesses(_OnExecutor):
    """Processes of this machine; a thread for each process gives it one item after another.

    An item whose process dies runs again after all others, alone, as memory may have been short.
    If its process dies again, it is the cause.
    """

    def __init__(self, number: int, function: Callable, timeout: float | None):
        self._threads = Threads(number)
        super().__init__(lambda *called: self._threads.submit(self._ask, *called), function)
        self._number, self._timeout = number, timeout
        # Each worker has a core of its own: some kernels leave two on one for seconds.
        cpus = os.sched_getaffinity(0)
        self._cpus: list[int | None] = [*cpus] if number == len(cpus) else [None] * number
        self._idle, self._busy = list[_Worker](), set[_Worker]()
        self._is_closed = False

    def run(self, items: Sequence) -> Outcomes:
        if items and not self._begun:
            _check_can_start(self._function, items)
            atexit.register(self.close)
        while len(self._idle) < min(self._number, len(items)):
            self._idle.append(_Worker(self._cpus.pop()))
        died = []
        try:
            for index, outcome in super().run(items):
                if outcome.error == _DIED:
                    died.append(index)
                else:
                    yield index, outcome
            for index in died:
                yield from self._batch(items, [index])
        except BrokenExecutor as error:
            raise SceneError(str(error)) from None

    def _ask(self, _call: Callable, *called: Any) -> Outcome:
        """Outcome from a worker for a function and an item; called in a thread."""
        if not isinstance(pickled := _tried(pickle.dumps, called), bytes):
            return pickled
        try:
            worker = self._idle.pop()
        except IndexError:  # some died
            worker = _Worker(self._cpus.pop())
        self._busy.add(worker)
        if self._is_closed:
            worker.process.kill()
        outcome = worker.outcome(pickled, self._timeout)
        self._busy.remove(worker)
        if worker.pipe.closed:
            self._cpus.append(worker.cpu)
        else:
            self._idle.append(worker)
        return outcome

    def close(self) -> None:
        """Let idle processes end, and kill busy ones."""
        atexit.unregister(self.close)
        self._is_closed = True
        self._threads.shutdown(wait=False, cancel_futures=True)
        for worker in [*self._busy]:
            worker.process.kill()
        self._threads.shutdown()
        for worker in self._idle:
            worker.pipe.close()
        while self._idle:
            self._idle.pop().end(_GRACE)


class _Worker:
    """A process, which `spawn` starts: a fork would share what MPI and PETSc hold."""

    _STARTING = threading.Lock()

    def __init__(self, cpu: int | None):
        spawn = multiprocessing.get_context("spawn")
        self.pipe, its_end = spawn.Pipe()
        self.cpu, self._is_ready = cpu, False
        level = logging.getLogger("fx_beam").getEffectiveLevel()
        self.process = spawn.Process(target=_work, args=(its_end, cpu, level))
        with self._STARTING:
            # Ctrl-C is not for workers; it waits for the end of this block.
            mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
            environment = {name: os.environ[name] for name in _ONE_THREAD if name in os.environ}
            os.environ.update(_ONE_THREAD)
            try:
                self.process.start()
            finally:
                for name in _ONE_THREAD:
                    del os.environ[name]
                os.environ.update(environment)
                signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        its_end.close()

    def outcome(self, pickled: bytes, timeout: float | None) -> Outcome:
        """Outcome of a pickled call in the process; it is ended if it does not in time, or died."""
        clock = perf_counter()
        try:
            self._is_ready = self._is_ready or self.pipe.recv()
            self.pipe.send_bytes(pickled)
            if self.pipe.poll(timeout if timeout is None else min(timeout, _LONGEST_WAIT)):
                return _tried(pickle.loads, self.pipe.recv_bytes())
            error = f"it took longer than timeout = {timeout:g} s, and was ended"
        except (EOFError, OSError):
            if not self._is_ready:
                raise BrokenExecutor(_NO_START) from None
            clock, error = np.nan, _DIED
        self.end()
        return Outcome(None, perf_counter() - clock, error)

    def end(self, grace: float = 0.0) -> None:
        """End the process, whatever it does."""
        self.pipe.close()
        self.process.join(grace)
        self.process.kill()
        self.process.join()


def _work(pipe: Connection, cpu: int | None, log_level: int) -> None:
    """Call functions for items, in a worker; it ends with its parent."""
    logging.getLogger("fx_beam").setLevel(log_level)
    if cpu is not None:
        os.sched_setaffinity(0, {cpu})
    threading.Thread(target=_end_with_parent, daemon=True).start()
    with suppress(EOFError, OSError):
        pipe.send(True)
        while True:
            called = pipe.recv_bytes()
            outcome = _tried(lambda called: call(*pickle.loads(called)), called)
            sent = _tried(pickle.dumps, outcome)
            pipe.send_bytes(sent if isinstance(sent, bytes) else pickle.dumps(sent))


def _end_with_parent() -> None:
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


#: What calls the function for items, as often as it is asked, until it is closed.
Workers = _SerialWorker | _OnExecutor


# -- A function of the user for many cases, on all cores or on other executors, as a table ------


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
        Any executor that runs the cases, or the number of processes; by default one process with
        one thread for each core. If one of these processes is killed, its case is repeated alone
        after all others, and fails if its process dies again; with your own executor this depends
        on the executor. Under ``mpirun -n N python -m mpi4py.futures`` give an
        ``mpi4py.futures.MPIPoolExecutor``.
    results : path, optional
        File to which each row is appended as it finishes, a line of JSON with "case", "result",
        "seconds" and "error". Cases in the file, also those that failed, are not run again: an
        interrupted sweep continues.
    chunksize : int, optional
        Number of rows of a table. The sweep is then an iterator of tables, and computes each table
        when it is asked for: of a million cases, only those of one table are in memory. `cases` may
        be a generator. Workers wait for the last case of each table: choose many more cases than
        workers.
    timeout : float, optional
        Longest time for a case [s], including the time in which its forms are compiled. A case that
        takes longer fails, and its process is ended. Refused with an executor of your own.
    threads : int, optional
        Number of threads of this process that run the cases, in the place of processes. The
        function may then be local, and needs no ``if __name__ == "__main__"``; several threads call
        it at the same time. Scenes of one structure share a program, and their steps run in
        parallel; Python runs in one thread at a time.

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
        Its attribute `rows` has the rows that were finished, with `chunksize` those of the current
        table.
    concurrent.futures.BrokenExecutor
        If an executor of your own breaks. The exception has the attribute `rows` as well.

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
        executor = cores()
    with (
        closing(Journal(results)) as journal,
        closing(open_workers(function, executor, timeout, threads)) as crew,
    ):
        for cases in chunks:
            yield _table_of(cases, crew, journal)


def _table_of(cases: list[dict], crew: Workers, journal: Journal):
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


def _row(case: dict, outcome: Outcome) -> dict:
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
