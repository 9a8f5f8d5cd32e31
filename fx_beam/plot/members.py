"""Members in pictures: lines, or bands as thick as the members are."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
from matplotlib.collections import LineCollection, PolyCollection

from fx_beam.scene.beam import Beam, arc_lengths
from fx_beam.scene.obstacles import Obstacle
from fx_beam.validation import as_float, positive

from .drawing import Drawing

_PIECES = 12  # per element, each with one colour
_NONE = np.empty((0, 1))
_MANY = 6_000  # pieces of all elements, of which there are no more if an element has several


class Members:
    """All members of a drawing, in pieces of their elements.

    Attributes
    ----------
    pieces : int
        Pieces of an element.
    """

    def __init__(self, drawing: Drawing, thickness: float | None = None):
        self._drawing, self._depths = drawing, None
        beams = drawing.solution.beams.values()
        elements = sum(beam.elements for beam in beams)
        self.pieces = max(1, min(_PIECES, _MANY // max(elements, 1)))
        if thickness is not None:
            positive(thickness, "thickness", "a positive factor on the depth, or None")
            fractions = np.arange(self.pieces + 1) / self.pieces
            touching = _contact_depths(drawing.solution.obstacles)
            depths = [
                np.full((beam.elements, len(fractions)), touching[beam.name])
                if beam.name in touching
                else _depths(beam, fractions)
                for beam in beams
            ]
            self._depths = as_float(thickness) * np.concatenate(depths or [_NONE])[..., None]

    def collection(
        self, width: float, zorder: float = 2, **look
    ) -> LineCollection | PolyCollection:
        """What shows the members, without a position: lines of a width [points], or bands."""
        # They are inside of the axes: a layout that asks each piece would be slow.
        look = {"zorder": zorder, "in_layout": False} | look
        if self._depths is None:
            width *= self._drawing.thinness
            return LineCollection([], linewidth=width, capstyle="round", **look)
        # A thin edge of the same colour closes the gaps between the pieces.
        return PolyCollection([], edgecolor="face", linewidth=0.3, **look)

    def move(self, collection: Any, k: int) -> None:
        """Move what shows the members to their positions in row k."""
        points = self._drawing.along_elements(k, self.pieces)
        if self._depths is None:
            pieces = np.stack([points[:, :-1], points[:, 1:]], axis=2)
            collection.set_segments(list(pieces.reshape(-1, 2, 2)))
            return
        aside = self._depths / 2 * self._drawing.normals(k, self.pieces)
        left, right = points + aside, points - aside
        corners = [left[:, :-1], left[:, 1:], right[:, 1:], right[:, :-1]]
        collection.set_verts(list(np.stack(corners, axis=2).reshape(-1, 4, 2)))

    def per_piece(self, values) -> np.ndarray:
        """One value for each member, repeated for its pieces."""
        counts = [beam.elements * self.pieces for beam in self._drawing.solution.beams.values()]
        return np.repeat(np.asarray(values), counts, axis=0)


def _contact_depths(contacts: Iterable[Obstacle]) -> dict[str, float]:
    """Thickness with which members touch, by their names; where they have several the largest."""
    depths: dict[str, float] = {}
    for contact in contacts:
        radii = np.broadcast_to(contact.radius, 2)
        for member, radius in zip((contact.target, contact.shape), radii.tolist(), strict=True):
            if isinstance(member, Beam) and radius > 0:
                depths[member.name] = max(depths.get(member.name, 0.0), 2 * radius)
    return depths


def _depths(beam: Beam, fractions: np.ndarray) -> np.ndarray:
    """Depths (elements, points) of rectangles with the stiffnesses or masses of a beam [m]."""
    if beam.section is None:
        raise ValueError(
            f"thickness needs the section of {beam.name!r}, which a saved file does not hold; take "
            "the solution as simulate gave it"
        )
    s = arc_lengths(beam, fractions) / beam.length
    for bending, axial in ("EI", "EA"), ("rhoI", "rhoA"):
        given, second = beam.section.values(axial, s), beam.section.values(bending, s)
        if given.all() and second.all():
            return np.sqrt(12 * second / given)
    raise ValueError(
        f"thickness needs EA and EI, or rhoA and rhoI, in the section of {beam.name!r}"
    )
