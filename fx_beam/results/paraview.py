"""Solutions as files for ParaView: a collection (PVD) of unstructured grids (VTU)."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import numpy as np

from .fields import RESULTANTS, along, nodes_of_elements
from .files import replacing, writable
from .grids import Grid, node_fields, write_collection


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
    folder = path.with_suffix("")
    made = not folder.exists()
    folder.mkdir(exist_ok=True)
    try:
        _write(solution, path, folder)
    except BaseException:
        if made:
            folder.rmdir()
        raise


def _write(solution, path: Path, folder: Path) -> None:
    """Write all grids of a folder, and their collection; all replace earlier ones at the end."""
    names, count = [*solution.beams], [beam.elements for beam in solution.beams.values()]
    nodes = np.concatenate([nodes_of_elements(solution, name) for name in names])
    grid = Grid(solution.X[nodes], np.repeat(np.arange(len(count)), count))
    fields = _along(solution, nodes.shape[1])
    v = solution.v if solution.has_rates else None
    # A static path may come to a load factor again: its rows are counted.
    times = solution.t if (np.diff(solution.t) > 0).all() else np.arange(len(solution.t))
    files = [folder / f"{folder.name}_{k:05d}.vtu" for k in range(len(times))]
    with ExitStack() as new:
        for k, file in enumerate(files):
            rates = None if v is None else v[k][nodes.ravel()]
            values = {kind: of[k] for kind, of in fields.items()}
            values = node_fields(solution.q[k][nodes.ravel()], rates) | values
            grid.write(new.enter_context(replacing(file, durable=False)), values)
        collection = new.enter_context(replacing(path, durable=False))
        write_collection(
            collection, times.tolist(), [f"{folder.name}/{file.name}" for file in files]
        )


def _along(solution, nodes: int) -> dict[str, np.ndarray]:
    """Resultants and internal variables (n, points) at so many nodes of each element.

    Those that a beam lacks are zero there.
    """
    rows, places = range(len(solution.t)), np.linspace(0, 1, nodes)
    internal = (name for own in solution.variables_of_beam.values() for name in own)
    return {
        kind: np.concatenate(
            [along(solution, name, kind, rows, places) for name in solution.beams], axis=1
        ).reshape(len(solution.t), -1)
        for kind in dict.fromkeys([*RESULTANTS, *internal])
    }
