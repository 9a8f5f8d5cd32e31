"""Stability of time schemes: cases, verdicts on the energy of runs, and the study of all."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, StepError, array_of, is_whole, positive, require
from fx_beam.laws.schemes import Scheme
from fx_beam.motions.dynamics import simulate
from fx_beam.motions.progress import progress_bar
from fx_beam.results.solution import Solution
from fx_beam.scene.scene import Scene
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import Record
from fx_beam.sweeps import sweep
from fx_beam_studies import candidates

#: Largest difference of the energy ratio from 1 for the verdict `kept`.
KEPT = 1e-8
#: Energy ratio above which the verdict is `blew up`.
BLOWN_UP = 10.0
#: Kinds of verdict; the last is for a case that cannot be computed, or in which nothing moves.
KINDS = "kept", "damped", "lost", "gained", "blew up", "failed", "no verdict"

#: Lags of the fit to a drift, as parts of the run. For longer lags there are too few samples; for
#: shorter ones the round-off of the energy itself dominates.
LAGS = 1 / 50, 1 / 5
#: Smallest number of errors from which a drift can be determined.
FEWEST = 100
#: Laws of a drift by their exponents.
LAWS = {0.0: "stays within bounds", 0.5: "random walk", 1.0: "drifts to one side"}

#: Relative difference up to which the numbers of two runs with different round-off are equal.
SAME = 0.1
#: Steps taken per step of the time grid from which on steps count as halved often.
OFTEN = 2.0


@dataclass(frozen=True)
class Verdict:
    """Verdict on the energy of a run.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    time, reached : float
        Time reached [s], and as a part of the requested time.
    highest, lowest : float
        Extremes of `energy_ratio`; NaN if there is no verdict.
    steps, substeps : int
        Steps of the time grid, and steps taken, including each part of a halved step.
    iterations, halvings : int
        Total numbers of Newton iterations and of halvings.
    reason : str
        Why the run failed, or why there is no verdict; empty if the run was completed.
    """

    kind: str
    time: float = 0.0
    reached: float = 0.0
    highest: float = np.nan
    lowest: float = np.nan
    steps: int = 0
    substeps: int = 0
    iterations: int = 0
    halvings: int = 0
    reason: str = ""

    @property
    def worst(self) -> float:
        """Largest difference of the energy ratio from 1; infinite if the energy is not finite."""
        return max(self.highest - 1, 1 - self.lowest)

    @property
    def gain(self) -> float:
        """Largest energy gained, as a part of the reference energy; 0 if none."""
        return max(self.highest - 1, 0.0)

    @property
    def amount(self) -> float:
        """The number for this kind of verdict.

        If the energy was kept, the largest error; if it was damped, lost or gained, this part of
        it; if it blew up, the energy ratio; if the run failed, the part of the time that it
        reached.
        """
        numbers = {"damped": 1 - self.lowest, "lost": 1 - self.lowest, "gained": self.gain}
        numbers |= {"blew up": self.highest, "failed": self.reached}
        return numbers.get(self.kind, self.worst)

    @property
    def parts(self) -> float:
        """Steps taken per step of the time grid; 1 if none was halved."""
        return self.substeps / self.steps if self.steps else 1.0


def energy_ratio(solution: Solution) -> np.ndarray:
    r"""Ratio of the energy to its exact value, scaled by the energy that moves.

    .. math:: r = 1 + \frac{e(t)}{E_0}, \qquad e = E - E(0) - W,
        \qquad E_0 = \max_t \left(T(0) + U(0) + W(t) - V(t) + V(0)\right),

    where E is the total energy, and W the work of all loads less the energy that dampers took, so
    that r = 1 under loads as well. The energy that `EnergyDecaying` takes lowers the ratio. E_0 is
    the largest kinetic and strain energy T + U that the motion should have, by its energy at the
    start and the work of loads and weight, whose potential is V. Without loads it is T + U at the
    start, in a fall from rest the largest potential energy released. As T and U are not negative, r
    is not negative.

    Parameters
    ----------
    solution : Solution
        A run, complete or up to a failed step.

    Returns
    -------
    (n,) float
        The ratio at the times of the solution; infinite if the energy is not finite.

    Raises
    ------
    SceneError
        If nothing moves, so that there is no energy to compare with.
    """
    return 1 + _over_moving(solution, solution.energy.gained)


def _over_moving(solution: Solution, error: np.ndarray) -> np.ndarray:
    """An error of the energy over E_0 of `energy_ratio`; infinite where it is not finite."""
    energy = solution.energy
    with np.errstate(invalid="ignore", over="ignore"):
        # What the scheme takes lessens no supply.
        supplied = energy.supplied + (energy.numerical - energy.numerical[0])
        start = energy.kinetic[0] + energy.stored[0]
        moving = start + supplied - energy.potential + energy.potential[0]
        scale = moving[np.isfinite(moving)].max()
        if scale > 0:
            return np.where(np.isfinite(part := error / scale), part, np.inf)
    if solution.stats.failure:  # before anything moved
        return np.zeros(len(solution.t))
    raise SceneError(
        f"no energy moves from t = 0 to {solution.t[-1]:g}: give a scene with loads or velocities"
    )


def classify(run: Solution | StepError, t_end: float) -> Verdict:
    """Verdict on a run.

    The first that holds: `blew up` if the energy ratio exceeded `BLOWN_UP` or was not finite, also
    if a step failed later; `failed` if a step failed; `kept` if the ratio always differed from 1 by
    at most `KEPT`; `gained` if the ratio rose more than it fell; `damped` if the loss is, within
    `KEPT`, the energy that the scheme states as taken, `Energy.numerical`; else `lost`.

    Parameters
    ----------
    run : Solution or StepError
        What `simulate` gave or raised.
    t_end : float
        Requested end of the run [s].

    Returns
    -------
    Verdict
        The verdict.

    Raises
    ------
    SceneError
        If nothing moves, or for another run, or a time that is not positive.
    """
    positive(t_end, "classify: t_end")
    if isinstance(run, StepError):
        solution, time = run.solution, run.time
    else:
        require(hasattr(run, "energy"), "classify: run", run, "what simulate gives or raises")
        solution, time = run, float(run.t[-1])
    if solution is None:  # no step was tried
        return Verdict("failed", time, time / t_end, 1.0, 1.0, reason=str(run))
    ratio, stats, failure = energy_ratio(solution), solution.stats, solution.stats.failure
    highest, lowest = float(ratio.max()), float(ratio.min())
    reason = f"{failure.reason}. {failure.where}".rstrip(". ") if failure else ""
    applies = {
        "blew up": highest > BLOWN_UP,
        "failed": bool(reason),
        "kept": max(highest - 1, 1 - lowest) <= KEPT,
        "gained": highest - 1 > 1 - lowest,
        "damped": abs(_over_moving(solution, solution.energy.balance_error)).max() <= KEPT,
        "lost": True,
    }
    kind = next(kind for kind in applies if applies[kind])
    numbers = stats.steps, stats.substeps, stats.newton_iterations, stats.halvings
    return Verdict(kind, time, time / t_end, highest, lowest, *numbers, reason)


@dataclass(frozen=True)
class Drift:
    """Growth of an error with the number of steps.

    Parameters
    ----------
    exponent : float
        Slope p of rms(e(n + k) - e(n)) ~ k^p: 0 for a bounded error, 1/2 for a random
        walk, as from round-off, and 1 for a drift to one side.
    steps : dict
        Largest magnitude of the error so far, by number of steps.
    """

    exponent: float
    steps: dict[int, float]

    @property
    def law(self) -> str:
        """The law with the nearest exponent, in words."""
        return LAWS[min(LAWS, key=lambda p: abs(p - self.exponent))]


def drift_of(error: np.ndarray) -> Drift:
    """Growth of the error of an invariant with the number of steps.

    Parameters
    ----------
    error : (n,) float
        Error of the invariant after each step, from the start on.

    Returns
    -------
    Drift
        The exponent, and the errors by number of steps.

    Raises
    ------
    SceneError
        For fewer than 100 errors, or values that are not finite.
    """
    error = array_of(error, "drift_of: error")
    n = len(error) if error.ndim == 1 else 0
    if n < FEWEST or not np.isfinite(error).all():
        raise SceneError(f"the law of a drift needs at least {FEWEST} finite errors, not {n}")
    lags = np.unique(np.geomspace(LAGS[0] * n, LAGS[1] * n, 20).astype(int))
    rms = np.array([np.sqrt(np.mean((error[k:] - error[:-k]) ** 2)) for k in lags])
    moved = rms > 0
    exponent = np.polyfit(np.log(lags[moved]), np.log(rms[moved]), 1)[0] if moved.any() else 0.0
    largest = np.maximum.accumulate(abs(error - error[0]))
    decades = [10**k for k in range(1, 10) if 10**k < n - 1]
    return Drift(float(exponent), {k: float(largest[k]) for k in (*decades, n - 1)})


@dataclass(frozen=True)
class Case:
    """A scene with a time step, on which schemes are tested.

    Parameters
    ----------
    group, label : str
        Name of the quantity that is varied, and its value in this case, in a few characters.
    scene : callable
        ``scene()`` gives the `Scene`.
    dt, t_end : float
        Time step and end of the run [s].
    newton : NewtonOptions, optional
        Tolerance and limits of Newton's method.
    drifts : bool
        Whether to determine how the error grows with the number of steps.
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
        if (steps := self.t_end / self.dt) < fewest * (1 - 1e-6):
            raise SceneError(f"{self.name}: {what} needs {fewest} or more steps, not {steps:.3g}")

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
    scheme : str
        Label of the scheme.
    verdict : Verdict
        Verdict on the energy.
    others : tuple of Verdict
        Verdicts on runs that differ only in round-off; empty if the run was not repeated.
    seconds : float
        Time spent stepping [s].
    max_halvings : int
        Largest number of halvings of a failing step.
    drift : Drift, optional
        Growth of the error with the number of steps, if the case has `drifts` and the run was
        completed.
    turns : float, optional
        Largest number of turns of a node at the end, if a drift was found.
    """

    case: Case
    scheme: str
    verdict: Verdict
    others: tuple[Verdict, ...] = ()
    seconds: float = 0.0
    max_halvings: int = 0
    drift: Drift | None = None
    turns: float | None = None

    @property
    def other(self) -> Verdict | None:
        """The verdict of a repeated run that differs most, if one differs.

        A verdict of another kind, or else the one whose number differs most, if by more than a
        tenth. Where the energy is kept, the numbers are round-off and are not compared.
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
        """Whether the run ended with at least two steps per step of the time grid."""
        return self.verdict.kind not in ("blew up", "failed") and self.verdict.parts >= OFTEN


