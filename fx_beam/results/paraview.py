"""Files for ParaView: grids of elements with fields (VTU), and their collection (PVD)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from xml.etree import ElementTree as xml

import numpy as np

from .fields import RESULTANTS, along_all, nodes_of_elements
from .files import replacing_all, writable

#: VTK's numbers of the line, and of the curves of degree 2 and 3.
_CELLS = {1: 3, 2: 21, 3: 35}
# Names of the motion of nodes in the plane and of their rotations, and of their rates.
_MOTION, _RATES = ("displacement", "rotation"), ("velocity", "spin")
_TYPES = {"f": "Float64", "i": "Int64", "u": "UInt8"}
# About how many numbers of each field are made ready at once.
_NUMBERS = 100_000
_GRID = {"type": "UnstructuredGrid", "version": "1.0"}
_GRID |= {"byte_order": "LittleEndian", "header_type": "UInt64"}


class Grid:
    """Elements, each with nodes of its own, at which fields may jump.

    `X` (n, 2) are the positions of nodes, `nodes` (elements, degree + 1) those of the elements in
    order along each, `beam` (elements,) the numbers of their beams.
    """

    def __init__(self, X: np.ndarray, nodes: np.ndarray, beam: np.ndarray):
        self._nodes, (self._count, node_count) = nodes.ravel(), nodes.shape
        self._points, self._beam = _in_space(X[self._nodes]), beam.astype(int)
        # The ends of an element come before the nodes inside it.
        order = np.r_[0, node_count - 1, 1 : node_count - 1]
        first = node_count * np.arange(self._count)[:, None]
        self._cells = {
            "connectivity": (first + order).ravel(),
            "offsets": first.ravel() + node_count,
            "types": np.full(self._count, _CELLS[node_count - 1], dtype=np.uint8),
        }

    def write(
        self,
        files: Sequence[str],
        q: np.ndarray,
        v: np.ndarray | None,
        along: Mapping[str, np.ndarray],
    ) -> None:
        """Write rows, one a file: q and v (rows, n, 3) of nodes, others along the elements.

        These have shape (rows, elements, degree + 1). Arrays follow each other as they are in
        memory, behind the text that says where each begins.
        """
        step = max(1, _NUMBERS // len(self._nodes))
        for parts in (slice(first, first + step) for first in range(0, len(files), step)):
            fields = dict[str, np.ndarray]()
            for motion, (motion_name, turn_name) in (q, _MOTION), (v, _RATES):
                if motion is not None:
                    rows = motion[parts][:, self._nodes]
                    fields |= {motion_name: _in_space(rows[..., :2]), turn_name: rows[..., 2]}
            for name, values in along.items():
                fields[name] = values[parts].reshape(-1, len(self._nodes))
            head, tail = self._around({name: values[0] for name, values in fields.items()})
            columns = list[np.ndarray]()
            for values in fields.values():
                flat = values.reshape(len(values), -1)
                size = np.array(8 * flat.shape[1], "<u8").view("<f8")
                columns += [np.broadcast_to(size, (len(flat), 1)), flat.astype("<f8", copy=False)]
            for file, row in zip(files[parts], np.concatenate(columns, axis=1), strict=True):
                with open(file, "wb") as opened:
                    opened.write(b"".join([head, row.tobytes(), tail]))

    def _around(self, fields: Mapping[str, np.ndarray]) -> tuple[bytes, bytes]:
        """Bytes before and behind the fields in the file of a row."""
        root = xml.Element("VTKFile", _GRID)
        sizes = {"NumberOfPoints": str(len(self._points)), "NumberOfCells": str(self._count)}
        piece = xml.SubElement(xml.SubElement(root, "UnstructuredGrid"), "Piece", sizes)
        parts: dict[str, Mapping[str, np.ndarray]] = {
            "Points": {"Points": self._points},
            "Cells": self._cells,
            "PointData": fields,
            "CellData": {"beam": self._beam},
        }
        blocks, offset = dict[str, bytes](), 0
        for part, arrays in parts.items():
            parent, blocks[part] = xml.SubElement(piece, part), b""
            for name, values in arrays.items():
                kind = {"type": _TYPES[values.dtype.kind], "Name": name}
                kind |= {"format": "appended", "offset": str(offset)}
                kind |= {"NumberOfComponents": str(values[0].size)}
                xml.SubElement(parent, "DataArray", kind)
                little = np.ascontiguousarray(values, values.dtype.newbyteorder("<"))
                blocks[part] += np.array(little.nbytes, "<u8").tobytes() + little.tobytes()
                offset += 8 + little.nbytes
        text = xml.tostring(root).removesuffix(b"</VTKFile>")
        head = text + b'<AppendedData encoding="raw">_' + blocks["Points"] + blocks["Cells"]
        return head, blocks["CellData"] + b"</AppendedData></VTKFile>"


def write_collection(path: Path | str, times: Iterable[float], names: Iterable[str]) -> None:
    """Write the file that gives the grid of each row, in a file by its name, its time."""
    root = xml.Element("VTKFile", type="Collection", version="1.0")
    collection = xml.SubElement(root, "Collection")
    for t, name in zip(times, names, strict=True):
        row = {"timestep": repr(float(t)), "part": "0", "file": name}
        xml.SubElement(collection, "DataSet", row)
    xml.ElementTree(root).write(path)


def _in_space(plane: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) of vectors (..., 2) in the plane."""
    return np.concatenate([plane, np.zeros_like(plane[..., :1])], axis=-1)


