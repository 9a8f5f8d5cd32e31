"""Schemes that a study compares, by their labels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.mechanics.schemes import Scheme


def labelled(schemes: Any) -> dict[str, Scheme]:
    """Schemes of a dict by label, those of a sequence by their names."""
    if isinstance(schemes, Mapping):
        labels, given = list(schemes), several("schemes", list(schemes.values()), distinct=False)
    else:
        given = several("schemes", schemes, distinct=False)
        labels = [getattr(scheme, "name", "") for scheme in given]
    for scheme in given:
        if not isinstance(scheme, Scheme):
            raise SceneError(
                f"unknown scheme {scheme!r}; give one such as fx_beam.Newmark(), with brackets"
            )
    if twice := [label for label in labels if labels.count(label) > 1]:
        raise SceneError(
            f"several schemes are called {twice[0]}; give a dict with a label for each scheme"
        )
    return dict(zip(labels, given, strict=True))


def several(name: str, given, distinct: bool = True) -> list[Any]:
    """The entries of a sequence that is not empty and has no entry twice."""
    if isinstance(given, str) or not isinstance(given, Sequence | np.ndarray):
        raise SceneError(f"{name} must be a sequence, as [...], not {given!r:.60}")
    if not len(given):
        raise SceneError(f"a study needs {name}; none are given")
    entries = list(given)
    if distinct and (twice := [entry for entry in entries if entries.count(entry) > 1]):
        raise SceneError(f"{name}: {twice[0]!r} is given twice")
    return entries
