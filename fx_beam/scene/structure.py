"""Whether two scenes differ in numbers only: what is set up for one then serves the other.

All that a scene has is structure, and must be equal, except what is listed here as a number. So
what is added to a scene later counts as structure until it is listed.
"""

from __future__ import annotations

import copy
import functools
import itertools
import operator
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from .beam import Beam, Node
from .body import Body
from .coordinate import Coordinate, Coulomb, Damper, Friction, Spring, Stop, functions_of
from .forces_between import ForceBetween
from .internal_variables import InternalVariables
from .joints import Joint
from .law import functions_of_energy
from .loads import Drag, Load, StrainPart, Velocity, VirtualWork
from .obstacles import Obstacle
from .scene import Scene
from .section import Section
from .symbols import STEP


def expressions_of(scene: Scene) -> list[tuple[str, Any]]:
    """What all functions of the user give, with their names, in a fixed order."""
    sections = [beam.section for beam in scene.beams]
    own: list[tuple[str, Any]] = []
    if any(section.strain_energy is not None for section in sections):
        distinct = {id(section): section for section in sections}
        numbers = {key: number for number, key in enumerate(distinct)}
        own.append(("sections", [numbers[id(section)] for section in sections]))
        for section in distinct.values():
            own += functions_of_energy(section.strain_energy, section.internal, 3)
    for joint in scene.joints:
        for on in filter(None, (joint.slide, joint.rotation)):
            own += functions_of(on)
    for obstacle in scene.obstacles:
        own += functions_of_energy(obstacle.energy, None, 1)
    for force in scene.forces_between:
        own += force.functions
    works = [work.of(STEP, "virtual work") for work in scene.virtual_works]
    return own + [("virtual work", work) for work in works]


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
    Friction: ("force", "speed"),
    Coulomb: ("mu", "stiffness", "radius", "damping"),
    Stop: ("lower", "upper", "stiffness", "restitution", "speed"),
    Obstacle: ("stiffness", "restitution", "speed", "radius"),
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
    Friction: ("force",),
    Obstacle: ("energy",),
    ForceBetween: ("force",),
    VirtualWork: ("term",),
}
#: Kinds of values that are compared quickly.
_PLAIN = {float, int, bool, str, type(None)}
#: Parts of a scene that are known to be the same: the known ones by the id of the new ones.
_Same = dict[int, Any]
#: What follows from the rest of a scene.
_DERIVED: dict[type, tuple[str, ...]] = {
    Scene: ("nodes", "_corners", "_couplings", "changes"),
}


class OtherStructureError(Exception):
    """A scene cannot use what was set up for another one; the message says why."""


class _DiffersError(Exception):
    """Parts differ. The place is added from part to part on the way out, and costs nothing else."""

    def within(self, place: str) -> _DiffersError:
        """The same of a larger part."""
        return _DiffersError(place, *self.args)


class ElsewhereError(OtherStructureError):
    """Only positions differ, but for these a scene must be set up anew."""


class Structure:
    """The structure of a scene as it is now; something may be added to the scene later."""

    def __init__(self, scene: Scene):
        self._parts = {
            name: copy.copy(part) if isinstance(part, list | dict | set) else part
            for name, part in vars(scene).items()
            if name not in _DERIVED[Scene]
        }
        # Most parts are empty, or of plain values: these are compared all at once.
        plain = [name for name, part in self._parts.items() if _is_plain(part)]
        self._plain = [self._parts[name] for name in plain], _getter(plain)
        self._others = {name: part for name, part in self._parts.items() if name not in plain}
        self._nodes = len(scene.nodes)
        self._functions = expressions_of(scene)

    def check(self, scene: Scene) -> None:
        """OtherStructureError if a scene differs in more than numbers."""
        if len(scene.nodes) != self._nodes:
            raise OtherStructureError("another number of nodes")
        numbers, now = NUMBERS[Scene], vars(scene)
        same: _Same = {}
        plain, own = self._plain
        for name, known in (self._others if [*own(scene)] == plain else self._parts).items():
            part = now[name]
            try:
                _check_part(name in numbers, part, known, same)
            except _DiffersError as differs:
                raise OtherStructureError(f"scene.{name}{''.join(differs.args)}") from None
        functions = expressions_of(scene)
        for own, known in itertools.zip_longest(functions, self._functions):
            if own != known:
                what = (own or known)[0]
                raise OtherStructureError(f"{what} of your own differs in more than parameters")


