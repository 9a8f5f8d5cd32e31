"""Modes about a state: frequencies, damping, participation, and outputs under their inertia."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np
import scipy.linalg

from fx_beam.equilibria.path_equations import PathEquations
from fx_beam.equilibria.small_loads import SmallForces
from fx_beam.errors import SceneError, is_flag, is_whole, require, vector
from fx_beam.fem.point_values import bristles_of
from fx_beam.laws.interval import Rest
from fx_beam.motions.evaluation import solution_of
from fx_beam.motions.motion_setup import stats_of
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.results.vibrations import Excitation, Modes, modes_of
from fx_beam.scene.outputs import Output, check_linear
from fx_beam.scene.scene import Scene
from fx_beam.step.constrained_matrix import ConstrainedMatrix, warn_of_rounding
from fx_beam.step.equations import acceleration_of
from fx_beam.step.forcing import LoadForcing
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.recorder import Record, Recorder
from fx_beam.step.stepper import LoadLoop

from .linearisation import DampedPencil, Linearisation, Weighted, bends, linearised, split

# -- Outputs under forces of inertia beside a state, to first order -----------------------------


# Error of first-order equilibrium from which on forces are not those of the stiffness.
_AGREE = 1e-6


def inertia_outputs(
    about: Linearisation, accelerations: np.ndarray, outputs: Mapping[str, Output]
) -> dict[str, np.ndarray]:
    """Changes (n, ...) of outputs, by name, under forces -M a, a (n, n_node, 3)."""
    check_linear(about.scene, outputs, "spectrum")
    if about.frame is not None:
        raise SceneError("spectrum: the state turns. Take modes of a state at rest")
    model, start = about.model, replace(about.start, t=about.factor)
    with model.lock:
        stats = stats_of(model, solver="sparse lu", static=True)
        forcing = LoadForcing(model, about.start.t)
        forcing.stay(start)
        loop = LoadLoop(forcing, NewtonOptions(), stats)
        path = PathEquations(loop)
        small = [_small_forces(about, path, start, a.ravel()) for a in accelerations]
        # Of each its states but that without forces, which all share.
        states = [start, *(state for each in small for state in each.states[1:])]
        recorder = Recorder(model, np.arange(len(states), dtype=float), Record())
        for state in states:
            loop.record(state, recorder)
    rest = Rest(forcing.time, np.full(len(states), start.t))
    solution = solution_of(recorder, stats, lambda: start, rest=rest)
    rows = np.insert(np.reshape(np.arange(1, len(states)), (len(small), -1)), 0, 0, axis=1)
    pairs, changes = [*zip(small, rows, strict=True)], dict[str, np.ndarray]()
    for name, output in outputs.items():
        values = solution.value(output)
        changes[name] = np.array([each.slope(values[numbers]) for each, numbers in pairs])
    return changes


def _small_forces(
    about: Linearisation, path: PathEquations, start: State, a: np.ndarray
) -> SmallForces:
    """The states under small parts of the forces of accelerations a (size,)."""
    force = -(about.model.masses.matrix @ a)
    x = about.stiffness.solve(about.unknown_forces(force))
    y, D = (about.columns @ x)[: path.model.reduction.free], about.at_nodes(x[:, None])[:, 0]
    small = SmallForces(path, start, about.loads, y, D, force, a)
    if not small.error < _AGREE:
        raise SceneError(
            "spectrum: small motions there and back from the state differ, as friction slips, or "
            "a material yields. Take another state, or simulate the scene"
        )
    return small


# -- Natural frequencies and mode shapes about a configuration, also damped ones ----------------


# A root is known when inverse iteration changes it by less, relative to its size.
_CLOSE = 1e-9
_ROUNDS = 20
# A stiffness that is none, relative to its own diagonal.
_SINGULAR = 1e-11
# Most unknowns with damping and without mass whose motions are all in a subspace.
_RELAXING = 12


class ModeParts(NamedTuple):
    """Modes, lowest first."""

    #: Roots lambda (n,) [1/s]: of a pair the one above the real axis, of two real ones the larger.
    roots: np.ndarray
    #: Natural angular frequencies (n,) [rad/s]; of real roots that grow -lambda.
    frequencies: np.ndarray
    #: Damping ratios (n,): above 1 for overdamped modes, nan for real roots that grow.
    ratios: np.ndarray
    #: Vectors (size, n) of modal mass 1.
    vectors: np.ndarray

    def only(self, chosen: np.ndarray | slice) -> ModeParts:
        """The modes of some numbers, or of a mask."""
        return ModeParts(*(part[..., chosen] for part in self))


def _not_rigid(
    pencil: DampedPencil, n: int, undamped: np.ndarray, rigid: np.ndarray, unit: float
) -> ModeParts:
    """The n lowest damped modes, from undamped ones (size, m), beside rigid ones (size, k).

    `unit` [rad/s] has the size of the lowest angular frequency, but is no root. A Rayleigh-Ritz
    method; inverse iteration at the roots extends its subspace.
    """
    K, C, M, shifted = pencil.K, pencil.C, pencil.M, pencil.matrix_at(unit)
    Z, zeros = _untouched(C, shifted, rigid, unit)
    masses = M.diagonal()
    MZ, scale = M @ Z, (abs(K.diagonal()) + unit**2 * masses) ** -0.5
    relaxing = np.flatnonzero((masses == 0) & (C.diagonal() != 0))
    start = [undamped, shifted.solve(C @ undamped), rigid]
    apart = relaxing[: len(relaxing) * (len(relaxing) <= _RELAXING)]
    whole = len(masses) <= 40 + sum(part.shape[1] for part in start)
    V = np.diag(scale) if whole else _independent(start, scale, apart)
    values: np.ndarray = np.empty(0)
    for _ in range(_ROUNDS):
        k, c, m = (V.T @ (A @ V) for A in (K, C, M))
        # Rigid motions without damping are double roots at zero: moved away, since they are known.
        k += (1e3 * unit) ** 2 * (V.T @ MZ) @ (MZ.T @ V)
        damped = _roots(k, c, m, unit, zeros, len(relaxing))
        damped = damped._replace(vectors=V @ damped.vectors)
        moved = (abs(MZ.T @ damped.vectors) ** 2).sum(axis=0) > 0.5
        damped = damped.only(np.flatnonzero(~moved)[:n])
        close = _CLOSE * abs(damped.roots) + _rounding(K, C, damped)
        changes = abs(damped.roots[:, None] - values).min(axis=1, initial=np.inf)
        new = np.flatnonzero(changes > close)
        if whole or not len(new):
            return damped
        values = damped.roots
        nearer = (_nearer(pencil, values[k], damped.vectors[:, k]) for k in new)
        V = _independent([V, *nearer], scale, apart)
    raise RuntimeError(
        f"modes: {len(new)} of {n} damped modes did not converge. Try fewer modes, or leave "
        "damping out by damping=False"
    )


def _rounding(K, C, damped: ModeParts) -> np.ndarray:
    """Rounding errors (n,) of the roots."""
    sizes, root = abs(damped.vectors), abs(damped.roots)
    work = (sizes * (abs(K) @ sizes + root * (abs(C) @ sizes))).sum(axis=0)
    # The derivative of lambda^2 + lambda c + k at its root; bounded near critical damping.
    slope = np.maximum(2 * abs(damped.roots.imag), 1e-3 * root)
    return 100 * np.finfo(float).eps * work / slope


def _untouched(C, shifted, R: np.ndarray, unit: float) -> tuple[np.ndarray, int]:
    """Combinations Z (size, k) of rigid modes R with C Z = 0, and roots at zero of the others.

    A damped one has a single root at zero; one that Coriolis forces turn has two, since another
    spin is another steady turn.
    """
    if not R.size:
        return R, 0
    force = C @ R
    # Squares of damping rates, relative to the unit of angular frequencies.
    _, squares, turned = scipy.linalg.svd(force.T @ shifted.solve(force))
    alone = squares < 1e-10
    moved = R @ turned[~alone].T
    rates = scipy.linalg.svdvals(moved.T @ (C @ moved)) if moved.size else squares[:0]
    return R @ turned[alone].T, moved.shape[1] + int((rates < 1e-5 * unit).sum())


def _independent(parts: list[np.ndarray], scale: np.ndarray, apart: np.ndarray) -> np.ndarray:
    """Basis (size, k) of the span of columns (size, n).

    Unknowns `apart` have unit vectors of their own: without mass they have a modal mass of zero.
    """
    columns = np.column_stack(parts) / scale[:, None]
    columns[apart] = 0.0
    sizes = np.linalg.norm(columns, axis=0)
    unit_columns = columns[:, sizes > 0] / sizes[sizes > 0]
    basis, R, _ = scipy.linalg.qr(unit_columns, mode="economic", pivoting=True)
    alone = np.arange(len(scale))[:, None] == apart
    return scale[:, None] * np.column_stack([basis[:, abs(R.diagonal()) > 1e-9], alone])


def _nearer(pencil: DampedPencil, root: complex, x: np.ndarray) -> np.ndarray:
    """Real and imaginary part (size, 2) after a step of inverse iteration at a root."""
    try:
        x = pencil.matrix_at(complex(root)).solve(2 * root * (pencil.M @ x) + pencil.C @ x)
    except RuntimeError:  # the root is exact
        return np.column_stack([x.real, x.imag])
    return np.column_stack([x.real, x.imag]) / abs(x).max()


def _roots(k, c, m, unit: float, zeros: int, relaxing: int) -> ModeParts:
    """All modes of small dense matrices, lowest first, without motions that only decay.

    There are so many `zeros`, simple roots at zero, and at most so many unknowns `relaxing`, with
    damping and without mass.
    """
    c, m = unit * c, unit**2 * m
    basis, has_mass = np.eye(len(m)), m.diagonal() > 0
    heavy, light = split(m, basis[:, has_mass])
    if light.shape[1]:  # round-off of their mass would make infinite roots finite
        basis, masses = np.hstack([heavy, light, basis[:, ~has_mass]]), heavy.shape[1]
        k, c, m = (basis.T @ A @ basis for A in (k, c, m))
        m[masses:], m[:, masses:] = 0.0, 0.0
    # Linear in (x, lambda x), inverse about the shift 1: the low roots come out best.
    size = len(k)
    left, right = np.hsplit(-scipy.linalg.solve(k + c + m, np.hstack([m + c, m])), 2)
    mu, vectors = np.linalg.eig(np.block([[left, right], [np.eye(size) + left, right]]))
    finite = np.flatnonzero(abs(mu) > 1e-14 * abs(mu).max())
    order = np.argsort(abs(1 + 1 / mu[finite]))
    half = mu[finite[order]].imag <= 0  # one of each pair
    modes, moves = finite[order[half]], np.flatnonzero(half) >= zeros
    mu, x = mu[modes], vectors[:size, modes]
    root = 1 + 1 / mu
    rounding = 1e-12 * np.einsum("ij,ij->j", abs(x), abs(m) @ abs(x))
    k, c, m = (np.einsum("ij,ij->j", x.conj(), A @ x) for A in (k, c, m))
    k, m = k.real, m.real
    massive = m > np.maximum(1e-18 * abs(k), rounding)
    real = mu.imag == 0
    # Of two real roots the larger: the smaller is its partner, exactly so in proportional damping.
    larger = real & (2 * root.real * m + c.real > 0)
    modes = massive & moves & (~real | larger)
    # Without a partner are those of motions that have damping but hardly any mass.
    alone = min(relaxing, 2 * np.sum(massive & larger) - np.sum(massive & real))
    decaying = np.flatnonzero(massive & larger & (root.real < 0))
    lightest = decaying[np.argsort(m[decaying] / c.real[decaying])]
    modes[lightest[: max(0, alone)]] = False
    k, c, m, x, root, real = k[modes], c[modes], m[modes], x[:, modes], root[modes], real[modes]
    grows = real & (root.real > 0)
    natural = np.where(real, np.sqrt(abs(k / m)), abs(root))
    ratio = np.where(real, c.real / (2 * m * natural), -root.real / natural)
    still = ~real & (abs(ratio) < 1e-12)  # rounding must not look like growth
    ratio, root = np.where(still, 0.0, ratio), np.where(still, 1j * root.imag, root)
    natural, ratio = np.where(grows, -root.real, natural), np.where(grows, np.nan, ratio)
    vectors = unit * (basis @ x) / np.sqrt(m)
    return ModeParts(unit * root, unit * natural, ratio, vectors).only(np.argsort(natural))


def rayleigh(frequencies: Sequence[float], ratios: Sequence[float]) -> tuple[float, float]:
    r"""Choose Rayleigh damping C = alpha M + tau K for two given damping ratios.

    A mode of angular frequency omega then has the damping ratio :math:`\zeta = \alpha / (2 \omega)
    + \tau \omega / 2`: lower between the two frequencies, higher outside.

    Parameters
    ----------
    frequencies : (f1, f2)
        Two different natural frequencies [Hz].
    ratios : (zeta1, zeta2)
        Their damping ratios.

    Returns
    -------
    alpha : float
        Mass factor [1/s] for ``scene.add_damping(alpha, tau)``.
    tau : float
        Retardation time [s], for the same, or for ``Section(..., retardation=tau)``.

    Raises
    ------
    SceneError
        If alpha or tau would be negative, or for frequencies that are equal or not positive.

    Examples
    --------
    Two per cent at 5 Hz and at 50 Hz.

    >>> import fx_beam as fb
    >>> alpha, tau = fb.rayleigh((5.0, 50.0), (0.02, 0.02))
    >>> round(alpha, 4), round(tau, 6)
    (1.1424, 0.000116)
    """
    f = vector(frequencies, 2, "rayleigh: frequencies")
    zeta = vector(ratios, 2, "rayleigh: ratios")
    usable = f.min() > 0 and f[0] != f[1]
    require(usable, "rayleigh: frequencies", frequencies, "positive and different")
    require(zeta.min() >= 0, "rayleigh: ratios", ratios, "zero or positive")
    # alpha + tau omega^2 = 2 zeta omega, with the frequencies in order.
    (w1, z1), (w2, z2) = sorted(zip(2 * np.pi * f, zeta, strict=True))
    alpha = 2 * w1 * w2 * (z1 * w2 - z2 * w1) / (w2**2 - w1**2)
    tau = 2 * (z2 * w2 - z1 * w1) / (w2**2 - w1**2)
    # With one factor alone the ratios are as the frequencies, or inversely.
    for name, unit, value, bound in (
        ("mass factor alpha", "1/s", alpha, f"at most {z1 * w2 / w1:.4g}"),
        ("retardation time tau", "s", tau, f"at least {z1 * w1 / w2:.4g}"),
    ):
        if value < 0:
            raise SceneError(
                f"rayleigh: these ratios need a negative {name} = {value:.4g} {unit}, which would "
                f"drive the motion. Choose a ratio of {bound} at {w2 / (2 * np.pi):.4g} Hz"
            )
    return float(alpha), float(tau)


def modes(scene: Scene, state: Solution | None = None, n: int = 6, damping: bool = True) -> Modes:
    """Compute the lowest natural frequencies, damping ratios and mode shapes.

    The stiffness is the tangent at the state: it includes the geometric stiffness, springs, loads
    and added forces. If it is not symmetric, as under forces that follow the motion, two modes may
    flutter: they have one frequency, and damping ratios of both signs. Damping is the derivative of
    all forces by the rates, at rest in the state: retardation of members, drag, dampers and
    friction of joints, and added forces against the velocity. Prescribed motions, motors and
    internal variables are fixed.

    About a turning state the modes are those in the turning frame, with centrifugal and Coriolis
    forces; damping depends on the rates in this frame. A free turn is a rigid mode.

    Parameters
    ----------
    scene : Scene
        The scene.
    state : Solution, optional
        A solution whose last row is the configuration, an equilibrium, at rest or in a steady turn
        (``static(scene, spin=...)``); by default the reference configuration without loads, or,
        with a warning, the equilibrium to which springs under tension bring it. It may be a
        solution of another scene with the same nodes, such as one in which a mechanism is
        supported.
    n : int
        Number of modes; fewer are returned if the scene has fewer degrees of freedom with mass.
    damping : bool
        Whether damping is included; without damping all shapes are real.

    Returns
    -------
    Modes
        Frequencies, damping ratios and shapes.

    Raises
    ------
    SceneError
        If the state is no equilibrium; the message names the node without balance. If the scene has
        no mass or no unknowns; if its damping at rest is infinite; or if it moves freely, and its
        stiffness is not symmetric.
    RuntimeError
        If no modes are found, or damped modes do not converge.

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
    lowest, rigid = lowest_modes(about, about.damping("modes", damping), n)
    roots, omega, ratios, vectors = lowest
    shapes = about.at_nodes(vectors)
    if about.stiffness.is_plain:
        lost = bends(about.model, shapes[:, rigid])
        if lost and state is not None:  # as it is at a critical load, too
            lost = False
            with suppress(SceneError):
                reference = linearised(scene, None, "modes")
                _, rigid_there, vectors_there = reference.undamped_modes.lowest(n)
                lost = bends(reference.model, reference.at_nodes(vectors_there[:, rigid_there]))
        warn_of_rounding(about.K, vectors[:, ~rigid], "modes: frequencies have", lost)
    found = modes_of(about.model, about.start.q, shapes, omega, rigid, ratios, roots)
    return replace(found, excitation=partial(_excitation, about))


