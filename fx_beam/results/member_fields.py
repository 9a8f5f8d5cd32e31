"""Fields along the members: what colours a shape, and files of them for ParaView."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from xml.etree import ElementTree as xml

import numpy as np

from fx_beam.scene.beam import arc_lengths, gauss_rule, lagrange, lagrange_and_slopes
from fx_beam.scene.law import Energy
from fx_beam.scene.loads import NAMES
from fx_beam.scene.parameters import replaced
from fx_beam.symbolic import ufl

from .export import replacing_all, writable
from .records import BeamBalance, BeamResultants, BeamStress, SectionForces

# -- Fields along the members: what colours a shape and is written for ParaView -----------------


RESULTANTS = ("N", "Q", "M")
_STIFFNESSES = ("EA", "GA", "EI")
#: What can be had along a member, and its unit.
QUANTITIES = {
    **{"N": "N", "Q": "N", "M": "N m", "stress": "Pa"},
    **{"strain energy": "J/m", "speed": "m/s"},
}


def at_ends(values: np.ndarray) -> np.ndarray:
    """Values (..., degree + 1) at the nodes of elements of those (..., degree) at Gauss points."""
    return _through(values, np.linspace(0, 1, values.shape[-1] + 1))


def _through(values: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values (..., points) of polynomials through those (..., degree) at Gauss points.

    The same to the last digit however the values lie in memory.
    """
    weights = lagrange(gauss_rule(values.shape[-1])[0], points).T
    return sum(values[..., k, None] * weight for k, weight in enumerate(weights))


def along_all(
    solution, quantities: Iterable[str], rows, points: np.ndarray
) -> dict[str, np.ndarray]:
    """Values (rows, elements, points) of quantities or internal variables, at points in [0, 1].

    N, Q and M follow from the balance of elements, where that is known. Others, but for the speed,
    are polynomials through the values at the Gauss points, and may jump. The stress is the larger
    one of both edges.
    """
    quantities, rows, fields = [*quantities], list(rows), dict[str, np.ndarray]()
    if not {*RESULTANTS, "stress"}.isdisjoint(quantities):
        try:
            balance, gauss = _as_one(solution, rows)
        except ValueError:  # the balance is not known
            known = {
                name: _through(_at_points(solution, name, rows), points) for name in RESULTANTS
            }
        else:
            known = dict(zip(RESULTANTS, balance.in_elements(gauss, points), strict=True))
        fields = {name: known[name] for name in RESULTANTS if name in quantities}
        if "stress" in quantities:
            fields["stress"] = _stresses(solution, known, points)
    for name in quantities:
        if name == "speed":
            nodes = nodes_of_elements(solution)
            values = lagrange(np.linspace(0, 1, nodes.shape[1]), points)
            v = np.einsum("pn,renc->repc", values, solution.recorded("v")[rows][:, nodes, :2])
            fields[name] = np.hypot(v[..., 0], v[..., 1])
        elif name not in fields:
            is_energy = name == "strain energy"
            values = (
                energy_density(solution, rows) if is_energy else _at_points(solution, name, rows)
            )
            fields[name] = _through(values, points)
    return {name: fields[name] for name in quantities}


def _as_one(solution, rows: list[int]) -> tuple[BeamBalance, np.ndarray]:
    """The balance of all beams, as of one behind the other, and values at the Gauss points.

    ValueError if it is not known.
    """
    resultants = [solution.resultants(name) for name in solution.beams]
    balances = [beam_resultants.balanced() for beam_resultants in resultants]
    parts = [np.stack([r.N[rows], r.Q[rows], r.M[rows]], axis=-1) for r in resultants]
    balance = BeamBalance.of_all([balance.in_rows(rows) for balance in balances])
    return balance, np.concatenate(parts, axis=1)


def _stresses(solution, known: dict[str, np.ndarray], points: np.ndarray) -> np.ndarray:
    """Larger stresses of both edges, of N, Q and M (rows, elements, points)."""
    end, values = 0, np.empty_like(known["N"])
    for beam in solution.beams.values():
        cells = slice(end, end := end + beam.elements)
        forces = (known[name][:, cells].reshape(len(values), -1) for name in RESULTANTS)
        along = SectionForces(arc_lengths(beam, points).ravel(), *forces)
        values[:, cells] = BeamStress(beam, along).largest.reshape(values[:, cells].shape)
    return values


def in_rows(resultants: BeamResultants, rows: list[int]) -> BeamResultants:
    """Resultants in some rows alone; ValueError if the balance of elements is not known."""
    balance = resultants.balanced().in_rows(rows)
    N, Q, M = (getattr(resultants, name)[rows] for name in RESULTANTS)
    return BeamResultants(resultants.s, N, Q, M, balance)


