"""One scheme with one time step on one mesh: what it cost, and its errors."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

#: A run is lost when it gained or lost more than this part of its kinetic and strain energy.
LOST = 0.5


@dataclass(frozen=True)
class Mesh:
    """Elements of a scene.

    Parameters
    ----------
    elements : int
        The number that the scene is asked for.
    degree : int
        Their degree.
    """

    elements: int
    degree: int

    def __str__(self):
        plural = "s" if self.elements > 1 else ""
        return f"{self.elements} element{plural} of degree {self.degree}"


@dataclass
class Run:
    """One scheme with one time step on one mesh.

    Of a run that was refused by its scene or scheme there are only the first four and the failure.

    Parameters
    ----------
    scheme : str
        Label of the scheme.
    name : str
        Its name, as in `Stats`.
    mesh : Mesh
        Elements and their degree.
    dt : float
        Time step [s].
    unknowns, steps, newton_iterations, halvings : int
        As in `Stats`.
    reached : float
        Time that it reached [s].
    failure : str
        Why it broke off there; empty if it did not.
    first_setup_seconds : float
        Time of the first run for mesh, forms and constant matrices, with compilation where the
        forms were not in the cache [s].
    energy_error : float
        Largest energy gained or lost without work, over the largest sum of kinetic and strain
        energy; of what was gained most is in that sum.
    errors : dict
        Relative error by quantity; empty if the run failed, NaN where there is none.
    step_errors : dict
        The part of it that is the time step's: the error against a fine step on this mesh.
    notes : dict
        Why there is no error, by quantity.
    seconds, setup_seconds : float
        Medians of the time for the steps, and of that for the set-up [s]; NaN if the run failed.
    quartiles : (float, float)
        Between which the middle half of the times for the steps lies [s].
    """

    scheme: str
    name: str
    mesh: Mesh
    dt: float
    unknowns: int = 0
    steps: int = 0
    newton_iterations: int = 0
    halvings: int = 0
    reached: float = 0.0
    failure: str = ""
    first_setup_seconds: float = np.nan
    energy_error: float = np.nan
    errors: dict[str, float] = field(default_factory=dict)
    step_errors: dict[str, float] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    seconds: float = np.nan
    setup_seconds: float = np.nan
    quartiles: tuple[float, float] = (np.nan, np.nan)

    @property
    def lost(self) -> bool:
        """Whether it broke off, or gained or lost more than half of its energy.

        Gained energy adds to the kinetic and the strain energy, so that it is more than half of
        them where it is more than the motion has by right.
        """
        return bool(self.failure) or not self.energy_error <= LOST
