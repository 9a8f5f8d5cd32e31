"""Functions of a user, in UFL, and the parameters in them, which are numbers."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING

from fx_beam.dual import dual_array, floats
from fx_beam.errors import SceneError, as_float, is_number, refuse_fields_in, shown
from fx_beam.symbolic import Expr, ufl

from .functions import Input, Signal, TimeValue, checked_value

if TYPE_CHECKING:
    from .ufl_symbols import Parameter


@contextmanager
def refused(refusal: str) -> Iterator[None]:
    """A block that calls a function of a user on symbols; SceneError with a text if it fails."""
    try:
        yield
    except Exception as error:
        raised: Exception = error
        if isinstance(error, TypeError) and "__float__" in str(error):  # UFL's own words
            raised = TypeError("a UFL symbol is not a number. Use ufl.exp, not math.exp")
        raise SceneError(f"{refusal}. It raised {raised!r}") from error


def is_parameter(value: object) -> bool:
    """Whether a value is a `Parameter`."""
    if not hasattr(value, "ufl_operands"):
        return False
    from .ufl_symbols import Parameter

    return isinstance(value, Parameter)


def parameters_in(*expressions: Expr) -> list[Parameter]:
    """All parameters in UFL expressions, also several of one name."""
    left, parts = [ufl.as_ufl(expression) for expression in expressions], dict[int, Expr]()
    while left:
        part = left.pop()
        if id(part) not in parts:
            parts[id(part)] = part
            left += part.ufl_operands
    return [part for part in parts.values() if is_parameter(part)]


def scalar_of(function: Callable, count: int, call: str) -> tuple[Expr, list[Expr]]:
    """The expression that a user's function gives, and the `count` variables in it.

    SceneError if it is no scalar UFL expression, or has other symbols than parameters.
    """
    variables = new_variables(count)
    with refused(
        f"{call} must give a UFL expression. Use ufl.sqrt, ufl.exp, ... in place of functions of "
        "math or NumPy"
    ):
        expression = ufl.as_ufl(function(*variables))
    refuse_fields_in(expression, call, [*parameters_in(expression), *symbols_of(variables)])
    if expression.ufl_shape != ():
        raise SceneError(f"{call} must be a scalar, not of shape {expression.ufl_shape}")
    return expression, variables


def new_variables(count: int) -> list[Expr]:
    """Variables of symbols, which refuse to be numbers."""
    from .ufl_symbols import Symbol

    return [ufl.variable(Symbol()) for _ in range(count)]


def symbols_of(variables: Iterable[Expr]) -> list[Expr]:
    """The symbols of variables."""
    return [variable.ufl_operands[0] for variable in variables]


def value_of(function: Callable, values: Sequence[float], call: str) -> float | complex:
    """Value of a user's function for numbers; nan where it is not defined."""
    expression, variables = scalar_of(function, len(values), call)
    try:
        return expression((), dict(zip(symbols_of(variables), map(float, values), strict=True)))
    except (ArithmeticError, ValueError):
        return math.nan


def parameters_of(functions: Iterable[tuple[str, Expr]]) -> list[Parameter]:
    """Parameters in expressions of a user, each with its kind."""
    return parameters_in(*(expression for _, expression in functions))


def names_of(parameters: Iterable[Parameter]) -> list[str]:
    """Names of parameters, each once, in alphabetical order."""
    return sorted({parameter.name for parameter in parameters})


def replaced(expression: Expr, values: Mapping[str, Expr | float]) -> Expr:
    """The expression with values in the place of parameters, by their names."""
    parameters = parameters_in(expression)
    if not parameters:
        return expression
    return ufl.replace(expression, {part: values[part.name] for part in parameters})


class Parameters(Mapping):
    """The parameters of a scene by name, and their values: numbers, functions of time or inputs.

    A value is changed by ``scene.parameters[name] = value``, for the analyses that begin after it.
    The next step of a `Motion` that has begun ends with an error.
    """

    def __init__(self) -> None:
        #: Values as functions of time (1,).
        self.functions: dict[str, Signal] = {}
        self._given: dict[str, TimeValue] = {}
        # First values: parameters with one name must begin with one value.
        self._first: dict[str, TimeValue] = {}
        #: How often a value was changed.
        self.changes = 0

    def __getitem__(self, name: str) -> TimeValue:
        return self._given[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._given)

    def __len__(self) -> int:
        return len(self._given)

    def __repr__(self) -> str:
        return f"<Parameters: {self}>"

    def __str__(self) -> str:
        return ", ".join(f"{name} = {_shown(value)}" for name, value in self.items())

    def __setitem__(self, name: str, value: TimeValue) -> None:
        if name not in self:
            raise SceneError(
                f"the scene has no parameter {shown(name)}; it has {list(self)}. What is added to "
                "a scene brings the parameters of its functions along"
            )
        self.functions[name] = checked_value(name, value)
        self._given[name] = value
        self.changes += 1

    def add(self, functions: Iterable[tuple[str, Expr]], owner: str) -> None:
        """Add the parameters of a part's functions; SceneError for a name with two values."""
        if not (functions := [*functions]):
            return
        first = dict(self._first)
        ordered = sorted(parameters_of(functions), key=lambda parameter: parameter.count())
        for parameter in ordered:
            other = first.setdefault(parameter.name, parameter.given)
            if not _same(parameter.given, other):
                raise SceneError(
                    f"{owner}: the parameter {parameter.name!r} = {_shown(parameter.given)} is "
                    f"{_shown(other)} elsewhere in the scene. Use one Parameter for both, or two "
                    "names"
                )
        self._first = first
        for parameter in ordered:
            if parameter.name not in self:
                self._given[parameter.name] = parameter.given
                self.functions[parameter.name] = parameter.function

    def forget(self, name: str) -> None:
        """Remove a parameter."""
        for values in (self._given, self._first, self.functions):
            values.pop(name, None)

    def replaced(self, function_of: Callable[[Signal], Signal]) -> Parameters:
        """Parameters like these with other functions of time."""
        new = copy.copy(self)
        new.functions = {name: function_of(function) for name, function in self.functions.items()}
        return new


def _same(a: TimeValue, b: TimeValue) -> bool:
    if is_number(a) and is_number(b):
        return as_float(a) == as_float(b)
    return a is b or (isinstance(a, Input) and a == b)


def _shown(value: TimeValue) -> str:
    if isinstance(value, Input):
        return str(value)
    return "a function of time" if callable(value) else f"{floats(dual_array(value)).item():g}"
