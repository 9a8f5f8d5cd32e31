"""Errors of many runs against their run time: observed orders, and who wins where."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .accuracy import MARGIN, ROUND_OFF, observed_order

#: Run times closer than by this factor are a tie, as another machine may turn them round.
TIE = 1.05
#: Relative errors that runs are asked to come within.
LEVELS = tuple(float(f"1e-{n}") for n in range(1, 13))


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
    errors : dict
        Relative error by quantity; empty if the run failed.
    step_errors : dict
        The part of it that is the time step's: the error against a fine step on this mesh.
    seconds, setup_seconds : float
        Medians of the time for the steps, and of that for the set-up [s]; NaN if the run failed.
    quartiles : (float, float)
        Between which the middle half of the times for the steps lies [s].
    """

    scheme: str
    name: str
    mesh: Mesh
    dt: float
    unknowns: int
    steps: int
    newton_iterations: int
    halvings: int
    reached: float
    failure: str
    first_setup_seconds: float
    errors: dict[str, float] = field(default_factory=dict)
    step_errors: dict[str, float] = field(default_factory=dict)
    seconds: float = np.nan
    setup_seconds: float = np.nan
    quartiles: tuple[float, float] = (np.nan, np.nan)


@dataclass(frozen=True)
class Winner:
    """Cheapest scheme over a range of errors.

    Parameters
    ----------
    loosest, tightest : float
        First and last error level of the range.
    schemes : tuple of str
        The cheapest scheme, and those whose times at each of its levels cannot be told from the
        shortest, by 5 % or as their quartiles overlap; empty where no run comes within the error.
    run : Run, optional
        The cheapest run at the tightest level.
    next : str
        The next scheme there; empty if no other one comes within the error.
    ratio : float
        How many times as long that one takes.
    """

    loosest: float
    tightest: float
    schemes: tuple[str, ...] = ()
    run: Run | None = None
    next: str = ""
    ratio: float = np.nan


@dataclass(frozen=True)
class Precision:
    """What a study of work and precision found.

    Parameters
    ----------
    t_end : float
        End of the simulations [s].
    repetitions : int
        Number of timed runs whose median is taken.
    references : dict
        By quantity the estimated relative error of its reference; None where that is exact.
    origin : str
        What the references that are not exact were computed with; empty if all are.
    runs : list of Run
        All runs, those that failed included.
    mesh_errors : dict
        By mesh the relative errors that a fine time step leaves, by quantity.
    """

    t_end: float
    repetitions: int
    references: dict[str, float | None]
    origin: str
    runs: list[Run]
    mesh_errors: dict[Mesh, dict[str, float]]

    @property
    def schemes(self) -> list[str]:
        """Labels of the schemes."""
        return list(dict.fromkeys(run.scheme for run in self.runs))

    @property
    def degrees(self) -> list[int]:
        """Degrees of the elements."""
        return sorted({run.mesh.degree for run in self.runs})

    @property
    def meshes(self) -> list[Mesh]:
        """The meshes."""
        return list(dict.fromkeys(run.mesh for run in self.runs))

    def floor(self, quantity: str) -> float:
        """Relative error below which a run cannot be told from its reference.

        Parameters
        ----------
        quantity : str
            Name of the quantity.

        Returns
        -------
        float
            Some times the error of the reference, where that is not exact.
        """
        return MARGIN * (self.references[quantity] or 0.0)

    def step_order(self, quantity: str, scheme: str, mesh: Mesh) -> float | None:
        """Observed order in the time step.

        Parameters
        ----------
        quantity, scheme : str
            Names.
        mesh : Mesh
            The mesh.

        Returns
        -------
        float or None
            Fit to the three finest steps; None with fewer.
        """
        runs = [r for r in self.runs if (r.scheme, r.mesh) == (scheme, mesh) and not r.failure]
        errors = [run.step_errors[quantity] for run in runs]
        return observed_order([run.dt for run in runs], errors, ROUND_OFF)

    def mesh_order(self, quantity: str, degree: int) -> float | None:
        """Observed order in the size of the elements, with a fine time step.

        Parameters
        ----------
        quantity : str
            Name of the quantity.
        degree : int
            Degree of the elements.

        Returns
        -------
        float or None
            Fit to the three finest meshes; None with fewer.
        """
        found = {m: e[quantity] for m, e in self.mesh_errors.items() if m.degree == degree}
        sizes = [1 / mesh.elements for mesh in found]
        floor = max(self.floor(quantity), ROUND_OFF)
        return observed_order(sizes, list(found.values()), floor)

    def cost(self, scheme: str, degree: int) -> float | None:
        """Run time over that of the first scheme with the same step on the same mesh.

        Parameters
        ----------
        scheme : str
            Label of the scheme.
        degree : int
            Degree of the elements.

        Returns
        -------
        float or None
            Median over all steps and meshes of the degree; None where no two runs compare.
        """
        runs = [run for run in self.runs if run.mesh.degree == degree and not run.failure]
        first = {(r.mesh, r.dt): r.seconds for r in runs if r.scheme == self.schemes[0]}
        here = {(r.mesh, r.dt): r.seconds for r in runs if r.scheme == scheme}
        both = [here[key] / first[key] for key in here if key in first]
        return float(np.median(both)) if both else None

    def front(self, quantity: str, scheme: str) -> list[Run]:
        """Runs of a scheme that are more accurate than all faster ones of it.

        Parameters
        ----------
        quantity, scheme : str
            Names.

        Returns
        -------
        list of Run
            From the fastest to the most accurate.
        """
        runs = [r for r in self.runs if r.scheme == scheme and r.errors.get(quantity, np.nan) <= 1]
        front: list[Run] = []
        for run in sorted(runs, key=lambda run: (run.seconds, run.errors[quantity])):
            if not front or run.errors[quantity] < front[-1].errors[quantity]:
                front.append(run)
        return front

    def winners(self, quantity: str) -> list[Winner]:
        """Cheapest schemes by powers of ten of the error, equal neighbours joined.

        Parameters
        ----------
        quantity : str
            Name of the quantity.

        Returns
        -------
        list of Winner
            From the loosest error to the tightest that a run comes within and that the reference
            can tell; then one without schemes, if there is a tighter one that it could tell.
        """
        fronts = {scheme: self.front(quantity, scheme) for scheme in self.schemes}
        found: list[Winner] = []
        for level in LEVELS:
            if level < self.floor(quantity):
                break
            winner = _winner(fronts, quantity, level)
            if not winner.schemes:
                return [*found, winner]
            if found and winner.schemes[0] in found[-1].schemes:
                before = found.pop()
                both = tuple(s for s in winner.schemes if s in before.schemes)
                winner = replace(winner, loosest=before.loosest, schemes=both)
            found.append(winner)
        return found


def _winner(fronts: dict[str, list[Run]], quantity: str, level: float) -> Winner:
    """Cheapest schemes at one error level."""
    reached = {s: [r for r in front if r.errors[quantity] <= level] for s, front in fronts.items()}
    # Along a front the first run within the error is the fastest.
    runs = sorted((within[0] for within in reached.values() if within), key=lambda r: r.seconds)
    if not runs:
        return Winner(level, level)
    best = runs[0]
    tie = max(best.quartiles[1], TIE * best.seconds)
    others = [run for run in runs if run.quartiles[0] > tie]
    tied = tuple(run.scheme for run in runs if run not in others)
    if not others:
        return Winner(level, level, tied, best)
    return Winner(level, level, tied, best, others[0].scheme, others[0].seconds / best.seconds)
