"""Laws of forces at points, compiled: their functions, and the entries of their tangents."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import ufl
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.constantvalue import Zero

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.mechanics.point_laws import Motion, PointLaw, StepRule, arguments

from .point_functions import PointFunction


class CompiledLaw:
    """The functions of a law in the steps of a rule, for C."""

    def __init__(self, law: PointLaw, rule: StepRule):
        self.law, self._rule = law, rule
        #: Rows and columns (n, 2) of the entries of the tangent that may be other than zero.
        self.entries = np.empty((0, 2), dtype=np.int32)
        #: Number of values that change their sign where the force switches.
        self.conditions = 0
        self._functions = {"law": self._function(law.name, self._forces)}
        for name in ("energy", "loss", "switches"):
            if (function := getattr(law, name)) is not None:
                self._add(name, function)
        #: Number of forces, entries of the tangent, internal variables and what is remembered.
        self.values = law.size + len(self.entries) + law.internal + law.remembered
        if law.at_zero:
            self._check()

    def address(self, name: str) -> int:
        """Address of a function: of the "law", its "energy", "loss" or "switches"; 0 for none."""
        return self._functions[name].address if name in self._functions else 0

    def __call__(self, given: np.ndarray) -> np.ndarray:
        """Forces, entries of their tangent, and the rest, of what is given (arguments,)."""
        return self._functions["law"](given)

    def _add(self, name: str, function: Callable[[Motion], Any]) -> None:
        def values(motion: Motion) -> list:
            value = function(motion)
            return value if isinstance(value, list) else [value]

        if name == "switches":
            self.conditions = len(values(self._motion(ufl.as_vector([0.1] * arguments(self.law)))))
            if not self.conditions:
                return
        self._functions[name] = self._function(f"{name} of {self.law.name}", values)

    def _motion(self, given: Any) -> Motion:
        return Motion(given, self.law, self._rule)

    def _function(self, name: str, values: Callable[[Motion], list]) -> PointFunction:
        count = arguments(self.law)
        return PointFunction(lambda given: ufl.as_vector(values(self._motion(given))), count, name)

    def _forces(self, motion: Motion) -> list:
        """Forces, entries of their tangent, internal variables and what is remembered."""
        result = self.law.forces(motion)
        entries = [
            (i, k, derivative)
            for i, force in enumerate(result.forces)
            for k, D in enumerate(motion.increment)
            if not isinstance(derivative := _derivative(force, D), Zero)
        ]
        self.entries = np.array([entry[:2] for entry in entries], dtype=np.int32).reshape(-1, 2)
        return [
            *result.forces,
            *(entry[2] for entry in entries),
            *result.internal,
            *result.remembered,
        ]

    def _check(self) -> None:
        """Refuse a law that is not finite where all coordinates are zero."""
        given = np.zeros(arguments(self.law))
        given[3 * self.law.size + 1] = 1.0  # the length of the step
        if not np.isfinite(self(given)).all():
            raise SceneError(self.law.at_zero)


def _derivative(force: Any, D: Any) -> Any:
    return apply_derivatives(apply_algebra_lowering(ufl.diff(force, D)))


@functools.cache
def _cached(law: PointLaw, rule: StepRule) -> CompiledLaw:
    return CompiledLaw(law, rule)


def compiled_law(law: PointLaw, rule: StepRule) -> CompiledLaw:
    """A compiled law; without functions of a user it is kept."""
    return CompiledLaw(law, rule) if law.own else _cached(law, rule)
