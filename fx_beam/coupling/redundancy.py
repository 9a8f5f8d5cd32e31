"""The check of closed loops: joints that hold the same motion twice, and singular starts."""

from __future__ import annotations

import numpy as np
from scipy.linalg import block_diag

from fx_beam.errors import SceneError
from fx_beam.scene.joints import Joint
from fx_beam.scene.scene import Scene

from .graph import Couplings
from .loops import Loops
from .reduction import Reduction

# Below this ratio of singular values closures depend on each other; forces below this ratio are
# zero.
_ROUNDING = 1e-7
# Motion to a configuration near by, relative to a unit of each unknown, and corrections that close
# the loops there.
_AWAY, _CORRECTIONS = 0.03, 60


def check_loops(scene: Scene, reduction: Reduction, loops: Loops) -> None:
    """Refuse loops whose equations depend on each other, at the start of a step.

    If they do so also in a configuration near by, joints are redundant, otherwise the start is
    singular.
    """
    couplings = reduction.couplings
    rank, left, right = _rank(reduction, loops)
    redundant = len(loops) - rank
    if not redundant:
        return
    if len(right) and _rank_near_by(reduction, loops, right) > rank:
        raise SceneError(f"start: {loops.singularity}. Start from a position beside it")
    forces = _forces(scene, couplings, loops, left)
    sizes = np.linalg.norm(forces, axis=(1, 2))
    carrying = [joint for joint in scene.joints if sizes[joint.number] > _ROUNDING * sizes.max()]
    centres = {body.centre.number for body in scene.bodies}
    inside = [j for j in carrying if j.is_rigid and j.a.number in centres]
    joints = [joint for joint in carrying if joint not in inside] or carrying
    raise SceneError(
        f"over-constrained: {'; '.join(map(str, joints))}: they close loops, and {redundant} of "
        f"them {'is' if redundant == 1 else 'are'} redundant: the motion is the same without, but "
        "the forces cannot be computed. Remove one of them, or let it yield: use "
        f"{_slide(joints[-1], forces[joints[-1].number])}, or a beam in place of a body"
    )


def _derivative(reduction: Reduction, loops: Loops) -> np.ndarray:
    """Derivative (closures, unknowns) of the closures by units of the loops' unknowns [m]."""
    return reduction.closure_derivatives()[:, loops.unknowns] * loops.unit[loops.unknowns]


def _rank(reduction: Reduction, loops: Loops) -> tuple[int, np.ndarray, np.ndarray]:
    """Rank of the closures, combinations (n, closures) that vanish, and motions (n, unknowns)."""
    G = _derivative(reduction, loops)
    parts = [np.linalg.svd(G[block]) for block in loops.blocks]
    largest = max([1e-300, *(values.max(initial=0.0) for _, values, _ in parts)])
    ranks = [int(np.count_nonzero(values > _ROUNDING * largest)) for _, values, _ in parts]
    left = block_diag(*(part[0][:, rank:] for part, rank in zip(parts, ranks, strict=True)))
    right = block_diag(*(part[2][rank:] for part, rank in zip(parts, ranks, strict=True)))
    return sum(ranks), left.T, right


def _rank_near_by(reduction: Reduction, loops: Loops, motions: np.ndarray) -> int:
    """Rank of the closures after a small motion that keeps the loops closed; 0 if there is none."""
    y = np.zeros(reduction.free)
    change = _AWAY * np.random.default_rng(0).choice([-1.0, 1.0], len(motions)) @ motions
    for _ in range(_CORRECTIONS):
        y[loops.unknowns] += change * loops.unit[loops.unknowns]
        closure = reduction.expand_open(y, np.zeros(reduction.driven))
        if abs(closure).max() < 1e-13 * loops.unit.max():
            return _rank(reduction, loops)[0]
        change = -np.linalg.lstsq(_derivative(reduction, loops), closure, rcond=_ROUNDING)[0]
    return 0


def _forces(scene: Scene, couplings: Couplings, loops: Loops, left: np.ndarray) -> np.ndarray:
    """Forces (joints, 3, n) of the joints that no load causes, for closing forces (n, closures)."""
    n = len(scene.nodes)
    forces, on_nodes = (np.zeros((count, 3, len(left))) for count in (scene.joint_count, n + 1))
    for force, one in zip(left.T, loops.closures, strict=True):
        forces[one.joint.number, one.component] += force
        on_nodes[one.joint.b.number, one.component] -= force
        on_nodes[one.joint.a.number, one.component] += force  # that of the ground is the last
    for i in (0, 1):
        for branch in reversed(couplings.forests[i]):
            forces[branch.joint.number, i] += branch.sign * on_nodes[branch.node, i]
            on_nodes[branch.parent, i] += on_nodes[branch.node, i]
    for joint in couplings.sliding:
        forces[joint.number] += on_nodes[joint.b.number]
    return forces


def _slide(joint: Joint, forces: np.ndarray) -> str:
    """A slide along the force that a joint transmits without load."""
    u, _, _ = np.linalg.svd(forces[:2])
    axis = np.round(u[:, 0] * np.sign(u[np.argmax(abs(u[:, 0])), 0]), 3) + 0.0
    kind = "Prismatic" if joint.turns_together else "PinInSlot"
    return f"a slide, such as a {kind} with axis=({axis[0]:g}, {axis[1]:g}) for {joint}"
