"""A case on which time schemes are tested, and the result of one scheme on it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from operator import attrgetter

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.scene.scene import Scene
from fx_beam.step.newton import NewtonOptions
from fx_beam.validation import positive

from .verdict import FEWEST, Drift, Verdict

#: Relative difference up to which the numbers of two runs with different round-off are equal.
SAME = 0.1
#: Steps taken per step of the time grid from which on steps count as halved often.
OFTEN = 2.0


@dataclass(frozen=True)
class Case:
    """A scene with a time step, on which schemes are tested.

    Parameters
    ----------
    group, label : str
        What is varied, and its value in this case, a few characters.
    scene : callable
        ``scene()`` gives the `Scene`.
    dt, t_end : float
        Time step and end of the run [s].
    newton : NewtonOptions, optional
        Tolerance and limits of Newton's method.
    drifts : bool
        Whether to find how the error grows with the number of steps.
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
            positive(value, f"{self.name}: {name}")
        fewest, what = (FEWEST, "the law of a drift") if self.drifts else (1, "a run")
        if (given := self.t_end / self.dt) < fewest * (1 - 1e-6):
            raise SceneError(f"{self.name}: {what} needs {fewest} or more steps, not {given:.3g}")

    @property
    def name(self) -> str:
        """Group and label."""
        return f"{self.group}: {self.label}"


@dataclass(frozen=True)
class Cell:
    """The result of a scheme on a case.

    Parameters
    ----------
    case : Case
        The case.
    scheme, family : str
        Label of the scheme, and its own name, which decides its line style.
    verdict : Verdict
        Verdict on the energy.
    others : tuple of Verdict
        Verdicts on runs that differ only in round-off; empty if the run was not repeated.
    t, ratio : (n,) float
        Times [s] and energy ratio, reduced to some hundred points with all extremes.
    seconds : float
        Time spent stepping [s].
    max_halvings : int
        Largest number of halvings of a failing step.
    drift : Drift, optional
        Growth of the error with the number of steps, if asked for and if the run was completed.
    turns : float, optional
        Largest number of turns of a node at the end, if a drift was found.
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
        """The most different verdict of the repeated runs, if one differs.

        One of another kind, else that with the most different number, if it differs by more than
        `SAME`. Where the energy is kept, the numbers are round-off and are not compared.
        """
        kind, amount = self.verdict.kind, self.verdict.amount
        turned = [other for other in self.others if other.kind != kind]
        if turned or kind == "kept":
            return turned[0] if turned else None
        same = amount * (1 - SAME), amount / (1 - SAME)
        apart = [other for other in self.others if not same[0] <= other.amount <= same[1]]
        return max(apart, key=lambda other: abs(other.amount - amount), default=None)

    @property
    def halved_often(self) -> bool:
        """Whether the run ended with at least `OFTEN` steps per step of the time grid."""
        return self.verdict.kind not in ("blew up", "failed") and self.verdict.parts >= OFTEN


def grouped(cells: Iterable[Cell], attribute: str) -> dict[str, list[Cell]]:
    """Cells by an attribute, such as "scheme" or "case.group", in their order."""
    groups: dict[str, list[Cell]] = {}
    for cell in cells:
        groups.setdefault(attrgetter(attribute)(cell), []).append(cell)
    return groups
