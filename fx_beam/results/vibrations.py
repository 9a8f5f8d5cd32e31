"""Vibrations and buckling: modes, responses to harmonic loads, periodic motions."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from html import escape
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from fx_beam import errors
from fx_beam.content_cache import cached_property
from fx_beam.dual import floats
from fx_beam.errors import SceneError, as_float, is_number, is_one_of, require, shown, vector
from fx_beam.scene.beam import COMPONENTS, Beam, Node
from fx_beam.scene.body import Body
from fx_beam.scene.joints import Joint
from fx_beam.scene.notebook import sketch
from fx_beam.scene.outputs import Output
from fx_beam.scene.parts import Parts

from .export import data_frame, write_csv
from .solution import Solution

# -- Largest responses to a shaken ground, of which a spectrum of accelerations is known --------


# Ordinates of a plateau differ by less, relative to the largest.
_PLATEAU = 1e-6


@dataclass(frozen=True, repr=False)
class SpectrumResponse:
    """Largest responses to a shaken ground, by the parts of the modes.

    Returned by `Modes.spectrum`.

    Parameters
    ----------
    values : dict of (...) float
        Largest sizes of the outputs, by name, without a sign.
    modal : dict of (n, ...) float
        Largest contribution of each mode, with its sign relative to the other modes.
    rest : dict of (...) float
        Contribution of the mass that the modes lack, which moves with the ground.
    accelerations : (n,) float
        Ordinates of the spectrum at the periods of the modes [m/s^2].
    rigid : (n,) float
        Part alpha of each mode that moves with the ground.
    share : float
        Sum of the effective masses of the modes, relative to that of all modes.

    Examples
    --------
    Two modes without a rigid part, with periods far apart: the root of the sum of squares.

    >>> import numpy as np, fx_beam as fb
    >>> modal = {"drift": np.array([3e-3, -4e-3])}
    >>> parts = {"modal": modal, "rest": {"drift": np.array(0.0)}}
    >>> fb.SpectrumResponse({"drift": np.array(5e-3)}, **parts, accelerations=np.ones(2),
    ...                     rigid=np.zeros(2), share=0.97)
    <SpectrumResponse: 2 modes with 97.0 % of the mass, drift>
    """

    values: dict[str, np.ndarray]
    modal: dict[str, np.ndarray]
    rest: dict[str, np.ndarray]
    accelerations: np.ndarray
    rigid: np.ndarray
    share: float

    def __repr__(self):
        names = ", ".join(self.values)
        modes = f"{len(self.rigid)} modes with {100 * self.share:.1f} % of the mass"
        return f"<SpectrumResponse: {modes}, {names}>"


class Spectrum:
    """Pseudo-accelerations (n,) [m/s^2] over periods (n,) [s], straight between them."""

    def __init__(self, spectrum: Any):
        is_pair = isinstance(spectrum, list | tuple) and len(spectrum) == 2
        parts = [floats(errors.real_array(part)) for part in spectrum] if is_pair else []
        ok = is_pair and parts[0].ndim == 1 and parts[0].shape == parts[1].shape
        ok = ok and len(parts[0]) > 1 and bool(np.isfinite(parts).all())
        expected = "two lists of the same length: periods [s] and accelerations [m/s^2]"
        require(ok, "spectrum", spectrum, expected)
        self._periods, self._values = parts
        expected = "periods that rise from 0, where the ordinate is the ground's own acceleration"
        rises = self._periods[0] == 0 and bool((np.diff(self._periods) > 0).all())
        require(rises, "spectrum: periods", self._periods, expected)
        positive = bool((self._values > 0).all())
        require(positive, "spectrum: accelerations", self._values, "positive numbers")

    @property
    def ground(self) -> float:
        """Largest acceleration of the ground [m/s^2]."""
        return float(self._values[0])

    def at(self, periods: np.ndarray) -> np.ndarray:
        """Ordinates at periods (n,) [s]."""
        last = self._periods[-1]
        for number in np.flatnonzero(periods > last):
            raise SceneError(
                f"spectrum: it ends at the period {last:g} s, but mode {number} has "
                f"{periods[number]:.4g} s. Extend it"
            )
        return np.interp(periods, self._periods, self._values)

    def rigid(self, periods: np.ndarray) -> np.ndarray:
        """Parts (n,) of modes of some periods [s] that move with the ground.

        Beyond the peak of the spectrum, at shorter periods, the ratio of the ground's acceleration
        to that of the mode (Lindley and Yow 1980).
        """
        peak = self._periods[(self._values >= (1 - _PLATEAU) * self._values.max()).argmax()]
        return np.where(periods < peak, np.minimum(self.ground / self.at(periods), 1.0), 0.0)


def correlations(frequencies: np.ndarray, damping: float) -> np.ndarray:
    """Correlation (n, n) of modes with one damping ratio under white noise.

    Der Kiureghian (1981), doi 10.1002/eqe.4290090205.
    """
    r = frequencies[:, None] / frequencies
    apart = (1 - r**2) ** 2 + 4 * damping**2 * r * (1 + r) ** 2
    return 8 * damping**2 * (1 + r) * r**1.5 / apart


def combined(
    modal: Mapping[str, np.ndarray],
    rest: Mapping[str, np.ndarray],
    rigid: np.ndarray,
    correlation: np.ndarray,
) -> dict[str, np.ndarray]:
    """Largest sizes (...) of outputs from what modes (n, ...) and the remaining mass give.

    What moves with the ground adds with its sign, the rest by the correlation (n, n) of modes, and
    both by the root of the sum of squares.
    """
    largest, own = dict[str, np.ndarray](), np.sqrt(1 - rigid**2)
    for name, values in modal.items():
        with_ground = np.tensordot(rigid, values, axes=1) + rest[name]
        parts = np.moveaxis(values, 0, -1) * own
        squares = ((parts @ correlation) * parts).sum(axis=-1)
        largest[name] = np.sqrt(with_ground**2 + np.maximum(squares, 0.0))
    return largest


# -- Vibrations as they are found: modes, responses to harmonic loads, periodic motions ---------


# Displacements below this part of the size of the scene times the largest rotation are zero.
_ZERO = 1e-6
# Sizes of parts of a mode that differ by less, relative to the largest, are equal.
_EQUAL = 1e-3
# Share of the mass that modes should have where a ground is shaken.
_ENOUGH = 0.9
# Units of the columns of a response.
_UNITS = {"x": "m", "y": "m", "rotation": "rad", "slide": "m", "angle": "rad"}


class Excitation(NamedTuple):
    """Forces by a unit acceleration of the ground along x and y, and the mass that they move."""

    #: M d (2, n_node, 3): mass matrix times a unit translation of all nodes [kg].
    forces: np.ndarray
    #: Mass (2, 2) that modes can move: (M d)_f . M_ff^-1 (M d)_f, f the unknowns [kg].
    mass: np.ndarray
    #: Gives changes (n, ...) of outputs by accelerations (n, n_node, 3); none in another process.
    outputs: Callable[[np.ndarray, Mapping[str, Output]], dict[str, np.ndarray]] | None


class Participation(NamedTuple):
    """How much the modes take part if the ground is shaken along a direction.

    Returned by `Modes.participation`.

    Parameters
    ----------
    factors : (n,) float
        Participation factors g = shape . M d of modes of the modal mass 1 [sqrt(kg)].
    effective_masses : (n,) float
        Effective masses g^2 [kg].
    total : float
        Effective mass of all modes that the scene has [kg]: its mass less that of the supports.

    Examples
    --------
    The first mode of a cantilever has 61 % of its mass.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e6, GA=1e6, EI=1.0, rhoA=1.0)
    >>> beam = scene.add_beam([(0, 0), (0, 1)], section, elements=64)
    >>> scene.clamp(beam.start)
    >>> shaken = fb.modes(scene, n=2).participation((1, 0))
    >>> round(float(shaken.effective_masses[0]), 2), round(float(shaken.shares.sum()), 2)
    (0.61, 0.81)
    """

    factors: np.ndarray
    effective_masses: np.ndarray
    total: float

    @property
    def shares(self) -> np.ndarray:
        """Effective masses (n,) as parts of `total`."""
        return self.effective_masses / self.total


@errors.answering_keywords
@dataclass(frozen=True)
class Modes:
    r"""Free vibrations about a configuration, lowest first.

    A vibration :math:`\hat x \sin(\omega t)` of small amplitude obeys
    :math:`K \hat x = \omega^2 M \hat x` in the unknowns of the scene. If :math:`\omega^2` is
    negative, the configuration is unstable: the amplitude grows as :math:`e^{|\omega| t}`, and the
    frequency is given as the negative number :math:`-|\omega|`.

    With damping the motion is :math:`\mathrm{Re}\,\hat x e^{\lambda t}`, with :math:`(\lambda^2 M +
    \lambda C + K) \hat x = 0`. A pair of complex roots is one mode, :math:`\lambda = \omega (-\zeta
    + i \sqrt{1 - \zeta^2})`. An overdamped mode has two real roots, of which `eigenvalues` has the
    slower one. Its frequency and damping ratio are those of the modal mass 1, :math:`\omega^2 =
    \hat x.K \hat x` and :math:`2 \zeta \omega = \hat x.C \hat x`. A node without mass that relaxes
    against a damper has a single root and is no mode: it is an eigenvalue of the matrix A of
    `linearise`. In a turning frame C includes the Coriolis forces, which do not damp.

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
        move in phase; the phase is chosen such that the imaginary part is small. The sign is chosen
        such that the first of all displacements, node by node along x and y, whose size is within
        0.1 % of the largest, is positive (for complex shapes its real part); if nodes only turn,
        the same holds for rotations.
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
    excitation : Excitation or callable, optional
        Data for `participation` and `spectrum`, or a function that gives them; None for modes of
        critical points.
    parts : Parts
        Supports, joints and springs of the scene, for pictures; copies have none.

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
    excitation: Any = field(default=None, repr=False)
    parts: Parts = field(default=Parts(), repr=False)

    def __post_init__(self):
        # Rotations count if nothing else moves.
        parts = (self.shapes.real * (1.0, 1.0, _ZERO * self._size)).reshape(len(self), -1)
        signs = [np.copysign(1.0, part[first_of_largest(abs(part))]) for part in parts]
        object.__setattr__(self, "shapes", np.reshape(signs, (-1, 1, 1)) * self.shapes)

    @property
    def _size(self) -> float:
        """Size of the scene [m]; 1 m for a single point."""
        return float(np.ptp(self.positions, axis=0).max()) or 1.0

    def participation(self, direction: Sequence[float]) -> Participation:
        r"""Participation factors and effective masses of the modes under a shaken ground.

        With the unit translation d of all nodes :math:`g = \hat x . M d`; the sum of all
        :math:`g^2` is :math:`(M d)_f . M_{ff}^{-1} (M d)_f`, f the unknowns.

        Parameters
        ----------
        direction : (2,) float
            Direction in which the ground moves, of any length.

        Returns
        -------
        Participation
            Factors, effective masses, and the mass of all modes.

        Raises
        ------
        SceneError
            For a direction without length, complex modes, and those of critical points.
        """
        d = _unit(direction, "participation")
        ok = self.excitation is not None and np.isrealobj(self.shapes)
        expected = "undamped ones of fx_beam.modes: modes(scene, damping=False)"
        require(ok, "participation: modes", self, expected)
        excitation = self._known_excitation()
        forces = np.tensordot(d, excitation.forces, axes=1)
        factors = np.tensordot(self.shapes, forces, axes=2)
        return Participation(factors, factors**2, float(d @ excitation.mass @ d))

    def spectrum(
        self,
        spectrum: Sequence[Any],
        direction: Sequence[float],
        damping: float = 0.05,
        combine: str = "CQC",
        *,
        outputs: Mapping[str, Output],
    ) -> SpectrumResponse:
        r"""Largest responses to a shaken ground, from a response spectrum.

        A mode with the participation factor g gives :math:`r = c.\hat x g S_a / \omega^2` to an
        output :math:`y = c.u`: the first-order response to its forces of inertia. The part
        :math:`\alpha` of it moves with the ground, as does all mass that the modes do not have; the
        response :math:`r_0` of this mass is the static one to the largest acceleration of the
        ground. Parts that move with the ground are added with their signs, :math:`R = \sum \alpha_i
        r_i + r_0`; with the parts :math:`p_i = \sqrt{1 - \alpha_i^2} \, r_i` of modes the largest
        response is :math:`\sqrt{R^2 + \sum_{ij} \rho_{ij} p_i p_j}`. Below the period of the
        largest ordinate :math:`\alpha = S_a(0) / S_a`, else zero.

        Parameters
        ----------
        spectrum : (periods, accelerations)
            Periods [s], from 0 on, and pseudo-accelerations S_a [m/s^2] of oscillators with this
            damping, linear between the periods. The value at 0 is the largest acceleration of the
            ground.
        direction : (2,) float
            Direction in which the whole ground moves, of any length.
        damping : float
            Damping ratio of all modes, on which their correlation depends.
        combine : {"CQC", "SRSS"}
            Correlation of modes: as under white noise (CQC), or none (SRSS).
        outputs : dict
            `Output` by names: displacements, rotations, coordinates and forces of joints, forces
            and lengths of ropes, reactions, section forces and stresses, as they change from the
            state; accelerations are absolute.

        Returns
        -------
        SpectrumResponse
            Largest magnitudes of the outputs, and the contribution of each mode.

        Raises
        ------
        SceneError
            As of `participation`; for modes that are rigid or unstable, or have longer periods than
            the spectrum; for outputs that are not linear, and those of contacts, beams and scenes;
            for a state that turns, and modes from another process.

        References
        ----------
        Der Kiureghian (1981), doi 10.1002/eqe.4290090205. Lindley and Yow (1980), Modal response
        summation for seismic qualification, 2nd ASCE Conference on Civil Engineering and Nuclear
        Power.

        Examples
        --------
        A mast on a clamp: most of its mass, and the moment of the clamp.

        >>> import fx_beam as fb
        >>> scene = fb.Scene()
        >>> section = fb.Section(EA=1e8, GA=1e8, EI=1e6, rhoA=10.0)
        >>> mast = scene.add_beam([(0, 0), (0, 10)], section, elements=16, degree=2)
        >>> scene.clamp(mast.start)
        >>> spectrum = [0.0, 0.1, 0.5, 4.0], [1.0, 2.5, 2.5, 0.3]
        >>> outputs = {"foot": fb.Output("reaction", mast.start, "moment")}
        >>> shaken = fb.modes(scene, n=4).spectrum(spectrum, (1, 0), outputs=outputs)
        >>> round(float(shaken.values["foot"])), round(shaken.share, 2)
        (1100, 0.91)
        """
        caller, table, shaken = "spectrum", Spectrum(spectrum), self.participation(direction)
        ok = is_number(damping) and 0 < damping < 1
        require(ok, f"{caller}: damping", damping, "a ratio between 0 and 1, such as 0.05")
        require(is_one_of(combine, ("CQC", "SRSS")), f"{caller}: combine", combine, "CQC or SRSS")
        still = bool((self.angular_frequencies > 0).all())
        require(still, f"{caller}: modes", self, "of a stable state that is held: none rigid")
        excitation = self._known_excitation()
        expected = "those of fx_beam.modes in this process"
        require(excitation.outputs is not None, f"{caller}: modes", "from a file", expected)
        periods = 1 / self.frequencies
        ordinates = table.at(periods)
        with_ground = np.zeros(self.shapes.shape[1:])
        with_ground[:, :2] = _unit(direction, caller)
        moved = shaken.factors[:, None, None] * self.shapes
        left = table.ground * (with_ground - moved.sum(axis=0))
        pushed = np.concatenate([ordinates[:, None, None] * moved, left[None]])
        changes = excitation.outputs(-pushed, outputs)
        modal = {name: values[:-1] for name, values in changes.items()}
        rest = {name: values[-1] for name, values in changes.items()}
        share, rigid = float(shaken.shares.sum()), table.rigid(periods)
        if share < _ENOUGH:
            errors.warn_once(
                f"{caller}: the modes have {100 * share:.0f} % of the mass. The rest counts as if "
                "it moved with the ground. Take more modes: modes(scene, n=...)"
            )
        is_cqc = combine == "CQC"
        correlation = correlations(self.frequencies, damping) if is_cqc else np.eye(len(self))
        values = combined(modal, rest, rigid, correlation)
        return SpectrumResponse(values, modal, rest, ordinates, rigid, share)

    def _known_excitation(self) -> Any:
        if callable(self.excitation):
            object.__setattr__(self, "excitation", self.excitation())
        return self.excitation

    def __getstate__(self):
        known = self._known_excitation()
        return self.__dict__ | {"excitation": known and known._replace(outputs=None)}

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
        size = 0.15 * self._size
        at_rest = [self.positions[nodes] for nodes in self.nodes_of_beam.values()]
        shades = ["#bbb"] * len(at_rest) + ["#0072B2"] * len(at_rest)
        shapes = []
        for mode in range(min(4, len(self))):
            moved = [self.shape(name, mode, size) for name in self.nodes_of_beam]
            shapes.append(sketch(at_rest + moved, shades))
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
            Largest displacement of a node of the scene [m]; zero where nodes only turn.
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
        for option, value in (("size", size), ("phase", phase)):
            require(is_number(value), f"shape: {option}", value, "a finite number")
        known: Mapping[str, Beam | Body] = self.bodies if isinstance(beam, Body) else self.beams
        part = beam if isinstance(beam, Beam | Body) else None
        name = part.name if part else beam
        member = known.get(name) if isinstance(name, str) else None
        if member is None or (part and part.nodes != member.nodes):
            kind = "body" if isinstance(beam, Body) else "beam"
            raise SceneError(
                f"{shown(beam)} is not a {kind} of these modes; take one of their scene: {[*known]}"
            )
        nodes = np.array([node.number for node in member.nodes])
        if isinstance(member, Beam):  # also those inside elements
            nodes = self.nodes_of_beam[member.name]
        if not errors.is_whole(mode, -len(self), len(self) - 1):
            raise SceneError(f"mode {shown(mode)}: there are {len(self)} modes, numbered from 0")
        return displaced(self, mode, as_float(size), as_float(phase), nodes)


