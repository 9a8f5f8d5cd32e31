"""Lines of beams: arcs, splines, functions, meshes of cells, and lines beside the axis."""

from __future__ import annotations

import functools
import itertools
import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import Chebyshev, chebder, chebint, chebpts1, chebpts2, chebvander

from fx_beam import errors
from fx_beam.dual import MaybeDual, dual_array, floats
from fx_beam.errors import SceneError, finite, is_flag, is_whole, real_array, require, shown, vector

from . import beam as beams
from .beam import MOST_ELEMENTS, Beam, BeamLayout, Node, lagrange, polyline, position_of
from .functions import checked_function
from .section import Section

# -- Arcs, splines and functions along which a beam may run, measured by arc length -------------
# A curved element is a polynomial of its degree, with equidistant nodes. It interpolates the
# curve at the Gauss-Lobatto points in arc length: at the Gauss points its tangent is then more
# accurate, and lengths, chords and strain energy converge with order 2p, as on straight elements.
# For degree 3 with nodes on the curve at thirds of the length the order would be 4 instead of 6;
# for degree 2 both choices are the same. Example: a quarter circle of 16 elements of degree 3 is
# bent straight; the error of its tip is 3e-12 of the radius, instead of 3e-8. The inner nodes of
# degree 3 are off the curve by an error of order 4.


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

    The curvature has kinks at the points, which limits the order of convergence to 4. Where
    distances between points change much the curve swings out beyond them: draw it, add points, or
    take a `monotone` curve. A polyline is a list of points without `spline`.

    Parameters
    ----------
    points : sequence of (x, y) or Node
        Two or more points [m]; the first and the last may be nodes of other beams, which are
        shared rigidly. If these two coincide, the curve closes smoothly.
    monotone : bool
        Whether x and y are monotone between two points (Fritsch and Carlson): the curve stays
        within the rectangle of both points. The curvature then jumps at points, and the curve does
        not close smoothly.

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
    points, positions = beams.listed_points(points, "spline")
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
        count = beams.USUAL_ELEMENTS[degree] if elements is None else elements
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


# -- Beams with their axis at a distance from the line of their points --------------------------


#: Lines turn by at most 150 degrees in a corner; 1 + cos of that.
_SHARPEST = 1 - np.cos(np.radians(30.0))


def shifted(line: BeamLayout, offset: float, name: str) -> BeamLayout:
    """The axis at a distance `offset` to the left of a line, mitred in corners."""
    offset = finite(offset, f"beam {name!r}: offset")
    ends = dual_array([position_of(end) for end in line.ends])
    inner = [] if line.inner is None else [*np.swapaxes(dual_array(line.inner), 0, 1)]
    points = [ends[:-1], *inner, ends[1:]]
    normals = _left_of(points)
    last_normals, next_normals = normals[-1][:-1], normals[0][1:]
    mitre = 1 + np.sum(last_normals * next_normals, axis=1)
    for i in np.flatnonzero(floats(mitre) < _SHARPEST):
        raise SceneError(
            f"beam {name!r}: the corner {_place(ends[i + 1])} is too sharp for an axis with an "
            "offset. Make two beams of it"
        )
    corner_normals = (last_normals + next_normals) / mitre[:, None]
    if line.inner is not None and len(points) == 2 and len(ends) > 2:
        # At the ends of a curve chords have an error of first order; parabolas have not.
        normals[0][:1] = _left_of([ends[i : i + 1] for i in range(3)])[0]
        normals[1][-1:] = _left_of([ends[i : i + 1] for i in (-3, -2)] + [ends[-1:]])[-1]
    axis = ends + offset * np.concatenate([normals[0][:1], corner_normals, normals[-1][-1:]])
    inner = [point + offset * n for point, n in zip(inner, normals[1:-1], strict=True)]
    forward = np.sum(np.diff(axis, axis=0) * np.diff(ends, axis=0), axis=1)
    for i in np.flatnonzero(floats(forward) <= 0):
        raise SceneError(
            f"beam {name!r}: with the offset {offset:g} the axis goes back {_place(ends[i])}, "
            "as the line is curved more. Take a smaller offset, or the other side"
        )
    nodes = [floats(point) for point in (axis[:-1], *inner, axis[1:])]
    inner_nodes = np.stack(inner, axis=1) if inner else None
    return BeamLayout([*axis], beams.lengths_to_ends(np.stack(nodes, axis=1)), inner_nodes)


