"""Errors of many runs against their run time: observed orders, and who wins where."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .accuracy import MARGIN, ROUND_OFF, observed_order
from .fronts import SAME, Front, Winner, cheapest
from .run import Mesh, Run

#: Relative errors that runs are asked to come within.
LEVELS = tuple(float(f"1e-{n}") for n in range(1, 13))


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
            Fit to the three finest steps, by `accuracy.observed_order`; None where there is none.
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
            Fit to the three finest meshes, as in `step_order`; None where there is none.
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
        finer = [
            r for r in self.runs if (r.scheme, r.mesh) == (run.scheme, run.mesh) and r.dt <= run.dt
        ]
        errors = [np.nan if r.lost else r.errors.get(quantity, np.nan) for r in finer]
        errors += [
            found[quantity]
            for mesh, found in self.mesh_errors.items()
            if mesh.degree == run.mesh.degree
            and mesh.elements >= run.mesh.elements
            and quantity in found
        ]
        return max(self.floor(quantity), *errors) if np.isfinite(errors).all() else np.inf

    def front(self, quantity: str, scheme: str) -> Front:
        """Line of a scheme in the diagram of a quantity.

        Parameters
        ----------
        quantity, scheme : str
            Names.

        Returns
        -------
        Front
            Its runs that are more accurate than all faster ones, if their error is at most 1.
        """
        runs = [(r.seconds, self.counted(quantity, r), r) for r in self.runs if r.scheme == scheme]
        front = Front(scheme, [], [])
        for _, error, run in sorted(runs, key=lambda entry: entry[:2]):
            if error <= 1 and (not front.runs or SAME * error < front.errors[-1]):
                front.runs.append(run)
                front.errors.append(error)
        return front

    def winners(self, quantity: str) -> list[Winner]:
        """Cheapest schemes by powers of ten of the error, neighbours with the same ones joined.

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
        fronts = [self.front(quantity, scheme) for scheme in self.schemes]
        found: list[Winner] = []
        for level in LEVELS:
            if level < self.floor(quantity):
                break
            winner = cheapest(fronts, level)
            if not winner.schemes:
                return [*found, winner]
            if found and set(winner.schemes) == set(found[-1].schemes):
                before = found.pop()
                seconds = before.seconds[0], winner.seconds[1]
                winner = replace(winner, loosest=before.loosest, seconds=seconds)
            found.append(winner)
        return found
