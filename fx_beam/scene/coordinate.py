"""Springs, dampers and motors on the coordinates of joints."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.validation import is_number, time_function


@dataclass(frozen=True)
class Spring:
    """Linear spring on a joint's free coordinate.

    Parameters
    ----------
    stiffness : float
        Force per slide [N/m], or moment per relative rotation [N m/rad].
    rest : float
        Slide [m] or relative rotation [rad] at which the spring is free of force.

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.Spring(stiffness=50, rest=0.1)
    Spring(stiffness=50.0, rest=0.1)
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
        Force per slide rate [N s/m], or moment per relative spin [N m s/rad].

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.Damper(viscosity=2)
    Damper(viscosity=2.0)
    """

    viscosity: float

    def __post_init__(self):
        _check(self, "viscosity")


@dataclass(frozen=True)
class Coordinate:
    """Spring, damper and motor on a coordinate of a joint.

    Parameters
    ----------
    spring : Spring, optional
        Linear spring.
    damper : Damper, optional
        Linear damper.
    motor : callable, optional
        ``motor(t)``, the change of the coordinate since the start. It prescribes the coordinate.

    Examples
    --------
    >>> import fx_beam as fb
    >>> hinge = fb.Coordinate(spring=fb.Spring(stiffness=2.0), damper=fb.Damper(viscosity=0.1))
    >>> hinge.spring.stiffness
    2.0
    """

    spring: Spring | None = None
    damper: Damper | None = None
    motor: Callable[[float], np.ndarray] | None = None


def checked_coordinate(what: str, spring, damper, motor) -> Coordinate:
    """Coordinate of checked parts."""
    for name, value, wanted in (("spring", spring, Spring), ("damper", damper, Damper)):
        if value is not None and not isinstance(value, wanted):
            raise SceneError(f"{name} = {value!r} must be an fx_beam.{wanted.__name__}")
    if motor is not None:
        motor = time_function(motor, 1, what)
    return Coordinate(spring, damper, motor)


def _check(part: Spring | Damper, name: str, lowest: float = 0.0) -> None:
    """Refuse a value that is not a number in range; keep it as a float."""
    value = getattr(part, name)
    if not (is_number(value) and value >= lowest):
        wanted = "finite" if lowest < 0 else "finite and not negative"
        raise SceneError(f"{type(part).__name__}: {name} = {value!r} must be {wanted}")
    object.__setattr__(part, name, float(value))
