"""Small motions about the reference or a static state, of scenes of parameters."""

from __future__ import annotations

import functools
from collections.abc import Callable

import numpy as np

from fx_beam.dual import Dual
from fx_beam.equilibria.statics import path_of
from fx_beam.errors import check_takes, require
from fx_beam.linear.linearisation import Linearisation, linearised
from fx_beam.results.records import Stats
from fx_beam.results.solution import Solution
from fx_beam.scene.scene import Scene
from fx_beam.step.model import Model

from .parametrised import Parametrised
from .static_derivatives import StateChange, StaticDerivatives
from .tangent_derivatives import Pairs, TangentDerivatives


class TangentAnalysis:
    """Stiffness, damping and mass about equilibria of scenes of parameters, for a `caller`.

    Messages of calls name the `analysis`. Damping counts if `damped`.
    """

    def __init__(
        self,
        parameters: Parametrised,
        caller: str,
        analysis: str,
        state: Callable[[Scene], Solution] | None,
        damped: bool,
    ):
        if state is not None:
            check_takes(state, "scene", f"{caller}: state")
        self.parameters, self._caller, self._analysis = parameters, caller, analysis
        self._state, self._damped = state, damped
        #: The linearised scene of the last call.
        self.linear: Linearisation
        self._models: dict[str, Model] = {}
        self._tangent = TangentDerivatives(caller)
        self._changes: dict[str, np.ndarray] | None = None

    def run(
        self, x: np.ndarray, take: Callable[[Linearisation], None] = lambda linear: None
    ) -> Linearisation:
        """Linearise about the equilibrium of the scene of parameters; `take` gets it first."""

        def linearise(x: np.ndarray | Dual) -> Linearisation:
            take(linear := self._linearised(x))
            return linear

        self._changes = None
        self.linear = self.parameters.scenes.serve(x, linearise, self._state is None)
        return self.linear

    def _linearised(self, x: np.ndarray | Dual) -> Linearisation:
        scene = self.parameters.build_and_keep(x)
        self._end = self._state and self._state(scene)
        self._path = path_of(self._end, scene)
        is_static = self._state is None or self._path is not None
        expected = "a solution of fx_beam.static(scene)"
        require(is_static, f"{self._caller}: state(scene)", self._end, expected)
        linear = linearised(scene, self._end, self._analysis, self._models)
        scheme, unknowns = linear.model.scheme, len(linear.unknowns)
        self.parameters.stats = Stats(scheme.name, scheme.rates.level, "", unknowns, static=True)
        if self._damped and linear.may_be_damped:
            _ = linear.damped_model  # which has the slopes of the scene as well
        return linear

    def changes(self) -> dict[str, np.ndarray]:
        """Derivatives (m, ...) by x of all numbers of the last call."""
        if self._changes is None:
            self._tangent.set_state(self.linear, self._end, self._damped)
            start: StateChange | None = None
            derivatives = self.parameters.derivatives
            if self._path is not None and self.linear.model.kinks.flows:
                start = StaticDerivatives(self._path).change_of_end(derivatives, self._caller)
            self._changes = derivatives(functools.partial(self._tangent.numbers_of, start=start))
        return self._changes

    def of_sums(self, pairs: Pairs, weights: np.ndarray) -> np.ndarray:
        """Derivatives (s, m) of real parts of weights (s, n) times sums; `changes` comes before."""
        assert self._changes is not None
        self._tangent.set_changes(self._changes, self.parameters.scenes.changing)
        return self._tangent.of_sums(pairs, weights)
