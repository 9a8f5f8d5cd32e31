"""Gaps of contacts in given configurations, and where their recorded forces are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping

import numpy as np

from fx_beam.scene.beam import Beam, Node
from fx_beam.scene.contacts import Contact, arc_of, nearest

#: Displacements (n, nodes, 3) of nodes by their numbers, in n rows.
Moved = Callable[[np.ndarray], np.ndarray]
#: Gaps (n, m), and directions (n, m, 2) to the free side.
GapsAndNormals = tuple[np.ndarray, np.ndarray]

# Distances of points and nodes, in all rows, that are looked at together.
_AT_ONCE = 100_000
# Distance of the ends of a member, relative to its size, at which it is closed.
_CLOSED = 1e-9


def nodes_of(nodes_of_beam: Mapping[str, np.ndarray], target: Node | Beam) -> np.ndarray:
    """Numbers (m,) of a node, or of all nodes of a beam, along it."""
    return nodes_of_beam[target.name] if isinstance(target, Beam) else np.array([target.number])


def columns_of(contacts: Iterable[Contact]) -> dict[int, slice]:
    """Columns of recorded forces by the number of a contact; contacts of members come last."""
    columns, end = dict[int, slice](), 0
    for contact in sorted(contacts, key=lambda contact: isinstance(contact.shape, Beam)):
        first, end = end, end + len(contact.points.lengths)
        columns[contact.number] = slice(first, end)
    return columns


def gaps_and_normals(
    contact: Contact, X: np.ndarray, nodes_of_beam: Mapping[str, np.ndarray], moved: Moved
) -> GapsAndNormals:
    """Gaps of the points of a contact, for reference positions X (nodes, 2) and displacements."""
    shape, nodes = contact.shape, nodes_of(nodes_of_beam, contact.target)
    points = X[nodes] + moved(nodes)[..., :2]
    if isinstance(shape, Beam):
        member_nodes = nodes_of_beam[shape.name]
        return _from_member(contact, points, X[member_nodes], moved(member_nodes)[..., :2])
    arms = contact.points.of(points) - shape.origin
    psi = np.zeros(len(arms))
    if shape.carrier is not None:
        x, y, psi = moved(np.array([shape.carrier.number]))[:, 0].T
        arms = arms - np.column_stack([x, y])[:, None]
    distances, directions = shape.seen(arms, psi[:, None])
    return distances - contact.radius, directions


def _from_member(
    contact: Contact, points: np.ndarray, X: np.ndarray, moved: np.ndarray
) -> GapsAndNormals:
    """Gaps from a member, for the positions (n, m, 2) of points that touch it."""
    positions, arc = X + moved, arc_of(X) if contact.shape is contact.target else None
    closed = bool(abs(positions[:, 0] - positions[:, -1]).max() <= _CLOSED * np.ptp(X))
    rows = max(1, _AT_ONCE // (points.shape[1] * len(X)))
    parts = [
        nearest(points[k : k + rows], positions[k : k + rows], contact.apart, arc, closed)
        for k in range(0, len(points), rows)
    ]
    distance, _, point = (np.concatenate(part) for part in zip(*parts, strict=True))
    directions = (points - point) / np.maximum(distance, 1e-300)[..., None]
    return distance - contact.radii, directions
