"""Errors of histories and of many runs with their run times, and the cheapest run for an error."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.results.solution import Solution

#: A number, a history (n,) or (n, k) at `Solution.t`, or a pair of times and such a history.
Quantity = Callable[[Solution], Any]
#: A number, or a function of times (n,) that gives (n,) or (n, k).
Exact = float | Callable[[np.ndarray], np.ndarray]

#: Relative errors below this come from Newton's tolerance and round-off; they have no order.
ROUND_OFF = 1e-10
#: An error is known if it is at least this many times that of the reference.
MARGIN = 3.0
#: Largest difference of slopes for which an order of convergence is given.
STEADY = 0.5

#: A run is lost when it gained or lost more than this part of its kinetic and strain energy.
LOST = 0.5
#: Runs whose times differ by less than this factor cost about the same.
ALIKE = 1.2
#: Largest number of halvings of a failing step: more would only prolong a lost motion.
MAX_HALVINGS = 2


@dataclass(frozen=True)
class History:
    """Values (n, k) of a quantity at times (n,) [s]; a single number has one row.

    A reference has a `size` that divides errors, and its own `error`, None if it is exact.
    """

    t: np.ndarray
    values: np.ndarray
    size: float = 1.0
    error: float | None = None
    function: Callable[[np.ndarray], np.ndarray] | None = None

    def at(self, t: np.ndarray) -> np.ndarray:
        """Values (m, k) at other times (m,): exact, or linear in between and NaN outside."""
        if self.function:
            return self.function(t)
        return np.column_stack([np.interp(t, self.t, v, np.nan, np.nan) for v in self.values.T])


def called(what: str, function: Callable, *arguments) -> Any:
    """Value of a user's function, whose errors are named."""
    try:
        return function(*arguments)
    except Exception as wrong:
        raise SceneError(f"{what} failed, {type(wrong).__name__}: {wrong}") from wrong


def measure(name: str, quantity: Quantity, solution: Solution) -> History:
    """History of a quantity of interest of a solution."""
    what = f"quantity {name!r}"
    values = called(what, quantity, solution)
    if isinstance(values, tuple):
        t, values = values if len(values) == 2 else (np.zeros(()), None)
        if np.ndim(t) != 1 or (np.diff(t) <= 0).any():
            raise SceneError(f"{what}: a tuple must be increasing times and an array of values")
    else:
        t = solution.t if np.ndim(values) else solution.t[-1:]
    return History(np.asarray(t), _rows(what, values, np.size(t)))


def exact(name: str, value: Exact, t_end: float) -> History:
    """Exact reference: a number, or a function of times (n,) up to `t_end`."""
    what, times = f"exact value of {name!r}", np.linspace(0, t_end, 1001)

    def at(t):
        return _rows(what, called(what, value, t) if callable(value) else [value] * len(t), len(t))

    history = History(times, at(times), function=at)
    return replace(history, size=_complete(what, history))


def computed(name: str, fine: History, coarse: History) -> History:
    """Reference from a fine solution; a second one with twice the step and element gives its error.

    The difference of the two is three times the error for second order (Roache 1994,
    doi 10.1115/1.2910291) and equal to it for first order. The whole difference is used.
    """
    _complete(f"the reference of {name!r}", coarse)
    history = replace(fine, size=_complete(f"the reference of {name!r}", fine))
    return replace(history, error=error(name, coarse, history))


def error(name: str, history: History, reference: History) -> float:
    """Largest distance from the reference at its times, over its largest magnitude.

    Absolute if the reference is 0, NaN if a value is not finite.
    """
    expected = reference.at(history.t)
    inside = np.isfinite(expected).all(axis=1)
    if not inside.any():
        first, last = history.t[[0, -1]]
        raise SceneError(f"the reference of {name!r} has no time between {first:g} and {last:g} s")
    if (width := history.values.shape[1]) != (other := expected.shape[1]):
        raise SceneError(f"quantity {name!r} has {width} values at a time, its reference {other}")
    return _size(history.values[inside] - expected[inside]) / reference.size


