"""Symbols in functions of a user, in UFL: those of a step, and parameters, which are numbers."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any

import ufl
from ufl.core.expr import Expr
from ufl.domain import AbstractDomain

from fx_beam.errors import (
    SceneError,
    TimeFunction,
    as_float,
    fields_in,
    is_name,
    is_number,
    refuse_fields,
    require,
    shown,
)

from .inputs import Input, time_function


class _Nowhere(AbstractDomain):
    """A domain that is no mesh, as UFL wants one for each symbol, with what its versions ask."""

    def __init__(self) -> None:
        super().__init__(1, 2)

    @property
    def meshes(self) -> tuple[AbstractDomain]:
        """It is its only part."""
        return (self,)

    def ufl_cell(self) -> Any:
        """An interval."""
        return ufl.interval

    def ufl_id(self) -> int:
        """No number of a mesh."""
        return -1

    def _ufl_sort_key_(self) -> tuple[int, str, int]:
        return 1, "nowhere", -1


#: Domain of symbols that belong to no mesh; in forms others are in their place.
NOWHERE = _Nowhere()


@contextmanager
def symbols_only(refusal: str = "") -> Iterator[None]:
    """A block that calls a function of a user; in it a symbol refuses to be a number.

    UFL would try it over and over, with a warning each time, and never end. SceneError with the
    refusal, if there is one, for a function that fails.
    """

    def refuse(self):
        raise TypeError("a UFL symbol is not a number. Use ufl.exp, not math.exp")

    usual = Expr.__float__
    Expr.__float__ = refuse  # numbers of UFL have their own
    try:
        yield
    except Exception as error:
        if not refusal:
            raise
        raise SceneError(f"{refusal}. It raised {error!r}") from error
    finally:
        Expr.__float__ = usual


def expression_of(function: Callable, arguments: Sequence, call: str) -> Any:
    """The UFL expression that a user's function gives; SceneError, named by the call, for none."""
    with symbols_only(
        f"{call} must give a UFL expression. Use ufl.sqrt, ufl.exp, ... in place of functions of "
        "math or NumPy"
    ):
        return ufl.as_ufl(function(*arguments))


# Fields of a step, by their shapes.
_VECTORS = "u0 Du u v virtual_u X t0 u_before director0 director1 director".split()
_STRAINS = """strains0 strains1 strain_increments strains_before
    total_strains0 total_strains1 natural0 natural1 natural_increments""".split()
_SCALARS = "psi0 Dpsi psi omega virtual_psi h t dt load_factor psi_before memory".split()


class Symbol(ufl.Constant):
    """A symbol that varies along a beam, so that UFL keeps its derivatives."""

    def __init__(self, *shape: int):
        super().__init__(NOWHERE, shape=shape)

    def is_cellwise_constant(self) -> bool:
        """It is not."""
        return False


class StepSymbols:
    """An `fx_beam.Step` whose fields are symbols of the same shape, on no mesh."""

    degree, nodes = 1, None

    def __init__(self) -> None:
        self.__dict__ |= {name: Symbol(2) for name in _VECTORS}
        self.__dict__ |= {name: Symbol() for name in _SCALARS}
        self.__dict__ |= {name: (Symbol(), Symbol(), Symbol()) for name in _STRAINS}

    def prime(self, field: Any) -> Any:
        """Derivative along the reference arc length."""
        return ufl.dot(ufl.grad(field), self.__dict__["t0"])


#: The symbols, made once: they are the same for all functions, so that these can be compared.
STEP: Any = StepSymbols()
SCALARS = tuple(Symbol() for _ in range(8))


# UFL knows constants by their numbers: those of a name have one, whatever the value.
_NUMBERS: dict[str, int] = {}


class Parameter(ufl.Constant):
    """A named number in a function of your own, in UFL, which changes without compilation.

    Numbers that such a function has otherwise are compiled in, and each new one takes a second or
    two. A parameter may stand in the strain energy of a `Section` or `Spring`, in the update of
    `InternalVariables`, in the law of a `Damper`, of `SmoothFriction` or of an obstacle, in a force
    between points and in a virtual work. `Scene.parameters` has those of a scene by name, and
    changes them.

    Parameters
    ----------
    name : str
        Name of the parameter p; in a scene a name has one value.
    value : float, callable or Input
        Value at the beginning: a number; a function ``value(t)`` of time [s], which may also look
        the value up in a table; or an `Input` of one number.

    Raises
    ------
    SceneError
        For an empty name, or a value that is neither a number, nor a function of time, nor an
        `Input`.

    Notes
    -----
    A stored energy W(strains, p) that changes with p(t) takes work from what changes p. In a step
    from t0 to t1 the forces are those of p in its middle, p_m, and

        W(E1, p(t1)) - W(E1, p_m) + W(E0, p_m) - W(E0, p(t0))

    is added to `Energy.work`, so that the balance of energy stays exact.

    Examples
    --------
    A beam with a stored energy of its own, of which the stiffness is varied. Only the first run
    compiles anything.

    >>> import fx_beam as fb
    >>> k = fb.Parameter("stiffness", 1e4)
    >>> section = fb.Section(strain_energy=lambda e, g, c: k / 2 * (e**2 + g**2 + c**2 / 100))
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (1, 0)], section, elements=4)
    >>> scene.clamp(beam.start)
    >>> load = scene.add_force(beam.end, (1.0, 0.0))
    >>> round(float(fb.static(scene).displacement(beam.end)[-1, 0]), 6)
    0.0001
    >>> scene.parameters["stiffness"] = 2e4
    >>> round(float(fb.static(scene).displacement(beam.end)[-1, 0]), 6)
    5e-05

    A muscle whose force is an input:

    >>> u = fb.Parameter("activation", fb.Input("muscle"))
    >>> pull = scene.add_force_between(beam.end, (1, 1), force=lambda r, rate, t: 3 * u * r)
    >>> list(scene.parameters)
    ['stiffness', 'activation']
    """

    def __init__(self, name: str, value: float | Any):
        require(is_name(name), "Parameter: name", name, "a text that is not empty")
        #: What was given as the value.
        self.given = value
        #: The value as a function of time.
        self.function = checked_value(name, value)
        self.name = name
        super().__init__(NOWHERE, count=_NUMBERS.get(name))
        _NUMBERS[name] = self.count()
        self._repr = f"Parameter({name!r}, {shown(value)})"

    def __str__(self):
        return self.name

    def __reduce__(self):
        return Parameter, (self.name, self.given)

    def _ufl_compute_hash_(self):
        return hash(self.name)  # as for UFL parameters of one name are equal

    def __float__(self):
        raise TypeError(
            f"the parameter {self.name!r} is a UFL symbol, not a number: use ufl.sqrt, ufl.exp, ..."
        )

    def evaluate(self, x, mapping, component, index_values, derivatives=()):
        """The value by name in a mapping, or else at the beginning; UFL calls it."""
        if derivatives:
            return 0.0
        return float(mapping[self] if mapping and self in mapping else self.function(0.0)[0])


