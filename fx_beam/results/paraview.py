"""Solutions as files for ParaView: a collection (PVD) of unstructured grids (VTU)."""

from __future__ import annotations

import base64
from contextlib import ExitStack
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as xml

import numpy as np

from .fields import RESULTANTS, along, nodes_of_elements
from .files import replacing, writable

#: VTK's numbers of the line, and of the curves of degree 2 and 3.
_CELLS = {1: 3, 2: 21, 3: 35}
_TYPES = {"f": "Float64", "i": "Int64", "u": "UInt8"}


def to_paraview(solution, path) -> None:
    """Write the motion for ParaView: one grid a row, in a folder beside the file.

    The grids are those of the reference configuration; ParaView's filter "Warp By Vector" shows
    the deformed one. The elements of a beam have nodes of their own, so that resultants may jump
    between them. With the points go displacement [m], rotation [rad], velocity [m/s] and spin
    [rad/s], where they were recorded, the resultants N [N], Q [N] and M [N m], as
    `Solution.resultants` has them, and internal variables by their names, zero on beams without;
    with the cells goes the number of their beam.

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
    folder, grid = path.with_suffix(""), _Grid(solution)
    made = not folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        _write(grid, path, folder)
    except BaseException:
        if made:
            folder.rmdir()
        raise


def _write(grid: _Grid, path: Path, folder: Path) -> None:
    """Write all grids of a folder, and their collection; all replace earlier ones at the end."""
    solution = grid.solution
    # A static path may come to a load factor again: its rows are counted.
    times = solution.t if (np.diff(solution.t) > 0).all() else np.arange(len(solution.t))
    root = xml.Element("VTKFile", type="Collection", version="1.0")
    collection = xml.SubElement(root, "Collection")
    with ExitStack() as files:
        for k, t in enumerate(times):
            file = folder / f"{folder.name}_{k:05d}.vtu"
            new = files.enter_context(replacing(file, durable=False))
            xml.ElementTree(grid.row(k)).write(new)
            name = f"{folder.name}/{file.name}"
            xml.SubElement(collection, "DataSet", timestep=repr(float(t)), file=name)
        xml.ElementTree(root).write(files.enter_context(replacing(path, durable=False)))


class _Grid:
    """The elements of all beams, each with nodes of its own, and the fields on them."""

    def __init__(self, solution: Any):
        beams = solution.beams.values()
        self.degree = next(iter(beams)).degree
        count = np.array([beam.elements for beam in beams])
        #: Nodes of the solution at the points, element by element.
        self.nodes = np.concatenate(
            [nodes_of_elements(solution, name).ravel() for name in solution.beams]
        )
        self.beam = np.repeat(np.arange(len(count)), count)
        self.solution = solution
        rows, places = range(len(solution.t)), np.linspace(0, 1, self.degree + 1)
        internal = (name for own in solution.variables_of_beam.values() for name in own)
        #: Stress resultants and internal variables; those that a beam lacks are zero there.
        self.along = {
            kind: np.concatenate(
                [along(solution, name, kind, rows, places) for name in solution.beams], axis=1
            ).reshape(len(solution.t), -1)
            for kind in dict.fromkeys([*RESULTANTS, *internal])
        }

    def row(self, k: int) -> xml.Element:
        """The grid with the fields of one row."""
        points, cells = len(self.nodes), len(self.beam)
        root = xml.Element(
            "VTKFile", type="UnstructuredGrid", version="1.0", byte_order="LittleEndian"
        )
        piece = xml.SubElement(
            xml.SubElement(root, "UnstructuredGrid"),
            "Piece",
            NumberOfPoints=str(points),
            NumberOfCells=str(cells),
        )
        _array(xml.SubElement(piece, "Points"), "Points", _in_space(self.solution.X[self.nodes]))
        topology = xml.SubElement(piece, "Cells")
        # The ends of an element come before the nodes inside it.
        order = np.r_[0, self.degree, 1 : self.degree]
        of_element = (self.degree + 1) * np.arange(cells)[:, None]
        _array(topology, "connectivity", (of_element + order).ravel())
        _array(topology, "offsets", of_element.ravel() + self.degree + 1)
        _array(topology, "types", np.full(cells, _CELLS[self.degree], dtype=np.uint8))
        data = xml.SubElement(piece, "PointData")
        for name, values in self._fields(k).items():
            _array(data, name, values)
        _array(xml.SubElement(piece, "CellData"), "beam", self.beam)
        return root

    def _fields(self, k: int) -> dict[str, np.ndarray]:
        names = {"q": ("displacement", "rotation")}
        if self.solution.has_rates:
            names["v"] = "velocity", "spin"
        arrays: dict[str, np.ndarray] = {}
        for history, (vector, angle) in names.items():
            values = getattr(self.solution, history)[k][self.nodes]
            arrays |= {vector: _in_space(values[:, :2]), angle: values[:, 2]}
        return arrays | {kind: values[k] for kind, values in self.along.items()}


def _in_space(plane: np.ndarray) -> np.ndarray:
    """Vectors (n, 3) of vectors (n, 2) in the plane."""
    return np.column_stack([plane, np.zeros(len(plane))])


def _array(parent: xml.Element, name: str, values: np.ndarray) -> None:
    """An array, in base64 behind its number of bytes."""
    little = values.dtype.newbyteorder("<")
    raw = np.ascontiguousarray(values, dtype=little).tobytes()
    kind = {"type": _TYPES[values.dtype.kind], "Name": name, "format": "binary"}
    if values.ndim == 2:
        kind["NumberOfComponents"] = str(values.shape[1])
    element = xml.SubElement(parent, "DataArray", kind)
    element.text = base64.b64encode(np.array(len(raw), dtype="<u4").tobytes() + raw).decode()
