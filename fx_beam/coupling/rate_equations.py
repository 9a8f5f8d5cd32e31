"""Joints, supports and driven motions as linear equations of the nodal rates, G v = g.

With the arm rho from a to b, and unit vectors t along a slide and n across it,

    v_b - v_a - omega_a W rho = t d'          joints without a slide, and driven slides
    n . (v_b - v_a - omega_a W rho) = 0       free slides
    omega_b - omega_a = phi'                  joints that turn together

G^T times the multipliers of these equations are the forces of joints and supports on the nodes.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.fem.mesh import Mesh
from fx_beam.scene.beam import Node
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import SlidingJoint, sliding_joints


class Coefficients(NamedTuple):
    """The equations in n configurations."""

    #: Entries (n, entries) of G, at `RateEquations.row` and `RateEquations.dof`.
    entries: np.ndarray
    #: Coefficients (n, rows) of the driven rates in g: g = given w[column].
    given: np.ndarray
    #: Force (n, rows, 2) on node b of a unit multiplier.
    push: np.ndarray


def summing(target: np.ndarray, count: int) -> scipy.sparse.csr_matrix:
    """Matrix (n, count) that adds each of n values to the sum of the number `target`."""
    n = len(target)
    return scipy.sparse.csr_matrix((np.ones(n), (np.arange(n), target)), (n, count))


class RateEquations:
    """The equations of a scene.

    `motors` has the driven columns of motors by the number of the joint, `supports` (n, 2) the
    degrees of freedom of supports and their columns; there are so many driven and fixed `columns`.
    """

    def __init__(
        self,
        scene: Scene,
        mesh: Mesh,
        motors: dict[int, int],
        supports: np.ndarray,
        columns: int,
    ):
        self.size, self.joints, self.columns = mesh.dofs.size, len(scene.joints), columns
        sliding = sliding_joints(scene.joints)
        plain = [joint for joint in scene.joints if joint not in sliding]
        slotted = [j for j in plain if j.slide is not None and j.slide.motor is None]
        pinned = [joint for joint in plain if joint not in slotted]
        turning = [joint for joint in plain if joint.turns_together]
        self._parts: list[_Part] = [
            _Pins(mesh, pinned),
            _Slots(mesh, slotted),
            _Turns(mesh, turning),
            *(_OnBeam(scene, mesh, joint) for joint in sliding),
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

    def at(self, q: np.ndarray, slides: np.ndarray) -> Coefficients:
        """Coefficients at displacements and rotations (n, size) and slides (n, joints)."""
        parts = [part.at(q, slides) for part in self._parts]
        entries, given, push = (
            np.concatenate(values, axis=1) for values in zip(*parts, strict=True)
        )
        given[:, self._column < 0] = 0.0
        return Coefficients(entries[:, self.moving], given, push)

    def tables(self) -> dict[str, Any]:
        """What `at`, `driven` and `forces` need, by the names of RateFit in C."""
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
            "beam": [part.tables() for part in on_beams if isinstance(part, _OnBeam)],
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

    def rows_of(self, joint: Joint) -> np.ndarray:
        """Rows of a joint: of forces, then of the moment."""
        return np.flatnonzero(self._joint == joint.number)

    def driven(self, of: Coefficients, w: np.ndarray) -> np.ndarray:
        """g (n, rows), for rates (n, driven) of driven motions; supports are at rest."""
        known = np.zeros((len(w), self.columns + 1))
        known[:, : w.shape[1]] = w
        return of.given * known[:, self._column]

    def forces(self, of: Coefficients, multipliers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces (n, joints, 3) of joints on b, and (n, columns) of motors and supports."""
        n, joint, column = len(multipliers), self._joint, self._column
        on_joints, constraints = np.zeros((self.joints, n, 3)), np.zeros((self.columns, n))
        of_joints, driven = np.flatnonzero(joint >= 0), np.flatnonzero(column >= 0)
        on_b = np.empty((n, len(of_joints), 3))
        on_b[..., :2] = of.push[:, of_joints] * multipliers[:, of_joints, None]
        on_b[..., 2] = self._turns[of_joints] * multipliers[:, of_joints]
        np.add.at(on_joints, joint[of_joints], on_b.swapaxes(0, 1))
        np.add.at(constraints, column[driven], (of.given * multipliers)[:, driven].T)
        return on_joints.swapaxes(0, 1), constraints.T


