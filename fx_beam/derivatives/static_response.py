"""Equilibria and critical loads as functions of parameters, with derivatives."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.equilibria.critical_points import FLUTTER, CriticalPoint, first_critical_point
from fx_beam.equilibria.load_steps import StaticOptions
from fx_beam.equilibria.statics import LoadPath
from fx_beam.errors import SceneError, check_takes
from fx_beam.linear.linearisation import linearised
from fx_beam.scene.outputs import CRITICAL_LOAD
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.sparse_lu import null_vectors, pivoted_lu
from fx_beam.step.tape import Tape
from fx_beam.step.tape_derivatives import TapeDerivatives

from .analysis import Analysis, DerivativesOf, StaticDerivatives
from .parametrised import Parametrised, one_call
from .response import Build, Response
from .tangent_derivatives import Pairs, TangentDerivatives

# -- Derivatives of the load at a critical point, and its sensitivity to imperfections ----------


# Work that is smaller, relative to its parts or to that of the load, is taken for round-off or an
# error in the place of the critical point.
_ZERO = 1e-5
# What counts of its parts in a motion of all unknowns by the size of the scene, or by a radian.
_ROUNDING = 1e-9
# The same of the slope of a bifurcation's mode, beside changes of its stiffness with the load.
_ASYMMETRIC = 1e-3
_WHAT = "StaticResponse: critical_load"


class Sensitivity(NamedTuple):
    """How a load falls with imperfections: by coefficients (m,) times their size to an exponent."""

    exponent: float
    coefficients: np.ndarray


class CriticalLoad:
    r"""The first critical point of a path, where the matrix B = K - s M has null vectors.

    K phi = s M phi, with s = 0 but for flutter, where s is the square of a frequency that two modes
    share. At a limit point :math:`d\lambda/dx = -\psi.r_x / \psi.r_\lambda`; else
    :math:`-g_x / g_\lambda` with the total derivatives of :math:`g = \psi.B \phi`, in which the
    state follows from x and the load.
    """

    def __init__(self) -> None:
        self._tangent, self._reference = TangentDerivatives(_WHAT), TangentDerivatives(_WHAT)

    def set_point(
        self, point: CriticalPoint, scene: Scene, derivatives: DerivativesOf, hold: np.ndarray
    ) -> None:
        """Take a point of the path of a scene, with `derivatives` of numbers of scenes by x.

        Forces `hold` (free,) balance the springs in the reference, and fade as the loads rise.
        """
        self._held = hold
        if hold.any():
            self._reference.set_state(linearised(scene, None, _WHAT, is_held=True), None)
            reference_changes = derivatives(self._reference.numbers_of)
            self._reference.set_changes(reference_changes, reference_changes.keys())
        self._point, state = point, point.solution
        assert state is not None and point.modes is not None  # of a point with a load factor
        if point.kind not in (FLUTTER, "limit point", "bifurcation"):
            raise SceneError(
                f"{_WHAT}: no derivatives: at load factor {point.load_factor:.6g} the stiffness "
                f"jumps ({point.kind}), and there is no smooth function of the parameters"
            )
        if len(point.modes) > 1:
            raise SceneError(
                f"{_WHAT}: no derivatives: {len(point.modes)} modes become unstable at once, at "
                f"load factor {point.load_factor:.6g}. Let them differ, by other parameters"
            )
        self._linear = linear = linearised(scene, state, _WHAT)
        start, beams = linear.start, linear.model.forms.beams
        flowed = linear.model.kinks.flows and any(
            x is not None and x.any() for x in (start.internal, start.spring_internal)
        )
        if flowed or (beams is not None and beams.has_external):
            reason = "material flows on the path" if flowed else "added virtual works have none"
            raise SceneError(f"{_WHAT}: no derivatives: {reason}")
        self._tangent.set_state(linear, state)
        changes, factor_slopes = derivatives(self._tangent.numbers_of), self._tangent.by_factor()
        #: Changes (m + 1, ...) of all numbers by x, and by the load factor.
        self._changes = {}
        for name, rows in changes.items():
            last = np.reshape(factor_slopes.get(name, 0 * rows[0]), (1, *rows[0].shape))
            self._changes[name] = np.concatenate([rows, last])
        self._tangent.set_changes(self._changes, self._changes.keys())
        omega = point.modes.angular_frequencies[0]
        self._square = omega**2 if point.kind == FLUTTER else 0.0
        self._unit = linear.model.units.unknowns[linear.unknowns]
        unit = scipy.sparse.diags(self._unit)
        self._B = (unit @ (linear.K - self._square * linear.M) @ unit).tocsr()
        left, right = (vectors[:, 0] for vectors in null_vectors(self._B))
        self._right, self._left = right, left if left @ right > 0 else -left
        self.phi, self.psi = self._unit * self._right, self._unit * self._left

    def _solved(self, state_gradient: np.ndarray) -> np.ndarray:
        """Weights w (free,) of forces with K^T w = `state_gradient` (free,).

        In the complement of the null vector if K is singular.
        """
        right_side = self._unit * state_gradient
        if self._square:
            unit = scipy.sparse.diags(self._unit)
            return self._unit * pivoted_lu((unit @ self._linear.K @ unit).T).solve(right_side)
        rows = [[self._B.T, self._right[:, None]], [self._left[None, :], None]]
        weights = pivoted_lu(scipy.sparse.bmat(rows)).solve(np.append(right_side, 0.0))
        return self._unit * weights[:-1]

    def derivatives(self) -> np.ndarray:
        """Derivatives (m,) of the load factor by x."""
        if self._point.kind == "limit point":
            totals = self._work(self.psi)
            return -totals[:-1] / totals[-1]
        totals, state_gradient, weights = self._along_path()
        if self._point.kind == "bifurcation":
            if len(disturbing := np.flatnonzero(self._disturbing(totals[-1]))):
                raise SceneError(self._infinite(int(disturbing[0])))
            if self._slope(totals[-1], state_gradient, weights)[0]:
                raise SceneError(
                    f"{_WHAT}: no derivatives: the bifurcation at load factor "
                    f"{self._point.load_factor:.6g} is not symmetric, and its place on the mode "
                    "follows from more than the tangent"
                )
        return -totals[:-1] / totals[-1]

    def sensitivity(self) -> Sensitivity:
        r"""How the load falls with parameters that are imperfections.

        On the mode, with the distance :math:`\xi`, :math:`A_2 \xi^2/2 + A_3 \xi^3/6 + B \xi
        \Delta\lambda + C \Delta x = 0` (Koiter): the path with C has a limit point.
        """
        if self._point.kind != "bifurcation":
            raise SceneError(
                f"StaticResponse.imperfection_sensitivity: a {self._point.kind} has none, "
                "only bifurcations have. For the slopes of this load use jacobian"
            )
        totals, state_gradient, weights = self._along_path()
        B, C = totals[-1], self._disturbing(totals[-1])
        slope, curvature = self._slope(B, state_gradient, weights)
        if slope:
            size = np.sqrt(2 * abs(slope * C)) / abs(B)
            return Sensitivity(1 / 2, np.sign(slope * C) * size)
        falls = (abs(curvature / B) / 2) ** (1 / 3) if curvature * B > 0 else 0.0
        return Sensitivity(2 / 3, falls * (1.5 * abs(C / B)) ** (2 / 3))

    def _slope(
        self, factor_change: float, state_gradient: np.ndarray, weights: np.ndarray
    ) -> tuple[float, float]:
        """A_2, or 0 if it is round-off, and A_3."""
        motions = self._tangent.along_motions(self._pair(0.0))
        _, curved = self._tangent.sum_derivatives(motions, np.ones(1), curved=True)
        curvature = float(self.phi @ curved - 3 * state_gradient @ weights)
        slope, size = self.phi @ state_gradient, abs(factor_change * self._point.load_factor)
        return (slope if abs(slope) > _ASYMMETRIC * (size + abs(curvature)) else 0.0), curvature

    def _along_path(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Total derivatives (m + 1,) of psi.B phi by x and by the load factor.

        And those by the state, with the weights of forces that belong to these.
        """
        motions = self._tangent.along_motions(self._pair(-self._square))
        by_name, state_gradient = self._tangent.sum_derivatives(motions, np.ones(1))
        weights = self._solved(state_gradient)  # the state follows by dy = -K^-1 dr
        return self._tangent.by_x(by_name) - self._work(weights), state_gradient, weights

    def _work(self, weights: np.ndarray) -> np.ndarray:
        """Derivatives (m + 1,) by x and the load factor of the work of all forces on a motion."""
        work = self._tangent.by_x(self._tangent.forces(weights))
        if self._held.any():
            spring_work = self._reference.by_x(self._reference.forces(weights))
            work[:-1] -= (1 - self._point.load_factor) * spring_work
            work[-1] += weights @ self._held
        return work

    def _pair(self, mass: float) -> Pairs:
        """The sum psi.K phi, and a factor times psi.M phi."""
        return Pairs(self.phi[None], self.psi[None], np.zeros(1, int), 1.0, mass=mass)

    def _disturbing(self, factor_change: float) -> np.ndarray:
        """Work (m,) on the mode of forces that appear with x; zero where it is round-off.

        So it is beside its parts, and beside the load's times the relative changes of numbers.
        """
        f, numbers = self._tangent.forces(self.psi), self._tangent.numbers_of(self._linear.scene)
        largest_forces = self._tangent.forces(self._unit)
        least = {name: _ROUNDING * abs(forces) for name, forces in largest_forces.items()}
        sizes = {name: np.maximum(abs(f[name]), least[name]) for name in f}
        changes = {name: abs(self._changes[name]) for name in f if self._changes[name].size}
        work, parts = self._work(self.psi)[:-1], self._tangent.by_x(sizes, changes)[:-1]
        relative = [
            rows.reshape(len(rows), -1).max(axis=1) / (abs(numbers[name]).max() or np.inf)
            for name, rows in changes.items()
        ]
        load_size = abs(factor_change * self._point.load_factor) * np.max(relative, axis=0)[:-1]
        return np.where(abs(work) > _ZERO * np.maximum(parts, load_size), work, 0.0)

    def _infinite(self, i: int) -> str:
        exponent, coefficients = self.sensitivity()
        power = f"|dx|^{'(2/3)' if exponent > 0.6 else '(1/2)'}"
        law = f"the critical load falls by {abs(coefficients[i]):.6g} {power}"
        if not coefficients[i]:
            law = "beside it the path bends without a limit point"
        return (
            f"{_WHAT}: no derivative by x[{i}], which is an imperfection of the scene with a "
            f"bifurcation at load factor {self._point.load_factor:.6g}: {law}, with an infinite "
            "slope here. See imperfection_sensitivity, or take a scene that has it already"
        )


