"""Parts of a scene with energies of their own, by which Newton's method judges (c/newton.h)."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from fx_beam.coupling.graph import Couplings
    from fx_beam.fem.mesh import Mesh

    from .model import Model

_Members = frozenset[int]
# An unknown that moves more members is judged by all: else the joints of a chain of n bodies would
# have n^2 members, and as many parts inside each other.
_MOST = 32


def part_tables(model: Model) -> dict[str, Any]:
    """``Parts`` of c/tables.h; none if there is only one.

    Nodes of the same beams are a part, others are one each; unknowns are one if they move nodes of
    the same. Light beams beside heavy ones are judged by themselves, what both share by both.
    """
    parts, node_parts = _parts_of_nodes(model.mesh)
    dof_parts = np.repeat(node_parts, 3)
    column_parts = _parts_of_columns(model.couplings, parts, dof_parts)
    if len(parts) < 2:
        return {}
    inner_parts = _parts_inside(parts)
    starts = np.cumsum([0, *map(len, inner_parts)])
    return {
        "count": len(parts),
        **_runs("dof", dof_parts),
        **_runs("column", column_parts),
        "inside_start": starts,
        "inside": np.concatenate(inner_parts),
    }


def _parts_of_nodes(mesh: Mesh) -> tuple[dict[_Members, int], np.ndarray]:
    """Numbers of parts by their members, and the part (nodes,) of each node.

    Members of a node are its beams; without any it is a member of its own.
    """
    nodes = np.concatenate([*mesh.nodes, np.empty(0, int)])
    beams = np.repeat(np.arange(len(mesh.nodes)), [*map(len, mesh.nodes)])
    shared = (np.bincount(nodes, minlength=len(mesh.X)) > 1)[nodes]
    member = -1 - np.arange(len(mesh.X))
    member[nodes[~shared]] = beams[~shared]
    node_beams: dict[int, list[int]] = {}
    for node, beam in zip(nodes[shared].tolist(), beams[shared].tolist(), strict=True):
        node_beams.setdefault(node, []).append(beam)
    parts, starts = dict[_Members, int](), _starts(member)
    numbers = [
        parts.setdefault(_Members(node_beams.get(node, [only])), len(parts))
        for node, only in zip(starts.tolist(), member[starts].tolist(), strict=True)
    ]
    return parts, np.repeat(np.array(numbers, int), np.diff(starts, append=len(member)))


def _parts_of_columns(
    couplings: Couplings, parts: dict[_Members, int], dof_parts: np.ndarray
) -> np.ndarray:
    """The part (free,) of each unknown, by members whose nodes it moves; new parts are added.

    It has every member where they are many, or not known.
    """
    members, all_members = [*parts], _Members().union(*parts)
    entries, auxiliaries = couplings.all_entries, couplings.auxiliaries
    pairs = np.unique(entries.column.astype(int) * len(parts) + dof_parts[entries.row])
    column, part = np.divmod(pairs, len(parts))
    numbers = np.zeros(couplings.columns + len(auxiliaries), int)
    numbers[column] = part
    # Others than those that move nodes of one part only.
    mixed = np.bincount(column, minlength=len(numbers)) != 1
    mixed[column] |= np.array([len(some) > _MOST for some in members])[part]
    mixed[[entry[0] for auxiliary in auxiliaries for entry in auxiliary.entries]] = True
    mixed[couplings.columns :] = True
    moved = {k: set[int]() for k in np.flatnonzero(mixed).tolist()}
    of_mixed = mixed[column]
    for k, number in zip(column[of_mixed].tolist(), part[of_mixed].tolist(), strict=True):
        moved[k] |= members[number]
    for k, auxiliary in reversed([*enumerate(auxiliaries, couplings.columns)]):
        for entry in auxiliary.entries:
            # Of too many members some are too many as well.
            moved[entry[0]].update(itertools.islice(moved[k], _MOST + 1))
    for k, some in moved.items():
        if k < couplings.free:
            several = _Members(some if 0 < len(some) <= _MOST else all_members)
            numbers[k] = parts.setdefault(several, len(parts))
    return numbers[: couplings.free]


def _parts_inside(parts: dict[_Members, int]) -> list[list[int]]:
    """For each part the parts whose members are all members of it, itself among them."""
    sharing: dict[int, list[_Members]] = {}
    for members in parts:
        for member in members:
            sharing.setdefault(member, []).append(members)
    inner_parts = []
    for members in parts:
        neighbours = dict.fromkeys(other for member in members for other in sharing[member])
        inner_parts.append([parts[other] for other in neighbours if other <= members])
    return inner_parts


def _runs(name: str, part: np.ndarray) -> dict[str, Any]:
    """Runs of the same part: their number, where they begin and the last one ends, their parts."""
    starts = _starts(part)
    return {
        f"{name}_runs": len(starts),
        f"{name}_run_start": np.append(starts, len(part)),
        f"{name}_run_part": part[starts],
    }


def _starts(numbers: np.ndarray) -> np.ndarray:
    """Where runs of equal numbers begin."""
    return np.flatnonzero(np.append(True, numbers[1:] != numbers[:-1])[: len(numbers)])
