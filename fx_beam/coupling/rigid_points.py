"""Massless nodes that rigid joints hold, such as points of bodies, out of equations of rates.

Node b moves with node a at the arm rho, and what acts on b acts on a:

    v_b = v_a + omega_a W rho,    omega_b = omega_a
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fx_beam.fem.mesh import Mesh
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.scene import Scene

from .rate_equations import RateEquations


class _Level(NamedTuple):
    """Nodes that move with nodes of the levels before."""

    #: Degrees of freedom (nodes, 3) of the nodes and of those with which they move.
    b: np.ndarray
    a: np.ndarray
    #: Arms (nodes, 2) in the reference configuration, and rows (nodes, 3) of the joints.
    apart: np.ndarray
    rows: np.ndarray
    #: Entries at x and at y of the nodes, and the nodes to which they belong.
    at: tuple[np.ndarray, np.ndarray]
    of: tuple[np.ndarray, np.ndarray]


class RigidPoints:
    """Equations of rates without massless nodes that move rigidly with others."""

    def __init__(self, scene: Scene, mesh: Mesh, massless: np.ndarray, equations: RateEquations):
        levels = _levels(scene, mesh, massless)
        rows = [np.array([equations.rows_of(j) for j in joints], int) for joints in levels]
        #: Rows that remain.
        self.remaining = np.setdiff1d(
            np.arange(equations.count), np.concatenate([[], *map(np.ravel, rows)])
        )
        self._entries = np.flatnonzero(np.isin(equations.row, self.remaining))
        row, dof = equations.row[self._entries], equations.dof[self._entries]
        #: Their numbers among all of the equations, also those of the ground.
        self._numbers = equations.moving[self._entries]
        self._row, self._dof, self._levels = row, dof, []
        for joints, own in zip(levels[::-1], rows[::-1], strict=True):
            a, b = (mesh.dofs[[getattr(j, name).number for j in joints]] for name in "ab")
            number = np.full((3, equations.size), -1)
            for i in range(3):
                number[i, b[:, i]] = np.arange(len(joints))
            x, y, turn = number[:, dof]
            at = np.flatnonzero(x >= 0), np.flatnonzero(y >= 0)
            of = x[at[0]], y[at[1]]
            apart = np.array([(j.b.x - j.a.x, j.b.y - j.a.y) for j in joints]).reshape(-1, 2)
            self._levels.append(_Level(b, a, apart, own, at, of))
            for i, n in enumerate((x, y, turn)):
                dof = np.where(n >= 0, a[n, i], dof)
            dof = np.concatenate([dof, a[of[0], 2], a[of[1], 2]])
            row = np.concatenate([row, row[at[0]], row[at[1]]])
        keys, target = np.unique(
            np.searchsorted(self.remaining, row) * equations.size + dof, return_inverse=True
        )
        #: The entry to which each one adds, of these equations and of the arms in turn.
        self._target = target
        #: Rows among those that remain, and degrees of freedom (entries,) of the entries.
        self.row, self.dof = np.divmod(keys, equations.size)

    def tables(self) -> dict[str, Any]:
        """The points and the equations that remain, by the names of RateFit in C."""
        levels = self._levels
        starts = np.cumsum([0, *(len(one.b) for one in levels)])
        carried = [
            (at, 2 * (start + of) + 1 - i, np.full(len(at), 2.0 * i - 1))
            for start, one in zip(starts, levels, strict=False)
            for i, (at, of) in enumerate(zip(one.at, one.of, strict=True))
        ]
        none = np.empty((0, 3), dtype=int)
        source, arm, sign = (
            np.concatenate([none[:, 0], *(part[i] for part in carried)]) for i in range(3)
        )
        return {
            "remaining": len(self.remaining),
            "remaining_row": self.remaining,
            "raw": len(self._entries),
            "raw_entry": self._numbers,
            "raw_row": self._row,
            "raw_dof": self._dof,
            "carries": len(source),
            "carry_from": source,
            "carry_arm": arm,
            "carry_sign": sign,
            "entry_of": self._target,
            "entries": len(self.row),
            "row": self.row,
            "dof": self.dof,
            "points": int(starts[-1]),
            "point_a": np.concatenate([none, *(one.a for one in levels)]),
            "point_b": np.concatenate([none, *(one.b for one in levels)]),
            "point_rows": np.concatenate([none, *(one.rows for one in levels)]),
            "point_apart": np.concatenate([none[:, :2], *(one.apart for one in levels)]),
        }


def _levels(scene: Scene, mesh: Mesh, massless: np.ndarray) -> list[list[Joint]]:
    """The rigid joints of massless nodes b, those first whose node a is none of them."""
    of_b: dict[int, Joint] = {}
    for joint in scene.joints:
        node = joint.b.number
        if not _is_rigid(joint) or node in of_b or not massless[mesh.dofs[node]].all():
            continue
        carrier = joint.a.number
        while carrier in of_b:
            carrier = of_b[carrier].a.number
        if carrier != node:
            of_b[node] = joint
    levels: list[list[Joint]] = []
    for joint in of_b.values():
        depth, carrier = 0, joint.a.number
        while carrier in of_b:
            depth, carrier = depth + 1, of_b[carrier].a.number
        levels += [[] for _ in range(depth + 1 - len(levels))]
        levels[depth].append(joint)
    return levels


def _is_rigid(joint: Joint) -> bool:
    return joint.is_rigid and GROUND not in (joint.a, joint.b)
