"""UFL and FFCx, imported when something is written in UFL: most processes find it in the cache."""

from __future__ import annotations

import importlib
import io
import logging
import sys
from collections.abc import Iterator, Mapping
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from ufl import Form
    from ufl.core.expr import Expr
else:  # UFL is loaded when something is written in it
    Expr = Form = object


def package(name: str) -> ModuleType:
    """UFL or FFCx, whose import would give the user's root logger a handler.

    UFL asks the streams that it writes to, which may be missing, for a terminal.
    """
    root = logging.getLogger()
    handlers = root.handlers[:]
    streams = {stream: getattr(sys, stream) for stream in ("stdout", "stderr")}
    missing = {s: file for s, file in streams.items() if getattr(file, "closed", file is None)}
    try:
        for stream in missing:
            setattr(sys, stream, io.StringIO())
        return importlib.import_module(name)
    finally:
        root.handlers[:] = handlers
        for stream, file in missing.items():
            setattr(sys, stream, file)


class _Ufl:
    """The module, whose names are looked up when they are first used."""

    def __getattr__(self, name: str) -> Any:
        part = self.__dict__[name] = getattr(package("ufl"), name)
        return part


ufl: Any = _Ufl()


def parts_of(expression: Expr) -> Iterator[Expr]:
    """An expression and all its parts, each once."""
    return ufl.corealg.traversal.unique_pre_traversal(expression)


def derivatives_taken(expression: Expr) -> Expr:
    """The expression with its derivatives written out."""
    lowered = ufl.algorithms.apply_algebra_lowering.apply_algebra_lowering(expression)
    return ufl.algorithms.apply_derivatives.apply_derivatives(lowered)


def is_zero(expression: Expr) -> bool:
    """Whether an expression is UFL's zero."""
    return isinstance(expression, ufl.constantvalue.Zero)


class Written(NamedTuple):
    """Forms, or expressions with their points, in UFL, which are used together, by name."""

    forms: Mapping[str, Form | tuple[Expr, np.ndarray]]
    #: Names of their coefficients and constants, by UFL's symbols.
    names: Mapping[Expr, str]
    #: What else their users must know, as JSON has it.
    facts: Mapping[str, Any] = {}
