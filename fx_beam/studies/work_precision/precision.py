"""Errors of many runs against their run time: observed orders, and which scheme is the cheapest."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .accuracy import MARGIN, ROUND_OFF, observed_order

#: A run is lost when it gained or lost more than this part of its kinetic and strain energy.
LOST = 0.5
#: Errors closer than by this factor are the same.
SAME = 1.1
#: Run times closer than by this factor are a tie, as another machine may turn them round.
TIE = 1.2
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
        Set-up of the first run, with compilation where the forms were not in the cache [s].
    energy_error : float
        Largest energy gained or lost without work, over the largest kinetic and strain energy.
    errors : dict
        Relative error by quantity; empty if the run failed, NaN where there is none.
    step_errors : dict
        The part of it that is the time step's: the error against a fine step on this mesh.
    notes : dict
        Why there is no error, by quantity.
    seconds, setup_seconds : float
        Medians of the time for the steps, and for the set-up [s]; NaN if the run failed.
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
        """Whether it broke off, or gained or lost more than half of its energy."""
        return bool(self.failure) or not self.energy_error <= LOST


@dataclass(frozen=True)
class Front:
    """Line of a scheme in the diagram: each run is more accurate than all faster ones, by 10 %."""

    scheme: str
    runs: list[Run]
    errors: list[float]  # with which they count

    def run(self, level: float) -> Run | None:
        """Cheapest run that comes within an error, by 10 %."""
        found = (r for r, e in zip(self.runs, self.errors, strict=True) if e <= SAME * level)
        return next(found, None)

    def seconds(self, level: float) -> np.ndarray:
        """Lower quartile, median and upper quartile of the run time at an error [s].

        They lie on straight lines between runs in logarithmic scales.
        """
        times = np.log([(run.quartiles[0], run.seconds, run.quartiles[1]) for run in self.runs])
        accuracy = -np.log(self.errors)
        return np.exp([np.interp(-np.log(level), accuracy, column) for column in times.T])


@dataclass(frozen=True)
class Level:
    """Run times [s] of the schemes that come within an error, from the shortest on."""

    error: float
    seconds: dict[str, float]
    cheapest: tuple[str, ...]  # those that cannot be told from the shortest
    run: Run | None  # the cheapest run of the fastest scheme


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
        By quantity the estimated relative error of its reference; None where that is exact, NaN
        where there is none.
    origin : str
        What the references that are not exact were computed with; empty if all are.
    runs : list of Run
        All runs, those that failed included.
    mesh_errors : dict
        By mesh the relative errors that a fine time step leaves, by quantity.
    start : str
        Name of the function that gave what the motions start from; empty for the reference
        configuration.
    missing : dict
        Why there is no reference, by quantity, and no solution with a fine step, by mesh.
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
            Three times the error of the reference; that of a number where it is exact.
        """
        own = self.references[quantity] or 0.0
        return float(np.fmax(MARGIN * own, np.finfo(float).eps))  # NaN where there is none

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
            Fit to the three finest steps; None where the errors have no order.
        """
        runs = [r for r in self.runs if (r.scheme, r.mesh) == (scheme, mesh)]
        errors = [run.step_errors.get(quantity, np.nan) for run in runs]
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
            Fit to the three finest meshes; None where the errors have no order.
        """
        own = {m: e.get(quantity, np.nan) for m, e in self.mesh_errors.items()}
        own = {mesh: error for mesh, error in own.items() if mesh.degree == degree}
        sizes = [1 / mesh.elements for mesh in own]
        return observed_order(sizes, list(own.values()), max(self.floor(quantity), ROUND_OFF))

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

    def counted(self, quantity: str, run: Run) -> float:
        """Error with which a run is compared, so that none wins by chance.

        Parameters
        ----------
        quantity : str
            Name of the quantity.
        run : Run
            A run of this study.

        Returns
        -------
        float
            The largest error of the run, of its scheme's with smaller steps on its mesh, and of a
            fine step on its mesh and those of more elements of its degree; not less than `floor`.
            Infinite where one of these runs is lost or has no error.
        """
        ours = [r for r in self.runs if (r.scheme, r.mesh) == (run.scheme, run.mesh)]
        errors = [
            np.nan if r.lost else r.errors.get(quantity, np.nan) for r in ours if r.dt <= run.dt
        ]
        for mesh, left in self.mesh_errors.items():
            if mesh.degree == run.mesh.degree and mesh.elements >= run.mesh.elements:
                errors += [left[quantity]] if quantity in left else []
        return max(self.floor(quantity), *errors) if np.isfinite(errors).all() else np.inf

    def front(self, quantity: str, scheme: str) -> Front:
        """Line of a scheme in the diagram of error over run time.

        Parameters
        ----------
        quantity, scheme : str
            Names.

        Returns
        -------
        Front
            Its ``runs`` that are more accurate than all faster ones, and their ``errors``, at
            most 1.
        """
        timed = [r for r in self.runs if r.scheme == scheme and np.isfinite(r.seconds)]
        front = Front(scheme, [], [])
        for run in sorted(timed, key=lambda r: (r.seconds, self.counted(quantity, r))):
            error = self.counted(quantity, run)
            if error <= 1 and (not front.runs or SAME * error < front.errors[-1]):
                front.runs.append(run)
                front.errors.append(error)
        return front

    def levels(self, quantity: str) -> list[Level]:
        """Cheapest schemes for errors of 1e-1, 1e-2, ... to 1e-12.

        Parameters
        ----------
        quantity : str
            Name of the quantity.

        Returns
        -------
        list of Level
            With ``error``, ``seconds`` by scheme and the ``cheapest`` schemes, whose times differ
            by less than 20 % or overlap by their quartiles. It ends with an error that no run
            comes within, or before one that the reference cannot tell.
        """
        fronts = [self.front(quantity, scheme) for scheme in self.schemes]
        found: list[Level] = []
        for error in LEVELS:
            if error < self.floor(quantity) or (found and not found[-1].cheapest):
                break
            found.append(_level(error, [front for front in fronts if front.run(error)]))
        return found


def _level(error: float, fronts: list[Front]) -> Level:
    times = sorted(((f, f.seconds(error)) for f in fronts), key=lambda entry: entry[1][1])
    if not times:
        return Level(error, {}, (), None)
    fastest, (_, shortest, upper) = times[0]
    tie = max(upper, TIE * shortest)
    cheapest = tuple(front.scheme for front, (lower, _, _) in times if lower <= tie)
    seconds = {front.scheme: float(t[1]) for front, t in times}
    return Level(error, seconds, cheapest, fastest.run(error))
