"""Parts of reports: description of the machine, strict JSON, CSV and Markdown tables."""

from __future__ import annotations

import csv
import functools
import itertools
import json
import os
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from fx_beam.results.export import in_table, named, of_numpy, replacing

_VERSIONS = {"FFCx": "fenics-ffcx", "numpy": "numpy", "fx_beam": "fx-beam"}
# How strict JSON has numbers that are not finite.
_NOT_FINITE = {"NaN": None, "Infinity": "inf", "-Infinity": "-inf"}

Row = Mapping[str, Any]


@functools.cache
def machine() -> dict[str, Any]:
    """Processor, operating system and versions with which a report was computed."""
    # Only functions import what reports need: a study without a report needs none of it.
    import scooby

    report = scooby.Report(core=list(_VERSIONS.values()), optional=[]).to_dict()
    model = re.search(r"^model name\s*: (.*)", Path("/proc/cpuinfo").read_text("utf-8"), re.M)
    return {
        "processor": model[1] if model else os.uname().machine,
        "cores": len(os.sched_getaffinity(0)),
        "system": report["OS"],
        "python": report["Python"].split()[0],
        **{name: report[distribution] for name, distribution in _VERSIONS.items()},
    }


def write_report(path: Path | str, page: str, numbers: Row, rows: Iterable[Row]) -> None:
    """Write a report: a page in Markdown, all numbers as JSON, the rows as CSV."""
    write_json(beside(path, ".json"), {"machine": machine(), **numbers})
    write_csv(beside(path, ".csv"), rows)
    stated = ", ".join(f"{key} {value}" for key, value in machine().items())
    with replacing(beside(path, ".md")) as new:
        new.write_text(f"{page}\nComputed on: {stated}.\n", "utf-8")


def beside(path: Path | str, ending: str) -> Path:
    """Path of a report's file, whose name may contain a point. Creates its directory."""
    path = named(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    return path.with_name(path.name + ending)


def write_json(path: Path | str, numbers: Any) -> None:
    """Write strict JSON: NaN becomes null, infinity the text "inf" or "-inf"."""
    text = json.dumps(_plain(numbers), indent=2, allow_nan=False)
    with replacing(beside(path, "")) as new:
        new.write_text(text + "\n", "utf-8")


def write_csv(path: Path | str, rows: Iterable[Row]) -> None:
    """Write rows as CSV, nested entries as columns with a point, as pandas.json_normalize does."""
    flat = [
        {in_table(name): in_table(value) for name, value in _flat(_plain(row)).items()}
        for row in rows
    ]
    with replacing(beside(path, "")) as new, new.open("w", encoding="utf-8", newline="") as file:
        columns = list(dict.fromkeys(itertools.chain.from_iterable(flat)))
        writer = csv.DictWriter(file, columns, lineterminator="\n")
        writer.writeheader()
        writer.writerows(flat)


def section(title: str, rows: Sequence[Row], note: str = "") -> str:
    """A part of a page: a table under its title, with a note; nothing without rows."""
    return f"## {title}\n\n{note}{table(rows)}" if rows else ""


def table(rows: Sequence[Row]) -> str:
    """Markdown table of rows: numbers to the right, None and NaN left empty."""
    from tabulate import tabulate

    columns = dict.fromkeys(itertools.chain.from_iterable(rows))
    texts = {name for row in rows for name, value in row.items() if isinstance(value, str)}
    sides = ["left" if name in texts else "right" for name in columns]
    cells = [[_cell(row.get(name)) for name in columns] for row in rows]
    # The cells are texts here; without this tabulate would read them as numbers and reformat them.
    how = {"tablefmt": "pipe", "disable_numparse": True, "colalign": sides}
    return tabulate(cells, [_cell(name) for name in columns], **how) + "\n"


def short(number: float) -> str:
    """A number >= 0 with one digit, such as 3e-13 or 2e9; from 1 to 999 as an integer."""
    if 1 <= number < 999.5:
        return f"{number:.0f}" if number >= 9.5 else f"{number:.2g}"
    mantissa, _, exponent = f"{number:.0e}".partition("e")
    return f"{mantissa}e{int(exponent)}" if exponent and number else f"{number:g}"


def _cell(value: Any) -> str:
    if value is None or value != value:
        return ""
    return f"{value:.3g}" if isinstance(value, float) else str(value).replace("|", "\\|")


def _plain(value: Any) -> Any:
    """The value as it is read back from JSON."""
    return json.loads(json.dumps(value, default=of_numpy), parse_constant=_NOT_FINITE.get)


def _flat(value: Any, name: str = "") -> dict[str, Any]:
    if not isinstance(value, dict | list):
        return {name: value}
    items = value.items() if isinstance(value, dict) else enumerate(value)
    nested = [_flat(item, f"{name}.{key}" if name else str(key)) for key, item in items]
    return {column: cell for part in nested for column, cell in part.items()}