def observed_order(errors: Iterable[tuple[float, float]], floor: float) -> float | None:
    """Slope of log(error) over log(step), fitted to the three smallest steps; None if unclear.

    Errors above 1 or below `floor` are left out. The errors must fall with the step, and the
    slopes between neighbours must not differ by more than `STEADY`.
    """
    points = sorted((h, e) for h, e in errors if floor < e <= 1)[:3]
    if len(points) < 3:
        return None
    log_h, log_e = np.log(points).T
    slopes = np.diff(log_e) / np.diff(log_h)
    if slopes.min() <= 0 or np.ptp(slopes) > STEADY:
        return None
    return float(np.polyfit(log_h, log_e, 1)[0])


def _rows(what: str, numbers: Any, n: int) -> np.ndarray:
    """Values (n, k) of a number, for n = 1, or of a history (n,) or (n, k); None gives NaN."""
    values = np.atleast_1d(np.nan if numbers is None else numbers)
    if values.dtype.kind not in "fiub" or values.ndim > 2 or values.shape[-1] == 0:
        raise SceneError(
            f"{what} must be a real number or an array (n,) or (n, k), not {numbers!r:.40} of "
            f"{values.dtype} with the shape {values.shape}"
        )
    if len(values) != n:
        raise SceneError(f"{what} has {len(values)} rows for {n} times")
    return values.reshape(n, -1).astype(float)


def _complete(what: str, history: History) -> float:
    """Magnitude that divides errors, 1 for a reference of 0; an error where it is not finite."""
    if (gaps := ~np.isfinite(history.values).all(axis=1)).any():
        raise SceneError(f"{what} is not a finite number at t = {history.t[gaps][0]:.4g} s")
    return _size(history.values) or 1.0


def _size(values: np.ndarray) -> float:
    """Largest norm of a row."""
    return float(np.linalg.norm(values, axis=1).max())


@dataclass(frozen=True)
class Mesh:
    """A mesh of a scene.

    Parameters
    ----------
    elements, degree : int
        Number and degree of the elements, as given to the function that makes the scene.
    """

    elements: int
    degree: int

    def __str__(self):
        plural = "s" if self.elements > 1 else ""
        return f"{self.elements} element{plural} of degree {self.degree}"


@dataclass
class Run:
    """One scheme with one time step on one mesh.

    If the scene or the scheme raised an error, only the first four parameters and `failure` are
    set.

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
        Time that the run reached [s].
    failure : str
        Why the run ended early; empty if it was completed.
    first_seconds : float
        Time of the first call, with compilation if the forms were not in the cache [s].
    energy_error : float
        Largest energy gained or lost without work, over the largest kinetic and strain energy.
    errors : dict
        Relative error by quantity; empty if the run ended early, NaN if the error is not known.
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
        """Whether the run ended early, or gained or lost more than half of its energy."""
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
        Estimated relative error of the reference, by quantity; None if it is exact, NaN if there is
        no reference.
    origin : str
        Scheme, mesh and step of the computed references; empty if all references are exact.
    runs : list of Run
        All runs, also those that ended early.
    mesh_errors : dict
        Relative errors with a fine time step, by mesh and then by quantity.
    start : str
        Name of the function that gave the states at the start; empty for the reference state.
    missing : dict
        Reasons why there is no reference, by quantity, or no solution with a fine step, by mesh.
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
        """Fastest run of each scheme with at most a given error.

        Parameters
        ----------
        quantity : str
            Name of the quantity.
        error : float
            Largest relative error. It must hold for the run, for all runs of the same scheme and
            mesh with smaller steps, and for the solutions with a fine step on the same mesh and on
            finer meshes of the same degree; none of these runs may be lost.

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


def alike(fastest: dict[str, Run]) -> list[str]:
    """Schemes of the fastest run and of those that cost about the same; none without a run."""
    least = min((run.seconds for run in fastest.values()), default=0.0)
    return [scheme for scheme, run in fastest.items() if run.seconds < ALIKE * least]


def floor(study: Precision, quantity: str) -> float:
    """Relative error below which the errors of runs are not known; NaN without a reference."""
    reference_size = study.references[quantity] or 0.0  # None if it is exact
    return float(np.fmax(MARGIN * reference_size, np.finfo(float).eps))


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