def _left_of(points: list) -> list:
    """Unit vectors (n, 2) to the left of n elements at each of their nodes."""
    places, normals = np.linspace(0.0, 1.0, len(points)), []
    for slopes in beams.lagrange_and_slopes(places, places)[1]:
        x, y = sum(slope * point for slope, point in zip(slopes, points, strict=True)).T
        normals.append(np.stack([-y, x], axis=1) / np.hypot(x, y)[:, None])
    return normals


def _place(point: np.ndarray) -> str:
    return "at ({:g}, {:g})".format(*floats(point))


# -- A mesh of points and cells, as arrays: the nodes of its straight beams, and their sections -


class MeshBeams(list[Beam]):
    """Beams of a mesh, in the order of its cells."""

    def __init__(self, nodes: list[Node], cells: list[int]):
        super().__init__()
        #: Nodes at the points of the mesh, in their order; number of the cell of each beam.
        self.nodes, self.cells = nodes, cells

    def __repr__(self):
        return f"<{len(self)} beams between {len(self.nodes)} points>"


class MeshLayout(NamedTuple):
    """Nodes of a mesh, in order: at points, nodes that pins join to points, nodes in cells."""

    #: Number of points.
    points: int
    #: Positions of all nodes (n, 2) [m].
    positions: np.ndarray
    #: Pairs (k, 2) of nodes that pins join; the first one is at a point.
    pins: np.ndarray
    #: Where each cell begins in `nodes` and `s`, and the length of both (m + 1,).
    starts: np.ndarray
    #: Nodes of the cells, one cell after the other.
    nodes: np.ndarray
    #: Arc length at these nodes, from the start of the cell [m].
    s: np.ndarray
    #: Node at each point of the user, and the user's cell of which each cell is a part.
    node_of_point: np.ndarray
    source_cell: np.ndarray


class _Joined(NamedTuple):
    """Points (n, 2) and cells (m, 2) that are joined; by the user's points and cells.

    `point` has the new point of each old one, `cell` the old cell of each new one.
    """

    places: MaybeDual
    pairs: np.ndarray
    point: np.ndarray
    cell: np.ndarray


def mesh_layout(points, cells, elements, pinned: bool, join: float | None) -> MeshLayout:
    """Nodes of a mesh; SceneError for points, cells or elements that do not fit."""
    places = _checked_points(points)
    pairs = _checked_cells(cells, len(places))
    elements = _checked_elements(elements, len(pairs))
    point, source = np.arange(len(places)), np.arange(len(pairs))
    if join is not None:
        tolerance = errors.positive(join, "add_mesh: join")
        places, pairs, point, source = _joined(places, pairs, tolerance)
    count, lengths = len(places), _checked_lengths(floats(places), pairs)
    share = lengths / np.bincount(source, lengths)[source]
    elements = np.maximum(1, np.rint(share * elements[source])).astype(int)
    ends, pinned_ends = pairs.flatten(), np.empty(0, int)
    if pinned:  # of the cells at a point the first one has the node there
        pinned_ends = _repeated(ends)
        ends[pinned_ends] = count + np.arange(len(pinned_ends))
    pinned_points = pairs.flat[pinned_ends]
    starts = np.concatenate(([0], np.cumsum(elements + 1)))
    cell = np.repeat(np.arange(len(pairs)), elements + 1)
    fractions = (np.arange(len(cell)) - starts[cell]) / elements[cell]
    is_inner = (fractions > 0) & (fractions < 1)
    nodes = np.empty(len(cell), int)
    nodes[~is_inner] = ends
    nodes[is_inner] = count + len(pinned_ends) + np.arange(np.count_nonzero(is_inner))
    a, b = (places[pairs[cell[is_inner], i]] for i in (0, 1))
    inner_positions = a + fractions[is_inner, None] * (b - a)
    positions = np.concatenate([places, places[pinned_points], inner_positions])
    pins = np.column_stack([pinned_points, ends[pinned_ends]])
    s = lengths[cell] * fractions
    return MeshLayout(count, positions, pins, starts, nodes, s, point, source)


