"""The rates at which a scene starts: given, checked against supports and joints, or projected."""

from __future__ import annotations

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from .beam import COMPONENTS
from .errors import SceneError
from .model import Model


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
    missing = v - T @ w
    weight = scipy.sparse.identity(model.size, format="csr")
    if scene.projects_velocities:
        weight = model.mass + _small_mass(model)
    free_T = T[:, :free]
    if free:
        normal = (free_T.T @ weight @ free_T).tocsc()
        w[:free] = scipy.sparse.linalg.spsolve(normal, free_T.T @ (weight @ missing))
    if scene.projects_velocities:
        return w
    gap = model.to_nodes(abs(T @ w - v)) / [1.0, 1.0, 1 / model.mesh.size]
    # Prescribed motion overrides what was given at its own degree of freedom.
    for key in scene.prescribed:
        gap[key] = 0.0
        _check_prescribed(model, key, v, T @ w)
    speed = (abs(model.to_nodes(v)) / [1.0, 1.0, 1 / model.mesh.size]).max()
    if gap.max() > 1e-9 * speed:
        node, component = np.unravel_index(np.argmax(gap), gap.shape)
        raise SceneError(_message(model, int(node), int(component), v, T @ w))
    return w


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
    joints = [str(j) for j in scene.joints if node in (j.a.number, j.b.number)]
    return (
        f"the initial velocities violate {' and '.join(joints) or 'a support'}: the rate of "
        f"{COMPONENTS[component]} of {where} is {given:g}, and would have to be {found:g} "
        f"(violation {abs(given - found):.3g}). Give compatible velocities to all members, or call "
        "scene.make_velocities_compatible()"
    )
