"""A function called for many items on workers: processes of this machine, or any executor."""

from __future__ import annotations

import logging
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed
from concurrent.futures import wait as wait_for
from contextlib import closing, contextmanager
from multiprocessing import connection
from multiprocessing.process import BaseProcess
from multiprocessing.queues import SimpleQueue
from time import monotonic, perf_counter
from typing import Any, NamedTuple, Protocol

import numpy as np

from fx_beam.errors import SceneError, StepError
from fx_beam.fem import mpi
from fx_beam.validation import is_whole, shown

from .kept_setup import KeptSetup, keeping_setup
from .progress import without_bars

_log = logging.getLogger("fx_beam")
_THREAD = threading.local()
# One thread a worker, whatever BLAS there is; read when numpy is imported.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
# Largest number of processes.
_MOST = 10_000
# Time of the items that a process is given at once [s].
_AT_ONCE = 0.02
# Time for processes to end by themselves before they are killed [s].
_GRACE = 2.0
_DIED = "its worker process died: it was killed, ran out of memory or crashed"
_NO_START = (
    "the worker processes cannot start. They import the script: its calls must stand under "
    "`if __name__ == '__main__':`, and the function at the top of a module. Their own errors are "
    "printed above"
)


class Outcome(NamedTuple):
    """What a call gave: a value, or a sentence on why there is none; and its time [s]."""

    value: Any
    seconds: float
    error: str


Outcomes = Generator[tuple[int, Outcome], None, None]


def call(function: Callable, item: Any) -> Outcome:
    """Call the function, in the worker."""
    clock = perf_counter()
    value, error = None, ""
    try:
        with without_bars(), keeping_setup(_kept_here()):
            value = function(item)
    except Exception as raised:
        error = _sentence(raised)
    return Outcome(value, perf_counter() - clock, error)


def _call_each(function: Callable, items: list) -> list[bytes]:
    """Call the function for some items, in the worker: outcomes as they are sent."""
    return [_sent(call(function, item)) for item in items]


def _sent(outcome: Outcome) -> bytes:
    try:
        return pickle.dumps(outcome)
    except Exception as error:
        return pickle.dumps(Outcome(None, np.nan, _sentence(error)))


class Workers(Protocol):
    """What calls the function for items, as often as it is asked, until it is closed."""

    def run(self, items: Sequence) -> Outcomes:
        """Places of the items and outcomes, as they finish. To be closed, which ends what runs."""

    def close(self) -> None:
        """End all that was started."""


def open_workers(function: Callable, executor: Executor | int | None) -> Workers:
    """Workers of an executor; None: here, one after another; a number: so many processes.

    The first item of all runs alone, so that it compiles for all. Nothing is started before it.
    """
    if executor is None:
        return _Here(function)
    if is_whole(executor, 1, _MOST):
        if reason := _no_locks():
            _log.warning(
                "worker processes cannot start (%s): they need a /dev/shm that can be written. The "
                "cases run in this process, one after another",
                reason,
            )
            return _Here(function)
        return _OnProcesses(int(executor), function)  # type: ignore[arg-type]
    if isinstance(executor, int) or not hasattr(executor, "submit"):
        raise SceneError(
            f"executor = {shown(executor)} must be an executor of concurrent.futures, or the "
            "number of processes"
        )
    return _OnExecutor(executor, function)


def run(function: Callable, items: Sequence, executor: Executor | int | None) -> Outcomes:
    """Places of the items and outcomes, as they finish. To be closed, which ends what runs."""
    with closing(open_workers(function, executor)) as workers:
        yield from workers.run(items)


def _kept_here() -> KeptSetup:
    """The set-up of the last motion of this thread."""
    if not hasattr(_THREAD, "kept"):
        _THREAD.kept = KeptSetup()
    return _THREAD.kept


class _Here:
    """The thread that asks, one item after another."""

    def __init__(self, function: Callable):
        self._function = function

    def run(self, items: Sequence) -> Outcomes:
        yield from ((index, call(self._function, item)) for index, item in enumerate(items))

    def close(self) -> None:
        vars(_THREAD).clear()


