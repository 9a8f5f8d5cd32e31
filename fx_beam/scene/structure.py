"""Whether two scenes differ in numbers only: what is set up for one then serves the other.

All that a scene has is structure, and must be equal, except fields that are marked as numbers, by
`NUMBER` or `number`. So what is added to a scene later counts as structure until it is marked.
"""

from __future__ import annotations

import copy
import functools
import itertools
from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from .beam import Node
from .coordinate import functions_of
from .law import functions_of_energy
from .scene import Scene


def expressions_of(scene: Scene) -> list[tuple[str, Any]]:
    """What all functions of the user give, with their names, in a fixed order."""
    sections = [beam.section for beam in scene.beams]
    expressions: list[tuple[str, Any]] = []
    if any(section.strain_energy is not None for section in sections):
        distinct = {id(section): section for section in sections}
        numbers = {key: number for number, key in enumerate(distinct)}
        expressions.append(("sections", [numbers[id(section)] for section in sections]))
        for section in distinct.values():
            expressions += functions_of_energy(section.strain_energy, section.internal, 3)
    for joint in scene.joints:
        for on in joint.coordinates.values():
            expressions += functions_of(on)
    for obstacle in scene.contacts:
        expressions += functions_of_energy(obstacle.energy, None, 1)
    for force in scene.forces_between:
        expressions += force.functions
    if scene.virtual_works:
        from .symbols import STEP

        works = [work.of(STEP, "virtual work") for work in scene.virtual_works]
        expressions += [("virtual work", work) for work in works]
    return expressions


# Attributes of a scene of which only the kind must be the same, as of fields that are marked by
# `NUMBER`: an array keeps its shape, a function of time or place stays one or becomes a number, and
# None stays None. Functions of a user in UFL are among them, as what they give is compared.
_NUMBERS = "gravity", "prescribed", "masses", "parameters"
# Kinds of values that are compared as they are.
_PLAIN = {float, int, bool, str, set, type(None)}
# What follows from the rest of a scene.
_DERIVED = {"nodes", "_corners", "_couplings", "changes"}
#: Pairs of parts, by their ids, that are known to be alike: many beams have one section.
_Alike = set[tuple[int, int]]


class OtherStructureError(Exception):
    """A scene cannot use what was set up for another one; the message says why."""


class ElsewhereError(OtherStructureError):
    """Only positions differ, but for these a scene must be set up anew."""


class Structure:
    """The structure of a scene as it is now; something may be added to the scene later."""

    def __init__(self, scene: Scene):
        self._parts = {
            name: copy.copy(part) if isinstance(part, list | dict | set) else part
            for name, part in vars(scene).items()
            if name not in _DERIVED
        }
        self._nodes, self._functions = len(scene.nodes), expressions_of(scene)

    def check(self, scene: Scene) -> None:
        """OtherStructureError if a scene differs in more than numbers."""
        if len(scene.nodes) != self._nodes:
            raise OtherStructureError("another number of nodes")
        alike = _Alike()
        for name, part in self._parts.items():
            other = getattr(scene, name)
            if isinstance(part, list | dict) and not (part or other):
                continue  # quickly, as most are empty
            compare = _difference_of_numbers if name in _NUMBERS else _difference
            if difference := compare(part, other, alike):
                raise OtherStructureError(f"scene.{name}{difference}")
        functions = expressions_of(scene)
        for function, known in itertools.zip_longest(functions, self._functions):
            if function != known:
                what = (function or known)[0]
                raise OtherStructureError(f"{what} of your own differs in more than parameters")


def _difference(one: Any, two: Any, alike: _Alike) -> str:
    """Where two values differ in more than numbers, and how; empty if they do not."""
    kind: Any = type(one)
    if kind is not type(two) and not (isinstance(one, float) and isinstance(two, float)):
        return " is of another kind"
    return _comparison(kind)(one, two, alike)


@functools.cache
def _comparison(kind: type) -> Callable[[Any, Any, _Alike], str]:
    """How two values of a kind are compared."""
    if kind in _PLAIN:
        return lambda one, two, _: "" if one == two else " differs"
    if issubclass(kind, Node):
        return lambda one, two, _: "" if one.number == two.number else " differs"
    if is_dataclass(kind):
        return _difference_of_fields
    if issubclass(kind, list | tuple | dict):
        return _difference_of_items
    if kind is np.ndarray:
        return lambda one, two, _: "" if np.array_equal(one, two) else " differs"
    # A function that is not listed is always another one.
    return lambda one, two, _: " differs" if callable(one) or one != two else ""


def _difference_of_items(one: Any, two: Any, alike: _Alike) -> str:
    """That of lists or dictionaries."""
    if len(one) != len(two):
        return " has another length"
    keys: Any = range(len(one))
    if isinstance(one, dict):
        if list(one) != list(two):
            return " has other keys"
        keys, one, two = list(one), one.values(), two.values()
    elif one and type(one[0]) is Node:  # quickly, as in beams of many elements
        one, two = ([node.number for node in nodes] for nodes in (one, two))
        return "" if one == two else " differs"
    for key, known, other in zip(keys, one, two, strict=True):
        if difference := _difference(known, other, alike):
            return f"[{key!r}]{difference}"
    return ""


def _difference_of_fields(one: Any, two: Any, alike: _Alike) -> str:
    """That of parts of a scene."""
    if (pair := (id(one), id(two))) in alike:
        return ""
    kind: Any = type(one)
    for name, is_number in _fields(kind):
        known, other = getattr(one, name), getattr(two, name)
        of = type(known)
        if of is type(other) and of in _PLAIN and (is_number or known == other):
            continue  # quickly, as most are
        compare = _difference_of_numbers if is_number else _difference
        if difference := compare(known, other, alike):
            return f".{name}{difference}"
    alike.add(pair)
    return ""


@functools.cache
def _fields(kind: type) -> list[tuple[str, bool]]:
    """Names of the attributes of a kind of parts, and whether they are numbers."""
    return [(field.name, "number" in field.metadata) for field in fields(kind)]


def _difference_of_numbers(one: Any, two: Any, alike: _Alike) -> str:
    return "" if _form(one) == _form(two) else " is of another kind"


def _form(number: Any) -> Any:
    """What is structure of a number: its shape, or its names; a function has that of one number."""
    if isinstance(number, np.ndarray):
        return number.shape
    if callable(number):
        return ()
    if number is None or isinstance(number, Node):
        return number and number.number
    if isinstance(number, list):  # lumped masses: first the number of the node
        return [row[0] for row in number]
    if isinstance(number, Mapping):  # of functions
        return [*number]
    return np.shape(number)
