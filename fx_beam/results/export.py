"""Solutions as files of this package, comma-separated columns, and tables of others."""

from __future__ import annotations

import csv
import importlib.util
import io
import json
import zipfile
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from fx_beam.errors import is_name, require
from fx_beam.scene.beam import COMPONENTS, Beam, BeamPlace, Node
from fx_beam.scene.outputs import Output

from .files import in_table, of_numpy, replacing
from .records import BeamResultants, known_resultants
from .section_forces import Balance
from .state import HISTORIES

#: Format of saved files.
FORMAT = "fx_beam solution 3"


def save(solution, path) -> None:
    """Write the solution to a file that `fx_beam.load` reads.

    Parameters
    ----------
    solution : Solution
        What is written.
    path : str or path
        File to write, in NumPy's npz format: arrays and a JSON text, no pickled objects.
    """
    arrays = dict[str, np.ndarray]()
    meta = {name: _packed(part, name, arrays) for name, part in _parts(solution).items()}
    arrays = {"meta": np.array(json.dumps(meta, default=of_numpy)), **arrays}
    with replacing(path) as new, open(new, "wb") as raw:
        file = zipfile.ZipFile(raw, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
        try:
            for name, values in arrays.items():
                with file.open(f"{name}.npy", "w", force_zip64=True) as part:
                    np.lib.format.write_array(part, np.asarray(values), allow_pickle=False)
            file.close()
        except BaseException:
            file.fp = io.BytesIO()  # a part that Ctrl-C has left open is written to its end
            raise


def _parts(solution) -> dict[str, Any]:
    """All that a file has of a solution, by name; of all beams one after the other: few arrays."""
    beams = solution.beams.values()
    parts = {"format": FORMAT, "X": solution.X}
    parts |= {name: getattr(solution, name) for name in HISTORIES}
    attributes = (
        "energy",
        "end",
        "stats",
        "bodies",
        "contacts",
        "names_of_parameters",
        "turns_of_line",
    )
    variables = (f"variables_of_{owner}" for owner in ("beam", "joint", "contact"))
    parts |= {name: getattr(solution, name) for name in (*attributes, *variables)}
    parts["beams"] = [
        {
            "name": beam.name,
            "degree": beam.degree,
            "s": beam.s.tolist(),
            "fractions": None if beam.fractions is None else beam.fractions.tolist(),
            "carriers": [node.number for node in beam.carriers],
        }
        for beam in beams
    ]
    if beams:
        nodes = [solution.nodes_of_beam[name] for name in solution.beams]
        parts["beams_nodes"] = np.concatenate(nodes)
    if known := known_resultants(solution):
        columns = [(r.s, r.N, r.Q, r.M) for r in known.values()]
        joined_columns = (np.concatenate(rows, axis=-1) for rows in zip(*columns, strict=True))
        parts["resultants"] = BeamResultants(*joined_columns)
        with suppress(ValueError):
            parts |= _balances([r.balanced() for r in known.values()])
    with suppress(ValueError):  # none are known, or they are not those of equilibria
        parts["unstable_modes"] = solution.unstable_modes
    return parts


def _balances(balances: list[Balance]) -> dict[str, np.ndarray]:
    """Section forces of all beams at the ends of elements, and at loads inside these."""
    places = [np.column_stack([0 * b.places + k, b.places]) for k, b in enumerate(balances)]
    return {
        "section_forces": np.concatenate([b.ends for b in balances], axis=1),
        "section_places": np.concatenate(places),
        "section_jumps": np.concatenate([b.jumps for b in balances], axis=1),
    }


def _packed(value: Any, name: str, arrays: dict[str, np.ndarray]) -> Any:
    """A value as JSON has it. Arrays go to `arrays`; nodes and beams are known otherwise."""
    if isinstance(value, np.ndarray):
        arrays[name] = value
        return {"array": name}
    if isinstance(value, Node):
        return {"node": value.number}
    if isinstance(value, Beam):
        return {"beam": value.name}
    if is_dataclass(value):
        parts = {field.name: getattr(value, field.name) for field in fields(value)}
        known = {part: _packed(item, f"{name}_{part}", arrays) for part, item in parts.items()}
        return {"is": type(value).__name__, **known}
    if isinstance(value, Mapping):  # whose keys may be numbers, and any text
        return {"keys": [*value], "values": _packed([*value.values()], name, arrays)}
    if isinstance(value, list | tuple):
        packed = [_packed(item, f"{name}{i}", arrays) for i, item in enumerate(value)]
        return packed if isinstance(value, list) else {"tuple": packed}
    return None if callable(value) else value


def to_csv(solution, path, nodes: dict[str, Node | BeamPlace] | None = None) -> None:
    """Write energies, momenta and the motion of some nodes as comma-separated columns.

    What was not recorded is left out. Before names that a spreadsheet would run as formulas (with
    = + - or @ at their start) there is an apostrophe.

    Parameters
    ----------
    solution : Solution
        What is written.
    path : str or path
        File to write; its first row names the columns.
    nodes : dict, optional
        Nodes, and places such as ``beam.at(0.5)`` with their section forces N, Q, M, by the names
        that their columns shall have.
    """
    write_csv(_columns(solution, {} if nodes is None else nodes), path)


def write_csv(columns: dict[str, np.ndarray], path) -> None:
    """Write columns (n,) by their names as comma-separated values."""
    with replacing(path) as new, open(new, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(map(in_table, columns))
        writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))


