"""Stability of time schemes: a matrix of schemes and cases, each run judged by its energy."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping

import numpy as np

from .cell import Case, Cell
from .drift import Drift, drift_of
from .dynamics import simulate
from .errors import SceneError, StepError
from .recorder import Record
from .schemes import Scheme
from .solution import Solution
from .stability_report import counts, write
from .verdict import BLOWN_UP, KEPT, KINDS, Verdict, classify, energy_ratio

__all__ = [
    "BLOWN_UP",
    "KEPT",
    "KINDS",
    "Case",
    "Cell",
    "Drift",
    "Verdict",
    "classify",
    "counts",
    "drift_of",
    "energy_ratio",
    "study",
    "write",
]

_log = logging.getLogger("fx_beam")

# Points of a curve that are kept.
_POINTS = 400


def study(
    schemes: Mapping[str, Scheme],
    cases: Iterable[Case],
    *,
    max_halvings: int = 8,
) -> list[Cell]:
    """Verdicts on all schemes in all cases.

    Parameters
    ----------
    schemes : dict
        Time schemes by name.
    cases : iterable of Case
        What they are tried on.
    max_halvings : int
        How often a failing step is halved before the run is given up, for all schemes alike.

    Returns
    -------
    list of Cell
        Case by case, in each the schemes in their order; for `write`.

    Raises
    ------
    SceneError
        If a scene cannot be computed, or two cases have one name.

    Examples
    --------
    Two stiffnesses of a scene of your own, which ``arm(EA)`` gives:

    >>> cases = [
    ...     fb.stability.Case("Arm: EA [N]", f"{EA:g}", lambda EA=EA: arm(EA), dt=0.01, t_end=5.0)
    ...     for EA in (1e6, 1e10)
    ... ]
    >>> schemes = {"EnergyMomentum": fb.EnergyMomentum(), "Newmark": fb.Newmark()}
    >>> cells = fb.stability.study(schemes, cases)
    >>> fb.stability.write("results/arm", cells, "an arm")  # .json, .md and pictures
    """
    cases = list(cases)
    if len({case.name for case in cases}) < len(cases):
        raise SceneError("two cases have the same group and label; give them different ones")
    return [
        _cell(case, name, scheme, max_halvings)
        for case in cases
        for name, scheme in schemes.items()
    ]


def _cell(case: Case, name: str, scheme: Scheme, max_halvings: int) -> Cell:
    try:
        run = _run(case, scheme, max_halvings)
        verdict = classify(run, case.t_end, case.start)
    except SceneError as error:
        raise SceneError(f"{case.name}, {name}: {error}") from error
    solution: Solution = run.solution if isinstance(run, StepError) else run
    t, ratio = energy_ratio(solution, case.start)
    drift = None
    if case.drifts and verdict.kind in ("kept", "lost", "gained"):
        drift = drift_of(ratio - 1)
    _log.info("%s, %s: %s", case.name, name, verdict.kind)
    kept = _thinned(ratio)
    seconds = solution.stats.seconds
    return Cell(case, name, scheme.name, verdict, t[kept], ratio[kept], seconds, drift)


def _run(case: Case, scheme: Scheme, max_halvings: int) -> Solution | StepError:
    try:
        return simulate(
            case.scene(),
            scheme,
            dt=case.dt,
            t_end=case.t_end,
            newton=case.newton,
            max_halvings=max_halvings,
            record=Record(motion=False, rates=False, forces=False),
            progress=False,
        )
    except StepError as error:
        return error


def _thinned(values: np.ndarray) -> np.ndarray:
    """Places of the lowest and the highest value in each of some hundred stretches."""
    if len(values) <= _POINTS:
        return np.arange(len(values))
    stretches = np.array_split(np.arange(len(values)), _POINTS // 2)
    extremes = [(s[values[s].argmin()], s[values[s].argmax()]) for s in stretches]
    return np.unique([0, *np.ravel(extremes), len(values) - 1])
