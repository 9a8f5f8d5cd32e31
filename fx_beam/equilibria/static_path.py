"""Load paths that were computed in a block of code, for their derivatives."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any, NamedTuple

from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.scene.scene import Scene
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.model import Model


class StaticPath(NamedTuple):
    """The states of a solution of `static`, and the model and the loads of which they are."""

    solution: Solution
    model: Model
    forcing: LoadForcing
    states: list[State]
    #: The scene as given, and functions of its inputs.
    scene: Scene
    inputs: Mapping[str, Any] | None
    #: Whether it began at another solution.
    continues: bool


_KEPT: ContextVar[list[StaticPath] | None] = ContextVar("kept paths", default=None)


def keep_path(path: StaticPath) -> None:
    """Keep a path if it is asked for."""
    if (paths := _KEPT.get()) is not None:
        paths.append(path)


@contextmanager
def keeping_paths() -> Iterator[list[StaticPath]]:
    """The load paths of this block."""
    paths: list[StaticPath] = []
    before = _KEPT.set(paths)
    try:
        yield paths
    finally:
        _KEPT.reset(before)
