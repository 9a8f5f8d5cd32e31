"""A function called for many items on workers: processes of this machine, or any executor."""

from __future__ import annotations

import atexit
import copy
import logging
import math
import multiprocessing
import os
import pickle
import selectors
import signal
import sys
import threading
from collections import deque
from collections.abc import Callable, Generator, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import closing, suppress
from multiprocessing import connection
from multiprocessing.connection import Connection
from statistics import median
from time import monotonic, perf_counter
from typing import Any, NamedTuple

import numpy as np

from fx_beam.errors import SceneError, StepError, is_whole, require
from fx_beam.fem import mpi
from fx_beam.motions.motion_series import MotionSeries
from fx_beam.motions.surroundings import simulating_by

_log = logging.getLogger("fx_beam")
_THREAD = threading.local()
# One thread a worker, whatever BLAS there is; read when numpy is imported.
_ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
# Largest number of processes.
_MOST = 10_000
# Time of the items that a process is given at once, and of one that lets the others wait [s].
_AT_ONCE, _LONG = 0.02, 0.1
# Longest wait for news [s]: the system takes no longer ones.
_LONGEST_WAIT = 1e6
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
    with simulating_by(_series_here()):  # the function may change the item that it is given
        outcome = _tried(lambda: Outcome(function(copy.deepcopy(item)), 0.0, ""), errors=Exception)
    return outcome._replace(seconds=perf_counter() - clock)


def _tried(function: Callable[..., Any], *given: Any, errors: Any = (Exception, SystemExit)) -> Any:
    """What a function gives; if it raises one of the `errors`, the outcome of a failed item."""
    try:
        return function(*given)
    except errors as error:
        return Outcome(None, np.nan, _sentence(error))


def open_workers(function: Callable, executor: Any, timeout: float | None = None) -> Workers:
    """Workers of an executor; None: here, one after another; a number: so many processes.

    The first item of all runs alone, so that it compiles for all. Nothing is started before it. An
    item that takes longer than `timeout` [s] is ended, with its process.
    """
    if executor is None:
        return _Here(function)
    if is_whole(executor, 1, _MOST):
        return _OnProcesses(int(executor), function, timeout)
    fits = not isinstance(executor, int) and hasattr(executor, "submit")
    wanted = "an executor of concurrent.futures, or the number of processes"
    require(fits, "executor", executor, wanted)
    if timeout is not None:
        raise SceneError(
            f"timeout = {timeout:g} needs processes of this machine: give executor their number"
        )
    return _OnExecutor(executor, function)


def run(function: Callable, items: Sequence, executor: Executor | int | None) -> Outcomes:
    """Places of the items and outcomes, as they finish. To be closed, which ends what runs."""
    with closing(open_workers(function, executor)) as workers:
        yield from workers.run(items)


def _series_here() -> MotionSeries:
    """The motions of this thread's items: a scene is prepared for those of equal structure."""
    if not hasattr(_THREAD, "series"):
        _THREAD.series = MotionSeries()
    return _THREAD.series


class _Here:
    """The thread that asks, one item after another."""

    def __init__(self, function: Callable):
        self._function = function

    def run(self, items: Sequence) -> Outcomes:
        yield from ((index, call(self._function, item)) for index, item in enumerate(items))

    def close(self) -> None:
        vars(_THREAD).clear()


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


# -- Processes of this machine -------------------------------------------------------------------


