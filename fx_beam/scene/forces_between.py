"""Forces along lines: between two points, and of ropes over several, as plain data."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np

from fx_beam.dual import dual_array, scene_number
from fx_beam.errors import IS_DATA, SceneError, real_array, require, vector
from fx_beam.symbolic import Expr, ufl

from .beam import Node, position_of
from .coordinate import Coordinate, Coulomb, Spring, functions_of
from .inputs import TimeValue
from .parameters import is_parameter, value_of

if TYPE_CHECKING:
    from .symbols import Parameter

#: A point as users give it.
Point = Node | Sequence[float] | np.ndarray
#: ``force(distance, rate, t)`` in UFL.
Pull = Callable[[Expr, Expr, Expr], Expr]


def _given_pull(pull: Parameter, *arguments: Expr) -> Parameter:
    """A pull that is a number or an input [N]."""
    return pull


@dataclass(frozen=True, eq=False)
class FixedPoint:
    """A place to which a force or a rope is fixed, or over which a rope runs."""

    position: np.ndarray = field(metadata=IS_DATA)

    def __str__(self):
        return "({:g}, {:g})".format(*self.position)


@dataclass(frozen=True, eq=False)
class ForceBetween:
    """A force along the line between two points, or a rope over several.

    Created by `Scene.add_force_between` and `Scene.add_rope`.

    Parameters
    ----------
    points : tuple of Node or FixedPoint
        The points of the line in order: nodes and places.
    on : Coordinate
        Spring, damper, friction and stops on the distance, or on the length of the rope.
    force : callable, optional
        ``force(distance, rate, t)``, a pull [N].
    number : int
        Index in the scene's forces between points.
    own : tuple of str
        Names of the parameters that it has alone.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> ball = scene.add_body((0, -2), mass=1.0, inertia=0.1, name="ball").centre
    >>> print(scene.add_force_between(ball, (0, 0), spring=fb.Spring(100.0, rest=2.0)))
    force 0, between node 0 at (0, -2) and (0, 0)
    """

    points: tuple[Node | FixedPoint, ...]
    on: Coordinate
    force: Pull | None = field(default=None, metadata=IS_DATA)
    number: int = -1
    own: tuple[str, ...] = ()
    #: Whether it acts between its target and the ground, along a direction.
    to_ground: ClassVar[bool] = False
    #: Whether it holds the nodes of a beam.
    is_bed: ClassVar[bool] = False
    #: Kinds of the points of a rope over pulleys; empty for others.
    kinds: ClassVar[str] = ""

    def __repr__(self):
        return f"<{self}>"

    def _repr_html_(self):
        from .notebook import html_table

        rows = {"laws": str(self.on)} if self.on.acts else {}
        if self.force is not None:
            rows["force"] = "a function" if callable(self.force) else str(self.force)
        return html_table(str(self), rows)

    def __str__(self):
        number = "" if self.number < 0 else f"force {self.number}, "
        if len(self.points) == 2:
            return f"{number}between {self.a} and {self.points[1]}"
        return f"{number}over {', '.join(map(str, self.points))}"

    @property
    def a(self) -> Node | np.ndarray:
        """The first point: a node or a position (2,) [m]."""
        return _node_or_position(self.points[0])

    @property
    def b(self) -> Node | np.ndarray:
        """The last point: a node or a position (2,) [m]."""
        return _node_or_position(self.points[-1])

    @property
    def nodes(self) -> tuple[int, ...]:
        """Numbers of the nodes in order; -1 for a fixed point."""
        return tuple(p.number if isinstance(p, Node) else -1 for p in self.points)

    @property
    def apart(self) -> np.ndarray:
        """Vectors (points - 1, 2) from each point to the next one, at the start [m]."""
        positions = [position_of(_node_or_position(point)) for point in self.points]
        return real_array([[y[0] - x[0], y[1] - x[1]] for x, y in itertools.pairwise(positions)])

    def straight(self, ways: np.ndarray) -> np.ndarray:
        """Straight parts of the line.

        Parameters
        ----------
        ways : (n - 1, 2) float
            Vectors from each point to the next one [m].

        Returns
        -------
        (n - 1, 2) float
            Vectors of the straight parts [m].
        """
        return ways

    @property
    def geometry(self) -> list[float]:
        """Numbers of its length: vectors from each point to the next one; of circles more."""
        return [component for way in self.apart for component in way]

    def vectors(self, numbers: Any, moved: Sequence) -> list[tuple]:
        """Vectors from each point to the next one.

        Parameters
        ----------
        numbers, moved : sequence
            As of `length`.

        Returns
        -------
        list of (x, y)
            Their components [m].
        """
        return [(numbers[2 * i] + x, numbers[2 * i + 1] + y) for i, (x, y) in enumerate(moved)]

    def length(
        self, numbers: Any, moved: Sequence, turned: Sequence, counted: np.ndarray | None = None
    ) -> Any:
        """The sum of distances, or of free spans and arcs.

        Parameters
        ----------
        numbers : sequence of float
            Those of `geometry`, which may have slopes.
        moved : sequence of (x, y)
            Changes of the vectors from each point to the next one [m]; components (...) may have
            slopes.
        turned : (first, last)
            Rotations of drums at both ends [rad].
        counted : (..., points - 1) float, optional
            Half turns that the spans of a rope over pulleys have turned [rad].

        Returns
        -------
        (...) float
            The length [m].
        """
        return sum(np.hypot(x, y) for x, y in self.vectors(numbers, moved))

    def rate(self, numbers: Any, moved: Sequence, rates: Sequence, spins: Sequence) -> Any:
        """Rate of the length.

        Parameters
        ----------
        numbers, moved : sequence
            As of `length`.
        rates : sequence of (x, y)
            Rates of the vectors from each point to the next one [m/s].
        spins : (first, last)
            Spins of drums at both ends [rad/s].

        Returns
        -------
        (...) float
            The rate [m/s].
        """
        pairs = zip(self.vectors(numbers, moved), rates, strict=True)
        return sum((x * vx + y * vy) / np.hypot(x, y) for (x, y), (vx, vy) in pairs)

    @property
    def length_at_start(self) -> float:
        """Distance of the points, or the sum of those along a rope, at the start [m]."""
        return math.fsum(math.hypot(*way) for way in self.apart)

    @property
    def drawn_length(self) -> float:
        """The length at the start, with the slopes that it has [m]."""
        moved = [(0.0, 0.0)] * (len(self.points) - 1)
        return scene_number(self.length(dual_array(self.geometry), moved, (0.0, 0.0)))

    @property
    def functions(self) -> list[tuple[str, Expr]]:
        """Expressions of the user's functions, by kind."""
        functions = [*functions_of(self.on)]
        if self.force is not None:
            from .symbols import SCALARS

            functions.append(("force", ufl.as_ufl(self.force(*SCALARS[:3]))))
        return functions


