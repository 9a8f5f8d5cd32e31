"""The rates at which a scene starts: given, checked against supports and joints, or projected."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from .beam import COMPONENTS
from .errors import SceneError
from .model import Model

_ADVICE = "Give compatible velocities to all members, or call scene.make_velocities_compatible()"


def initial_rates(model: Model, driven: np.ndarray) -> np.ndarray:
    """Rates of all columns at t = 0.

    Parameters
    ----------
    model : Model
        The model, its reduction at the start.
    driven : (driven,) float
        Rates of prescribed motions and motors [m/s, rad/s].

    Returns
    -------
    (columns,) float
        Rates of the unknowns, of the driven columns, and zero for the fixed ones.

    Raises
    ------
    SceneError
        If the given velocities violate a support or a joint and are not to be projected.
    """
    v = _given_velocity(model)
    reduction, scene = model.reduction, model.scene
    free = reduction.free
    w = np.zeros(reduction.columns)
    w[free : free + reduction.driven] = driven
    T = reduction.coupling()
    led = T @ w
    missing = v - led
    weight = scipy.sparse.identity(model.size, format="csr")
    if scene.projects_velocities:
        weight = model.mass + _small_mass(model)
    free_T = T[:, :free]
    if free:
        normal = (free_T.T @ weight @ free_T).tocsc()
        w[:free] = scipy.sparse.linalg.spsolve(normal, free_T.T @ (weight @ missing))
    if scene.projects_velocities:
        return w
    unit = [1.0, 1.0, 1 / model.mesh.size]
    kept = T @ w
    gap = model.to_nodes(abs(kept - v)) / unit
    # Prescribed motion overrides what was given at its own degree of freedom.
    for key in scene.prescribed:
        gap[key] = 0.0
        _check_prescribed(model, key, v, kept)
    v[model.prescribed] = kept[model.prescribed]
    # The rates of driven motion are differences, and no more accurate than that.
    speed, drive = (abs(model.to_nodes(rates) / unit).max() for rates in (v, led))
    tolerance = 1e-9 * speed + 1e-5 * drive
    if gap.max() > tolerance:
        _check_joints(model, v, driven, tolerance)
        node, component = np.unravel_index(np.argmax(gap), gap.shape)
        raise SceneError(_message(model, int(node), int(component), v, kept))
    return w


def acceleration_of(mass: scipy.sparse.spmatrix, force: np.ndarray) -> np.ndarray:
    """Accelerations (n,) under generalised forces (n,), zero where there is no mass.

    Where several unknowns move one mass, such as the displacement and the rotation of a massless
    node that carries it at an offset, their accelerations are the smallest that fit.

    Parameters
    ----------
    mass : (n, n) sparse matrix
        Mass matrix of the unknowns.
    force : (n,) float
        Generalised forces.

    Returns
    -------
    (n,) float
        Accelerations.
    """
    a = np.zeros(len(force))
    diagonal = mass.diagonal()
    moving = np.flatnonzero(diagonal > 0)
    if len(moving):
        scale = scipy.sparse.diags(diagonal[moving] ** -0.5)
        scaled = (scale @ mass.tocsr()[moving][:, moving] @ scale).tocsc()
        b = scale @ force[moving]
        try:
            factors = scipy.sparse.linalg.splu(scaled)
            singular = abs(factors.U.diagonal()).min() < 1e-10
        except RuntimeError:
            singular = True
        if singular:
            a[moving] = scale @ np.linalg.lstsq(scaled.toarray(), b, rcond=1e-10)[0]
        else:
            a[moving] = scale @ factors.solve(b)
    return a


def _given_velocity(model: Model) -> np.ndarray:
    """Vector of initial rates as given, zero elsewhere."""
    mesh, scene = model.mesh, model.scene
    v = np.full((len(mesh.X), 3), np.nan)
    for item in scene.velocities:
        for node in mesh.nodes_of(scene, item.target):
            x, y = map(float, mesh.X[node])
            value = np.concatenate([item.value(x, y), item.spin(x, y)])
            if not np.isfinite(value).all():
                raise SceneError(f"initial velocity at ({x:g}, {y:g}) is {value}, not finite")
            if (abs(v[node] - value) > 1e-9 * abs(value).max()).any():
                raise SceneError(f"two initial velocities at ({x:g}, {y:g}): {v[node]} and {value}")
            v[node] = value
    return model.from_nodes(np.nan_to_num(v))


def _check_prescribed(model: Model, key: tuple[int, int], v: np.ndarray, kept: np.ndarray) -> None:
    given, moved = model.to_nodes(v)[key], model.to_nodes(kept)[key]
    if given != 0 and abs(given - moved) > 1e-3 * max(abs(given), abs(moved)):
        node, component = key
        raise SceneError(
            f"{model.scene.nodes[node]} moves as prescribed in {COMPONENTS[component]} at the rate "
            f"{moved:g} and has another initial rate, {given:g}"
        )


def _check_joints(model: Model, v: np.ndarray, driven: np.ndarray, tolerance: float) -> None:
    """Refuse rates with which the nodes of a joint part, naming the joint that is worst."""
    nodes, scene = np.vstack([model.to_nodes(v), np.zeros(3)]), model.scene  # the ground is last
    rates = driven[len(model.prescribed) :]
    motors = {(j.number, name): r for (j, name), r in zip(model.motors, rates, strict=True)}
    worst, text = tolerance, ""
    for joint in scene.joints:
        a, b = nodes[joint.a.number], nodes[joint.b.number]
        arm, gap = joint.offset, b[:2] - a[:2]
        if joint.axis is not None:
            arm = arm + joint.start()[0] * joint.axis
        gap = gap - a[2] * np.array([-arm[1], arm[0]])
        if joint.axis is not None:
            slide = motors.get((joint.number, "slide"), gap @ joint.axis)
            gap = gap - slide * joint.axis
        turn = b[2] - a[2] - motors.get((joint.number, "rotation"), 0.0)
        for size, what in (
            (np.hypot(*gap), f"its nodes part at a rate of {np.hypot(*gap):.3g}"),
            (abs(turn) * model.mesh.size * joint.turns_together, f"b turns at {turn:.3g} too much"),
        ):
            if size > worst:
                worst, text = size, f"{joint}: {what}"
    if text:
        raise SceneError(f"the initial velocities violate {text}. {_ADVICE}")


def _small_mass(model: Model) -> scipy.sparse.spmatrix:
    """A mass for what has none, so small that it changes no other rate."""
    diagonal = model.mass.diagonal()
    size = np.full(model.size, 1.0)
    size[model.turns] = model.mesh.size**2
    scale = (diagonal / size).max()
    return scipy.sparse.diags(np.where(model.massless, 1e-10 * (scale or 1.0) * size, 0.0))


def _message(model: Model, node: int, component: int, v: np.ndarray, kept: np.ndarray) -> str:
    scene = model.scene
    given, found = model.to_nodes(v)[node, component], model.to_nodes(kept)[node, component]
    x, y = model.mesh.X[node]
    where = f"node {node} at ({x:g}, {y:g})"
    if (node, component) in scene.fixed:
        return (
            f"{where} is supported in {COMPONENTS[component]} and has an initial rate of {given:g} "
            "there; it must be 0"
        )
    return (
        f"the initial velocities violate a support: the rate of {COMPONENTS[component]} of {where} "
        f"is {given:g}, and would have to be {found:g}. {_ADVICE}"
    )
