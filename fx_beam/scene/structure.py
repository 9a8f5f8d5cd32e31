"""Whether two scenes differ in numbers only: what is set up for one then serves the other.

All that a scene has is structure, and must be equal, except what is listed here as a number. So
what is added to a scene later counts as structure until it is listed.
"""

from __future__ import annotations

import copy
import functools
import itertools
import operator
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from .beam import Beam, Node
from .body import Body
from .contacts import Contact
from .coordinate import Coordinate, Coulomb, Damper, SmoothFriction, Spring, Stop, functions_of
from .forces_between import ForceBetween
from .internal_variables import InternalVariables
from .joints import Joint
from .law import functions_of_energy
from .loads import Drag, Load, StrainPart, Velocity, VirtualWork
from .scene import Scene
from .section import Section
from .symbols import STEP


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
    works = [work.of(STEP, "virtual work") for work in scene.virtual_works]
    return expressions + [("virtual work", work) for work in works]


#: Attributes of which only the kind must be the same, besides those that shapes name themselves: an
#: array keeps its shape, a function of time or place stays one or becomes a number, and None stays
#: None.
NUMBERS: dict[type, tuple[str, ...]] = {
    Scene: ("gravity", "prescribed", "masses", "parameters"),
    Beam: ("s", "inner"),
    Section: ("EA", "GA", "EI", "rhoA", "rhoI", "retardation"),
    Body: ("mass", "inertia"),
    Joint: ("offset", "axis"),
    Coordinate: ("motor",),
    Spring: ("stiffness", "rest"),
    Damper: ("viscosity",),
    SmoothFriction: ("force", "speed"),
    Coulomb: ("mu", "stiffness", "radius", "damping"),
    Stop: ("lower", "upper", "stiffness", "restitution", "speed"),
    Contact: ("stiffness", "restitution", "speed", "radius"),
    ForceBetween: ("b",),
    Load: ("value", "along"),
    StrainPart: ("value", "along"),
    Drag: ("linear", "quadratic", "rotation"),
    Velocity: ("value", "spin"),
}
#: Functions of the user, which are compared by the UFL expressions that they give.
_OWN: dict[type, tuple[str, ...]] = {
    Section: ("strain_energy",),
    InternalVariables: ("update",),
    Spring: ("strain_energy",),
    Damper: ("law",),
    SmoothFriction: ("force",),
    Contact: ("energy",),
    ForceBetween: ("force",),
    VirtualWork: ("term",),
}
#: Kinds of values that are their own outlines.
_PLAIN = {float, int, bool, str, type(None)}
#: What follows from the rest of a scene.
_DERIVED = {"nodes", "_corners", "_couplings", "changes"}
#: Outlines of parts by their ids: many beams have one section.
_Known = dict[int, Any]


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

    @functools.cached_property
    def _outlines(self) -> dict[str, Any]:
        """Outlines of the parts that are not empty lists, which most are; few scenes need them."""
        known, parts = _Known(), self._parts.items()
        full = ((name, part) for name, part in parts if not isinstance(part, list) or part)
        return {name: _of_part(name, part, known) for name, part in full}

    def check(self, scene: Scene) -> None:
        """OtherStructureError if a scene differs in more than numbers."""
        if len(scene.nodes) != self._nodes:
            raise OtherStructureError("another number of nodes")
        made, outlines = _Known(), self._outlines
        for name in self._parts:
            part = getattr(scene, name)
            if name in outlines:
                if (outline := _of_part(name, part, made)) != outlines[name]:
                    difference = _difference(outlines[name], outline)
                    raise OtherStructureError(f"scene.{name}{difference}")
            elif part:
                raise OtherStructureError(f"scene.{name} has another length")
        functions = expressions_of(scene)
        for function, known in itertools.zip_longest(functions, self._functions):
            if function != known:
                what = (function or known)[0]
                raise OtherStructureError(f"{what} of your own differs in more than parameters")


class _Outline(tuple):
    """What is structure of something with parts: its kind, keys or length, then their outlines."""

    __slots__ = ()


def _of_part(name: str, part: Any, known: _Known) -> Any:
    return _number(part) if name in NUMBERS[Scene] else _of(part, known)


def _of(value: Any, known: _Known) -> Any:
    """The outline of a value; equal for two that differ in numbers only."""
    kind: Any = type(value)
    return value if kind in _PLAIN else _outliner(kind)(value, known)


@functools.cache
def _outliner(kind: type) -> Callable[[Any, _Known], Any]:
    """How outlines of a kind are made."""
    if issubclass(kind, Node):
        return lambda node, known: node.number
    if issubclass(kind, list | tuple):
        return _of_sequence
    if issubclass(kind, set):
        return lambda values, known: frozenset(values)
    if issubclass(kind, Mapping):
        return lambda items, known: _Outline(
            (tuple(items), *(_of(part, known) for part in items.values()))
        )
    if issubclass(kind, np.ndarray):
        return lambda array, known: (array.shape, *array.ravel().tolist())
    if not is_dataclass(kind):  # a function that is not listed is always another one
        return lambda value, known: object() if callable(value) else value
    numbers = {name for of, names in NUMBERS.items() if issubclass(kind, of) for name in names}
    numbers |= {*getattr(kind, "NUMBERS", ())}
    functions = {name for of, names in _OWN.items() if issubclass(kind, of) for name in names}
    names = [field.name for field in fields(kind)]
    are_numbers, of_user = [[name in of for name in names] for of in (numbers, functions)]
    values = _getter(names)

    def outline(of: Any, known: _Known) -> Any:
        if id(of) not in known:
            parts: list[Any] = [kind]
            for value, is_number, may_be in zip(values(of), are_numbers, of_user, strict=True):
                if may_be and callable(value):
                    parts.append("a function")
                elif is_number:
                    parts.append(() if type(value) is float else _number(value))
                else:
                    parts.append(value if type(value) in _PLAIN else _of(value, known))
            known[id(of)] = _Outline(parts)
        return known[id(of)]

    return outline


def _getter(names: list[str]) -> Any:
    """A function that gives several attributes of an object, quickly."""
    if len(names) > 1:
        return operator.attrgetter(*names)
    return lambda of: [getattr(of, name) for name in names]


def _of_sequence(values: Any, known: _Known) -> _Outline:
    if values and type(values[0]) is Node:  # quickly, as in beams of many elements
        return _Outline((len(values), *(node.number for node in values)))
    return _Outline((len(values), *(_of(value, known) for value in values)))


def _number(value: Any) -> Any:
    """What is structure of a number: its shape, or its names; a function has that of one number."""
    if value is None or isinstance(value, Node):
        return value and value.number
    if isinstance(value, list):  # lumped masses: first the number of the node
        return tuple(row[0] for row in value)
    if isinstance(value, Mapping):  # of functions
        return tuple(value)
    return () if callable(value) else np.shape(value)


def _difference(known: Any, other: Any) -> str:
    """The place of the first difference of two outlines, and what it is."""
    if type(known) is not type(other):
        return " is of another kind"
    if not isinstance(known, _Outline):
        return " differs"
    label = known[0]
    if label != other[0]:
        return " has another length" if isinstance(label, int) else " is of another kind"
    places: Iterable[str] = (f"[{i}]" for i in range(len(known) - 1))
    if isinstance(label, type):
        places = (f".{field.name}" for field in fields(label))
    elif isinstance(label, tuple):
        places = (f"[{key!r}]" for key in label)
    return next(
        place + _difference(one, two)
        for place, one, two in zip(places, known[1:], other[1:], strict=True)
        if one != two
    )
