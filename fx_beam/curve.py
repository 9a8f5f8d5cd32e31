"""Curves along which a beam may run: arcs, splines and functions, measured by their arc length."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial.chebyshev import Chebyshev, chebder, chebint, chebinterpolate, chebval
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

from .beam import Layout, Node, place
from .errors import SceneError
from .values import checked_function, vector

# Degrees of the polynomials in which a piece of a curve and its speed are interpolated.
_CURVE_DEGREE, _SPEED_DEGREE = 14, 20
# A smooth curve is measured to rounding with a few pieces; what takes more has a corner.
_MOST_PIECES = 256


@dataclass(frozen=True)
class Curve:
    """A curve in the plane, for `Scene.add_beam`.

    Parameters
    ----------
    function : callable
        ``function(fraction)`` gives (x, y) [m] for a fraction in [0, 1], at any speed.
    start, end : Node, optional
        Nodes of other beams at which it starts and ends, shared rigidly: displacement and
        rotation are the same. They must lie where the function starts and ends.
    breaks : sequence of float
        Fractions at which the function is less smooth than between them.
    """

    function: Callable[[float], Any]
    start: Node | None = None
    end: Node | None = None
    breaks: Sequence[float] = (0.0, 1.0)


def arc(start, through, end) -> Curve:
    """Arc of a circle through three points.

    Parameters
    ----------
    start : (x, y) or Node
        Its first point [m]. A node of another beam is shared rigidly.
    through : (x, y)
        Any point between the ends [m].
    end : (x, y) or Node
        Its last point [m], or the node of another beam.

    Returns
    -------
    Curve
        The arc, for `Scene.add_beam`.

    Raises
    ------
    SceneError
        If the three points lie on a line.
    """
    a, b, c = (vector(place(point), 2, "arc") for point in (start, through, end))
    to_b, to_c, across = b - a, c - a, c - b
    area = to_b[0] * to_c[1] - to_b[1] * to_c[0]
    longest = max(to_b @ to_b, to_c @ to_c, across @ across)
    if not abs(area) > 1e-9 * longest:
        raise SceneError(
            f"arc: the points {a}, {b} and {c} lie on a line or coincide; for a straight beam give "
            "its ends, for a full circle two arcs"
        )
    rise = (to_b @ to_b) * to_c - (to_c @ to_c) * to_b
    to_centre = np.array([rise[1], -rise[0]]) / (2 * area)
    # Twice the angle at the circumference is that at the centre.
    inside = math.atan2(abs(area), -(to_b @ across))
    sweep = math.copysign(2 * (math.pi - inside), area)

    def on_arc(fraction: float) -> np.ndarray:
        c, s = math.cos(sweep * fraction), math.sin(sweep * fraction)
        x, y = to_centre
        return a + to_centre - np.array([c * x - s * y, s * x + c * y])

    return Curve(on_arc, *_nodes(start, end))


def spline(points: Sequence) -> Curve:
    """Smooth curve through points: a cubic spline over the length of their polygon.

    Parameters
    ----------
    points : sequence of (x, y) or Node
        Two or more points [m]; the first and the last may be nodes of other beams, which are
        shared rigidly. Where these two coincide the curve closes smoothly.

    Returns
    -------
    Curve
        The spline, for `Scene.add_beam`.

    Raises
    ------
    SceneError
        For fewer than two points, or points in a row that coincide.
    """
    try:
        points = list(points)
    except TypeError:
        raise SceneError(f"spline: {points!r} must be points (x, y) or nodes") from None
    if any(isinstance(point, Node) for point in points[1:-1]):
        raise SceneError("spline: only its ends can be nodes of other beams; end one there instead")
    if len(points) < 2:
        raise SceneError("spline: it needs at least two points")
    xy = np.array([vector(place(point), 2, f"spline, point {i}") for i, point in enumerate(points)])
    chords = np.hypot(*np.diff(xy, axis=0).T)
    for i in np.flatnonzero(chords <= 1e-12 * abs(xy).max()):
        raise SceneError(f"spline: the points {i} and {i + 1} coincide at {xy[i]}")
    breaks = np.concatenate([[0.0], np.cumsum(chords)]) / chords.sum()
    closed = len(xy) > 2 and (xy[0] == xy[-1]).all()
    function = CubicSpline(breaks, xy, bc_type="periodic" if closed else "not-a-knot")
    return Curve(function, *_nodes(points[0], points[-1]), tuple(breaks))


def _nodes(start, end) -> tuple[Node | None, Node | None]:
    return (
        start if isinstance(start, Node) else None,
        end if isinstance(end, Node) else None,
    )


def lay_along(curve: Curve, elements: Any, degree: int, name: str) -> Layout:
    """Nodes along a curve, at equal distances of its arc length.

    Parameters
    ----------
    curve : Curve
        The curve.
    elements : int
        Number of elements.
    degree : int
        Polynomial degree of the elements, which says how many nodes lie inside each.
    name : str
        Name of the beam, for messages.

    Returns
    -------
    Layout
        Ends of the elements, arc lengths and nodes inside.

    Raises
    ------
    SceneError
        For a function that gives no points, a curve of no length, or nodes that it misses.
    """
    if not isinstance(elements, int | np.integer) or elements < 1:
        raise SceneError(
            f"beam {name!r}: elements = {elements!r} must be one positive whole number for a curve"
        )
    function = checked_function(curve.function, 2, f"beam {name!r}: curve", 0.0)

    def position(fraction: float) -> np.ndarray:
        return vector(function(fraction), 2, f"beam {name!r}: curve at the fraction {fraction:.6g}")

    length, fraction_at = _measure(position, curve.breaks, name)
    s = length * np.linspace(0, 1, elements * degree + 1)
    points = np.array([position(fraction_at(distance)) for distance in s])
    _check_followed(points[::degree], s[::degree], name)
    ends: list = list(points[::degree])
    for i, node, where in ((0, curve.start, "starts"), (-1, curve.end, "ends")):
        if node is None:
            continue
        gap = math.dist((node.x, node.y), points[i])
        if gap > 1e-9 * length:
            raise SceneError(
                f"beam {name!r}: its curve {where} at ({points[i, 0]:g}, {points[i, 1]:g}), "
                f"{gap:.3g} away from {node}, which it shall share"
            )
        ends[i] = node
    inner = points[:-1].reshape(elements, degree, 2)[:, 1:]
    return Layout(ends, s[::degree], inner)


def _check_followed(ends: np.ndarray, s: np.ndarray, name: str) -> None:
    """Refuse elements that are too long for the curve, such as a whole circle in one."""
    chords, lengths = np.hypot(*np.diff(ends, axis=0).T), np.diff(s)
    k = int(np.argmin(chords / lengths))
    if chords[k] < 0.5 * lengths[k]:
        raise SceneError(
            f"beam {name!r}: {len(chords)} elements are too few for its curve; element {k} is "
            f"{lengths[k]:.3g} long, and its ends are {chords[k]:.3g} apart"
        )


def _measure(position, breaks, name: str) -> tuple[float, Callable[[float], float]]:
    """Length of a curve, and its fraction at a distance from the start."""
    lengths = [0.0]
    cuts = np.asarray(breaks, dtype=float)
    while True:
        pieces = [_piece(position, a, b) for a, b in zip(cuts[:-1], cuts[1:], strict=True)]
        ends = np.cumsum([0.0] + [float(s(b)) for s, b in zip(pieces, cuts[1:], strict=True)])
        lengths.append(float(ends[-1]))
        rounding = 1e-13 * lengths[-1]
        if abs(lengths[-1] - lengths[-2]) <= rounding or len(pieces) >= _MOST_PIECES:
            break
        cuts = np.sort(np.concatenate([cuts, (cuts[:-1] + cuts[1:]) / 2]))
    size = max(abs(position(float(a))).max() for a in cuts)
    if not lengths[-1] > 1e-9 * size:  # less is the rounding of its derivative
        raise SceneError(f"beam {name!r}: its curve has no length")

    def fraction_at(distance: float) -> float:
        i = min(int(np.searchsorted(ends, distance, side="right")) - 1, len(pieces) - 1)
        left = distance - ends[i]
        if left <= rounding:
            return float(cuts[i])
        if left >= ends[i + 1] - ends[i] - rounding:
            return float(cuts[i + 1])
        return brentq(lambda x: pieces[i](x) - left, cuts[i], cuts[i + 1], xtol=1e-15, rtol=1e-15)

    return lengths[-1], fraction_at


def _piece(position, a: float, b: float) -> Chebyshev:
    """Arc length from `a` on, as a polynomial of the fraction in [a, b]."""

    def points(x):
        return np.array([position(a + (b - a) * (1 + ahead) / 2) for ahead in x])

    rates = chebder(chebinterpolate(points, _CURVE_DEGREE))
    speed = chebinterpolate(lambda x: np.hypot(*chebval(x, rates)), _SPEED_DEGREE)
    return Chebyshev(chebint(speed, lbnd=-1), domain=[a, b])
