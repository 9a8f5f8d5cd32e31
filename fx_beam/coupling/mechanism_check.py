"""The check that nothing can move without mass or support."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import splu

from fx_beam.errors import SceneError
from fx_beam.fem.mesh import Mesh
from fx_beam.scene.coordinate import Coordinate
from fx_beam.scene.scene import Scene

# A motion is allowed if it violates supports and joints by no more than this part of itself.
_ROUNDING = 1e-9
# What the factorised matrix gets on its diagonal: more than its rounding, and less than the squares
# of what is told from zero.
_SHIFT = 1e-14
# Motions that are sought at a time, and corrections of each.
_SOUGHT, _CORRECTIONS = 4, 6


def check_no_massless_mechanism(
    scene: Scene,
    mesh: Mesh,
    stiffness: scipy.sparse.csr_matrix,
    mass: scipy.sparse.csr_matrix | None,
) -> None:
    """Refuse a scene that can move as a mechanism of rigid parts without mass or support.

    The rigid motions of all parts that supports and joints, with their motors, springs and
    dampers, allow must have mass. In statics there must be none, and dampers hold nothing.

    Parameters
    ----------
    scene : Scene
        Its supports and joints.
    mesh : Mesh
        The mesh.
    stiffness : (size, size) sparse matrix
        Its sparsity joins what the elements join.
    mass : (size, size) sparse matrix, optional
        Mass matrix; none in statics.

    Raises
    ------
    SceneError
        If such a motion exists; the message describes it.
    """
    parts = _parts(mesh, stiffness, mass)
    if not parts.free.any():
        return
    rows = _rows(scene, mesh, parts, at_rest=mass is None)
    motion = _motion(rows[:, parts.free.ravel()])
    if motion is None:
        return
    advice = "without mass or support: give its section rhoA and rhoI, add a mass, or support it"
    if mass is None:
        advice = (
            "without support, which statics has no mass to make up for: support it. If loads "
            "hold it, as weight does a pendulum that hangs, hold it in a copy of the scene, "
            "and go on from that with modes(scene, state=...) or simulate(scene, start=...)"
        )
    rates = np.zeros(parts.free.shape)
    rates[parts.free] = motion
    raise SceneError(f"{_description(mesh, parts, rates)} {advice}")


class _Parts(NamedTuple):
    """Rigid parts, whose motion is that of a point [sizes of the scene] and a rotation.

    Parameters
    ----------
    of_node : (n_node,) int
        Part of each node.
    middle, point : (parts, 2) float
        Mean position of its nodes, and its point: the middle, or where its mass is [m].
    free : (parts, 3) bool
        Whether its point may move along x and y, and whether it may turn: without mass to move.
    """

    of_node: np.ndarray
    middle: np.ndarray
    point: np.ndarray
    free: np.ndarray


def _parts(mesh: Mesh, stiffness, mass) -> _Parts:
    # Whatever the values of the entries are.
    ones = np.ones_like(stiffness.data)
    graph = scipy.sparse.csr_matrix((ones, stiffness.indices, stiffness.indptr))
    count, part_of_dof = scipy.sparse.csgraph.connected_components(graph, directed=False)
    of_node, X = part_of_dof[mesh.dofs[:, 0]], mesh.X

    def mean(nodes: np.ndarray) -> np.ndarray:
        """Mean positions of some nodes of each part, zero where there are none."""
        own = of_node[nodes]
        sums = [np.bincount(own, X[nodes, i], count) for i in (0, 1)]
        return np.column_stack(sums) / np.maximum(np.bincount(own, minlength=count), 1)[:, None]

    point = middle = mean(np.arange(len(X)))
    free = np.ones((count, 3), dtype=bool)
    if mass is not None:
        # No thresholds: mass in one place lets a part turn about it, in two it does not.
        diagonal = mass.diagonal()[mesh.dofs]
        heavy, turning = np.flatnonzero(diagonal[:, 0]), np.flatnonzero(diagonal[:, 2])
        free[of_node[heavy], :2] = False
        point = np.where(free[:, :1], middle, mean(heavy))
        apart = np.hypot(*(X[heavy] - point[of_node[heavy]]).T) > 1e-12 * mesh.size
        free[of_node[heavy[apart]], 2] = free[of_node[turning], 2] = False
    return _Parts(of_node, middle, point, free)


def _rows(scene: Scene, mesh: Mesh, parts: _Parts, at_rest: bool) -> scipy.sparse.csr_matrix:
    """Rates that supports and joints make zero, (rows, 3 parts)."""
    arms: list[list[float]] = ((mesh.X - parts.point[parts.of_node]) / mesh.size).tolist()
    part_of_node = [int(part) for part in parts.of_node]
    entries: list[tuple[int, int, float]] = []
    row = -1

    def add(node: int, component: int, factor: float, lever: float = 0.0) -> None:
        """Add a node's rate, and the displacement at a lever of the rotation, to the row."""
        if node < 0:
            return
        first = 3 * part_of_node[node]
        if component == 2:
            entries.append((row, first + 2, factor))
            return
        x, y = arms[node]
        entries.append((row, first + component, factor))
        entries.append((row, first + 2, factor * ((-y, x)[component] + lever)))

    for node, component in (*scene.fixed, *scene.prescribed):
        row += 1
        add(node, component, 1.0)
    for joint in scene.joints:
        a, b = joint.a.number, joint.b.number
        slide = joint.start()[0]
        arm = joint.offset + (0.0 if joint.axis is None else slide * joint.axis)
        across = arm[::-1] * (-1, 1) / mesh.size
        gaps = [(1.0, 0.0), (0.0, 1.0)]
        if joint.axis is not None and not _is_held(joint.slide, at_rest):
            gaps = [(-joint.axis[1], joint.axis[0])]
        for gap in gaps:
            row += 1
            for component in (0, 1):
                add(b, component, gap[component])
                add(a, component, -gap[component], across[component])
        if joint.turns_together or _is_held(joint.rotation, at_rest):
            row += 1
            add(b, 2, 1.0)
            add(a, 2, -1.0)
    i, j, values = np.array(entries).reshape(-1, 3).T
    shape = row + 1, parts.free.size
    return scipy.sparse.csr_matrix((values, (i.astype(int), j.astype(int))), shape)


