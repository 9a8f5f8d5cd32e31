"""Laws of forces at points and nodal rules, compiled: their functions, and entries of tangents."""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from fx_beam.c_library import compiled
from fx_beam.content_cache import cached_property
from fx_beam.errors import SceneError
from fx_beam.laws.point_laws import ForceStep, PointLaw, StepRule, arguments
from fx_beam.laws.rates import NodalRates
from fx_beam.scene.parameters import names_of, parameters_in, replaced
from fx_beam.symbolic import Written, derivatives_taken, is_zero, ufl

from .assembly import tabulated
from .form_library import CompiledForm, form_module

T = TypeVar("T")

#: The library that evaluates all forces at points: its title, file and header.
LIBRARY = "forces at points", "point_forces.h", "point_force.h"

# Tensor, coefficients, constants, coordinates; the others have no meaning here. Later versions of
# FFCx have one more, which C ignores where there is none.
_FUNCTION = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 7)

# Functions of a law besides its forces.
_OTHERS = "energy", "loss", "switches", "pull"

# A UFL vector of UFL numbers.
Values = Callable[[Any], Any]


def _shared(expression: Any, variables: bool = True) -> Any:
    """The expression with equal parts as one object, with or without variables of derivatives.

    UFL compares equal objects part by part, whose number without sharing grows exponentially.
    """
    known: dict[int, Any] = {}
    by_parts: dict[Any, Any] = {}
    reuse = ufl.corealg.multifunction.MultiFunction().reuse_if_untouched
    left = [expression]
    while left:
        part = left[-1]
        if id(part) in known:
            left.pop()
        elif missing := [operand for operand in part.ufl_operands if id(operand) not in known]:
            left += missing
        else:
            left.pop()
            parts = [known[id(operand)] for operand in part.ufl_operands]
            if not variables and isinstance(part, ufl.classes.Variable):
                known[id(part)] = parts[0]
                continue
            key = (type(part), *map(id, parts)) if parts else part
            if key not in by_parts:
                by_parts[key] = reuse(part, *parts)
            known[id(part)] = by_parts[key]
    return known[id(expression)]


class PointFunction:
    """A UFL vector of some numbers as a C function."""

    def __init__(self, compiled: CompiledForm):
        #: Number of its values, and address of the function.
        self.size, (self.address,) = compiled.values, compiled.addresses
        self._compiled = compiled  # as long as it is there, so is its library
        self._function = _FUNCTION(self.address)

    def __call__(self, numbers: np.ndarray) -> np.ndarray:
        """Values (size,) of numbers (arguments,)."""
        out = np.zeros(self.size)
        self._function(out.ctypes.data, None, numbers.ctypes.data, None, None, None, None)
        return out

    def in_rows(self, numbers: np.ndarray) -> np.ndarray:
        """Values (k, size) of numbers (k, arguments)."""
        none = np.empty((len(numbers), 1, 0))
        return tabulated(self.address, none, numbers, none[0], self.size)[:, 0]


def _numbers(count: int) -> Any:
    """UFL's symbol for so many numbers."""
    from . import elements

    return ufl.Constant(elements.domain(1), shape=(count,))


def _written(values: Mapping[str, Values], arguments: int) -> Written:
    """UFL vectors of `arguments` numbers by name, which are used together."""
    numbers = _numbers(arguments)
    expand = ufl.algorithms.expand_derivatives
    # Without the variables of derivatives: later versions of UFL tell them apart by numbers of
    # the process, and would compile the same function again.
    expressions = {
        name: (_shared(expand(_shared(function(numbers))), variables=False), np.array([[0.5]]))
        for name, function in values.items()
    }
    return Written(expressions, {numbers: "numbers"})


def point_function(name: str, values: Values, arguments: int, key: Any = None) -> PointFunction:
    """A UFL vector of `arguments` numbers as a C function.

    It has a key if no function of a user is in it.
    """
    module = form_module(key, lambda: _written({name: values}, arguments))
    return PointFunction(module.forms[name])


OfForceStep = Callable[[ForceStep], list]


