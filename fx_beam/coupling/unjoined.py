"""Ends of beams that lie on another beam without being joined to it, as in a drawing of lines."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np

from fx_beam.errors import warn_once
from fx_beam.fem.mesh import Mesh
from fx_beam.fem.sparsity import connected_parts
from fx_beam.scene.joints import GROUND
from fx_beam.scene.scene import Scene

# An end lies on a beam if it is so near to it, relative to the scene: coordinates are rounded.
_NEAR = 1e-5
# So many are named.
_NAMED = 3


def warn_of_unjoined(scene: Scene, mesh: Mesh) -> None:
    """Warn of beams that end on another one without a joint, a contact or a line between them."""
    if ends := unjoined_ends(scene, mesh):
        warn_once(
            f"not joined: {ends}. Beams are joined by common nodes, such as beam.end and "
            "beam.node(fraction) as a point of another one, or by joints; a joint, a contact or a "
            "line between them says that they are apart on purpose"
        )


def unjoined_ends(scene: Scene, mesh: Mesh) -> str:
    """Beams that end on another one with nothing between them, in words; empty without any."""
    parts, held = _connected(scene, mesh)
    ends_of = [(beam.start.number, beam.end.number) for beam in scene.beams]
    ends = np.setdiff1d(ends_of, held)
    found = _touching(scene, mesh, ends, parts) if len(ends) else []
    left = _unintended(scene, mesh, parts, ends_of, found)
    more = f", and {len(left) - _NAMED} more" if len(left) > _NAMED else ""
    return "; ".join(left[:_NAMED]) + more


def _touching(
    scene: Scene, mesh: Mesh, ends: np.ndarray, parts: np.ndarray
) -> list[tuple[int, int]]:
    """Of `ends` those that lie on a beam whose nodes there are in other parts, and its number."""
    from scipy.spatial import cKDTree

    X, degree = _places_on_lines(scene, mesh), mesh.elements.shape[1] - 1
    first, second = mesh.elements[:, :-1].ravel(), mesh.elements[:, 1:].ravel()
    ways = X[second] - X[first]
    lengths = np.hypot(*ways.T)
    near = _NEAR * mesh.size + _rises(scene, mesh, first, second)
    close = cKDTree(X[ends]).query_ball_point(X[first] + ways / 2, lengths / 2 + near)
    piece = np.repeat(np.arange(len(first)), [len(numbers) for numbers in close])
    node = ends[np.concatenate(close).astype(int)]
    part = parts[node]
    is_other = (part != parts[first[piece]]) & (part != parts[second[piece]])
    piece, node = piece[is_other], node[is_other]
    arms, along = X[node] - X[first[piece]], ways[piece] / lengths[piece, None]
    s = np.clip((arms * along).sum(axis=1), 0, lengths[piece])
    lies_on = np.hypot(*(arms - s[:, None] * along).T) <= near[piece]
    beam = mesh.beam_of_cell[piece[lies_on] // degree]
    return [*dict.fromkeys(zip(node[lies_on].tolist(), beam.tolist(), strict=True))]


def _rises(scene: Scene, mesh: Mesh, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Rise (n,) of curved beams above chords c: sqrt(3 c e / 8), if the arc is longer by e."""
    chords, degree = np.hypot(*(mesh.X[second] - mesh.X[first]).T), mesh.elements.shape[1] - 1
    last = np.cumsum([len(beam.s) for beam in scene.beams])[:-1] - 1
    arcs = np.delete(np.diff(np.concatenate([beam.s for beam in scene.beams])), last)
    longer = (arcs - chords.reshape(-1, degree).sum(axis=1)) / degree
    return np.sqrt(3 / 8 * chords * np.repeat(np.clip(longer, 0, None), degree))


def _places_on_lines(scene: Scene, mesh: Mesh) -> np.ndarray:
    """Places (nodes, 2) of nodes; those of an axis with an offset on the line of its beam."""
    X = mesh.X.copy()
    for beam, nodes in zip(scene.beams, mesh.nodes, strict=True):
        if beam.carriers:
            line, places = X[[node.number for node in beam.carriers]], np.arange(len(nodes))
            X[nodes] = np.stack([np.interp(places, places[:: beam.degree], x) for x in line.T], 1)
    return X


def _unintended(
    scene: Scene,
    mesh: Mesh,
    parts: np.ndarray,
    ends_of: list[tuple[int, int]],
    found: list[tuple[int, int]],
) -> list[str]:
    """In words the nodes and beams that nothing connects, of those that touch."""
    beams_at: dict[int, list[int]] = {}
    for i, ends in enumerate(ends_of):
        for node in {*ends}:
            beams_at.setdefault(node, []).append(i)
    left = dict[tuple, str]()
    for node, i in found:
        ending = beams_at[node]
        mine = parts[[node, *(len(mesh.X) + k for k in ending)]]
        others = parts[[*mesh.nodes[i], len(mesh.X) + i]]
        if i in ending or np.isin(mine, others).any():
            continue
        beam, other = scene.beams[ending[0]], scene.beams[i]
        (x, y), pair = mesh.X[node], sorted((ending[0], i))
        text = f"beam {beam.name!r} ends at ({x:g}, {y:g}) on beam {other.name!r}"
        left.setdefault((*pair, f"{x:g}, {y:g}"), text)
    return [*left.values()]


def _connected(scene: Scene, mesh: Mesh) -> tuple[np.ndarray, list[int]]:
    """The part to which each node, and then each beam, belongs; nodes that are held.

    Parts are connected by joints, contacts and lines, not by beams.
    """
    held = {node for node, i in scene.fixed if i == 0 and (node, 1) in scene.fixed}
    for joint in scene.joints:
        if GROUND in (joint.a, joint.b):
            held |= {joint.a.number, joint.b.number}
    pairs = np.reshape([pair for pair in links(scene, mesh) if min(pair) >= 0], (-1, 2))
    return connected_parts(pairs.astype(int).T, len(mesh.X) + len(scene.beams)), [*held]


def links(scene: Scene, mesh: Mesh) -> list[tuple[int, int]]:
    """Pairs that joints, contacts and lines connect: nodes, and beams behind; -1, the ground."""
    beams = {id(beam): len(mesh.X) + i for i, beam in enumerate(scene.beams)}
    pairs: list[tuple[Any, Any]]
    pairs = [(getattr(joint, "beam", joint.a), joint.b) for joint in scene.joints]
    pairs += [(gear.joint_b.b, gear.joint_a.a) for gear in scene.gears]
    for contact in scene.contacts:
        pairs.append((contact.target, getattr(contact.shape, "carrier", contact.shape)))
    line: Any
    for line in scene.forces_between:
        pairs += pairwise((line.target, GROUND) if line.to_ground else line.points)
    # What has no number, as a fixed point, is on the ground.
    numbers = ([beams.get(id(x), getattr(x, "number", -1)) for x in pair] for pair in pairs)
    return [(a, b) for a, b in numbers]
