"""Files that users ask for: solutions, comma-separated columns, and tables of others."""

from __future__ import annotations

import csv
import importlib.util
import io
import json
import os
import secrets
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, is_name, require, shown
from fx_beam.scene.beam import COMPONENTS, Beam, BeamPlace, Node
from fx_beam.scene.body import Body
from fx_beam.scene.contacts import Contact
from fx_beam.scene.forces_between import ForceBetween
from fx_beam.scene.joints import Joint
from fx_beam.scene.outputs import OF_PLACES, Output, is_gear, lack, quantities_of

from .records import BeamBalance, BeamResultants, known_resultants
from .state import HISTORIES

# -- Files that users ask to be written ---------------------------------------------------------


# What formulas begin with.
_FORMULAS = tuple("=+-@\t\r")


def of_numpy(value: object) -> object:
    """A number or an array of NumPy as JSON has it; ValueError for what JSON does not know."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise ValueError(f"{value!r:.80} is a {type(value).__name__}, which JSON cannot hold")


def in_table(value: object) -> object:
    """A value in a table that a spreadsheet may open, where no text is run as a formula."""
    if not isinstance(value, str) or not value.startswith(_FORMULAS):
        return value
    try:
        float(value)
    except ValueError:
        return f"'{value}"  # for spreadsheets the mark of a text
    return value


def named(path: Path | str) -> Path:
    """The path of a file; ValueError for what is no name."""
    if not isinstance(path, str | Path) or not str(path) or "\0" in str(path):
        raise ValueError(f"path = {shown(path)} must be the name of a file, or a Path")
    return Path(path)


def writable(path: Path | str, endings: Sequence[str] = ()) -> Path:
    """The path of a file to be written; ValueError for a missing folder or an unknown ending."""
    file = named(path)
    if not file.parent.is_dir():
        raise ValueError(f"cannot write {file}: make the folder {file.parent} first")
    if endings and file.suffix.lower().lstrip(".") not in endings:
        raise ValueError(f"cannot write {file}: its name must end with .{', .'.join(endings)}")
    return file


@contextmanager
def replacing(path: Path | str, durable: bool = True) -> Iterator[Path]:
    """A new file to be written, which takes the place of `path` at the end of the block.

    An earlier file is whole until then, and after a failure. Links are followed, permissions kept.
    With `durable` the file is on the disk, also after a power cut.
    """
    target = Path(os.path.realpath(writable(path)))
    if target.is_dir():
        raise ValueError(f"cannot write {path}: it is a folder")
    if target.exists() and not target.is_file():  # such as /dev/stdout
        yield target
        return
    if target.exists() and not os.access(target, os.W_OK):
        raise PermissionError(f"cannot write {path}: the file is write-protected")
    new = target.with_name(f".{target.stem[:50]}-{secrets.token_hex(8)}{target.suffix}")
    try:
        new.touch(exist_ok=False)
        if target.exists():
            old = target.stat()
            with suppress(OSError):  # where the owner may not be changed
                os.chown(new, old.st_uid, old.st_gid)
            new.chmod(old.st_mode & 0o777)
        yield new
        if durable:
            with open(new, "rb") as file:
                os.fsync(file.fileno())
        new.replace(target)
    finally:
        new.unlink(missing_ok=True)


@contextmanager
def replacing_all(paths: Sequence[Path]) -> Iterator[list[str]]:
    """Many files at once as by `replacing`, not `durable`; most are not there yet."""
    token = secrets.token_hex(8)
    with ExitStack() as earlier:
        files, moves = list[str](), list[tuple[str, Path]]()
        for number, path in enumerate(paths):
            if os.path.lexists(path):
                file = str(earlier.enter_context(replacing(path, durable=False)))
            else:
                file = os.path.join(path.parent, f".{token}-{number}{path.suffix}")
                moves.append((file, path))
            files.append(file)
        try:
            yield files
            for file, path in moves:
                os.replace(file, path)
        except BaseException:
            for file, _ in moves:
                with suppress(FileNotFoundError):
                    os.unlink(file)
            raise


# -- Solutions as files of this package, comma-separated columns, and tables of others ----------


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


def _balances(balances: list[BeamBalance]) -> dict[str, np.ndarray]:
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


def to_csv(
    solution,
    path,
    nodes: Mapping[str, Any] | None = None,
    *,
    outputs: Mapping[str, Output] | None = None,
    energies: bool | None = None,
    units: bool = False,
) -> None:
    """Write energies, motions of parts of the scene, and outputs as a table with commas.

    Quantities that were not recorded are left out, except `outputs`. Names that a spreadsheet would
    run as formulas (with = + - or @ at their start) get an apostrophe before them.

    Parameters
    ----------
    solution : Solution
        What is written.
    path : str or path
        File to write; its first row names the columns.
    nodes : dict, optional
        Parts by names, with which their columns begin: nodes and bodies, with the reactions of
        supports; places such as ``beam.at(0.5)``, with section forces N, Q, M; joints, ropes,
        springs, contacts and gears, with all quantities that an `Output` can have for them.
    outputs : dict of Output, optional
        Outputs by the names of their columns, to which components are added.
    energies : bool, optional
        Whether energies and momenta are written; by default those of motions are.
    units : bool
        Whether a second row has the SI units.

    Raises
    ------
    SceneError
        For anything that is no part or output of this solution.
    ValueError
        For an output that was not recorded.
    """
    columns, known_units = _columns(solution, nodes, outputs, energies)
    write_csv(columns, path, known_units if units else None)


def write_csv(columns: dict[str, np.ndarray], path, units: list[str] | None = None) -> None:
    """Write columns (n,) by their names as comma-separated values, with a row of units if any."""
    with replacing(path) as new, open(new, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(map(in_table, columns))
        if units is not None:
            writer.writerow(units)
        writer.writerows(zip(*(column.tolist() for column in columns.values()), strict=True))


def to_pandas(
    solution,
    nodes: Mapping[str, Any] | None = None,
    *,
    outputs: Mapping[str, Output] | None = None,
    energies: bool | None = None,
):
    """Table with the columns of `to_csv`.

    Parameters
    ----------
    solution : Solution
        What is shown.
    nodes, outputs, energies : optional
        As of `to_csv`.

    Returns
    -------
    pandas.DataFrame
        A row for each time or load factor, which is its index. ``attrs["units"]`` has the SI units
        by columns.

    Raises
    ------
    RuntimeError
        Where pandas is not installed.
    SceneError, ValueError
        As of `to_csv`.
    """
    columns, units = _columns(solution, nodes, outputs, energies)
    known_units = dict(zip(columns, units, strict=True))
    frame = data_frame(columns)
    frame.attrs["units"] = known_units
    return frame


def data_frame(columns: dict[str, np.ndarray]):
    """Columns (n,) by their names as pandas.DataFrame; the first is the index."""
    _require("pandas", "to_pandas", "to_csv writes the same columns")
    import pandas

    name = next(iter(columns))
    index = pandas.Index(columns.pop(name), name=name)
    return pandas.DataFrame(columns, index=index)


def to_xarray(
    solution,
    nodes: Mapping[str, Any] | None = None,
    *,
    outputs: Mapping[str, Output] | None = None,
    energies: bool | None = None,
):
    """All that was recorded, as arrays with named axes.

    Parameters
    ----------
    solution : Solution
        What is shown.
    nodes, outputs, energies : optional
        As of `to_csv`.

    Returns
    -------
    xarray.Dataset
        Over time "t" or "load factor": the columns of `to_csv`; displacements and rotations "q",
        rates "v" and accelerations "a", each by "node" and "component"; and for each beam the
        resultants "N name", "Q name" and "M name", by arc length "s name". The attribute "units" of
        each has its SI unit.

    Raises
    ------
    RuntimeError
        Where xarray is not installed.
    SceneError, ValueError
        As of `to_csv`.
    """
    _require("xarray", "to_xarray", "the solution itself has NumPy arrays")
    import xarray

    columns, units = _columns(solution, nodes, outputs, energies)
    known_units = dict(zip(columns, units, strict=True))
    time = next(iter(columns))
    data: dict = {name: (time, values) for name, values in columns.items() if name != time}
    coordinates = {time: columns[time], "component": list(COMPONENTS)}
    coordinates |= {"x": ("node", solution.X[:, 0]), "y": ("node", solution.X[:, 1])}
    known_units |= {"x": "m", "y": "m"}
    recorded: dict[str, tuple] = {}
    rates = {"v": "m/s, rad/s", "a": "m/s^2, rad/s^2"} if solution.has_rates else {}
    for name, unit in (({"q": "m, rad"} if solution.has_motion else {}) | rates).items():
        recorded[name] = (time, "node", "component"), getattr(solution, name)
        known_units[name] = unit
    for beam, resultants in known_resultants(solution).items():
        coordinates[f"s {beam}"] = resultants.s
        known_units[f"s {beam}"] = "m"
        for kind in "NQM":
            recorded[f"{kind} {beam}"] = (time, f"s {beam}"), getattr(resultants, kind)
            known_units[f"{kind} {beam}"] = OF_PLACES[kind].unit
    twice = {*data} & ({*recorded} | {*coordinates})
    expected = "other names than those of arrays that the dataset has"
    require(not twice, "to_xarray: columns", sorted(twice), expected)
    dataset = xarray.Dataset(data | recorded, coordinates, {"scheme": solution.stats.scheme})
    for name, unit in known_units.items():
        dataset[name].attrs["units"] = unit
    return dataset


def of_rows(rows: list[dict]):
    """The rows as a pandas.DataFrame, where pandas is installed."""
    if importlib.util.find_spec("pandas") is None:
        return rows
    import pandas

    return pandas.DataFrame(rows)


def _require(package: str, task: str, instead: str) -> None:
    if importlib.util.find_spec(package) is None:
        raise RuntimeError(f"{task} needs {package}: pip install {package}. Without it: {instead}")


def _columns(
    solution,
    nodes: Mapping[str, Any] | None,
    outputs: Mapping[str, Output] | None,
    energies: bool | None,
) -> tuple[dict[str, np.ndarray], list[str]]:
    """Columns (n,) by their names, times or load factors first, and their units."""
    static = solution.stats.static
    columns = {"load factor" if static else "t": solution.t}
    units = ["1" if static else "s"]

    def add(name: str, values: np.ndarray, unit: str) -> None:
        require(name not in columns, "the name of a column", name, "used once")
        columns[name] = values
        units.append(unit)

    if not static if energies is None else energies:
        for name, values in vars(solution.energy).items():
            add(f"energy {name}", values, "J")
        add("energy total", solution.energy.total, "J")
        add("energy balance error", solution.energy.balance_error, "J")
        for component, values in zip("xy", solution.linear_momentum.T, strict=True):
            add(f"linear momentum {component}", values, "kg m/s")
        add("angular momentum", solution.angular_momentum, "kg m^2/s")
    expected = "a dict of nodes by the names of their columns, such as {'tip': beam.end}"
    parts: Any = {} if nodes is None else nodes
    require(isinstance(parts, dict) and all(map(is_name, parts)), "nodes", nodes, expected)
    for label, part in parts.items():
        for name, output in _outputs_of(solution, part):
            try:
                values = _values(solution, output)
            except SceneError:
                raise
            except ValueError:  # it was not recorded
                continue
            for component, (column, unit) in values.items():
                add(" ".join(filter(None, (label, name, component))), column, unit)
    expected = "a dict of fx_beam.Output by the names of their columns"
    parts = {} if outputs is None else outputs
    require(isinstance(parts, dict) and all(map(is_name, parts)), "outputs", outputs, expected)
    for label, output in parts.items():
        for component, (column, unit) in _values(solution, output).items():
            add(f"{label} {component}".rstrip(), column, unit)
    return columns, units


# Columns of nodes and places, with their quantities and components.
_MOTION = {
    **{"x": ("position", "x"), "x rate": ("velocity", "x")},
    **{"y": ("position", "y"), "y rate": ("velocity", "y")},
    **{"rotation": ("rotation", None), "rotation rate": ("spin", None)},
}


def _outputs_of(solution, part: Any) -> list[tuple[str, Output]]:
    """Outputs of a part of a scene that its columns have, with their names."""
    if isinstance(part, Body):
        part = part.centre
    if isinstance(part, Node | BeamPlace):
        columns = dict(_MOTION)
        if isinstance(part, BeamPlace):
            columns |= {name: (name, None) for name in "NQM"}
        elif _is_supported(solution, part):
            columns["reaction"] = "reaction", None
        return [(name, Output(kind, part, i)) for name, (kind, i) in columns.items()]
    expected = "a node, a body, a place such as beam.at(0.5), a joint, a rope, a spring, a contact"
    ok = is_gear(part) or isinstance(part, Joint | ForceBetween | Contact)
    require(ok, "nodes", part, f"{expected} or a gear")
    known = quantities_of(part)
    if isinstance(part, Joint):
        known = {name: known[name] for name in known if name != "spin" and not lack(part, name)}
    return [(name.replace("_", " "), Output(name, part)) for name in known]


def _is_supported(solution, node: Node) -> bool:
    """Whether a support holds or drives a node at the end of a solution."""
    constraints = solution.end.constraints
    return any(node.number == number for number, _ in (*constraints.fixed, *constraints.driven))


def _values(solution, output: Output) -> dict[str, tuple[np.ndarray, str]]:
    """Columns (n,) of an output by components, with units; of a beam by arc lengths."""
    rows = solution.value(output)
    if rows.ndim == 1:
        return {"": (rows, output.unit)}
    if isinstance(output.of, Beam):
        names = [f"at {s:.6g}" for s in solution.resultants(output.of).s]
        return {name: (column, output.unit) for name, column in zip(names, rows.T, strict=True)}
    parts = {name: replace(output, component=name) for name in output.components}
    pairs = zip(parts.items(), rows.T, strict=True)
    return {name: (column, part.unit) for (name, part), column in pairs}
