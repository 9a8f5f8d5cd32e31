"""Obstacles: fixed lines and circles that nodes cannot enter, as plain data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.deprecation import formerly
from fx_beam.errors import SceneError
from fx_beam.validation import as_float, is_flag, is_number, numbers, require, shown, vector

from .beam import Beam, Node, inner_positions
from .law import Energy, check_energy
from .loads import label
from .stop import checked_impact, loss_of

_FIXED = "2 numbers: obstacles are fixed, they do not move with a node"


@dataclass(frozen=True)
class Line:
    """A fixed straight wall; nodes stay on the side to which its normal points.

    Parameters
    ----------
    point : (x, y)
        A point of the wall [m].
    normal : (x, y)
        Direction from the wall to the free side, of any length.

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
        require(not isinstance(self.point, Node), "Line: point", self.point, _FIXED)
        point = vector(self.point, 2, "Line: point")
        object.__setattr__(self, "point", tuple(point.tolist()))

    @formerly(places="positions")
    def gap(self, positions) -> np.ndarray:
        """Distance of positions from the wall.

        Parameters
        ----------
        positions : (..., 2) float
            Positions [m].

        Returns
        -------
        (...) float
            Distance [m]; negative behind the wall.
        """
        return (_checked("Line", positions) - self.point) @ np.array(self.normal)


@dataclass(frozen=True)
class Circle:
    """A fixed circle; nodes stay outside of it, or inside.

    Parameters
    ----------
    centre : (x, y)
        Its centre [m].
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
        fits = is_number(self.radius) and as_float(self.radius) > 0
        require(fits, "Circle: radius", self.radius, "finite and positive")
        require(is_flag(self.inside), "Circle: inside", self.inside, "True or False")
        object.__setattr__(self, "radius", as_float(self.radius))
        require(not isinstance(self.centre, Node), "Circle: centre", self.centre, _FIXED)
        centre = vector(self.centre, 2, "Circle: centre")
        object.__setattr__(self, "centre", tuple(centre.tolist()))

    @formerly(places="positions")
    def gap(self, positions) -> np.ndarray:
        """Distance of positions from the circle.

        Parameters
        ----------
        positions : (..., 2) float
            Positions [m].

        Returns
        -------
        (...) float
            Distance [m]; negative on the side that is not allowed.
        """
        x, y = np.moveaxis(_checked("Circle", positions) - self.centre, -1, 0)
        distance = np.hypot(x, y) - self.radius
        return -distance if self.inside else distance


def _checked(what: str, positions) -> np.ndarray:
    """Positions (..., 2) as an array."""
    checked = numbers(positions)
    fits = checked.ndim > 0 and checked.shape[-1] == 2
    require(fits, f"{what}.gap: positions", positions, "positions (x, y)")
    return checked


@dataclass(frozen=True, eq=False)
class Obstacle:
    """A line or circle that a node, or all nodes of a beam, may touch but not enter.

    Created by `Scene.add_obstacle`.

    Parameters
    ----------
    target : Node or Beam
        What it stops.
    shape : Line or Circle
        The line or circle.
    stiffness : float
        Stiffness of a node [N/m], of a beam per length [N/m^2]; 1 with an energy.
    restitution : float
        Coefficient of restitution e.
    speed : float, optional
        Speed below which the loss is viscous [m/s].
    number : int
        Index in the scene's obstacles.
    energy : callable, optional
        Stored energy of the depth, in the place of a stiffness.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 1), (1, 1)], fb.Section(EA=1.0, GA=1.0, EI=1.0), name="bar")
    >>> print(scene.add_obstacle(beam, fb.Line((0, 0), normal=(0, 1)), stiffness=1e3))
    obstacle 0, Line for beam 'bar'
    """

    target: Node | Beam
    shape: Line | Circle
    stiffness: float
    restitution: float = 1.0
    speed: float | None = None
    number: int = -1
    energy: Energy | None = None

    def __repr__(self):
        return f"<{self}, stiffness {self.stiffness:g} N/m>"

    def __str__(self):
        number = "" if self.number < 0 else f"obstacle {self.number}, "
        return f"{number}{type(self.shape).__name__} for {label(self.target)}"

    @property
    def loss(self) -> float:
        """Dissipative part r of the force, relative to the elastic part."""
        return loss_of(self.restitution)


def checked_obstacle(
    target: Beam | Node, shape: Line | Circle, impact: tuple, number: int, size: float
) -> Obstacle:
    """An obstacle of a scene of this size [m]; SceneError if the target starts behind it."""
    if not isinstance(shape, Line | Circle):
        raise SceneError(
            f"add_obstacle needs an fx_beam.Line or an fx_beam.Circle, not {shown(shape)}"
        )
    what, (stiffness, restitution, speed, energy) = f"obstacle for {label(target)}", impact
    if (stiffness is None) == (energy is None):
        raise SceneError(f"{what}: give either a stiffness or an energy")
    if energy is not None:
        check_energy(energy, None, what, ("d",), "energy")
        stiffness = 1.0
    impact = checked_impact(what, stiffness, restitution, speed)
    made = Obstacle(target, shape, *impact, number, energy)
    nodes = target.nodes if isinstance(target, Beam) else (target,)
    positions = np.array([(node.x, node.y) for node in nodes])
    if isinstance(target, Beam):
        positions = np.concatenate([positions, inner_positions(target)])
    gaps = shape.gap(positions)
    deepest = int(np.argmin(gaps))
    if gaps[deepest] < -1e-9 * max(size, float(np.ptp(positions, axis=0).max())):
        x, y = positions[deepest]
        raise SceneError(
            f"{made}: the node at ({x:.6g}, {y:.6g}) starts {-gaps[deepest]:.4g} behind it. Move "
            "it, or give the other side: the opposite normal of a Line, or inside of a Circle"
        )
    return made
