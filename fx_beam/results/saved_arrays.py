"""Arrays of a saved solution: whether they fit together."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from .histories import HISTORIES
from .state import ARRAYS, NUMBERS

# Lengths by name; those of rows that may be missing begin with "n?".
_SHAPES: dict[str, tuple] = {
    name: ("n" if history.record == "always" else "n?", *history.shape)
    for name, history in HISTORIES.items()
}
_SHAPES["X"] = "nodes", 2
# Those of the last state: what it must have, and what it may have.
_NEEDED: dict[str, tuple] = {f"end_{name}": () for name in NUMBERS} | {"end_motors": ("motors",)}
_OF_END: dict[str, tuple] = {
    **{"end_impact": (), "end_fitted": ("nodes", 3), "end_parts": (5,), "end_inputs": ("inputs",)},
    **{"end_driven_rates": ("driven",), "end_owners": ("spring variables",)},
    **{"end_constraints": ("texts",), "end_negative_eigenvalues": ()},
    **{"past_ages": ("past",), "past_differences": ("past", "past nodes", 3)},
    **{"past_slides": ("past", "joints"), "past_orders": ("orders",)},
}
for _name, _array in ARRAYS.items():
    _shape = ("nodes", 3) if str(_array.shape[0]).endswith("dofs") else _array.shape
    # Two motions in one solution may have more contacts than the last state.
    _shape = tuple("end " + s if s in ("contacts", "parameters") else s for s in _shape)
    (_NEEDED if _array.required else _OF_END)[f"end_{_name}"] = _shape
# What numbers are not floats.
_KINDS = dict.fromkeys(("end_owners", "end_constraints"), "U")
_KINDS |= dict.fromkeys(("end_negative_eigenvalues", "past_orders"), "i")
# A lost motion may have infinite rates, forces and energies, but not these.
_FINITE = {"t", "X", "q", "past_ages", "past_differences", "past_slides"}
_FINITE |= {f"end_{name}" for name in ("t", "motors", "q", "slides", "parts", "inputs", "length")}
_FINITE |= {f"end_{name}" for name in ("q_previous", "internal", "spring_internal", "natural")}


def check_arrays(data: Mapping[str, np.ndarray], beams: list[dict[str, Any]]) -> None:
    """Refuse arrays that do not fit together, or to the beams of a file, by a ValueError."""
    sizes = {"n": len(data["t"]), "nodes": len(data["X"])}
    shapes = {name: shape for name, shape in _SHAPES.items() if name in data or name in HISTORIES}
    shapes |= {name: ("n",) for name in data if name.startswith("energy_")}
    for i, beam in enumerate(beams):
        _check_beam(beam, data[f"beam{i}_nodes"], sizes["nodes"])
        if f"beam{i}_s" in data:
            sizes[f"p{i}"] = beam["degree"] * (len(beam["s"]) - 1)
            shapes[f"beam{i}_s"] = (f"p{i}",)
            shapes |= {f"beam{i}_{part}": ("n", f"p{i}") for part in "NQM"}
    if "end_t" in data:
        shapes |= _NEEDED | {name: shape for name, shape in _OF_END.items() if name in data}
        if "past_ages" in data and not data["past_ages"].size:
            del shapes["past_differences"]  # of no steps, in another form
    for name, shape in shapes.items():
        _check(name, data[name], shape, sizes)
    orders = data.get("past_orders", np.zeros(0))
    if ((orders < 0) | (orders > len(data.get("past_ages", [])))).any():
        raise ValueError("past_orders are above the number of configurations")


def _check(name: str, array: np.ndarray, shape: tuple, sizes: dict[str, int]) -> None:
    """Refuse an array of another shape or kind; `sizes` are those known by names so far."""
    missing = shape[:1] == ("n?",) and len(array) == 0
    fits = array.ndim == len(shape) and array.dtype.kind == _KINDS.get(name, "f")
    for size, length in list(zip(shape, array.shape, strict=False))[missing:]:
        wanted = sizes.setdefault(size.rstrip("?"), length) if isinstance(size, str) else size
        fits &= wanted == length
    if not fits:
        raise ValueError(f"{name} is {array.dtype} {array.shape}, not {shape} of {sizes}")
    if name in _FINITE and not np.isfinite(array).all():
        raise ValueError(f"{name} is not finite")


def _check_beam(beam: dict[str, Any], nodes: np.ndarray, known: int) -> None:
    degree, elements = beam["degree"], len(beam["s"]) - 1
    fits = nodes.dtype.kind == "i" and nodes.shape == (degree * elements + 1,)
    if not fits or degree not in (1, 2, 3) or elements < 1:
        raise ValueError(f"beam {beam['name']!r}: its nodes do not fit to its elements")
    if nodes.min() < 0 or nodes.max() >= known:
        raise ValueError(f"beam {beam['name']!r}: a node is missing")
