"""Imperfect scenes: the reference shape with a mode added."""

from __future__ import annotations

import copy

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.linear.modal import Modes
from fx_beam.scene.beam import Beam, inner_positions, lagrange_and_slopes
from fx_beam.scene.scene import Scene
from fx_beam.validation import as_float, is_number, is_whole, require


def imperfect(scene: Scene, modes: Modes, size: float, mode: int = 0) -> Scene:
    """Copy of a scene whose reference shape, without stress, has a mode added.

    Elements of degree 2 and 3 become curved. Handles of the scene, such as beams, are not those of
    the copy: its own are in ``copy.beams`` and ``copy.nodes``, in the same order. `Beam.node` of
    the copy takes the fractions of the scene.

    Parameters
    ----------
    scene : Scene
        The perfect scene, of beams that are joined at nodes, without bodies.
    modes : Modes
        Modes of this scene: of a critical point, or of `modes`.
    size : float
        Largest displacement of a node [m]; negative against the mode, whose sign follows the rule
        of `Modes`.
    mode : int
        Number of the mode.

    Returns
    -------
    Scene
        The imperfect scene.

    Raises
    ------
    SceneError
        If the modes belong to another scene, or if joints have offsets, guides or sleeves, whose
        arms would change.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> column = scene.add_beam([(0, 0), (0, 1)], fb.Section(EA=1e4, GA=1e4, EI=1.0), elements=8)
    >>> scene.pin(column.start)
    >>> scene.fix(column.end, "x")
    >>> load = scene.add_force(column.end, (0, -12.0))
    >>> point, = fb.static(scene, steps=4).critical_points
    >>> crooked = fb.imperfect(scene, point.modes, 0.001)
    >>> round(crooked.beams[0].node(0.5).x, 6)
    0.001
    """
    require(isinstance(scene, Scene), "imperfect: scene", scene, "an fx_beam.Scene")
    require(is_number(size), "imperfect: size", size, "a finite number [m]")
    fits = isinstance(modes, Modes) and is_whole(mode, 0, len(modes) - 1)
    require(fits, "imperfect: mode", mode, "the number of one of the modes")
    nodes = np.array([[node.x, node.y] for node in scene.nodes]).reshape(-1, 2)
    X = np.vstack([nodes, *(inner_positions(beam) for beam in scene.beams)])
    if len(X) != len(modes.positions) or {*modes.beams} != {beam.name for beam in scene.beams}:
        raise SceneError("imperfect: the modes belong to another scene, with other nodes")
    if scene.bodies or any(not joint.is_index for joint in scene.joints):
        raise SceneError(
            "imperfect: bodies, and joints with offsets or guides, are rigid. Give the scene its "
            "imperfect shape when you build it"
        )
    moved = modes.shapes[mode, :, :2].real
    X += as_float(size) / np.hypot(*moved.T).max() * moved
    new = copy.copy(scene)
    for node, (x, y) in zip(new.nodes, X.tolist(), strict=False):
        object.__setattr__(node, "x", x)
        object.__setattr__(node, "y", y)
    for beam in new.beams:
        _bend(beam, X[modes.nodes_of_beam[beam.name]])
    X = X[: len(nodes)]
    new._corners = X.min(axis=0).tolist(), X.max(axis=0).tolist()
    return new


def _bend(beam: Beam, X: np.ndarray) -> None:
    """Set the positions (elements * degree + 1, 2) of all nodes of a beam in order."""
    p = beam.degree
    of_elements = X[p * np.arange(beam.elements)[:, None] + np.arange(p + 1)]
    places, weights = np.polynomial.legendre.leggauss(6)
    slopes = lagrange_and_slopes(np.linspace(-1, 1, p + 1), places)[1]
    along = np.linalg.norm(np.einsum("gi,eix->egx", slopes, of_elements), axis=2)
    fractions = beam.s / beam.length if beam.fractions is None else beam.fractions
    changes = {"s": np.concatenate([[0.0], np.cumsum(along @ weights)]), "fractions": fractions}
    if p > 1:
        changes["inner"] = of_elements[:, 1:-1].copy()
    for name, values in changes.items():
        values.setflags(write=False)
        object.__setattr__(beam, name, values)
