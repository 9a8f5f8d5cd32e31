"""Steady vibrations under a harmonic load as a function of numbers, with derivatives."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from threading import RLock
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from fx_beam.array_calls import ArrayCalls, calling_with_arrays
from fx_beam.dual import stacked
from fx_beam.errors import array_of, check_takes, is_one_of, require
from fx_beam.linear.harmonic import Measured, Vibration, checked_frequencies, nodal_load
from fx_beam.linear.linearisation import check_equilibrium, linearised
from fx_beam.results.solution import Solution
from fx_beam.results.vibrations import FrequencyResponse
from fx_beam.scene.scene import Scene
from fx_beam.step.interrupts import one_thread

from .built_scenes import BuiltScenes, checked_numbers
from .tangent_derivatives import Product, TangentDerivatives, checked_state

_WHAT = "HarmonicResponse"
_LOAD = "amplitudes of the load"
# Error of the frequency of a peak, relative to it; that of its amplitude is the square.
_PLACE = 1e-7


class Peak(NamedTuple):
    """A largest amplitude over frequency, with its derivatives (m,) by the numbers."""

    frequency: float
    amplitude: float
    gradient: np.ndarray


class HarmonicResponse:
    r"""Steady vibrations under a harmonic load as a function of numbers.

    ``values = run(x)`` builds the scene of the numbers x and computes complex amplitudes as
    `frequency_response` does. With :math:`D = K + i \omega C - \omega^2 M` and :math:`D \hat x =
    \hat F`, the derivative of a component :math:`r.\hat x` is :math:`\lambda.(\hat F_x - D_x \hat
    x) + r_x.\hat x`, with :math:`D^T \lambda = r`: one more substitution for each frequency and
    component. Derivatives along :math:`\hat x` are differences of order six, as in `ModalResponse`;
    the dependence of a static state is included.

    Parameters
    ----------
    build : callable
        ``build(x)`` gives the scene, the load and where the motion is wanted,
        ``(scene, load, at)``, the latter as in `frequency_response`.
    frequencies : (n,) float
        Frequencies of the load [Hz], zero or positive.
    state : callable, optional
        ``state(scene)`` computes the equilibrium about which the scene vibrates, such as
        ``lambda scene: fb.static(scene)``; by default the reference configuration without loads.

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
        build: Callable[[Any], tuple],
        frequencies: Sequence[float],
        *,
        state: Callable[[Scene], Solution] | None = None,
    ):
        check_takes(build, "x", f"{_WHAT}: build")
        if state is not None:
            check_takes(state, "scene", f"{_WHAT}: state")
        self._build, self._state = build, state
        self._f = checked_frequencies(frequencies, f"{_WHAT}: frequencies")
        self._begin()

    def _begin(self) -> None:
        """Know of no call yet."""
        self._alone, self._calls = RLock(), ArrayCalls()
        self._scenes = BuiltScenes(self._built)
        # What `build` gives besides a scene.
        self._given = dict[Scene, tuple]()
        self._x: Any = None
        self._tangent: TangentDerivatives | None = None
        self._changes: dict[str, np.ndarray] | None = None
        self.response: FrequencyResponse

    def __getstate__(self):
        return {name: vars(self)[name] for name in ("_build", "_f", "_state")}

    def __setstate__(self, given):
        vars(self).update(given)
        self._begin()

    def _built(self, x: Any) -> tuple[Scene, Mapping[str, Any]]:
        built = self._build(x)
        fits = isinstance(built, tuple) and len(built) == 3 and isinstance(built[0], Scene)
        require(fits, f"{_WHAT}: what build gives", built, "(scene, load, at)")
        self._given[built[0]] = built[1:]
        return built[0], {"vibration": lambda solution: 0.0}

    @one_thread
    def __call__(self, x: Sequence[float]) -> np.ndarray:
        """Compute the vibrations of the scene of some numbers.

        Parameters
        ----------
        x : (m,) float
            The numbers that `build` takes.

        Returns
        -------
        (n, c) complex
            Amplitudes [m or rad] of the components, as `FrequencyResponse.values`: their size is
            the amplitude of the motion, their angle its phase.
        """
        given, self._x, self._changes = checked_numbers(x), None, None
        self._given.clear()
        with calling_with_arrays(self._calls):
            scene, _ = self._scenes.at(given)
            state = self._state and checked_state(self._state, scene, _WHAT)
            self._about = about = linearised(scene, state, _WHAT)
        check_equilibrium(about, state, _WHAT)
        self._scene, self._end = scene, state
        load, at = self._given[scene]
        self._force = nodal_load(about, load, f"{_WHAT}: load")
        self._reduced = about.T.T @ self._force
        self._measured = Measured(about, at, f"{_WHAT}: at")
        self._vibration = Vibration(about, _WHAT)
        solved = [self._solved(f) for f in self._f]
        self._motions, self._adjoints = map(np.array, zip(*solved, strict=True))
        values = self._motions @ self._measured.rows.T
        self.response = FrequencyResponse(at, self._f, self._measured.names, values)
        self._x = given
        return values.copy()

    def _solved(self, frequency: float) -> tuple[np.ndarray, np.ndarray]:
        """The motion (free,) at a frequency, and those (c, free) of the adjoint components."""
        vibration, rows = self._vibration.at(frequency), self._measured.rows
        motion = vibration.solved(self._reduced)
        return motion, np.array([vibration.solved(row + 0j, transposed=True) for row in rows])

    # -- Derivatives ------------------------------------------------------------------------------

    @one_thread
    def vjp(self, weights: Sequence[Any]) -> np.ndarray:
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
        self._begin_derivatives("vjp")
        what, values = f"{_WHAT}.vjp: weights", self.response.values
        given = array_of(np.real(weights), what) + 1j * array_of(np.imag(weights), what)
        fits = given.shape == values.shape and np.isfinite(given).all()
        require(bool(fits), what, weights, f"{values.shape} finite numbers")
        return self._derivatives([[*enumerate(given)]])[0]

    @one_thread
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
        self._begin_derivatives("jacobian")
        values = self.response.values
        units = np.eye(values.shape[1])
        sums = [[(k, u * part)] for k in range(len(values)) for u in units for part in (1, -1j)]
        parts = self._derivatives(sums).reshape(*values.shape, 2, -1)
        return parts[..., 0, :] + 1j * parts[..., 1, :]

    @one_thread
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
        self._begin_derivatives("peaks")
        names = self.response.names
        what = f"{_WHAT}.peaks: component"
        require(is_one_of(component, names), what, component, f"one of {', '.join(names)}")
        i = names.index(component)
        row, order = self._measured.rows[i], np.argsort(self._f)
        size, f = abs(self.response.values[order, i]), self._f[order]

        def amplitude(frequency: float) -> float:
            return float(abs(row @ self._solved(frequency)[0]))

        peaks = []
        for k in np.flatnonzero((size[1:-1] > size[:-2]) & (size[1:-1] >= size[2:])) + 1:
            found = minimize_scalar(
                lambda frequency: -amplitude(frequency),
                bounds=(f[k - 1], f[k + 1]),
                method="bounded",
                options={"xatol": _PLACE * f[k]},
            )
            motion, adjoints = self._solved(found.x)
            value = row @ motion
            weights = np.conj(value) / abs(value) * (np.arange(len(names)) == i)
            gradient = self._of_sums([[self._product(found.x, motion, weights, adjoints)]])[0]
            peaks.append(Peak(float(found.x), float(abs(value)), gradient))
        return peaks

    def _begin_derivatives(self, what: str) -> None:
        wanted = "called after run(x) without an error"
        require(self._x is not None, f"{_WHAT}.{what}", "no amplitudes yet", wanted)
        if self._changes is not None:
            return
        damped = self._vibration.damped
        if self._tangent is None or self._tangent.damped != damped:
            self._tangent = TangentDerivatives(_WHAT, damped)
        self._tangent.begin(self._about, self._end)
        with calling_with_arrays(self._calls):
            changes = self._scenes.derivatives(self._x, self._scene, self._numbers_of)
        self._given = {self._scene: self._given[self._scene]}
        self._load_changes = changes.pop(_LOAD) @ np.kron(np.eye(3), [[1], [1j]])
        self._changes = changes

    def _numbers_of(self, scene: Scene, change: Any) -> dict[str, Any]:
        """The numbers of a scene and of its load, whose node is that of the last call."""
        assert self._tangent is not None  # after `_begin_derivatives`
        _, components = self._given[scene][0]
        parts = [(c.real, c.imag) if np.iscomplexobj(c) else (c, 0.0) for c in components]
        flat = np.reshape(stacked(parts), -1)
        filled = np.concatenate([flat, np.zeros(6 - len(flat))])
        return self._tangent.numbers_of(scene) | {_LOAD: filled}

    def _derivatives(self, sums: list[list[tuple[int, np.ndarray]]]) -> np.ndarray:
        """Derivatives (n, m) of real parts of sums of weights (c,) times amplitudes."""
        x, adjoints, f = self._motions, self._adjoints, self._f
        products = [[self._product(f[k], x[k], of, adjoints[k]) for k, of in row] for row in sums]
        return self._of_sums(products)

    def _product(
        self, frequency: float, motion: np.ndarray, weights: np.ndarray, adjoints: np.ndarray
    ) -> Product:
        """Its derivatives are those of weights times amplitudes, but by the load's numbers."""
        w, of_nodes = 2 * np.pi * frequency, weights @ self._measured.of_nodes
        factors = (-1.0, -1j * w, w**2, 1 / w if w else 1.0)
        left = weights @ adjoints
        return Product(left, motion, *factors, on_left=self._force, on_right=of_nodes)

    def _of_sums(self, sums: list[list[Product]]) -> np.ndarray:
        tangent, changes, about = self._tangent, self._changes, self._about
        assert tangent is not None and changes is not None  # after `_begin_derivatives`
        node = self._given[self._scene][0][0]
        at_node = about.T[about.model.mesh.dofs[node.number]]
        by_load = [sum(at_node @ product.left for product in products) for products in sums]
        by_load = np.array(by_load) @ self._load_changes.T
        return tangent.of_sums(about, sums, changes) + by_load.real