def _is_held(coordinate: Coordinate | None, at_rest: bool) -> bool:
    """Whether a motor, a spring or, unless at rest, a damper keeps a coordinate from moving."""
    if coordinate is None:
        return False
    spring, damper = coordinate.spring, coordinate.damper
    stiffness = spring.stiffness if spring else 0.0
    viscosity = damper.viscosity if damper and not at_rest else 0.0
    return bool(coordinate.motor or stiffness or viscosity)


def _motion(rows: scipy.sparse.csr_matrix) -> np.ndarray | None:
    """Rates (n,) that all rows make zero, or none if there are no such.

    Inverse iteration on the rows' normal equations, whose rounding is that of the squares, finds
    candidates; they are judged by the rows themselves.
    """
    n, normal = rows.shape[1], (rows.T @ rows).tocsc()
    largest = normal.diagonal().max() or 1.0
    shifted = normal + _SHIFT * largest * scipy.sparse.identity(n, format="csc")
    options = {"SymmetricMode": True}
    solve = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve

    def settled(motions: np.ndarray) -> np.ndarray:
        for _ in range(_CORRECTIONS):
            motions = np.linalg.qr(solve(motions))[0]
        return motions

    found = settled(np.random.default_rng(0).standard_normal((n, min(n, _SOUGHT))))
    # Rows of zeros, as there may be fewer of them than motions.
    violated = np.vstack([rows @ found, np.zeros((found.shape[1],) * 2)])
    _, violations, mixed = np.linalg.svd(violated, full_matrices=False)
    allowed = found @ mixed[violations <= _ROUNDING * np.sqrt(largest)].T
    if not allowed.size:
        return None
    # Of all allowed motions the one that moves a column most, which is the simplest to describe.
    shares = np.sum(allowed**2, axis=1)
    most = np.zeros((n, 1))
    most[np.argmax(shares > 0.5 * shares.max())] = 1.0
    return settled(most)[:, 0]


def _description(mesh: Mesh, parts: _Parts, rates: np.ndarray) -> str:
    """What a motion (parts, 3) of the points of parts does to the one that it moves most."""
    middle, turn = parts.middle, rates[:, 2]
    x, y = ((middle - parts.point) / mesh.size).T
    at_middle = rates + np.column_stack([-turn * y, turn * x, 0 * turn])
    sizes = abs(at_middle).max(axis=1)
    part = int(np.argmax(sizes > (1 - 1e-6) * sizes.max()))  # the first of equal ones
    mode, (x, y) = at_middle[part], middle[part]
    if abs(mode[2]) > 1e-6 * abs(mode[:2]).max():
        # Velocity (mode0 - w y, mode1 + w x) vanishes at the pole.
        pole = middle[part] + mesh.size * np.array([-mode[1], mode[0]]) / mode[2]
        pole = np.round(pole / mesh.size, 9) * mesh.size + 0.0  # no rounding in place of a zero
        how = f"can turn about ({pole[0]:.4g}, {pole[1]:.4g})"
    else:
        along = np.round(mode[:2] / abs(mode[:2]).max(), 6) + 0.0  # no -0
        how = f"can move along ({along[0]:.3g}, {along[1]:.3g})"
    return f"the part of the scene around ({x:.4g}, {y:.4g}) {how}"
