"""What responses share: functions of numbers, called by one thread at a time."""

from __future__ import annotations

import functools
from collections.abc import Callable
from threading import RLock
from typing import Any, TypeVar

import numpy as np

from fx_beam.dual import Dual
from fx_beam.errors import all_of, real_array, require
from fx_beam.results.records import Stats
from fx_beam.scene.functions import ArrayCalls
from fx_beam.scene.scene import Scene
from fx_beam.step.interrupts import one_thread

from .built_scenes import BuiltScenes, NumbersOf

_Method = TypeVar("_Method", bound=Callable)


def one_call(method: _Method) -> _Method:
    """A method for one thread; all but `__call__` need a call before."""
    name = method.__name__

    @functools.wraps(method)
    def call(self, *given, **named):
        if name != "__call__":
            expected = "called after run(x) without an error"
            what = f"{type(self).__name__}.{name}"
            require(self._x is not None, what, f"no {self._gives} yet", expected)
        return method(self, *given, **named)

    return one_thread(call)  # type: ignore[return-value]


class Differentiable:
    """A function of the parameters of which scenes are built, with derivatives by them."""

    stats: Stats
    #: What a call gives, for messages.
    _gives = "motion"
    __call__: Callable[..., Any]
    vjp: Callable[..., Any]
    jacobian: Callable[..., Any]
    _build: Callable[..., Any]
    _scene: Scene
    #: The scene of parameters; SceneError if `build` gives something else.
    _scene_at: Callable[..., Scene]
    #: Derivatives (m, ...) of all numbers of the last call by x, as they are found.
    _changes_by_x: Callable[..., dict[str, np.ndarray]]

    def _begin(self) -> None:
        """Know of no call yet; what was given until now is what pickles and copies keep."""
        self._arguments = dict(vars(self))
        self._alone, self._array_calls = RLock(), ArrayCalls()
        self._scenes = BuiltScenes(self._scene_at)
        self._x: Any = None
        self._known_changes: dict[str, np.ndarray] | None = None

    def __getstate__(self):
        return self._arguments

    def __setstate__(self, given):
        vars(self).update(given)
        self._begin()

    def _built(self, x: Any, *more: Any) -> Any:
        """What `build` gives; its x is a copy, which it may change in place."""
        built = self._build(x if isinstance(x, Dual) else x.copy(), *more)
        scene = built[0] if isinstance(built, tuple) and built else built
        if isinstance(scene, Scene):
            scene.array_calls = self._array_calls
        return built

    def _begin_call(self, x: Any) -> np.ndarray:
        """The parameters of a call; there are no derivatives until it succeeds."""
        self._x = self._known_changes = None
        values = real_array(x)
        ok = values.ndim == 1 and values.size > 0 and all_of(np.isfinite(values))
        require(ok, "Response: x", x, "a sequence of finite numbers")
        return values

    def _changes(self) -> dict[str, np.ndarray]:
        """Derivatives (m, ...) of all numbers of the last call by x."""
        if self._known_changes is None:
            self._known_changes = self._changes_by_x()
        return self._known_changes

    def _derivatives(self, numbers_of: NumbersOf) -> dict[str, np.ndarray]:
        """Derivatives (m, ...) by x of the numbers of scenes at the last one."""
        changes = self._scenes.derivatives(self._x, self._scene, numbers_of)
        self.stats.difference_reason = self._scenes.reason
        return changes
