"""Obstacles: lines and circles, fixed or carried by a node, that points cannot enter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.validation import (
    as_float,
    finite,
    is_flag,
    is_number,
    is_whole,
    numbers,
    require,
    set_finite,
    shown,
    vector,
)

from .beam import Beam, Node, inner_positions, lagrange, position_of
from .coordinate import Coulomb
from .joints import GROUND
from .law import Energy, check_energy
from .loads import label
from .stop import checked_impact, loss_of

# Lengths that belong to the nodes of an element, by its degree, relative to its own: the weights of
# the rule that integrates the nodes' polynomials.
_SHARES = {
    1: np.array([1, 1]) / 2,
    2: np.array([1, 4, 1]) / 6,
    3: np.array([1, 3, 3, 1]) / 8,
}
# Most integration points in an element.
_MOST_POINTS = 50


def _place(given: Any, what: str) -> Any:
    """A node that carries a shape, or the point (x, y) of one that is fixed."""
    if isinstance(given, Node) and given is not GROUND:
        return given
    if not isinstance(given, list | tuple | np.ndarray):
        wanted = "(x, y), or a node that carries it: beam.end, body.centre, body[name]"
        given = "the ground" if given is GROUND else shown(given)
        raise SceneError(f"{what} = {given} must be {wanted}")
    x, y = vector(given, 2, what).tolist()
    return x, y


@dataclass(frozen=True)
class Line:
    """A straight wall, fixed or carried by a node; others stay where its normal points.

    Parameters
    ----------
    point : (x, y) or Node
        A point of the wall [m]; or a node of a beam or body with which it moves and turns.
    normal : (x, y)
        Direction from the wall to the free side, of any length; in the reference configuration if
        it is carried by a node.

    Raises
    ------
    SceneError
        For a normal without direction, or values that are not finite.

    Examples
    --------
    >>> import fx_beam as fb
    >>> floor = fb.Line((0, -1), normal=(0, 2))
    >>> float(floor.gap((5.0, 0.5)))
    1.5
    """

    point: Any
    normal: Any

    def __post_init__(self):
        normal = vector(self.normal, 2, "Line: normal")
        if not normal.any():
            raise SceneError(f"Line: normal = {self.normal!r} has no direction")
        length = np.hypot(*normal)
        if abs(length - 1) > 4e-16:  # a unit vector stays as it is, to the last digit
            normal = normal / length
        object.__setattr__(self, "normal", tuple(normal.tolist()))
        object.__setattr__(self, "point", _place(self.point, "Line: point"))

    @property
    def carrier(self) -> Node | None:
        """The node that carries it; None for a fixed one."""
        return self.point if isinstance(self.point, Node) else None

    @property
    def origin(self) -> tuple[float, float]:
        """A point of it in the reference configuration [m]."""
        return position_of(self.point)

    def gap(self, positions) -> np.ndarray:
        """Distance of positions from the wall, in its reference configuration if it is carried.

        Parameters
        ----------
        positions : (..., 2) float
            Positions [m].

        Returns
        -------
        (...) float
            Distance [m]; negative behind the wall.
        """
        return (_checked("Line", positions) - self.origin) @ np.array(self.normal)


@dataclass(frozen=True)
class Circle:
    """A circle, fixed or carried by a node; others stay outside of it, or inside.

    Parameters
    ----------
    centre : (x, y) or Node
        Its centre [m]; or a node of a beam or body with which it moves.
    radius : float
        Its radius [m].
    inside : bool
        Whether nodes stay inside.

    Raises
    ------
    SceneError
        For a radius that is not positive, or values that are not finite.

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.Circle((0, 0), 2.0).gap([(3.0, 0.0), (0.0, 1.0)])
    array([ 1., -1.])
    """

    centre: Any
    radius: float
    inside: bool = False

    def __post_init__(self):
        set_finite(self, "radius", "positive")
        require(is_flag(self.inside), "Circle: inside", self.inside, "True or False")
        object.__setattr__(self, "centre", _place(self.centre, "Circle: centre"))

    @property
    def carrier(self) -> Node | None:
        """The node that carries it; None for a fixed one."""
        return self.centre if isinstance(self.centre, Node) else None

    @property
    def origin(self) -> tuple[float, float]:
        """Its centre in the reference configuration [m]."""
        return position_of(self.centre)

    def gap(self, positions) -> np.ndarray:
        """Distance of positions from the circle, in its reference configuration if it is carried.

        Parameters
        ----------
        positions : (..., 2) float
            Positions [m].

        Returns
        -------
        (...) float
            Distance [m]; negative on the side that is not allowed.
        """
        x, y = np.moveaxis(_checked("Circle", positions) - self.origin, -1, 0)
        distance = np.hypot(x, y) - self.radius
        return -distance if self.inside else distance


def _checked(what: str, positions) -> np.ndarray:
    """Positions (..., 2) as an array."""
    checked = numbers(positions)
    fits = checked.ndim > 0 and checked.shape[-1] == 2
    require(fits, f"{what}.gap: positions", positions, "positions (x, y)")
    return checked


def moved(shape: Line | Circle, q: np.ndarray) -> Line | Circle:
    """A shape where its carrier has moved by q = (u_x, u_y, rotation); a fixed one as it is."""
    if shape.carrier is None:
        return shape
    x, y = (float(p + u) for p, u in zip(shape.origin, q[:2], strict=True))
    if isinstance(shape, Circle):
        return Circle((x, y), shape.radius, shape.inside)
    c, s = np.cos(q[2]), np.sin(q[2])
    a, b = shape.normal
    return Line((x, y), (c * a - s * b, s * a + c * b))


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A line or circle that a node or points of a beam may touch but not enter.

    Created by `Scene.add_obstacle` and `Scene.add_contact`.

    Parameters
    ----------
    target : Node or Beam
        What it stops.
    shape : Line, Circle or Beam
        The line or circle, fixed or carried by a node; or the member that it touches.
    stiffness : float
        Stiffness of a node [N/m], of a beam per length [N/m^2]; 1 with an energy.
    restitution : float
        Coefficient of restitution e.
    speed : float, optional
        Speed below which the loss is viscous [m/s].
    number : int
        Number among the scene's obstacles.
    energy : callable, optional
        Stored energy of the depth, in the place of a stiffness.
    radius : float or pair
        Half of the thickness of a beam, or radius of a ball around a node [m]; between members that
        of both.
    along : int, optional
        Number of integration points in each element of a beam; without it its nodes touch.
    friction : Coulomb, optional
        Friction that sticks.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 1), (1, 1)], fb.Section(EA=1.0, GA=1.0, EI=1.0), name="bar")
    >>> print(scene.add_obstacle(beam, fb.Line((0, 0), normal=(0, 1)), stiffness=1e3))
    obstacle 0, Line for beam 'bar'
    """

    target: Node | Beam
    shape: Line | Circle | Beam
    stiffness: float
    restitution: float = 1.0
    speed: float | None = None
    number: int = -1
    energy: Energy | None = None
    radius: float | tuple[float, float] = 0.0
    along: int | None = None
    friction: Coulomb | None = None

    def __repr__(self):
        law = f"stiffness {self.stiffness:g} N/m" if self.energy is None else "energy of its own"
        return f"<{self}, {law}>"

    def __str__(self):
        number = "" if self.number < 0 else f"obstacle {self.number}, "
        if isinstance(self.shape, Beam):
            other = "itself" if self.shape is self.target else label(self.shape)
            return f"{number}{label(self.target)} against {other}"
        carrier = f" on {self.shape.carrier}" if self.shape.carrier is not None else ""
        return f"{number}{type(self.shape).__name__}{carrier} for {label(self.target)}"

    @property
    def loss(self) -> float:
        """Dissipative part r of the force, relative to the elastic part."""
        return loss_of(self.restitution)

    @property
    def radii(self) -> float:
        """Half thickness of what touches; between members the sum of both [m]."""
        return float(np.sum(self.radius))

    @property
    def apart(self) -> float:
        """How far apart along a member its parts must be to touch one another [m]."""
        longest = np.hypot(*np.diff(start_of(self.target), axis=0).T).max(initial=0.0)
        return float(np.pi / 2 * self.radii + 2 * longest)

    @property
    def variables(self) -> int:
        """Number of internal variables of its friction with a shape: two for each point."""
        sticks = self.friction is not None and not isinstance(self.shape, Beam)
        return 2 * len(self.points.lengths) if sticks else 0

    @property
    def points(self) -> Points:
        """The points that touch it."""
        return points_of(self.target, self.along)


