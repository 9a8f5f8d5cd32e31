"""Nodes that slide on beams, for the compiled loop."""

from __future__ import annotations

from typing import Any

import numpy as np

from fx_beam.coupling.index_reduction import Reduction
from fx_beam.coupling.joint_reduction import JointReduction
from fx_beam.coupling.sliders import Slide, Sliders


def storage_of(reduction: Reduction, at: np.ndarray, stored: int) -> tuple[np.ndarray, int]:
    """Storage indices of the tangent's entries before the elimination, and the number of values.

    Given are those of the pattern. Entries of sliding columns are behind them. The last index is
    for what is no unknown; `sliders_of` sets it.
    """
    if not isinstance(reduction, JointReduction) or reduction.sliders is None:
        return at, stored
    sliders = reduction.sliders
    count = len(sliders.keys)
    of_all = np.full(count + 1, -1)
    of_all[sliders.kept] = at[reduction.places()]
    others = np.flatnonzero(of_all[:count] < 0)
    of_all[others] = stored + np.arange(len(others))
    return of_all, stored + len(others)


def sliders_of(reduction: Reduction, at: np.ndarray, behind: int) -> list[dict[str, Any]] | None:
    """Sliding nodes as ``Slider`` of c/problem.h; None without any.

    Sets the last storage index: behind all, where padding lanes are added as well.
    """
    sliders = reduction.sliders if isinstance(reduction, JointReduction) else None
    if sliders is None:
        return None
    at[-1] = behind
    return [
        _path_of(slide) | _columns_of(k, sliders, at) | _windows_of(k, sliders, at)
        for k, slide in enumerate(sliders.all)
    ]


def _path_of(slide: Slide) -> dict[str, Any]:
    path = slide.path
    return {
        "joint": slide.joint.number,
        "column": slide.column,
        "components": len(slide.columns),
        "carried": slide.columns,
        "node": slide.node_dofs,
        "degree": path.degree,
        "elements": len(path.h),
        "window": path.window,
        "most": path.most,
        "width": path.width,
        "ends": path.s,
        "coefficients": path.coefficients,
        "position": path.X,
        "angle": slide.relation.angles,
        "dofs": slide.dofs,
    }


def _columns_of(k: int, sliders: Sliders, at: np.ndarray) -> dict[str, Any]:
    entries, own = sliders.entries(k), sliders.index[sliders.all[k].columns]
    rows, values, signs = (np.concatenate(part) for part in zip(*entries, strict=True))
    around = sliders.neighbours(k)
    return {
        "entry_start": np.cumsum([0, *(len(part[0]) for part in entries)]),
        "entry_row": rows,
        "entry_value": values,
        "entry_sign": signs,
        "around": len(around),
        "own_place": at[sliders.places(own[:, None], own)],
        "left_place": at[sliders.places(around[:, None], own)],
        "right_place": at[sliders.places(own, around[:, None])],
    }


def _windows_of(k: int, sliders: Sliders, at: np.ndarray) -> dict[str, Any]:
    slide = sliders.all[k]
    windows = [sliders.window(k, first) for first in slide.windows]
    sizes = np.array([len(w.local) for w in windows])
    found = {
        "window_start": np.cumsum([0, *sizes]),
        "inside_start": np.cumsum([0, *sizes**2]),
        "beside": np.concatenate([at[w.beside].ravel() for w in windows]),
        "above": np.concatenate([at[w.above.T].ravel() for w in windows]),
        "inside": np.concatenate([at[w.inside].ravel() for w in windows]),
        "entry_factor": np.zeros(2 * int(sizes.max())),
    }
    for name in ("local", "value", "sign"):
        found[name] = np.concatenate([getattr(w, name) for w in windows])
    for name in ("entry_T", "entry_virtual", "entry_KT"):
        found[name] = np.zeros(len(slide.columns) * int(sizes.max()))
    return found
