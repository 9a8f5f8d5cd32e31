"""Functions that accept arrays: called once for all times or places, where values stay the same."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextvars import Context, ContextVar, copy_context
from typing import Any

import numpy as np

from .dual import Dual, have_slopes, plain, stacked

_NOW: ContextVar[ArrayCalls | None] = ContextVar("array calls", default=None)
# Fewer values are cheaper one by one; an array of so many is never taken for a vector.
_LEAST = 24
# Number of values of a known function that are compared.
_SAMPLES = 4
# Error of values in terms of the largest one: powers and sines of arrays may be rounded otherwise,
# and their differences are smaller than they.
_ROUNDING = 1e-13


class ArrayCalls:
    """What is known of functions: whether they give, for columns of numbers, the values at each.

    All values of the first function made by a line of the user's code are compared with those of
    calls one by one, and some of each later one. They may differ by round-off.
    """

    def __init__(self):
        self._fit: dict[Any, bool] = {}
        # Of a scene with slopes the last arguments of each function, and the values there: its
        # models, a motion and its derivatives ask for the same.
        self._known: dict[Any, tuple[Callable, np.ndarray, Any]] | None = None
        # Makes a block with slopes.
        self._block: Callable[[], Context]

    def begin_scene(self) -> None:
        """Forget the values of the last scene; those of this one are shared if it has slopes."""
        self._known, self._block = {} if have_slopes() else None, copy_context().copy

    def values(
        self, function: Callable, size: int, arguments: np.ndarray, what: str, one_by_one: Callable
    ) -> np.ndarray:
        """Values (n, size) at n arguments (n, k); `one_by_one` finds them from some of these."""
        given = function, size, arguments, what, one_by_one
        if self._known is None or isinstance(arguments, Dual):
            return self._values(*given)
        entry = self._known.get((id(function), what))
        if entry is None or not np.array_equal(entry[1], arguments):
            entry = function, arguments, self._block().run(self._values, *given)
            self._known[id(function), what] = entry
        return entry[2] if have_slopes() else plain(entry[2])

    def _values(
        self, function: Callable, size: int, arguments: np.ndarray, what: str, one_by_one: Callable
    ) -> np.ndarray:
        key = what, getattr(function, "__code__", type(function))
        least = 2 if have_slopes() else _LEAST  # with slopes, calls one by one are dear
        if len(arguments) < least or not self._fit.get(key, True):
            return one_by_one(arguments)
        at_once, is_first = _at_once(function, size, arguments), key not in self._fit
        if is_first:
            known = one_by_one(arguments)
            self._fit[key] = at_once is not None and agree(at_once, known)
            return known
        some = np.arange(_SAMPLES) * (len(arguments) - 1) // (_SAMPLES - 1)
        some, sizes = (some[1:2], at_once) if have_slopes() else (some, None)
        if at_once is None or not agree(at_once[some], one_by_one(arguments[some]), sizes):
            return one_by_one(arguments)
        return at_once


def array_calls() -> ArrayCalls | None:
    """Those of the block in which this is called; None outside."""
    return _NOW.get()


class calling_with_arrays:  # noqa: N801  # a block, which costs less than one by a generator
    """In this block, functions are called with arrays where they accept them."""

    def __init__(self, calls: ArrayCalls):
        self._calls = calls

    def __enter__(self) -> None:
        self._before = _NOW.set(self._calls)

    def __exit__(self, *_) -> None:
        _NOW.reset(self._before)


def agree(values: np.ndarray, known: np.ndarray, sizes: Any = None) -> bool:
    """Whether values (n, size) differ by round-off at most, of those known or of others."""
    values, known, sizes = map(plain, (values, known, known if sizes is None else sizes))
    return bool((abs(values - known) <= _ROUNDING * abs(sizes).max(axis=0)).all())


def _at_once(function: Callable, size: int, arguments: np.ndarray) -> np.ndarray | None:
    """Finite values (n, size) of one call; None if they do not fit."""
    if isinstance(arguments, Dual):
        columns: Any = [arguments[:, [i]] for i in range(arguments.shape[1])]
    else:
        columns = np.array(arguments.T[..., None], order="C")
        columns.setflags(write=False)
    shape = len(arguments), 1
    try:
        with np.errstate(divide="raise", over="raise", invalid="raise"):
            result: Any = function(*columns)
        if isinstance(result, np.ndarray | Dual) and result.shape == (len(arguments), size):
            values = stacked(result)
        else:
            alone = isinstance(result, Dual) and not result.ndim
            alone = alone or not hasattr(result, "__len__") or len(result) != size
            parts: Sequence = (result,) if alone else result
            columns = [np.broadcast_to(stacked(part), shape) for part in parts]
            values = np.concatenate(columns, axis=1)
    except Exception:  # noqa: BLE001  # whatever a function does that takes single numbers
        return None
    return values if values.shape[1] == size and np.isfinite(values).all() else None