class CompiledLaw:
    """The functions of a law in the steps of a rule, for C."""

    def __init__(self, law: PointLaw, rule: StepRule):
        self.law, self._rule = law, rule
        self._key = None if law.user_defined else (*law.key, *rule)
        #: Names of the parameters in its functions, whose values are given behind all else.
        self.parameters: list[str] = []
        module = form_module(self._key, self._written)
        facts, functions = module.facts, map(PointFunction, module.forms.values())
        self._functions = dict(zip(["law", *facts["others"]], functions, strict=True))
        #: Rows and columns (n, 2) of the entries of the tangent that may be other than zero.
        self.entries = np.array(facts["entries"], dtype=np.int32).reshape(-1, 2)
        #: Number of values that change their sign where the force switches.
        self.conditions: int = facts["conditions"]
        self._derivatives: dict[str, PointFunction] = {}
        #: Number of forces, entries of the tangent, internal variables and what is remembered.
        self.values = law.size + len(self.entries) + law.internal + law.iteration_memory

    def function(self, name: str) -> PointFunction:
        """One of `_OTHERS` that the law has."""
        return self._functions[name]

    def address(self, name: str) -> int:
        """Address of a function: of the "law" or one of `_OTHERS`; 0 for none."""
        return self._functions[name].address if name in self._functions else 0

    @property
    def members(self) -> dict[str, Any]:
        """Members of it that structs in C have."""
        (row, column), law = self.entries.T, self.law
        return {
            **{name: self.address(name) for name in ("law", "energy", "loss")},
            **{"internal": law.internal, "iteration_memory": law.iteration_memory},
            **{"entries": len(self.entries), "entry_row": row, "entry_column": column},
        }

    @property
    def slopes_address(self) -> int:
        """Address of its `slopes`."""
        return self.slopes.address

    @property
    def slopes_size(self) -> int:
        """Number of its `slopes`."""
        return self.slopes.size

    def check_at_zero(self, parameters: np.ndarray) -> None:
        """Refuse a law that is not finite at zero, with values of its `parameters` (n,)."""
        inputs = np.zeros(self.given)
        inputs[3 * self.law.size + 1] = 1.0  # the length of the step
        inputs[arguments(self.law) :] = parameters
        if self.law.zero_advice and not np.isfinite(self._functions["law"](inputs)).all():
            raise SceneError(self.law.zero_advice)

    @property
    def given(self) -> int:
        """Number of values that its functions are given."""
        return arguments(self.law) + len(self.parameters)

    @cached_property
    def slopes(self) -> PointFunction:
        """Derivatives of its forces and internal variables (`slopes_of`)."""
        return slopes_of(self.law, self._rule, tuple(self.parameters))

    def derivatives(self, quantity: str) -> PointFunction:
        """Derivatives of one of its functions, such as the "energy", by all given."""
        if quantity not in self._derivatives:
            value = self._function(_listed(getattr(self.law, quantity)))

            def values(numbers: Any) -> Any:
                inputs = ufl.variable(ufl.as_vector([numbers[i] for i in range(self.given)]))
                return ufl.diff(value(inputs)[0], inputs)

            name = f"derivatives of the {quantity} of {self.law.name}"
            key = self._key and (*self._key, name)
            self._derivatives[quantity] = point_function(name, values, self.given, key)
        return self._derivatives[quantity]

    def _written(self) -> Written:
        """Its functions in UFL."""
        law = self.law
        inputs = _numbers(arguments(law))
        motion = ForceStep(inputs, law, self._rule)
        functions = {name: getattr(law, name) for name in _OTHERS}
        listed = {name: _listed(f) for name, f in functions.items() if f is not None}
        conditions = len(listed["switches"](motion)) if "switches" in listed else 0
        if not conditions:
            listed.pop("switches", None)
        if law.user_defined:
            of_step = law.forces(motion)
            parts = [part for f in listed.values() for part in f(motion)]
            self.parameters = names_of(parameters_in(*of_step.forces, *of_step.internal, *parts))
        named = {law.name: self._function(self._forces)}
        named |= {f"{name} of {law.name}": self._function(f) for name, f in listed.items()}
        written = _written(named, self.given)
        # Without the names of parameters, in which laws may differ that have the same code.
        facts = {"others": [*listed], "entries": self._entries, "conditions": conditions}
        return written._replace(facts=facts)

    def _function(self, values: OfForceStep) -> Callable[[Any], Any]:
        """The values as a vector of what the law is given."""
        first = arguments(self.law)

        def of(inputs: Any) -> Any:
            by_name = {parameter: inputs[first + i] for i, parameter in enumerate(self.parameters)}
            motion = ForceStep(inputs, self.law, self._rule)
            return replaced(ufl.as_vector(values(motion)), by_name)

        return of

    def _forces(self, motion: ForceStep) -> list:
        """Forces, entries of their tangent, internal variables and what is remembered."""
        result = self.law.forces(motion)
        entries = [
            (i, k, derivative)
            for i, force in enumerate(result.forces)
            for k, D in enumerate(motion.increment)
            if not is_zero(derivative := derivatives_taken(ufl.diff(force, D)))
        ]
        self._entries = [entry[:2] for entry in entries]
        return [
            *result.forces,
            *(entry[2] for entry in entries),
            *result.internal,
            *result.iteration_memory,
        ]


