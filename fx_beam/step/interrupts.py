"""Ctrl-C and other threads: not between changes that belong together."""

from __future__ import annotations

import functools
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, TypeVar

Method = TypeVar("Method", bound=Callable[..., Any])


class _Blocks:
    """How many blocks have been entered, and the Ctrl-C that waits for their end."""

    def __init__(self) -> None:
        self.depth = 0
        self.waiting: Any = None

    def deliver(self) -> None:
        """Let Ctrl-C take effect."""
        interrupt, self.waiting = self.waiting, None
        if interrupt is not None:
            interrupt()


class _Uninterrupted(threading.local):
    """A block at whose end Ctrl-C takes effect. It costs little, so that each step may have one."""

    def __init__(self) -> None:
        self.blocks = _Blocks()

    def __enter__(self) -> None:
        self.blocks.depth += 1

    def __exit__(self, *_) -> None:
        blocks = self.blocks
        blocks.depth -= 1
        if blocks.waiting is not None and not blocks.depth:
            blocks.deliver()


uninterrupted = _Uninterrupted()


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


@contextmanager
def ctrl_c_between_blocks() -> Iterator[None]:
    """Let Ctrl-C wait until the end of `uninterrupted` blocks; a second one does not wait."""
    handler = signal.getsignal(signal.SIGINT)
    if not callable(handler) or threading.current_thread() is not threading.main_thread():
        yield  # no interrupt comes here
        return
    # Counted anew: another exception may have come in the midst of `__enter__` or `__exit__`.
    outer, blocks = uninterrupted.blocks, _Blocks()

    def interrupt(*arguments) -> None:
        try:
            handler(*arguments)
        except BaseException:
            # Here: it may come in the `finally` below, before this is done.
            signal.signal(signal.SIGINT, handler)
            raise

    def handle(*arguments) -> None:
        if blocks.depth and blocks.waiting is None:
            blocks.waiting = lambda: interrupt(*arguments)
        else:
            blocks.waiting = None
            interrupt(*arguments)

    try:
        uninterrupted.blocks = blocks
        signal.signal(signal.SIGINT, handle)
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
        uninterrupted.blocks = outer
        blocks.deliver()


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
