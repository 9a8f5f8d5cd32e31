"""Whether two scenes differ in numbers only: what is set up for one then serves the other.

All that a scene has is structure, and must be equal, except fields that are marked as numbers, by
`IS_DATA` or `real`. So what is added to a scene later counts as structure until it is marked.
`Watch` notices changes of a scene while something that was made of it is in use.
"""

from __future__ import annotations

import itertools
import operator
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from fx_beam.dual import DualFloat
from fx_beam.errors import SceneError, field_kinds

from .beam import Node
from .coordinate import functions_of
from .law import functions_of_energy
from .scene import Scene
from .section import functions_of_section


def expressions_of(scene: Scene) -> Iterator[tuple[str, object]]:
    """Expressions of all functions of the user, with their names, in a fixed order."""
    sections = [beam.section for beam in scene.beams]
    if any(section.strain_energy is not None for section in sections):
        distinct = {id(section): section for section in sections}
        numbers = {key: number for number, key in enumerate(distinct)}
        yield "sections", [numbers[id(section)] for section in sections]
        for section in distinct.values():
            yield from functions_of_section(section)
    for joint in scene.joints:
        for coordinate in joint.coordinates.values():
            yield from functions_of(coordinate)
    for gear in scene.gears:
        yield from functions_of(gear.on)
    for obstacle in scene.contacts:
        yield from functions_of_energy(obstacle.energy, None, 1)
    for force in scene.forces_between:
        yield from force.functions
    if scene.virtual_works:
        from .ufl_symbols import STEP

        yield from (("virtual work", work.of(STEP, "virtual work")) for work in scene.virtual_works)


# Attributes of a scene of which only the kind must be the same, as of fields that are marked by
# `IS_DATA`: an array keeps its shape, a function of time or place stays one or becomes a number,
# and None stays None. Functions of a user in UFL are among them, as what they give is compared.
_NUMBERS = "_gravity", "prescribed", "masses", "parameters", "rates"
# Kinds of values that are compared as they are; and of plain numbers.
_PLAIN = {float, DualFloat, int, bool, str, type(None)}
_SCALARS, _NODES = _PLAIN - {type(None)}, {Node}
# What follows from the rest of a scene.
_DERIVED = {"nodes", "_couplings", "changes", "array_calls", "part_indices"}


# The number of a node.
_NUMBER = operator.attrgetter("number")


class OtherStructureError(Exception):
    """A scene cannot use what was set up for another one; the message says why."""


class _Form(tuple):
    """The structure of a part of a scene: its kind, and the forms of its attributes."""


class Structure:
    """The structure of a scene as it is now, to compare; the scene may change later."""

    def __init__(self, scene: Scene):
        #: Numbers of nodes, beams, joints and bodies.
        self.counts = (
            *(len(scene.nodes), len(scene.beams)),
            *(len(scene.joints), len(scene.bodies)),
        )
        self._forms = _forms_of(scene)
        self._functions = (*((name, _frozen(value)) for name, value in expressions_of(scene)),)

    def __eq__(self, other: object) -> bool:
        return (
            isinstance(other, Structure)
            and self.counts == other.counts
            and self._forms == other._forms
            and self._functions == other._functions
        )

    def check(self, scene: Scene) -> None:
        """OtherStructureError if a scene differs in more than numbers."""
        if (other := Structure(scene)) != self:
            raise OtherStructureError(self.difference(other))

    def has_other_functions(self, other: Structure) -> bool:
        """Whether only functions of the user differ from those of another structure."""
        return self._forms == other._forms and self._functions != other._functions

    def difference(self, other: Structure) -> str:
        """Where another structure differs first."""
        if self.counts[0] != other.counts[0]:
            return "another number of nodes"
        for name in self._forms | other._forms:
            form, known = other._forms.get(name, ()), self._forms.get(name, ())
            if form != known:
                return f"scene.{name}{_difference(form, known)}"
        for function, known in itertools.zip_longest(other._functions, self._functions):
            if function != known:
                return (
                    f"{(function or known)[0]} of your own differs in more than parameters. "
                    "Numbers in it that change must be fb.Parameter(name, value)"
                )
        return "it has other numbers that are zero"


