"""The processes of mpirun: the first one sends calls, and each does them with its part."""

from __future__ import annotations

import io
import os
import pickle
import queue
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import partial
from typing import Any, ClassVar

from fx_beam.errors import SceneError
from fx_beam.fem.mpi import world
from fx_beam.scene.parameters import is_parameter

# Longest time between two looks for a message [s], and number of first looks without a pause.
_PAUSE, _AT_ONCE = 1e-3, 200
# How long the first process waits for the others when mpirun ends them [s].
_PATIENCE = 0.2
# Time [s] for the other processes after an error of one, as some may wait for it; tag of errors.
_ALONE, _FAILED = 10.0, 1
_LOST = (
    "fx_beam: mpirun ends all processes, and kills this one soon. The script goes on with a "
    "KeyboardInterrupt, to save the steps so far"
)
_REFUSED = (
    "on several processes functions of your own in sections are sent to all, but one of these "
    "cannot be: {}. Let it use numbers, functions and modules only, or compute on one process, "
    "without mpirun"
)


class ProcessGroup:
    """What the first process knows of all: it sends calls and waits for what they give."""

    #: The team of this process while a script runs on it; None without other processes.
    leading: ClassVar[ProcessGroup | None] = None

    def __init__(self) -> None:
        self._comm = world()
        self.size: int = self._comm.size
        self._objects: dict[int, Any] = {}
        self._made = 0
        #: Numbers of objects that are destroyed before the next call.
        self.left: list[int] = []
        self._busy, self._waiting = False, False
        #: Whether mpirun ends all processes, and whether some do not answer.
        self._ending, self.lost = False, False
        self._own_error: Exception | None = None
        # A SimpleQueue that a signal interrupts may wait for ever, whatever the timeout.
        self._asked, self._found = queue.SimpleQueue[Any](), queue.Queue[list]()
        self._thread = threading.Thread(target=self._exchange, daemon=True)
        self._thread.start()

    def make(self, make: Callable, arguments: Sequence[tuple]) -> RemoteObjects:
        """Make an object on each process, by a function of a module."""
        self._made += 1
        number = self._made
        self.ask([(("make", number, make), argument) for argument in arguments])
        return RemoteObjects(self, number)

    def ask(self, messages: Sequence[tuple]) -> list:
        """What each process gives for a message."""
        if self.lost:
            raise SceneError("the other processes of mpirun have failed: start the script again")
        left, self.left = self.left, []
        packed = [_packed((left, *message)) for message in messages[1:]]
        self._busy = True  # an interrupt waits until all processes have answered
        try:
            self._asked.put((packed, lambda: (left, *messages[0])))
            answers = self._wait()
        finally:
            self._busy = False
        if self._waiting:
            self._waiting = False
            raise KeyboardInterrupt
        for rank, (error, _) in enumerate(answers):
            if error is not None:
                if rank:
                    error.add_note(f"fx_beam: on process {rank} of {self.size}")
                raise error
        return [value for _, value in answers]

    def _exchange(self) -> None:
        """In a thread, so that signals arrive: do what is asked, while the others do the same."""
        while (request := self._asked.get()) is not None:
            packed, first_request = request
            for rank in range(1, self.size):
                self._comm.send(packed.pop(0), rank)
            answers = [answer(self._objects, first_request)]
            self._own_error = answers[0][0]
            answers += [_received(self._comm, rank) for rank in range(1, self.size)]
            self._own_error = None
            self._found.put(answers)
            del request, packed, first_request, answers

    def _wait(self) -> list:
        """What all found. KeyboardInterrupt if mpirun ends them."""
        failed_at = None
        while True:
            try:
                return self._found.get(timeout=_PATIENCE)
            except queue.Empty:
                if self._ending:
                    raise KeyboardInterrupt from None
            if self._own_error is None and not self._comm.iprobe(tag=_FAILED):
                continue
            failed_at = failed_at or time.monotonic()
            if time.monotonic() - failed_at > _ALONE:
                self.lost = True
                raise self._own_error or self._comm.recv(tag=_FAILED)[0]

    def interrupt(self, *_: Any) -> None:
        """Take Ctrl-C, between two calls."""
        if self._busy:
            self._waiting = True
        else:
            raise KeyboardInterrupt

    def terminate(self, *arguments: Any) -> None:
        """Take the end by mpirun, a second later, as Ctrl-C: the script can save its steps."""
        signal.signal(signal.SIGTERM, signal.SIG_IGN)
        self._ending = self.lost = True
        os.write(2, f"{_LOST}\n".encode())
        handler = signal.getsignal(signal.SIGINT)
        if callable(handler):
            handler(*arguments)

    def close(self) -> None:
        """Let the others end."""
        if self.lost:
            self._comm.Abort(1)
        self._asked.put(None)
        self._thread.join()
        for rank in range(1, self.size):
            self._comm.send(None, rank)