def _node_or_position(point: Node | FixedPoint) -> Node | np.ndarray:
    return point if isinstance(point, Node) else point.position


@dataclass(frozen=True)
class RopeSpring(Spring):
    """A linear spring that only pulls, from a length on; both numbers are parameters."""

    slope: Any = field(default=None, metadata=IS_DATA)
    length: Any = field(default=None, metadata=IS_DATA)


def parameter_of_length(length: Any, number: int) -> str:
    """Name of the parameter that is the length of a rope."""
    return length.name if is_parameter(length) else f"length of rope {number}"


def rope_spring(spring, length: TimeValue, number: int) -> tuple[RopeSpring, tuple[str, ...]]:
    """A spring that only pulls, from a length on, and names of parameters made for it.

    SceneError if no linear spring is given.
    """
    from .symbols import Parameter

    ok = isinstance(spring, Spring) and spring.stiffness > 0
    ok = ok and spring.strain_energy is None and spring.rest == 0
    expected = "a linear fx_beam.Spring(k) without a rest, as the rope has a length"
    require(ok, f"rope {number}: spring", spring, expected)
    k = Parameter(f"stiffness of rope {number}", spring.stiffness)
    names: tuple[str, ...] = (k.name,)
    if not is_parameter(length):
        length = Parameter(parameter_of_length(length, number), length)
        names = (*names, length.name)

    def energy(x):
        return ufl.conditional(ufl.gt(x, length), k / 2 * (x - length) ** 2, 0.0)

    return RopeSpring(strain_energy=energy, slope=k, length=length), names


