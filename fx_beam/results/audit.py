"""What a simulation is judged by: energies, stress resultants and the effort it took."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np


def read_only(values: np.ndarray) -> np.ndarray:
    """A view of an array through which it cannot be changed."""
    view = np.asarray(values).view()
    view.setflags(write=False)
    return view


@dataclass(frozen=True)
class Energy:
    """Energies over time, each (n,) [J].

    Parameters
    ----------
    kinetic : (n,) float
        1/2 v.M v (eq. 8).
    strain : (n,) float
        Stored energy of the beams (eq. 10).
    potential : (n,) float
        Of the weight, zero in the reference configuration.
    work : (n,) float
        Done since the start by loads, prescribed motion, motors and added virtual works.
    springs : (n,) float, optional
        Stored energy of the springs of joints; zero by default.
    dissipated : (n,) float, optional
        What the dampers of joints took since the start, which never falls; zero by default.
    """

    kinetic: np.ndarray
    strain: np.ndarray
    potential: np.ndarray
    work: np.ndarray
    springs: Any = None
    dissipated: Any = None

    def __post_init__(self):
        for name in ("springs", "dissipated"):
            if getattr(self, name) is None:
                object.__setattr__(self, name, np.zeros_like(self.kinetic))
        _lock(self)

    @property
    def stored(self) -> np.ndarray:
        """Energy in beams and springs (n,) [J]."""
        return self.strain + self.springs

    @property
    def total(self) -> np.ndarray:
        """Kinetic, strain and potential energy, and that of springs (n,) [J]."""
        return self.kinetic + self.stored + self.potential

    @property
    def supplied(self) -> np.ndarray:
        """Work less what was dissipated, both since the start, (n,) [J]."""
        supplied = self.work - self.dissipated
        return supplied - supplied[0]

    @property
    def balance_error(self) -> np.ndarray:
        """Energy gained since the start that was not supplied, (n,) [J]."""
        return self.total - self.total[0] - self.supplied


@dataclass
class Stats:
    """What a simulation took.

    Parameters
    ----------
    scheme : str
        Name of the time scheme.
    level : float
        Where in a step the scheme takes the forces: 0.5 in its middle, 1 at its end.
    solver : str
        Which linear solver ran.
    unknowns : int
        Free degrees of freedom.
    steps : int
        Steps of the time grid that were completed.
    newton_iterations : int
        Corrections in all, those of failed attempts not counted.
    halvings : int
        Times a step failed and was halved.
    substeps : int
        Steps that were taken, each part of a halved one counted.
    too_large : int
        Parts of halved steps in which a node turned by more than half a radian per step of the
        grid: there `dt` is too large for the motion, and where that goes may depend on rounding.
    inside_out : int
        Steps, each part of a halved one counted, that end with a Gauss point at which a section
        faces backwards: t . phi' > 0 (eq. 4) is violated.
    ended_by : dict
        Number of solves that ended by a small increment and at round-off.
    seconds : float
        Time spent stepping [s].
    setup_seconds : float
        Time spent on mesh, compilation and constant matrices [s].
    compiled : list of str
        Forms that were compiled.
    assembled : list of str
        Matrices and loads the scene has.
    failure : str
        Why the simulation broke off; empty if it did not.
    static : bool
        Whether the load factor was stepped, and not time.
    limit_points : list of float
        Load factors of the limit points that were met.
    """

    scheme: str
    level: float
    solver: str
    unknowns: int
    steps: int = 0
    newton_iterations: int = 0
    halvings: int = 0
    substeps: int = 0
    too_large: int = 0
    inside_out: int = 0
    ended_by: dict[str, int] = field(default_factory=dict)
    seconds: float = 0.0
    setup_seconds: float = 0.0
    compiled: list[str] = field(default_factory=list)
    assembled: list[str] = field(default_factory=list)
    failure: str = ""
    static: bool = False
    limit_points: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class BeamResultants:
    """Stress resultants along a beam, at the Gauss points of its elements.

    Row k holds those that the scheme takes in the step that ends at t[k], or in the last part of
    it where it was taken in parts: for the mid-point schemes a mean over that part, for the others
    those at `Solution.t_level`. They belong to row k of `Solution.reaction` and
    `Solution.joint_force`. Row 0 holds those of the start configuration.

    Forces of `Scene.add_virtual_work` that act inside a member are not in them: they are no part
    of the stored energy or of the scheme.

    Parameters
    ----------
    s : (elements * degree,) float
        Arc length of the points [m].
    N : (n, elements * degree) float
        Axial force, positive in tension [N].
    Q : (n, elements * degree) float
        Shear force along the turned section [N].
    M : (n, elements * degree) float
        Bending moment [N m].
    """

    s: np.ndarray
    N: np.ndarray
    Q: np.ndarray
    M: np.ndarray

    def __post_init__(self):
        _lock(self)


def _lock(histories: Energy | BeamResultants) -> None:
    for name, values in vars(histories).items():
        object.__setattr__(histories, name, read_only(values))
