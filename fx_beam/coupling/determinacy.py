"""Whether joints hold a scene, and not twice; ends of beams that are not joined."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from itertools import pairwise
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse
from scipy.sparse.linalg import splu

from fx_beam.errors import SceneError, warn_once
from fx_beam.fem.mesh import Mesh, connected_parts
from fx_beam.scene.coordinate import Coordinate
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.scene import Scene

if TYPE_CHECKING:
    from .dependent_columns import Loops
    from .graph import Couplings
    from .reduction import Reduction


# -- Ends of beams that lie on another beam without being joined to it, as in a drawing of lines


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
    tree, middles, radii = cKDTree(X[ends]), X[first] + ways / 2, lengths / 2 + near
    close_pieces = np.flatnonzero(tree.query(middles)[0] <= radii)  # most have no end near
    close = tree.query_ball_point(middles[close_pieces], radii[close_pieces])
    piece = np.repeat(close_pieces, [*map(len, close)])
    node = ends[np.fromiter(itertools.chain.from_iterable(close), int)]
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


# -- Whether joints hold a scene, and not twice: mechanisms, redundant joints, singular starts --


# A motion is possible if it violates supports and joints by less than this fraction of itself.
_ROUNDING = 1e-9
# Shift of the diagonal before factorisation: above round-off, and small compared with the squares
# of the violations to be detected.
_SHIFT = 1e-14
# Up to so many columns all singular vectors are computed, which is then faster.
_FEW = 30
# Number of motions in the inverse iteration, and of iterations.
_SOUGHT, _CORRECTIONS = 4, 6


def mechanism_of(
    scene: Scene, mesh: Mesh, mass: scipy.sparse.csr_matrix | None, settles: bool
) -> str:
    """Why a scene can move as a mechanism of rigid bodies without mass or support; empty if not.

    SceneError unless it settles. Each such motion must have mass or linear drag. In statics (`mass`
    is None) none may exist, and neither dampers nor drag restrain it.
    """
    parts = _parts(mesh, None if mass is None else _inertia(scene, mesh, mass))
    if parts is None or not parts.free.any():
        return ""
    motion = _motion(_rows(scene, mesh, parts, static=mass is None))
    if motion is None:
        return ""
    rates = np.zeros(parts.free.shape)
    rates[parts.free] = motion
    description, advice = _description(scene, mesh, parts, rates)
    body = f"{description} as a rigid body"
    if ends := unjoined_ends(scene, mesh):
        body += f" (not joined: {ends})"
    reason = f"Equations of motion are singular: {body}, without mass or support"
    if mass is None:
        reason, advice = f"Static analysis is singular: {body}", "Add a support"
    if not settles:
        raise SceneError(f"{reason}. {advice}")
    return f"{reason}. {advice}".removesuffix(". Add a support")


class _Parts(NamedTuple):
    """Rigid bodies; each moves by a point [in sizes of the scene] and a rotation."""

    #: Body of each node (n_node,).
    part_of_node: np.ndarray
    #: Mean position (parts, 2) of the nodes of a body, and its point (parts, 2): the same, or the
    #: centre of the massive nodes [m].
    middle: np.ndarray
    point: np.ndarray
    #: Whether the point may move along x and y, and the body rotate, without mass (parts, 3).
    free: np.ndarray


def _inertia(scene: Scene, mesh: Mesh, mass: scipy.sparse.csr_matrix) -> np.ndarray:
    """Masses or linear drags (n_node, 3) that resist the rates of nodes; zero for neither."""
    diagonal = mass.diagonal().reshape(-1, 3)
    for drag in scene.drags:
        linear, rotation = drag.linear.min(), drag.rotation[0]
        diagonal[mesh.nodes_of(scene, drag.target)] += linear, linear, rotation
    return diagonal


def _parts(mesh: Mesh, inertia: np.ndarray | None) -> _Parts | None:
    """The parts of a scene; None if all of them have mass and rotary inertia."""
    pairs, X = np.array([mesh.elements[:, :-1].ravel(), mesh.elements[:, 1:].ravel()]), mesh.X
    part_of_node = connected_parts(pairs, len(X))
    count = part_of_node.max() + 1
    free = np.ones((count, 3), dtype=bool)
    if inertia is not None:
        heavy, turning = np.flatnonzero(inertia[:, 0]), np.flatnonzero(inertia[:, 2])
        free[part_of_node[heavy], :2] = free[part_of_node[turning], 2] = False
        if not free.any():
            return None

    def mean(nodes: np.ndarray) -> np.ndarray:
        """Mean positions of some nodes of each part, zero for a part without them."""
        part = part_of_node[nodes]
        sums = [np.bincount(part, X[nodes, i], count) for i in (0, 1)]
        return np.column_stack(sums) / np.maximum(np.bincount(part, minlength=count), 1)[:, None]

    point = middle = mean(np.arange(len(X)))
    if inertia is not None:
        # With mass at one place only, a body can rotate about it without inertia.
        point = np.where(free[:, :1], middle, mean(heavy))
        apart = np.hypot(*(X[heavy] - point[part_of_node[heavy]]).T) > 1e-12 * mesh.size
        free[part_of_node[heavy[apart]], 2] = False
    return _Parts(part_of_node, middle, point, free)


def _rows(scene: Scene, mesh: Mesh, parts: _Parts, static: bool):
    """Linear constraints of the scene on the free rates: an array (rows, free) if few."""
    rates, free = _held_rates(scene, mesh, static), parts.free.ravel()
    terms, count, n = [*itertools.chain.from_iterable(rates)], len(rates), len(free)
    row = np.repeat(np.arange(count), [*map(len, rates)])
    dof, weight = np.array([dof for dof, _ in terms], int), np.array([x for _, x in terms])
    row, dof, weight = row[dof >= 0], dof[dof >= 0], weight[dof >= 0]
    node, component = np.divmod(dof, 3)
    part = parts.part_of_node[node]
    x, y = ((mesh.X[node] - parts.point[part]) / mesh.size).T
    lever = np.choose(component, [-y, x, 0 * x])
    row, column = np.tile(row, 2), np.append(3 * part + component, 3 * part + 2)
    values = np.append(weight, weight * lever)
    if free.sum() > _FEW:
        return scipy.sparse.coo_matrix((values, (row, column)), (count, n)).tocsr()[:, free]
    return np.bincount(row * n + column, values, count * n).reshape(count, n)[:, free]


#: Degrees of freedom, negative of the ground, and weights of a rate of nodes.
_Terms = list[tuple[int, float]]


def _held_rates(scene: Scene, mesh: Mesh, static: bool) -> list[_Terms]:
    """Rates, in sizes of the scene, that its supports, joints, springs, ropes and gears hold."""
    rates: list[_Terms] = [[(3 * n + i, 1.0)] for n, i in (*scene.fixed, *scene.prescribed)]
    for joint in scene.joints:
        ways = [(1.0, 0.0), (0.0, 1.0)]
        if (axis := joint.direction) is not None and not _is_held(joint.slide, static):
            ways = [(-axis[1], axis[0])]
        rates += _partings(joint, ways, mesh.size)
        if joint.turns_together or _is_held(joint.rotation, static):
            rates.append(_turn(joint))
    for force in scene.forces_between:
        if _is_held(force.on, static):
            rates += _stretches(scene, mesh, force)
    for gear in scene.gears:
        unit, rate = 1.0 if gear.column else mesh.size, _Terms()
        for joint, name, weight in gear.terms if gear.is_ideal or _is_held(gear.on, static) else ():
            if name == "slide":
                rate += _partings(joint, [joint.direction], mesh.size)[0]
            else:
                rate += [(dof, sign * weight / unit) for dof, sign in _turn(joint)]
        rates.append(rate)
    return rates


def _turn(joint: Joint) -> _Terms:
    """Spin of b relative to a."""
    return [(3 * joint.b.number + 2, 1.0), (3 * joint.a.number + 2, -1.0)]


def _partings(joint: Joint, ways: list, size: float) -> list[_Terms]:
    """Velocities of b relative to the end of its arm on a, along some directions."""
    a, b, (arm_x, arm_y) = 3 * joint.a.number, 3 * joint.b.number, (joint.arm / size).tolist()
    levers = [x * arm_y - y * arm_x for x, y in ways]
    return [[*_apart(a, b, *way), (a + 2, x)] for way, x in zip(ways, levers, strict=True)]


def _apart(a: int, b: int, x: float, y: float) -> _Terms:
    """Velocity of b relative to a along (x, y), by their first degrees of freedom."""
    return [(b, x), (b + 1, y), (a, -x), (a + 1, -y)]


def _stretches(scene: Scene, mesh: Mesh, line: Any) -> list[_Terms]:
    """Rates of the length of a line, or of what it holds to the ground."""
    if line.to_ground and line.direction is None:
        return [[(3 * line.target.number + 2, 1.0)]]
    if line.to_ground:
        nodes = mesh.nodes_of(scene, line.target)
        ways = zip(nodes.tolist(), line.ways(mesh.X[nodes]).tolist(), strict=True)
        return [[(3 * node, x), (3 * node + 1, y)] for node, (x, y) in ways]
    drums = getattr(line, "drums", ())
    rate = [(3 * node + 2, radius / mesh.size) for node, radius in drums]
    parts = line.straight(np.array(line.apart, dtype=float)).tolist()
    for a, b, (x, y) in zip(line.nodes, line.nodes[1:], parts, strict=False):
        length = math.hypot(x, y)
        rate += _apart(3 * a, 3 * b, x / length, y / length)
    return [rate]


def _is_held(coordinate: Coordinate | None, static: bool) -> bool:
    """Whether a motor or a spring restrains a coordinate, or in a motion a damper or friction."""
    if coordinate is None:
        return False
    spring, damper, friction = coordinate.spring, coordinate.damper, coordinate.friction
    restraint = coordinate.motor or (spring and (spring.stiffness or spring.strain_energy))
    resists = getattr(friction, "force", False)  # that of Coulomb may be zero
    damped = (damper and (damper.viscosity or damper.law)) or resists
    return bool(restraint or (damped and not static))


def _motion(rows) -> np.ndarray | None:
    """Rates (n,) in the null space of the rows, or None."""
    n = rows.shape[1]
    allowed, settled = null_space(rows, _ROUNDING)
    if not allowed.size:
        return None
    # Of all possible motions the one that moves a single column most is simplest to describe.
    shares, most = np.sum(allowed**2, axis=1), np.zeros((n, 1))
    most[np.argmax(shares > 0.5 * shares.max())] = 1.0
    return settled(most)[:, 0]


def null_space(rows, least: float) -> tuple[np.ndarray, Callable]:
    """Unit motions (n, k) that rows (m, n) see by up to a least part of the largest column.

    And the projection on them. Of a sparse matrix a few of the motions, by inverse iteration on the
    normal equations: it has the round-off of squares, so the rows themselves decide.
    """
    n = rows.shape[1]
    if isinstance(rows, np.ndarray):
        largest = np.sqrt((rows**2).sum(axis=0).max(initial=0.0)) or 1.0
        few = len(rows) < n  # of more, those to the left need memory by their square
        _, seen, motions = np.linalg.svd(rows, full_matrices=few)
        seen = np.append(seen, np.zeros(len(motions) - len(seen)))
        allowed = motions[seen <= least * largest].T
        return allowed, lambda motion: allowed @ (allowed.T @ motion)
    normal = (rows.T @ rows).tocsc()
    largest = normal.diagonal().max() or 1.0
    shifted = normal + _SHIFT * largest * scipy.sparse.identity(n, format="csc")
    options = {"SymmetricMode": True}
    solve = splu(shifted, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options).solve

    def settled(motions: np.ndarray) -> np.ndarray:
        for _ in range(_CORRECTIONS):
            motions = np.linalg.qr(solve(motions))[0]
        return motions

    motions = settled(np.random.default_rng(0).standard_normal((n, min(n, _SOUGHT))))
    # Zero rows are added, as there may be fewer rows than motions.
    violated = np.vstack([rows @ motions, np.zeros((motions.shape[1],) * 2)])
    _, seen, mixed = np.linalg.svd(violated, full_matrices=False)
    return motions @ mixed[seen <= least * np.sqrt(largest)].T, settled


# What gives a part mass, by its kind.
_BEAM_ADVICE = "Give its section rhoA and rhoI, add a mass, or add a support"
_NODE_ADVICE = "Give it a mass by add_mass(node, mass, inertia=...), or add a support"
_ROTATION_ADVICE = (
    "Give the mass an inertia by {}(..., inertia=...); or, as a point mass that does not turn, "
    'hold it by fix(node, "rotation")'
)


def _description(scene: Scene, mesh: Mesh, parts: _Parts, rates: np.ndarray) -> tuple[str, str]:
    """The beams of the body that a motion (parts, 3) moves most, its motion, and what helps."""
    middle, turn = parts.middle, rates[:, 2]
    x, y = ((middle - parts.point) / mesh.size).T
    middle_rates = rates + np.column_stack([-turn * y, turn * x, 0 * turn])
    sizes = abs(middle_rates).max(axis=1)
    part = int(np.argmax(sizes > (1 - 1e-6) * sizes.max()))  # the first of equal ones
    mode = middle_rates[part]
    if abs(mode[2]) > 1e-6 * abs(mode[:2]).max():
        # Velocity (mode0 - w y, mode1 + w x) vanishes at the pole.
        pole = middle[part] + mesh.size * np.array([-mode[1], mode[0]]) / mode[2]
        pole = np.round(pole / mesh.size, 9) * mesh.size + 0.0  # zero instead of round-off
        motion = f"can rotate about ({pole[0]:.4g}, {pole[1]:.4g})"
    else:
        direction = np.round(mode[:2] / abs(mode[:2]).max(), 6) + 0.0  # no -0
        motion = f"can move along ({direction[0]:.3g}, {direction[1]:.3g})"
    nodes_of = zip(scene.beams, mesh.nodes, strict=True)
    names = [repr(beam.name) for beam, nodes in nodes_of if parts.part_of_node[nodes[0]] == part]
    if not names:  # a part without elements is one node
        number = int(np.flatnonzero(parts.part_of_node == part)[0])
        owners = [body.name for body in scene.bodies if scene.nodes[number] in body.nodes]
        advice = _NODE_ADVICE
        if not parts.free[part, :2].any():  # it has a mass at this place
            advice = _ROTATION_ADVICE.format("add_body" if owners else "add_mass")
        return f"{scene.nodes[number]}{f' of {owners[0]}' if owners else ''} {motion}", advice
    ending = f" and {len(names) - 3} more" if len(names) > 3 else ""
    return f"beam{'s' * (len(names) > 1)} {', '.join(names[:3])}{ending} {motion}", _BEAM_ADVICE


# Below this ratio of singular values closures depend on each other; forces below this ratio are
# zero.
_DEPENDENT = 1e-7
# Motion to a configuration near by, relative to a unit of each unknown, and corrections that close
# the loops there.
_AWAY, _CLOSURES = 0.03, 60


def check_loops(scene: Scene, reduction: Reduction, loops: Loops) -> None:
    """Refuse loops whose equations depend on each other, at the start of a step.

    If they do so also in a configuration near by, joints are redundant, otherwise the start is
    singular.
    """
    G = reduction.maps.closure_derivatives()
    stresses = _dependences(G)
    redundant = stresses.shape[1]
    if not redundant:
        return
    motions = null_space(G.toarray(), _DEPENDENT)[0].T
    if len(motions) and _dependences_near_by(reduction, loops, motions) < redundant:
        raise SceneError(f"start: {loops.singularity}. Start from a position beside it")
    forces = _self_stress(scene, reduction.couplings, loops, stresses.T * loops.lengths)
    sizes = np.linalg.norm(forces, axis=(1, 2))
    connections: list[Any] = [*scene.joints, *scene.gears]
    carrying = [joint for joint in connections if sizes[joint.number] > _DEPENDENT * sizes.max()]
    centres = {body.centre.number for body in scene.bodies}
    inner = [j for j in carrying if isinstance(j, Joint) and j.is_rigid and j.a.number in centres]
    joints = [joint for joint in carrying if joint not in inner] or carrying
    yields = "a spring of a gear"
    if isinstance(joints[-1], Joint):
        slide = _slide(joints[-1], forces[joints[-1].number])
        yields = f"{slide}, or a beam in place of a body"
    raise SceneError(
        f"over-constrained: {'; '.join(map(str, joints))}: they close loops, and {redundant} of "
        f"them {'is' if redundant == 1 else 'are'} redundant: the motion is the same without, but "
        f"the forces cannot be computed. Remove one of them, or let it yield: use {yields}"
    )


def _dependences(G: scipy.sparse.csr_matrix) -> np.ndarray:
    """Combinations (closures, n) of closures that no motion changes."""
    if G.shape[0] > _FEW and not null_space(G.T.tocsr(), 10 * _DEPENDENT)[0].size:
        return np.empty((G.shape[0], 0))  # surely
    return null_space(G.toarray().T, _DEPENDENT)[0]


def _dependences_near_by(reduction: Reduction, loops: Loops, motions: np.ndarray) -> int:
    """Number of dependences after a small motion that keeps the loops closed; all if none does."""
    y = np.zeros(reduction.free)
    change = _AWAY * np.random.default_rng(0).choice([-1.0, 1.0], len(motions)) @ motions
    for _ in range(_CLOSURES):
        y[loops.unknowns] += change * loops.unit[loops.unknowns]
        closure = loops.lengths * reduction.closures_at(y, np.zeros(reduction.driven))
        G = reduction.maps.closure_derivatives()
        if abs(closure).max() < 1e-13 * loops.size:
            return _dependences(G).shape[1]
        change = -np.linalg.lstsq(G.toarray(), closure, rcond=_DEPENDENT)[0]
    return len(loops)


def _self_stress(scene: Scene, couplings: Couplings, loops: Loops, left: np.ndarray) -> np.ndarray:
    """Forces (joints, 3, n) of the joints that no load causes, for closing forces (n, closures)."""
    n = len(scene.nodes)
    forces, node_forces = (np.zeros((count, 3, len(left))) for count in (scene.joint_count, n + 1))
    for force, closure in zip(left.T, loops.closures, strict=True):
        joint, i = closure.joint, closure.component
        forces[joint.number, i] += force
        if not isinstance(joint, Joint):
            continue
        node_forces[joint.b.number, i] -= force
        node_forces[joint.a.number, i] += force  # the last row is the ground
    for i in (0, 1):
        for branch in reversed(couplings.forests[i]):
            forces[branch.joint.number, i] += branch.sign * node_forces[branch.node, i]
            node_forces[branch.parent, i] += node_forces[branch.node, i]
    for joint in couplings.sliding:
        forces[joint.number] += node_forces[joint.b.number]
    return forces


def _slide(joint: Joint, forces: np.ndarray) -> str:
    """A slide along the force that a joint transmits without load."""
    u, _, _ = np.linalg.svd(forces[:2])
    axis = np.round(u[:, 0] * np.sign(u[np.argmax(abs(u[:, 0])), 0]), 3) + 0.0
    kind = "Prismatic" if joint.turns_together else "PinInSlot"
    return f"a slide, such as a {kind} with axis=({axis[0]:g}, {axis[1]:g}) for {joint}"