class Points(NamedTuple):
    """Points of a node or beam: sums of its nodes, along the beam with those inside elements."""

    #: Nodes (points, n) of each point, by their place along the beam, and weights (points, n).
    nodes: np.ndarray
    weights: np.ndarray
    #: Length of the beam that belongs to each (points,) [m]; 1 for a node.
    lengths: np.ndarray

    def of(self, values: np.ndarray) -> np.ndarray:
        """Values (..., points, k) at the points of those (..., nodes, k) at the nodes."""
        if self.nodes.shape[1] == 1:
            return self.weights * values[..., self.nodes[:, 0], :]
        return np.einsum("pn,...pnk->...pk", self.weights, values[..., self.nodes, :])


def points_of(target: Node | Beam, along: int | None = None) -> Points:
    """The points of a node, or of a beam at its nodes or `along` its elements."""
    if not isinstance(target, Beam):
        return Points(np.zeros((1, 1), dtype=int), np.ones((1, 1)), np.ones(1))
    degree, lengths = target.degree, np.diff(target.s)
    firsts = degree * np.arange(target.elements)
    if along is None:
        at_nodes = np.zeros(target.elements * degree + 1)
        of_element = firsts[:, None] + np.arange(degree + 1)
        np.add.at(at_nodes, of_element, lengths[:, None] * _SHARES[degree])
        return Points(np.arange(len(at_nodes))[:, None], np.ones((len(at_nodes), 1)), at_nodes)
    places, shares = np.polynomial.legendre.leggauss(along)
    values = lagrange(np.linspace(0, 1, degree + 1), (places + 1) / 2)
    nodes = np.repeat(firsts[:, None] + np.arange(degree + 1), along, axis=0)
    weights = np.tile(values, (target.elements, 1))
    return Points(nodes, weights, (lengths[:, None] * shares / 2).ravel())


