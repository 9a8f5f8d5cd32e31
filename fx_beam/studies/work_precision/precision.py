"""Errors of many runs against their run time: observed orders and the cheapest schemes."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from .accuracy import MARGIN, ROUND_OFF, observed_order

#: A run is lost when it gained or lost more than this part of its kinetic and strain energy.
LOST = 0.5
#: Errors whose ratio is below this are regarded as equal.
SAME = 1.1
#: Run times whose ratio is below this are regarded as equal: another machine may order them
#: differently.
TIE = 1.2
#: Relative errors for which the cheapest scheme is determined.
LEVELS = tuple(float(f"1e-{n}") for n in range(1, 13))


@dataclass(frozen=True)
class Mesh:
    """Elements of a scene.

    Parameters
    ----------
    elements : int
        Number of elements, as given to the scene function.
    degree : int
        Degree of the elements.
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
        Reason why it failed there; empty if it was completed.
    first_setup_seconds : float
        Set-up of the first run, with compilation if the forms were not in the cache [s].
    energy_error : float
        Largest energy gained or lost without work, over the largest kinetic and strain energy.
    errors : dict
        Relative error by quantity; empty if the run failed, NaN if there is none.
    step_errors : dict
        The part due to the time step: the error relative to a fine step on this mesh.
    notes : dict
        Reasons for missing errors, by quantity.
    seconds, setup_seconds : float
        Medians of the time for the steps, and for the set-up [s]; NaN if the run failed.
    quartiles : (float, float)
        Lower and upper quartile of the times for the steps [s].
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
        """Whether it failed, or gained or lost more than half of its energy."""
        return bool(self.failure) or not self.energy_error <= LOST


@dataclass(frozen=True)
class Front:
    """Line of a scheme in the diagram: runs more accurate than all faster ones, by 10 %."""

    scheme: str
    runs: list[Run]
    errors: list[float]  # assigned errors

    def run(self, level: float) -> Run | None:
        """Cheapest run whose error is within this one, or at most 10 % above it."""
        found = (r for r, e in zip(self.runs, self.errors, strict=True) if e <= SAME * level)
        return next(found, None)

    def seconds(self, level: float) -> np.ndarray:
        """Lower quartile, median and upper quartile of the run time at an error [s].

        Interpolated linearly between runs, in logarithmic scales.
        """
        times = np.log([(run.quartiles[0], run.seconds, run.quartiles[1]) for run in self.runs])
        accuracy = -np.log(self.errors)
        return np.exp([np.interp(-np.log(level), accuracy, column) for column in times.T])


@dataclass(frozen=True)
class Level:
    """Run times [s] of the schemes that reach an error, in ascending order."""

    error: float
    seconds: dict[str, float]
    cheapest: tuple[str, ...]  # all that cost the same as the fastest
    run: Run | None  # the cheapest run of the fastest scheme


@dataclass(frozen=True)
class Precision:
    """Result of a work-precision study.

    Parameters
    ----------
    t_end : float
        End of the simulations [s].
    repetitions : int
        Number of timed runs of which the median is taken.
    references : dict
        Estimated relative error of the reference, by quantity; None if the reference is exact, NaN
        if there is none.
    origin : str
        Scheme, mesh and step of the computed references; empty if all references are exact.
    runs : list of Run
        All runs, including those that failed.
    mesh_errors : dict
        Relative errors with a fine time step, by mesh and then by quantity.
    start : str
        Name of the function that gave the states from which the motions start; empty for the
        reference configuration.
    missing : dict
        Reasons for a missing reference, by quantity, and for a missing solution with a fine step,
        by mesh.
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
        """Relative error below which a run cannot be distinguished from its reference.

        Parameters
        ----------
        quantity : str
            Name of the quantity.

        Returns
        -------
        float
            Three times the error of the reference; a small number if the reference is exact.
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
            Fit to the three smallest steps; None if the errors have no clear order.
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
            Fit to the three finest meshes; None if the errors have no clear order.
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
            Median over all steps and meshes of the degree; None if no two runs can be compared.
        """
        runs = [run for run in self.runs if run.mesh.degree == degree and not run.failure]
        first = {(r.mesh, r.dt): r.seconds for r in runs if r.scheme == self.schemes[0]}
        here = {(r.mesh, r.dt): r.seconds for r in runs if r.scheme == scheme}
        both = [here[key] / first[key] for key in here if key in first]
        return float(np.median(both)) if both else None

    def counted(self, quantity: str, run: Run) -> float:
        """Error assigned to a run in comparisons, so that no run is the best by chance.

        Parameters
        ----------
        quantity : str
            Name of the quantity.
        run : Run
            A run of this study.

        Returns
        -------
        float
            The largest of these errors: of the run, of runs by its scheme with smaller steps on
            its mesh, and of solutions with a fine step on its mesh and on finer meshes of its
            degree; at least `floor`. Infinite if one of these runs is lost or has no error.
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
            The ``runs`` that are more accurate than all faster ones, and their ``errors``, which
            are at most 1.
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
            by less than 20 % or whose quartiles overlap. The list ends with the first error that
            no run reaches, or before the first one that the reference cannot resolve.
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
