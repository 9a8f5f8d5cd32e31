"""Ctrl-C and other threads: not between changes that belong together."""

from __future__ import annotations

import functools
import signal
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any, TypeVar

Method = TypeVar("Method", bound=Callable[..., Any])

#: A block in which Ctrl-C need not wait.
NOTHING = nullcontext()


@contextmanager
def without_ctrl_c() -> Iterator[None]:
    """Take no notice of Ctrl-C: what follows the first one is short."""
    handler = signal.getsignal(signal.SIGINT)
    if not callable(handler) or threading.current_thread() is not threading.main_thread():
        yield
        return
    try:
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


class Whole:
    """A block at whose end Ctrl-C takes effect; a second one does not wait."""

    def __init__(self, handler: Callable[..., Any]):
        self._handler, self._entered = handler, False
        self._waiting: tuple | None = None

    def __enter__(self) -> None:
        self._entered = True

    def __exit__(self, *_: Any) -> None:
        self._entered = False
        if self._waiting is not None:
            self.deliver(*self._waiting)

    def handle(self, *arguments: Any) -> None:
        """Take Ctrl-C."""
        if self._entered and self._waiting is None:
            self._waiting = arguments
        else:
            self.deliver(*arguments)

    def deliver(self, *arguments: Any) -> None:
        """Let it take effect."""
        self._waiting = None
        try:
            self._handler(*arguments)
        except BaseException:
            # Here: it may come in the `finally` below, before this is done.
            signal.signal(signal.SIGINT, self._handler)
            raise


@contextmanager
def ctrl_c_waits() -> Iterator[AbstractContextManager[None]]:
    """Let Ctrl-C wait until the end of `Whole` blocks, of which this has one."""
    handler = signal.getsignal(signal.SIGINT)
    if not callable(handler) or threading.current_thread() is not threading.main_thread():
        yield NOTHING  # no interrupt comes here
        return
    whole = Whole(handler)
    try:
        signal.signal(signal.SIGINT, whole.handle)
        yield whole
    finally:
        signal.signal(signal.SIGINT, handler)
        whole.__exit__()


class Threads(ThreadPoolExecutor):
    """Threads for calls; at the end of a `with` block calls that have not begun are dropped."""

    def submit(self, function: Callable, /, *arguments: Any, **options: Any) -> Future:
        """A call in one of the threads; Ctrl-C within it could leave them without their locks."""
        with ctrl_c_waits() as whole, whole:
            return super().submit(function, *arguments, **options)

    def __exit__(self, *_: Any) -> None:
        self.shutdown(cancel_futures=True)


def one_thread(method: Method) -> Method:
    """A method of an object with a `threading.RLock` `_alone`: other threads are refused."""

    @functools.wraps(method)
    def alone(self, *arguments, **options):
        lock = self._alone
        if not lock.acquire(blocking=False):
            raise RuntimeError(
                f"{type(self).__name__}.{method.__name__}: another thread is using this object, "
                "which has the state of one motion. Give each thread a copy.copy of it"
            )
        try:  # after an exception before this line the thread still has the lock, and may go on
            return method(self, *arguments, **options)
        finally:
            lock.release()

    return alone  # type: ignore[return-value]