class RemoteObjects:
    """Objects of one kind, one on each process."""

    def __init__(self, team: ProcessGroup, number: int):
        self.team, self._number = team, number

    def __call__(self, method: str, arguments: Sequence[tuple] | None = None) -> list:
        """Results of a method, one of each process."""
        calls = arguments or [()] * self.team.size
        return self.team.ask([(("call", self._number, method), call) for call in calls])

    def __del__(self) -> None:
        self.team.left.append(self._number)


@contextmanager
def led() -> Iterator[None]:
    """On the first process: lead the others while the script runs."""
    ProcessGroup.leading = team = ProcessGroup()
    signal.signal(signal.SIGINT, team.interrupt)
    # mpirun sends it after Ctrl-C, and when a process is lost.
    signal.signal(signal.SIGTERM, team.terminate)
    try:
        yield
    except BaseException:
        if team.lost:  # its end is that of all processes
            traceback.print_exc()
            sys.stderr.flush()
        raise
    finally:
        ProcessGroup.leading = None
        team.close()


def follow() -> None:
    """On the others: do what the first one asks, until it ends."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)
    comm, objects = world(), dict[int, Any]()
    try:
        while (message := _received(comm, 0)) is not None:
            error, value = answer(objects, partial(pickle.loads, message))
            try:
                pickle.loads(pickle.dumps(error))
            except Exception:  # it cannot be sent
                error = RuntimeError(repr(error))
            comm.send((error, value), 0, 0 if error is None else _FAILED)
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
        comm.Abort(1)


def answer(objects: dict[int, Any], message: Callable[[], tuple]) -> tuple[Exception | None, Any]:
    """The error, or what a call gives."""
    try:
        left, (kind, number, name), arguments = message()
        for old in left:
            if old in objects:
                objects.pop(old).destroy()
        if kind == "make":
            objects[number] = name(*arguments)
            return None, None
        return None, getattr(objects[number], name)(*arguments)
    except Exception as error:
        return error, None


def _received(comm: Any, rank: int) -> Any:
    """The next message of a process; the wait leaves the processor to other work."""
    tries, pause = 0, 2e-5
    while not comm.iprobe(rank):
        tries += 1
        if tries > _AT_ONCE:
            time.sleep(pause)
            pause = min(1.1 * pause, _PAUSE)
    return comm.recv(source=rank)


def _packed(message: Any) -> bytes:
    """A message as bytes, with the code of functions that the other processes cannot import."""
    # Imported here: one process alone sends nothing.
    import cloudpickle

    class Pickler(cloudpickle.Pickler):
        def reducer_override(self, value: Any) -> Any:
            if is_parameter(value):  # its values come with each step
                return type(value), (value.name, 0.0)
            return super().reducer_override(value)

    out = io.BytesIO()
    try:
        Pickler(out).dump(message)
    except (pickle.PicklingError, AttributeError, TypeError, ValueError) as error:
        raise SceneError(_REFUSED.format(error)) from None
    return out.getvalue()
