"""Arcs, splines and functions along which a beam may run, measured by arc length.

A curved element is a polynomial of its degree, with equidistant nodes. It interpolates
the curve at the Gauss-Lobatto points in arc length: at the Gauss points its tangent is then more
accurate, and lengths, chords and strain energy converge with order 2p, as on straight elements.
For degree 3 with nodes on the curve at thirds of the length the order would be 4 instead of 6; for
degree 2 both choices are the same. Example: a quarter circle of 16 elements of degree 3 is bent
straight; the error of its tip is 3e-12 of the radius, instead of 3e-8. The inner nodes of degree 3
are off the curve by an error of order 4.
"""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import Chebyshev, chebder, chebint, chebpts1, chebpts2, chebvander

from fx_beam.errors import SceneError, is_flag, is_whole, real_array, require, vector

from .beam import (
    MOST_ELEMENTS,
    USUAL_ELEMENTS,
    BeamLayout,
    Node,
    lagrange,
    listed_points,
    polyline,
    position_of,
)
from .functions import checked_function

# Degrees of the interpolating polynomials of a piece of a curve, and of its speed.
_CURVE_DEGREE, _SPEED_DEGREE = 14, 20
# The points include the ends of a piece, so that a jump between two pieces is found.
_POINTS = chebpts2(_CURVE_DEGREE + 1)
_SPEED_POINTS = chebpts1(_SPEED_DEGREE + 1)
# Matrices from values to derivatives, and from speeds to the coefficients of the arc length.
_DERIVATIVE = chebvander(_SPEED_POINTS, _CURVE_DEGREE - 1) @ chebder(
    np.linalg.inv(chebvander(_POINTS, _CURVE_DEGREE))
)
_INTEGRAL = chebint(np.linalg.inv(chebvander(_SPEED_POINTS, _SPEED_DEGREE)), lbnd=-1)
# A smooth curve needs a few pieces for round-off accuracy; each corner needs 40 more.
_MOST_PIECES = 10_000
_ROUNDING = float(np.finfo(float).eps)
# Gauss-Lobatto points, by degree: there the element's polynomial interpolates the curve.
_LOBATTO = {
    1: np.array([0.0, 1.0]),
    2: np.array([0.0, 0.5, 1.0]),
    3: np.array([0.0, 0.5 - 0.1 * math.sqrt(5), 0.5 + 0.1 * math.sqrt(5), 1.0]),
}


@dataclass(frozen=True)
class Curve:
    """A curve in the plane, for `Scene.add_beam`.

    Parameters
    ----------
    function : callable
        ``function(fraction)`` gives (x, y) [m] for a fraction in [0, 1]; its speed may vary.
    start, end : Node, optional
        Nodes of other beams at which it starts and ends, shared rigidly: displacement and
        rotation are the same. They must lie where the function starts and ends.
    breaks : sequence of float, optional
        Fractions at which the function is less smooth, such as corners. They are also found
        automatically, but that takes longer.

    Raises
    ------
    SceneError
        For an end that is not a node, or breaks that are not fractions.

    Examples
    --------
    A parabolic arch that shares the top of a post.

    >>> import fx_beam as fb
    >>> scene, section = fb.Scene(), fb.Section(EA=1e6, GA=1e6, EI=1e3)
    >>> post = scene.add_beam([(0, 0), (0, 1)], section)
    >>> parabola = fb.Curve(lambda f: (4 * f, 1 + 4 * f * (1 - f)), start=post.end)
    >>> arch = scene.add_beam(parabola, section, elements=8, degree=1)
    >>> round(arch.length, 3), arch.start is post.end
    (4.591, True)
    """

    function: Callable[[float], Sequence[float] | np.ndarray]
    start: Node | None = None
    end: Node | None = None
    breaks: Sequence[float] = ()

    def __post_init__(self):
        for name, end in (("start", self.start), ("end", self.end)):
            is_end = end is None or isinstance(end, Node)
            require(is_end, f"Curve: {name}", end, "a node of another beam, or None")
        require(callable(self.function), "Curve: function", self.function, "a function")
        breaks = real_array(self.breaks)
        ok = breaks.ndim == 1 and ((breaks >= 0) & (breaks <= 1)).all()
        require(bool(ok), "Curve: breaks", self.breaks, "fractions between 0 and 1")
        object.__setattr__(self, "breaks", tuple(breaks.tolist()))


