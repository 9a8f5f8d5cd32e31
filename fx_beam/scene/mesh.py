"""A mesh of points and cells, as arrays: the nodes of its straight beams, and their sections."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from typing import NamedTuple

import numpy as np

from fx_beam.dual import MaybeDual, dual_array, floats
from fx_beam.errors import LARGEST, SceneError, positive, real_array, shown

from .beam import MOST_ELEMENTS, Beam, Node
from .section import Section


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
        tolerance = positive(join, "add_mesh: join")
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
    for i in np.flatnonzero(~(abs(floats(places)) <= LARGEST).all(axis=1)):
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