class _OnProcesses:
    """Processes of this machine; each is given the next items when it has none.

    An item whose process dies runs again after all others, alone, as memory may have been short.
    If its process dies again, it is the cause.
    """

    def __init__(self, number: int, function: Callable, timeout: float | None):
        self._number, self._function, self._timeout = number, function, timeout or math.inf
        # Each worker has a core of its own: some kernels leave two on one for seconds.
        cpus = os.sched_getaffinity(0)
        self._cpus: list[int | None] = [*cpus] if number == len(cpus) else [None] * number
        self._workers: list[_Worker] = []
        self._news = selectors.DefaultSelector()
        self._begun, self._idle, self._numbered = False, True, 0
        #: Times of the last items [s], and numbers of those whose process died.
        self._seconds: deque[float] = deque(maxlen=64)
        self._died: set[int] = set()

    def run(self, items: Sequence) -> Outcomes:
        if items and not self._workers:
            _check_can_start(self._function, items)
            atexit.register(self.close)
        self._idle, first = False, self._numbered
        self._numbered += len(items)  # over all runs, as one may be sent when it is not awaited
        left, retried = deque(range(first, self._numbered)), deque[int]()
        while left or retried or self._is_busy():
            if len(self._workers) < min(self._number, len(left) + len(retried)):
                self._start(min(self._number, len(left) + len(retried)))
            done = self._hand_out(lambda number: items[number - first], left or retried)
            if not done:
                for worker in self._with_news():
                    done += self._read(worker, left, retried)
            yield from ((number - first, outcome) for number, outcome in done)
        self._idle = True

    def _start(self, number: int) -> None:
        """Have so many processes. Ctrl-C is not theirs; it waits for the end."""
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        before = os.environ.copy()
        os.environ.update(_ONE_THREAD)
        try:
            while len(self._workers) < number:
                worker = _Worker(self._function, self._cpus.pop())
                self._workers.append(worker)
                for source in (worker.pipe, worker.process.sentinel):
                    self._news.register(source, selectors.EVENT_READ, worker)
        finally:
            for name in _ONE_THREAD:
                del os.environ[name]
            os.environ.update(before)
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def _hand_out(self, item: Callable[[int], Any], queue: deque[int]) -> list[tuple[int, Outcome]]:
        """Give items to workers that have none, or soon. Returns those that cannot be sent."""
        done: list[tuple[int, Outcome]] = []
        usual = median(self._seconds) if self._seconds else math.inf
        for worker in sorted(self._workers, key=lambda worker: len(worker.awaited)):
            if not queue:
                break
            # The first of all compiles for the others; those whose process died are the last.
            alone = not self._begun or queue[0] in self._died
            soon = len(worker.awaited) == 1 and max(usual, worker.seconds()) < _LONG
            if not worker.ready or (self._is_busy() if alone else worker.awaited and not soon):
                continue
            # Sending each costs 0.1 ms.
            size = min(int(_AT_ONCE / max(usual, 1e-5)), len(queue) // (8 * self._number))
            size = 1 if alone else max(1, size)
            part: list[tuple[int, bytes]] = []
            while queue and len(part) < size:
                number = queue.popleft()
                pickled = _tried(pickle.dumps, item(number))
                (part if isinstance(pickled, bytes) else done).append((number, pickled))
            if part:
                worker.give(part)
        return done

    def _is_busy(self) -> bool:
        return any(worker.awaited for worker in self._workers)

    def _with_news(self) -> set[_Worker]:
        """Wait for workers that sent something, died, or take long."""
        left = {worker: self._patience(worker) - worker.seconds() for worker in self._workers}
        wait = min(left.values(), default=math.inf)
        ready = self._news.select(min(max(wait, 0.0), _LONGEST_WAIT))
        late = {worker for worker, seconds in left.items() if seconds <= wait < math.inf}
        return late | {key.data for key, _ in ready}

    def _patience(self, worker: _Worker) -> float:
        """How long it may be busy with an item before something is done [s]."""
        if not worker.awaited:
            return math.inf
        return min(self._timeout, _LONG if len(worker.awaited) > 1 else math.inf)

    def _read(
        self, worker: _Worker, left: deque[int], retried: deque[int]
    ) -> list[tuple[int, Outcome]]:
        """What a worker has done. What it does not do any more goes back."""
        lives = worker.process.is_alive()  # asked first: then all that it sent is there
        done = worker.outcomes()
        if done:
            times = [outcome.seconds for _, outcome in done if self._begun]
            self._seconds += filter(math.isfinite, times)
            self._begun = True
        if lives and len(worker.awaited) > 1 and worker.seconds() > _LONG:
            left += worker.take_back()
        if lives and not (worker.awaited and worker.seconds() > self._timeout):
            return done
        if not worker.ready:
            raise SceneError(_NO_START)
        if worker.awaited:
            number = worker.awaited.popleft()
            if lives:
                late = f"it took longer than timeout = {self._timeout:g} s, and was ended"
                done.append((number, Outcome(None, worker.seconds(), late)))
            elif number in self._died:
                done.append((number, Outcome(None, np.nan, _DIED)))
            else:
                self._died.add(number)
                retried.append(number)
        left += worker.awaited
        for source in (worker.pipe, worker.process.sentinel):
            self._news.unregister(source)
        worker.end()
        self._workers.remove(worker)
        self._cpus.append(worker.cpu)
        return done

    def close(self) -> None:
        """Let processes end that have nothing to do; end others, whatever they do."""
        atexit.unregister(self.close)
        for worker in self._workers:
            if not self._idle:
                worker.process.terminate()
            worker.pipe.close()
        until = monotonic() + _GRACE
        for worker in self._workers:
            worker.process.join(max(until - monotonic(), 0))
            worker.end()
        self._workers.clear()


#: What calls the function for items, as often as it is asked, until it is closed.
Workers = _Here | _OnExecutor | _OnProcesses


class _Worker:
    """A process, which `spawn` starts: a fork would share what MPI and PETSc hold."""

    def __init__(self, function: Callable, cpu: int | None):
        self.cpu = cpu
        #: Whether it has the function; numbers of the items that it was given and has not done.
        self.ready, self.awaited = False, deque[int]()
        self._since = 0.0
        spawn = multiprocessing.get_context("spawn")
        self.pipe, its_end = spawn.Pipe()
        arguments = its_end, function, cpu, _log.getEffectiveLevel()
        self.process = spawn.Process(target=_work, args=arguments)
        self.process.start()
        its_end.close()

    def seconds(self) -> float:
        """How long it has been busy with an item [s]."""
        return monotonic() - self._since

    def give(self, part: list[tuple[int, bytes]]) -> None:
        """Give it pickled items, with their numbers."""
        self.awaited.extend(number for number, _ in part)
        self._since = monotonic()
        self._send(part)

    def take_back(self) -> list[int]:
        """Numbers of the items that it shall not begin any more."""
        first, *others = self.awaited
        self.awaited = deque([first])
        # By their numbers: it may not have begun the first one either.
        self._send(set(others))
        return others

    def _send(self, part: list[tuple[int, bytes]] | set[int]) -> None:
        with suppress(OSError):  # of a process that died, which is seen later
            self.pipe.send(part)

    def outcomes(self) -> list[tuple[int, Outcome]]:
        """What it has sent, by the numbers of the items."""
        done = []
        with suppress(EOFError, OSError):
            while self.pipe.poll():
                number, sent = self.pipe.recv()
                self.ready, self._since = True, monotonic()
                if number in self.awaited:
                    self.awaited.remove(number)
                    done.append((number, _tried(pickle.loads, sent)))
        return done

    def end(self) -> None:
        """End the process, whatever it does."""
        self.pipe.close()
        self.process.kill()
        self.process.join()


def _work(pipe: Connection, function: Callable, cpu: int | None, log_level: int) -> None:
    """Call the function for items that come, in a worker; it ends with its parent."""
    _log.setLevel(log_level)
    if cpu is not None:
        os.sched_setaffinity(0, {cpu})
    signal.signal(signal.SIGTERM, _end)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def watch():
        connection.wait([parent.sentinel])
        _end()

    threading.Thread(target=watch, daemon=True).start()
    items: deque[tuple[int, bytes]] = deque()
    with suppress(EOFError, OSError):
        pipe.send((-1, b""))  # it has the function
        while True:
            while not items or pipe.poll():
                got = pipe.recv()
                if isinstance(got, set):  # of items that others do
                    items = deque(item for item in items if item[0] not in got)
                else:
                    items.extend(got)
            number, pickled = items.popleft()
            outcome = _tried(lambda pickled: call(function, pickle.loads(pickled)), pickled)
            sent = _tried(pickle.dumps, outcome)
            pipe.send((number, sent if isinstance(sent, bytes) else pickle.dumps(sent)))


def _end(*_) -> None:
    """End this worker at once."""
    os._exit(1)
