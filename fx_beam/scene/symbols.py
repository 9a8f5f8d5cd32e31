"""UFL symbols in the hands of a user's functions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import ufl
from ufl.core.expr import Expr

from fx_beam.errors import SceneError


@contextmanager
def not_numbers() -> Iterator[None]:
    """Calls in which a symbol refuses to be a number, as functions of math and NumPy want it.

    UFL would try it over and over, with a warning each time, and never end.
    """

    def refuse(self):
        raise TypeError("a UFL symbol is not a number. Use ufl.exp, not math.exp")

    usual = Expr.__float__
    Expr.__float__ = refuse  # numbers of UFL have their own
    try:
        yield
    finally:
        Expr.__float__ = usual


def expression_of(function: Callable, arguments: Sequence, call: str) -> Any:
    """The UFL expression that a user's function gives; SceneError, named by the call, for none."""
    try:
        with not_numbers():
            return ufl.as_ufl(function(*arguments))
    except Exception as error:
        raise SceneError(
            f"{call} must give a UFL expression. Use ufl.sqrt, ufl.exp, ... in place of functions "
            f"of math or NumPy. It raised {error!r}"
        ) from error
