"""Linear buckling: load factors at which small displacements lose their stability."""

from __future__ import annotations

import logging
from functools import partial

import numpy as np
import scipy.linalg
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import ArpackError, LinearOperator, eigsh

from fx_beam.errors import SceneError, is_whole, require
from fx_beam.motions.initial_state import end_of
from fx_beam.results.solution import Solution
from fx_beam.results.vibrations import BucklingModes, modes_of
from fx_beam.scene.scene import Scene
from fx_beam.step.constrained_matrix import ConstrainedMatrix, warn_of_rounding
from fx_beam.step.model import Model

from .load_steps import LoadStepper, StaticOptions
from .small_loads import SmallLoads, check_forces, geometric_stiffness
from .statics import LoadPath

_log = logging.getLogger("fx_beam")

# Number of unknowns up to which matrices are full.
_FULL = 60
# Part of a rough value of the lowest load factor about which the lowest ones are sought.
_BELOW = 0.9
# A load factor that is none, relative to the smallest in size: the geometric stiffness of its mode
# is round-off.
_NONE = 1e6
# Rotation or strain by first order at a load factor beyond which all of it is round-off.
_MOST = 1e5
# Strain of an element along its chord before it buckles that is too large to be neglected.
_STRAINED = 0.1


def buckling(
    scene: Scene, state: Solution | None = None, n: int = 4, *, t: float = 0.0
) -> BucklingModes:
    r"""Compute load factors and shapes of linear buckling.

    It solves :math:`(K_0 + \lambda K_g) \varphi = 0`, with the stiffness :math:`K_0` about a state,
    and the geometric stiffness :math:`K_g`, in the shape of this state, of the first-order forces
    of the loads in members, lines and joints. Displacements before the critical load are neglected:
    where members deform much before they buckle, as shallow arches, take `static` with
    ``continuation="arc-length"``.

    Parameters
    ----------
    scene : Scene
        The scene. The load factor multiplies all loads, including the weight, natural strains,
        prescribed motions and motors; not the forces of springs that are under tension in the
        scene as it is drawn.
    state : Solution, optional
        The last row of a `static` solution at rest, with loads that do not increase, such as
        prestress or the weight (dead loads). The loads of `scene` are then those that increase. By
        default the equilibrium without loads, with springs under tension.
    n : int
        Number of load factors; fewer are given if there are fewer positive ones.
    t : float
        Time at which functions of time are evaluated [s].

    Returns
    -------
    BucklingModes
        Load factors and shapes.

    Raises
    ------
    SceneError
        If the state is unstable, of first order, free to move, moves or turns, or has natural
        strains and the scene has none; for loads that follow the motion or have a law of their own,
        contact, and nodes that slide on beams; or if no positive load factor exists.

    References
    ----------
    Bathe (1996), Finite Element Procedures, section 6.8.2.

    Examples
    --------
    A cantilever under its end load, :math:`\pi^2 EI / (4 L^2)`.

    >>> import math, fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e8, GA=1e8, EI=1.0)
    >>> column = scene.add_beam([(0, 0), (0, 1)], section, elements=8, degree=3)
    >>> scene.clamp(column.start)
    >>> load = scene.add_force(column.end, (0, -1.0))
    >>> bool(abs(fb.buckling(scene, n=1).load_factors[0] / (math.pi**2 / 4) - 1) < 1e-4)
    True
    """
    require(is_whole(n, 1), "buckling: n", n, "a whole number from 1 on")
    expected = "a Solution, such as that of fx_beam.static"
    require(isinstance(state, Solution | None), "buckling: state", state, expected)
    path = LoadPath(scene, StaticOptions(what="buckling", t=t), state)
    if state is not None:
        _check_state(state, path.model)
    first = path.unloaded_state()
    path.forcing.keep_start()
    path.stepper.path.held[:] = 0.0  # forces that hold the state do not fade
    check_forces(path.model)
    small = SmallLoads("buckling", path.stepper, first)
    if not small.acts:
        raise SceneError(
            f"buckling: no load acts at t = {path.options.t:g}. Add one to the scene, or give "
            "buckling the t at which loads that are functions of time act"
        )
    factors, vectors = _lowest(small, path.stepper, n)
    _warn_of_strains(small, path.model, factors)
    zeros = np.zeros(len(factors))
    shapes = path.stepper.motions.at_nodes(first, vectors)
    modes = modes_of(path.model, small.state.q, shapes, zeros, zeros > 0, zeros, zeros * 1j)
    return BucklingModes(factors, modes)


