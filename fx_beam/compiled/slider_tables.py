"""Hands nodes that slide on beams over to the compiled loop: the struct Slider of c/problem.h."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fx_beam.coupling.index_reduction import Reduction
from fx_beam.coupling.joint_reduction import JointReduction
from fx_beam.coupling.sliders import Slide, Sliders


def storage_of(reduction: Reduction, at: np.ndarray, stored: int) -> tuple[np.ndarray, int]:
    """Storage indices of the tangent's entries before the elimination, and the number of values.

    Given are those of the pattern. Entries of sliding columns are behind them. The last index is
    for what is no unknown; `hand_over_sliders` sets it.
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


def hand_over_sliders(
    ffi: Any, problem: Any, reduction: Reduction, at: np.ndarray, pointer: Callable
) -> Any:
    """Set the sliding nodes of a C struct Problem; returns what must be kept."""
    sliders = reduction.sliders if isinstance(reduction, JointReduction) else None
    if sliders is None:
        return None
    at[-1] = problem.places  # behind all, where padding lanes are added as well
    problem.sliders = len(sliders.all)
    problem.slider = array = ffi.new("Slider[]", len(sliders.all))
    for k, slide in enumerate(sliders.all):
        _set_path(array[k], slide, pointer)
        _set_columns(array[k], k, sliders, at, pointer)
        _set_windows(array[k], k, sliders, at, pointer)
    return array


def _set_path(to: Any, slide: Slide, pointer: Callable) -> None:
    path, joint = slide.path, slide.joint
    to.joint, to.column = joint.number, slide.column
    to.components = len(slide.columns)
    to.carried[0 : len(slide.columns)] = slide.columns.tolist()
    to.node[0:3] = slide.node_dofs.tolist()
    to.degree, to.elements, to.window = path.degree, len(path.h), path.window
    to.most, to.width = path.most, path.width
    to.ends = pointer(path.s, np.float64)
    to.coefficients = pointer(path.coefficients, np.float64)
    to.position = pointer(path.X, np.float64)
    to.angle = pointer(slide.relation.angles, np.float64)
    to.dofs = pointer(slide.dofs, np.int32)


def _set_columns(to: Any, k: int, sliders: Sliders, at: np.ndarray, pointer: Callable) -> None:
    entries, own = sliders.entries(k), sliders.index[sliders.all[k].columns]
    rows, values, signs = (np.concatenate(part) for part in zip(*entries, strict=True))
    to.entry_start = pointer(np.cumsum([0, *(len(part[0]) for part in entries)]), np.int32)
    to.entry_row, to.entry_value = pointer(rows, np.int32), pointer(values, np.int32)
    to.entry_sign = pointer(signs, np.float64)
    around = sliders.neighbours(k)
    to.around = len(around)
    to.own_place = pointer(at[sliders.places(own[:, None], own)], np.int32)
    to.left_place = pointer(at[sliders.places(around[:, None], own)], np.int32)
    to.right_place = pointer(at[sliders.places(own, around[:, None])], np.int32)


def _set_windows(to: Any, k: int, sliders: Sliders, at: np.ndarray, pointer: Callable) -> None:
    slide = sliders.all[k]
    windows = [sliders.window(k, first) for first in slide.windows]
    sizes = np.array([len(w.local) for w in windows])
    to.window_start = pointer(np.cumsum([0, *sizes]), np.int32)
    to.inside_start = pointer(np.cumsum([0, *sizes**2]), np.int32)
    for name in ("local", "value"):
        setattr(to, name, pointer(np.concatenate([getattr(w, name) for w in windows]), np.int32))
    to.sign = pointer(np.concatenate([w.sign for w in windows]), np.float64)
    to.beside = pointer(np.concatenate([at[w.beside].ravel() for w in windows]), np.int32)
    to.above = pointer(np.concatenate([at[w.above.T].ravel() for w in windows]), np.int32)
    to.inside = pointer(np.concatenate([at[w.inside].ravel() for w in windows]), np.int32)
    room = len(slide.columns) * int(sizes.max())
    for name in ("entry_T", "entry_virtual", "entry_KT"):
        setattr(to, name, pointer(np.zeros(room), np.float64))
    to.entry_factor = pointer(np.zeros(2 * int(sizes.max())), np.float64)
