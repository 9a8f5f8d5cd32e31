"""A case on which time schemes are tried, and what became of one of them there."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .drift import FEWEST, Drift
from .errors import SceneError
from .newton import NewtonOptions
from .scene import Scene
from .verdict import Verdict


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
    start : float
        Time from which the energy is judged [s]: the end of loads, whose work some schemes have
        to second order only.
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
    start: float = 0.0
    newton: NewtonOptions | None = None
    drifts: bool = False

    def __post_init__(self):
        if not self.start < self.t_end:
            raise SceneError(
                f"{self.name}: the energy is judged from {self.start:g} on, but the run ends at "
                f"{self.t_end:g}"
            )
        if self.drifts and self.t_end < FEWEST * self.dt:
            raise SceneError(
                f"{self.name}: the law of a drift needs {FEWEST} steps and more, not "
                f"{self.t_end / self.dt:.3g}"
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
    t, ratio : (n,) float
        Energy over what it should be, thinned out to some hundred points, extremes kept.
    seconds : float
        Time spent stepping [s].
    drift : Drift, optional
        How the error grows with the number of steps, if sought and the run did not break off.
    """

    case: Case
    scheme: str
    family: str
    verdict: Verdict
    t: np.ndarray
    ratio: np.ndarray
    seconds: float
    drift: Drift | None = None