def _is_plain(part: Any) -> bool:
    """Whether a part is a set, a count or a flag, or empty."""
    return isinstance(part, set | int) or (isinstance(part, list | dict) and not part)


def _check_part(is_number: bool, a: Any, b: Any, same: _Same) -> None:
    if a is not b or callable(a):
        (_check_number if is_number else _check)(a, b, same)


def _check(a: Any, b: Any, same: _Same) -> None:
    kind: Any = type(a)
    if kind is not type(b):
        raise _DiffersError(" is of another kind")
    check = _checks(kind)  # type: ignore[arg-type]
    if check is not None:
        check(a, b, same)
    elif a != b or callable(a):
        raise _DiffersError(" differs")


@functools.cache
def _checks(kind: Any) -> Any:
    """How objects of a kind are compared; None for plain values."""
    if issubclass(kind, Node):
        return _nodes
    if issubclass(kind, list | tuple):
        return _sequences
    if issubclass(kind, Mapping):
        return _mappings
    if issubclass(kind, np.ndarray):
        return _arrays
    own = {of: names for of, names in NUMBERS.items() if issubclass(kind, of)}
    numbers = {name for names in own.values() for name in names} | {*getattr(kind, "NUMBERS", ())}
    functions = {name for of, names in _OWN.items() if issubclass(kind, of) for name in names}
    if not is_dataclass(kind):
        return None
    parts = tuple(
        (field.name, field.name in numbers, field.name in functions) for field in fields(kind)
    )

    values = _getter([name for name, *_ in parts])

    def check(a: Any, b: Any, same: _Same) -> None:
        if same.get(id(a)) is b:
            return
        for part, one, other in zip(parts, values(a), values(b), strict=True):
            name, is_number, may_be_function = part
            if type(one) is type(other) in _PLAIN and (is_number or one == other):
                continue
            try:
                if may_be_function and (callable(one) or callable(other)):
                    if not (callable(one) and callable(other)):
                        raise _DiffersError(" is of another kind")
                    continue
                _check_part(is_number, one, other, same)
            except _DiffersError as differs:
                raise differs.within(f".{name}") from None
        same[id(a)] = b

    return check


def _getter(names: list[str]) -> Any:
    """A function that gives several attributes of an object, quickly."""
    if len(names) > 1:
        return operator.attrgetter(*names)
    return lambda of: [getattr(of, name) for name in names]


def _nodes(a: Node, b: Node, same: _Same) -> None:
    if a.number != b.number:
        raise _DiffersError(" is another node")


def _sequences(a: Any, b: Any, same: _Same) -> None:
    if len(a) != len(b):
        raise _DiffersError(" has another length")
    if a and type(a[0]) is Node and type(b[0]) is Node:  # quickly, as in beams of many elements
        if [node.number for node in a] != [node.number for node in b]:
            raise _DiffersError(" are other nodes")
        return
    for i, (one, other) in enumerate(zip(a, b, strict=True)):
        try:
            _check(one, other, same)
        except _DiffersError as differs:
            raise differs.within(f"[{i}]") from None


def _mappings(a: Any, b: Any, same: _Same) -> None:
    if list(a) != list(b):
        raise _DiffersError(" has other keys")
    for key in a:
        try:
            _check(a[key], b[key], same)
        except _DiffersError as differs:
            raise differs.within(f"[{key!r}]") from None


def _arrays(a: np.ndarray, b: np.ndarray, same: _Same) -> None:
    if a.shape != b.shape or not (a == b).all():
        raise _DiffersError(" differs")


def _check_number(a: Any, b: Any, same: _Same) -> None:
    kind, other = type(a), type(b)
    if kind is float and other is float:
        return
    if a is None or b is None:
        fits = a is b
    elif kind is np.ndarray and other is np.ndarray:
        fits = a.shape == b.shape
    elif callable(a) and callable(b):
        return
    elif isinstance(a, list):  # lumped masses: first the number of the node
        fits = [row[0] for row in a] == [row[0] for row in b]
    elif isinstance(a, Node) or isinstance(b, Node):
        return _check(a, b, same)
    elif isinstance(a, Mapping):  # of functions
        fits = list(a) == list(b)
    else:
        fits = np.shape(a) == np.shape(b)
    if not fits:
        raise _DiffersError(" is of another kind")