def grouped(cells: Iterable[Cell], attribute: str) -> dict[str, list[Cell]]:
    """Cells by an attribute, such as "scheme" or "case.group", in their order."""
    groups: dict[str, list[Cell]] = {}
    for cell in candidates.entries_of(Cell, cells):
        groups.setdefault(attrgetter(attribute)(cell), []).append(cell)
    return groups


_log = logging.getLogger("fx_beam")

# Relative change of the time step for repeated runs: enough to change the last digits of all
# results. It must be small, so that a load that jumps between two steps still does.
_DIGIT = 2.0**-51


def study(
    schemes: Mapping[str, Scheme] | Sequence[Scheme],
    cases: Iterable[Case],
    *,
    max_halvings: int = 12,
    repeats: int = 4,
    executor: Executor | int | None = None,
) -> list[Cell]:
    """Verdicts on all schemes in all cases.

    A run that does not keep the energy, or halves its steps often, is repeated with time steps that
    differ in their last digit. If the verdict or its number then differs, the run is marked as
    sensitive to round-off: it may differ on another machine.

    Parameters
    ----------
    schemes : dict or sequence of Scheme
        Time schemes, by label or by their names.
    cases : iterable of Case
        Cases on which the schemes are tested. A case that cannot be computed, or in which nothing
        moves, gives cells with the reason and without a verdict.
    max_halvings : int
        Number of halvings of a failing step after which a run fails, for all schemes. A run whose
        energy has blown up ends earlier.
    repeats : int
        Number of repetitions of a doubtful run.
    executor : concurrent.futures.Executor or int, optional
        An executor or a number of processes for the runs, as for `sweep`; the functions of the
        cases are sent to the processes. By default this process alone.

    Returns
    -------
    list of Cell
        Ordered by case, then by scheme; for `write`.

    Raises
    ------
    SceneError
        Before anything runs, if there are no cases or schemes, or if two have the same name.
    KeyboardInterrupt
        If interrupted. The attribute `cells` of this exception, and of any other, has the runs that
        are done, for `write`.

    Examples
    --------
    Two stiffnesses of a scene of your own, which ``arm(EA)`` gives:

    >>> from fx_beam_studies import stability
    >>> cases = [
    ...     stability.Case("Arm: EA [N]", f"{EA:g}", lambda EA=EA: arm(EA), dt=0.01, t_end=5.0)
    ...     for EA in (1e6, 1e10)
    ... ]
    >>> schemes = [fb.EnergyMomentum(), fb.Newmark()]
    >>> cells = stability.study(schemes, cases)
    >>> stability.write("results/arm", cells, "an arm")  # .json, .csv, .md, .png
    """
    wanted = "a whole number from 0 "
    require(is_whole(max_halvings, 0, 50), "max_halvings", max_halvings, f"{wanted}to 50")
    require(is_whole(repeats, 0), "repeats", repeats, f"{wanted}on")
    labelled, cases = candidates.labelled(schemes), candidates.entries_of(Case, cases)
    candidates.several("cases", [case.name for case in cases])
    none = Verdict("no verdict")
    items = [
        (Cell(case, label, none, max_halvings=max_halvings), scheme)
        for case, (label, scheme) in itertools.product(cases, labelled.items())
    ]
    cells: dict[int, Cell] = {}
    try:
        with (
            progress_bar(len(items), None, desc="runs") as bar,
            closing(sweep.run(partial(_judged, repeats=repeats), items, executor)) as outcomes,
        ):
            for index, (judged, _, error) in outcomes:
                blank = replace(items[index][0], verdict=replace(none, reason=error))
                cell = cells[index] = judged or blank
                _log.info("%s, %s: %s", cell.case.name, cell.scheme, cell.verdict.kind)
                bar.update()
        return [cells[index] for index in sorted(cells)]
    except BaseException as stop:
        stop.cells = [cells[index] for index in sorted(cells)]  # type: ignore[attr-defined]
        raise


