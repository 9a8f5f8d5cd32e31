"""Joints between two nodes, or a node and the ground, as plain data."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.validation import is_number, time_function, vector

from .beam import Node


class _Ground(Node):
    """The fixed frame. It is told by identity, so that copies and pickles of it are itself."""

    def __reduce__(self):
        return "GROUND"

    def __str__(self):
        return "the ground"


#: The fixed frame, in place of a joint's first or second node.
GROUND = _Ground(-1, math.nan, math.nan)


@dataclass(frozen=True)
class Spring:
    """Linear spring on a joint's free coordinate.

    Parameters
    ----------
    stiffness : float
        Force per slide [N/m], or moment per relative rotation [N m/rad].
    rest : float
        Slide [m] or relative rotation [rad] without force.
    """

    stiffness: float
    rest: float = 0.0

    def __post_init__(self):
        _check(self, "stiffness")
        _check(self, "rest", -math.inf)


@dataclass(frozen=True)
class Damper:
    """Linear damper on a joint's free coordinate.

    Parameters
    ----------
    viscosity : float
        Force per rate of the slide [N s/m], or moment per relative spin [N m s/rad].
    """

    viscosity: float

    def __post_init__(self):
        _check(self, "viscosity")


@dataclass(frozen=True)
class Coordinate:
    """What acts on a free coordinate of a joint.

    Parameters
    ----------
    spring : Spring, optional
        Linear spring.
    damper : Damper, optional
        Linear damper.
    motor : callable, optional
        ``motor(t)``, the change of the coordinate since the start; it is then not free.
    """

    spring: Spring | None = None
    damper: Damper | None = None
    motor: Callable[[float], np.ndarray] | None = None


@dataclass(frozen=True, eq=False)
class Joint:
    """Coupling of two nodes; made by `Rigid`, `Revolute`, `Prismatic` and `PinInSlot`.

    The position of b is phi_b = phi_a + R(psi_a) (offset + d axis), with the slide d; the
    rotation psi_b is that of a, or free.

    Parameters
    ----------
    kind : str
        Name of the kind.
    a, b : Node
        The nodes; one may be `GROUND`. The offset and the axis turn with a.
    offset : (2,) float
        From a to the joint, in the reference configuration [m].
    axis : (2,) float, optional
        Unit vector of the slide in the reference configuration.
    slide : Coordinate, optional
        What acts on the slide; none where there is no slide.
    rotation : Coordinate, optional
        What acts on the relative rotation psi_b - psi_a; none where that is not free.
    number : int
        Place in the scene's joints.
    """

    kind: str
    a: Node
    b: Node
    offset: np.ndarray
    axis: np.ndarray | None = None
    slide: Coordinate | None = None
    rotation: Coordinate | None = None
    number: int = field(default=-1)

    def __str__(self):
        number = "" if self.number < 0 else f"joint {self.number}, "
        return f"{number}{self.kind} of {self.a} and {self.b}"

    @property
    def turns_together(self) -> bool:
        """Whether the rotation of b is that of a, a motor's angle apart."""
        return self.rotation is None or self.rotation.motor is not None

    @property
    def is_index(self) -> bool:
        """Whether displacements are simply equal."""
        return self.axis is None and not self.offset.any()

    def start(self) -> tuple[float, float]:
        """Slide and gap at the start.

        Returns
        -------
        slide : float
            Distance along the axis from the joint's place on a to b [m].
        gap : float
            What is left of the distance [m].
        """
        if self.a is GROUND or self.b is GROUND:
            return 0.0, 0.0  # the ground's point is where the joint starts
        distance = np.array([self.b.x - self.a.x, self.b.y - self.a.y]) - self.offset
        slide = 0.0 if self.axis is None else float(distance @ self.axis)
        along = 0.0 if self.axis is None else slide * self.axis
        return slide, float(np.hypot(*(distance - along)))

    def check_start(self, size: float) -> None:
        """Refuse nodes that are not where the joint has them, and motors that do not start from 0.

        Parameters
        ----------
        size : float
            Size of the scene, to which rounding is compared [m].

        Raises
        ------
        SceneError
            With the gap, or where the motor starts.
        """
        _, gap = self.start()
        if gap > 1e-9 * size:
            raise SceneError(
                f"{self}: at the start there is a gap of {gap:.4g} between b and its place on a; "
                "move the nodes, or give the joint an offset"
            )
        for name, coordinate, unit in (("slide", self.slide, size), ("rotation", self.rotation, 1)):
            if coordinate is not None and coordinate.motor is not None:
                place = coordinate.motor(0.0)[0]
                if not abs(place) <= 1e-9 * unit:
                    raise SceneError(
                        f"{self}: the motor of its {name} is {place:g} at t = 0; it must start "
                        "from 0"
                    )