_Values = tuple[np.ndarray, np.ndarray, np.ndarray]


class _Part:
    """Equations of joints of one kind: row and degree of freedom of each entry, -1 on the ground.

    For each row the number of its joint, and whether it has a moment as its multiplier.
    """

    row: np.ndarray
    dof: np.ndarray
    joint: np.ndarray
    turns: np.ndarray

    def at(self, q: np.ndarray, slides: np.ndarray) -> _Values:
        """Entries, coefficients of driven rates, and forces on b."""
        raise NotImplementedError


class _Arms(_Part):
    """Ends, arms and axes of joints."""

    def __init__(self, mesh: Mesh, joints: list[Joint]):
        self.a, self.b = (_dofs(mesh, [getattr(j, name) for j in joints]) for name in "ab")
        #: From a to b in the reference configuration; joints of nodes that coincide have no arm.
        self._apart = np.array([_apart(joint) for joint in joints]).reshape(-1, 2)
        self._has_arm = np.array([not joint.is_index for joint in joints], dtype=float)[:, None]
        axes = [(0.0, 0.0) if joint.axis is None else joint.axis for joint in joints]
        self._axis = np.array(axes).reshape(-1, 2)
        self.numbers = np.array([joint.number for joint in joints], dtype=int)

    def tables(self) -> dict[str, np.ndarray]:
        """What `arm` and `along` need."""
        return {
            "arm_a": self.a,
            "arm_b": self.b,
            "apart": self._apart,
            "slide_axis": self._axis,
            "has_arm": self._has_arm,
        }

    def arm(self, q: np.ndarray) -> np.ndarray:
        """From a to b (n, joints, 2)."""
        moved = _of(q, self.b[:, :2]) - _of(q, self.a[:, :2])
        return (self._apart + moved) * self._has_arm

    def along(self, q: np.ndarray) -> np.ndarray:
        """Unit vectors (n, joints, 2) along the axes; zero without one."""
        psi, (x, y) = _of(q, self.a[:, 2]), self._axis.T
        c, s = np.cos(psi), np.sin(psi)
        return np.stack([c * x - s * y, s * x + c * y], axis=-1)


class _Pins(_Arms):
    """Joints without a slide, or with a driven one: two equations each."""

    def __init__(self, mesh: Mesh, joints: list[Joint]):
        super().__init__(mesh, joints)
        count, i = len(joints), np.arange(len(joints))
        self.row = np.concatenate([2 * i, 2 * i, 2 * i, 2 * i + 1, 2 * i + 1, 2 * i + 1])
        a, b = self.a, self.b
        self.dof = np.concatenate([b[:, 0], a[:, 0], a[:, 2], b[:, 1], a[:, 1], a[:, 2]])
        self.joint, self.turns = np.repeat(self.numbers, 2), np.zeros(2 * count)
        self._push = np.tile(np.eye(2), (count, 1))

    def at(self, q, slides):
        """b - a - W rho."""
        x, y = np.moveaxis(self.arm(q), -1, 0)
        one = np.ones_like(x)
        entries = np.concatenate([one, -one, y, one, -one, -x], axis=1)
        along = self.along(q).reshape(len(q), -1)
        return entries, along, np.broadcast_to(self._push, (len(q), *self._push.shape))


class _Slots(_Arms):
    """Joints with a free slide: one equation each, across it."""

    def __init__(self, mesh: Mesh, joints: list[Joint]):
        super().__init__(mesh, joints)
        a, b = self.a, self.b
        self.row = np.tile(np.arange(len(joints)), 5)
        self.dof = np.concatenate([b[:, 0], b[:, 1], a[:, 0], a[:, 1], a[:, 2]])
        self.joint, self.turns = self.numbers, np.zeros(len(joints))

    def at(self, q, slides):
        """Across the slide; W rho across it is the part of rho along it."""
        along = self.along(q)
        across = _perp(along)
        x, y = np.moveaxis(across, -1, 0)
        lever = np.sum(along * self.arm(q), axis=-1)
        entries = np.concatenate([x, y, -x, -y, -lever], axis=1)
        return entries, np.zeros_like(x), across


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
        self._signs = np.repeat([1.0, -1.0], len(joints))

    def at(self, q, slides):
        """b - a."""
        n, count = len(q), len(self.joint)
        entries = np.broadcast_to(self._signs, (n, 2 * count))
        return entries, np.broadcast_to(self.given, (n, count)), np.zeros((n, count, 2))


