"""Laws of forces at points, of lines and nodal rules, compiled."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from fx_beam.c_library import compiled
from fx_beam.errors import SceneError
from fx_beam.laws.point_laws import TINY, ForceStep, LawForces, PointLaw, StepRule, arguments
from fx_beam.laws.rates import NodalRates
from fx_beam.scene.parameters import names_of, parameters_in, replaced
from fx_beam.symbolic import Expr, Written, derivatives_taken, is_zero, ufl

from .compiled_forms import CompiledForm, form_module, tabulated

# -- Laws of forces at points and nodal rules, compiled: their functions, and entries of tangents


#: The library that evaluates all forces at points: its title, file and header.
LIBRARY = "forces at points", "point_forces.h", "point_force.h"

# Functions of a law besides its forces.
_OTHERS = "energy", "loss", "switches", "pull"

# A UFL vector of UFL numbers.
Values = Callable[[Expr], Expr]


def _shared(expression: Expr, variables: bool = True) -> Expr:
    """The expression with equal parts as one object, with or without variables of derivatives.

    UFL compares equal objects part by part, whose number without sharing grows exponentially.
    """
    shared: dict[int, Expr] = {}
    shared_parts: dict[Expr, Expr] = {}
    reuse = ufl.corealg.multifunction.MultiFunction().reuse_if_untouched
    left = [expression]
    while left:
        part = left[-1]
        if id(part) in shared:
            left.pop()
        elif missing := [operand for operand in part.ufl_operands if id(operand) not in shared]:
            left += missing
        else:
            left.pop()
            parts = [shared[id(operand)] for operand in part.ufl_operands]
            if not variables and isinstance(part, ufl.classes.Variable):
                shared[id(part)] = parts[0]
                continue
            key = (type(part), *map(id, parts)) if parts else part
            if key not in shared_parts:
                shared_parts[key] = reuse(part, *parts)
            shared[id(part)] = shared_parts[key]
    return shared[id(expression)]


class PointFunction:
    """A UFL vector of some numbers as a C function."""

    def __init__(self, compiled: CompiledForm):
        #: Number of its values, and address of the function.
        self.size, (self.address,) = compiled.values, compiled.addresses
        self._compiled = compiled  # as long as it is there, so is its library

    def in_rows(self, numbers: np.ndarray) -> np.ndarray:
        """Values (k, size) of numbers (k, arguments)."""
        none = np.empty((len(numbers), 1, 0))
        return tabulated(self.address, none, numbers, none[0], self.size)[:, 0]


def _numbers(count: int) -> Expr:
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


def point_function(name: str, values: Values, arguments: int, key: object = None) -> PointFunction:
    """A UFL vector of `arguments` numbers as a C function.

    It has a key if no function of a user is in it.
    """
    module = form_module(key, lambda: _written({name: values}, arguments))
    return PointFunction(module.forms[name])


class CompiledLaw:
    """The functions of a law in the steps of a rule, for C."""

    def __init__(self, law: PointLaw, rule: StepRule):
        self.law, self._rule = law, rule
        #: Names of the parameters in its functions, whose values are given behind all else.
        self.parameters: list[str] = []
        module = form_module(None if law.user_defined else (*law.key, *rule), self._written)
        facts, functions = module.facts, map(PointFunction, module.forms.values())
        self._functions = dict(zip(["forces", *facts["others"]], functions, strict=True))
        self._derivatives: dict[str, PointFunction] = {}
        #: Rows and columns (n, 2) of the entries of the tangent that may be other than zero.
        self.entries = np.array(facts["entries"], dtype=np.int32).reshape(-1, 2)
        #: Number of values that change their sign where the force switches.
        self.conditions: int = facts["conditions"]
        #: Number of forces, entries of the tangent, internal variables and what is remembered.
        self.size = law.size + len(self.entries) + law.internal + law.iteration_memory
        #: Number of values that its functions are given.
        self.input_count = arguments(law) + len(self.parameters)

    def address(self, quantity: str) -> int:
        """Address of the function of the "forces" or of one of `_OTHERS`; 0 for none."""
        return self._functions[quantity].address if quantity in self._functions else 0

    @property
    def members(self) -> dict[str, object]:
        """Members of it that structs in C have."""
        (row, column), law = self.entries.T, self.law
        return {
            "law": self.address("forces"),
            **{name: self.address(name) for name in ("energy", "loss")},
            **{"internal": law.internal, "iteration_memory": law.iteration_memory},
            **{"entries": len(self.entries), "entry_row": row, "entry_column": column},
        }

    @property
    def slopes_address(self) -> int:
        """Address of the derivatives of its forces and internal variables."""
        return self.derivative("forces").address

    @property
    def slopes_size(self) -> int:
        """Number of the derivatives of its forces and internal variables."""
        return self.derivative("forces").size

    def check_at_zero(self, parameters: np.ndarray) -> None:
        """Refuse a law that is not finite at zero, with values of its `parameters` (n,)."""
        inputs = np.zeros((1, self.input_count))
        inputs[0, 3 * self.law.size + 1] = 1.0  # the length of the step
        inputs[0, arguments(self.law) :] = parameters
        if self.law.zero_advice and not np.isfinite(self.values("forces", inputs)).all():
            raise SceneError(self.law.zero_advice)

    def values(self, quantity: str, inputs: np.ndarray) -> np.ndarray:
        """Values (k, m) of a function for inputs (k, n)."""
        return self._functions[quantity].in_rows(inputs)

    def slopes(self, quantity: str, inputs: np.ndarray) -> np.ndarray:
        """Derivatives (k, n) of one of `_OTHERS` by inputs (k, n)."""
        return self.derivative(quantity).in_rows(inputs)

    def derivative(self, quantity: str) -> PointFunction:
        """Derivatives of one of its functions, as `derivative_of` gives them."""
        if quantity not in self._derivatives:
            names = tuple(self.parameters)
            self._derivatives[quantity] = derivative_of(self.law, self._rule, quantity, names)
        return self._derivatives[quantity]

    def _written(self) -> Written:
        """Functions of the law in UFL."""
        law, rule = self.law, self._rule
        motion, entries = ForceStep(_numbers(arguments(law)), law, rule), list[tuple[int, int]]()
        conditions = len(_parts(law, "switches", motion)) if law.switches else 0
        others = [name for name in _OTHERS if getattr(law, name)]
        if law.switches and not conditions:
            others.remove("switches")
        if law.user_defined:
            parts = (part for name in ("forces", *others) for part in _parts(law, name, motion))
            self.parameters = names_of(parameters_in(*parts))

        def forces(inputs: Expr) -> Expr:
            motion = ForceStep(inputs, law, rule)
            step, tangent = law.forces(motion), []
            for i, force in enumerate(step.forces):
                for k, D in enumerate(motion.increment):
                    if not is_zero(slope := derivatives_taken(ufl.diff(force, D))):
                        tangent.append(slope)
                        entries.append((i, k))
            return [*step.forces, *tangent, *step.internal, *step.iteration_memory]

        def other(name: str, inputs: Expr) -> Expr:
            return _parts(law, name, ForceStep(inputs, law, rule))

        lists = {law.name: forces}
        lists |= {f"{name} of {law.name}": functools.partial(other, name) for name in others}

        def vector(parts: Callable[[Expr], list], inputs: Expr) -> Expr:
            return ufl.as_vector(_with_inputs(parts(inputs), law, self.parameters, inputs))

        vectors = {name: functools.partial(vector, parts) for name, parts in lists.items()}
        written = _written(vectors, arguments(law) + len(self.parameters))
        # Without the names of parameters, in which laws may differ that have the same code.
        facts = {"others": others, "entries": entries, "conditions": conditions}
        return written._replace(facts=facts)


def _parts(law: PointLaw, quantity: str, motion: ForceStep) -> list:
    """Values of a function of a law in UFL; of the "forces" with internal variables behind."""
    value = getattr(law, quantity)(motion)
    if isinstance(value, LawForces):
        return [*value.forces, *value.internal]
    return value if isinstance(value, list) else [value]


def _with_inputs(parts: list, law: PointLaw, parameters: Sequence[str], inputs: Expr) -> list:
    """UFL numbers in which the last inputs take the place of parameters."""
    first = arguments(law)
    values = {name: inputs[first + i] for i, name in enumerate(parameters)}
    return [replaced(part, values) for part in parts]


def derivative_of(
    law: PointLaw, rule: StepRule, quantity: str, parameters: Sequence[str] = ()
) -> PointFunction:
    """Derivatives of the values of a function of a law, one value after the other, by all inputs.

    Those of the "forces" and internal variables are by the start, increments, internal variables,
    numbers and parameters alone, as C has them.
    """
    n, first = law.size, arguments(law)
    columns = [*range(count := first + len(parameters))]
    if quantity == "forces":
        internal = columns[3 * n + 2 :][: law.internal]
        columns = [*columns[: 2 * n], *internal, *columns[first - law.numbers :]]

    def values(symbols: Expr) -> Expr:
        inputs = ufl.variable(ufl.as_vector([symbols[i] for i in range(count)]))
        parts = _parts(law, quantity, ForceStep(inputs, law, rule))
        parts = _with_inputs(parts, law, parameters, inputs)
        rows = [ufl.diff(part, inputs) for part in parts]
        return ufl.as_vector([row[k] for row in rows for k in columns])

    name = f"derivatives of the {quantity} of {law.name}"
    key = None if law.user_defined else (*law.key, *rule, name)
    return point_function(name, values, count, key)


def compiled_laws(laws: Sequence[PointLaw], rule: StepRule) -> list[CompiledLaw]:
    """Laws as they are compiled, each once; without functions of a user they are kept."""
    compiled_laws_by_id: dict[int, CompiledLaw] = {}
    for law in laws:
        if id(law) not in compiled_laws_by_id:
            make = functools.partial(CompiledLaw, law, rule)
            key = CompiledLaw, law, rule
            compiled_laws_by_id[id(law)] = make() if law.user_defined else compiled(key, make)
    return [compiled_laws_by_id[id(law)] for law in laws]


def compiled_rule(rates: NodalRates, rule) -> PointFunction:
    """(D, v0, a0, previous, dt) -> acceleration, its slopes by D, rates, and their slopes by D."""

    def values(numbers):
        D, v0, a0, previous = (
            ufl.as_vector([numbers[3 * k + i] for i in range(3)]) for k in range(4)
        )
        D = ufl.variable(D)
        a, v1, a1 = rates.values(rule, D, v0, a0, previous, numbers[12])
        slopes = [ufl.diff(a[i], D) for i in range(3)]
        return ufl.as_vector([x[i] for x in (a, *slopes, v1, a1) for i in range(3)])

    return point_function("rule for the rates", values, 13)


# -- Laws of lines over points: compiled laws of their length, and their pieces (line_law.h) ----


class _Pieces(NamedTuple):
    """Vectors (k, pieces, 2) of a line in k rows: unit vectors, and slopes of the rate."""

    start: np.ndarray
    end: np.ndarray
    rate_slopes: np.ndarray
    #: Inputs (k, ...) of the law of the length.
    inputs: np.ndarray


class LineLaw:
    """The law of a line over points in the steps of a rule, as a `CompiledLaw` of all points."""

    def __init__(self, law: PointLaw, length: CompiledLaw, level: float):
        self.law, self._length, self._level = law, length, level
        self.parameters, self.conditions = length.parameters, length.conditions
        numbers = np.arange(law.size, dtype=np.int32)
        #: Rows and columns (n, 2) of the entries of the tangent: all.
        self.entries = np.stack(np.meshgrid(numbers, numbers, indexing="ij"), -1).reshape(-1, 2)
        self.size = law.size + len(self.entries) + law.internal + law.iteration_memory
        #: Number of values that its functions are given.
        self.input_count = arguments(law) + len(self.parameters)
        self.address, self.check_at_zero = length.address, length.check_at_zero
        # Where the coordinates of each point begin, -1 of those that are fixed.
        moves = np.array(law.moves)
        self._moves = np.where(moves, 2 * np.cumsum(moves) - 2, -1)

    @property
    def members(self) -> dict[str, object]:
        """Members of it that structs in C have."""
        (row, column), length = self.entries.T, self._length
        return {
            **length.members,
            "entries": len(row),
            "entry_row": row,
            "entry_column": column,
            "level": self._level,
            "pieces": len(self._moves) - 1,
            "moves": self._moves,
            "length_entries": len(length.entries),
            "others": length.law.numbers + len(self.parameters),
        }

    @property
    def slopes_address(self) -> int:
        """Address of the derivatives of the law of the length."""
        return self._length.slopes_address

    @property
    def slopes_size(self) -> int:
        """Number of the derivatives of all forces and internal variables."""
        law = self.law
        wide = 2 * law.size + law.internal + law.numbers + len(self.parameters)
        return (law.size + law.internal) * wide

    def values(self, quantity: str, inputs: np.ndarray) -> np.ndarray:
        """Values (k, m) of a function of the length for inputs (k, n)."""
        return self._length.values(quantity, self._pieces(inputs).inputs)

    def slopes(self, quantity: str, inputs: np.ndarray) -> np.ndarray:
        """Derivatives (k, n) of a function of the length by inputs (k, n)."""
        pieces = self._pieces(inputs)
        slopes = self._length.slopes(quantity, pieces.inputs)
        start, path, rate = (slopes[:, i, None, None] for i in range(3))
        start_slopes = (start - path) * pieces.start + path * pieces.end + rate * pieces.rate_slopes
        motion = start_slopes, path * pieces.end, rate * pieces.start
        end = 5 + self.law.internal + self.law.iteration_memory
        vectors = start_slopes.reshape(len(slopes), -1)
        middle, rest = slopes[:, 3:end], slopes[:, end:]
        return np.hstack([*map(self._point_slopes, motion), middle, vectors, rest])

    def _pieces(self, inputs: np.ndarray) -> _Pieces:
        """The pieces for inputs (k, n)."""
        n, last = self.law.size, arguments(self.law)
        count, first = len(self._moves) - 1, last - self.law.numbers
        start, D, rates = (self._vectors(inputs[:, i * n : (i + 1) * n]) for i in range(3))
        start += inputs[:, first : first + 2 * count].reshape(-1, count, 2)
        vectors = np.stack([start, start + D])
        sizes = np.sqrt(np.sum(vectors * vectors, axis=3) + TINY)
        units = vectors / sizes[..., None]
        rate = np.sum(units[0] * rates, axis=2)
        rate_slopes = (rates - units[0] * rate[..., None]) / sizes[0][..., None]
        lengths = [sizes[0], sizes[1] - sizes[0], rate]
        sums = np.stack([values.sum(axis=1) for values in lengths], axis=1)
        rest = [inputs[:, 3 * n : first], inputs[:, first + 2 * count :]]
        return _Pieces(units[0], units[1], rate_slopes, np.hstack([sums, *rest]))

    def _vectors(self, values: np.ndarray) -> np.ndarray:
        """Vectors (k, pieces, 2) between points, of coordinates (k, n)."""
        columns = self._moves[:, None] + np.arange(2)
        return np.diff(np.where(self._moves[:, None] < 0, 0.0, values[:, columns]), axis=1)

    def _point_slopes(self, piece_slopes: np.ndarray) -> np.ndarray:
        """Derivatives (k, n) by the coordinates from those (k, pieces, 2) by the pieces."""
        none = np.zeros_like(piece_slopes[:, :1])
        slopes = -np.diff(np.concatenate([none, piece_slopes, none], axis=1), axis=1)
        return slopes[:, self._moves >= 0].reshape(len(piece_slopes), -1)


def laws_of_forces(laws: Sequence[PointLaw], rule: StepRule) -> list[CompiledLaw | LineLaw]:
    """Compiled laws of forces at points, also of lines over points."""
    compiled = compiled_laws([law.length_law or law for law in laws], rule)
    return [
        LineLaw(law, compiled_law, rule.level) if law.length_law else compiled_law
        for law, compiled_law in zip(laws, compiled, strict=True)
    ]
