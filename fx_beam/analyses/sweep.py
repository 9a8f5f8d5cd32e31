"""A function of the user for many cases, on all cores or on other executors, as a table."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import Executor
from contextlib import closing
from pathlib import Path
from typing import Any

from fx_beam.errors import SceneError
from fx_beam.results import tables
from fx_beam.validation import require, shown

from . import workers
from .journal import Journal
from .progress import progress_bar

# Columns of a row besides those of its case and of what the function gives.
_OWN = "seconds", "error"


def sweep(
    function: Callable[[dict], Any],
    cases: Iterable[Mapping[str, Any]],
    executor: Executor | int | None = None,
    results: Path | str | None = None,
):
    """Call a function for each case, several at a time, and collect the results in a table.

    The first case runs alone, so that forms are compiled once; then all workers start. If a case
    fails, its row has the message of the error. In a script, write the call below
    ``if __name__ == "__main__":``, as worker processes import the script.

    Parameters
    ----------
    function : callable
        ``function(case)`` gives the results of a case: a dict, whose entries become columns, or a
        value, which becomes the column "result". Worker processes must be able to import it:
        define it at the top level of a module.
    cases : iterable of dict, or pandas.DataFrame
        Cases: parameters by name, or the rows of a table.
    executor : concurrent.futures.Executor or int, optional
        What runs the cases: any executor, or the number of processes; by default one process with
        one thread for each core. If one of these is killed, its case fails and the others
        continue; with your own executor this depends on the executor. Under ``mpirun -n N python -m
        mpi4py.futures`` give an ``mpi4py.futures.MPIPoolExecutor``.
    results : path, optional
        File to which each row is appended as it finishes, a line of JSON with "case", "result",
        "seconds" and "error". Cases in the file, also failed ones, are not run again: so you can
        continue a sweep that was interrupted.

    Returns
    -------
    pandas.DataFrame or list of dict
        A row for each case, in their order: the case, the results, the run time in "seconds", and
        "error", which is empty if there is none. A list if pandas is not installed.

    Raises
    ------
    SceneError
        If an argument is invalid, or if the worker processes cannot start.
    KeyboardInterrupt
        If interrupted, after all worker processes have ended. Its attribute `rows` has the
        finished rows.
    concurrent.futures.BrokenExecutor
        If an executor of your own breaks. It has the attribute `rows` as well.

    Examples
    --------
    The lowest frequency of arms of several lengths. An executor with one thread runs here what
    processes would run in a script.

    >>> from concurrent.futures import ThreadPoolExecutor
    >>> import fx_beam as fb
    >>> def lowest(case):
    ...     scene = fb.Scene()
    ...     section = fb.Section(EA=1e6, GA=1e6, EI=100.0, rhoA=1.0)
    ...     scene.clamp(scene.add_beam([(0, 0), (case["length"], 0)], section).start)
    ...     return {"frequency": fb.modes(scene, n=1).frequencies[0]}
    >>> cases = [{"length": 1.0}, {"length": 2.0}, {"length": 0.0}]
    >>> table = fb.sweep(lowest, cases, executor=ThreadPoolExecutor(1))
    >>> bool(table["frequency"][0] > 3.9 * table["frequency"][1])
    True
    >>> print(table["error"][2])
    beam 'beam 1': the points 0 and 1 coincide at (0, 0). Remove one of them
    """
    require(callable(function), "sweep: function", function, "a function of a case")
    given = _listed(cases)
    if executor is None:
        executor = workers.cores()
    journal = Journal(results)
    rows: dict[int, dict] = {}
    try:
        for index, case in enumerate(given):
            if (row := journal.finished(case)) is not None:
                rows[index] = row
        left = [index for index in range(len(given)) if index not in rows]
        with (
            progress_bar(len(given), None, desc="cases", initial=len(rows)) as bar,
            closing(_run(function, [given[index] for index in left], executor)) as runs,
        ):
            for k, row in runs:
                rows[left[k]] = journal.append(row)
                bar.update()
        return _table(rows)
    except BaseException as stop:
        stop.rows = _table(rows)  # type: ignore[attr-defined]
        raise
    finally:
        journal.close()


def _listed(cases: Any) -> list[dict]:
    """Cases as dicts; SceneError for anything else."""
    if hasattr(cases, "to_dict"):  # a table of pandas
        cases = cases.to_dict("records")
    given = _entries(cases)
    if given is None or isinstance(cases, Mapping | str):
        raise SceneError(f"cases must be a sequence of dicts or a table, not {shown(cases)}")
    if not given:
        raise SceneError("a sweep needs cases; none are given")
    for case in given:
        if not isinstance(case, Mapping):
            raise SceneError(f"the case {shown(case)} must be a dict of parameters by name")
        if own := [name for name in _OWN if name in case]:
            raise SceneError(f"{own[0]!r} is a column of the results; rename it in the cases")
    return [dict(case) for case in given]


def _entries(cases: Any) -> list | None:
    try:
        return list(cases)
    except Exception:  # numbers, arrays without axes and UFL expressions have none
        return None


def _run(function, cases: list[dict], executor):
    """Rows as they finish, as the file has them."""
    if not cases:
        return
    with closing(workers.run(function, cases, executor)) as outcomes:
        for index, (value, seconds, error) in outcomes:
            case, result = cases[index], None
            if not error:
                result = dict(value) if isinstance(value, Mapping) else {"result": value}
                if twice := [name for name in result if name in (*case, *_OWN)]:
                    what = "a column of its own" if twice[0] in _OWN else "a parameter of the case"
                    error = (
                        f"the function gives {twice[0]!r}, which is {what}; give it another name"
                    )
                    result = None
            yield index, {"case": case, "result": result, "seconds": seconds, "error": error}


def _table(rows: dict[int, dict]):
    ordered = (row for _, row in sorted(rows.items()))
    return tables.of_rows(
        [
            {**row["case"], **(row["result"] or {}), **{name: row[name] for name in _OWN}}
            for row in ordered
        ]
    )
