"""What a study of error against run time is asked for, checked before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.studies.candidates import several

from .run import Mesh


def check(quantities: Any, exact: Any, t_end: Any, steps: Any, repetitions: Any) -> None:
    """Refuse what could not be computed, before anything is.

    Parameters
    ----------
    quantities, exact, t_end, steps, repetitions
        As given to `work_precision.study`.
    """
    for name, given in (("quantities", quantities), ("exact", exact)):
        if not isinstance(given, Mapping):
            raise SceneError(f"{name} must be a dict by name, not {given!r:.40}")
    if not quantities:
        raise SceneError("a study needs quantities; none are given")
    if wrong := [name for name, quantity in quantities.items() if not callable(quantity)]:
        raise SceneError(f"quantity {wrong[0]!r} must be a function of the solution")
    if unknown := [name for name in exact if name not in quantities]:
        raise SceneError(f"exact value of {unknown[0]!r}, which is none of {list(quantities)}")
    if not _is_number(t_end):
        raise SceneError(f"t_end = {t_end!r} must be a positive number")
    for dt in several("steps", steps):
        if not _is_number(dt) or dt > t_end:
            raise SceneError(f"step {dt!r} must be a positive number, at most t_end = {t_end:g}")
    if not isinstance(repetitions, int | np.integer) or repetitions < 1:
        raise SceneError(f"repetitions = {repetitions!r} must be a whole number, at least 1")


def grid(meshes: Any) -> list[Mesh]:
    """Meshes by name.

    Parameters
    ----------
    meshes : sequence of (int, int)
        Pairs of elements and degree.

    Returns
    -------
    list of Mesh
        Those meshes.
    """
    for mesh in several("meshes", meshes):
        whole = np.shape(mesh) == (2,) and all(isinstance(n, int | np.integer) for n in mesh)
        if not whole or min(mesh) < 1:
            raise SceneError(f"mesh {mesh!r} must be a pair of elements and degree, as (8, 1)")
    return [Mesh(*mesh) for mesh in meshes]


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and 0 < float(value) < math.inf