def checked_value(name: str, value: float | Any) -> TimeFunction:
    """A value of a parameter as a function of time (1,)."""
    if isinstance(value, ufl.core.expr.Expr):
        raise SceneError(f"parameter {name!r}: its value is {shown(value)}, not a number")
    return time_function(value, 1, f"parameter {name!r}")


def parameters_in(*expressions: Any) -> list[Parameter]:
    """All parameters in UFL expressions, also several of one name."""
    parameters: list[Parameter] = []
    left, seen = [ufl.as_ufl(expression) for expression in expressions], set()
    while left:
        part = left.pop()
        if id(part) in seen:
            continue
        seen.add(id(part))
        if isinstance(part, Parameter):
            parameters.append(part)
        left += part.ufl_operands
    return parameters


def scalar_of(function: Callable, values: Sequence[float], call: str) -> tuple[Any, list[Any]]:
    """The expression that a user's function gives, and the variables at these values in it.

    SceneError if it is no scalar UFL expression, or has other symbols than parameters.
    """
    variables = [ufl.variable(ufl.as_ufl(value)) for value in values]
    expression = expression_of(function, variables, call)
    refuse_fields(fields_in(expression), call, parameters_in(expression))
    if expression.ufl_shape != ():
        raise SceneError(f"{call} must be a scalar, not of shape {expression.ufl_shape}")
    return expression, variables


def value_of(function: Callable, values: Sequence[float], call: str) -> Any:
    """What a user's function gives for numbers; nan where it is not defined."""
    expression, _ = scalar_of(function, values, call)
    try:
        return expression(())
    except (ArithmeticError, ValueError):
        return math.nan


def parameters_of(functions: Iterable[tuple[str, Any]]) -> list[Parameter]:
    """Parameters in expressions of a user, each with its kind."""
    return parameters_in(*(expression for _, expression in functions))


def names_of(parameters: Iterable[Parameter]) -> list[str]:
    """Their names, each once, in alphabetical order."""
    return sorted({parameter.name for parameter in parameters})


def replaced(expression: Any, by_name: Mapping[str, Any]) -> Any:
    """The expression with others in the place of its parameters."""
    parameters = parameters_in(expression)
    if not parameters:
        return expression
    return ufl.replace(expression, {part: by_name[part.name] for part in parameters})


class Parameters(Mapping):
    """The parameters of a scene by name, and their values: numbers, functions of time or inputs.

    A value is changed by ``scene.parameters[name] = value``, for the analyses that begin after it.
    """

    def __init__(self) -> None:
        #: Values as functions of time (1,).
        self.functions: dict[str, TimeFunction] = {}
        self._given: dict[str, Any] = {}
        # Values at the beginning, of which those with the same name must be the same.
        self._first: dict[str, Any] = {}

    def __getitem__(self, name: str) -> Any:
        return self._given[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._given)

    def __len__(self) -> int:
        return len(self._given)

    def __repr__(self) -> str:
        return f"<Parameters: {self}>"

    def __str__(self) -> str:
        return ", ".join(f"{name} = {_shown(value)}" for name, value in self.items())

    def __setitem__(self, name: str, value: Any) -> None:
        if name not in self:
            raise SceneError(
                f"the scene has no parameter {shown(name)}; it has {list(self)}. What is added to "
                "a scene brings the parameters of its functions along"
            )
        self.functions[name] = checked_value(name, value)
        self._given[name] = value

    def add(self, functions: Iterable[tuple[str, Any]], what: str) -> None:
        """Add the parameters of a part's functions; SceneError for a name with two values."""
        first = dict(self._first)
        ordered = sorted(parameters_of(functions), key=lambda parameter: parameter.count())
        for parameter in ordered:
            other = first.setdefault(parameter.name, parameter.given)
            if not _same(parameter.given, other):
                raise SceneError(
                    f"{what}: the parameter {parameter.name!r} = {_shown(parameter.given)} is "
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

    def replaced(self, function_of: Callable[[TimeFunction], TimeFunction]) -> Parameters:
        """The same parameters with other functions of time."""
        new = copy.copy(self)
        new.functions = {name: function_of(of) for name, of in self.functions.items()}
        return new


def _same(a: Any, b: Any) -> bool:
    if is_number(a) and is_number(b):
        return as_float(a) == as_float(b)
    return a is b or (isinstance(a, Input) and a == b)


def _shown(value: Any) -> str:
    if isinstance(value, Input):
        return str(value)
    return "a function of time" if callable(value) else f"{float(value):g}"
