"""What reports are made of: the machine, strict JSON and Markdown tables."""

from __future__ import annotations

import functools
import json
import math
import os
import platform
import subprocess
import sys
from collections.abc import Iterable, Sequence
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

#: Distributions whose versions a report states.
VERSIONS = {
    "dolfinx": "fenics-dolfinx",
    "petsc": "petsc4py",
    "numpy": "numpy",
    "fx_beam": "fx-beam",
}

_IMPORT = """
import sys, time
sys.path.insert(0, sys.argv[1])
start = time.perf_counter()
import fx_beam
print(time.perf_counter() - start)
"""


def machine() -> dict[str, Any]:
    """What a report was computed on.

    Returns
    -------
    dict
        Processor, number of its cores that may be used, versions of Python, dolfinx, PETSc, NumPy
        and fx_beam.
    """
    return {
        "processor": _processor(),
        "cores": len(os.sched_getaffinity(0)),
        "python": platform.python_version(),
        **{name: _version(distribution) for name, distribution in VERSIONS.items()},
    }


@functools.cache
def import_seconds() -> float:
    """Time that a fresh interpreter takes to import fx_beam.

    Returns
    -------
    float
        That time, with files that the system has read before; NaN where there is no such
        interpreter [s].
    """
    done = subprocess.run(
        [sys.executable, "-c", _IMPORT, str(Path(__file__).parents[2])],
        # As Python found it: what MPI has added to it since is for this process alone.
        env=dict(os.environ),
        capture_output=True,
        text=True,
        check=False,
    )
    return math.nan if done.returncode else float(done.stdout)


def write_json(path: Path | str, numbers: Any) -> None:
    """Write numbers as JSON that every reader understands, in directories that need not exist.

    Parameters
    ----------
    path : str or path
        File to write.
    numbers : dict
        Dictionaries, sequences, arrays, numbers and texts. NaN becomes null, infinity the text
        "inf" or "-inf", as JSON has neither.
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(_plain(numbers), indent=2, allow_nan=False) + "\n", "utf-8")


def table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Markdown table, legible as plain text too.

    Parameters
    ----------
    header : sequence of str
        Names of the columns.
    rows : iterable of sequences
        Cells; None is left empty. A column of numbers, formatted or not, stands to the right.

    Returns
    -------
    str
        The table, with a line feed at its end.
    """
    lines = [[_cell(value) for value in row] for row in (header, *rows)]
    columns = list(zip(*lines, strict=True))
    widths = [max(3, *map(len, column)) for column in columns]
    right = [all(_is_number(cell) for cell in column[1:] if cell) for column in columns]

    def line(row):
        fitted = [
            cell.rjust(width) if on_right else cell.ljust(width)
            for cell, width, on_right in zip(row, widths, right, strict=True)
        ]
        return "| " + " | ".join(fitted) + " |\n"

    rule = [
        "-" * (n - 1) + (":" if on_right else "-")
        for n, on_right in zip(widths, right, strict=True)
    ]
    return "".join(map(line, [lines[0], rule, *lines[1:]]))


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    for line in cpuinfo.read_text("utf-8").splitlines() if cpuinfo.exists() else ():
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _version(distribution: str) -> str:
    try:
        return metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return "not installed, run from its sources"


def _cell(value: Any) -> str:
    return "" if value is None else str(value).replace("|", "\\|")


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | np.generic):
        value = value.tolist()
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else str(value)
    return value
