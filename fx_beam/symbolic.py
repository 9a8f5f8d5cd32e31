"""UFL and FFCx, imported when something is written in UFL: most processes find it in the cache."""

from __future__ import annotations

import importlib
import io
import sys
from collections.abc import Mapping
from types import ModuleType
from typing import Any, NamedTuple


def package(name: str) -> Any:
    """UFL or FFCx, which ask pkg_resources for their versions alone in Debian 12.

    Its own import takes longer than both of theirs.
    """
    if name in sys.modules or "pkg_resources" in sys.modules:
        return _imported(name)
    stand_in: Any = ModuleType("pkg_resources")
    sys.modules["pkg_resources"] = stand_in
    try:
        stand_in.get_distribution = importlib.import_module("importlib.metadata").distribution
        return _imported(name)
    finally:
        del sys.modules["pkg_resources"]


def _imported(name: str) -> Any:
    """The same; UFL asks where it writes whether that is a terminal, also if there is nothing."""
    streams = {of: getattr(sys, of) for of in ("stdout", "stderr")}
    missing = [of for of, to in streams.items() if to is None or getattr(to, "closed", False)]
    try:
        for of in missing:
            setattr(sys, of, io.StringIO())
        return importlib.import_module(name)
    finally:
        for of in missing:
            setattr(sys, of, streams[of])


class _Ufl:
    """The module, whose names are looked up when they are first used."""

    def __getattr__(self, name: str) -> Any:
        part = self.__dict__[name] = getattr(package("ufl"), name)
        return part


ufl: Any = _Ufl()


def parts_of(expression: Any) -> Any:
    """An expression and all of which it consists, each once."""
    return ufl.corealg.traversal.unique_pre_traversal(expression)


def derivatives_taken(expression: Any) -> Any:
    """The expression with its derivatives written out."""
    lowered = ufl.algorithms.apply_algebra_lowering.apply_algebra_lowering(expression)
    return ufl.algorithms.apply_derivatives.apply_derivatives(lowered)


def is_zero(expression: Any) -> bool:
    """Whether an expression is UFL's zero."""
    return isinstance(expression, ufl.constantvalue.Zero)


class Written(NamedTuple):
    """Forms, or expressions with their points, in UFL, which are used together, by name."""

    forms: Mapping[str, Any]
    #: Names of their coefficients and constants, by UFL's symbols.
    names: Mapping[Any, str]
    #: What else their users must know, as JSON has it.
    facts: Mapping[str, Any] = {}
