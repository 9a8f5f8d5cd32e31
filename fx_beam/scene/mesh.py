"""A mesh of beams: points, and cells between them, from arrays or from another program."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.dual import stacked
from fx_beam.errors import LARGEST, SceneError, is_one_of, is_whole, numbers, require, shown

from .beam import MOST_ELEMENTS, Beam, Node
from .section import Section

_JOINTS = "rigid", "pin"
_WANTED = "rows of two numbers of points, one row for each beam"


class MeshBeams(list[Beam]):
    """The beams of a mesh, in the order of its cells.

    Attributes
    ----------
    nodes : list of Node
        The node at each point of the mesh; with pins that of the first beam there, to which those
        of the others are joined.
    """

    def __init__(self, nodes: list[Node]):
        super().__init__()
        self.nodes = nodes


@dataclass
class Mesh:
    """Points (n, 2), cells (m, 2) and the section of each, checked."""

    points: Any
    cells: list[tuple[int, int]]
    #: Lengths (m,) of the cells [m].
    lengths: np.ndarray
    sections: list[Section]


def checked(points: Any, cells: Any, section: Any, elements: Any, tags: Any, joints: Any) -> Mesh:
    """What was given as a mesh; SceneError for what is none."""
    require(is_one_of(joints, _JOINTS), "add_mesh: joints", joints, f"one of {_JOINTS}")
    fits = is_whole(elements, 1, MOST_ELEMENTS)
    require(fits, "add_mesh: elements", elements, f"a whole number from 1 to {MOST_ELEMENTS:,}")
    at = numbers(points)
    fits = at.ndim == 2 and at.shape[1] == 2 and bool((abs(at) <= LARGEST).all())
    require(fits, "add_mesh: points", points, "finite (x, y), one row for each point")
    table = np.asarray(cells)
    fits = table.ndim == 2 and table.shape[1] == 2 and len(table) > 0 and table.dtype.kind in "iu"
    require(fits, "add_mesh: cells", cells, _WANTED)
    _check_cells(at, table)
    ends = at[table]
    lengths = np.hypot(*(ends[:, 1] - ends[:, 0]).T)
    for cell in np.flatnonzero(lengths <= 1e-12 * np.ptp(at, axis=0).max()):
        a, b = table[cell]
        raise SceneError(f"add_mesh: cell {cell} has no length: the points {a} and {b} coincide")
    pairs = [*map(tuple, table.tolist())]
    return Mesh(stacked(points), pairs, lengths, _sections(section, tags, len(table)))


def _check_cells(points: np.ndarray, cells: np.ndarray) -> None:
    """Refuse cells between points that do not exist, doubled ones, and points without a cell."""
    outside = (cells < 0) | (cells >= len(points))
    for cell in np.flatnonzero(outside.any(axis=1)):
        raise SceneError(
            f"add_mesh: cell {cell} lies between the points {cells[cell].tolist()}, but there are "
            f"the points 0 to {len(points) - 1}"
        )
    _, first, count = np.unique(np.sort(cells), axis=0, return_index=True, return_counts=True)
    for cell in first[count > 1]:
        a, b = cells[cell].tolist()
        raise SceneError(f"add_mesh: several cells lie between the points {a} and {b}: keep one")
    for point in np.setdiff1d(np.arange(len(points)), cells):
        x, y = points[point]
        raise SceneError(
            f"add_mesh: point {point} at ({x:g}, {y:g}) belongs to no cell. Leave it out; programs "
            "for meshes may add points for themselves"
        )


def _sections(section: Any, tags: Any, count: int) -> list[Section]:
    """The section of each cell: one for all, or by its tag."""
    if tags is None:
        wanted = "an fx_beam.Section; for several give a dictionary by tags, and the tags"
        require(isinstance(section, Section), "add_mesh: section", section, wanted)
        return [section] * count
    fits = isinstance(section, Mapping) and all(isinstance(s, Section) for s in section.values())
    require(fits, "add_mesh: section", section, "with tags a dictionary of sections by tag")
    listed = np.asarray(tags).tolist()
    fits = isinstance(listed, list) and len(listed) == count
    require(fits, "add_mesh: tags", tags, f"a sequence of {count} tags, one for each cell")
    for cell, tag in enumerate(listed):
        if tag not in section:
            raise SceneError(
                f"add_mesh: cell {cell} has the tag {shown(tag)}, for which there is no section; "
                f"there are {shown([*section])}"
            )
    return [section[tag] for tag in listed]
