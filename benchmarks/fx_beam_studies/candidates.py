"""Schemes that a study compares, by their labels."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.laws.schemes import Scheme


def labelled(schemes: Any) -> dict[str, Scheme]:
    """Schemes of a dict by label, those of a sequence by their names."""
    named = isinstance(schemes, Mapping)
    candidates = several("schemes", list(schemes.items()) if named else schemes)
    pairs = (
        candidates if named else [(getattr(scheme, "name", ""), scheme) for scheme in candidates]
    )
    for label, scheme in pairs:
        if not isinstance(scheme, Scheme):
            what = f"unknown scheme {scheme!r}; give one such as fx_beam.Newmark(), with brackets"
            raise SceneError(what)
        if sum(label == other for other, _ in pairs) > 1:
            raise SceneError(f"several schemes are called {label}; give a dict, a label for each")
    return dict(pairs)


def entries_of(kind: type, items) -> list[Any]:
    """Cases or cells of a study of stability; SceneError for what is none."""
    entries = list(items) if isinstance(items, Iterable) else [items]
    if wrong := [entry for entry in entries if not isinstance(entry, kind)]:
        raise SceneError(f"{wrong[0]!r} is no fx_beam_studies.stability.{kind.__name__}")
    return entries


def several(name: str, values) -> list[Any]:
    """The entries of a sequence that is not empty and has no entry twice."""
    if isinstance(values, str) or not isinstance(values, Sequence | np.ndarray):
        raise SceneError(f"{name} must be a sequence, as [...], not {values!r:.60}")
    entries = values.tolist() if isinstance(values, np.ndarray) else list(values)
    if not entries:
        raise SceneError(f"a study needs {name}; none are given")
    if twice := [entry for entry in entries if entries.count(entry) > 1]:
        raise SceneError(f"{name}: {twice[0]!r} is given twice")
    return entries
