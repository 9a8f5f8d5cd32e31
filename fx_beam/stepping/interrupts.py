"""Ctrl-C at the right moment: not between changes that belong together."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class _Uninterrupted(threading.local):
    """A block at whose end Ctrl-C takes effect. It costs little, so that each step may have one."""

    depth = 0
    waiting: Any = None

    def __enter__(self) -> None:
        self.depth += 1

    def __exit__(self, *_) -> None:
        self.depth -= 1
        if self.waiting is not None and not self.depth:
            interrupt, self.waiting = self.waiting, None
            interrupt()


uninterrupted = _Uninterrupted()


@contextmanager
def ctrl_c_between_blocks() -> Iterator[None]:
    """Let Ctrl-C wait until the end of `uninterrupted` blocks."""
    handler = signal.getsignal(signal.SIGINT)
    if not callable(handler) or threading.current_thread() is not threading.main_thread():
        yield  # no interrupt comes here
        return

    def handle(*arguments) -> None:
        if uninterrupted.depth:
            uninterrupted.waiting = lambda: handler(*arguments)
        else:
            handler(*arguments)

    signal.signal(signal.SIGINT, handle)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)
