"""Forces between two nodes, or between a node and a fixed point, as plain data."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from fx_beam.errors import NUMBER, SceneError, numbers, vector
from fx_beam.symbolic import ufl

from .beam import Node, position_of
from .coordinate import Coordinate, Coulomb, functions_of
from .notebook import html_table
from .parameters import value_of

if TYPE_CHECKING:
    from .symbols import Parameter

#: ``force(distance, rate, t)`` in UFL.
Pull = Callable[[Any, Any, Any], Any]


@dataclass(frozen=True)
class GivenPull:
    """A pull that is a number or an input."""

    pull: Parameter

    def __call__(self, distance, rate, t):
        """The pull [N]."""
        return self.pull


@dataclass(frozen=True, eq=False)
class ForceBetween:
    """A force along the line between two points; created by `Scene.add_force_between`.

    Parameters
    ----------
    a : Node
        A node.
    b : Node or (2,) float array
        Another node, or a fixed point [m].
    on : Coordinate
        Spring, damper, friction and stops on the distance.
    force : callable, optional
        ``force(distance, rate, t)``, a pull [N].
    number : int
        Index in the scene's forces between points.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> ball = scene.add_body((0, -2), mass=1.0, inertia=0.1, name="ball").centre
    >>> print(scene.add_force_between(ball, (0, 0), spring=fb.Spring(100.0, rest=2.0)))
    force 0, between node 0 at (0, -2) and (0, 0)
    """

    a: Node
    b: Any = field(metadata=NUMBER)
    on: Coordinate
    force: Pull | None = field(default=None, metadata=NUMBER)
    number: int = -1

    def __repr__(self):
        return f"<{self}>"

    def _repr_html_(self):
        rows = {"laws": str(self.on)} if self.on.acts else {}
        if self.force is not None:
            rows["force"] = "a function" if callable(self.force) else str(self.force)
        return html_table(str(self), rows)

    def __str__(self):
        number = "" if self.number < 0 else f"force {self.number}, "
        end = self.b if isinstance(self.b, Node) else "({:g}, {:g})".format(*self.b)
        return f"{number}between {self.a} and {end}"

    @property
    def between(self) -> tuple[int, int]:
        """Numbers of the nodes, from the first to the second; -1 for a fixed point, the first."""
        return (self.a.number, self.b.number) if isinstance(self.b, Node) else (-1, self.a.number)

    @property
    def apart(self) -> np.ndarray:
        """Vector (2,) from the first point of `between` to the second, at the start [m]."""
        start, end = position_of(self.a), position_of(self.b)
        start, end = (start, end) if isinstance(self.b, Node) else (end, start)
        return numbers([end[0] - start[0], end[1] - start[1]])

    @property
    def functions(self) -> list[tuple[str, Any]]:
        """Expressions of the user's functions, by kind."""
        functions = [*functions_of(self.on)]
        if self.force is not None:
            from .symbols import SCALARS

            functions.append(("force", ufl.as_ufl(self.force(*SCALARS[:3]))))
        return functions


def checked_force(a: Node, b: Any, on: Coordinate, force: Any, number: int, size: float):
    """A force of a scene of this size [m]; SceneError if its laws are not finite at the start."""
    if force is not None and not callable(force):
        from .symbols import Parameter

        force = GivenPull(Parameter(f"force {number} between points", force))
    if not isinstance(b, Node):
        b = vector(b, 2, "force between points: b, a node or a fixed point,")
    made = ForceBetween(a, b, on, force, number)
    distance = math.hypot(*made.apart)
    if distance <= 1e-12 * size:
        raise SceneError(f"{made}: the points are at the same place, so that no direction is known")
    if not (on.acts or force is not None):
        raise SceneError(f"{made}: give a spring, damper, friction, stop or force")
    if isinstance(on.friction, Coulomb):
        raise SceneError(
            f"{made}: fx_beam.Coulomb needs a normal force, which a force between two points has "
            "not. Use fx_beam.SmoothFriction"
        )
    if on.stop is not None:
        on.stop.check_start(distance, 1e-9 * size, f"{made}: the distance")
    if on.spring is not None and on.spring.strain_energy is not None and not on.spring.internal:
        _check(on.spring.strain_energy, (distance - on.spring.rest,), made, "strain_energy(x)")
    if force is not None:
        _check(force, (distance, 0.0, 0.0), made, "force(distance, rate, t)")
    return made


def _check(function: Callable, at: tuple[float, ...], what: ForceBetween, call: str) -> None:
    """Refuse a function that is no scalar UFL expression, or not finite at the start."""
    value = value_of(function, at, f"{what}: {call}")
    if isinstance(value, complex) or not math.isfinite(value):
        raise SceneError(f"{what}: {call} is {value} at the start, at {at[0]:.6g}")