# -- Equilibria as a function of parameters, with derivatives -----------------------------------


class StaticResponse(Response):
    """The equilibria of a scene as a function of parameters.

    ``factors, y = run(x)`` builds the scene of the parameters x and computes its equilibria by
    `static`. ``run.vjp(weights)`` and ``run.jacobian()`` are derivatives of the outputs at constant
    load factors. The derivatives are exact for the computed load steps, also if members or springs
    yield, and need no further equilibria. With an arc length, too, they hold at constant load
    factors of the rows; at a limit point there is no such derivative.

    Several threads may call it, and `map`, as with `Response`.

    The output "critical_load" of the scene is the load factor at the first critical point of the
    path, a single number, and its derivatives are those of the point.

    Parameters
    ----------
    build : callable
        ``build(x)`` gives the scene and its outputs, as in `Response`.
    load_steps : int
        Number of load steps.
    t : float
        Time at which functions of time are evaluated [s].
    continuation : {"arc-length"}, optional
        Method to pass limit points.
    newton : NewtonOptions, optional
        Convergence criteria of Newton's method.
    max_cuts, max_steps : int
        Limits of load steps and arc-length steps, as in `static`.
    inputs : dict, optional
        Constants or functions of time of the inputs of the scene.

    Attributes
    ----------
    stats : Stats
        Statistics of the last call.

    Raises
    ------
    SceneError
        In the cases of `Response`; if "critical_load" is an output and the path has no critical
        point. In derivatives also if springs under tension change internal variables before the
        loads act. In derivatives of the critical load also if several modes are critical at once,
        where the stiffness jumps, by parameters that are imperfections, with added virtual works,
        where material has flowed, and in the cases of `ModalResponse`.

    Examples
    --------
    A moment bends a cantilever to a half circle. The derivatives of the position of its tip by the
    factor x of the moment are exactly (-L, -2 L / pi), and close to them with straight elements.

    >>> import math, numpy as np, fx_beam as fb
    >>> def build(x):
    ...     scene = fb.Scene()
    ...     section = fb.Section(EA=1e4, GA=1e4, EI=1.0)
    ...     beam = scene.add_beam([(0, 0), (1, 0)], section, elements=40)
    ...     scene.clamp(beam.start)
    ...     scene.add_moment(beam.end, math.pi * x[0])
    ...     return scene, {"tip": fb.Output("position", beam.end)}
    >>> run = fb.StaticResponse(build, load_steps=4)
    >>> factors, y = run([1.0])
    >>> J = run.jacobian()
    >>> J["tip"].shape
    (5, 2, 1)
    >>> bool(abs(J["tip"][-1, :, 0] + [1, 2 / math.pi]).max() < 1e-3)
    True

    The load at which a column buckles is in proportion to its stiffness.

    >>> def column(x):
    ...     scene, section = fb.Scene(), fb.Section(EA=1e6, GA=1e6, EI=x[0])
    ...     beam = scene.add_beam([(0, 0), (0, 1)], section, elements=8, degree=3)
    ...     scene.pin(beam.start)
    ...     scene.fix(beam.end, "x")
    ...     scene.add_force(beam.end, (0, -1.0))
    ...     return scene, {"load": fb.Output("critical_load", scene)}
    >>> run = fb.StaticResponse(column, load_steps=4)
    >>> factors, y = run([0.05])
    >>> round(float(y["load"]) / math.pi**2, 5), (run.jacobian()["load"] / math.pi**2).round(5)
    (0.05, array([1.]))
    """

    _analysis: StaticAnalysis

    def __init__(
        self,
        build: Build,
        load_steps: int = 10,
        *,
        t: float = 0.0,
        continuation: str | None = None,
        newton: NewtonOptions | None = None,
        max_cuts: int = 8,
        max_steps: int = 1000,
        inputs: Mapping[str, object] | None = None,
    ):
        check_takes(build, "x", "StaticResponse: build")
        options = StaticOptions.among(locals(), progress=False)
        self._begin(build, functools.partial(StaticAnalysis, options))

    @one_call
    def imperfection_sensitivity(self) -> Sensitivity:
        r"""How the critical load falls if the parameters x of the last call become imperfections.

        Near a bifurcation the load is :math:`\lambda_c - c |\Delta x|^p` (Koiter 1945): p = 2/3 at
        a symmetric bifurcation, with c = 0 if the paths that branch there are stable; p = 1/2 at an
        asymmetric bifurcation, for changes with the sign of c; changes of the other sign do not
        reduce the load.

        Returns
        -------
        exponent : float
            p.
        coefficients : (m,) float
            c for each parameter alone; 0 for parameters that are no imperfections. If no parameter
            is an imperfection, use the slopes of `jacobian`.

        Raises
        ------
        SceneError
            Before the first call, if the first critical point is no bifurcation, and in the cases
            of `jacobian`.
        """
        return self._analysis.critical_load.sensitivity()


