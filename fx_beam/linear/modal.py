"""Natural frequencies and mode shapes about a configuration."""

from __future__ import annotations

import numpy as np
import scipy.sparse

from fx_beam.errors import SceneError
from fx_beam.results.solution import Solution
from fx_beam.results.vibrations import Modes, modes_of
from fx_beam.scene.scene import Scene
from fx_beam.step.undamped_modes import lowest
from fx_beam.validation import is_flag, is_whole, require

from .damped_modes import lowest_damped
from .linearisation import check_equilibrium, linearised


def modes(scene: Scene, state: Solution | None = None, n: int = 6, damping: bool = True) -> Modes:
    """Compute the lowest natural frequencies, damping ratios and mode shapes.

    The stiffness is the tangent at the state: it includes the geometric stiffness, springs, dead
    loads, and added forces with a potential. Damping is the derivative of all forces by the rates,
    at rest in the state: retardation of members, drag, dampers and friction of joints, and added
    forces against the velocity. Prescribed motions, motors and internal variables are fixed.

    Of a state that turns the modes are those seen in its turning frame, with centrifugal and
    Coriolis forces; damping is by the rates seen there. A free turn is a rigid mode.

    Parameters
    ----------
    scene : Scene
        The scene.
    state : Solution, optional
        A solution whose last row is the configuration, an equilibrium, at rest or in a steady turn
        (``static(scene, spin=...)``); by default the reference configuration without loads. It may
        be a solution of another scene with the same nodes, such as one in which a mechanism is
        supported.
    n : int
        Number of modes; fewer are returned if the scene has fewer degrees of freedom with mass.
    damping : bool
        Whether damping counts; without it a damped scene has real shapes.

    Returns
    -------
    Modes
        Frequencies, damping ratios and shapes.

    Raises
    ------
    SceneError
        If the state is no equilibrium; the message says what has no balance. If the scene cannot
        vibrate: it has no mass, no unknowns, or forces that depend on the
        motion and have no potential; or if its damping at rest is infinite.
    RuntimeError
        If no modes are found, or damped ones do not converge.

    Examples
    --------
    The first bending frequency of a cantilever; the exact value is 3.516 sqrt(EI / (rhoA L^4)).

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e5, GA=1e5, EI=1.0, rhoA=1.0)
    >>> beam = scene.add_beam([(0, 0), (1, 0)], section, elements=16)
    >>> scene.clamp(beam.start)
    >>> lowest = fb.modes(scene, n=2)
    >>> round(float(lowest.angular_frequencies[0]), 1)
    3.5
    """
    require(is_whole(n, 1), "modes: n", n, "a whole number from 1 on")
    require(is_flag(damping), "modes: damping", damping, "True or False")
    about = linearised(scene, state, "modes")
    check_equilibrium(about, state, "modes")
    model, K, M = about.model, about.K, about.M
    if not M.data.any():
        raise SceneError("modes: the scene has no mass. Give a section rhoA or add a mass")
    if _asymmetry(K, model.unit_of_unknowns[about.unknowns]) > 1e-12:
        raise SceneError(
            "modes: the stiffness is not symmetric, since a load or an added virtual work depends "
            "on the motion and has no potential, or friction slips. Simulate the scene instead, "
            "linearise it, or remove this load or friction"
        )
    K = _symmetric(K)
    C = about.damping("modes") if damping and about.may_be_damped else None
    if about.coriolis is not None:
        C = about.coriolis if C is None else C + about.coriolis
    if C is None or not abs(C).max():
        omega, rigid, vectors = lowest(K, M, n)
        ratios, roots = np.zeros(len(omega)), np.where(omega < 0, -omega, 1j * omega)
    else:
        omega, rigid, ratios, roots, vectors = lowest_damped(K, C, M, n)
    return modes_of(model, about.start.q, about.T @ vectors, omega, rigid, ratios, roots)


def _symmetric(K):
    """The symmetric part; entries that are zero stay if the pattern is symmetric."""
    other = K.T.tocsr()
    if np.array_equal(K.indptr, other.indptr) and np.array_equal(K.indices, other.indices):
        other.data = (K.data + other.data) / 2
        return other
    return (K + other) / 2


def _asymmetry(K, unit: np.ndarray) -> float:
    """Largest asymmetry of a stiffness, relative to its rows, independent of the user's units."""
    gap, row = (K - K.T).tocoo(), np.repeat(np.arange(len(unit)), np.diff(K.indptr))
    work = abs(K.data) * unit[row] * unit[K.indices]
    largest = scipy.sparse.csr_matrix((work, K.indices, K.indptr)).max(axis=1).toarray()[:, 0]
    sizes = np.sqrt(largest[gap.row] * largest[gap.col])
    gaps = abs(gap.data) * unit[gap.row] * unit[gap.col]
    return float((gaps[sizes > 0] / sizes[sizes > 0]).max(initial=0.0))
