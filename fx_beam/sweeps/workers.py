"""A function called for many items on workers: processes, threads, or any executor."""

from __future__ import annotations

import atexit
import copy
import logging
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable, Generator, Iterable, Sequence
from concurrent.futures import (
    BrokenExecutor,
    Executor,
    Future,
    ProcessPoolExecutor,
    as_completed,
)
from contextlib import closing, suppress
from multiprocessing.connection import Connection
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from fx_beam import mpi
from fx_beam.errors import SceneError, StepError, is_whole, require
from fx_beam.motions.surroundings import in_sweep
from fx_beam.scene.functions import ArrayCalls
from fx_beam.step.interrupts import Threads

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
