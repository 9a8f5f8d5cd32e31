"""Quantities that can be measured: what solutions, motions and derivatives know of each."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from .beam import Node
from .joint_kinematics import NodalMotion, axial_rate
from .joints import GROUND, Joint
from .sliders import SlidingJoint


class Local(NamedTuple):
    """What a law of a node or a joint reads: the motion (3, ...) of its node, or of b and a."""

    q: Any = np.zeros(3)
    v: Any = np.zeros(3)
    q_a: Any = np.zeros(3)
    v_a: Any = np.zeros(3)
    slide: Any = 0.0
    #: Numbers of the scene (2,): a joint's place on a, and its axis.
    offset: Any = np.zeros(2)
    axis: Any = np.zeros(2)


def _rate(at: Local) -> Any:
    """Rate of the slide."""
    x, y = at.v[0] - at.v_a[0], at.v[1] - at.v_a[1]
    return axial_rate(at, at.slide, at.q_a[2], at.v_a[2], x, y)


class Quantity(NamedTuple):
    """What can be measured: all that solutions, motions, linear systems and derivatives know of it.

    It is linear in what is recorded, or has a law: a function of `Local` in numpy, analytic in all
    of this, from whose value derivatives follow.
    """

    unit: str
    components: tuple[str, ...] = ()
    #: The history that has it, of a joint's nodes that of b less that of a; the column there.
    of: str = ""
    column: int = 0
    #: Whether it is a place, to which that in the reference configuration is added.
    is_place: bool = False
    law: Callable[[Local], Any] | None = None

    @property
    def reads(self) -> str:
        """What its law reads of nodes: places, or these and their rates."""
        return "q" if self.of == "q" else "qv"


_PLANE, _FORCE = ("x", "y"), ("x", "y", "moment")
#: Quantities of nodes, joints, scenes and beams by name.
OF_NODES: dict[str, Quantity] = {
    "position": Quantity("m", _PLANE, "q", is_place=True),
    "displacement": Quantity("m", _PLANE, "q"),
    "rotation": Quantity("rad", of="q", column=2),
    "velocity": Quantity("m/s", _PLANE, "v"),
    "spin": Quantity("rad/s", of="v", column=2),
    "acceleration": Quantity("m/s^2", _PLANE, "a"),
    "reaction": Quantity("N, N m", _FORCE, "reactions"),
}
OF_JOINTS: dict[str, Quantity] = {
    "angle": Quantity("rad", of="q", column=2),
    "slide": Quantity("m", of="slides"),
    "spin": Quantity("rad/s", of="v", column=2),
    "rate": Quantity("m/s or rad/s", of="v", column=2, law=_rate),
    "force": Quantity("N, N m", _FORCE, "joint_forces"),
    "motor_force": Quantity("N or N m", of="motor_forces"),
}
OF_SCENES: dict[str, Quantity] = {
    name: Quantity("J")
    for name in (
        *("kinetic_energy", "strain_energy", "potential_energy", "spring_energy", "total_energy"),
        *("dissipated_energy", "work"),
    )
}
OF_BEAMS: dict[str, Quantity] = {
    "N": Quantity("N", of="resultants"),
    "Q": Quantity("N", of="resultants"),
    "M": Quantity("N m", of="resultants"),
}


@dataclass(frozen=True)
class Defined:
    """A quantity of a node, a joint, a beam or the scene, or one of its components."""

    quantity: Quantity
    of: Any
    #: Number of its component; None for all.
    index: int | None

    @property
    def shape(self) -> tuple[int, ...]:
        """Lengths of a value; none of a single number."""
        count = len(self.quantity.components)
        return (count,) if count and self.index is None else ()

    @property
    def number(self) -> int:
        """Number of its node or joint."""
        return self.of.number

    @property
    def columns(self) -> Any:
        """Columns of its components in the history of its quantity; a number for a single one."""
        first, count = self.quantity.column, len(self.quantity.components)
        return first + (np.arange(count) if self.shape else self.index or 0)

    def ends(self) -> Iterator[tuple[int, Node]]:
        """Its nodes, with their signs: 1, and -1 of a joint's node a; without the ground."""
        both = [self.of] if isinstance(self.of, Node) else [self.of.b, self.of.a]
        for sign, node in zip((1, -1), both, strict=False):
            if node is not GROUND:
                yield sign, node

    def local(self, motion: Callable[[str, Node], Any], slide: Any) -> Local:
        """What its law reads of the motion (3, ...) of nodes, and of the slide of its joint."""
        given: dict[str, Any] = {"slide": slide}
        for sign, node in self.ends():
            end = "" if sign > 0 else "_a"
            given |= {f"{name}{end}": motion(name, node) for name in self.quantity.reads}
        if isinstance(self.of, Joint):
            axis = (0.0, 0.0) if self.of.axis is None else self.of.axis
            given |= {"offset": self.of.offset, "axis": axis}
        return Local(**given)

    def law(self, at: Local) -> Any:
        """Its value, or those of its components, by its law."""
        law = self.quantity.law
        assert law is not None
        return law(at) if self.index is None else law(at)[self.index]

    def by_law(self, at: NodalMotion, slide: Any) -> Any:
        """Its values (n,) or (n, components) by its law; `slide` (n,) is that of its joint."""
        if isinstance(self.of, SlidingJoint):
            return self.of.kinematics.rate(at, slide)
        value = self.law(self.local(at.of_node, slide))
        return np.stack(value, axis=-1) if self.shape else value