def arc(start, through, end) -> Curve:
    """Arc of a circle through three points.

    Parameters
    ----------
    start : (x, y) or Node
        First point [m]. A node of another beam is shared rigidly.
    through : (x, y)
        Any point between the ends [m].
    end : (x, y) or Node
        Last point [m], or the node of another beam.

    Returns
    -------
    Curve
        The arc, for `Scene.add_beam`.

    Raises
    ------
    SceneError
        If the three points lie on a line.

    Examples
    --------
    >>> import math, fx_beam as fb
    >>> half_circle = fb.arc((1, 0), (0, 1), (-1, 0))
    >>> section = fb.Section(EA=1e6, GA=1e6, EI=1e3)
    >>> ring = fb.Scene().add_beam(half_circle, section, elements=6, degree=2)
    >>> math.isclose(ring.length, math.pi)
    True
    """
    if isinstance(through, Node):
        raise SceneError(
            "arc: only its ends can be nodes of other beams. Make two arcs that meet at this node"
        )
    a, b, c = (vector(position_of(point), 2, "arc") for point in (start, through, end))
    b_arm, c_arm, chord = b - a, c - a, c - b
    area = b_arm[0] * c_arm[1] - b_arm[1] * c_arm[0]
    longest = max(b_arm @ b_arm, c_arm @ c_arm, chord @ chord)
    if not abs(area) > 1e-9 * longest:
        raise SceneError(
            f"arc: the points {a}, {b} and {c} lie on a line or coincide. For a straight beam give "
            "its two ends; for a full circle use two arcs"
        )
    rise = (b_arm @ b_arm) * c_arm - (c_arm @ c_arm) * b_arm
    centre_arm = np.array([rise[1], -rise[0]]) / (2 * area)
    # The central angle is twice the inscribed angle.
    sweep = math.copysign(2 * math.atan2(abs(area), b_arm @ chord), area)

    return Curve(functools.partial(_on_arc, a, centre_arm, sweep), _node(start), _node(end))


def _on_arc(a: np.ndarray, centre_arm: np.ndarray, sweep: float, fraction: float) -> np.ndarray:
    # From a along the chord: no cancellation for a large radius.
    c, s = math.cos(sweep * fraction / 2), math.sin(sweep * fraction / 2)
    x, y = centre_arm
    return a + 2 * s * np.array([s * x + c * y, s * y - c * x])


