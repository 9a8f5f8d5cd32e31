"""Natural frequencies and mode shapes about a configuration."""

from __future__ import annotations

from dataclasses import dataclass, field
from html import escape

import numpy as np
import scipy.sparse

from fx_beam.errors import SceneError
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import Beam
from fx_beam.scene.body import Body
from fx_beam.scene.notebook import sketch
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model
from fx_beam.validation import as_float, is_flag, is_number, is_whole, require, shown

from .damped_modes import lowest_damped
from .linearisation import check_equilibrium, linearised
from .undamped_modes import first_of_largest, lowest


@dataclass(frozen=True)
class Modes:
    r"""Free vibrations about a configuration, lowest first.

    A vibration :math:`\hat x \sin(\omega t)` of small amplitude obeys
    :math:`K \hat x = \omega^2 M \hat x` in the unknowns of the scene. If :math:`\omega^2` is
    negative, the configuration is unstable: the amplitude grows as :math:`e^{|\omega| t}`, and the
    frequency is given as the negative number :math:`-|\omega|`.

    With damping the motion is :math:`\mathrm{Re}\,\hat x e^{\lambda t}`, with
    :math:`(\lambda^2 M + \lambda C + K) \hat x = 0`. A pair of complex roots is one mode,
    :math:`\lambda = \omega (-\zeta + i \sqrt{1 - \zeta^2})`. An overdamped mode has two real
    roots; the slower one stands for both. Its frequency and damping ratio are those of the modal
    mass 1, :math:`\omega^2 = \hat x.K \hat x` and :math:`2 \zeta \omega = \hat x.C \hat x`.
    In a frame that turns, C has the Coriolis forces as well, which do not damp.

    Parameters
    ----------
    angular_frequencies : (n,) float
        Natural angular frequencies omega [rad/s]; zero for rigid modes, negative for unstable ones,
        which grow without vibrating.
    rigid : (n,) bool
        Whether a mode is a rigid-body motion: its strain energy is zero up to rounding.
    shapes : (n, n_node, 3) float or complex
        Displacements and rotations of the nodes, with modal mass 1: shape.M.shape = 1 kg m^2, with
        the conjugate of one of both. Complex for damped scenes, since the nodes of a mode need not
        move in phase; the phase is chosen such that the imaginary part is small. The sign: of the
        displacements along x and y of all nodes, in their order, the first one that is within
        0.1 % of the largest is positive (of complex ones the real part); where nodes only turn, of
        the rotations.
    positions : (n_node, 2) float
        Positions of the nodes in the configuration [m].
    nodes_of_beam : dict
        All nodes of each beam in order, those inside elements included.
    degree : int
        Degree of the elements.
    damping_ratios : (n,) float
        Damping ratios zeta: 0 for rigid modes, above 1 for overdamped ones, negative for vibrations
        that grow, nan for growth without vibration.
    eigenvalues : (n,) complex
        Roots lambda [1/s]: the amplitude changes as e^(Re(lambda) t), the vibration has the angular
        frequency Im(lambda).
    bodies, beams : dict, optional
        The bodies and the beams by name.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> bar = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0))
    >>> scene.fix(bar.start, "x", "y", "rotation")
    >>> mass = scene.add_mass(bar.end, mass=1.0)
    >>> modes = fb.modes(scene, n=2)
    >>> moved = modes.shape(bar, mode=0, size=0.1)[-1] - modes.positions[-1]
    >>> len(modes), abs(moved).round(3)
    (2, array([0. , 0.1]))
    """

    angular_frequencies: np.ndarray
    rigid: np.ndarray
    shapes: np.ndarray
    positions: np.ndarray
    nodes_of_beam: dict[str, np.ndarray]
    degree: int
    damping_ratios: np.ndarray
    eigenvalues: np.ndarray
    bodies: dict[str, Body] = field(default_factory=dict)
    beams: dict[str, Beam] = field(default_factory=dict)

    def __post_init__(self):
        size = float(np.ptp(self.positions, axis=0).max()) or 1.0
        # Rotations count if nothing else moves.
        parts = (self.shapes.real * (1.0, 1.0, 1e-6 * size)).reshape(len(self), -1)
        signs = [np.copysign(1.0, part[first_of_largest(abs(part))]) for part in parts]
        object.__setattr__(self, "shapes", np.reshape(signs, (-1, 1, 1)) * self.shapes)

    @property
    def frequencies(self) -> np.ndarray:
        """Natural frequencies [Hz], (n,); negative for modes that grow without vibrating."""
        return self.angular_frequencies / (2 * np.pi)

    @property
    def unstable(self) -> np.ndarray:
        """Whether a mode grows, (n,)."""
        return (self.angular_frequencies < 0) | (self.damping_ratios < 0)

    @property
    def overdamped(self) -> np.ndarray:
        """Whether a mode decays without vibrating, (n,)."""
        return self.damping_ratios > 1

    def __len__(self):
        return len(self.rigid)

    def __repr__(self):
        low, high = self.frequencies.min(), self.frequencies.max()
        return f"<Modes: {len(self)} from {low:.4g} to {high:.4g} Hz>"

    def _repr_html_(self):
        shown = range(min(4, len(self)))
        size = 0.15 * float(np.ptp(self.positions, axis=0).max())
        shapes = [
            sketch(
                [
                    *(self.positions[nodes] for nodes in self.nodes_of_beam.values()),
                    *(self.shape(name, mode, size) for name in self.nodes_of_beam),
                ],
                ["#bbb"] * len(self.nodes_of_beam) + ["#0072B2"] * len(self.nodes_of_beam),
            )
            for mode in shown
        ]
        return f"<pre>{escape(str(self))}</pre>{' '.join(shapes)}"

    def __str__(self):
        kinds = [self.rigid, self.unstable, self.overdamped]
        names = np.select(kinds, ["rigid", "unstable", "overdamped"], "")
        ratios = [f", damping ratio {z:.4g}" if abs(z) > 0 else "" for z in self.damping_ratios]
        rows = zip(range(len(self)), self.frequencies, ratios, names, strict=True)
        return "\n".join(f"mode {k}: {f:.6g} Hz{z} {name}".rstrip() for k, f, z, name in rows)

    def shape(
        self, beam: Beam | Body | str, mode: int, size: float, phase: float = 0.0
    ) -> np.ndarray:
        """Axis of a beam, or nodes of a body, displaced by a mode.

        Parameters
        ----------
        beam : Beam, Body or str
            A beam or its name, or a body.
        mode : int
            Number of the mode, from 0.
        size : float
            Largest displacement of a node of the scene [m].
        phase : float
            Angle of the vibration [rad]; pi/2 is a quarter of the period later, and pi half of it.

        Returns
        -------
        (elements * degree + 1, 2) float
            Positions of its nodes, those inside elements included [m]. Of a body: its centre, then
            its points.

        Raises
        ------
        SceneError
            If there is no such beam or mode.
        """
        name = beam.name if isinstance(beam, Beam) else beam
        for what, value in (("size", size), ("phase", phase)):
            require(is_number(value), f"shape: {what}", value, "a finite number")
        if isinstance(beam, Body):
            nodes = np.array([node.number for node in beam.nodes])
        elif not isinstance(name, str) or name not in self.nodes_of_beam:
            raise SceneError(
                f"{shown(name)} is not a beam of these modes; they have {list(self.nodes_of_beam)}"
            )
        else:
            nodes = self.nodes_of_beam[name]
        if not is_whole(mode, -len(self), len(self) - 1):
            raise SceneError(f"mode {shown(mode)}: there are {len(self)} modes, numbered from 0")
        moved = self.shapes[mode, :, :2]
        # The largest half-axis of the ellipses on which the nodes move.
        squares = (abs(moved) ** 2).sum(axis=1) + abs((moved**2).sum(axis=1))
        scale = as_float(size) / np.sqrt(squares.max() / 2)
        return self.positions[nodes] + scale * (moved[nodes] * np.exp(1j * as_float(phase))).real


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


def modes_of(model: Model, q, vectors, omega, rigid, ratios, roots) -> Modes:
    """Modes about a configuration q (size,), from motions (size, n) of its nodes."""
    shapes = np.array([model.to_nodes(vector) for vector in vectors.T])
    positions = model.mesh.X + model.to_nodes(q)[:, :2]
    beams = {beam.name: beam for beam in model.scene.beams}
    nodes = dict(zip(beams, model.mesh.nodes, strict=True))
    degree = model.scene.beams[0].degree if beams else 1
    bodies = {body.name: body for body in model.scene.bodies}
    return Modes(omega, rigid, shapes, positions, nodes, degree, ratios, roots, bodies, beams)


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