def _joined(places: MaybeDual, pairs: np.ndarray, tolerance: float) -> _Joined:
    """Points as near as a tolerance [m] become one; cells are divided at points as near to them.

    The first of such points stays. Cells between points that become one go.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    X, count = floats(places), len(places)
    near = cKDTree(X).query_pairs(tolerance, output_type="ndarray")
    graph = coo_array((np.ones(len(near)), near.T), (count, count))
    group = connected_components(graph, directed=False)[1]
    first, point = np.unique(np.unique(group, return_index=True)[1][group], return_inverse=True)
    for i in np.flatnonzero(np.hypot(*(X - X[first[point]]).T) > 2 * tolerance):
        raise SceneError(
            f"add_mesh: join = {tolerance:g} makes one point of {first[point[i]]} and {i}, with "
            "others between them. Give less"
        )
    X, ends = X[first], point[pairs]
    cell = np.flatnonzero(ends[:, 0] != ends[:, 1])
    for i in np.setdiff1d(np.arange(len(first)), ends[cell]):
        raise SceneError(f"add_mesh: all cells at point {first[i]} are shorter than join")
    start, way = X[ends[cell, 0]], X[ends[cell, 1]] - X[ends[cell, 0]]
    length = np.hypot(*way.T)
    close = cKDTree(X).query_ball_point(start + way / 2, length / 2 + tolerance)
    # Pairs of a cell and a point near it; both ends are among the points, at 0 and at the length.
    row, near_point = np.repeat(np.arange(len(cell)), [*map(len, close)]), np.concatenate(close)
    along, arm = way[row] / length[row, None], X[near_point] - start[row]
    s, beside = (arm * along).sum(axis=1), abs(arm[:, 0] * along[:, 1] - arm[:, 1] * along[:, 0])
    is_end = (near_point[:, None] == ends[cell[row]]).any(axis=1)
    divides = is_end | ((s > 0) & (s < length[row]) & (beside <= tolerance))
    order = np.flatnonzero(divides)[np.lexsort((s[divides], row[divides]))]
    row, near_point = row[order], near_point[order]
    piece = np.flatnonzero(row[1:] == row[:-1])
    new, source = np.column_stack([near_point[piece], near_point[piece + 1]]), cell[row[piece]]
    keys = np.sort(new, axis=1) @ (len(first), 1)
    for k in _repeated(keys):
        twins = sorted({*source[keys == keys[k]].tolist()})
        (x, y), (x1, y1) = X[new[k]]
        raise SceneError(
            f"add_mesh: cells {twins} lie on one another between ({x:g}, {y:g}) and ({x1:g}, "
            f"{y1:g}). Leave one out there"
        )
    return _Joined(places[first], new, point, source)


def _repeated(values: np.ndarray) -> np.ndarray:
    """Indices of values that occur before in the array."""
    return np.setdiff1d(np.arange(len(values)), np.unique(values, return_index=True)[1])


def _checked_points(points: object) -> MaybeDual:
    """Positions (n, 2) [m], with slopes if they have any."""
    places = real_array(points)
    if places.ndim != 2 or places.shape[1] != 2:
        depth = ". Take x and y: points[:, :2]" if places.shape[1:] == (3,) else ""
        raise SceneError(
            f"add_mesh: points must be an array (n, 2) of numbers, not {shown(points)}{depth}"
        )
    for i in np.flatnonzero(~(abs(floats(places)) <= errors.LARGEST).all(axis=1)):
        raise SceneError(
            f"add_mesh: point {i} at ({places[i, 0]:g}, {places[i, 1]:g}) is not finite, or too far"
        )
    return dual_array(places)


def _checked_cells(cells: object, count: int) -> np.ndarray:
    """Points at both ends of each cell (m, 2), of so many points."""
    pairs = real_array(cells)
    if pairs.ndim != 2 or pairs.shape[1] != 2 or not pairs.size or (pairs != np.floor(pairs)).any():
        raise SceneError(
            "add_mesh: cells must be an array (m, 2) of whole numbers, the points at both ends, "
            f"not {shown(cells)}"
        )
    for k in np.flatnonzero(((pairs < 0) | (pairs >= count)).any(axis=1)):
        start = ". If they count from 1, give cells - 1" if pairs.min() == 1 else ""
        raise SceneError(
            f"add_mesh: {_named(k, pairs)} has a point that is not among the {count} points, which "
            f"count from 0{start}"
        )
    ends = pairs.astype(int)
    unused = np.setdiff1d(np.arange(count), ends)
    if len(unused):
        raise SceneError(
            f"add_mesh: no cell has the points {shown(unused.tolist())}. Leave them out: kept, "
            "cells = np.unique(cells, return_inverse=True), then points[kept] and "
            "cells.reshape(-1, 2)"
        )
    keys = np.sort(ends, axis=1) @ (count, 1)
    for k in _repeated(keys):
        twin = int(np.argmax(keys == keys[k]))
        raise SceneError(
            f"add_mesh: {_named(k, pairs)} is there twice, also as cell {twin}. Leave one out"
        )
    return ends


def _checked_lengths(places: np.ndarray, ends: np.ndarray) -> np.ndarray:
    """Lengths (m,) of cells [m]."""
    lengths = np.hypot(*(places[ends[:, 1]] - places[ends[:, 0]]).T)
    shortest = max(1e-12 * np.ptp(places, axis=0).max(), 1e-15 * abs(places).max())
    for k in np.flatnonzero(lengths <= shortest):
        raise SceneError(
            f"add_mesh: {_named(k, ends)} has no length, as both points are at "
            f"({places[ends[k, 0], 0]:g}, {places[ends[k, 0], 1]:g}). Leave it out"
        )
    return lengths


def _named(k: int, cells: np.ndarray) -> str:
    return f"cell {k} = ({cells[k, 0]:.0f}, {cells[k, 1]:.0f})"


def _checked_elements(elements: object, count: int) -> np.ndarray:
    """Numbers of elements (m,) of so many cells."""
    counts = real_array(elements)
    ok = counts.shape in ((), (count,)) and (counts == np.floor(counts)).all()
    if not ok or not ((counts >= 1) & (counts <= MOST_ELEMENTS)).all():
        raise SceneError(
            f"add_mesh: elements = {shown(elements)} must be a whole number from 1 to "
            f"{MOST_ELEMENTS:,}, or one for each of the {count} cells"
        )
    return np.broadcast_to(counts.astype(int), count)


def sections_of(section, tags, count: int) -> list[Section]:
    """Sections of `count` cells, by tags if given; SceneError for a cell without a section."""
    if isinstance(section, Mapping) != (tags is not None):
        lack = "a dict of sections by tag" if tags is not None else "the tag of each cell as tags"
        raise SceneError(f"add_mesh: tags choose sections from a dict; give {lack}, too")
    sections = {None: section} if tags is None else section
    for tag, part in sections.items():
        if not isinstance(part, Section):
            key = "" if tags is None else f" of the tag {shown(tag)}"
            raise SceneError(
                f"add_mesh: section{key} must be an fx_beam.Section, not {shown(part)}"
            )
    listed = [None] * count if tags is None else np.array(tags, object).tolist()
    if not isinstance(listed, list) or len(listed) != count:
        raise SceneError(f"add_mesh: tags = {shown(tags)} must be one for each of {count} cells")
    for k, tag in enumerate(listed):
        if not isinstance(tag, Hashable) or tag not in sections:
            raise SceneError(
                f"add_mesh: cell {k} has the tag {shown(tag)}, which has no section; there are "
                f"sections of {shown([*sections])}"
            )
    return [sections[tag] for tag in listed]
