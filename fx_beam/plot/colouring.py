"""Members coloured by a quantity: stress resultants, stored energy or speed."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection
from matplotlib.colors import LinearSegmentedColormap, Normalize, to_hex

from fx_beam.results.fields import QUANTITIES, RESULTANTS, along_all
from fx_beam.validation import is_one_of, shown

from .drawing import Drawing

# Without the palest colours, which are hard to see on white.
SEQUENTIAL = LinearSegmentedColormap.from_list(
    "sequential", matplotlib.colormaps["viridis"](np.linspace(0, 0.92, 256))
)
# Blue below zero and red above; grey and not white in between.
SIGNED = matplotlib.colormaps["coolwarm"]
WORDS = {
    "N": "axial force $N$",
    "Q": "shear force $Q$",
    "M": "bending moment $M$",
    "strain energy": "strain energy per length",
    "speed": "speed",
}
_PIECES = 12  # per element, each with one colour
_MANY = 40_000  # pieces of all elements, of which there are no more if an element has several


def is_signed(quantity: str) -> bool:
    """Whether a quantity has both signs: stress resultants and internal variables."""
    return quantity in RESULTANTS or quantity not in QUANTITIES


def unit_of(quantity: str, scene_unit: str) -> str:
    """Unit of a quantity; empty if that of the scene is not the metre, as it is not known then."""
    return QUANTITIES.get(quantity, "") if scene_unit == "m" else ""


def words_for(quantity: str, scene_unit: str) -> str:
    """A quantity in words, with its unit."""
    unit = unit_of(quantity, scene_unit)
    return WORDS.get(quantity, quantity) + (f" [{unit}]" if unit else "")


def hexadecimal(scale, count: int) -> list[str]:
    """Colours of a scale from one end to the other, as pages write them."""
    return [to_hex(scale(i / (count - 1))) for i in range(count)]


class Colouring:
    """Colours of the members for one quantity, on the same scale in all rows of a drawing."""

    def __init__(self, drawing: Drawing, quantity: str, scene_unit: str):
        if not drawing.solution.beams:
            raise ValueError(f"colour = {quantity!r} needs beams, but the solution has none")
        internal = {name for own in drawing.solution.internal_of_beam.values() for name in own}
        if not is_one_of(quantity, {*QUANTITIES, *internal}):
            known = ", ".join(repr(name) for name in [*QUANTITIES, *sorted(internal)])
            raise ValueError(f"colour = {shown(quantity)} must be one of {known}, or None")
        self._drawing = drawing
        elements = sum(beam.elements for beam in drawing.solution.beams.values())
        self._pieces = max(1, min(_PIECES, _MANY // elements))
        middles = (np.arange(self._pieces) + 0.5) / self._pieces
        values = along_all(drawing.solution, quantity, drawing.rows, middles)
        rows = values.reshape(len(drawing.rows), -1)
        self._values = dict(zip(drawing.rows, rows, strict=True))
        largest = abs(values).max() or 1.0
        signed = is_signed(quantity)
        norm = Normalize(-largest if signed else 0.0, largest)
        #: The scale, for a colour bar, and its label.
        self.scale = ScalarMappable(norm, SIGNED if signed else SEQUENTIAL)
        self.label = words_for(quantity, scene_unit)

    def lines(self, width: float, zorder: float = 2) -> LineCollection:
        """Lines for the members, which `paint` colours."""
        look: dict[str, Any] = {"linewidth": width, "capstyle": "round", "zorder": zorder}
        return LineCollection([], norm=self.scale.norm, cmap=self.scale.cmap, **look)

    def paint(self, lines: LineCollection, k: int) -> LineCollection:
        """Move the lines to the members' positions in row k, and colour them."""
        drawing = self._drawing
        lines.set_segments(list(drawing.pieces(k, self._pieces)))
        lines.set_array(self._values[k])
        return lines