def spline(points: Sequence, monotone: bool = False) -> Curve:
    """Smooth curve through points: a cubic spline, parametrised by the length of their polygon.

    Its curvature has kinks at the points; there elements converge with order 4 at most. Where
    distances between points change much it swings out beyond them: draw it, add points there, or
    take a `monotone` one. A polyline is a list of points without `spline`.

    Parameters
    ----------
    points : sequence of (x, y) or Node
        Two or more points [m]; the first and the last may be nodes of other beams, which are
        shared rigidly. If these two coincide, the curve closes smoothly.
    monotone : bool
        Whether x and y rise or fall between two points only as these do (Fritsch and Carlson): the
        curve stays in the box of both. Its curvature jumps at points, and it does not close
        smoothly.

    Returns
    -------
    Curve
        The spline, for `Scene.add_beam`.

    Raises
    ------
    SceneError
        For fewer than two points, or successive points that coincide.

    Examples
    --------
    >>> import fx_beam as fb
    >>> wave = fb.spline([(0, 0), (1, 0.5), (2, 0), (3, -0.5), (4, 0)])
    >>> beam = fb.Scene().add_beam(wave, fb.Section(EA=1e6, GA=1e6, EI=1e3), elements=10)
    >>> beam.end.x, round(beam.length, 2)
    (4.0, 4.62)
    """
    points, positions = listed_points(points, "spline")
    xy = np.array(positions)
    if any(isinstance(point, Node) for point in points[1:-1]):
        raise SceneError(
            "spline: only its ends can be nodes of other beams. Make two splines that meet there"
        )
    require(is_flag(monotone), "spline: monotone", monotone, "True or False")
    chords = np.hypot(*np.diff(xy, axis=0).T)
    for i in np.flatnonzero(chords <= 1e-12 * abs(xy).max()):
        raise SceneError(f"spline: points {i} and {i + 1} coincide at {xy[i]}. Remove one")
    breaks = np.concatenate([[0.0], np.cumsum(chords)])
    breaks /= breaks[-1]
    closed = len(xy) > 2 and math.dist(xy[0], xy[-1]) <= 1e-12 * abs(xy).max()
    if closed:
        xy[-1] = xy[0]
    # Imported here: most scenes need no curve, and the import takes time.
    from scipy.interpolate import CubicSpline, PchipInterpolator

    if monotone:
        function = PchipInterpolator(breaks, xy)
    else:
        function = CubicSpline(breaks, xy, bc_type="periodic" if closed else "not-a-knot")
    return Curve(function, _node(points[0]), _node(points[-1]), tuple(breaks))


def _node(point: object) -> Node | None:
    return point if isinstance(point, Node) else None


def layout(points, elements, degree: int, name: str) -> BeamLayout:
    """Nodes of a beam along a polyline, a `Curve`, or a function of the fraction."""
    if callable(points):
        points = Curve(points)
    if isinstance(points, Curve):
        count = USUAL_ELEMENTS[degree] if elements is None else elements
        return along_curve(points, count, degree, name)
    return polyline(points, elements, degree, name)


def along_curve(curve: Curve, elements, degree: int, name: str) -> BeamLayout:
    """Elements of equal arc length along a curve, with degree - 1 nodes inside each."""
    expected = f"one positive whole number for a curve, at most {MOST_ELEMENTS:,}"
    require(is_whole(elements, 1, MOST_ELEMENTS), f"beam {name!r}: elements", elements, expected)
    elements = int(elements)
    function = checked_function(curve.function, 2, f"beam {name!r}: curve", 0.0)

    def position(fraction: float) -> np.ndarray:
        return vector(function(fraction), 2, f"beam {name!r}: curve at the fraction {fraction:.6g}")

    length, fraction_at = _measure(position, curve.breaks, name)
    met = _LOBATTO[degree]
    fractions = (np.arange(elements)[:, None] + met[:-1]).ravel() / elements
    points = np.array([position(fraction_at(length * x)) for x in (*fractions, 1.0)])
    s = length * np.linspace(0, 1, elements + 1)
    _check_followed(points[::degree], s, name)
    ends: list = list(points[::degree])
    for i, node, verb in ((0, curve.start, "starts"), (-1, curve.end, "ends")):
        if node is None:
            continue
        gap = math.dist((node.x, node.y), points[i])
        if gap > 1e-9 * length:
            raise SceneError(
                f"beam {name!r}: its curve {verb} at ({points[i, 0]:g}, {points[i, 1]:g}), "
                f"{gap:.3g} away from {node} that it should share. Move the node or the curve"
            )
        ends[i] = node
    element_points = points[degree * np.arange(elements)[:, None] + np.arange(degree + 1)]
    inner = lagrange(met, np.arange(1, degree) / degree) @ element_points
    return BeamLayout(ends, s, inner)