def checked_obstacle(
    target: Beam | Node,
    shape: Line | Circle | Beam,
    impact: tuple,
    number: int,
    radius: Any = 0.0,
    along: int | None = None,
    friction: Coulomb | None = None,
) -> Obstacle:
    """An obstacle with valid numbers. SceneError for others; where it starts is not checked."""
    if not isinstance(shape, Line | Circle | Beam):
        raise SceneError(
            f"a contact needs an fx_beam.Line, an fx_beam.Circle or a beam, not {shown(shape)}. A "
            "body has none of its own: give it one, such as fx_beam.Circle(body.centre, radius)"
        )
    what, (stiffness, restitution, speed, energy) = f"obstacle for {label(target)}", impact
    if (stiffness is None) == (energy is None):
        raise SceneError(f"{what}: give either a stiffness or an energy")
    if energy is not None:
        check_energy(energy, None, what, ("d",), "energy")
        stiffness = 1.0
    impact = checked_impact(what, stiffness, restitution, speed)
    if isinstance(shape, Beam):
        radius = checked_radii(what, radius)
    else:
        radius = finite(radius, f"{what}: radius", "not negative")
    if along is not None:
        require(isinstance(target, Beam), f"{what}: along", along, "None, as a node has no length")
        fits = is_whole(along, 1, _MOST_POINTS)
        require(fits, f"{what}: along", along, f"a whole number from 1 to {_MOST_POINTS}, or None")
        along = int(along)
    fits = friction is None or isinstance(friction, Coulomb)
    require(fits, f"{what}: friction", friction, "an fx_beam.Coulomb(mu, stiffness), or None")
    if friction is not None and friction.radius is not None:
        raise SceneError(f"{what}: friction has the radius of a pin, {friction.radius:g}; omit it")
    return Obstacle(target, shape, *impact, number, energy, radius, along, friction)


def checked_radii(what: str, radius: Any) -> tuple[float, float]:
    """Half thicknesses of what touches and of the member; one number is that of both."""
    pair = (radius, radius) if is_number(radius) else radius
    fits = isinstance(pair, tuple | list) and len(pair) == 2 and all(map(is_number, pair))
    fits = fits and min(map(as_float, pair)) >= 0 and sum(map(as_float, pair)) > 0
    wanted = "half of the thickness of the members, positive, or a pair of both"
    require(fits, f"{what}: radius", radius, wanted)
    first, second = map(as_float, pair)
    return first, second


def check_start(made: Obstacle, size: float) -> None:
    """SceneError if the target starts behind a shape, in a scene of this size [m]."""
    target, shape = made.target, made.shape
    assert isinstance(shape, Line | Circle)
    if isinstance(shape, Circle) and shape.inside and shape.radius <= made.radii:
        raise SceneError(f"{made}: its radius {shape.radius:g} must be above that of the inner one")
    nodes = target.nodes if isinstance(target, Beam) else (target,)
    if shape.carrier is not None and shape.carrier in nodes:
        raise SceneError(
            f"{made}: {shape.carrier} carries the {type(shape).__name__.lower()} and belongs to "
            "what it should stop. Let a node of another member or body carry it"
        )
    positions = start_of(made.target)
    inside = made.points.of(positions)
    gaps = shape.gap(inside) - made.radii
    deepest = int(np.argmin(gaps))
    if gaps[deepest] < -1e-9 * max(size, float(np.ptp(positions, axis=0).max())):
        x, y = inside[deepest]
        raise SceneError(
            f"{made}: the {'node' if made.along is None else 'point'} at ({x:.6g}, {y:.6g}) starts "
            f"{-gaps[deepest]:.4g} behind it. Move it, or give the other side: the opposite "
            "normal of a Line, or inside of a Circle"
        )


def start_of(target: Node | Beam) -> np.ndarray:
    """Positions (nodes, 2) of a node or of all nodes of a beam in order, in the reference [m]."""
    if not isinstance(target, Beam):
        return np.array([(target.x, target.y)])
    positions = np.empty((target.elements * target.degree + 1, 2))
    positions[:: target.degree] = [(node.x, node.y) for node in target.nodes]
    inner = inner_positions(target).reshape(target.elements, -1, 2)
    for i in range(target.degree - 1):
        positions[i + 1 :: target.degree] = inner[:, i]
    return positions