def _no_locks() -> str:
    """Why processes cannot share locks; empty if they can."""
    try:
        multiprocessing.get_context("spawn").Lock()
    except OSError as error:
        return str(error)
    return ""


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def _sentence(error: BaseException) -> str:
    if isinstance(error, SceneError | StepError):
        return str(error)
    return f"{type(error).__name__}: {error}".rstrip(": ")


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


def _outcome(future: Future) -> Outcome:
    error = future.exception()
    if error is None:
        return future.result()
    if isinstance(error, BrokenExecutor | KeyboardInterrupt):
        raise error
    return Outcome(None, np.nan, _sentence(error))  # such as a value that cannot be pickled


def _outcomes(future: Future) -> list[Outcome]:
    """Outcomes of some items, or of one that could not be sent."""
    if future.exception() is not None:
        return [_outcome(future)]
    return [pickle.loads(sent) for sent in future.result()]


# -- An executor of the user ---------------------------------------------------------------------


class _OnExecutor:
    """Any executor, which its owner closes."""

    def __init__(self, executor: Executor, function: Callable):
        self._executor, self._function = executor, function
        self._begun = False

    def run(self, items: Sequence) -> Outcomes:
        alone = [] if self._begun else [0][: len(items)]
        if alone and isinstance(self._executor, ProcessPoolExecutor):
            _check_pickles(self._function, items)
        self._begun |= bool(alone)
        for batch in alone, range(len(alone), len(items)):
            futures: dict[Future, int] = {}
            try:
                for index in batch:
                    futures[self._executor.submit(call, self._function, items[index])] = index
                for future in as_completed(futures):
                    yield futures[future], _outcome(future)
            finally:
                for future in futures:
                    future.cancel()

    def close(self) -> None:
        pass


# -- Processes of this machine -------------------------------------------------------------------