class StaticAnalysis(Analysis):
    """Load paths one after the other, and the steps of the last one on a tape."""

    single = CRITICAL_LOAD

    def __init__(self, options: StaticOptions, parameters: Parametrised):
        super().__init__(parameters)
        self._options, self._point = options, CriticalLoad()
        self.rest_time, self.inputs = options.t, options.inputs
        # Load steps and critical point of the last path, once they are asked for.
        self._load_steps: StaticDerivatives | None = None
        self._critical: CriticalLoad | None = None

    def run(self, x: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Load factors and outputs for parameters."""
        scene = self.parameters.build_and_keep(x)
        self._path = LoadPath(scene, self._options, None)
        self._load_steps = self._critical = None
        # Beyond a critical point a path is unstable.
        self._path.warns = all(measured.name != CRITICAL_LOAD for measured in self.measured)
        self._solution = solution = self._path.whole_path()
        self.parameters.stats, self.t = solution.stats, solution.t
        return solution.load_factor, self.read(solution)

    def of_single(self) -> np.ndarray:
        """As of `Analysis`, of the load factor of the first critical point."""
        return self.critical_load.derivatives()

    @property
    def critical_load(self) -> CriticalLoad:
        """The first critical point of the last call."""
        if self._critical is None:
            point, parameters = first_critical_point(self._solution), self.parameters
            self._point.set_point(point, parameters.scene, parameters.derivatives, self._path.held)
            self._critical = self._point
        return self._critical

    def _steps(self) -> StaticDerivatives:
        self._load_steps = self._load_steps or StaticDerivatives(self._path)
        return self._load_steps

    def tape_of_last_run(self, method: str) -> tuple[Model, Tape, TapeDerivatives]:
        """As of `Analysis`."""
        steps = self._steps()
        return steps.model, steps.tape, steps.derivatives

    def boundaries(self, tape: Tape) -> np.ndarray:
        """As of `Analysis`."""
        return np.arange(1, len(tape) + 1)

    def changes(self) -> dict[str, np.ndarray]:
        """As of `Analysis`."""
        return self._steps().changes(self.parameters.derivatives)
