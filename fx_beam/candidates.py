"""What studies are asked for: quantities, schemes, time steps and meshes that make sense."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .errors import SceneError
from .run import Mesh
from .schemes import Scheme


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
    for dt in _several("steps", steps):
        if not _is_number(dt) or dt > t_end:
            raise SceneError(f"step {dt!r} must be a positive number, at most t_end = {t_end:g}")
    if not isinstance(repetitions, int | np.integer) or repetitions < 1:
        raise SceneError(f"repetitions = {repetitions!r} must be a whole number, at least 1")


def labelled(schemes: Any) -> dict[str, Scheme]:
    """Schemes by label.

    Parameters
    ----------
    schemes : dict or sequence of Scheme
        By label, or to be called by their names.

    Returns
    -------
    dict
        Those schemes.
    """
    if isinstance(schemes, Mapping):
        labels, given = list(schemes), _several("schemes", list(schemes.values()), distinct=False)
    else:
        given = _several("schemes", schemes, distinct=False)
        labels = [getattr(scheme, "name", "") for scheme in given]
    for scheme in given:
        if not isinstance(scheme, Scheme):
            raise SceneError(
                f"unknown scheme {scheme!r}; give one such as fx_beam.Newmark(), with its brackets"
            )
    if twice := [label for label in labels if labels.count(label) > 1]:
        raise SceneError(
            f"several schemes are called {twice[0]}; give a dict of labels and schemes"
        )
    return dict(zip(labels, given, strict=True))


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
    for mesh in _several("meshes", meshes):
        whole = np.shape(mesh) == (2,) and all(isinstance(n, int | np.integer) for n in mesh)
        if not whole or min(mesh) < 1:
            raise SceneError(f"mesh {mesh!r} must be a pair of elements and degree, as (8, 1)")
    return [Mesh(*mesh) for mesh in meshes]


def _several(name: str, given, distinct: bool = True) -> list[Any]:
    """A sequence that is not empty, of different entries."""
    if isinstance(given, str) or not isinstance(given, Sequence | np.ndarray):
        raise SceneError(f"{name} must be a sequence, as [...], not {given!r:.60}")
    if not len(given):
        raise SceneError(f"a study needs {name}; none are given")
    entries = list(given)
    if distinct and (twice := [entry for entry in entries if entries.count(entry) > 1]):
        raise SceneError(f"{name}: {twice[0]!r} is given twice")
    return entries


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and 0 < float(value) < math.inf
