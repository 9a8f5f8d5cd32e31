"""Holds of nodes and beams by the ground: springs, dampers, friction, stops and beds."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from fx_beam.errors import IS_DATA, require

from .beam import Beam, Node
from .contacts import points_of
from .coordinate import Coordinate, Damper, SmoothFriction, Spring, Stop
from .forces_between import ForceBetween, check_at_start


@dataclass(frozen=True, eq=False, repr=False)
class GroundSpring(ForceBetween):
    """A spring, damper, friction and stops between a node or a beam and the ground.

    Created by `Scene.add_spring` and `Scene.add_bed`. It acts on the displacement along one
    direction, or on the rotation of a node. Of a beam all laws are per length.

    Parameters
    ----------
    points : tuple of Node
        The node, or the nodes of the beam.
    on : Coordinate
        Spring, damper, friction and stops on the displacement or rotation.
    force : callable, optional
        None: the laws are those of `on`.
    number : int
        Index in the scene's forces between points.
    own : tuple of str
        Names of the parameters that it has alone.
    target : Node or Beam
        What is held.
    direction : (2,) float or None
        Direction of the displacement: of a node along x and y, of a beam along its axis and to the
        left of it; None for the rotation.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> ball = scene.add_body((0, 0), mass=1.0, inertia=0.1, name="ball").centre
    >>> print(scene.add_spring(ball, y=fb.Spring(100.0)).y)
    force 0, between node 0 at (0, 0) and the ground along (0, 1)
    """

    to_ground: ClassVar[bool] = True
    target: Node | Beam = None  # type: ignore[assignment]
    direction: np.ndarray | None = field(default=None, metadata=IS_DATA)

    @property
    def is_bed(self) -> bool:  # type: ignore[override]
        """Whether it holds the nodes of a beam."""
        return isinstance(self.target, Beam)

    @property
    def geometry(self) -> list[float]:
        """Its direction; nothing for a rotation."""
        return [] if self.direction is None else [*self.direction]

    def __str__(self):
        number = "" if self.number < 0 else f"force {self.number}, "
        way = "against rotation"
        if self.direction is not None:
            way = "along ({:.4g}, {:.4g})".format(*self.direction)
            if isinstance(self.target, Beam):
                way = "along it" if self.direction[0] else "across it"
                return f"{number}bed of beam {self.target.name!r} {way}"
        return f"{number}between {self.target} and the ground {way}"

    def ways(self, positions: np.ndarray) -> np.ndarray:
        """Directions of the displacements of the nodes.

        Parameters
        ----------
        positions : (n, 2) float
            Reference positions of the nodes [m].

        Returns
        -------
        (n, 2) float array
            Unit vectors.
        """
        assert self.direction is not None
        if isinstance(self.target, Node):
            return self.direction[None]
        padded = np.concatenate([positions[:1], positions, positions[-1:]])
        chords = padded[2:] - padded[:-2]
        x, y = chords.T / np.hypot(*chords.T)
        forwards, left = self.direction
        return np.stack([forwards * x - left * y, forwards * y + left * x], axis=1)

    @property
    def lengths(self) -> np.ndarray:
        """Lengths (n,) of the beam that belong to its nodes [m]; 1 for a node."""
        return points_of(self.target).lengths


class GroundSprings(NamedTuple):
    """Springs of a node to the ground along x, y and against rotation; None where there is none.

    Returned by `Scene.add_spring`.

    Parameters
    ----------
    x, y, rotation : GroundSpring or None
        Each as `Solution.joint`, `Output` and `Scene.remove` take it.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> ball = scene.add_body((0, 0), mass=1.0, inertia=0.1).centre
    >>> held = scene.add_spring(ball, x=fb.Spring(100.0), rotation=fb.Spring(5.0))
    >>> held.y is None, held.x.on.spring.stiffness
    (True, 100.0)
    """

    x: GroundSpring | None = None
    y: GroundSpring | None = None
    rotation: GroundSpring | None = None


class Bed(NamedTuple):
    """Springs of a beam to the ground, across it and along it; None where there is none.

    Returned by `Scene.add_bed`.

    Parameters
    ----------
    normal, tangential : GroundSpring or None
        Each as `Solution.joint`, `Output` and `Scene.remove` take it.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> rail = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0), name="rail")
    >>> print(scene.add_bed(rail, normal=100.0).normal)
    force 0, bed of beam 'rail' across it
    """

    normal: GroundSpring | None = None
    tangential: GroundSpring | None = None


#: Names of laws in `Coordinate` by their kinds.
_LAWS = {Spring: "spring", Damper: "damper", SmoothFriction: "friction", Stop: "stop"}


def _coordinate(laws, name: str, beginning: float = 0.0) -> Coordinate:
    """Laws of a displacement or rotation since its `beginning`; SceneError for no law."""
    law_list = laws if isinstance(laws, list | tuple) else [laws]
    names = [_LAWS.get(type(law), "") for law in law_list]
    ok = bool(law_list) and all(names) and len({*names}) == len(names)
    expected = "an fx_beam.Spring, Damper, SmoothFriction or Stop, or a list with one of each"
    require(ok, name, laws, expected)
    if beginning:
        law_list = [_since(beginning, law) for law in law_list]
    return Coordinate(**dict(zip(names, law_list, strict=True)))


def _since(beginning: float, law: Any) -> Any:
    """A law of a displacement that is zero at a beginning, as one of the displacement itself."""
    if isinstance(law, Spring):
        return replace(law, rest=law.rest + beginning)
    if isinstance(law, Stop):
        limits = {"lower": law.lower, "upper": law.upper}
        return replace(law, **{n: x + beginning for n, x in limits.items() if x is not None})
    return law


def ground_spring(
    node: Node, laws, direction: np.ndarray | None, name: str, beginning: float = 0.0
) -> GroundSpring:
    """A spring to the ground along a direction or on the rotation, from a `beginning` on."""
    coordinate = _coordinate(laws, name, beginning)
    spring = GroundSpring((node,), coordinate, target=node, direction=direction)
    what = "the rotation" if direction is None else "the displacement"
    check_at_start(spring, beginning, 1e-12 * abs(beginning), what)
    return spring


def parts_of_bed(
    beam: Beam, normal: float, tangential: float, pushes_only: bool, law=None
) -> dict[str, GroundSpring]:
    """Springs across a beam and along it, by their names in `Bed`; across it by a law, if any."""
    parts, up, forwards = dict[str, GroundSpring](), np.array([0.0, 1.0]), np.array([1.0, 0.0])
    if law is None and normal:
        law = Stop(0.0, None, normal) if pushes_only else Spring(normal)
    if law is not None:
        name = f"bed of beam {beam.name!r}: law"
        across = _coordinate(law, name)
        spring, damper, friction = across.spring, across.damper, across.friction
        remembers = spring is not None and spring.internal is not None
        has_law = damper is not None and damper.law is not None
        has_law |= isinstance(friction, SmoothFriction) and callable(friction.force)
        expected = "without internal variables, and dampers and friction without functions"
        require(not (remembers or has_law), name, law, expected)
        parts["normal"] = GroundSpring(beam.nodes, across, target=beam, direction=up)
        check_at_start(parts["normal"], 0.0, 0.0, "the displacement")
    if tangential:
        along = Coordinate(Spring(tangential))
        parts["tangential"] = GroundSpring(beam.nodes, along, target=beam, direction=forwards)
    return parts