def to_pandas(solution, nodes: dict[str, Node | BeamPlace] | None = None):
    """Table of energies, momenta and the motion of some nodes, with the columns of `to_csv`.

    Parameters
    ----------
    solution : Solution
        What is shown.
    nodes : dict, optional
        Nodes, and places such as ``beam.at(0.5)`` with their section forces N, Q, M, by the names
        that their columns shall have.

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
    for name in ["q"] * solution.has_motion + ["v", "a"] * solution.has_rates:
        data[name] = (time, "node", "component"), getattr(solution, name)
    for beam, resultants in known_resultants(solution).items():
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


def _require(package: str, task: str, instead: str) -> None:
    if importlib.util.find_spec(package) is None:
        raise RuntimeError(f"{task} needs {package}: pip install {package}. Without it: {instead}")


def _columns(solution, nodes: dict[str, Node | BeamPlace]) -> dict[str, np.ndarray]:
    """Columns (n,) by their names, times or load factors first."""
    expected = "a dict of nodes by the names of their columns, such as {'tip': beam.end}"
    require(isinstance(nodes, dict) and all(map(is_name, nodes)), "nodes", nodes, expected)
    columns = {"load factor" if solution.stats.static else "t": solution.t}
    columns |= {f"energy {name}": value for name, value in vars(solution.energy).items()}
    columns["energy total"] = solution.energy.total
    columns["energy balance error"] = solution.energy.balance_error
    columns["linear momentum x"], columns["linear momentum y"] = solution.linear_momentum.T
    columns["angular momentum"] = solution.angular_momentum
    for label, place in nodes.items():
        parts: dict = {}
        if solution.has_motion:
            parts[""] = _columns_at(solution, place, "position", "rotation")
        if solution.has_rates:
            parts[" rate"] = _columns_at(solution, place, "velocity", "spin")
        for i, component in enumerate(COMPONENTS):
            for kind, values in parts.items():
                columns[f"{label} {component}{kind}"] = values[i]
        if isinstance(place, BeamPlace):
            forces = solution.resultants(place.beam).at(place.s)
            columns |= {f"{label} {name}": getattr(forces, name)[:, 0] for name in "NQM"}
    return columns


def _columns_at(solution, place: Node | BeamPlace, *names: str) -> np.ndarray:
    """Columns (k, n) of quantities of a node or a place."""
    return np.column_stack([solution.value(Output(name, place)) for name in names]).T
