"""UFL symbols in the hands of a user's functions."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from ufl.core.expr import Expr


@contextmanager
def not_numbers() -> Iterator[None]:
    """Calls in which a symbol refuses to be a number, as functions of math and NumPy want it.

    UFL would try it over and over, with a warning each time, and never end.
    """

    def refuse(self):
        raise TypeError("a UFL symbol is not a number")

    usual = Expr.__float__
    Expr.__float__ = refuse  # numbers of UFL have their own
    try:
        yield
    finally:
        Expr.__float__ = usual