def _listed(function: Callable[[ForceStep], Any]) -> OfForceStep:
    """A function that gives one value or several, always as a list."""

    def values(motion: ForceStep) -> list:
        value = function(motion)
        return value if isinstance(value, list) else [value]

    return values


def _of_law(make: Callable[..., T], law: PointLaw, *extra: Any) -> T:
    """What is made of a law and of more: once, unless the law has functions of a user."""
    if law.user_defined:
        return make(law, *extra)
    return compiled((make, law, *extra), lambda: make(law, *extra))


def slopes_of(law: PointLaw, rule: StepRule, parameters: tuple[str, ...] = ()) -> PointFunction:
    """Derivatives of the forces and internal variables of a law, one after the other.

    They are by the values at the start, the increments, internal variables, numbers and parameters.
    """
    return _of_law(_slopes, law, rule, parameters)


def _slopes(law: PointLaw, rule: StepRule, parameters: tuple[str, ...]) -> PointFunction:
    n, first = law.size, arguments(law)
    count, first_internal = first + len(parameters), 3 * n + 2
    columns = [
        *range(2 * n),
        *range(first_internal, first_internal + law.internal),
        *range(first - law.numbers, count),
    ]

    def values(symbols: Any) -> Any:
        inputs = ufl.variable(ufl.as_vector([symbols[i] for i in range(count)]))
        by_name = {parameter: inputs[first + i] for i, parameter in enumerate(parameters)}
        of_step = law.forces(ForceStep(inputs, law, rule))
        quantities = [replaced(part, by_name) for part in (*of_step.forces, *of_step.internal)]
        rows = [ufl.diff(part, inputs) for part in quantities]
        return ufl.as_vector([row[k] for row in rows for k in columns])

    name = f"slopes of {law.name}"
    key = None if law.user_defined else (*law.key, *rule, name)
    return point_function(name, values, count, key)


def compiled_laws(laws: Sequence[PointLaw], rule: StepRule) -> list[CompiledLaw]:
    """Laws as they are compiled, each once; without functions of a user they are kept."""
    distinct = {id(law): law for law in laws}
    by_law = {key: _of_law(CompiledLaw, law, rule) for key, law in distinct.items()}
    return [by_law[id(law)] for law in laws]


def compiled_rule(rates: NodalRates, rule) -> PointFunction:
    """(D, v0, a0, before, dt) -> acceleration, its slopes by D, rates, and their slopes by D."""

    def values(numbers):
        D, v0, a0, before = (
            ufl.as_vector([numbers[3 * k + i] for i in range(3)]) for k in range(4)
        )
        D = ufl.variable(D)
        a, v1, a1 = rates.values(rule, D, v0, a0, before, numbers[12])
        slopes = [ufl.diff(a[i], D) for i in range(3)]
        return ufl.as_vector([x[i] for x in (a, *slopes, v1, a1) for i in range(3)])

    return point_function("rule for the rates", values, 13)