def _at_points(solution, quantity: str, rows: list[int]) -> np.ndarray:
    """Resultants or internal variables (rows, elements, degree): zero on a beam that lacks them."""
    beam_values = []
    for name, beam in solution.beams.items():
        if quantity in RESULTANTS:
            values = getattr(solution.resultants(name), quantity)
        else:
            values = solution.variables_of_beam.get(name, {}).get(quantity)
        shape = len(rows), beam.elements, beam.degree
        beam_values.append(np.zeros(shape) if values is None else values[rows].reshape(shape))
    return np.concatenate(beam_values, axis=1)


def energy_density(solution, rows: list[int]) -> np.ndarray:
    """Stored energy per length (rows, elements, degree) of beams at their Gauss points [J/m]."""
    if solution.has_own_energy:
        raise ValueError(
            "the strain energy along a member is not known: resultants, strains or energy are your "
            "own, not those of its section. Take N, Q, M or speed"
        )
    if any(beam.section is None for beam in solution.beams.values()):
        raise ValueError(
            "the strain energy along a member needs its section, which a saved file does not hold; "
            "take the solution as simulate gave it, or N, Q, M or speed"
        )
    natural = np.stack([_at_points(solution, name, rows) for name in NAMES.values()])
    q = solution.recorded("q")[rows]
    strains = _strains(solution, nodes_of_elements(solution), q) - natural
    names, values = solution.names_of_parameters, solution.parameters[rows].tolist()
    parameters = [dict(zip(names, row_points, strict=True)) for row_points in values]
    density, end = np.empty(strains.shape[1:]), 0
    constant: dict[int, list[np.ndarray]] = {}  # stiffnesses by sections, empty where they vary
    for beam in solution.beams.values():
        first, end = end, end + beam.elements
        cells, section = slice(first, end), beam.section
        beam_strains, energy = strains[:, :, cells], section.strain_energy
        if energy is None:
            if (stiffness := constant.get(id(section))) is None:
                kinds = () if any(map(section.varies, _STIFFNESSES)) else _STIFFNESSES
                stiffness = [section.values(kind, np.zeros(1)) for kind in kinds]
                constant[id(section)] = stiffness
            if not stiffness:
                fractions = arc_lengths(beam, gauss_rule(beam.degree)[0]) / beam.length
                stiffness = [section.values(kind, fractions) for kind in _STIFFNESSES]
            parts = zip(stiffness, beam_strains**2, strict=True)
            density[:, cells] = sum(factor * squares for factor, squares in parts) / 2
            continue
        variables = solution.variables_of_beam.get(beam.name, {})
        internal = [variable for name, variable in variables.items() if name not in NAMES.values()]
        columns = [*beam_strains.reshape(3, -1), *(variable[rows].ravel() for variable in internal)]
        points = np.column_stack(columns).reshape(len(rows), -1, len(columns))
        pairs = zip(parameters, points, strict=True)
        energies = [_stored(energy, values, *x) for values, row_points in pairs for x in row_points]
        density[:, cells] = np.reshape(energies, density[:, cells].shape)
    return density


# In NumPy, beside laws/kinematics.py: pictures are also drawn of solutions that come from
# another process or a copy, without the compiled forms.
def _strains(solution, nodes: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Axial strain, shear strain and curvature (3, rows, elements, degree) (eqs 9 and 10)."""
    count = nodes.shape[1]
    values, slopes = lagrange_and_slopes(np.linspace(0, 1, count), gauss_rule(count - 1)[0])
    X, q = solution.X[nodes], q[:, nodes]
    (X, Y), (u, v, psi) = np.moveaxis(X, -1, 0), np.moveaxis(q, -1, 0)
    x, y, du, dv, curvature = (f @ slopes.T for f in (X, Y, u, v, psi))
    J, half = np.hypot(x, y), psi @ values.T / 2
    c, s = np.cos(half), np.sin(half)
    turn_x, turn_y = -2 * s * (s * x + c * y) / J, 2 * s * (c * x - s * y) / J
    tx, ty = x / J + turn_x, y / J + turn_y
    Ex, Ey = du / J - turn_x, dv / J - turn_y
    return np.stack([Ex * tx + Ey * ty, Ey * tx - Ex * ty, curvature / J])


def nodes_of_elements(solution) -> np.ndarray:
    """Numbers (elements, degree + 1) of the nodes of each element, in order along its beam."""
    beam_nodes = [np.empty((0, 2), dtype=int)]
    for name, beam in solution.beams.items():
        first = beam.degree * np.arange(beam.elements)[:, None]
        beam_nodes.append(solution.nodes_of_beam[name][first + np.arange(beam.degree + 1)])
    return np.concatenate(beam_nodes[1:] or beam_nodes)


def _stored(energy: Energy, parameters: dict[str, float], eps, gamma, kappa, *a) -> float:
    """Stored energy per length of strains and internal variables [J/m]."""
    numbers = [ufl.as_ufl(float(x)) for x in (eps, gamma, kappa, *a)]
    density = energy(*numbers[:3], *([ufl.as_vector(numbers[3:])] if a else []))
    return float(replaced(density, parameters)(()))


# -- Files for ParaView: grids of elements with fields (VTU), and their collection (PVD) --------


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
