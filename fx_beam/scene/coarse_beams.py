"""Warnings of beams whose elements are too coarse for their sections, as far as the scene tells."""

from __future__ import annotations

import numpy as np

from fx_beam.dual import floats
from fx_beam.errors import SceneError, warn_once

from .beam import Beam
from .section import values_along

# Relative change of a quantity within an element that counts, and its part that is left only of a
# jump after so many halvings of the element; distance of the first places to its ends.
_CHANGE, _LEFT, _HALVINGS, _INSIDE = 0.02, 0.5, 16, 1e-6
# Places in an element between which a quantity is looked at first.
_PLACES = np.array([_INSIDE, 0.25, 0.5, 0.75, 1 - _INSIDE])
# Number of elements of degree 2 or 3 from which on two layers bend as one, with an error below 1 %.
_LAYER_ELEMENTS = 16


def warn_of_coarse_elements(beam: Beam) -> None:
    """Warn of stiffness or mass that jumps in an element, and of layers held at few places."""
    for name in ("EA", "GA", "EI", "rhoA", "rhoI"):
        place = None
        if beam.section.varies(name):
            try:
                place = _jump(beam, name)
            except SceneError:  # the analysis says where the function fails
                return
        if place is not None:
            warn_once(
                f"beam {beam.name!r}: {name} jumps inside an element, near the fraction "
                f"{place:.4g} of its length: deflections or frequencies may be wrong by several "
                "per cent. Begin a new beam there, or take elements that end there"
            )
            return
    if beam.carriers and beam.degree > 1 and beam.elements < _LAYER_ELEMENTS:
        warn_once(
            f"beam {beam.name!r}: its offset is held at the ends of its {beam.elements} elements "
            f"only, of degree {beam.degree}: two layers bend as one with {_LAYER_ELEMENTS} "
            "elements or more; take them, or degree=1"
        )


def _jump(beam: Beam, name: str) -> float | None:
    """The fraction of the length at which a quantity jumps inside an element; None if nowhere."""
    edges = floats(beam.s) / float(beam.length)

    def logs(places: np.ndarray) -> np.ndarray:
        values = floats(values_along(beam.section, name, places, None))
        return np.log(np.maximum(values, np.finfo(float).tiny))  # masses may be zero

    places = edges[:-1, None] + np.diff(edges)[:, None] * _PLACES
    changes = abs(np.diff(values := logs(places), axis=1))
    first = changes.argmax(axis=1)
    rows = np.flatnonzero(changes.max(axis=1) > _CHANGE)
    low, high = places[rows, first[rows]], places[rows, first[rows] + 1]
    at_low, at_high = values[rows, first[rows]], values[rows, first[rows] + 1]
    most = abs(at_high - at_low)
    for _ in range(_HALVINGS):
        rows = np.flatnonzero(abs(at_high - at_low) > _LEFT * most)
        if not len(rows):
            return None
        low, high, at_low, at_high, most = (x[rows] for x in (low, high, at_low, at_high, most))
        middle = (low + high) / 2
        value = logs(middle)
        ahead = abs(at_high - value) > abs(value - at_low)
        low, at_low = np.where(ahead, middle, low), np.where(ahead, value, at_low)
        high, at_high = np.where(ahead, high, middle), np.where(ahead, at_high, value)
    return float((low[0] + high[0]) / 2)