def Rigid(a: Node, b: Node, offset=(0.0, 0.0)) -> Joint:
    """Rigid joint: b moves and turns with a.

    Parameters
    ----------
    a, b : Node
        The nodes; one may be `GROUND`.
    offset : (x, y)
        From a to b in the reference configuration [m].

    Returns
    -------
    Joint
        The joint, for `Scene.add_joint`.
    """
    return _joint("Rigid", a, b, offset)


def Revolute(
    a: Node,
    b: Node,
    offset=(0.0, 0.0),
    spring: Spring | None = None,
    damper: Damper | None = None,
    motor=None,
) -> Joint:
    """Hinge: b stays where it is on a, and turns freely.

    Parameters
    ----------
    a, b : Node
        The nodes; one may be `GROUND`.
    offset : (x, y)
        From a to the hinge in the reference configuration [m]; it turns with a.
    spring, damper : Spring, Damper, optional
        On the relative rotation psi_b - psi_a.
    motor : callable, optional
        ``motor(t)``, the relative rotation since the start [rad]; zero at t = 0.

    Returns
    -------
    Joint
        The joint, for `Scene.add_joint`.
    """
    rotation = _coordinate("motor of a revolute joint", spring, damper, motor)
    return _joint("Revolute", a, b, offset, rotation=rotation)


def Prismatic(
    a: Node,
    b: Node,
    axis,
    offset=(0.0, 0.0),
    spring: Spring | None = None,
    damper: Damper | None = None,
    motor=None,
) -> Joint:
    """Prismatic joint: b slides along an axis that a carries, and turns with a.

    Parameters
    ----------
    a, b : Node
        The nodes; a carries the guide. One may be `GROUND`.
    axis : (x, y)
        Direction of the guide in the reference configuration, of any length.
    offset : (x, y)
        From a to a point of the guide in the reference configuration [m].
    spring, damper : Spring, Damper, optional
        On the slide.
    motor : callable, optional
        ``motor(t)``, the slide since the start [m]; zero at t = 0.

    Returns
    -------
    Joint
        The joint, for `Scene.add_joint`.
    """
    slide = _coordinate("motor of a prismatic joint", spring, damper, motor)
    return _joint("Prismatic", a, b, offset, axis, slide)


def PinInSlot(
    a: Node,
    b: Node,
    axis,
    offset=(0.0, 0.0),
    spring: Spring | None = None,
    damper: Damper | None = None,
    motor=None,
    hinge: Coordinate | None = None,
) -> Joint:
    """Pin in a slot: b slides along an axis that a carries, and turns freely.

    Parameters
    ----------
    a, b : Node
        The nodes; a carries the slot. One may be `GROUND`.
    axis : (x, y)
        Direction of the slot in the reference configuration, of any length.
    offset : (x, y)
        From a to a point of the slot in the reference configuration [m].
    spring, damper : Spring, Damper, optional
        On the slide.
    motor : callable, optional
        ``motor(t)``, the slide since the start [m]; zero at t = 0.
    hinge : Coordinate, optional
        What acts on the relative rotation.

    Returns
    -------
    Joint
        The joint, for `Scene.add_joint`.
    """
    slide = _coordinate("motor of a pin in slot", spring, damper, motor)
    hinge = hinge or Coordinate()
    rotation = _coordinate("hinge of a pin in slot", hinge.spring, hinge.damper, hinge.motor)
    return _joint("PinInSlot", a, b, offset, axis, slide, rotation)


def _joint(kind, a, b, offset, axis=None, slide=None, rotation=None) -> Joint:
    for node in (a, b):
        if not isinstance(node, Node):
            raise SceneError(f"{kind}: {node!r} is no node; take one from a beam, or GROUND")
    if a is b:
        raise SceneError(f"{kind}: both of its nodes are {a}")
    if axis is not None:
        axis = vector(axis, 2, f"{kind}: axis")
        length = np.hypot(*axis)
        if length == 0:
            raise SceneError(f"{kind}: axis = {axis} has no direction")
        axis = axis / length
        axis.setflags(write=False)
    offset = vector(offset, 2, f"{kind}: offset")
    if a is GROUND and offset.any():
        raise SceneError(f"{kind}: the ground takes no offset; its point is where {b} starts")
    return Joint(kind, a, b, offset, axis, slide, rotation)


def _coordinate(what: str, spring, damper, motor) -> Coordinate:
    for name, value, wanted in (("spring", spring, Spring), ("damper", damper, Damper)):
        if value is not None and not isinstance(value, wanted):
            raise SceneError(f"{name} = {value!r} must be an fx_beam.{wanted.__name__}")
    if motor is not None:
        motor = time_function(motor, 1, what)
    return Coordinate(spring, damper, motor)


def _check(part: Spring | Damper, name: str, lowest: float = 0.0) -> None:
    """Refuse what is no number in range, and keep it as a float."""
    value = getattr(part, name)
    if not (is_number(value) and value >= lowest):
        wanted = "finite" if lowest < 0 else "finite and not negative"
        raise SceneError(f"{type(part).__name__}: {name} = {value!r} must be {wanted}")
    object.__setattr__(part, name, float(value))
