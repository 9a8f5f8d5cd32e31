"""Equilibria as a function of numbers, with derivatives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from fx_beam.equilibria.load_path import LoadPath
from fx_beam.equilibria.static_options import StaticOptions
from fx_beam.errors import check_takes
from fx_beam.step.adjoint import Adjoint
from fx_beam.step.model import Model
from fx_beam.step.newton import NewtonOptions
from fx_beam.step.tape import Tape

from .built_scenes import Build
from .response import Response
from .static_derivatives import StaticDerivatives


class StaticResponse(Response):
    """The equilibria of a scene as a function of numbers.

    ``factors, y = run(x)`` builds the scene of the numbers x and computes its equilibria by
    `static`. ``run.vjp(weights)`` and ``run.jacobian()`` are derivatives of the outputs at constant
    load factors. They are exact for the computed load steps, also if members or springs yield: no
    equilibrium is computed for them. With an arc length as well, the factors of the rows count as
    constant; at a limit point there is no derivative.

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
        As of `Response`. In derivatives also if springs are under tension and change internal
        variables before the loads act.

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
    """

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
        inputs: Mapping[str, Any] | None = None,
    ):
        check_takes(build, "x", "StaticResponse: build")
        self._build = build
        self._static = StaticOptions(
            load_steps=load_steps,
            t=t,
            continuation=continuation,
            newton=newton,
            max_cuts=max_cuts,
            max_steps=max_steps,
            progress=False,
            inputs=inputs,
        )
        self._begin()

    def _begin(self) -> None:
        super()._begin()
        self._derivatives: StaticDerivatives | None = None

    def __call__(self, x: Sequence[float]) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        """Compute the equilibria of the scene of some numbers.

        Parameters
        ----------
        x : (m,) float
            The numbers that `build` takes.

        Returns
        -------
        factors : (n,) float
            Load factors.
        y : dict of (n, ...) float
            The outputs by name.
        """
        return super().__call__(x)

    def _run(self, x: np.ndarray) -> tuple[np.ndarray, dict[str, np.ndarray]]:
        self._scene, self._outputs = self._scenes.at(x)
        self._static_path = LoadPath(self._scene, self._static, None)
        solution = self._static_path.followed()
        self.stats, self._t = solution.stats, solution.t
        self._derivatives = self._known_changes = None
        return solution.load_factor, self._read_all(solution)

    # -- Derivatives ------------------------------------------------------------------------------

    def _followed(self, what: str) -> tuple[Model, Tape, Adjoint]:
        self._check_has_run(what)
        if self._derivatives is None:
            self._derivatives = StaticDerivatives(self._static_path)
        of = self._derivatives
        return of.model, of.tape, of.adjoint

    def _boundaries(self, tape: Tape) -> np.ndarray:
        return np.arange(1, len(tape) + 1)

    def _states(self, model: Model, tape: Tape, steps: np.ndarray) -> dict[str, np.ndarray]:
        assert self._derivatives is not None  # `_followed` comes first
        states = self._derivatives.states_at(steps)
        return {name.replace("_", " "): rows for name, rows in states.items()}

    def _changes(self, tape: Tape) -> dict[str, np.ndarray]:
        if self._known_changes is None:
            of = self._derivatives
            assert of is not None  # `_followed` comes first
            self._known_changes = self._scenes.derivatives(
                self._x, self._scene, lambda scene, change: of.numbers_of(scene)
            )
            self.stats.difference_reason = self._scenes.reason
        return self._known_changes
