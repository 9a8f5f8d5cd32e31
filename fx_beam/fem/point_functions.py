"""Functions of a few numbers, from UFL: compiled once, called from Python and from C."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from typing import Any

import ufl
from ufl.algorithms import expand_derivatives
from ufl.corealg.map_dag import map_expr_dag
from ufl.corealg.multifunction import MultiFunction

import numpy as np

from . import dolfinx_api, ffcx_api

# Tensor, coefficients, constants, coordinates; the others have no meaning here. Later versions of
# FFCx have one more, which C ignores where there is none.
_FUNCTION = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 7)

# A UFL vector of UFL numbers.
Values = Callable[[Any], Any]


class _Stripped(MultiFunction):
    """An expression without the variables of its derivatives; parts that it shares stay shared."""

    expr = MultiFunction.reuse_if_untouched

    def variable(self, _, operand, label):
        """What the variable stands for."""
        return operand


def _shared(expression: Any) -> Any:
    """The expression with equal parts as one object.

    UFL compares equal objects part by part, whose number without sharing grows exponentially.
    """
    known: dict[int, Any] = {}
    by_parts: dict[Any, Any] = {}
    reuse = MultiFunction().reuse_if_untouched
    left = [expression]
    while left:
        part = left[-1]
        if id(part) in known:
            left.pop()
        elif missing := [of for of in part.ufl_operands if id(of) not in known]:
            left += missing
        else:
            left.pop()
            parts = [known[id(of)] for of in part.ufl_operands]
            key = (type(part), *map(id, parts)) if parts else part
            if key not in by_parts:
                by_parts[key] = reuse(part, *parts)
            known[id(part)] = by_parts[key]
    return known[id(expression)]


class PointFunction:
    """A UFL vector of some numbers as a C function."""

    def __init__(self, compiled: dolfinx_api.CompiledForm):
        self._compiled = compiled
        self._size = compiled.form[0].ufl_shape[0]
        #: Address of the function.
        self.address = ffcx_api.expression_function(compiled)
        self._function = _FUNCTION(self.address)

    def __call__(self, numbers: np.ndarray) -> np.ndarray:
        """Values (size,) of numbers (arguments,)."""
        out = np.zeros(self._size)
        self._function(out.ctypes.data, None, numbers.ctypes.data, None, None, None, None)
        return out


def point_functions(values: Mapping[str, Values], arguments: int) -> list[PointFunction]:
    """UFL vectors of `arguments` numbers by name, which are used together, as C functions."""
    numbers = ufl.Constant(dolfinx_api.domain(1), shape=(arguments,))
    # Without the variables of derivatives: later versions of UFL tell them apart by numbers of
    # the process, and would compile the same function again.
    expressions = {
        name: map_expr_dag(_Stripped(), expand_derivatives(_shared(of(numbers))))
        for name, of in values.items()
    }
    compiled = dolfinx_api.compile_together(
        {name: (expression, np.array([[0.5]])) for name, expression in expressions.items()}
    )
    return [PointFunction(function) for function in compiled]
