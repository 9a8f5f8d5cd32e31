"""Rigid bodies: a node at the centre of mass, and points that follow it rigidly."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field
from typing import TypeVar

from fx_beam.dual import dual_array
from fx_beam.errors import IS_DATA, SceneError, is_name, require

from . import loads
from .beam import Beam, Node

T = TypeVar("T", "Beam", "Body")


@dataclass(frozen=True, eq=False)
class Body:
    """A rigid body; created by `Scene.add_body`.

    Its points move with the centre: phi = phi_c + R(psi_c) (X - X_c). They are nodes, as in beams.
    ``body["A"]`` is the point "A".

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
    mass: float = field(metadata=IS_DATA)
    inertia: float = field(metadata=IS_DATA)

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


class Members(list[T]):
    """Beams or bodies in order; ``beams["arm"]`` is the one with this name."""

    def __init__(self, kind: str):
        super().__init__()
        #: What they are: "beam" or "body".
        self.kind = kind
        #: Names that were ever given.
        self.names: set[str] = set()
        # Numbers of members by name, which may have changed since.
        self._numbers: dict[str, int] = {}

    def copy(self) -> Members[T]:
        """The members of now, which are found by their names."""
        other = Members[T](self.kind)
        other.extend(self)
        return other

    def __getitem__(self, key):
        if not isinstance(key, str):
            return super().__getitem__(key)
        return self[self.number_of(key)]

    def number_of(self, name: str) -> int:
        """Number of the member with a name; SceneError for none."""
        if (number := self._find(name)) is None:
            raise SceneError(f"the scene has no {name!r}; it has {[*self._numbers]}")
        return number

    def has(self, member: T) -> bool:
        """Whether a member is one of these, and not another one of its name."""
        number = self._find(member.name)
        return number is not None and self[number] is member

    def _find(self, name: str) -> int | None:
        number = self._numbers.get(name)
        if number is None or number >= len(self) or self[number].name != name:
            self._numbers = {member.name: i for i, member in enumerate(self)}
            number = self._numbers.get(name)
        return number

    def new_name(self, name: str | None) -> str:
        """The name of a new member, by default a number; SceneError for one that is in use."""
        if name is None:
            numbers = itertools.count(len(self) + 1)
            name = next(free for n in numbers if (free := f"{self.kind} {n}") not in self.names)
        require(is_name(name), f"add_{self.kind}: name", name, "a text that is not empty")
        if name in self.names:
            plural = "beams" if self.kind == "beam" else "bodies"
            raise SceneError(f"two {plural} are called {name!r}; use different names")
        return name

    def add(self, member: T) -> T:
        """A new member, added."""
        self.names.add(member.name)
        self.append(member)
        return member


def velocities_of(body: Body, velocity, spin) -> list[loads.Velocity]:
    """Initial velocities of the nodes of a body, from velocity and spin of its centre."""
    centre = body.centre
    start = loads.initial_velocity(centre, velocity, spin)
    position = dual_array([(centre.x, centre.y)])
    # Floats of NumPy would lose the slopes of the arms.
    (vx, vy), (w,) = (signal.each(position)[0].tolist() for signal in (start.value, start.spin))
    arms = [(node, node.x - centre.x, node.y - centre.y) for node in body.nodes]
    return [loads.initial_velocity(node, (vx - w * y, vy + w * x), w) for node, x, y in arms]


def check_body(scene, body: Body, name: str) -> None:
    """Refuse a body of another scene."""
    if body not in scene.bodies:
        raise SceneError(f"{name}: {body.name} belongs to another scene; take a body of this one")