def _excitation(about: Linearisation) -> Excitation:
    """Forces of inertia by unit accelerations of the ground."""
    model = about.model
    translations = np.tile(np.eye(2, 3), model.size // 3)
    forces = (model.masses.matrix @ translations.T).T
    pushes = [about.unknown_forces(force) for force in forces]
    unit = model.units.unknowns[about.unknowns]
    moved = [acceleration_of(about.M, push, unit) for push in pushes]
    mass = np.array(pushes) @ np.array(moved).T
    return Excitation(forces.reshape(2, -1, 3), mass, partial(inertia_outputs, about))


def lowest_modes(
    about: Linearisation, C: ConstrainedMatrix | None, n: int
) -> tuple[ModeParts, np.ndarray]:
    """The n lowest modes, and which of them are rigid.

    C is the derivative of the forces by the rates; None for none.
    """
    undamped = about.undamped_modes
    if C is not None and not abs(C.system).max():
        C = None
    if not about.has_potential:
        return _following(about, C, n)
    if C is None:
        omega, rigid, vectors = undamped.lowest(n)
        roots = np.where(omega < 0, -omega, 1j * omega)
        return ModeParts(roots, omega, np.zeros(len(omega)), vectors), rigid
    # All rigid and unstable modes, some that are neither, and more in which damping may show:
    # Coriolis forces may carry what is unstable without them.
    count = 2 * n + 10
    while True:
        omega, rigid, vectors = undamped.lowest(count)
        if (omega > 0).sum() > n // 2 or len(omega) < count:
            break
        count *= 2
    unit = 0.7 * abs(omega[~rigid]).min(initial=np.inf)
    pencil = DampedPencil(about.stiffness.symmetric, C, about.inertia)
    if np.isinf(unit):
        unit = abs(pencil.C.diagonal()).max() / pencil.M.diagonal().max()
    still = vectors[:, rigid]
    damped = _not_rigid(pencil, n, vectors[:, ~rigid], still, unit)
    return _in_order(damped, pencil.M, still, n)


def _following(
    about: Linearisation, C: ConstrainedMatrix | None, n: int
) -> tuple[ModeParts, np.ndarray]:
    """The n lowest modes under forces without a potential: two modes may flutter."""
    K, none = about.stiffness, np.empty((len(about.unknowns), 0))
    undamped = K.without_equations.with_data(0 * K.without_equations.system.data)
    if bristles_of(about.model.points):
        raise SceneError(
            "modes: the stiffness is not symmetric, since a load depends on the motion beside "
            "friction, or friction slips, or sticks to what is round or bends: small motions there "
            "and back differ. Simulate the scene, linearise it, or remove the friction"
        )
    pencil = DampedPencil(K, undamped if C is None else C, about.inertia)
    _check_held(K, np.sqrt(abs(pencil.K.diagonal())))
    # The modes of the symmetric part begin the subspace.
    omega, _, start = about.undamped_modes.lowest(2 * n + 10)
    unit = 0.7 * abs(omega[omega != 0]).min()
    damped = _not_rigid(pencil, n, start, none, unit)
    if C is None:  # what neither grows nor decays but for round-off
        ratios, roots = damped.ratios, damped.roots
        noise = _rounding(pencil.K, pencil.C, damped) / abs(roots)
        still = (roots.imag != 0) & (abs(ratios) <= noise)
        roots = np.where(still, 1j * damped.frequencies, roots)
        damped = damped._replace(ratios=np.where(still, 0.0, ratios), roots=roots)
    return _in_order(damped, pencil.M, none, n)


def _in_order(
    damped: ModeParts, M: Weighted, rigid: np.ndarray, n: int
) -> tuple[ModeParts, np.ndarray]:
    """The n lowest of damped modes and of rigid ones (size, k), as of `lowest_modes`."""
    # The phase in which the imaginary part of a vector is smallest.
    vectors = damped.vectors
    phases = np.angle(np.einsum("ij,ij->j", vectors, M @ vectors))
    zeros = np.zeros(rigid.shape[1])
    roots, omega, ratios = (np.concatenate([zeros, part]) for part in damped[:3])
    vectors = np.column_stack([rigid, vectors * np.exp(-0.5j * phases)])
    order = np.argsort(omega, kind="stable")[:n]
    return ModeParts(roots, omega, ratios, vectors).only(order), order < len(zeros)


def _check_held(K: ConstrainedMatrix, scale: np.ndarray) -> None:
    """SceneError if a part moves freely: its double root at zero would not be found exactly.

    `scale` (free,) has roots of stiffnesses.
    """
    scale[scale == 0] = 1.0
    x = np.random.default_rng(0).standard_normal(len(scale))
    try:
        for _ in range(3):  # inverse iteration
            x = scale * K.solve(scale * x / np.linalg.norm(x))
    except RuntimeError:  # a pivot is zero
        x = np.array([np.inf])
    if not np.linalg.norm(x) < 1 / _SINGULAR:
        raise SceneError(
            "modes: a part moves freely, and the stiffness is not symmetric, since a load or an "
            "added virtual work depends on the motion and has no potential. "
            "Support the scene, or take the eigenvalues of linearise(scene, state).A"
        )
