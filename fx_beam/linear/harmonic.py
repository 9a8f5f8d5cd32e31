"""Steady vibrations under a harmonic load, over its frequency."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse

from fx_beam.errors import LARGEST, SceneError, numbers, require
from fx_beam.results.solution import Solution
from fx_beam.results.vibrations import FrequencyResponse
from fx_beam.scene.beam import COMPONENTS, Node
from fx_beam.scene.joints import GROUND, Joint
from fx_beam.scene.loads import check_node
from fx_beam.scene.scene import Scene
from fx_beam.step.sparse_lu import pivoted_lu

from .linearisation import Linearisation, check_equilibrium, linearised

# Motion per force, in the units of the equations' diagonal, at which only rounding bounds it.
_UNBOUNDED = 1e14


def frequency_response(
    scene: Scene,
    load: tuple[Node, Sequence[complex]],
    at: Node | Joint,
    frequencies: Sequence[float],
    state: Solution | None = None,
) -> FrequencyResponse:
    r"""Compute steady vibrations under a harmonic load, for small amplitudes.

    :math:`(K + i \omega C - \omega^2 M) \hat x = \hat F`, with the stiffness, damping and mass of
    `modes`, and one factorisation for each frequency. The loads of the scene do not vibrate; they
    count in the state. Prescribed motions, motors and internal variables are fixed.

    Parameters
    ----------
    scene : Scene
        The scene.
    load : (Node, components)
        The node and the amplitudes (fx, fy) of its force [N], or (fx, fy, moment) with a moment
        [N m]. Complex ones have phases of their own.
    at : Node or Joint
        The node whose motion is wanted, or the joint whose free coordinates are.
    frequencies : (n,) float
        Frequencies of the load [Hz], zero or positive.
    state : Solution, optional
        A solution whose last row is the configuration, an equilibrium, at rest or in a steady turn;
        by default the reference configuration without loads, as for `modes`. In a turn the load and
        the motion are those seen in the frame that turns.

    Returns
    -------
    FrequencyResponse
        Complex amplitudes.

    Raises
    ------
    SceneError
        For a node, load, joint or frequency that is not one, a state that is no equilibrium, or if
        the scene has no unknowns.
        If the motion has no bound: at a natural frequency without damping, or at 0 Hz for a scene
        that moves freely.

    Examples
    --------
    A cantilever, at its first natural frequency of 0.56 Hz: as 1/(2 zeta) of the static deflection.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e5, GA=1e5, EI=1.0, rhoA=1.0, retardation=0.01)
    >>> beam = scene.add_beam([(0, 0), (1, 0)], section, elements=8, degree=2)
    >>> scene.clamp(beam.start)
    >>> lowest = fb.modes(scene, n=1)
    >>> f = float(lowest.frequencies[0])
    >>> response = fb.frequency_response(scene, (beam.end, (0.0, 0.01)), beam.end, [0.0, f])
    >>> static, resonant = response.component("y")
    >>> round(float(abs(static)), 5), round(float(abs(resonant / static)), 1)
    (0.00333, 27.6)
    """
    what = "frequency_response"
    about = linearised(scene, state, what)
    check_equilibrium(about, state, what)
    force = _force(about, load, f"{what}: load")
    names, rows = _rows(about, at, f"{what}: at")
    f = _checked_frequencies(frequencies, f"{what}: frequencies")
    K, M = about.K, about.M
    C = about.damping(what) if about.may_be_damped else 0 * K
    if about.coriolis is not None:
        C = C + about.coriolis
    values = np.empty((len(f), len(names)), dtype=complex)
    scale = np.sqrt(abs(K.diagonal()) + (2 * np.pi * f.max()) ** 2 * M.diagonal())
    scale[scale == 0] = 1.0
    for k, w in enumerate(2 * np.pi * f):
        try:
            x = pivoted_lu(K + 1j * w * C - w**2 * M).solve(force)
        except RuntimeError:  # a pivot is zero
            x = np.full(len(scale), np.inf)
        if not np.linalg.norm(scale * x) < _UNBOUNDED * np.linalg.norm(force / scale):
            raise SceneError(
                f"{what}: at {f[k]:g} Hz the motion has no bound: this is a natural frequency "
                "without damping, or the scene moves freely at 0 Hz. Add damping or a support, or "
                "leave this frequency out"
            )
        values[k] = rows @ x
    return FrequencyResponse(at, f, names, values)


def _checked_frequencies(frequencies, what: str) -> np.ndarray:
    f = numbers(frequencies)
    fits = f.ndim == 1 and f.size and (f >= 0).all() and (f <= LARGEST).all()
    require(bool(fits), what, frequencies, "a list of numbers [Hz], zero or positive")
    return f


def _force(about: Linearisation, load, what: str) -> np.ndarray:
    """Generalised forces (free,) of the load."""
    fits = isinstance(load, tuple | list) and len(load) == 2
    wanted = "a node and its amplitudes, such as (beam.end, (0.0, 1.0))"
    require(fits, what, load, wanted)
    node, components = load
    check_node(about.scene, node, what)
    given = components if isinstance(components, list | tuple) or np.ndim(components) else ()
    parts = numbers([(x.real, x.imag) if np.iscomplexobj(x) else (x, 0.0) for x in given])
    fits = parts.shape in ((2, 2), (3, 2)) and bool((abs(parts) <= LARGEST).all())
    require(fits, f"{what} on {node}", components, "(fx, fy) or (fx, fy, moment)")
    amplitudes = parts @ (1, 1j)
    full = np.zeros(about.model.size, dtype=complex)
    full[about.model.mesh.dofs[node.number][: len(amplitudes)]] = amplitudes
    force = about.T.T @ full
    if not force.any():
        raise SceneError(
            f"{what} on {node} moves nothing: it is zero, or supports take all of it. Give "
            "components in free directions"
        )
    return force


def _rows(about: Linearisation, at, what: str):
    """Names of the components, and the matrix (m, free) that gives them from the unknowns."""
    model, T = about.model, about.T
    dofs, scene = model.mesh.dofs, about.scene
    if not isinstance(at, Joint):
        check_node(scene, at, what)
        return COMPONENTS, T[dofs[at.number]]
    if at not in scene.joints:
        raise SceneError(f"{what}: {at} is not a joint of the scene; take what add_joint returned")
    rows = {}
    free = at.coordinates.keys() - at.driven
    if "slide" in free:
        rows["slide"] = about.columns[model.couplings.slides[at.number]]
    if "rotation" in free:
        a, b = (
            T[dofs[node.number, 2]] if node is not GROUND else 0 * T[0] for node in (at.a, at.b)
        )
        rows["angle"] = b - a
    if not rows:
        raise SceneError(f"{what}: {at} has no free coordinate. Take one of its nodes")
    return tuple(rows), scipy.sparse.vstack(list(rows.values()))
