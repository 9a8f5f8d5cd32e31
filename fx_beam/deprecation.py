"""Former names of parameters and attributes, which still work."""

from __future__ import annotations

import functools
import warnings
from collections.abc import Callable
from typing import Any, TypeVar

_Function = TypeVar("_Function", bound=Callable[..., Any])


def formerly(**names: str) -> Callable[[_Function], _Function]:
    """Let a function take former names of its parameters, with a warning: former="present"."""

    def decorate(function: _Function) -> _Function:
        @functools.wraps(function)
        def called(*arguments, **options):
            for former, present in names.items():
                if former in options:
                    warnings.warn(f"{former} is now {present}", DeprecationWarning, stacklevel=2)
                    options[present] = options.pop(former)
            return function(*arguments, **options)

        return called  # type: ignore[return-value]

    return decorate


def former(of: Any, name: str, known: dict[str, tuple[str, Callable[[Any], Any]]]) -> Any:
    """A former attribute of an object, with a warning: what to write now, and what it gives."""
    if name not in known:
        raise AttributeError(f"{type(of).__name__!r} object has no attribute {name!r}")
    present, value = known[name]
    kind = type(of).__name__
    warnings.warn(f"{kind}.{name} is now {kind}.{present}", DeprecationWarning, stacklevel=3)
    return value(of)
