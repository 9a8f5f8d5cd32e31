"""Equilibria as a function of parameters, with derivatives."""

from __future__ import annotations

import functools
from collections.abc import Mapping

import numpy as np

from fx_beam.equilibria.critical_points import first_critical_point
from fx_beam.equilibria.static_options import StaticOptions
from fx_beam.equilibria.statics import LoadPath
from fx_beam.errors import check_takes
from fx_beam.scene.outputs import CRITICAL_LOAD
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.tape import Tape
from fx_beam.step.tape_derivatives import TapeDerivatives

from .analysis import Analysis
from .critical_load import CriticalLoad, Sensitivity
from .parametrised import Parametrised, one_call
from .response import Build, Response
from .static_derivatives import StaticDerivatives


class StaticResponse(Response):
    """The equilibria of a scene as a function of parameters.

    ``factors, y = run(x)`` builds the scene of the parameters x and computes its equilibria by
    `static`. ``run.vjp(weights)`` and ``run.jacobian()`` are derivatives of the outputs at constant
    load factors. They are exact for the computed load steps, also if members or springs yield: no
    equilibrium is computed for them. With an arc length as well, the factors of the rows count as
    constant; at a limit point there is no derivative.

    Threads may call it at once, and by `map`, as a `Response`.

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
        As of `Response`; if the path has no critical point, whose load is an output. In derivatives
        also if springs are under tension and change internal variables before the loads act; and of
        the critical load, for several modes at once, where the stiffness jumps, by parameters that
        are imperfections, with added virtual works, where material has flowed, and as of
        `ModalResponse`.

    Examples
    --------
    How the tip of a cantilever, rolled up to a half circle by a moment, depends on the moment; per
    load factor the exact values are (-L, -2 L / pi), those of a beam of straight elements close to
    them.

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
        r"""How the critical load falls if parameters x of the last call make the scene imperfect.

        Near a bifurcation the load is :math:`\lambda_c - c |\Delta x|^p` (Koiter 1945): p = 2/3 at
        a symmetric bifurcation, with c = 0 where the paths beyond it are stable; p = 1/2 at another
        one, for changes with the sign of c, while others make the load no less.

        Returns
        -------
        exponent : float
            p.
        coefficients : (m,) float
            c for each number alone; 0 for those that are no imperfections. If no number is one,
            `jacobian` gives the slopes.

        Raises
        ------
        SceneError
            Before the first call, if the first critical point is no bifurcation, and as of
            `jacobian`.
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
