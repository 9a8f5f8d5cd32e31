"""Steady vibrations under a harmonic load as a function of parameters, with derivatives."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import minimize_scalar, newton

from fx_beam.dual import dual_array
from fx_beam.errors import array_of, check_takes, is_one_of, require
from fx_beam.linear.harmonic import (
    ObservedMotion,
    Vibration,
    checked_frequencies,
    forces_and_base,
)
from fx_beam.linear.linearisation import Linearisation
from fx_beam.results.solution import Solution
from fx_beam.results.vibrations import FrequencyResponse
from fx_beam.scene.scene import Scene

from .gradient import DualArrays
from .parametrised import ParameterFunction, Parametrised, one_call
from .tangent_analysis import TangentAnalysis
from .tangent_derivatives import Pairs

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
    x) + r_x.\hat x`, with :math:`D^T \lambda = r`: one more right side for each frequency and
    component. Derivatives along :math:`\hat x` are differences of order six, as in `ModalResponse`;
    the dependence of a static state is included. Threads may call it at once, as a `Response`.

    Parameters
    ----------
    build : callable
        ``build(x)`` gives the scene, the load and where the motion is wanted,
        ``(scene, load, at)``, the latter as in `frequency_response`.
    frequencies : (n,) float
        Frequencies of the load [Hz], zero or positive.
    state : callable, optional
        ``state(scene)`` computes the equilibrium about which the scene vibrates, such as
        ``lambda scene: fb.static(scene)``, also in a steady turn, ``fb.static(scene, spin=...)``;
        by default the reference configuration without loads; if springs are under tension there,
        what they press has none of their force, with a warning.
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
        something else, and as of `frequency_response`. In derivatives as of `ModalResponse`.

    Examples
    --------
    An oscillator at rest, and at half of its natural frequency: by its stiffness k the amplitude
    1 / (k - w^2 m) changes by -1 / (k - w^2 m)^2.

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
            Weights of what the call has given. For a sum of squares of amplitudes twice their
            conjugates, for amplitudes their conjugates over their sizes.

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
            Their frequencies [Hz], amplitudes and gradients (m,), by rising frequency: one for each
            of `frequencies` with a larger amplitude than both beside it, found between these. The
            height of a peak does not change with its place, so that the gradient is that at a
            constant frequency.

        Raises
        ------
        SceneError
            As of `vjp`, and for a name that is none.
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
