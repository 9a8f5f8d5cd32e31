"""Solutions as tables: CSV files, pandas and xarray."""

from __future__ import annotations

import csv
import importlib.util

import numpy as np

from fx_beam.scene.beam import COMPONENTS, Node
from fx_beam.validation import is_name, shown

from .files import replacing


def to_csv(solution, path, nodes: dict[str, Node] | None = None) -> None:
    """Write energies, momenta and the motion of some nodes as comma-separated columns.

    What was not recorded is left out.

    Parameters
    ----------
    solution : Solution
        What is written.
    path : str or path
        File to write; its first row names the columns.
    nodes : dict, optional
        Nodes by the names that their columns shall have.
    """
    write_csv(_columns(solution, {} if nodes is None else nodes), path)


def write_csv(columns: dict[str, np.ndarray], path) -> None:
    """Write columns (n,) by their names as comma-separated values."""
    with replacing(path) as new, open(new, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))


def to_pandas(solution, nodes: dict[str, Node] | None = None):
    """Table of energies, momenta and the motion of some nodes, with the columns of `to_csv`.

    Parameters
    ----------
    solution : Solution
        What is shown.
    nodes : dict, optional
        Nodes by the names that their columns shall have.

    Returns
    -------
    pandas.DataFrame
        A row for each time or load factor, which is its index.

    Raises
    ------
    RuntimeError
        Where pandas is not installed.
    """
    return data_frame(_columns(solution, {} if nodes is None else nodes))


def data_frame(columns: dict[str, np.ndarray]):
    """Columns (n,) by their names as pandas.DataFrame; the first is the index."""
    _require("pandas", "to_pandas", "to_csv writes the same columns")
    import pandas

    name = next(iter(columns))
    index = pandas.Index(columns.pop(name), name=name)
    return pandas.DataFrame(columns, index=index)


def to_xarray(solution):
    """All that was recorded, as arrays with named axes.

    Parameters
    ----------
    solution : Solution
        What is shown.

    Returns
    -------
    xarray.Dataset
        Over time "t" or "load factor": energies and momenta; displacements and rotations "q", rates
        "v" and accelerations "a", each by "node" and "component"; and for each beam the resultants
        "N name", "Q name" and "M name", by arc length "s name".

    Raises
    ------
    RuntimeError
        Where xarray is not installed.
    """
    _require("xarray", "to_xarray", "the solution itself has NumPy arrays")
    import xarray

    columns = _columns(solution, {})
    time = next(iter(columns))
    data: dict = {name: (time, values) for name, values in columns.items() if name != time}
    coordinates = {time: columns[time], "component": list(COMPONENTS)}
    coordinates |= {"x": ("node", solution.X[:, 0]), "y": ("node", solution.X[:, 1])}
    recorded = {"q": solution.has_motion, "v": solution.has_rates, "a": solution.has_rates}
    for name in (name for name, known in recorded.items() if known):
        data[name] = (time, "node", "component"), getattr(solution, name)
    for beam in solution.beams if solution.has_motion else ():
        resultants = solution.resultants(beam)
        coordinates[f"s {beam}"] = resultants.s
        data |= {
            f"{kind} {beam}": ((time, f"s {beam}"), getattr(resultants, kind)) for kind in "NQM"
        }
    return xarray.Dataset(data, coordinates, {"scheme": solution.stats.scheme})


def of_rows(rows: list[dict]):
    """The rows as a pandas.DataFrame, where pandas is installed."""
    if importlib.util.find_spec("pandas") is None:
        return rows
    import pandas

    return pandas.DataFrame(rows)


def _require(package: str, what: str, instead: str) -> None:
    if importlib.util.find_spec(package) is None:
        raise RuntimeError(f"{what} needs {package}: pip install {package}. Without it: {instead}")


def _columns(solution, nodes: dict[str, Node]) -> dict[str, np.ndarray]:
    """Columns (n,) by their names, times or load factors first."""
    if not isinstance(nodes, dict) or not all(map(is_name, nodes)):
        raise ValueError(
            f"nodes = {shown(nodes)} must be a dict of nodes by the names of their columns, "
            "such as {'tip': beam.end}"
        )
    columns = {"load factor" if solution.stats.static else "t": solution.t}
    columns |= {f"energy {name}": value for name, value in vars(solution.energy).items()}
    columns["energy total"] = solution.energy.total
    columns["energy balance error"] = solution.energy.balance_error
    columns["linear momentum x"], columns["linear momentum y"] = solution.linear_momentum.T
    columns["angular momentum"] = solution.angular_momentum
    for label, node in nodes.items():
        parts: dict = {}
        if solution.has_motion:
            parts[""] = *solution.position(node).T, solution.rotation(node)
        if solution.has_rates:
            parts[" rate"] = *solution.velocity(node).T, solution.spin(node)
        for i, component in enumerate(COMPONENTS):
            for kind, values in parts.items():
                columns[f"{label} {component}{kind}"] = values[i]
    return columns
