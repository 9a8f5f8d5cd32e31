"""Stability of time schemes: a matrix of schemes and cases with a verdict on each run's energy."""

from __future__ import annotations

import itertools
import logging
from collections.abc import Iterable, Mapping, Sequence
from concurrent.futures import Executor
from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, StepError
from fx_beam.laws.schemes import Scheme
from fx_beam.motions.dynamics import simulate
from fx_beam.motions.progress import progress_bar
from fx_beam.results.solution import Solution
from fx_beam.step.recorder import Record
from fx_beam.studies import candidates
from fx_beam.sweeps import workers

from .case import Case, Cell, Verdict, classify, drift_of, energy_ratio

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
    differ in their last digit. If its verdict or its number then differs, the run is marked as
    sensitive to round-off. It may differ on another machine.

    Parameters
    ----------
    schemes : dict or sequence of Scheme
        Time schemes, by label or by their names.
    cases : iterable of Case
        Cases on which they are tested. A case that cannot be computed, or in which nothing moves,
        gives cells with the reason and without a verdict.
    max_halvings : int
        Number of halvings of a failing step after which a run fails, the same for all schemes. A
        run whose energy has blown up ends earlier.
    repeats : int
        Number of repetitions of a doubtful run.
    executor : concurrent.futures.Executor or int, optional
        What runs the cells, as for `sweep`: an executor or a number of processes, to which the
        functions of the cases are sent; by default this process alone.

    Returns
    -------
    list of Cell
        Ordered by case, then by scheme; for `write`.

    Raises
    ------
    SceneError
        Before anything runs, if there are no cases or schemes, or if two have the same name.
    KeyboardInterrupt
        If interrupted. Its attribute `cells` holds the runs that are done, for `write`; so does
        that of every other exception.

    Examples
    --------
    Two stiffnesses of a scene of your own, which ``arm(EA)`` gives:

    >>> cases = [
    ...     fb.stability.Case("Arm: EA [N]", f"{EA:g}", lambda EA=EA: arm(EA), dt=0.01, t_end=5.0)
    ...     for EA in (1e6, 1e10)
    ... ]
    >>> schemes = [fb.EnergyMomentum(), fb.Newmark()]
    >>> cells = fb.stability.study(schemes, cases)
    >>> fb.stability.write("results/arm", cells, "an arm")  # .json, .csv, .md, .png
    """
    labelled, cases = candidates.labelled(schemes), list(cases)
    if wrong := [case for case in cases if not isinstance(case, Case)]:
        raise SceneError(f"{wrong[0]!r} is no fx_beam.stability.Case")
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
            closing(workers.run(partial(_judged, repeats=repeats), items, executor)) as outcomes,
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
    if (
        cell.case.drifts
        and end is not None
        and verdict.kind in ("kept", "damped", "lost", "gained")
    ):
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
