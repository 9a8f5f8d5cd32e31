"""Errors of many runs and their run times, and the cheapest run for an error."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .accuracy import MARGIN

#: A run is lost when it gained or lost more than this part of its kinetic and strain energy.
LOST = 0.5
#: Largest number of halvings of a failing step: more would only prolong a lost motion.
MAX_HALVINGS = 2


@dataclass(frozen=True)
class Mesh:
    """Elements of a scene.

    Parameters
    ----------
    elements, degree : int
        Number and degree of the elements, as given to the scene function.
    """

    elements: int
    degree: int

    def __str__(self):
        plural = "s" if self.elements > 1 else ""
        return f"{self.elements} element{plural} of degree {self.degree}"


@dataclass
class Run:
    """One scheme with one time step on one mesh.

    A run that ended with an error of its scene or scheme has only the first four and the failure.

    Parameters
    ----------
    scheme, name : str
        Label of the scheme, and its name as in `Stats`.
    mesh : Mesh
        Elements and their degree.
    dt : float
        Time step [s].
    unknowns, steps, newton_iterations, halvings : int
        As in `Stats`.
    reached : float
        Time that it reached [s].
    failure : str
        Reason why it broke off there; empty if it was completed.
    first_seconds : float
        Time of the first call, with compilation if the forms were not in the cache [s].
    energy_error : float
        Largest energy gained or lost without work, over the largest kinetic and strain energy.
    errors : dict
        Relative error by quantity; empty if the run broke off, NaN if there is none.
    step_errors : dict
        The part due to the time step: the error relative to a fine step on this mesh.
    notes : dict
        Reasons for missing errors, by quantity.
    seconds, step_seconds : float
        Least processor time of the whole call of `simulate`, and least time of its steps alone [s].
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
    first_seconds: float = np.nan
    energy_error: float = np.nan
    errors: dict[str, float] = field(default_factory=dict)
    step_errors: dict[str, float] = field(default_factory=dict)
    notes: dict[str, str] = field(default_factory=dict)
    seconds: float = np.nan
    step_seconds: float = np.nan

    def __str__(self):
        return f"{self.scheme}, dt = {self.dt:.3g} s, {self.mesh}"

    @property
    def lost(self) -> bool:
        """Whether it broke off, or gained or lost more than half of its energy."""
        return bool(self.failure) or not self.energy_error <= LOST


@dataclass(frozen=True)
class Precision:
    """Result of a work-precision study.

    Parameters
    ----------
    t_end : float
        End of the simulations [s].
    repetitions : int
        Number of timed runs of which the least time is taken.
    references : dict
        Estimated relative error of the reference, by quantity; None if exact, NaN if there is none.
    origin : str
        Scheme, mesh and step of the computed references; empty if all references are exact.
    runs : list of Run
        All runs, including those that broke off.
    mesh_errors : dict
        Relative errors with a fine time step, by mesh and then by quantity.
    start : str
        Name of the function that gave the states at the start; empty for the reference state.
    missing : dict
        Why there is no reference, by quantity, or no solution with a fine step, by mesh.
    """

    t_end: float
    repetitions: int
    references: dict[str, float | None]
    origin: str
    runs: list[Run]
    mesh_errors: dict[Mesh, dict[str, float]] = field(default_factory=dict)
    start: str = ""
    missing: dict[str, str] = field(default_factory=dict)

    @property
    def schemes(self) -> list[str]:
        """Labels of the schemes."""
        return list(dict.fromkeys(run.scheme for run in self.runs))

    def cheapest(self, quantity: str, error: float) -> dict[str, Run]:
        """Fastest run of each scheme that has at most this error.

        Parameters
        ----------
        quantity : str
            Name of the quantity.
        error : float
            Largest relative error. A run has it if its own error is at most this one, and so are
            those of the scheme's runs with smaller steps on its mesh, and of the solutions with a
            fine step on its mesh and finer ones of its degree; none of these runs may be lost.

        Returns
        -------
        dict
            `Run` by scheme, the fastest scheme first. A scheme that does not reach the error is
            left out.
        """
        fastest: dict[str, Run] = {}
        timed = [run for run in self.runs if np.isfinite(run.seconds)]
        for run in sorted(timed, key=lambda run: run.seconds):
            if run.scheme not in fastest and counted(self, quantity, run) <= error:
                fastest[run.scheme] = run
        return fastest


def floor(study: Precision, quantity: str) -> float:
    """Relative error below which the errors of runs are not known; NaN without a reference."""
    own = study.references[quantity] or 0.0  # None if it is exact
    return float(np.fmax(MARGIN * own, np.finfo(float).eps))


def counted(study: Precision, quantity: str, run: Run) -> float:
    """Error assigned to a run, so that none is good by chance: the largest one that confirms it.

    See `Precision.cheapest`. At least `floor`; infinite if a run is lost or has no error.
    """
    ours = [r for r in study.runs if (r.scheme, r.mesh) == (run.scheme, run.mesh)]
    errors = [np.nan if r.lost else r.errors.get(quantity, np.nan) for r in ours if r.dt <= run.dt]
    for mesh, left in study.mesh_errors.items():
        if mesh.degree == run.mesh.degree and mesh.elements >= run.mesh.elements:
            errors += [left[quantity]] if quantity in left else []
    return max(floor(study, quantity), *errors) if np.isfinite(errors).all() else np.inf
