"""Results that are computed once: of functions of small arrays, and of properties; copies."""

from __future__ import annotations

import functools
from collections.abc import Callable
from contextlib import nullcontext
from typing import Any, NamedTuple, TypeVar

import numpy as np

F = TypeVar("F", bound=Callable)
T = TypeVar("T")

# Size of all arguments up to which a result is kept [bytes], and number of results of a function.
_LARGEST, _MOST = 1 << 16, 32


class _Contents(NamedTuple):
    """An array as an argument that can be compared."""

    kind: np.dtype
    shape: tuple[int, ...]
    data: bytes


def cached_by_content(function: F) -> F:
    """Keep the last results of a function of arrays and constants, if the arrays are small.

    Scenes that differ in numbers only share what follows from their connectivity. The arrays of a
    result are made read-only.
    """

    @functools.lru_cache(maxsize=_MOST)
    def of_contents(*contents):
        return _locked(function(*map(_array, contents)))

    @functools.wraps(function)
    def wrapper(*arguments):
        if sum(getattr(argument, "nbytes", 0) for argument in arguments) > _LARGEST:
            return function(*arguments)
        return of_contents(*map(_contents, arguments))

    return wrapper  # type: ignore[return-value]


class cached_property(functools.cached_property[T]):
    """A property that is computed when it is first read.

    Without the lock of Python 3.11: all objects share it, and an interrupt may leave it closed.
    """

    def __init__(self, function: Callable[..., T]):
        super().__init__(function)
        self.lock = nullcontext()


def _contents(argument: object) -> object:
    if isinstance(argument, np.ndarray):
        return _Contents(argument.dtype, argument.shape, argument.tobytes())
    return argument


def _array(contents: object) -> object:
    if isinstance(contents, _Contents):
        return np.frombuffer(contents.data, contents.kind).reshape(contents.shape).copy()
    return contents


def _locked(result: Any) -> Any:
    if isinstance(result, np.ndarray):
        result.setflags(write=False)
    elif isinstance(result, tuple | list | dict):
        for part in result.values() if isinstance(result, dict) else result:
            _locked(part)
    return result


def shallow_copy(original: T) -> T:
    """An object of the same class with the same attributes, sooner than by `copy.copy`."""
    other = object.__new__(type(original))
    other.__dict__.update(original.__dict__)
    return other