def _frozen(value: object) -> object:
    """A value with tuples in the place of lists."""
    return (*map(_frozen, value),) if isinstance(value, list | tuple) else value


def _difference(form: object, known: object) -> str:
    """Where two forms differ first, and how."""
    if isinstance(form, _Form) and isinstance(known, _Form) and form[0] is known[0]:
        named = field_kinds(form[0])
        names = [f".{name}" for name in (*named.structure, *named.numbers)]
        form, known = form[1:], known[1:]
    elif type(form) is tuple and type(known) is tuple:
        if len(form) != len(known):
            return " has another length"
        names = [f"[{i}]" for i in range(len(form))]
    else:
        return " differs"
    pairs = zip(names, form, known, strict=True)
    return next(name + _difference(a, b) for name, a, b in pairs if a != b)


def _forms_of(scene: Scene) -> dict[str, object]:
    """Structures of all that a scene has, by their names; without what is empty or zero."""
    known_forms = dict[int, _Form]()
    return {
        name: _form_of_number(value) if name in _NUMBERS else _form(value, known_forms)
        for name, value in vars(scene).items()
        if name not in _DERIVED and (name == "_gravity" or value)
    }


def _form(value: object, known_forms: dict[int, _Form]) -> object:
    """Structure of a value; `known_forms` has those of parts by ids, as beams share sections."""
    kind: Any = type(value)
    if kind in _PLAIN:
        return value
    if isinstance(value, Node):
        return value.number
    if hasattr(kind, "__dataclass_fields__"):  # quicker than is_dataclass
        if (form := known_forms.get(id(value))) is None:
            values, named = vars(value), field_kinds(kind)
            parts = [
                part if type(part := values[name]) in _PLAIN else _form(part, known_forms)
                for name in named.structure
            ]
            numbers = [
                ()
                if type(number := values[name]) in _SCALARS or callable(number)
                else _form_of_number(number)
                for name in named.numbers
            ]
            form = known_forms[id(value)] = _Form((kind, *parts, *numbers))
        return form
    if isinstance(value, list | tuple):
        kinds = {*map(type, value)}
        if kinds == _NODES:
            return (*map(_NUMBER, value),)
        if kinds <= _PLAIN:
            return (*value,)
        return (*[_form(part, known_forms) for part in value],)
    if isinstance(value, set | np.ndarray):
        return frozenset(value) if isinstance(value, set) else _frozen(value.tolist())
    if isinstance(value, dict):
        return (*[(key, _form(part, known_forms)) for key, part in value.items()],)
    # A function that is not listed is always another one.
    return object() if callable(value) else value


def _form_of_number(number: Any) -> object:
    """Shape of a number, or names of several; a function counts as one number."""
    if number is None:
        return None
    if isinstance(number, np.ndarray):
        return number.shape
    if callable(number):
        return ()
    if isinstance(number, list):  # lumped masses: first the number of the node
        return (*[row[0] for row in number],)
    return (*number,) if isinstance(number, Mapping) else np.shape(number)


# Parts of a scene that may become longer.
_LISTS = operator.attrgetter(
    *(name for name, part in vars(Scene()).items() if isinstance(part, list | dict | set))
)


class Watch:
    """Notices whether something was added to a scene, removed from it or changed."""

    def __init__(self, scene: Scene):
        self._scene, self._parts = scene, _LISTS(scene)
        self._counts = self._now()

    def _now(self) -> tuple[int, ...]:
        """Lengths of lists and counts of changes: a change of the scene changes one of them."""
        return *map(len, self._parts), self._scene.changes, self._scene.parameters.changes

    @property
    def has_changed(self) -> bool:
        """Whether the scene has changed since the start."""
        return self._now() != self._counts

    def check_unchanged(self, caller: str) -> None:
        """SceneError if the scene was changed while an analysis ran."""
        if self.has_changed:
            raise SceneError(
                f"{caller}: the scene was changed while it was computed, as by a load function "
                "that adds a beam. Change it before, or by latches and fuses (changes=...)"
            )