def _unit(direction: Sequence[float], caller: str) -> np.ndarray:
    """A direction of the length 1."""
    way = floats(vector(direction, 2, f"{caller}: direction"))
    size = np.hypot(*way)
    require(bool(size > 0), f"{caller}: direction", direction, "not zero")
    return way / size


def displaced(
    modes: Modes, mode: int, size: float, phase: float, nodes: np.ndarray | slice
) -> np.ndarray:
    """Positions (n, 2) of nodes displaced by a mode, whose largest displacement is `size` [m]."""
    moved, turned = modes.shapes[mode, :, :2], modes.shapes[mode, :, 2]
    # The largest half-axis of the ellipses on which the nodes move; where they only turn, more.
    squares = (abs(moved) ** 2).sum(axis=1) + abs((moved**2).sum(axis=1))
    least = _ZERO * modes._size * abs(turned).max()
    scale = size / max(np.sqrt(squares.max() / 2), least)
    return modes.positions[nodes] + scale * (moved[nodes] * np.exp(1j * phase)).real


def modes_of(model, q, vectors, omega, rigid, ratios, roots) -> Modes:
    """Modes about a configuration q (size,), from motions (size, n) of its nodes."""
    shapes = np.array([vector.reshape(-1, 3) for vector in vectors.T])
    positions = model.mesh.X + q.reshape(-1, 3)[:, :2]
    beams = {beam.name: beam for beam in model.scene.beams}
    nodes = dict(zip(beams, model.mesh.nodes, strict=True))
    degree = model.scene.beams[0].degree if beams else 1
    bodies = {body.name: body for body in model.scene.bodies}
    members, parts = (bodies, beams), model.data.parts
    known = (shapes, positions, nodes, degree, ratios, roots)
    return Modes(omega, rigid, *known, *members, parts=parts)


