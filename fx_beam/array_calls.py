"""Functions of time that accept arrays: called once for all times, where values stay the same."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

import numpy as np

_NOW: ContextVar[ArrayCalls | None] = ContextVar("array calls", default=None)
# Fewer times are cheaper one by one; an array of so many is never taken for a vector.
_LEAST = 24
# Number of times at which the values of a known function are compared.
_SAMPLES = 4
# Error of values in terms of the largest one: powers and sines of arrays may be rounded otherwise.
_ROUNDING = 16 * np.finfo(float).eps


class ArrayCalls:
    """What is known of functions: whether they give, for a column of times, the values at each.

    All values of the first function made by a line of the user's code are compared with those of
    calls one by one, and some of each later one.
    """

    def __init__(self):
        self._fit: dict[Any, bool] = {}

    def values(
        self, function: Callable, size: int, times: np.ndarray, what: str, one_by_one: Callable
    ) -> np.ndarray:
        """Values (n, size) at n times; `one_by_one` finds them from some times."""
        key = what, getattr(function, "__code__", type(function))
        if len(times) < _LEAST or not self._fit.get(key, True):
            return one_by_one(times)
        found, is_first = _at_once(function, size, times), key not in self._fit
        if is_first:
            known = one_by_one(times)
            self._fit[key] = found is not None and _agree(found, known)
            return known
        some = np.linspace(0, len(times) - 1, _SAMPLES).astype(int)
        if found is None or not _agree(found[some], one_by_one(times[some])):
            return one_by_one(times)
        return found


def array_calls() -> ArrayCalls | None:
    """Those of the block in which this is called; None outside."""
    return _NOW.get()


@contextmanager
def calling_with_arrays() -> Iterator[None]:
    """In this block, functions of time are called with arrays where they accept them."""
    before = _NOW.set(ArrayCalls())
    try:
        yield
    finally:
        _NOW.reset(before)


def _at_once(function: Callable, size: int, times: np.ndarray) -> np.ndarray | None:
    """Values (n, size) of one call; None if they do not fit."""
    column = times[:, None].copy()
    column.setflags(write=False)
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            found: Any = function(column)
        if isinstance(found, np.ndarray) and found.shape == (len(times), size):
            return np.array(found, float)
        parts: Sequence = found if hasattr(found, "__len__") and len(found) == size else (found,)
        columns = [np.broadcast_to(np.asarray(part, float), column.shape) for part in parts]
        return np.hstack(columns) if len(columns) == size else None
    except Exception:  # noqa: BLE001  # whatever a function does that takes single times
        return None


def _agree(found: np.ndarray, known: np.ndarray) -> bool:
    """Whether values (n, size) differ by round-off only."""
    return bool((abs(found - known) <= _ROUNDING * abs(known).max(axis=0)).all())
