"""The geometric stiffness of forces that small loads cause, in the shape of a state."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from fx_beam.coupling.graph import joints_with_arms
from fx_beam.errors import SceneError
from fx_beam.fem.mesh import rotation_of
from fx_beam.scene.beam import Node
from fx_beam.scene.joints import GROUND
from fx_beam.step.model import Model

from .load_steps import LoadStepper
from .small_loads import SmallLoads
from .virtual_strains import Axes


def check_forces(model: Model) -> None:
    """SceneError for forces whose geometric stiffness is not known."""
    scene, unsupported = model.scene, ""
    if scene.virtual_works or any(line.force for line in scene.forces_between):
        unsupported = "forces with a law of their own"
    if len(model.points.followers):
        unsupported = "loads that follow the motion, so that stability depends on masses"
    if scene.contacts or model.couplings.sliding:
        unsupported = "contact" if scene.contacts else "nodes that slide on beams"
    if unsupported:
        raise SceneError(
            f"buckling: the scene has {unsupported}. Take fx_beam.static, which finds "
            "critical_points"
        )


def geometric_stiffness(small: SmallLoads, stepper: LoadStepper) -> scipy.sparse.csr_matrix:
    """dK/dlambda (unknowns, unknowns) by forces alone: displacements stay those of the state."""
    model, motions = stepper.model, stepper.motions
    K = _beam_part(small, model) + _line_part(small, model)
    motions.stiffness(small.state)  # the couplings are then those of this state
    T = motions.coupling()
    return (T.T @ K @ T + _joint_part(small, model, T)).tocsr()


def _assembled(dofs: np.ndarray, blocks: np.ndarray, size: int) -> scipy.sparse.csr_matrix:
    """Matrix (size, size) of blocks (n, k, k) by their degrees of freedom (n, k)."""
    rows = np.repeat(dofs, dofs.shape[1], axis=1).ravel()
    columns = np.tile(dofs, dofs.shape[1]).ravel()
    return scipy.sparse.csr_matrix((blocks.ravel(), (rows, columns)), (size, size))


def _beam_part(small: SmallLoads, model: Model) -> scipy.sparse.csr_matrix:
    """Part (size, size) of N and Q: the second variation of N eps + Q gamma (eqs 9 and 10)."""
    # With t and n along and across the section: N (2 n.du' dpsi - t.phi' dpsi^2) and
    # -Q (2 t.du' dpsi + n.phi' dpsi^2).
    mesh, size = model.mesh, model.size
    if not model.scene.beams:
        return scipy.sparse.csr_matrix((size, size))
    weights, values, slopes, dphi, t, n = Axes.of(mesh, small.state.q)
    nodes, count = mesh.elements, mesh.elements.shape[1]
    N, Q = (_slopes_of(small, model, name)[..., None] for name in "NQ")
    turned = -((N * t + Q * n) * dphi).sum(axis=-1)
    # du' is a slope by J, and the integral has the weight J.
    mixed = np.einsum("g,ga,egi,gb->eaib", weights, slopes, N * n - Q * t, values)
    blocks = np.zeros((len(nodes), count, 3, count, 3))
    blocks[:, :, :2, :, 2] = mixed
    blocks[:, :, 2, :, :2] = mixed.transpose(0, 3, 1, 2)
    blocks[:, :, 2, :, 2] = np.einsum("g,eg,ga,gb->eab", weights, turned, values, values)
    width = 3 * count
    return _assembled(mesh.dofs[nodes].reshape(-1, width), blocks.reshape(-1, width, width), size)


def _slopes_of(small: SmallLoads, model: Model, name: str) -> np.ndarray:
    """Resultants (cells, points) by the load factor."""
    parts = []
    for beam in model.scene.beams:
        rows = getattr(small.solution.resultants(beam), name)
        parts.append(small.slope(rows).reshape(beam.elements, -1))
    return np.concatenate(parts)


def _line_part(small: SmallLoads, model: Model) -> scipy.sparse.csr_matrix:
    """Part (size, size) of lines and ropes: F / l across each straight part of length l."""
    # What holds nodes to the ground has a fixed direction.
    lines, size = [line for line in model.scene.forces_between if not line.to_ground], model.size
    if not lines:
        return scipy.sparse.csr_matrix((size, size))
    forces = small.slope(small.solution.recorded("line_forces"))
    positions = model.mesh.X + small.state.q.reshape(-1, 3)[:, :2]
    # The degrees of freedom of a fixed point are behind all others, and left out at the end.
    fixed = np.full(2, size)
    dofs, blocks = [], []
    for line in lines:
        points, node_dofs = line.points, model.mesh.dofs[:, :2]
        places = [positions[p.number] if isinstance(p, Node) else p.position for p in points]
        numbers = [node_dofs[p.number] if isinstance(p, Node) else fixed for p in points]
        for k, arm in enumerate(line.straight(np.diff(places, axis=0))):
            length = np.hypot(*arm)
            normal = np.eye(2) - np.outer(arm, arm) / length**2
            blocks.append(forces[line.number] / length * np.kron([[1, -1], [-1, 1]], normal))
            dofs.append(np.concatenate(numbers[k : k + 2]))
    return _assembled(np.array(dofs), np.array(blocks), size + 1)[:size, :size]


def _joint_part(
    small: SmallLoads, model: Model, T: scipy.sparse.csr_matrix
) -> scipy.sparse.csr_matrix:
    """Part (unknowns, unknowns) of forces f in joints: f.d2x of b at x = x_a + R (arm + s axis).

    Forces change by the loads as they are seen from a, like N and Q of a stiff member.
    """
    reduction, state, size = model.reduction, small.state, model.size
    arm_joints = joints_with_arms(model.couplings, model.scene)  # of the present scene
    joints = [joint for joint in arm_joints if joint.a is not GROUND]
    dependence = reduction.maps.dependence_matrix()[:, reduction.independent]
    # Rotations of a, then slides.
    motions = scipy.sparse.vstack([T, dependence], "csr")
    forces = small.solution.recorded("joint_forces")[..., :2]
    slopes, entries = small.slope(forces), []
    for joint in joints:
        turn, number = rotation_of(joint.a), joint.number
        (x, y), psi = forces[0, number], state.q[turn]
        f = slopes[number] - small.D[turn] * np.array([-y, x])
        turned = np.array([[np.cos(psi), -np.sin(psi)], [np.sin(psi), np.cos(psi)]])
        arm, slide = turned @ joint.offset, size + model.couplings.slides.get(number, 0)
        if joint.axis is not None:
            axis = turned @ joint.axis
            arm = arm + state.slides[number] * axis
            mixed = f @ (-axis[1], axis[0])
            if number in model.couplings.slides:
                entries += [(turn, slide, mixed), (slide, turn, mixed)]
        entries.append((turn, turn, -f @ arm))
    rows, columns, values = np.reshape(entries, (-1, 3)).T
    places, shape = (rows.astype(int), columns.astype(int)), (motions.shape[0],) * 2
    return motions.T @ scipy.sparse.csr_matrix((values, places), shape) @ motions
