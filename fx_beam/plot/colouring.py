"""Members coloured by a quantity: stress resultants, stored energy or speed."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.colors import LinearSegmentedColormap, LogNorm, Normalize, SymLogNorm, to_hex

from fx_beam.results.fields import QUANTITIES, RESULTANTS, along_all
from fx_beam.validation import as_float, is_one_of, numbers, require, shown

from .drawing import Drawing
from .members import Members

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
_SCALES = "linear", "log"
_DECADES = 1e-4  # smallest value on a logarithmic scale, as a fraction of the largest


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
    """Colours of the members for one quantity, on the same scale in all rows of a drawing.

    Attributes
    ----------
    scale : ScalarMappable
        The scale, for a colour bar.
    bar : dict
        How the colour bar looks, and its label.
    """

    def __init__(
        self,
        drawing: Drawing,
        quantity: str,
        scene_unit: str,
        limits: tuple[float, float] | None = None,
        scale: str = "linear",
        thickness: float | None = None,
    ):
        if not drawing.solution.beams:
            raise ValueError(f"colour = {quantity!r} needs beams, but the solution has none")
        internal = {name for own in drawing.solution.variables_of_beam.values() for name in own}
        if not is_one_of(quantity, {*QUANTITIES, *internal}):
            known = ", ".join(repr(name) for name in [*QUANTITIES, *sorted(internal)])
            raise ValueError(f"colour = {shown(quantity)} must be one of {known}, or None")
        require(is_one_of(scale, _SCALES), "colour_scale", scale, "'linear' or 'log'")
        self._members = Members(drawing, thickness)
        middles = (np.arange(self._members.pieces) + 0.5) / self._members.pieces
        values = along_all(drawing.solution, quantity, drawing.rows, middles)
        rows = values.reshape(len(drawing.rows), -1)
        signed = is_signed(quantity)
        norm, (least, most) = _norm(values, signed, limits, scale == "log")
        low, high = bool((rows < least).any()), bool((rows > most).any())
        if isinstance(norm, LogNorm):  # zero has the colour of the low end
            rows = np.maximum(rows, least)
        self._values = dict(zip(drawing.rows, rows, strict=True))
        self.scale = ScalarMappable(norm, SIGNED if signed else SEQUENTIAL)
        beyond = {(True, True): "both", (True, False): "min", (False, True): "max"}
        self.bar: dict[str, Any] = {"label": words_for(quantity, scene_unit)}
        self.bar["extend"] = beyond.get((low, high), "neither")
        if scale == "linear":
            self.bar["format"] = "%.3g"

    def lines(self, width: float, zorder: float = 2) -> LineCollection | PolyCollection:
        """Lines or bands for the members, which `paint` colours."""
        return self._members.collection(width, zorder, norm=self.scale.norm, cmap=self.scale.cmap)

    def paint(self, lines: Any, k: int) -> Any:
        """Move the lines to the members' positions in row k, and colour them."""
        self._members.move(lines, k)
        lines.set_array(self._values[k])
        return lines


def _norm(values: np.ndarray, signed: bool, limits: Any, logarithmic: bool):
    """The scale, and the values at its ends."""
    largest = float(abs(values).max()) or 1.0
    if limits is not None:
        fits = numbers(limits).shape == (2,) and bool(np.isfinite(numbers(limits)).all())
        low, high = (as_float(limit) for limit in limits) if fits else (0.0, 0.0)
        wanted = "two finite numbers, the lower one first"
        require(fits and low < high, "colour_limits", limits, wanted)
        if logarithmic:
            wanted = "the smallest and the largest size, both positive, on a log scale"
            require(low > 0, "colour_limits", limits, wanted)
    elif logarithmic:
        low, high = _DECADES * largest, largest
    else:
        low, high = -largest if signed else 0.0, largest
    if not logarithmic:
        return Normalize(low, high), (low, high)
    if signed:
        return SymLogNorm(low, vmin=-high, vmax=high), (-high, high)
    return LogNorm(low, high), (low, high)
