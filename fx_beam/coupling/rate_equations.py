"""Joints, supports and driven motions as linear equations of the nodal rates, G v = g.

With the arm rho from a to b, and unit vectors t along a slide and n across it,

    v_b - v_a - omega_a W rho = t d'          joints without a slide, and driven slides
    n . (v_b - v_a - omega_a W rho) = 0       free slides
    omega_b - omega_a = phi'                  joints that turn together

G^T times the multipliers of these equations are the forces of joints and supports on the nodes.
Here are the rows and columns of G, and what its entries depend on; C evaluates them
(c/fitted_rates.c).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fx_beam.fem.mesh import Mesh
from fx_beam.scene.beam import Node
from fx_beam.scene.joints import Joint
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import SlidingJoint


class RateEquations:
    """The equations of a scene.

    `sliding` are the joints of nodes on beams; `motors` has the driven columns of motors by the
    number of the joint, `supports` (n, 2) the degrees of freedom of supports and their columns;
    there are so many driven and fixed `columns`.
    """

    def __init__(
        self,
        scene: Scene,
        mesh: Mesh,
        sliding: Sequence[SlidingJoint],
        motors: dict[int, int],
        supports: np.ndarray,
        columns: int,
    ):
        self.size, self.joints, self.columns = mesh.dofs.size, scene.joint_count, columns
        plain = [joint for joint in scene.joints if joint not in sliding]
        slotted = [j for j in plain if j.slide is not None and j.slide.motor is None]
        pinned = [joint for joint in plain if joint not in slotted]
        turning = [joint for joint in plain if joint.turns_together]
        self._parts: list[_Part] = [
            _Pins(mesh, pinned),
            _Slots(mesh, slotted),
            _Turns(mesh, turning),
            *(OnBeam(scene, mesh, joint) for joint in sliding),
            _Supports(supports[:, 0]),
        ]
        starts = np.cumsum([0, *(len(part.joint) for part in self._parts)])
        #: Number of equations, and rows and degrees of freedom (entries,) of G.
        self.count = int(starts[-1])
        self.row = np.concatenate(
            [i + part.row for i, part in zip(starts, self._parts, strict=False)]
        )
        self.dof = np.concatenate([part.dof for part in self._parts])
        #: Which of all entries these are: the ground has no rates.
        self.moving = np.flatnonzero(self.dof >= 0)
        self._all_entries = len(self.dof)
        self.row, self.dof = self.row[self.moving], self.dof[self.moving]
        #: Joint of each equation, and its driven or fixed column; -1 without one.
        self._joint = np.concatenate([part.joint for part in self._parts])
        self._turns = np.concatenate([part.turns for part in self._parts])
        self._column = np.array([motors.get(number, -1) for number in self._joint.tolist()], int)
        self._column[starts[-2] :] = supports[:, 1]

    def tables(self) -> dict[str, Any]:
        """The equations by the names of RateFit in C."""
        pins, slots, turns, *on_beams, _ = self._parts
        assert isinstance(pins, _Arms)
        assert isinstance(slots, _Arms)
        assert isinstance(turns, _Turns)
        arms = [part.tables() for part in (pins, slots)]
        return {
            "pins": len(pins.numbers),
            "slots": len(slots.numbers),
            "turns": len(turns.joint),
            "turned": turns.given,
            "beams": len(on_beams),
            "beam": [part.tables() for part in self.on_beams],
            "joint": self._joint,
            "column": self._column,
            "turning": self._turns,
            "size": self.size,
            "joints": self.joints,
            "columns": self.columns,
            "count": self.count,
            "all_entries": self._all_entries,
            **{name: np.concatenate([part[name] for part in arms]) for name in arms[0]},
        }

    @property
    def on_beams(self) -> list[OnBeam]:
        """Nodes that slide on beams."""
        return [part for part in self._parts if isinstance(part, OnBeam)]

    def rows_of(self, joint: Joint) -> np.ndarray:
        """Rows of a joint: of forces, then of the moment."""
        return np.flatnonzero(self._joint == joint.number)


class _Part:
    """Equations of joints of one kind: row and degree of freedom of each entry, -1 on the ground.

    For each row the number of its joint, and whether it has a moment as its multiplier.
    """

    row: np.ndarray
    dof: np.ndarray
    joint: np.ndarray
    turns: np.ndarray


class _Arms(_Part):
    """Ends, arms and axes of joints."""

    def __init__(self, mesh: Mesh, joints: list[Joint]):
        self.a, self.b = (_dofs(mesh, [getattr(j, name) for j in joints]) for name in "ab")
        #: From a to b in the reference configuration; joints of nodes that coincide have no arm.
        self._apart = np.array([joint.apart for joint in joints]).reshape(-1, 2)
        self._has_arm = np.array([not joint.is_index for joint in joints], dtype=float)[:, None]
        axes = [(0.0, 0.0) if joint.axis is None else joint.axis for joint in joints]
        self._axis = np.array(axes).reshape(-1, 2)
        self.numbers = np.array([joint.number for joint in joints], dtype=int)

    def tables(self) -> dict[str, np.ndarray]:
        """What the arms and axes depend on."""
        return {
            "arm_a": self.a,
            "arm_b": self.b,
            "apart": self._apart,
            "slide_axis": self._axis,
            "has_arm": self._has_arm,
        }


class _Pins(_Arms):
    """Joints without a slide, or with a driven one: two equations each."""

    def __init__(self, mesh: Mesh, joints: list[Joint]):
        super().__init__(mesh, joints)
        i = np.arange(len(joints))
        self.row = np.concatenate([2 * i, 2 * i, 2 * i, 2 * i + 1, 2 * i + 1, 2 * i + 1])
        a, b = self.a, self.b
        self.dof = np.concatenate([b[:, 0], a[:, 0], a[:, 2], b[:, 1], a[:, 1], a[:, 2]])
        self.joint, self.turns = np.repeat(self.numbers, 2), np.zeros(2 * len(joints))


class _Slots(_Arms):
    """Joints with a free slide: one equation each, across it."""

    def __init__(self, mesh: Mesh, joints: list[Joint]):
        super().__init__(mesh, joints)
        a, b = self.a, self.b
        self.row = np.tile(np.arange(len(joints)), 5)
        self.dof = np.concatenate([b[:, 0], b[:, 1], a[:, 0], a[:, 1], a[:, 2]])
        self.joint, self.turns = self.numbers, np.zeros(len(joints))


class _Turns(_Part):
    """Joints whose nodes turn together, up to the angle of a motor: one equation each."""

    def __init__(self, mesh: Mesh, joints: list[Joint]):
        a, b = (_dofs(mesh, [getattr(j, name) for j in joints])[:, 2] for name in "ab")
        self.row, self.dof = np.tile(np.arange(len(joints)), 2), np.concatenate([b, a])
        self.joint = np.array([joint.number for joint in joints], dtype=int)
        self.turns = np.ones(len(joints))
        motor = [joint.rotation is not None for joint in joints]
        #: Whether a motor drives the angle.
        self.given = np.array(motor, dtype=float)


class OnBeam(_Part):
    """A node that slides on a beam, at sum N x with the rotation sum N psi.

    A sleeve turns by the curvature of the beam where it slides.
    """

    def __init__(self, scene: Scene, mesh: Mesh, joint: SlidingJoint):
        self.path, self.number = joint.path, joint.number
        #: Degrees of freedom (nodes, 3) of the beam, and (3,) of the node.
        self.beam = mesh.dofs[mesh.nodes_of(scene, joint.beam)]
        self.node = node = mesh.dofs[joint.b.number]
        driven = joint.slide is not None and joint.slide.motor is not None
        self.free, self.sleeve = not driven, joint.turns_together
        # A row and column of the beam's nodes for each component of the node.
        own = np.concatenate([[node[i], *self.beam[:, i]] for i in range(3)])
        self.rows = rows = 1 + driven + self.sleeve
        self.row, self.dof = np.repeat(np.arange(rows), len(own)), np.tile(own, rows)
        self.joint = np.full(rows, joint.number)
        self.turns = np.zeros(rows)
        self.turns[rows - self.sleeve :] = 1.0

    def tables(self) -> dict[str, Any]:
        """As BeamRate in C."""
        path = self.path
        return {
            "joint": self.number,
            "free": self.free,
            "sleeve": self.sleeve,
            "degree": path.degree,
            "elements": len(path.h),
            "nodes": len(path),
            "dofs": self.beam,
            "ends": path.s,
            "coefficients": path.coefficients,
            "position": path.X,
            "angle": path.angles(),
        }


class _Supports(_Part):
    """Components of nodes that are fixed or prescribed."""

    def __init__(self, dofs: np.ndarray):
        self.dof, self.row = dofs, np.arange(len(dofs))
        self.joint, self.turns = np.full(len(dofs), -1), np.zeros(len(dofs))


def _dofs(mesh: Mesh, nodes: list[Node]) -> np.ndarray:
    """Degrees of freedom (nodes, 3); -1 on the ground."""
    known = np.vstack([mesh.dofs, np.full((1, 3), -1)])
    return known[[node.number for node in nodes]].reshape(-1, 3)
