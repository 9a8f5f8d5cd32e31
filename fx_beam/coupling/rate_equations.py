"""Joints, supports and driven motions as linear equations of the nodal rates, G v = g.

At node b the force p acts, and -p at the same place on a, or a moment. With the arm rho from a to
b, and t along the slide,

    p . (v_b - v_a - omega_a W rho) = p . t d'     joints without a slide, and driven slides
    the same with p = W t / |t| and d' = 0         free slides
    omega_b - omega_a = phi'                       joints that turn together

G^T times the multipliers of these equations are the forces of joints and supports on the nodes.
Here is what the equations depend on; C evaluates them (c/fitted_rates.c).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fx_beam.dual import plain, stacked
from fx_beam.fem.mesh import Mesh
from fx_beam.scene.joints import GROUND, Joint, Track
from fx_beam.scene.scene import Scene
from fx_beam.scene.sliders import SlidingJoint

from .sliders import members_of

# Kinds of plain equations, and the component of each: the last slides.
_ALONG_X, _ALONG_Y, _SLOT, _TURN, _SUPPORT = range(5)
_COMPONENTS = np.array([0, 1, -1, 2])
# Members of RateFit in C by the names that they have here.
_MEMBERS = (
    *("size", "joints", "columns", "count", "plain", "all_entries", "b", "a", "direction"),
    *("free", "joint", "column", "turning", "entry", "row", "dof"),
)


class RateEquations:
    """The equations of a scene, those of nodes that slide on beams behind all plain ones.

    `sliding` are the joints of these; `motors` has the driven columns of motors by the number of
    the joint, `supports` (n, 3) nodes, components and columns of supports; there are so many driven
    and fixed `columns`. Equations of rigid `points` are left out (`rigid_points`): what acts on
    one acts on the node that carries it.
    """

    def __init__(
        self,
        scene: Scene,
        mesh: Mesh,
        sliding: Sequence[SlidingJoint],
        motors: Mapping[int, int],
        supports: np.ndarray,
        columns: int,
        points: Mapping[int, Joint],
    ):
        self._points, self._X, self.columns = points, mesh.X, columns
        self.size, self.joints = mesh.dofs.size, scene.joint_count
        self.apart, self.axis = map(plain, arms_and_axes(scene, sliding))
        #: Kinds of the tracks of joints, and by the numbers of the joints (joints + 1,) theirs.
        self.tracks: set[type[Track]] = {Track, *(joint.track for joint in scene.joints)}
        self.track = np.zeros(self.joints + 1, dtype=int)
        slots: list[Joint] = []
        pins: list[Joint] = []
        left_out = set(points.values())
        for joint in scene.joints:
            if joint in sliding:
                continue
            if joint.axis is not None:
                self.track[joint.number] = joint.track.number
            if joint not in left_out:
                free = "slide" in joint.coordinates and "slide" not in joint.driven
                (slots if free else pins).append(joint)
        turns = [joint for joint in pins + slots if joint.turns_together]
        parts = pins, pins, slots, turns
        kind = np.repeat(np.arange(5), [*map(len, parts), len(supports)])
        ends = [(j.a.number, j.b.number, j.number) for part in parts for j in part]
        ends += [(GROUND.number, node, -1) for node in supports[:, 0].tolist()]
        a, b, joint = np.array(ends, dtype=int).reshape(-1, 3).T
        component = np.append(_COMPONENTS[kind[kind < _SUPPORT]], supports[:, 1])
        self.plain = len(kind)
        #: Directions (plain, 2) of forces that do not turn, and what is given besides their slides.
        self.direction = 1.0 * (component[:, None] == [0, 1])
        self._given = 1.0 * (kind == _SUPPORT)
        self._given[kind == _TURN] = [joint.rotation is not None for joint in turns]
        self.on_beams = [OnBeam(scene, mesh, joint) for joint in sliding]
        #: Joint of each equation, its driven or fixed column, or -1; whether its multiplier is a
        #: moment, and whether its force is across a free slide.
        self.joint = np.concatenate([joint, *(one.joint for one in self.on_beams)])
        self.column = np.array([motors.get(number, -1) for number in self.joint.tolist()], int)
        self.column[np.flatnonzero(kind == _SUPPORT)] = supports[:, 2]
        moment, across = [component == 2], [kind == _SLOT]
        self.turning = np.concatenate([*moment, *(one.turning for one in self.on_beams)]) * 1.0
        self.free = np.concatenate([*across, *(one.free for one in self.on_beams)])
        self.count = len(self.joint)
        self._find_entries(mesh, a, b)

    def _find_entries(self, mesh: Mesh, a: np.ndarray, b: np.ndarray) -> None:
        """Find arms and entries, at nodes a and b or those that carry them."""
        n, joint, points = self.plain, self.joint[: self.plain], [*self._points.values()]
        dofs = np.vstack([mesh.dofs, np.full((1, 3), -1)])
        X, carrier = np.vstack([mesh.X, np.zeros((1, 2))]), np.arange(len(dofs))
        number = np.full(len(dofs), -1)
        for k, point in enumerate(points):
            carrier[point.b.number], number[point.b.number] = carrier[point.a.number], k
        #: Degrees of freedom (plain, 3) of nodes b and a; -1 on the ground.
        self.b, self.a = dofs[b], dofs[a]
        ends = np.hstack([dofs[carrier[b]], dofs[carrier[a]]])
        point_b, point_a = (
            np.array([(p.b.number, p.a.number) for p in points], int).reshape(-1, 2).T
        )
        self._tables = {
            "ends": ends,
            "arms": np.hstack([X[b] - X[carrier[b]], self.apart[joint] + X[a] - X[carrier[a]]]),
            "points": len(points),
            "point_joint": np.array([point.number for point in points], dtype=int),
            "point_b": dofs[point_b],
            "point_a": dofs[point_a],
            "point_carrier": dofs[carrier[point_b]],
            "point_apart": X[point_b] - X[point_a],
            "point_arm": X[point_b] - X[carrier[point_b]],
            "point_of_point": number[point_a],
            "point_of": np.column_stack([number[b], number[a]]),
        }
        #: Which of the plain entries (plain, 6), and of those of nodes on beams, may not be zero.
        pushes, turns = (self.direction > 0) | self.free[:n, None], self.turning[:n] > 0
        arms = (
            carrier[b] != b,
            (carrier[a] != a) | self.apart[joint].any(1) | self.axis[joint].any(1),
        )
        levers = [turns | (pushes.any(axis=1) & arm) for arm in arms]
        used = np.column_stack([pushes, levers[0], pushes, levers[1]]) & (ends >= 0)
        beams, rows = self.on_beams, [np.repeat(np.arange(n), 6)]
        for one in beams:
            rows.append(rows[-1].max(initial=-1) + 1 + np.repeat(np.arange(one.rows), one.dof.size))
        used = np.concatenate([used.ravel(), *(one.used for one in beams)])
        dof = np.concatenate([ends.ravel(), *(np.tile(one.dof.ravel(), one.rows) for one in beams)])
        #: Numbers of these, and their rows and degrees of freedom.
        self.entry, self.all_entries = np.flatnonzero(used), len(used)
        self.row, self.dof = np.concatenate(rows)[self.entry], dof[self.entry]

    def tables(self) -> dict[str, Any]:
        """The equations by the names of RateFit in C."""
        joint, numbers = self.joint[: self.plain], {name: getattr(self, name) for name in _MEMBERS}
        of_joints = {name: getattr(self, name)[joint] for name in ("apart", "axis", "track")}
        beams = {"beams": len(self.on_beams), "beam": [one.tables() for one in self.on_beams]}
        entries = {"constant": self._given, "entries": len(self.entry)}
        return self._tables | numbers | of_joints | beams | entries


class OnBeam:
    """A node that slides on a beam, at sum N x with the rotation sum N psi.

    A sleeve turns by the curvature of the beam where it slides.
    """

    def __init__(self, scene: Scene, mesh: Mesh, joint: SlidingJoint):
        self.path, self.number = joint.path, joint.number
        #: Degrees of freedom (nodes, 3) of the beam, and (3,) of the node.
        self.beam = mesh.dofs[mesh.nodes_of(scene, joint.beam)]
        self.node = mesh.dofs[joint.b.number]
        slides = "slide" not in joint.driven
        self.sleeve = joint.turns_together
        self.rows = 2 - slides + self.sleeve
        #: Of each row: its joint, whether its multiplier is a moment, and its force across a free
        #: slide.
        self.joint, self.turning = np.full(self.rows, joint.number), np.zeros(self.rows)
        self.turning[self.rows - self.sleeve :] = 1.0
        self.free = np.full(self.rows, slides)
        components = np.eye(3, dtype=bool)[[0, 1, 2] if self.sleeve else [0, 1]]
        if slides:
            components = np.array([[True, True, False], [True, True, True]])[: self.rows]
        #: Degrees of freedom (3, 1 + nodes) of node and beam; which entries may not be zero.
        self.dof = np.vstack([self.node, self.beam]).T
        self.used = np.repeat(components.ravel(), self.dof.shape[1])

    def tables(self) -> dict[str, Any]:
        """As BeamRate in C."""
        return {
            "joint": self.number,
            "free": self.free[0],
            "sleeve": self.sleeve,
            "nodes": len(self.path),
            "path": [members_of(self.path) | {"dofs": self.beam}],
        }


def arms_and_axes(scene: Scene, sliding: Sequence[SlidingJoint]) -> tuple[Any, Any]:
    """From a to b in the reference configuration, and axes of slides (joints + 1, 2).

    The last is none, as the joint -1 of supports. They have slopes if the scene has.
    """
    arms: list[Any] = [(0.0, 0.0)] * (scene.joint_count + 1)
    axes = arms[:]
    for joint in scene.joints:
        if joint not in sliding:
            if not joint.is_index:  # else its nodes coincide
                arms[joint.number] = joint.apart
            if joint.axis is not None:
                axes[joint.number] = joint.axis
    return stacked(arms), stacked(axes)


def rigid_points(
    scene: Scene, mesh: Mesh, massless: np.ndarray, sliding: Sequence[SlidingJoint]
) -> dict[int, Joint]:
    """Rigid joints of nodes b without mass, such as points of bodies, by b; carriers first.

    Not of what slides, or on what others slide.
    """
    others = {joint.b.number for joint in sliding}
    others.update(*(mesh.nodes_of(scene, joint.beam).tolist() for joint in sliding))
    of_b: dict[int, Joint] = {}

    def carriers(node: int) -> list[int]:
        nodes = [node]
        while nodes[-1] in of_b:
            nodes.append(of_b[nodes[-1]].a.number)
        return nodes

    for joint in scene.joints:
        node = joint.b.number
        rigid = joint.is_rigid and GROUND not in (joint.a, joint.b)
        if not rigid or node in others or node in of_b or not massless[mesh.dofs[node]].all():
            continue
        if node not in carriers(joint.a.number):
            of_b[node] = joint
    depth = {node: len(carriers(node)) for node in of_b}
    return {node: of_b[node] for node in sorted(of_b, key=depth.__getitem__)}
