"""Rigid bodies: a node at the centre of mass, and points that follow it rigidly."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from fx_beam.errors import SceneError
from fx_beam.validation import is_name, require, vector

from . import loads
from .beam import Node
from .geometry import Geometry
from .joints import Joint, Rigid


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body; created by `Scene.add_body`.

    Its points move with the centre: phi = phi_c + R(psi_c) (X - X_c). They are nodes like those of
    beams. ``body["A"]`` is the point "A".

    Parameters
    ----------
    name : str
        Name in messages.
    centre : Node
        The centre of mass, which has the three unknowns of the body.
    points : dict
        Nodes of the points, by name.
    mass, inertia : float
        Mass [kg], and moment of inertia about the centre [kg m^2].

    Examples
    --------
    >>> import fx_beam as fb
    >>> body = fb.Scene().add_body((0, 0), 2.0, 0.1, points={"A": (1, 0)})
    >>> print(body["A"])
    node 1 at (1, 0)
    """

    name: str
    centre: Node
    points: dict[str, Node]
    mass: float
    inertia: float

    def __getitem__(self, name: str) -> Node:
        if not isinstance(name, str) or name not in self.points:
            raise SceneError(f"{self.name} has no point {name!r}; it has {list(self.points)}")
        return self.points[name]

    def __repr__(self):
        return f"<Body {self.name!r} at ({self.centre.x:g}, {self.centre.y:g})>"

    @property
    def nodes(self) -> list[Node]:
        """The centre, then the points."""
        return [self.centre, *self.points.values()]


class Bodies(Geometry):
    """Bodies of a scene, made of nodes, joints and masses."""

    add_joint: Callable[[Joint], Joint]
    add_mass: Callable[[Node, float, float], None]

    def __init__(self):
        super().__init__()
        self.bodies: list[Body] = []

    def add_body(
        self,
        position: Sequence[float],
        mass: float,
        inertia: float = 0.0,
        points: Mapping[str, Sequence[float] | Node] | None = None,
        name: str | None = None,
    ) -> Body:
        """Add a rigid body; joints and beams take its points.

        Each point is joined to the centre by a `Rigid` joint with an offset, without error and
        without unknowns of its own: the body has three.

        Parameters
        ----------
        position : (x, y)
            Centre of mass in the reference configuration [m].
        mass : float
            Mass m [kg].
        inertia : float
            Moment of inertia J about the centre [kg m^2].
        points : dict, optional
            Points by name: positions (x, y) in the reference configuration [m], not relative to
            the centre; or nodes of beams and of other bodies, which then follow this body.
        name : str, optional
            Name in messages.

        Returns
        -------
        Body
            The body: ``body.centre`` and ``body["A"]`` are its nodes.

        Raises
        ------
        SceneError
            For a position, mass, inertia or point that is invalid, or a name that is in use.

        Examples
        --------
        A compound pendulum: one radian per second squared for small angles, m g a / (J + m a^2).

        >>> import fx_beam as fb
        >>> scene = fb.Scene(gravity=(0, -10))
        >>> body = scene.add_body((0, -0.2), mass=3.0, inertia=0.48, points={"pin": (0, 0)})
        >>> pin = scene.add_joint(fb.Revolute(fb.GROUND, body["pin"]))
        >>> round(float(fb.modes(scene, state=fb.static(scene, steps=1)).omega[0] ** 2), 9)
        10.0
        """
        name = self._name_of_body(name)
        x, y = vector(position, 2, f"{name}: position")
        given = (("mass", mass), ("inertia", inertia))
        m, J = (loads.not_negative(value, f"{name}: {what}") for what, value in given)
        fits = isinstance(points, Mapping | None) and all(map(is_name, points or ()))
        require(fits, f"{name}: points", points, "a dict of positions by their names")
        ends: list[Node | tuple[float, float]] = [(float(x), float(y))]
        for key, point in (points or {}).items():
            if isinstance(point, Node):
                loads.check_node(self, point, f"{name}: point {key!r}")
                ends.append(point)
            else:
                at = vector(point, 2, f"{name}: point {key!r}")
                ends.append((float(at[0]), float(at[1])))
        centre, *nodes = self._nodes_at(ends, name)
        for node in nodes:
            offset = (node.x - centre.x, node.y - centre.y)
            self.add_joint(Rigid(centre, node, offset=offset))
        if m or J:
            self.add_mass(centre, m, J)
        named = dict(zip(points or {}, nodes, strict=True))
        self.bodies.append(Body(name, centre, named, m, J))
        return self.bodies[-1]

    def _name_of_body(self, name: str | None) -> str:
        names = {body.name for body in self.bodies}
        if name is None:
            numbers = itertools.count(len(self.bodies) + 1)
            name = next(free for n in numbers if (free := f"body {n}") not in names)
        require(is_name(name), "add_body: name", name, "a text that is not empty")
        if name in names:
            raise SceneError(f"two bodies are called {name!r}; use different names")
        return name


def velocities_of(body: Body, velocity, spin) -> list[loads.Velocity]:
    """Initial velocities of the nodes of a body, from that of its centre and its spin."""
    centre = body.centre
    given = loads.initial_velocity(centre, velocity, spin)
    place = [(centre.x, centre.y)]
    (vx, vy), w = given.value.each(place)[0], float(given.spin.each(place)[0, 0])
    return [
        loads.initial_velocity(
            node, (vx - w * (node.y - centre.y), vy + w * (node.x - centre.x)), w
        )
        for node in body.nodes
    ]


def check_body(scene, body: Body, what: str) -> None:
    """Refuse a body of another scene."""
    if body not in scene.bodies:
        raise SceneError(f"{what}: {body.name} belongs to another scene; take a body of this one")