def to_paraview(solution, path) -> None:
    """Write the motion for ParaView: one grid a row, in a folder beside the file.

    The grids are those of the reference configuration; ParaView's filter "Warp By Vector" shows
    the deformed one. The elements of a beam have nodes of their own, so that resultants may jump
    between them. With the points go displacement [m], rotation [rad], velocity [m/s] and spin
    [rad/s], where they were recorded, the resultants N [N], Q [N] and M [N m] from
    the balance of elements, as `BeamResultants.at` has them, and internal variables by
    their names, zero on beams without; with the cells goes the number of their beam.

    Parameters
    ----------
    solution : Solution
        What is written.
    path : str or path
        File to write, such as "run.pvd"; its grids are in the folder "run".

    Raises
    ------
    ValueError
        For another ending, or a motion that was not recorded.
    """
    path = writable(path, ("pvd",))
    solution.recorded("q")
    if not solution.beams:
        raise ValueError("the solution has no beams, of which the files for ParaView are made")
    count = [beam.elements for beam in solution.beams.values()]
    nodes = nodes_of_elements(solution)
    grid = Grid(solution.X, nodes, np.repeat(np.arange(len(count)), count))
    # Internal variables that a beam lacks are zero there.
    internal = (name for variables in solution.variables_of_beam.values() for name in variables)
    rows, points = range(len(solution.t)), np.linspace(0.0, 1.0, nodes.shape[1])
    kinds = dict.fromkeys([*RESULTANTS, *internal])
    fields = along_all(solution, kinds, rows, points)
    # A static path may come to a load factor again: its rows are counted.
    times = solution.t if (np.diff(solution.t) > 0).all() else np.arange(len(solution.t))
    folder = path.with_suffix("")
    files = [folder / f"{folder.name}_{k:05d}.vtu" for k in rows]
    is_new_folder = not folder.exists()
    folder.mkdir(exist_ok=True)
    # All files replace earlier ones at the end.
    with ExitStack() as new:
        if is_new_folder:
            new.push(lambda error, *_: folder.rmdir() if error else None)
        *new_files, collection = new.enter_context(replacing_all([*files, path]))
        grid.write(new_files, solution.q, solution.v if solution.has_rates else None, fields)
        names = [f"{folder.name}/{file.name}" for file in files]
        write_collection(collection, times.tolist(), names)
