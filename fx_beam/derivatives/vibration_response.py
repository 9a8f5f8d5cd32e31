"""Natural frequencies and steady vibrations as functions of parameters, with derivatives."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import linear_sum_assignment, minimize_scalar, newton

from fx_beam.dual import dual_array
from fx_beam.errors import SceneError, array_of, check_takes, is_flag, is_one_of, is_whole, require
from fx_beam.linear.harmonic import ObservedMotion, Vibration, checked_frequencies, forces_and_base
from fx_beam.linear.linearisation import DampedPencil, Linearisation
from fx_beam.linear.modal import lowest_modes
from fx_beam.results.solution import Solution
from fx_beam.results.vibrations import FrequencyResponse, Modes, modes_of
from fx_beam.scene.scene import Scene

from .parametrised import DualArrays, ParameterFunction, Parametrised, one_call
from .tangent_derivatives import Pairs, TangentAnalysis

# -- Natural frequencies as a function of parameters, with derivatives --------------------------


_log = logging.getLogger("fx_beam")
# Squares of angular frequencies that differ by less, relative to them, are repeated.
_EQUAL = 1e-7
# Modes more than those wanted if some of these have other shapes than before, or copies above.
_MORE = 10
# Least square of the cosine between two shapes of the same mode.
_SAME = 0.5
# Asymmetry of damping that is round-off; distance from a root, relative to it, at which inverse
# iteration finds its left vector, and number of iterations.
_SYMMETRIC, _BESIDE, _ITERATIONS = 1e-12, 1e-13, 2
_REPEATED = (
    "ModalResponse.jacobian: %d modes have the same frequency, %.6g rad/s. Each column has the "
    "derivatives of their group, in rising order: directional derivatives by this number alone, "
    "which do not add up over several parameters"
)


def _read(built: Scene) -> tuple[Scene, None]:
    """The scene that `build` gave."""
    require(isinstance(built, Scene), "ModalResponse: what build gives", built, "a Scene")
    return built, None


class ModalResponse(ParameterFunction):
    r"""Natural frequencies of a scene as a function of parameters.

    ``w = run(x)`` builds the scene of the parameters x and computes its lowest modes, as `modes`
    does without damping. Their derivatives need no further modes: with :math:`\phi.M \phi = 1`,
    :math:`d\omega^2/dx = \phi.(K_x - \omega^2 M_x) \phi`, and about a static state also
    :math:`-\eta.r_x`, as the state depends on the parameters: :math:`K \eta` is the derivative of
    :math:`\phi.K \phi` by the state, and r the residual. With damping, or in a steady turn, the
    vector on the left is the mode of the transposed equations. Derivatives along :math:`\phi` are
    differences of order six, with an error of about 1e-8, in which no contact opens or closes; all
    other derivatives are exact, if `build` takes dual numbers.

    From the second call on modes keep their order, also where frequencies cross: mode i has the
    shape most similar to mode i of the call before (MAC, with the mass). Several threads may call
    it; the call before is then that of the same thread, as with `Response`.

    Parameters
    ----------
    build : callable
        ``build(x)`` gives the scene.
    n : int
        Number of modes.
    state : callable, optional
        ``state(scene)`` computes the equilibrium about which the scene vibrates, such as ``lambda
        scene: fb.static(scene)``, also in a steady turn, ``fb.static(scene, spin=...)``; by default
        the reference configuration without loads. If springs are under tension there, a warning
        says that the stiffness does not include the forces with which they load the members.
    damped : bool
        Whether damping is included: ``w`` is then (n, 2), with frequencies and damping ratios, as
        in `modes`.

    Attributes
    ----------
    modes : Modes
        The modes of the last call.

    Raises
    ------
    SceneError
        If `build` or `state` is no function of its argument; in a call if x has values that are not
        finite, if `build` gives no scene, if `state` gives no static solution of the scene, and in
        the cases of `modes`. In derivatives for sticking friction (of a contact if it is closed),
        for internal variables in a steady turn, for contact of members in scenes with nodes that
        slide on beams, or if the tangent of the state is singular.

    Examples
    --------
    The first frequency of a cantilever grows with the root of its stiffness, and falls with the
    square of its length.

    >>> import fx_beam as fb
    >>> def build(x):
    ...     scene = fb.Scene()
    ...     section = fb.Section(EA=1e4 * x[0], GA=1e4 * x[0], EI=x[0], rhoA=1.0)
    ...     beam = scene.add_beam([(0, 0), (x[1], 0)], section, elements=8)
    ...     scene.clamp(beam.start)
    ...     return scene
    >>> run = fb.ModalResponse(build, n=2)
    >>> w = run([1.0, 1.0])
    >>> (run.jacobian()[0] / w[0]).round(2)
    array([ 0.5, -2. ])
    """

    def __init__(
        self,
        build: Callable[..., Scene],
        n: int = 6,
        *,
        state: Callable[[Scene], Solution] | None = None,
        damped: bool = False,
    ):
        require(is_whole(n, 1), "ModalResponse: n", n, "a whole number from 1 on")
        require(is_flag(damped), "ModalResponse: damped", damped, "True or False")
        check_takes(build, "x", "ModalResponse: build")
        self._begin(build, n, state, damped)

    def _begin(self, *arguments) -> None:
        super()._begin(*arguments)
        build, self._n, state, self._damped = arguments
        self._parameters = Parametrised(build, _read, "modes")
        self._tangent = TangentAnalysis(
            self._parameters, "ModalResponse", "modes", state, self._damped
        )
        # Shapes (size, n) of the last modes in their places.
        self._shapes: np.ndarray | None = None

    @property
    def modes(self) -> Modes:
        """The modes of the last call."""
        return self._state()._result

    @one_call
    def __call__(self, x: ArrayLike) -> np.ndarray:
        """Compute the modes of the scene of some numbers.

        Parameters
        ----------
        x : (m,) float
            The parameters that `build` takes.

        Returns
        -------
        (n,) float
            Angular frequencies [rad/s]: zero for rigid modes, negative for unstable ones, as
            `Modes.angular_frequencies`; fewer than n if the scene has fewer. With `damped` (n, 2),
            in the second column damping ratios.
        """
        values = self._parameters.check_x(x)
        self._linear = linear = self._tangent.run(values)
        if not linear.has_potential:
            raise SceneError(
                "ModalResponse: the stiffness is not symmetric, since a load or an added virtual "
                "work depends on the motion and has no potential, or friction slips, or sticks to "
                "what is round or bends: such modes have no derivatives. fx_beam.modes has them "
                'without; of loads at flutter the output "critical_load" of StaticResponse has some'
            )
        self._looked_above = False
        self._damping = linear.damping("modes", self._damped)
        extra = 2 if self._damped else 0  # copies above are seen without damping only
        if self._take_modes(self._n + extra) < _SAME:
            self._take_modes(2 * self._n + _MORE)
        roots, omega, ratios, vectors = self._modes.only(slice(self._n))
        self._shapes = linear.T @ vectors
        self._result = modes_of(
            linear.model, linear.start.q, self._shapes, omega, omega == 0, ratios, roots
        )
        self._parameters.x = values
        return np.column_stack([omega, ratios]) if self._damped else omega.copy()

    def _take_modes(self, count: int) -> float:
        """Find the lowest modes, in their places; the least likeness to the last ones there."""
        lowest, _ = lowest_modes(self._linear, self._damping, count)
        order, alike = self._places(lowest.vectors)
        self._modes = lowest.only(order)
        return alike

    def _places(self, vectors: np.ndarray) -> tuple[np.ndarray, float]:
        """Order of the modes: first as the shapes of the last call; the least likeness of a pair.

        By the modal assurance criterion.
        """
        linear, last = self._linear, self._shapes
        shapes = linear.T @ vectors
        mode_numbers = np.arange(shapes.shape[1])
        if last is None or len(last) != len(shapes) or last.shape[1] > len(mode_numbers):
            return mode_numbers, 1.0
        mass = linear.model.masses.matrix
        lengths = [np.einsum("ij,ij->j", x.conj(), mass @ x).real for x in (last, shapes)]
        alike = abs(last.conj().T @ (mass @ shapes)) ** 2 / np.outer(*lengths)
        rows, order = linear_sum_assignment(-alike)
        return np.append(order, np.setdiff1d(mode_numbers, order)), float(alike[rows, order].min())

    # -- Derivatives ------------------------------------------------------------------------------

    @one_call
    def jacobian(self) -> np.ndarray:
        """Derivatives of the frequencies of the last call by all numbers.

        For modes with the same frequency they are the eigenvalues of the matrix of derivatives of
        these modes; a warning says so.

        Returns
        -------
        (n, m) float
            dw/dx; zero for rigid modes. With `damped` (n, 2, m), for frequencies and damping
            ratios.

        Raises
        ------
        SceneError
            Before the first call, for scenes without derivatives, and for overdamped modes.
        """
        self._follow()
        groups, count = [*self._groups()], len(self._parameters.x)
        jacobian = np.zeros((len(self._modes.frequencies), 1 + self._damped, count))
        # A mode alone is a group as well; matrices have a lower triangle.
        triangles = [np.tril_indices(len(group)) for group in groups]
        entries = [group[np.array(ij)] for group, ij in zip(groups, triangles, strict=True)]
        left, right = np.hstack([np.zeros((2, 0), int), *entries])
        root_weights = self._by_roots(right)
        weights = np.vstack([*map(np.diag, root_weights)])
        root_slopes = self._tangent.of_sums(self._pairs(left, right), weights)
        rows = root_slopes.reshape(*root_weights.shape, count)
        parts = np.split(rows, np.cumsum([len(i) for i, _ in triangles]), axis=1)
        for group, (i, j), group_rows in zip(groups, triangles, parts, strict=False):
            if len(group) > 1:
                self._warn_of(group)
            matrices = np.zeros((len(rows), count, len(group), len(group)))
            matrices[..., i, j] = group_rows.swapaxes(1, 2)
            jacobian[group] = np.moveaxis(np.linalg.eigvalsh(matrices), -1, 0)
        return jacobian[: self._n] if self._damped else jacobian[: self._n, 0]

    @one_call
    def vjp(self, weights: Sequence[float]) -> np.ndarray:
        """Derivatives of a sum of weights times frequencies of the last call, by all numbers.

        Parameters
        ----------
        weights : (n,) or (n, 2) float
            Weights of the frequencies, or of frequencies and damping ratios with `damped`.

        Returns
        -------
        (m,) float
            The sum of weights times dw/dx.

        Raises
        ------
        SceneError
            In the cases of `jacobian`; for weights of another shape, and for modes of the same
            frequency with different weights, since only the sum of these frequencies has a
            gradient.
        """
        self._follow()
        name = "ModalResponse.vjp: weights"
        shape = (len(self.modes), 2) if self._damped else (len(self.modes),)
        weight_values = array_of(weights, name)
        ok = weight_values.shape == shape and np.isfinite(weight_values).all()
        require(bool(ok), name, weights, f"{shape} finite numbers")
        all_weights = np.zeros((len(self._modes.frequencies), 1 + self._damped))
        all_weights[: len(weight_values)] = weight_values.reshape(len(weight_values), -1)
        modes = list[np.ndarray]()
        for group in self._groups():
            if np.ptp(all_weights[group], axis=0).any():
                raise SceneError(
                    f"ModalResponse.vjp: the modes {group.tolist()} have the same frequency, so "
                    f"that only their sum has a gradient, but the weights "
                    f"{all_weights[group].tolist()}. Give equal weights, or all modes of the group "
                    "by a larger n, or use jacobian"
                )
            modes.append(group[all_weights[group].any(axis=1)])
        if not sum(map(len, modes)):
            return np.zeros(len(self._parameters.x))
        chosen = np.concatenate(modes)
        weight_values = (self._by_roots(chosen) * all_weights[chosen].T).sum(axis=0)
        return self._tangent.of_sums(self._pairs(chosen, chosen), weight_values[None])[0]

    def _follow(self) -> None:
        """Find derivatives of all numbers, and modes above if these have the same frequency."""
        self._tangent.changes()
        if self._looked_above or self._damped or self._damping is not None:
            return
        highest = self._modes.frequencies.max()
        bound = highest * abs(highest) + 2 * _EQUAL * highest**2
        if self._linear.undamped_modes.count_below(bound) != len(self._modes.frequencies):
            self._take_modes(2 * self._n + _MORE)
        self._looked_above = True

    def _groups(self) -> Iterator[np.ndarray]:
        """Groups of modes with the same root, without rigid modes."""
        order = np.lexsort((self._modes.roots.real, self._modes.frequencies))
        order = order[self._modes.frequencies[order] != 0]
        gaps, sizes = abs(np.diff(self._modes.roots[order])), abs(self._modes.roots[order[1:]])
        for group in np.split(order, np.flatnonzero(gaps > _EQUAL * sizes) + 1):
            if len(group) and group.min() < self._n:
                yield np.sort(group)

    def _by_roots(self, modes: np.ndarray) -> np.ndarray:
        """Factors (1 or 2, n) of ds: the real part is the change of a frequency, and of a ratio."""
        s, w = self._modes.roots[modes], abs(self._modes.frequencies[modes])
        if self._damped and not s.imag.all():
            raise SceneError(
                f"ModalResponse: mode {modes[int(np.argmin(abs(s.imag)))]} does not vibrate: it is "
                "overdamped, or grows, and has no derivatives with damped=True"
            )
        frequency_factors = np.where(s.imag, np.conj(s) / w, -1.0)
        ratio_factors = (s.real * np.conj(s) / w**2 - 1) / w
        return np.array([frequency_factors, ratio_factors] if self._damped else [frequency_factors])

    def _pairs(self, left: np.ndarray, right: np.ndarray) -> Pairs:
        """Pairs with the derivatives of roots s, or of entries of matrices for equal roots.

        With left and right vectors l and x, ds = -l.(s^2 dM + s dC + dK) x / l.(2 s M + C) x.
        """
        modes, mode_of = np.unique(right, return_inverse=True)
        linear, C, vectors = self._linear, self._damping, self._modes.vectors
        x, lefts = vectors.T, vectors[:, left].T
        s, slope = self._modes.roots[right], 2 * self._modes.roots[right]
        if C is not None:
            pencil, A = DampedPencil(linear.stiffness, C, linear.inertia), C.alone
            if abs(A - A.T).max() > _SYMMETRIC * abs(A).max():
                lefts = np.array(
                    [_left_vector(pencil, *mode) for mode in zip(s, lefts, strict=True)]
                )
            sides = 2 * s * (pencil.M @ x[right].T) + pencil.C @ x[right].T
            slope = (lefts * sides.T).sum(axis=1)
        times = 1 / abs(self._modes.frequencies[modes])
        return Pairs(x[modes], lefts, mode_of, -1 / slope, -s / slope, -(s**2) / slope, times)

    def _warn_of(self, group: np.ndarray) -> None:
        """Tell of modes with the same root; SceneError if they have no derivatives."""
        if self._damped or self._damping is not None:
            raise SceneError(
                f"ModalResponse: the modes {group.tolist()} have the same root, and no "
                "derivatives. Let them differ, or leave damping out"
            )
        _log.warning(_REPEATED, len(group), self._modes.frequencies[group[0]])


def _left_vector(pencil: DampedPencil, root: complex, x: np.ndarray) -> np.ndarray:
    """The left vector of a mode, by inverse iteration at its root; x is the right one."""
    s = root * (1 + _BESIDE)
    factors = pencil.matrix_at(s)
    left = np.conj(x)
    for _ in range(_ITERATIONS):
        left = factors.solve(left, "T")
        left /= np.linalg.norm(left)
    return left


# -- Steady vibrations under a harmonic load as a function of parameters, with derivatives ------


_WHAT = "HarmonicResponse"
_LOAD = "amplitudes of the load"
# Complex components (3,) of their real and imaginary parts (6,).
_COMPLEX = np.kron(np.eye(3), [[1], [1j]])
# Errors of the frequency of a peak, relative to it: first where the amplitude is largest, then
# where its slope is zero.
_PLACE, _EXACT = 1e-7, 1e-14


class Peak(NamedTuple):
    """A largest amplitude over frequency, with its derivatives (m,) by the numbers."""

    frequency: float
    amplitude: float
    gradient: np.ndarray


class _Vibrations(NamedTuple):
    """Motions under a load, and adjoint ones: right sides (free, 1 + c) of equations.

    Inertia forces of a base `grow` with the square of the frequency.
    """

    vibration: Vibration
    sides: np.ndarray
    grow: bool

    def sides_at(self, frequency: float) -> np.ndarray:
        """Right sides at a frequency [Hz]."""
        factors = np.ones(self.sides.shape[1])
        factors[0] = (2 * np.pi * frequency) ** 2 if self.grow else 1.0
        return self.sides * factors

    def solved(self, frequency: float) -> tuple[np.ndarray, np.ndarray]:
        """The motion (free,) at a frequency, and those (c, free) of the adjoint components."""
        system, sides = self.vibration.at_frequency(frequency), self.sides_at(frequency)
        if system.symmetric:
            solved = system.solved(sides).T
            return solved[0], solved[1:]
        return system.solved(sides[:, 0]), system.solved(sides[:, 1:], transposed=True).T


class HarmonicResponse(ParameterFunction):
    r"""Steady vibrations under a harmonic load as a function of parameters.

    ``values = run(x)`` builds the scene of the parameters x and computes complex amplitudes as
    `frequency_response` does. With :math:`D = K + i \omega C - \omega^2 M` and :math:`D \hat x =
    \hat F`, the derivative of a component :math:`r.\hat x` is :math:`\lambda.(\hat F_x - D_x \hat
    x) + r_x.\hat x`, with :math:`D^T \lambda = r`: one more linear system with the same matrix for
    each frequency and component. Derivatives along :math:`\hat x` are differences of order six, as
    in `ModalResponse`; the dependence of a static state is included. Several threads may call it,
    as with `Response`.

    Parameters
    ----------
    build : callable
        ``build(x)`` gives ``(scene, load, at)``: the scene, and `load` and `at` as in
        `frequency_response`.
    frequencies : (n,) float
        Frequencies of the load [Hz], zero or positive.
    state : callable, optional
        ``state(scene)`` computes the equilibrium about which the scene vibrates, such as ``lambda
        scene: fb.static(scene)``, also in a steady turn, ``fb.static(scene, spin=...)``; by default
        the reference configuration without loads. If springs are under tension there, a warning
        says that the stiffness does not include the forces with which they load the members.
    base : (2,) complex, optional
        Amplitudes of the displacement of the base [m], as in `frequency_response`; then the load
        that `build` gives is None.

    Attributes
    ----------
    response : FrequencyResponse
        The amplitudes of the last call.

    Raises
    ------
    SceneError
        If `build` or `state` is no function of its argument; in a call if `build` or `state` gives
        something else, and in the cases of `frequency_response`. In derivatives in the cases of
        `ModalResponse`.

    Examples
    --------
    An oscillator under a constant load, and at half of its natural frequency: the amplitude is 1 /
    (k - w^2 m), its derivative by the stiffness k is -1 / (k - w^2 m)^2.

    >>> import math, fx_beam as fb
    >>> def build(x):
    ...     scene = fb.Scene()
    ...     body = scene.add_body((0, 0), mass=1.0, inertia=1.0)
    ...     spring = fb.Spring(4 * math.pi**2 * x[0])
    ...     scene.add_joint(fb.Prismatic(fb.GROUND, body.centre, axis=(1, 0), spring=spring))
    ...     return scene, (body.centre, (4 * math.pi**2, 0.0)), body.centre
    >>> run = fb.HarmonicResponse(build, [0.0, 0.5])
    >>> run([1.0])[:, 0].real.round(3)
    array([1.   , 1.333])
    >>> run.jacobian()[:, 0, 0].real.round(3)
    array([-1.   , -1.778])
    """

    def __init__(
        self,
        build: Callable[..., tuple],
        frequencies: Sequence[float],
        *,
        state: Callable[[Scene], Solution] | None = None,
        base: Sequence[complex] | None = None,
    ):
        check_takes(build, "x", f"{_WHAT}: build")
        f = checked_frequencies(frequencies, f"{_WHAT}: frequencies")
        self._begin(build, f, state, base)

    def _begin(self, *arguments) -> None:
        super()._begin(*arguments)
        build, self._f, state, self._base = arguments
        self._parameters = Parametrised(build, self._read, "amplitudes", self._load_numbers)
        self._tangent = TangentAnalysis(self._parameters, _WHAT, _WHAT, state, damped=True)

    @property
    def response(self) -> FrequencyResponse:
        """The amplitudes of the last call."""
        return self._state()._result

    def _read(self, built: tuple) -> tuple[Scene, tuple]:
        """The scene, and its load and where the motion is wanted."""
        ok = isinstance(built, tuple) and len(built) == 3 and isinstance(built[0], Scene)
        ok = ok and (built[1] is None) == (self._base is not None)
        expected = "(scene, load, at)" if self._base is None else "(scene, None, at), with a base"
        require(ok, f"{_WHAT}: what build gives", built, expected)
        return built[0], built[1:]

    @one_call
    def __call__(self, x: ArrayLike) -> np.ndarray:
        """Compute the vibrations of the scene of some numbers.

        Parameters
        ----------
        x : (m,) float
            The parameters that `build` takes.

        Returns
        -------
        (n, c) complex
            Amplitudes [m or rad] of the components, as `FrequencyResponse.values`: their size is
            the amplitude of the motion, their angle its phase.
        """
        values = self._parameters.check_x(x)

        def take_load(linear: Linearisation) -> None:
            load = self._parameters.besides[0]
            self._force, self._moved = forces_and_base(linear, load, self._base, _WHAT)

        linear = self._tangent.run(values, take_load)
        _, observed = self._parameters.besides
        self._load_changes: np.ndarray | None = None
        self._measured = ObservedMotion(linear, observed, f"{_WHAT}: at")
        sides = np.array([linear.unknown_forces(self._force), *self._measured.rows]).T
        self._vibrations = _Vibrations(Vibration(linear, _WHAT), sides, self._base is not None)
        solved = [self._vibrations.solved(f) for f in self._f]
        motions, adjoints = map(np.array, zip(*solved, strict=True))
        self._solutions = self._f, motions, adjoints
        amplitudes = motions @ self._measured.rows.T + self._measured.node_rows @ self._moved
        self._result = FrequencyResponse(observed, self._f, self._measured.names, amplitudes)
        self._parameters.x = values
        return amplitudes.copy()

    # -- Derivatives ------------------------------------------------------------------------------

    @one_call
    def vjp(self, weights: ArrayLike) -> np.ndarray:
        """Derivatives of the real part of a sum of weights times amplitudes of the last call.

        Parameters
        ----------
        weights : (n, c) float or complex
            Weights of the complex amplitudes z. For the gradient of a sum of abs(z)^2 they are 2
            conj(z), of a sum of abs(z) they are conj(z) / abs(z).

        Returns
        -------
        (m,) float
            Re sum of weights times d values/dx.

        Raises
        ------
        SceneError
            Before the first call, for weights of another shape, and for scenes without derivatives.
        """
        name, values = f"{_WHAT}.vjp: weights", self.response.values
        factors = array_of(np.real(weights), name) + 1j * array_of(np.imag(weights), name)
        ok = factors.shape == values.shape and np.isfinite(factors).all()
        require(bool(ok), name, weights, f"{values.shape} finite numbers")
        pairs = self._pairs(self._solutions, factors[:, None])
        return self._of_sums(pairs, np.ones((1, len(values))))[0]

    @one_call
    def jacobian(self) -> np.ndarray:
        """Derivatives of all amplitudes of the last call by all numbers.

        Returns
        -------
        (n, c, m) complex
            d values/dx.

        Raises
        ------
        SceneError
            As of `vjp`.
        """
        values = self.response.values
        parts = np.vstack([np.eye(values.size) * part for part in (1, -1j)])
        pairs = self._pairs(self._solutions, np.eye(values.shape[1])[None])
        rows = self._of_sums(pairs, parts)
        real, imaginary = rows.reshape(2, *values.shape, len(self._parameters.x))
        return real + 1j * imaginary

    @one_call
    def peaks(self, component: str) -> list[Peak]:
        """The peaks of an amplitude between the frequencies, with derivatives of their heights.

        Parameters
        ----------
        component : str
            One of the names of `response`.

        Returns
        -------
        list of Peak
            Frequencies [Hz], amplitudes and gradients (m,) of the peaks, by rising frequency. A
            peak is looked for around each of `frequencies` whose amplitude is larger than those of
            both neighbours. The gradient of the height of a peak is that of the amplitude at its
            frequency, as the slope over the frequency is zero there.

        Raises
        ------
        SceneError
            In the cases of `vjp`, and for an unknown component.
        """
        names, name = self.response.names, f"{_WHAT}.peaks: component"
        require(is_one_of(component, names), name, component, f"one of {', '.join(names)}")
        i = names.index(component)
        vibrations = self._vibrations
        row, order = self._measured.rows[i], np.argsort(self._f)
        base_part = self._measured.node_rows[i] @ self._moved
        size, f = abs(self.response.values[order, i]), self._f[order]

        def minus_amplitude(frequency: float) -> float:
            side = vibrations.sides_at(frequency)[:, 0]
            return -float(
                abs(row @ vibrations.vibration.at_frequency(frequency).solved(side) + base_part)
            )

        def slope(frequency: float) -> float:
            motion, adjoints = vibrations.solved(frequency)
            frequency_slope = adjoints[i] @ vibrations.vibration.frequency_slope(motion)
            if vibrations.grow:
                frequency_slope -= 4 * np.pi * frequency * (adjoints[i] @ vibrations.sides[:, 0])
            return float((np.conj(row @ motion + base_part) * frequency_slope).real)

        peaks = []
        for k in np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:])) + 1:
            search = {"bounds": (f[k - 1], f[k + 1]), "options": {"xatol": _PLACE * f[k]}}
            guess = float(minimize_scalar(minus_amplitude, method="bounded", **search).x)
            peak = float(
                newton(slope, guess, x1=guess * (1 + _PLACE), tol=_EXACT * guess, disp=False)
            )
            motion, adjoints = vibrations.solved(peak)
            value = row @ motion + base_part
            weights = np.conj(value) / abs(value) * (np.arange(len(names)) == i)
            solution = np.array([peak]), motion[None], adjoints[None]
            gradient = self._of_sums(self._pairs(solution, weights[None, None]), np.ones((1, 1)))[0]
            peaks.append(Peak(peak, float(abs(value)), gradient))
        return peaks

    def _load_numbers(self, scene: Scene, built: tuple, known: tuple) -> DualArrays:
        """Components (fx, fy, moment), real and imaginary parts (6,), of the load of a scene."""
        _, components = built[0] or (None, (0.0, 0.0))
        parts = [(c.real, c.imag) if np.iscomplexobj(c) else (c, 0.0) for c in components]
        flat = np.reshape(dual_array(parts), -1)
        return {_LOAD: np.concatenate([flat, np.zeros(6 - len(flat))])}

    def _pairs(self, solutions: tuple[np.ndarray, ...], weights: np.ndarray) -> Pairs:
        """Pairs with the derivatives of weights (., k, c) times amplitudes, but for the load's.

        At frequencies (k,), with motions (k, free) and adjoint ones (k, c, free).
        """
        frequencies, motions, adjoints = solutions
        left, node_weights = weights @ adjoints, weights @ self._measured.node_rows
        owner, w = np.arange(len(left)).repeat(left.shape[1]), 2 * np.pi * frequencies
        node_weights = np.broadcast_to(node_weights, (*left.shape[:2], node_weights.shape[2]))
        has_base = self._base is not None
        return Pairs(
            right=motions,
            left=left.reshape(len(owner), -1),
            owner=owner,
            stiffness=-1.0,
            damping=-1j * w[owner],
            mass=w[owner] ** 2,
            times=1 / np.where(w > 0, w, 1.0),
            left_forces=np.multiply.outer(w[owner] ** 2, self._force) if has_base else self._force,
            right_forces=node_weights.reshape(len(owner), -1),
            base=self._moved if has_base else None,
        )

    def _of_sums(self, pairs: Pairs, weights: np.ndarray) -> np.ndarray:
        """Derivatives (s, m) of real parts of weights (s, n) times sums, with those by the load."""
        if self._load_changes is None:
            self._load_changes = self._tangent.changes()[_LOAD] @ _COMPLEX
        slopes = self._tangent.of_sums(pairs, weights)
        if not self._load_changes.any():
            return slopes
        node, linear = self._parameters.besides[0][0], self._tangent.linear
        node_motions = linear.T[linear.model.mesh.dofs[node.number]]
        load_slopes = weights @ (pairs.left @ node_motions.T @ self._load_changes.T)
        return slopes + load_slopes.real
