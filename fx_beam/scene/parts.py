"""Parts of a scene that pictures show, as they are when a run begins."""

from __future__ import annotations

import operator
from collections.abc import Callable, Sequence
from dataclasses import is_dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from .beam import Node
from .contacts import Contact
from .forces_between import ForceBetween
from .gears import Gear
from .joints import Joint
from .loads import Load, Mass

if TYPE_CHECKING:
    from .scene import Scene


class Parts(NamedTuple):
    """Supports, joints, springs, masses, loads and contacts; copies have contacts only."""

    #: Numbers of nodes with their fixed components.
    fixed: frozenset[tuple[int, int]] = frozenset()
    joints: tuple[Joint, ...] = ()
    gears: tuple[Gear, ...] = ()
    forces_between: tuple[ForceBetween, ...] = ()
    masses: tuple[Mass, ...] = ()
    loads: tuple[Load, ...] = ()
    contacts: tuple[Contact, ...] = ()

    @classmethod
    def of(cls, scene: Scene) -> Parts:
        """The parts of a scene as it is now."""
        gone = scene.gone
        fixed = (key for key in scene.fixed if key[0] not in gone) if gone else scene.fixed
        return cls(frozenset(fixed), *map(tuple, _LISTS(scene)))

    def __reduce__(self):
        # Functions of the user, as loads may have, cannot be copied.
        return Parts, (*type(self)()[:-1], self.contacts)

    @property
    def radii(self) -> dict[int, float]:
        """Radii of the balls and wheels around nodes, by their numbers [m]."""
        radii: dict[int, float] = {}
        for contact in self.contacts:
            radius = float(np.broadcast_to(contact.radius, 2)[0])
            if isinstance(contact.target, Node) and radius > 0:
                number = contact.target.number
                radii[number] = max(radius, radii.get(number, 0.0))
        return radii

    def without(self, others: Parts) -> Parts:
        """The parts that others do not have, known by what they are and on which nodes."""

        def named(part: object) -> object:
            return part if isinstance(part, tuple) else str(part)

        lists: list[Any] = []
        pairs: Any = zip(self, others, strict=True)
        for own, other in pairs:
            names = set(map(named, other))
            lists.append(type(own)(part for part in own if named(part) not in names))
        return Parts(*lists)

    def moved(self, node_of: Callable[[Node], Node], numbers: Sequence[int]) -> Parts:
        """The same parts on other nodes; `numbers` has those of the other nodes by their own."""
        fixed = frozenset((int(numbers[number]), component) for number, component in self.fixed)
        masses = tuple(mass._replace(node=int(numbers[mass.node])) for mass in self.masses)
        return Parts(*_on(node_of, tuple(self)))._replace(fixed=fixed, masses=masses)


def _on(node_of: Callable[[Node], Node], part: Any) -> Any:
    """A part of a scene, or several, on other nodes."""
    if isinstance(part, Node):
        return node_of(part)
    if type(part) is tuple:
        return tuple(_on(node_of, item) for item in part)
    if not is_dataclass(part):
        return part
    new = {name: _on(node_of, value) for name, value in vars(part).items()}
    if all(value is vars(part)[name] for name, value in new.items()):
        return part
    other = object.__new__(type(part))
    vars(other).update(new)
    return other


# Lists of a scene, in the order of the fields.
_LISTS = operator.attrgetter(*Parts._fields[1:])