def first_of_largest(sizes: np.ndarray) -> int:
    """Number of the first size (n,) that is the largest one, but for rounding errors."""
    return int((sizes >= (1 - _EQUAL) * sizes.max()).argmax())


@errors.answering_keywords
@dataclass(frozen=True, repr=False)
class FrequencyResponse:
    r"""Steady vibrations of a node or joint; returned by `frequency_response`.

    Under the load :math:`\mathrm{Re}\,\hat F e^{i \omega t}` the motion about the configuration is
    :math:`\mathrm{Re}\,\hat x e^{i \omega t}`.

    Parameters
    ----------
    at : Node or Joint
        The node or joint whose motion it is.
    frequencies : (n,) float
        Frequencies of the load [Hz].
    names : tuple of str
        Components of the motion: "x", "y" and "rotation" of a node, "slide" or "angle" or both of a
        joint.
    values : (n, m) complex
        Complex amplitudes of the components [m or rad].

    Examples
    --------
    A damped oscillator at half its natural frequency, which is 1 Hz: 1/(1 - 1/4) of the static
    displacement, without damping.

    >>> import math, fx_beam as fb
    >>> scene = fb.Scene()
    >>> bar = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=4 * math.pi**2, GA=1.0, EI=1.0))
    >>> scene.fix(bar.start, "x", "y", "rotation")
    >>> mass = scene.add_mass(bar.end, mass=1.0)
    >>> response = fb.frequency_response(scene, (bar.end, (4 * math.pi**2, 0)), bar.end, [0.0, 0.5])
    >>> response.amplitude[:, 0].round(3)
    array([1.   , 1.333])
    """

    at: Node | Joint
    frequencies: np.ndarray
    names: tuple[str, ...]
    values: np.ndarray

    def __repr__(self):
        return f"<FrequencyResponse of {', '.join(self.names)} at {len(self)} frequencies>"

    def __len__(self):
        return len(self.frequencies)

    @property
    def amplitude(self) -> np.ndarray:
        """Amplitudes (n, m) [m or rad]."""
        return abs(self.values)

    @property
    def phase(self) -> np.ndarray:
        """Phase (n, m) [rad], from -pi to pi; negative where the motion lags behind the load."""
        return np.angle(self.values)

    @property
    def units(self) -> tuple[str, ...]:
        """Unit of each component."""
        return tuple(_UNITS[name] for name in self.names)

    def component(self, name: str) -> np.ndarray:
        """Complex amplitudes of one component.

        Parameters
        ----------
        name : str
            One of `names`.

        Returns
        -------
        (n,) complex
            Its amplitudes [m or rad].

        Raises
        ------
        SceneError
            If there is no such component.
        """
        require(is_one_of(name, self.names), "component", name, f"one of {list(self.names)}")
        return self.values[:, self.names.index(name)]

    def to_csv(self, path: Path | str) -> None:
        """Write frequencies, amplitudes and phases as comma-separated columns.

        Parameters
        ----------
        path : str or path
            File to write; its first row names the columns.
        """
        write_csv(self._columns(), path)

    def to_pandas(self):
        """Table of amplitudes and phases, with the columns of `to_csv`.

        Returns
        -------
        pandas.DataFrame
            A row for each frequency, which is its index.

        Raises
        ------
        RuntimeError
            Where pandas is not installed.
        """
        return data_frame(self._columns())

    def _columns(self) -> dict[str, np.ndarray]:
        columns = {"frequency": self.frequencies}
        for name, size, angle in zip(self.names, self.amplitude.T, self.phase.T, strict=True):
            columns |= {f"{name} amplitude": size, f"{name} phase": angle}
        return columns