def _warn_of_strains(small: SmallLoads, model: Model, factors: np.ndarray) -> None:
    """Warn of load factors before which elements are stretched or shortened much."""
    ends = model.mesh.elements[:, [0, -1]]
    if not len(ends):
        return
    places = model.mesh.X + small.state.q.reshape(-1, 3)[:, :2]
    chords, moved = (np.diff(x[ends], axis=1)[:, 0] for x in (places, small.D.reshape(-1, 3)))
    strains = np.sum(chords * moved[:, :2], axis=1) / np.sum(chords**2, axis=1)
    most = int(abs(strains).argmax())
    for factor in factors[abs(strains[most]) * factors > _STRAINED][:1].tolist():
        strain, beam = factor * strains[most], model.scene.beams[model.mesh.beam_of_cell[most]]
        _log.warning(
            "buckling: at the load factor %.4g and above, beam %r would be %s by %.0f %% before it "
            "buckles, which linear buckling neglects%s. Take fx_beam.static, which finds "
            "critical_points",
            *(factor, beam.name, "stretched" if strain > 0 else "shortened", 100 * abs(strain)),
            ". What is in tension buckles by shear only, near N = GA" if strain > 0 else "",
        )


def _check_state(solution: Solution, model: Model) -> None:
    """SceneError for a state that is in no balance, moves, or has strains that would be lost."""
    state = end_of(solution)
    if solution.stats.linear:
        raise SceneError(
            "buckling: the state is of first order, so that its forces are in no balance in its "
            "shape. Take that of fx_beam.static without linear=True"
        )
    if state.v.any():
        raise SceneError(
            "buckling: the state moves or turns. Take an equilibrium at rest; for one that turns "
            "give all loads to fx_beam.static, with its spin, which counts the unstable modes"
        )
    if state.natural is not None and state.natural.any() and not model.data.natural:
        raise SceneError(
            "buckling: the state has natural strains, but the scene has none. Add one to it, of "
            "zero for one that stays: scene.add_natural_strain(beam, axial=0.0)"
        )


def _lowest(small: SmallLoads, stepper: LoadStepper, n: int) -> tuple[np.ndarray, np.ndarray]:
    """The n lowest positive load factors, and vectors (unknowns, n)."""
    motions = stepper.motions
    K = motions.extended(small.state)
    size, unit = K.free, K.units(stepper.model)
    if not size:
        raise SceneError("buckling: nothing moves")
    if not K.is_symmetric(unit) or motions.growing(small.state) != (0, 0):
        raise SceneError(
            "buckling: the state is no stable equilibrium. Reduce its loads, or support it"
        )
    Kg = geometric_stiffness(small, stepper.model, K)
    K, Kg = (A.symmetric.scaled(unit) for A in (K, Kg))
    # 1/lambda are the largest eigenvalues of -Kg in the metric of K.
    if size <= _FULL or n > size // 3:
        inverse, vectors = scipy.linalg.eigh(-Kg.matrix.toarray(), K.matrix.toarray())
    else:
        inverse, vectors = _largest(Kg.without_equations, K, n)
    order = np.argsort(-inverse)[:n]
    least = max(abs(inverse).max(initial=0.0) / _NONE, small.size() / _MOST)
    order = order[inverse[order] > least]
    if not len(order):
        raise SceneError(
            "buckling: no positive load factor: the loads make nothing unstable. Reverse them, "
            "or check that they compress a member"
        )
    vectors = vectors[:, order]
    warn_of_rounding(K.alone, K.spread(vectors), "buckling: load factors have")
    return 1 / inverse[order], unit[:size, None] * vectors


def _largest(Kg: ConstrainedMatrix, K: ConstrainedMatrix, n: int) -> tuple[np.ndarray, np.ndarray]:
    """The n largest eigenvalues of -Kg x = mu K x, if they are positive; their vectors (size, n).

    Kg is without equations.
    """
    start = np.random.default_rng(0).standard_normal(K.free)
    operator = partial(LinearOperator, (K.free, K.free), dtype=float)

    def product(A: csr_matrix) -> LinearOperator:
        return operator(lambda x: K.collected(A @ K.spread(x)))

    def inverse(matrix: ConstrainedMatrix) -> LinearOperator:
        system = matrix.system.sorted_indices()
        if matrix.is_plain:  # else entries that are zero count in the order of elimination
            system.eliminate_zeros()
        lu = matrix.factors((system.indptr, system.indices))
        if not lu.factorise(system.data):  # T^T A T is positive definite: no exchange of rows
            raise SceneError(
                "buckling: the stiffness is singular but for round-off. Support the scene, and "
                "check the units of stiffnesses: very different magnitudes are lost"
            )
        others = np.zeros(system.shape[0] - K.free)
        return operator(lambda forces: lu.solve(np.append(forces, others))[: K.free])

    A, stiffness = product(-Kg.alone), product(K.alone)
    try:
        (rough,) = eigsh(A, 1, stiffness, which="LA", Minv=inverse(K), v0=start, tol=1e-2)[0]
    except ArpackError:  # there is none apart from zero
        rough = 0.0
    if rough <= 0:
        return np.zeros(0), np.zeros((len(start), 0))
    shift = _BELOW / rough
    shifted = inverse(K + Kg.with_data(shift * Kg.system.data))
    factors, vectors = eigsh(stiffness, n, A, shift, mode="buckling", OPinv=shifted, v0=start)
    return 1 / factors, vectors
