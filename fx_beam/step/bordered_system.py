"""The linear system without what slides on beams, which borders it (c/bordering_rows.h)."""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse

from fx_beam.coupling.column_map import nested_solution


def without_border(
    A: scipy.sparse.csr_matrix, entries: scipy.sparse.coo_matrix, border: dict[str, Any]
) -> scipy.sparse.csr_matrix:
    """The system (n, n) of A (n, n) and the `entries` (n + m, n + m) of what borders it.

    Columns of sliding nodes, and forces on them, are eliminated: the pivots of the `border` (tables
    of tables.h) are 1 or -1, and what is left couples slides with the nodes near to them.
    """
    n, size = A.shape[0], entries.shape[0]
    A = scipy.sparse.csr_matrix(A)
    A.resize((size, size))
    # What borders A though it is no column of a node comes to its place among the unknowns.
    place, last_places = np.arange(size), n + border["bordered_row"]
    place[border["bordered_unknown"]], place[last_places] = last_places, border["bordered_unknown"]
    system = (A + entries).tocsr()[place][:, place]
    equations = system[n + border["pivot"]]
    pivots = equations[:, n:].diagonal()
    equations = scipy.sparse.diags(1 / pivots) @ equations
    # A node depends on those that carry its beam, a force on columns.
    nested = scipy.sparse.identity(size - n) - equations[:, n:]
    solution = nested_solution(nested.tocsr(), equations[:, :n])
    return (system[:n, :n] - system[:n, n:] @ solution).tocsr()
