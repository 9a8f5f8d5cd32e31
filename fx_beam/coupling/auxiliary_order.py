"""The order of elimination of linear systems with auxiliary unknowns.

The pivots of an auxiliary unknown are 1. The pivot of another unknown is the stiffness and inertia
of all that follows it, as in the reduced tangent, if the auxiliary unknowns that depend on it are
eliminated before: from the leaves of the trees to their roots.
"""

from __future__ import annotations

import heapq

import numpy as np
import scipy.sparse


def auxiliary_fill_in(
    graph: scipy.sparse.csr_matrix, sizes: np.ndarray, dependent: np.ndarray, last: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions (n,) in an order of minimum degree, and the pattern of L + U: starts, columns.

    From a symmetric graph of n groups of unknowns with these sizes. Of the groups of `dependent`
    (2, m) the first contain auxiliary unknowns that depend on the second, and come before them;
    those of `last` come after all with which they are coupled.
    """
    n, (of, on) = graph.shape[0], dependent
    near = [set(row.tolist()) for row in np.split(graph.indices, graph.indptr[1:-1])]
    for k in range(n):
        near[k].discard(k)
    #: Groups on which those of auxiliary unknowns depend, and how many depend on each.
    needs: list[set[int]] = [set() for _ in range(n)]
    for auxiliary, other in zip(of.tolist(), on.tolist(), strict=True):
        if auxiliary != other:
            needs[auxiliary].add(other)
    for force in last.tolist():
        for k in near[force]:
            needs[k].add(force)
    waits = np.bincount([k for groups in needs for k in groups], minlength=n).tolist()
    weights = sizes.tolist()

    def degree(k: int) -> int:
        return sum([weights[j] for j in near[k]])

    ready = [(degree(k), k) for k in range(n) if not waits[k]]
    heapq.heapify(ready)
    position, above = np.full(n, -1), list[list[int]]()
    while ready:
        size, k = heapq.heappop(ready)
        if position[k] >= 0:
            continue
        if size != (now := degree(k)):
            heapq.heappush(ready, (now, k))
            continue
        position[k] = len(above)
        above.append(list(near[k]))
        for j in near[k]:
            near[j] |= near[k]
            near[j] -= {j, k}
        for j in needs[k]:
            waits[j] -= 1
        for j in near[k] | needs[k]:
            if not waits[j] and position[j] < 0:
                heapq.heappush(ready, (degree(j), j))
    counts = [len(row) for row in above]
    row = np.repeat(np.arange(n), counts)
    column = position[np.array([j for columns in above for j in columns], dtype=int)]
    each = np.arange(n)
    i, j = np.concatenate([row, column, each]), np.concatenate([column, row, each])
    pattern = scipy.sparse.csr_matrix((np.ones(len(i)), (i, j)), (n, n))
    pattern.sort_indices()
    return position, pattern.indptr, pattern.indices