def _check_followed(ends: np.ndarray, s: np.ndarray, name: str) -> None:
    """Refuse elements that are too long for the curve, such as one element for a whole circle."""
    chords, lengths = np.hypot(*np.diff(ends, axis=0).T), np.diff(s)
    k = int(np.argmin(chords / lengths))
    if chords[k] < 0.5 * lengths[k]:
        raise SceneError(
            f"beam {name!r}: {len(chords)} elements are too few for its curve: element {k} is "
            f"{lengths[k]:.3g} long, but its ends are {chords[k]:.3g} apart. Use more elements"
        )


def _measure(position, breaks, name: str) -> tuple[float, Callable[[float], float]]:
    """Length of a curve, and a function from the distance along it to the fraction."""
    cuts = np.unique([0.0, *breaks, 1.0])
    size = max(abs(position(cut)).max() for cut in cuts.tolist())
    pieces = _pieces(position, cuts.tolist(), size, name)
    ends = np.cumsum([0.0, *(piece.length for piece in pieces)])
    length = float(ends[-1])
    # Imported here, as in `spline`.
    from scipy.optimize import brentq

    def fraction_at(distance: float) -> float:
        i = min(int(np.searchsorted(ends, distance, side="right")) - 1, len(pieces) - 1)
        piece, left = pieces[i], distance - ends[i]
        if left <= 1e-13 * length:
            return piece.start
        if left >= piece.length - 1e-13 * length:
            return piece.end
        length_to = piece.length_to
        return brentq(lambda x: length_to(x) - left, piece.start, piece.end, xtol=1e-15, rtol=1e-15)

    return length, fraction_at


class _Piece(NamedTuple):
    """A piece of a curve: fractions at its ends, its length, and the arc length from its start."""

    start: float
    end: float
    length: float
    length_to: Chebyshev


def _pieces(position, cuts: list[float], size: float, name: str) -> list[_Piece]:
    """Pieces of a curve in order, bisected until halving them does not change their length."""
    left = [_piece(position, a, b) for a, b in itertools.pairwise(cuts)][::-1]
    length = sum(piece.length for piece in left)
    if not length > 1e-9 * size:  # less is round-off
        raise SceneError(f"beam {name!r}: its curve has no length; its points coincide")
    negligible = 1e-12 * length + 16 * _ROUNDING * size
    pieces: list[_Piece] = []
    while left:
        whole = left.pop()
        middle = (whole.start + whole.end) / 2
        halves = [_piece(position, whole.start, middle), _piece(position, middle, whole.end)]
        # Each half by itself: a jump in one of them may leave their sum unchanged.
        first = whole.length_to(middle)
        change = abs(halves[0].length - first) + abs(halves[1].length - (whole.length - first))
        if change <= negligible:
            pieces += halves
        elif whole.end - whole.start > 4 * _ROUNDING * (whole.end + _ROUNDING):
            left += halves[::-1]
        elif whole.length <= 1e-6 * length:  # a corner, or infinite speed at the start
            pieces.append(whole)
        else:
            raise SceneError(
                f"beam {name!r}: its curve jumps at the fraction {round(middle, 9):g}; it must be "
                "continuous. Make two beams, one on each side of the jump"
            )
        if len(pieces) + len(left) > _MOST_PIECES:
            raise SceneError(
                f"beam {name!r}: its curve has too many corners. Give their fractions as breaks of "
                "an fx_beam.Curve, or use a spline or a polyline"
            )
    return pieces


def _piece(position, a: float, b: float) -> _Piece:
    # scipy.integrate needs the speed, but users give positions. With differences of positions it
    # reaches 1e-10 where this reaches round-off, and fails where the speed is infinite at an end.
    points = np.array([position((a * (1 - x) + b * (1 + x)) / 2) for x in _POINTS.tolist()])
    speed = np.hypot(*(_DERIVATIVE @ (points - points[0])).T)
    length_to = Chebyshev(_INTEGRAL @ speed, domain=[a, b])
    return _Piece(a, b, float(length_to(b)), length_to)
