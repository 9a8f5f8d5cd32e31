"""Parts of a scene with energies of their own, by which Newton's method judges (c/newton.h)."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
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
    dof_members = np.repeat(_members_of_nodes(model), 3)
    column_members = _members_of_columns(model, dof_members)
    parts = {members: i for i, members in enumerate(dict.fromkeys([*dof_members, *column_members]))}
    if len(parts) < 2:
        return {}
    inner_parts = _parts_inside(parts)
    starts = np.cumsum([0, *map(len, inner_parts)])
    return {
        "count": len(parts),
        **_runs("dof", np.array([parts[members] for members in dof_members])),
        **_runs("column", np.array([parts[members] for members in column_members])),
        "inside_start": starts,
        "inside": np.concatenate(inner_parts),
    }


def _members_of_nodes(model: Model) -> np.ndarray:
    """Beams on which each node lies; of other nodes a member of their own."""
    mesh = model.mesh
    node_beams: list[list[int]] = [[] for _ in mesh.X]
    for beam, nodes in enumerate(mesh.nodes):
        for node in nodes:
            node_beams[node].append(beam)
    members = np.empty(len(node_beams), dtype=object)
    members[:] = [_Members(beams or [-1 - node]) for node, beams in enumerate(node_beams)]
    return members


def _members_of_columns(model: Model, dof_members: np.ndarray) -> list[_Members]:
    """Members whose nodes each unknown moves; every one where they are many, or not known."""
    couplings, all_members = model.couplings, _Members().union(*dof_members)
    moved: list[set[int]] = [set() for _ in range(couplings.columns + len(couplings.auxiliaries))]
    entries = couplings.all_entries
    for dof, column in zip(entries.row, entries.column, strict=True):
        moved[column] |= dof_members[dof]
    for k, auxiliary in reversed([*enumerate(couplings.auxiliaries, couplings.columns)]):
        for column, *_ in auxiliary.entries:
            # Of too many members some are too many as well.
            moved[column].update(itertools.islice(moved[k], _MOST + 1))
    few = (members if len(members) <= _MOST else () for members in moved[: couplings.free])
    return [_Members(members or all_members) for members in few]


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
    starts = (
        np.flatnonzero(np.append(True, part[1:] != part[:-1])) if len(part) else np.zeros(0, int)
    )
    return {
        f"{name}_runs": len(starts),
        f"{name}_run_start": np.append(starts, len(part)),
        f"{name}_run_part": part[starts],
    }
