"""Steady vibrations under a harmonic load, over its frequency."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.dual import floats
from fx_beam.errors import LARGEST, SceneError, real_array, require
from fx_beam.results.solution import Solution
from fx_beam.results.vibrations import FrequencyResponse
from fx_beam.scene.beam import Node
from fx_beam.scene.joints import Joint
from fx_beam.scene.loads import check_node
from fx_beam.scene.outputs import Measured, Output
from fx_beam.scene.scene import Scene
from fx_beam.step.constrained_matrix import Symmetry

from .linearisation import DampedPencil, Linearisation, Weighted, linearised, output_rows

# Motion per force, in the units of the equations' diagonal, at which only rounding bounds it.
_UNBOUNDED = 1e14


def frequency_response(
    scene: Scene,
    load: tuple[Node, Sequence[complex]] | None = None,
    at: Node | Joint | None = None,
    frequencies: Sequence[float] = (),
    state: Solution | None = None,
    *,
    base: Sequence[complex] | None = None,
    damping_ratio: float | Sequence[float] | None = None,
) -> FrequencyResponse:
    r"""Compute steady vibrations under a harmonic load or on a shaken base, for small amplitudes.

    :math:`(K + i \omega C - \omega^2 M) \hat x = \hat F`, with the stiffness, damping and mass of
    `modes`, and one factorisation for each frequency. The loads of the scene do not vibrate; they
    act in the state. Prescribed motions, motors and internal variables are fixed.

    With a `base` the whole ground moves by :math:`\hat b`: all supports and prescribed nodes, fixed
    points, the ground of joints, dampers and obstacles, and the air of drag. For motions relative
    to the base :math:`\hat F = \omega^2 T^T M \hat b`, with the masses of all nodes. The result for
    a node is its absolute motion: with ``base=(1, 0)`` the transmissibility, which is also the
    ratio of accelerations. Subtract :math:`\hat b` for the motion relative to the base; coordinates
    of joints are relative.

    Parameters
    ----------
    scene : Scene
        The scene.
    load : (Node, components), optional
        The node and the amplitudes (fx, fy) of its force [N], or (fx, fy, moment) with a moment [N
        m]. Complex amplitudes have different phases.
    at : Node or Joint
        The node whose motion is wanted, or the joint whose free coordinates are.
    frequencies : (n,) float
        Frequencies of the load or the base [Hz], zero or positive.
    state : Solution, optional
        A solution whose last row is the configuration, an equilibrium, at rest or in a steady turn;
        by default the reference configuration without loads, as for `modes`. In a turn the load and
        the motion are those seen in the frame that turns.
    base : (2,) complex, optional
        In place of a load, the amplitudes of the displacement of the base [m] in x and y. An
        acceleration a [m/s^2] at a frequency f has the amplitude ``-a / (2 pi f)**2``.
    damping_ratio : float or (n,) float, optional
        Modal damping in addition to that of the scene: damping ratios of the n lowest modes, or one
        ratio for all modes up to three times the largest of the `frequencies`. The ratio of higher
        modes is the last one, times their frequency over that of the last mode.

    Returns
    -------
    FrequencyResponse
        Complex amplitudes.

    Raises
    ------
    SceneError
        For an invalid node, load, base, joint or frequency, if not exactly one of load and base is
        given, for a state that is no equilibrium, a base in a turning state, or a scene without
        unknowns. If the motion has no bound: at a natural frequency without damping, or at 0 Hz for
        a scene that moves freely.

    Examples
    --------
    A cantilever: its static deflection, and the amplitude at the first natural frequency of 0.56
    Hz, larger by the factor 1/(2 zeta).

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

    The same cantilever on a base that shakes across it, very slowly and at resonance, where its tip
    moves by 1.566/(2 zeta), with the participation of the first mode.

    >>> shaken = fb.frequency_response(scene, at=beam.end, frequencies=[0.0, f], base=(0.0, 1.0))
    >>> shaken.amplitude[:, 1].round(1)
    array([ 1. , 44.5])

    A damping ratio of two per cent for each mode, in place of a retardation: about 1/(2 zeta) = 25
    times the static deflection.

    >>> import dataclasses
    >>> scene = fb.Scene()
    >>> elastic = dataclasses.replace(section, retardation=0.0)
    >>> beam = scene.add_beam([(0, 0), (1, 0)], elastic, elements=8, degree=2)
    >>> scene.clamp(beam.start)
    >>> load = beam.end, (0.0, 0.01)
    >>> damped = fb.frequency_response(scene, load, beam.end, [0.0, f], damping_ratio=0.02)
    >>> static, resonant = damped.component("y")
    >>> round(float(abs(resonant / static)), 1)
    24.3
    """
    caller = "frequency_response"
    if (load is None) == (base is None):
        raise SceneError(
            f"{caller}: give either a load, such as (beam.end, (0.0, 1.0)), or the motion of the "
            "base, such as base=(1.0, 0.0)"
        )
    if at is None:
        raise SceneError(
            f"{caller}: say where the motion is wanted, by a node or a joint, such as at=beam.end"
        )
    about = linearised(scene, state, caller)
    # Forces at the nodes, and over the square of the angular frequency; the motion of the base.
    force, moved = forces_and_base(about, load, base, caller)
    measured = ObservedMotion(about, at, f"{caller}: at")
    f = checked_frequencies(frequencies, f"{caller}: frequencies")
    modal = None if damping_ratio is None else modal_damping(about, damping_ratio, f.max(), caller)
    vibration = Vibration(about, caller, modal)
    values = np.zeros((len(f), len(measured.names)), complex)
    unknown_forces = about.unknown_forces(force)
    for row, frequency in zip(values, f, strict=True):
        factor = 1.0 if base is None else (2 * np.pi * frequency) ** 2
        motion = vibration.at_frequency(frequency).solved(factor * unknown_forces)
        row[:] = measured.rows @ motion + measured.node_rows @ moved
    return FrequencyResponse(at, f, measured.names, values)


class ModalDamping(NamedTuple):
    """The damping matrix tau K + B diag(c) B^T, which gives some modes their ratios."""

    #: M times the modes (free, n); what they have beside the part of the stiffness [1/s].
    B: np.ndarray
    c: np.ndarray
    #: Retardation time of all modes [s].
    tau: float


def modal_damping(about: Linearisation, ratios: Any, f: float, caller: str) -> ModalDamping:
    """The damping of ratios of the lowest modes, or of one for those up to three times f [Hz]."""
    zeta = np.atleast_1d(floats(real_array(ratios)))
    ok = zeta.ndim == 1 and zeta.size > 0 and bool((zeta >= 0).all() and (zeta <= LARGEST).all())
    require(ok, f"{caller}: damping_ratio", ratios, "a ratio such as 0.02, or a list of them")
    count, modes = len(zeta), about.undamped_modes
    if not np.ndim(ratios):
        count = max(1, *(modes.count_below(k * (6 * np.pi * f) ** 2) for k in (1.0, 1.01)))
    omega, _, vectors = modes.lowest(count)
    expected = f"at most {len(omega)} ratios, as there are no more modes"
    require(len(omega) >= len(zeta), f"{caller}: damping_ratio", ratios, expected)
    zeta, w = np.broadcast_to(zeta, omega.shape), omega.clip(0.0)
    tau = 2 * zeta[-1] / w[-1] if w[-1] else 0.0
    M = Weighted(about.inertia.alone, about.stiffness)
    return ModalDamping(M @ vectors, 2 * zeta * w - tau * w**2, tau)


class Vibration:
    """K + i w C - w^2 M of small motions about a configuration."""

    def __init__(self, about: Linearisation, caller: str, modal: ModalDamping | None = None):
        self._what, self._modal, K = caller, modal, about.stiffness
        alone, C = K.without_equations, about.damping(caller)
        if C is None:
            C = alone.with_data(0 * alone.system.data)
        if modal is not None:
            symmetric = K.symmetric.without_equations
            C = C + symmetric.with_data(modal.tau * symmetric.system.data)
        self._pencil = DampedPencil(K, C, about.inertia)
        self._diagonals = abs(self._pencil.K.diagonal()), self._pencil.M.diagonal()
        matrices = (part.A for part in (self._pencil.K, self._pencil.C, self._pencil.M))
        sliding = bool(about.model.couplings.sliding)
        #: Whether K, C and M are symmetric, but for round-off.
        self.symmetric = all(Symmetry.of(A.tocsr(), about.unit, sliding) for A in matrices)

    def at_frequency(self, frequency: float) -> Vibration:
        """Itself, with factors of the matrix at a frequency [Hz]."""
        self._f, w = frequency, 2 * np.pi * frequency
        stiffness, mass = self._diagonals
        self._scale = np.sqrt(stiffness + w**2 * mass)
        self._scale[self._scale == 0] = 1.0
        self._system = self._pencil.matrix_at(1j * w)
        return self

    def solved(self, force: np.ndarray, transposed: bool = False) -> np.ndarray:
        """Motions (free, ...) under forces (free, ...), or with the transposed matrix."""
        try:
            x = self._system.solve(force, "T" if transposed else "N")
        except RuntimeError:  # a pivot is zero
            raise self._unbounded() from None
        if self._modal is not None:  # a matrix of low rank beside it (Woodbury)
            B, weights = self._modal.B, 2j * np.pi * self._f * self._modal.c[:, None]
            mode_motions = self._system.solve(B)
            small = np.eye(B.shape[1]) + weights * (B.T @ mode_motions)
            x = x - mode_motions @ np.linalg.solve(small, weights[:, 0] * (B.T @ x))
        # Sizes of real and imaginary parts, which are side by side.
        scaled = (
            np.ascontiguousarray(part).view(float)
            for part in (self._scale * x.T, (force.T / self._scale).astype(complex))
        )
        motion, load = (np.einsum("...i,...i", part, part) for part in scaled)  # squares
        if not np.all(motion <= _UNBOUNDED**2 * load):
            raise self._unbounded()
        return x

    def frequency_slope(self, motion: np.ndarray) -> np.ndarray:
        """Derivative of the matrix by the angular frequency w, times a motion (free,)."""
        return 1j * (self._pencil.C @ motion) - 4 * np.pi * self._f * (self._pencil.M @ motion)

    def _unbounded(self) -> SceneError:
        return SceneError(
            f"{self._what}: at {self._f:g} Hz the motion has no bound: this is a natural frequency "
            "without damping, or the scene moves freely at 0 Hz. Add damping or a support, or "
            "leave this frequency out"
        )


def checked_frequencies(frequencies, name: str) -> np.ndarray:
    """Frequencies (n,) [Hz]; SceneError for others."""
    f = real_array(frequencies)
    is_valid = f.ndim == 1 and f.size and (f >= 0).all() and (f <= LARGEST).all()
    require(bool(is_valid), name, frequencies, "a list of numbers [Hz], zero or positive")
    return f


def forces_and_base(
    about: Linearisation, load: Any, base: Any, caller: str
) -> tuple[np.ndarray, np.ndarray]:
    """Forces (size,) of a load, or of a moving base over the square of w; motion of the base."""
    if base is None:
        return _nodal_load(about, load, f"{caller}: load"), np.zeros(about.model.size)
    moved = _base_motion(about, base, f"{caller}: base")
    return about.model.masses.matrix @ moved, moved


def _nodal_load(about: Linearisation, load, name: str) -> np.ndarray:
    """Complex amplitudes (size,) of the load at the nodes."""
    is_pair = isinstance(load, tuple | list) and len(load) == 2
    require(is_pair, name, load, "a node and its amplitudes, such as (beam.end, (0.0, 1.0))")
    node, components = load
    check_node(about.scene, node, name)
    parts = _amplitudes(components)
    expected = "(fx, fy) or (fx, fy, moment)"
    require(len(parts) in (2, 3), f"{name} on {node}", components, expected)
    full = np.zeros(about.model.size, dtype=complex)
    full[about.model.mesh.dofs[node.number][: len(parts)]] = parts
    if not about.unknown_forces(full).any():
        raise SceneError(
            f"{name} on {node} moves nothing: it is zero, or supports take all of it. Give "
            "components in free directions"
        )
    return full


def _base_motion(about: Linearisation, base, name: str) -> np.ndarray:
    """Complex amplitudes (size,) of the motion of all nodes with the base."""
    parts = _amplitudes(base)
    expected = "the amplitudes (x, y) of its displacement [m], such as (1.0, 0.0)"
    require(len(parts) == 2 and bool(parts.any()), name, base, expected)
    if about.frame is not None:
        raise SceneError(
            f"{name}: the state turns, and a base that shakes in one direction of space has two "
            "frequencies in the frame that turns. Take a state at rest, or give loads as they are "
            "seen in the frame"
        )
    full = np.zeros((about.model.size // 3, 3), dtype=complex)
    full[:, :2] = parts
    return full.ravel()


def _amplitudes(components) -> np.ndarray:
    """Complex numbers (n,); an empty array unless `components` are a row of finite numbers."""
    row = components if isinstance(components, list | tuple) or np.ndim(components) else ()
    pairs = [(x.real, x.imag) if np.iscomplexobj(x) else (x, 0.0) for x in row]
    parts = floats(real_array(pairs))
    finite = parts.shape[1:] == (2,) and bool((abs(parts) <= LARGEST).all())
    return parts @ (1, 1j) if finite else np.empty(0)


class ObservedMotion:
    """The components of a motion at a node or joint."""

    def __init__(self, about: Linearisation, place: Any, name: str):
        model, outputs = about.model, dict[str, Output]()
        if not isinstance(place, Joint):
            check_node(about.scene, place, name)
            outputs = {part: Output("displacement", place, part) for part in "xy"}
            outputs["rotation"] = Output("rotation", place)
        elif place not in about.scene.joints:
            raise SceneError(
                f"{name}: {place} is not a joint of the scene; take what add_joint returned"
            )
        else:
            free = place.coordinates.keys() - place.driven
            if "slide" in free:
                outputs["slide"] = Output("slide", place)
            if "rotation" in free and not place.on_beam:
                outputs["angle"] = Output("angle", place)
            if not outputs:
                raise SceneError(f"{name}: {place} has no free coordinate. Take one of its nodes")
        every = scipy.sparse.identity(model.size + model.reduction.columns, format="csr")
        arrays = {"q": every[: model.size], "slides": every[model.size :]}
        listed = [output_rows(model, Measured(output), arrays) for output in outputs.values()]
        #: Names of the components; matrices that give them from the motion of all nodes (m, size),
        #: but for slides, and from the unknowns (m, free).
        self.names = tuple(outputs)
        self.node_rows, column_rows = np.hsplit(np.vstack(listed), [model.size])
        rows = zip(self.node_rows, column_rows, strict=True)
        self.rows = np.array([about.unknown_forces(*parts) for parts in rows])