def _with_rope(
    laws: Coordinate, force: object, length: TimeValue | None, number: int
) -> tuple[Coordinate, tuple[str, ...]]:
    """Laws with the spring of a rope of a length, and names of parameters made for it.

    An upper stop with a damper or friction, and no spring or force, is a rope: else they would push
    where it is slack. SceneError if it has a loss of its own.
    """
    stop, resists = laws.stop, laws.damper or laws.friction
    is_alone = length is None and laws.spring is None and force is None
    if is_alone and resists and stop is not None and stop.lower is None:
        if stop.restitution < 1:
            raise SceneError(
                f"force {number}: its stop has restitution = {stop.restitution!r}, and there is a "
                "damper or friction, which acts while a rope is taut. Give one of them"
            )
        laws, length = replace(laws, spring=Spring(stop.stiffness), stop=None), stop.upper
    if length is None:
        return laws, ()
    spring, names = rope_spring(laws.spring, length, number)
    return replace(laws, spring=spring), names


def checked_force(
    scene, points: Sequence, coordinate: Coordinate, force, length=None, make=ForceBetween
) -> ForceBetween:
    """A new force of a scene; SceneError if a law is not finite at the start."""
    number, size = scene.force_count, scene.nodes.size
    coordinate, names = _with_rope(coordinate, force, length, number)
    if force is not None and not callable(force):
        from .symbols import Parameter

        name = f"force {number} between points"
        force, names = functools.partial(_given_pull, Parameter(name, force)), (*names, name)
    new = make(_points(points), coordinate, force, number, names)
    if min(math.hypot(*way) for way in new.apart) <= 1e-12 * size:
        raise SceneError(f"{new}: the points are at the same place, so that no direction is known")
    distance = new.length_at_start
    if not (coordinate.acts or force is not None):
        raise SceneError(f"{new}: give a spring, damper, friction, stop or force")
    if isinstance(coordinate.friction, Coulomb):
        raise SceneError(
            f"{new}: fx_beam.Coulomb needs a normal force, which a force between two points has "
            "not. Use fx_beam.SmoothFriction"
        )
    check_at_start(new, distance, 1e-9 * size, "the distance")
    if force is not None:
        _check(force, (distance, 0.0, 0.0), new, "force(distance, rate, t)")
    return new


def check_at_start(force: ForceBetween, place: float, tolerance: float, name: str) -> None:
    """SceneError if a force starts beyond a stop, or its stored energy is not finite there."""
    stop, spring = force.on.stop, force.on.spring
    if stop is not None:
        stop.check_start(place, tolerance, f"{force}: {name}")
    if spring is not None and spring.strain_energy is not None and not spring.internal:
        _check(spring.strain_energy, (place - spring.rest,), force, "strain_energy(x)")


def _points(points: Sequence) -> tuple[Node | FixedPoint, ...]:
    """Nodes and fixed points; SceneError for anything else."""
    name = "force between points: b, a node or a fixed point,"
    if len(points) > 2:
        name = "rope: a point, a node or a fixed one,"
    return tuple(p if isinstance(p, Node) else FixedPoint(vector(p, 2, name)) for p in points)


def _check(function: Callable, arguments: tuple[float, ...], part: ForceBetween, call: str) -> None:
    """Refuse a function that is no scalar UFL expression, or not finite at the start."""
    value = value_of(function, arguments, f"{part}: {call}")
    if isinstance(value, complex) or not math.isfinite(value):
        raise SceneError(f"{part}: {call} is {value} at the start, at {arguments[0]:.6g}")