def _known(value: Any) -> Any:
    """A value in the place of a function that gives it."""
    return value


@dataclass(repr=False, eq=False)
class PeriodicMotion:
    """A motion that repeats itself; `periodic`, `backbone` and `forced_response` find it.

    Parameters
    ----------
    period : float
        Period [s].
    energy : float
        Energy at its start [J], zero in the reference configuration: kinetic, stored, of the
        weight, and of dead loads if these are constant. Without losses and other loads it is
        constant.
    multipliers : (n,) complex
        Floquet multipliers, largest first: the factors by which small deviations grow in a period,
        eigenvalues of the monodromy matrix. Multipliers of deviations that turn by more than 90
        degrees in one step, which the steps do not resolve, are left out. A free motion has the
        multiplier 1 for a shift in time, and once more if it belongs to a family.
    instability : str
        "fold" if the largest multiplier is real and above 1, "period doubling" if it is below -1,
        "Neimark-Sacker" for a complex pair outside the unit circle; empty for a stable motion. A
        multiplier counts from 1 + 1e-5 on.
    error : float
        Distance of the states before and after the period, relative to the largest distance within
        the period; relative to the size of the scene for a scene at rest.
    iterations : int
        Number of Newton's iterations.
    run : callable
        ``run()`` gives the solution.
    cycle : object
        Data of the search, for derivatives.

    Examples
    --------
    A body that swings on a spring.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> body = scene.add_body((0, 0), mass=1.0, inertia=1.0)
    >>> spring = fb.Spring(stiffness=4.0)
    >>> joint = scene.add_joint(fb.Prismatic(fb.GROUND, body.centre, axis=(1, 0), spring=spring))
    >>> swing = fb.periodic(scene, mode=0, amplitude=0.1)
    >>> swing.stable, round(swing.frequency, 3), round(swing.amplitude(body.centre, "x"), 3)
    (True, 0.318, 0.1)
    """

    period: float
    energy: float
    multipliers: np.ndarray
    instability: str
    error: float
    iterations: int
    run: Callable[[], Solution]
    cycle: Any

    @property
    def frequency(self) -> float:
        """Frequency of the motion [Hz]."""
        return 1 / self.period

    @property
    def stable(self) -> bool:
        """Whether no small deviation grows."""
        return not self.instability

    @cached_property
    def solution(self) -> Solution:
        """The motion over one period; `simulate(scene, start=...)` continues it."""
        return self.run()

    def amplitude(self, node: Node, component: str = "y") -> float:
        """Half of the distance between the ends of the motion of a node.

        Parameters
        ----------
        node : Node
            A node of the scene.
        component : {"x", "y", "rotation"}
            Component of the motion of the node.

        Returns
        -------
        float
            Amplitude [m or rad].

        Raises
        ------
        SceneError
            For a node that is none, or another component.
        """
        ok = is_one_of(component, COMPONENTS)
        require(ok, "amplitude: component", component, f"one of {list(COMPONENTS)}")
        rows = np.column_stack([self.solution.displacement(node), self.solution.rotation(node)])
        return float(np.ptp(rows[:, COMPONENTS.index(component)])) / 2

    def __getstate__(self):
        # The function holds the compiled model: copies get what it gives.
        return vars(self) | {"solution": self.solution, "run": partial(_known, self.solution)}

    def __repr__(self):
        verdict = self.instability or "stable"
        return f"<PeriodicMotion: {self.frequency:.6g} Hz, {verdict}, {self.energy:.4g} J>"