class _OnProcesses:
    """A pool of processes, which ends with any of them: then another one goes on.

    Items that may have run in the process that died run again, one by one. One whose process dies
    again is the cause.
    """

    def __init__(self, number: int, function: Callable):
        self._number, self._function = number, function
        self._pool: _Pool | None = None
        self._idle = True

    def run(self, items: Sequence) -> Outcomes:
        self._idle = False
        left, alone = dict(enumerate(items)), []
        if left and self._pool is None:
            self._pool = self._started(items)
            alone = [0]
        seconds: list[float] = []
        while left:
            assert self._pool is not None
            batch, size = alone[:1] or list(left), 1
            del alone[:1]
            if len(batch) > 1 and not seconds:
                batch = batch[: 4 * self._number]  # tells how long items take
            elif len(batch) > 1:
                size = self._together(seconds, len(batch))
            parts = [batch[k : k + size] for k in range(0, len(batch), size)]
            futures = self._pool.submit(self._function, left, parts)
            for future in as_completed(futures):
                error, part = future.exception(), futures[future]
                if isinstance(error, BrokenExecutor):
                    continue
                if error is not None and len(part) > 1:  # such as one that cannot be sent
                    alone += part
                    continue
                for index, outcome in zip(part, _outcomes(future), strict=True):
                    del left[index]
                    if len(batch) > 1 and np.isfinite(outcome.seconds):
                        seconds.append(outcome.seconds)
                    yield index, outcome
            if not self._pool.broken(futures, parts):
                continue
            self._pool.stop()
            self._pool = _Pool(self._number)
            if len(batch) == 1:
                del left[batch[0]]
                yield batch[0], Outcome(None, np.nan, _DIED)
            else:
                # Those that ran, and those that a pool holds ready: the first in order.
                alone = list(left)[: (2 * self._number + 1) * size]
        self._idle = True

    def _together(self, seconds: list[float], number: int) -> int:
        """How many of so many items a process is given at once: sending each costs 0.3 ms."""
        usual = max(float(np.median(seconds)), 1e-5)
        return max(1, min(int(_AT_ONCE / usual), number // (8 * self._number)))

    def _started(self, items: Sequence) -> _Pool:
        """A pool whose processes have the function."""
        _check_pickles(self._function, items)
        if getattr(multiprocessing.current_process(), "_inheriting", False):
            sys.exit(1)  # a worker that imports a script without a main guard; the parent says so
        if mpi.under_mpirun():
            raise SceneError(
                "under mpirun give executor=mpi4py.futures.MPIPoolExecutor(), and start the script "
                "by `mpirun -n 3 python -m mpi4py.futures script.py`"
            )
        pool = _Pool(self._number)
        try:
            pool.start(self._function, min(self._number, len(items)))
        except BaseException:
            pool.stop()
            raise
        return pool

    def close(self) -> None:
        if self._pool is not None:
            if self._idle:
                self._pool.close()
            self._pool.stop()


class _Pool:
    """A pool of processes, which `spawn` starts: a fork would share what MPI and PETSc hold."""

    def __init__(self, number: int):
        self._own: set[BaseProcess] = set()
        spawn, level = multiprocessing.get_context("spawn"), _log.getEffectiveLevel()
        cpus = None
        if number == cores():
            # Each worker has a core of its own: some kernels leave two on one for seconds.
            cpus = spawn.SimpleQueue()
            for cpu in os.sched_getaffinity(0):
                cpus.put(cpu)
        self._executor = ProcessPoolExecutor(number, spawn, _begin, (level, cpus))

    def start(self, function: Callable, number: int) -> None:
        """Start so many processes, and wait for the first one to have the function."""
        with self._starting():
            ready = [self._executor.submit(_has, function) for _ in range(number)]
        (first, *_), _ = wait_for(ready, return_when="FIRST_COMPLETED")
        if isinstance(first.exception(), BrokenExecutor):
            raise SceneError(_NO_START)

    @contextmanager
    def _starting(self) -> Iterator[None]:
        """Note the processes that start meanwhile. Ctrl-C is not theirs; it waits for the end."""
        others = set(multiprocessing.active_children())
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            with _environment(_ONE_THREAD):
                yield
        finally:
            self._own |= set(multiprocessing.active_children()) - others
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def submit(
        self, function: Callable, items: dict[int, Any], parts: list[list[int]]
    ) -> dict[Future, list[int]]:
        """Submit calls for parts of the items, each part in one process.

        A pool that breaks takes no more. It starts further processes as needed.
        """
        futures: dict[Future, list[int]] = {}
        with self._starting():
            for part in parts:
                own = [items[index] for index in part]
                try:
                    futures[self._executor.submit(_call_each, function, own)] = part
                except BrokenExecutor:
                    break
        return futures

    def broken(self, futures: dict[Future, list[int]], parts: list[list[int]]) -> bool:
        """Whether a process died before all was done."""
        broken = any(isinstance(future.exception(), BrokenExecutor) for future in futures)
        return broken or len(futures) < len(parts)

    def close(self) -> None:
        """Wait for the processes to end; they have nothing to do."""
        self._executor.shutdown()

    def stop(self) -> None:
        """End all processes, whatever they do."""
        self._executor.shutdown(wait=False, cancel_futures=True)
        for process in self._own:
            process.terminate()
        until = monotonic() + _GRACE
        for process in self._own:
            process.join(max(until - monotonic(), 0))
            process.kill()
            process.join()


def _has(function: Callable) -> None:
    """Nothing: a worker that is called has imported the function."""


def _begin(log_level: int, cpus: SimpleQueue | None) -> None:
    """Prepare a worker: it ends with its parent, even if that is killed."""
    _log.setLevel(log_level)
    if cpus is not None:
        os.sched_setaffinity(0, {cpus.get()})
    signal.signal(signal.SIGTERM, _end)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch():
        connection.wait([parent.sentinel])
        _end()

    threading.Thread(target=watch, daemon=True).start()


def _end(*_) -> None:
    """End this worker at once."""
    os._exit(1)


@contextmanager
def _environment(variables: dict[str, str]) -> Iterator[None]:
    """Environment variables for processes that start meanwhile."""
    before = {name: os.environ.get(name) for name in variables}
    os.environ.update(variables)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