def _judged(item: tuple[Cell, Scheme], repeats: int) -> Cell:
    """A cell with the verdict on its run and on repeated runs; in a worker, if there are any."""
    cell, scheme = item
    solution, verdict = _run(cell, scheme)
    cell = replace(cell, verdict=verdict)
    if verdict.kind != "kept" or cell.halved_often:
        digits = [_DIGIT * (number // 2 + 1) * (-1) ** number for number in range(repeats)]
        cell = replace(cell, others=tuple(_run(cell, scheme, 1 + digit)[1] for digit in digits))
    if solution is None:  # no step was tried
        return cell
    ratio, end = energy_ratio(solution), solution.end
    if cell.case.drifts and end is not None and verdict.kind not in ("blew up", "failed"):
        turns = float(abs(end.q[:, 2]).max() / (2 * np.pi))
        cell = replace(cell, drift=drift_of(ratio - 1), turns=turns)
    return replace(cell, seconds=solution.stats.seconds)


def _run(cell: Cell, scheme: Scheme, stretch: float = 1.0) -> tuple[Solution | None, Verdict]:
    """A run, as far as it came, and its verdict.

    The limit of halvings is raised in stages, so that a run that blows up ends early.
    """
    case, most, run = cell.case, cell.max_halvings, None
    scene, dt, t_end = case.scene(), case.dt * stretch, case.t_end * stretch
    record = Record(motion=False, rates=False, forces=False)
    for limit in (*range(2, most, 2), most):
        how: dict[str, Any] = {"max_halvings": limit, "record": record, "progress": False}
        try:
            solution = simulate(scene, scheme, dt=dt, t_end=t_end, newton=case.newton, **how)
            return solution, classify(solution, t_end)
        except StepError as error:
            run, verdict = error.solution, classify(error, t_end)
        if verdict.kind != "failed":
            break
    return run, verdict