class StabilityChange(NamedTuple):
    """Where the stability of a family changes."""

    #: It changes between the motions number - 1 and number.
    number: int
    #: `PeriodicMotion.instability` of the unstable motions.
    kind: str
    #: The motion there.
    motion: PeriodicMotion


@dataclass(repr=False, eq=False)
class PeriodicFamily(Sequence[PeriodicMotion]):
    """Periodic motions of a family; `backbone` and `forced_response` return it.

    It is a sequence of `PeriodicMotion`.

    Parameters
    ----------
    motions : list of PeriodicMotion
        The motions, along the curve.
    free : bool
        Whether they are free motions, a backbone curve.
    changes : dict, optional
        Functions that give the motion at a change of stability, by the number of the motion after
        it.

    Examples
    --------
    A body on a spring that softens.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> body = scene.add_body((0, 0), mass=1.0, inertia=1.0)
    >>> spring = fb.Spring(stiffness=1.0, strain_energy=lambda x: -(x**4) / 8)
    >>> joint = scene.add_joint(fb.Prismatic(fb.GROUND, body.centre, axis=(1, 0), spring=spring))
    >>> family = fb.backbone(scene, amplitude=1.0)
    >>> bool(family.stable.all()), (family.frequencies * 6.2832).round(2)[[0, -1]]
    (True, array([1.  , 0.78]))
    """

    motions: list[PeriodicMotion]
    free: bool
    changes: Mapping[int, Callable[[], PeriodicMotion]] = field(default_factory=dict)

    def __getstate__(self):
        known = {change.number: partial(_known, change.motion) for change in self.critical}
        return vars(self) | {"changes": known}

    def __len__(self):
        return len(self.motions)

    def __getitem__(self, number):
        return self.motions[number]

    def __repr__(self):
        low, high = self.frequencies.min(), self.frequencies.max()
        kind = "free" if self.free else "forced"
        return f"<PeriodicFamily: {len(self)} {kind} motions from {low:.4g} to {high:.4g} Hz>"

    @property
    def frequencies(self) -> np.ndarray:
        """Frequencies (n,) [Hz]."""
        return np.array([motion.frequency for motion in self.motions])

    @property
    def energies(self) -> np.ndarray:
        """Energies (n,) at the starts [J]."""
        return np.array([motion.energy for motion in self.motions])

    @property
    def stable(self) -> np.ndarray:
        """Whether the motions are stable, (n,)."""
        return np.array([motion.stable for motion in self.motions])

    @cached_property
    def critical(self) -> list[StabilityChange]:
        """Changes of stability, as (number, kind, motion), found when they are first read.

        Stability changes between the motions number - 1 and number. The kind is
        `PeriodicMotion.instability` of the unstable motions: at a fold the curve turns back in
        frequency, or another branch begins; at a period doubling a branch of motions with twice the
        period begins. ``motion`` is the motion at which the largest multiplier crosses the unit
        circle, at a fold with the frequency of the fold. For free motions, and where one
        instability follows another, it is the motion with this number.
        """
        kinds = [motion.instability for motion in self.motions]
        return [
            StabilityChange(number, kinds[number] or kinds[number - 1], motion())
            for number, motion in sorted(self.changes.items())
        ]

    def amplitudes(self, node: Node, component: str = "y") -> np.ndarray:
        """Amplitudes of a node.

        Parameters
        ----------
        node : Node
            A node of the scene.
        component : {"x", "y", "rotation"}
            Component of the motion of the node.

        Returns
        -------
        (n,) float
            `PeriodicMotion.amplitude` of all motions [m or rad].
        """
        return np.array([motion.amplitude(node, component) for motion in self.motions])


