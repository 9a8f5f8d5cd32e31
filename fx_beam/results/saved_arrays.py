"""Arrays of a saved solution: whether they fit together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .histories import HISTORIES

# Lengths by name; those of rows that may be missing begin with "n?".
_SHAPES: dict[str, tuple] = {
    name: ("n" if history.record == "always" else "n?", *history.shape)
    for name, history in HISTORIES.items()
}
_SHAPES |= {"X": ("nodes", 2), **dict.fromkeys(("end_q", "end_v", "end_a"), ("nodes", 3))}
_SHAPES["end_slides"] = ("joints",)
# A lost motion may have infinite rates and energies, but not these.
_FINITE = "t", "X", "q", "slides"


def check_arrays(data: Mapping[str, np.ndarray], beams: list[dict[str, Any]]) -> None:
    """Refuse arrays that do not fit together, or to the beams of a file, by a ValueError."""
    sizes = {"n": len(data["t"]), "nodes": len(data["X"])}
    shapes = {name: shape for name, shape in _SHAPES.items() if name in data or name in HISTORIES}
    for name, shape in shapes.items():
        if len(shape) > 1 and shape[1] not in sizes and isinstance(shape[1], str):
            sizes[shape[1]] = data[name].shape[1]
    shapes |= {name: ("n",) for name in data if name.startswith("energy_")}
    for i, beam in enumerate(beams):
        _check_beam(beam, data[f"beam{i}_nodes"], sizes["nodes"])
        if f"beam{i}_s" in data:
            sizes[f"p{i}"] = beam["degree"] * (len(beam["s"]) - 1)
            shapes[f"beam{i}_s"] = (f"p{i}",)
            shapes |= {f"beam{i}_{part}": ("n", f"p{i}") for part in "NQM"}
    for name, shape in shapes.items():
        _check(name, data[name], shape, sizes)


def _check(name: str, array: np.ndarray, shape: tuple, sizes: dict[str, int]) -> None:
    wanted = tuple(sizes[size.rstrip("?")] if isinstance(size, str) else size for size in shape)
    missing = shape[0] == "n?" and len(array) == 0
    if array.dtype.kind != "f" or array.shape[missing:] != wanted[missing:]:
        raise ValueError(f"{name} is {array.dtype} {array.shape}, not {wanted}")
    if name in _FINITE and not np.isfinite(array).all():
        raise ValueError(f"{name} is not finite")


def _check_beam(beam: dict[str, Any], nodes: np.ndarray, known: int) -> None:
    degree, elements = beam["degree"], len(beam["s"]) - 1
    fits = nodes.dtype.kind == "i" and nodes.shape == (degree * elements + 1,)
    if not fits or degree not in (1, 2, 3) or elements < 1:
        raise ValueError(f"beam {beam['name']!r}: its nodes do not fit to its elements")
    if nodes.min() < 0 or nodes.max() >= known:
        raise ValueError(f"beam {beam['name']!r}: a node is missing")
