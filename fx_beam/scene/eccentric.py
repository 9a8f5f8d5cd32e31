"""Beams with their axis at a distance from the line of their points."""

from __future__ import annotations

import numpy as np

from fx_beam.dual import dual_array, floats
from fx_beam.errors import SceneError, finite

from .beam import BeamLayout, lagrange_and_slopes, lengths_to_ends, position_of

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
    return BeamLayout([*axis], lengths_to_ends(np.stack(nodes, axis=1)), inner_nodes)


def _left_of(points: list) -> list:
    """Unit vectors (n, 2) to the left of n elements at each of their nodes."""
    places, normals = np.linspace(0.0, 1.0, len(points)), []
    for slopes in lagrange_and_slopes(places, places)[1]:
        x, y = sum(slope * point for slope, point in zip(slopes, points, strict=True)).T
        normals.append(np.stack([-y, x], axis=1) / np.hypot(x, y)[:, None])
    return normals


def _place(point: np.ndarray) -> str:
    return "at ({:g}, {:g})".format(*floats(point))