class _OnBeam(_Part):
    """A node that slides on a beam, at sum N x with the rotation sum N psi.

    A sleeve turns by the curvature of the beam where it slides.
    """

    def __init__(self, scene: Scene, mesh: Mesh, joint: SlidingJoint):
        self._path, self._number = joint.path, joint.number
        self._beam = mesh.dofs[mesh.nodes_of(scene, joint.beam)]
        node = mesh.dofs[joint.b.number]
        driven = joint.slide is not None and joint.slide.motor is not None
        self._free, self._sleeve = not driven, joint.turns_together
        # A row and column of the beam's nodes for each component of the node.
        own = np.concatenate([[node[i], *self._beam[:, i]] for i in range(3)])
        rows = 1 + driven + self._sleeve
        self.row, self.dof = np.repeat(np.arange(rows), len(own)), np.tile(own, rows)
        self.joint = np.full(rows, joint.number)
        self.turns = np.zeros(rows)
        self.turns[rows - self._sleeve :] = 1.0

    def tables(self) -> dict[str, Any]:
        """What `at` needs."""
        path = self._path
        return {
            "joint": self._number,
            "free": self._free,
            "sleeve": self._sleeve,
            "degree": path.degree,
            "elements": len(path.h),
            "nodes": len(path),
            "dofs": self._beam,
            "ends": path.s,
            "coefficients": path.coefficients,
            "position": path.X,
            "angle": path.angles(),
        }

    def at(self, q, slides):
        """Across the beam, or along x and y; then the rotation."""
        path, s, n = self._path, slides[:, self._number], len(q)
        each = np.broadcast_to(np.eye(len(path)), (n, len(path), len(path)))
        N, slope = path.over(each, s), path.over(each, s, 1)
        apart = np.column_stack([np.ones(n), -N])
        along = np.einsum("na,nai->ni", slope, path.X + _of(q, self._beam[:, :2]))
        square = np.sum(along**2, axis=1)
        bend = np.einsum("na,na->n", slope, path.angles() + _of(q, self._beam[:, 2]))
        if self._free:
            push = (_perp(along) / np.sqrt(square)[:, None])[:, None]
            given = np.zeros((n, 1))
        else:
            push, given = np.broadcast_to(np.eye(2), (n, 2, 2)), along
        if self._sleeve:
            turning = -along * (bend / square)[:, None] if self._free else 0 * along
            push = np.concatenate([push, turning[:, None]], axis=1)
            given = np.column_stack([given, 0 * bend if self._free else bend])
        weights = np.concatenate([push, 0 * push[..., :1]], axis=-1)
        if self._sleeve:
            weights[:, -1, 2] = 1.0
        entries = weights[..., None] * apart[:, None, None]
        return entries.reshape(n, -1), given, push


class _Supports(_Part):
    """Components of nodes that are fixed or prescribed."""

    def __init__(self, dofs: np.ndarray):
        self.dof, self.row = dofs, np.arange(len(dofs))
        self.joint, self.turns = np.full(len(dofs), -1), np.zeros(len(dofs))

    def at(self, q, slides):
        """The rates themselves."""
        n, count = len(q), len(self.dof)
        one = np.ones((n, count))
        return one, one, np.zeros((n, count, 2))


def _dofs(mesh: Mesh, nodes: list[Node]) -> np.ndarray:
    """Degrees of freedom (nodes, 3); -1 on the ground."""
    known = np.vstack([mesh.dofs, np.full((1, 3), -1)])
    return known[[node.number for node in nodes]].reshape(-1, 3)


def _of(q: np.ndarray, dofs: np.ndarray) -> np.ndarray:
    """Values (n, ...) at degrees of freedom; zero on the ground."""
    return np.where(dofs >= 0, q[:, dofs], 0.0)


def _apart(joint: Joint) -> np.ndarray:
    """From a to b in the reference configuration (2,); a joint with the ground is at its node."""
    if joint.a is GROUND or joint.b is GROUND:
        return joint.offset
    return np.array([joint.b.x - joint.a.x, joint.b.y - joint.a.y])


def _perp(a: np.ndarray) -> np.ndarray:
    return np.stack([-a[..., 1], a[..., 0]], axis=-1)
