"""Small motions about the reference or a static state as functions of numbers."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from fx_beam.errors import check_takes, require
from fx_beam.linear.linearisation import Linearisation, linearised
from fx_beam.motions.set_ups import Lease
from fx_beam.results.records import Stats
from fx_beam.results.solution import Solution
from fx_beam.scene.scene import Scene

from .differentiable import Differentiable
from .static_derivatives import StateChange, StaticDerivatives
from .tangent_derivatives import Pairs, TangentDerivatives


class TangentResponse(Differentiable):
    """What follows from stiffness, damping and mass about an equilibrium."""

    #: The function that is asked for, in messages of calls.
    _asked: str
    #: Whether damping counts.
    _damped: bool

    def _begin_tangent(
        self, build: Callable[..., Any], state: Callable[[Scene], Solution] | None
    ) -> None:
        self._what = type(self).__name__
        check_takes(build, "x", f"{self._what}: build")
        if state is not None:
            check_takes(state, "scene", f"{self._what}: state")
        self._build, self._state = build, state
        self._begin()

    def _begin(self) -> None:
        super()._begin()
        self._about: Linearisation
        # Whether damping counted in the last call.
        self._is_damped = False
        self._models: dict[str, Lease] = {}
        self._tangent = TangentDerivatives(self._what)

    def _linearised(self, x: Any) -> Linearisation:
        """Linearise about the equilibrium of the scene of numbers."""
        self._scene = scene = self._scene_at(x)
        self._end = self._state and self._state(scene)
        self._path = path = getattr(self._end, "load_path", None)
        ok = self._state is None or (path is not None and path.scene is scene)
        expected = "a solution of fx_beam.static(scene)"
        require(ok, f"{self._what}: state(scene)", self._end, expected)
        self._about = about = linearised(scene, self._end, self._asked, self._models)
        scheme, unknowns = about.model.scheme, len(about.unknowns)
        self.stats = Stats(scheme.name, scheme.rates.level, "", unknowns, static=True)
        self._is_damped = self._damped and about.may_be_damped
        if self._is_damped:
            _ = about.damped_model  # which has the slopes of the scene as well
        return about

    def _changes_by_x(self) -> dict[str, np.ndarray]:
        self._tangent.begin(self._about, self._end, self._damped)
        self._start: StateChange | None = None
        if self._path is not None and self._about.model.flows:
            self._start = StaticDerivatives(self._path).change_of_end(self._derivatives, self._what)
        return self._derivatives(self._numbers_of)

    def _numbers_of(self, scene: Scene, change: Any) -> dict[str, Any]:
        return self._tangent.numbers_of(scene, change, self._start)

    def _of_sums(self, pairs: Pairs, weights: np.ndarray) -> np.ndarray:
        """Derivatives (s, m) of real parts of weights (s, n) times sums."""
        self._tangent.take(self._changes(), self._scenes.changing)
        return self._tangent.of_sums(pairs, weights)
