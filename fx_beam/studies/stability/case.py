"""A case on which time schemes are tried, and what became of one of them there."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.scene.scene import Scene
from fx_beam.stepping.newton import NewtonOptions
from fx_beam.validation import is_number

from .verdict import FEWEST, Drift, Verdict

#: Numbers of two runs that round differently are the same if they differ by no more than this.
SAME = 0.1
#: Steps are halved often if so many are taken for each of the time grid.
OFTEN = 2.0


@dataclass(frozen=True)
class Case:
    """A scene with a time step, on which schemes are tried.

    Parameters
    ----------
    group : str
        What is varied.
    label : str
        Its value here, a few characters.
    scene : callable
        ``scene()`` gives the `Scene`.
    dt : float
        Time step [s].
    t_end : float
        End of the run [s].
    newton : NewtonOptions, optional
        When Newton's method stops.
    drifts : bool
        Whether the law is sought by which the error grows with the number of steps.
    """

    group: str
    label: str
    scene: Callable[[], Scene]
    dt: float
    t_end: float
    newton: NewtonOptions | None = None
    drifts: bool = False

    def __post_init__(self):
        if not (isinstance(self.group, str) and isinstance(self.label, str)):
            raise SceneError(f"{self.name}: group and label must be texts")
        if not callable(self.scene):
            raise SceneError(f"{self.name}: scene must be a function that makes the scene")
        for name, value in (("dt", self.dt), ("t_end", self.t_end)):
            if not (is_number(value) and value > 0):
                raise SceneError(f"{self.name}: {name} = {value!r} must be a positive number")
        fewest = FEWEST if self.drifts else 1
        if self.t_end / self.dt < fewest * (1 - 1e-6):
            why = "the law of a drift" if self.drifts else "a run"
            raise SceneError(
                f"{self.name}: {why} needs {fewest} steps and more, not {self.t_end / self.dt:.3g}"
            )

    @property
    def name(self) -> str:
        """Group and label."""
        return f"{self.group}: {self.label}"


@dataclass(frozen=True)
class Cell:
    """A scheme on a case.

    Parameters
    ----------
    case : Case
        The case.
    scheme : str
        Name of the scheme.
    family : str
        The name it has itself, by which it is drawn.
    verdict : Verdict
        What became of the energy.
    others : tuple of Verdict
        The same of runs that differ in their rounding only; none where it makes no difference.
    t, ratio : (n,) float
        Energy over what it should be, thinned out to some hundred points, extremes kept.
    seconds : float
        Time spent stepping [s].
    max_halvings : int
        How often a failing step was halved at most.
    drift : Drift, optional
        How the error grows with the number of steps, if sought and the run did not break off.
    turns : float, optional
        Turns that a node has made in the end, if a drift was found.
    """

    case: Case
    scheme: str
    family: str
    verdict: Verdict
    others: tuple[Verdict, ...] = ()
    t: np.ndarray = field(default_factory=lambda: np.empty(0))
    ratio: np.ndarray = field(default_factory=lambda: np.empty(0))
    seconds: float = 0.0
    max_halvings: int = 0
    drift: Drift | None = None
    turns: float | None = None

    @property
    def other(self) -> Verdict | None:
        """The verdict with another rounding that differs most, if one does.

        One of another kind, else the number farthest from `verdict`'s, if not within `SAME`. What
        is left where the energy is kept is rounding itself, and no difference.
        """
        one = self.verdict
        for other in self.others:
            if other.kind != one.kind:
                return other
        if one.kind == "kept":
            return None
        apart = [other for other in self.others if not _same(one.amount, other.amount)]
        return max(apart, key=lambda other: abs(other.amount - one.amount), default=None)

    @property
    def halved_often(self) -> bool:
        """Whether at least `OFTEN` steps were taken for each of the time grid, to an end."""
        ended = self.verdict.kind not in ("blew up", "failed")
        return ended and self.verdict.parts >= OFTEN


def _same(a: float, b: float) -> bool:
    return a == b or abs(a - b) <= SAME * max(abs(a), abs(b))


def by_case(cells: Iterable[Cell]) -> list[list[Cell]]:
    """All schemes of each case."""
    return list(_grouped(cells, lambda cell: (cell.case.group, cell.case.label)).values())


def by_group(cells: Iterable[Cell]) -> dict[str, list[list[Cell]]]:
    """The cases of each group, as `by_case` has them."""
    groups = _grouped(cells, lambda cell: cell.case.group)
    return {group: by_case(own) for group, own in groups.items()}


def by_scheme(cells: Iterable[Cell]) -> dict[str, list[Cell]]:
    """All cases of each scheme."""
    return _grouped(cells, lambda cell: cell.scheme)


def _grouped(cells: Iterable[Cell], key: Callable[[Cell], Any]) -> dict[Any, list[Cell]]:
    found: dict[Any, list[Cell]] = {}
    for cell in cells:
        found.setdefault(key(cell), []).append(cell)
    return found
