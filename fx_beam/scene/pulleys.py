"""Pulleys with a radius, and ropes over them, as plain data."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fx_beam.dual import dual_array, floats, scene_number
from fx_beam.errors import IS_DATA, SceneError, check_fields, is_one_of, real, real_array, require

from .beam import Node
from .forces_between import ForceBetween, Point

# Points on an arc of a picture.
_DRAWN = 17


@dataclass(frozen=True, eq=False)
class Pulley:
    r"""A circle on which a rope lies: a pulley, or at an end of the rope a drum.

    For `Scene.add_rope`. Between two points of the rope a pulley turns freely and has no friction,
    so that the tension is the same on both sides. At an end it is a drum: the rope is wound on it,
    does not slip, and turns with its node. With ropes to both of its sides a drum is a pulley with
    inertia on which the rope does not slip.

    Parameters
    ----------
    at : Node or (x, y)
        The centre: a node of a body or beam, which moves, or a fixed place [m].
    radius : float
        Radius R to the middle of the rope [m].
    side : {"left", "right"}
        On which side of the rope the centre is, seen along the rope from its first point: a rope
        turns to the left about a pulley on its left.

    Raises
    ------
    SceneError
        For a radius that is not positive, or an unknown side.

    Examples
    --------
    Atwood's machine with a pulley of 0.2 m radius, that turns freely.

    >>> import fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -9.81))
    >>> loads = [scene.add_body((x, -1), mass=m).centre for x, m in ((-0.2, 1.0), (0.2, 1.5))]
    >>> for load in loads:
    ...     scene.fix(load, "x", "rotation")
    >>> points = [loads[0], fb.Pulley((0, 0), 0.2, side="right"), loads[1]]
    >>> rope = scene.add_rope(points, spring=fb.Spring(1e6))
    >>> print(f"{rope.length_at_start:.4f} m")  # 2 + 0.2 pi
    2.6283 m
    """

    at: Point
    radius: float = real("positive")
    side: str = "left"

    def __post_init__(self):
        check_fields(self)
        require(is_one_of(self.side, ("left", "right")), "Pulley: side", self.side, "left or right")


@dataclass(frozen=True, eq=False, repr=False)
class RopeOverPulleys(ForceBetween):
    """A rope over points of which some are circles; created by `Scene.add_rope`.

    The points are the centres.
    """

    #: Of each point: n for a node, f for a fixed one, N and F for pulleys there, D for a drum.
    kinds: str = ""  # type: ignore[misc]
    #: Radii (n,), positive for a centre on the left of the rope, 0 for points [m].
    radii: np.ndarray = field(default_factory=lambda: np.zeros(0), metadata=IS_DATA)

    def __post_init__(self):
        for i, (way, step) in enumerate(zip(self.apart, self.steps, strict=True)):
            if not math.hypot(*way) > abs(step):
                raise SceneError(
                    f"{self}: points {i} and {i + 1} are {math.hypot(*way):.4g} apart, and the "
                    f"rope has no tangent to both circles. Move them more than {abs(step):.4g} "
                    "apart, or give the other side"
                )
        _ = self.turns  # which says what the rope does not touch

    @property
    def steps(self) -> np.ndarray:
        """Differences (n - 1,) of the radii of neighbours [m]."""
        radii = dual_array(self.radii)
        return scene_number(radii[:-1] - radii[1:])

    def spans(self, ways: Any) -> tuple[Any, Any]:
        """Lengths (n - 1, ...) of the free spans [m], and angles from the centres' lines to them.

        `ways` (n - 1, 2, ...) are the vectors from each centre to the next one [m].
        """
        far = np.hypot(ways[:, 0], ways[:, 1])
        steps = dual_array(self.steps).reshape(-1, *[1] * (far.ndim - 1))
        return np.sqrt(far * far - steps * steps), np.arcsin(steps / far)

    def straight(self, ways: np.ndarray) -> np.ndarray:
        """Vectors (n - 1, 2) of the free spans for those between centres [m]."""
        spans, leans = self.spans(ways)
        ratio, c, s = spans / np.hypot(*ways.T), np.cos(leans), np.sin(leans)
        x, y = ways.T
        return np.stack([ratio * (c * x - s * y), ratio * (s * x + c * y)], axis=1)

    @property
    def turns(self) -> np.ndarray:
        """Angles (n,) of the arcs where the length has no part of drums; less those of `spans`."""
        ways = dual_array(self.apart)
        _, leans = self.spans(ways)
        turns = [0.0 - leans[0]]
        for i, (way, next_way) in enumerate(itertools.pairwise(ways), start=1):
            cross = way[0] * next_way[1] - way[1] * next_way[0]
            turn = np.arctan2(cross, way[0] * next_way[0] + way[1] * next_way[1])
            turns.append(turn + self._full_turns(i, turn + leans[i] - leans[i - 1]))
        return real_array([*turns, leans[-1]])

    def _full_turns(self, i: int, turn: Any) -> float:
        """Full turns [rad] that make an arc positive on its side; SceneError if none touches."""
        radius = float(self.radii[i])
        if not radius:
            return 0.0
        arc = float(floats(turn)) * math.copysign(1.0, radius)
        wrap = arc % (2 * math.pi)
        if wrap > 1.5 * math.pi:
            side = "left" if radius > 0 else "right"
            raise SceneError(
                f"{self}: the rope passes the pulley at point {i} on its other side, or does not "
                f"touch it: with side={side!r} its arc would be {arc - 2 * math.pi * (arc > 0):.3g}"
                " rad. Give the other side, or move the pulley"
            )
        return math.copysign(wrap - arc, radius) if abs(wrap - arc) > 1e-9 else 0.0

    @property
    def numbers(self) -> list[float]:
        """Ways between centres, and of each circle the radius and the arc at the start."""
        circles = [i for i, kind in enumerate(self.kinds) if kind in "NFD"]
        circle_numbers = [x for i in circles for x in (self.radii[i], self.turns[i])]
        return [*(x for way in self.apart for x in way), *circle_numbers]

    @property
    def length_at_start(self) -> float:
        """Free spans and arcs at the start, without what is wound on drums [m]."""
        spans, leans = self.spans(self.apart)
        bent = (self.turns * self.radii).sum() + (self.steps * leans).sum()
        return float(floats(spans.sum() + bent))

    @property
    def drums(self) -> list[tuple[int, float]]:
        """Numbers of the nodes of drums, and how much rope their rotations let in [m/rad]."""
        ends = (0, -self.radii[0]), (-1, self.radii[-1])
        return [(self.nodes[i], float(r)) for i, r in ends if self.kinds[i] == "D"]

    @property
    def geometry(self) -> list[float]:
        """Ways between centres, then radii (n,) and arcs (n,) at the start."""
        return [*super().geometry, *self.radii, *self.turns]

    def _circles(self, numbers: Any) -> tuple[Any, Any, Any]:
        """Radii (n,), their steps (n - 1,) and arcs (n,) at the start, of numbers."""
        n = len(self.points)
        radii, turns = numbers[-2 * n : -n], numbers[-n:]
        return radii, radii[:-1] - radii[1:], turns

    def arcs(
        self, numbers: Any, moved: Sequence, turned: Sequence, counted: np.ndarray | None = None
    ) -> list:
        """Angles (n,) about each centre to the left, of drums since the start [rad].

        `counted` (..., n - 1) are half turns of the spans [rad], from which their angles are less
        than one; None for none.
        """
        _, steps, turns = self._circles(numbers)
        angles, leans = [], []
        for i, (x, y) in enumerate(self.vectors(numbers, moved)):
            X, Y = numbers[2 * i], numbers[2 * i + 1]
            half = 0.0 if counted is None else np.pi * np.round(counted[..., i] / np.pi)
            sign = np.cos(half)  # of the direction from which the angle is measured
            cross, along = sign * (X * y - Y * x), sign * (X * x + Y * y)
            angles.append(half + np.arctan2(cross, along))
            leans.append(np.arcsin(steps[i] / np.hypot(x, y)))
        arcs = [angles[0] + leans[0] - turned[0]]
        for i, (old, new) in enumerate(itertools.pairwise(angles)):
            arcs.append(new - old + leans[i + 1] - leans[i])
        arcs.append(turned[1] - angles[-1] - leans[-1])
        return [arc + turns[i] for i, arc in enumerate(arcs)]

    def length(
        self, numbers: Any, moved: Sequence, turned: Sequence, counted: np.ndarray | None = None
    ) -> Any:
        """Sum of free spans and arcs [m], with half turns as of `arcs`."""
        radii, steps, _ = self._circles(numbers)
        ways = zip(self.vectors(numbers, moved), steps, strict=True)
        arcs = enumerate(self.arcs(numbers, moved, turned, counted))
        spans = sum(np.sqrt(x * x + y * y - step * step) for (x, y), step in ways)
        return spans + sum(radii[i] * arc for i, arc in arcs if self.radii[i])

    def rate(self, numbers: Any, moved: Sequence, rates: Sequence, spins: Sequence) -> Any:
        """Rate of the length [m/s]."""
        radii, steps, _ = self._circles(numbers)
        total = radii[-1] * spins[1] - radii[0] * spins[0]
        for (x, y), (vx, vy), step in zip(self.vectors(numbers, moved), rates, steps, strict=True):
            square = x * x + y * y
            span = np.sqrt(square - step * step)
            total = total + ((span * x - step * y) * vx + (step * x + span * y) * vy) / square
        return total

    def outline(self, centres: np.ndarray) -> np.ndarray:
        """Points (..., m, 2) along the rope for centres (n, ..., 2)."""
        ways = np.moveaxis(np.diff(centres, axis=0), -1, 1)
        _, leans = self.spans(ways)
        angles = np.arctan2(ways[:, 1], ways[:, 0]) + leans
        points = []
        for i, radius in enumerate(self.radii.tolist()):
            first_angle, last_angle = angles[max(i - 1, 0)], angles[min(i, len(angles) - 1)]
            arc = np.copysign((last_angle - first_angle) * np.sign(radius) % (2 * np.pi), radius)
            if i in (0, len(angles)):
                arc = 2 * np.pi  # a drum is a circle
            for share in np.linspace(0, 1, _DRAWN if radius else 1):
                angle = first_angle + share * arc
                arm = radius * np.stack([np.sin(angle), -np.cos(angle)], axis=-1)
                points.append(centres[i] + arm)
        return np.stack(points, axis=-2)


def rope_parts(points: Sequence[Point | Pulley]) -> tuple[list[Point], str, np.ndarray]:
    """Centres of points and pulleys of a rope, and the rest of a `RopeOverPulleys`."""
    centres, kinds, radii = list[Point](), "", list[float]()
    for i, point in enumerate(points):
        centre = point.at if isinstance(point, Pulley) else point
        radius = 0.0
        if isinstance(point, Pulley):
            radius = point.radius if point.side == "left" else -point.radius
        kind = "n" if isinstance(centre, Node) else "f"
        if radius:
            is_at_end = i in (0, len(points) - 1) and kind == "n"
            kind = "D" if is_at_end else kind.upper()
        centres.append(centre)
        kinds += kind
        radii.append(radius)
    return centres, kinds, real_array(radii)
