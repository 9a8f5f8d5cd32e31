"""Solutions as files of this package, comma-separated columns, and tables of others."""

from __future__ import annotations

import csv
import importlib.util
import json
import zipfile
from dataclasses import asdict, fields

import numpy as np

from fx_beam.errors import is_name, shown
from fx_beam.scene.beam import COMPONENTS, Beam, Node
from fx_beam.scene.contacts import Contact

from .files import of_numpy, replacing
from .state import HISTORIES

#: Format of saved files.
FORMAT = "fx_beam solution 2"
# What is written of a contact as it is.
_OF_CONTACTS = "stiffness", "restitution", "speed", "radius", "along", "number"


def save(solution, path) -> None:
    """Write the solution to a file that `fx_beam.load` reads.

    Parameters
    ----------
    solution : Solution
        What is written.
    path : str or path
        File to write, in NumPy's npz format: arrays and a JSON text, no pickled objects.
    """
    arrays = {name: getattr(solution, name) for name in ("X", *HISTORIES)}
    arrays |= {f"energy_{name}": value for name, value in vars(solution.energy).items()}
    if solution.end is not None:
        known = {name: value for name, value in vars(solution.end).items() if value is not None}
        past = known.pop("past", None)
        arrays |= {f"end_{name}": value for name, value in known.items()}
        arrays |= {f"past_{name}": value for name, value in vars(past).items()} if past else {}
    if solution.stats.static:
        arrays |= _stability(solution)
    beams: list[dict] = []
    if solution.beams:
        arrays |= _of_all_beams(solution)
    for name, beam in solution.beams.items():
        internal = solution.variables_of_beam.get(name, {})
        arrays |= {
            f"beam{len(beams)}_internal{i}": rows for i, rows in enumerate(internal.values())
        }
        item = {"name": name, "degree": beam.degree, "s": beam.s.tolist()}
        if beam.fractions is not None:
            item["fractions"] = beam.fractions.tolist()
        beams.append({**item, "internal": list(internal)})
    joints = {number: list(variables) for number, variables in solution.variables_of_joint.items()}
    for number, variables in solution.variables_of_joint.items():
        arrays |= {f"joint{number}_internal{i}": rows for i, rows in enumerate(variables.values())}
    for number, variables in solution.variables_of_contact.items():
        arrays[f"contact{number}_friction"] = variables
    stats = asdict(solution.stats)
    bodies = [
        {
            **{name: getattr(body, name) for name in ("name", "mass", "inertia")},
            "centre": body.centre.number,
            "points": {name: node.number for name, node in body.points.items()},
        }
        for body in solution.bodies.values()
    ]
    meta = {"format": FORMAT, "stats": stats, "beams": beams, "joints": joints, "bodies": bodies}
    meta["parameters"] = solution.names_of_parameters
    meta["contacts"] = [_described(contact) for contact in solution.contacts]
    text = json.dumps(meta, default=of_numpy)
    arrays = {"meta": np.array(text), **arrays}
    with replacing(path) as new, open(new, "wb") as raw:
        file = zipfile.ZipFile(raw, "w", zipfile.ZIP_DEFLATED, compresslevel=1)
        try:
            for name, values in arrays.items():
                with file.open(f"{name}.npy", "w", force_zip64=True) as part:
                    np.lib.format.write_array(part, np.asarray(values), allow_pickle=False)
            file.close()
        except BaseException:
            file.fp = None  # it would complain of a part that Ctrl-C has left open
            raise


def _of_all_beams(solution) -> dict[str, np.ndarray]:
    """Nodes and resultants, those of each beam after those of the one before: few arrays."""
    arrays = {"nodes": [solution.nodes_of_beam[name] for name in solution.beams]}
    if solution.has_motion:
        parts = [vars(solution.resultants(name)) for name in solution.beams]
        arrays |= {name: [resultants[name] for resultants in parts] for name in parts[0]}
    return {f"beams_{name}": np.concatenate(parts, axis=-1) for name, parts in arrays.items()}


def _stability(solution) -> dict[str, np.ndarray]:
    """Numbers of unstable modes, if they can be found."""
    try:
        return {"unstable_modes": solution.unstable_modes}
    except ValueError:
        return {}


def _described(contact: Contact) -> dict:
    """A contact in plain values; a node by its number, a beam by its name."""
    target, shape = contact.target, contact.shape
    parts: dict = {"beam": shape.name} if isinstance(shape, Beam) else {}
    if not parts:
        parts = {field.name: getattr(shape, field.name) for field in fields(shape)}
    return {
        "on": target.name if isinstance(target, Beam) else target.number,
        "kind": type(contact.shape).__name__,
        "shape": {
            name: part.number if isinstance(part, Node) else part for name, part in parts.items()
        },
        **{name: getattr(contact, name) for name in _OF_CONTACTS},
        "friction": None if contact.friction is None else asdict(contact.friction),
    }


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
