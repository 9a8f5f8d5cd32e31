"""Elements whose rows one process writes."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from .fields import at_ends
from .files import replacing
from .grids import Fields, Grid, node_fields


class Piece:
    """Elements by the places (n, 2) of their nodes, and their nodes (elements, degree + 1).

    `beam` (elements,) are the numbers of their beams.
    """

    def __init__(self, X: np.ndarray, nodes: np.ndarray, beam: np.ndarray):
        self._grid, self._nodes = Grid(X[nodes], beam), nodes.ravel()

    def write(
        self, path: Path, q: np.ndarray, v: np.ndarray | None, along: Mapping[str, np.ndarray]
    ) -> Fields:
        """Write a row: q and v (n, 3) of its nodes, others (elements, degree) at Gauss points."""
        rates = None if v is None else v[self._nodes]
        fields = node_fields(q[self._nodes], rates)
        fields |= {name: at_ends(values).ravel() for name, values in along.items()}
        with replacing(path, durable=False) as new:
            return self._grid.write(new, fields)

    def destroy(self) -> None:
        """Nothing: its memory is Python's."""