# -- Load factors and shapes of linear buckling -------------------------------------------------


@dataclass(frozen=True, repr=False)
class BucklingModes:
    r"""Linear buckling: load factors and shapes, lowest load factor first; made by `buckling`.

    Parameters
    ----------
    load_factors : (n,) float
        Load factors :math:`\lambda`, positive, in rising order.
    modes : Modes
        Shapes of the modes, for pictures; their frequencies are zero.

    Examples
    --------
    Euler's column on two hinges, :math:`\pi^2 EI / L^2`.

    >>> import math, fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e8, GA=1e8, EI=1.0)
    >>> column = scene.add_beam([(0, 0), (0, 1)], section, elements=8, degree=3)
    >>> scene.pin(column.start)
    >>> scene.fix(column.end, "x")
    >>> load = scene.add_force(column.end, (0, -1.0))
    >>> found = fb.buckling(scene, n=2)
    >>> (found.load_factors / math.pi**2).round(4)
    array([1., 4.])
    >>> found.shape(column, mode=0, size=0.1).shape
    (25, 2)
    """

    load_factors: np.ndarray
    modes: Modes

    def __len__(self):
        return len(self.load_factors)

    def __repr__(self):
        return f"<BucklingModes: load factors {', '.join(f'{x:.6g}' for x in self.load_factors)}>"

    def shape(self, beam: Beam | Body | str, mode: int, size: float) -> np.ndarray:
        """Axis of a beam, or nodes of a body, displaced by a mode.

        Parameters
        ----------
        beam : Beam, Body or str
            A beam or its name, or a body.
        mode : int
            Number of the mode, from 0.
        size : float
            Largest displacement of a node of the scene [m].

        Returns
        -------
        (elements * degree + 1, 2) float
            Positions of its nodes [m], as of `Modes.shape`.
        """
        return self.modes.shape(beam, mode, size)
