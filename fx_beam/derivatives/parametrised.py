"""Scenes as a function of parameters: what all responses have, and one call of them at a time."""

from __future__ import annotations

import functools
from collections.abc import Callable
from threading import RLock
from typing import Any, Generic, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.dual import Dual
from fx_beam.errors import all_of, real_array, require
from fx_beam.results.records import Stats
from fx_beam.scene.functions import ArrayCalls
from fx_beam.scene.scene import Scene
from fx_beam.step.interrupts import one_thread

from .built_scenes import BuiltScenes, NumbersOf
from .gradient import DualArrays

_Method = TypeVar("_Method", bound=Callable)
_Built = TypeVar("_Built")
_Besides = TypeVar("_Besides")


def one_call(method: _Method) -> _Method:
    """A method for one thread; all but `__call__` need a call before."""
    name = method.__name__

    @functools.wraps(method)
    def call(self, *arguments, **named):
        if name != "__call__":
            parameters, subject = self._parameters, f"{type(self).__name__}.{name}"
            expected = "called after run(x) without an error"
            require(len(parameters.x) > 0, subject, f"no {parameters.gives} yet", expected)
        return method(self, *arguments, **named)

    return one_thread(call)  # type: ignore[return-value]


class Parametrised(Generic[_Besides]):
    """Scenes that `build` gives for parameters x, and derivatives of their numbers by x.

    `read` takes the scene, and all else, from what `build` gives; SceneError if this is wrong.
    `numbers_of` gives numbers of all else in a scene, by that of the last call.
    """

    def __init__(
        self,
        build: Callable[..., _Built],
        read: Callable[[_Built], tuple[Scene, _Besides]],
        gives: str,
        numbers_of: Callable[[Scene, _Besides, _Besides], DualArrays] = lambda *_: {},
    ):
        self._built, self._numbers_of = lambda *values: read(build(*values)), numbers_of
        # The scene that `build` gave last, and what it gave besides.
        self._last: tuple[Scene, _Besides]
        #: What a call gives, for messages.
        self.gives = gives
        self.alone, self._array_calls = RLock(), ArrayCalls()
        #: Arguments of `build` after x.
        self.more: tuple[float, ...] = ()
        #: The parameters of the last call; empty until it succeeds.
        self.x = np.empty(0)
        #: Its scene, what `build` gave besides, and its statistics.
        self.scene: Scene
        self.besides: Any = None
        self.stats: Stats
        self.scenes = BuiltScenes(lambda x: self.at(x)[0])

    def begin(self, x: ArrayLike) -> np.ndarray:
        """The parameters of a call, which are checked; there are none until it succeeds."""
        self.x = np.empty(0)
        values = real_array(x)
        is_right = values.ndim == 1 and values.size > 0 and all_of(np.isfinite(values))
        require(is_right, "Response: x", x, "a sequence of finite numbers")
        return values

    def at(self, x: np.ndarray | Dual, *extra: float) -> tuple[Scene, _Besides]:
        """The scene that `build` makes of a copy of x, and the rest of its result."""
        own_x = x if isinstance(x, Dual) else x.copy()
        scene, besides = self._built(own_x, *(extra or self.more))
        scene.array_calls, self._last = self._array_calls, (scene, besides)
        return scene, besides

    def take(self, x: np.ndarray | Dual) -> Scene:
        """Take the scene of x as that of this call."""
        self.scene, self.besides = self.at(x)
        return self.scene

    def derivatives(self, numbers_of: NumbersOf) -> dict[str, np.ndarray]:
        """Derivatives (m, ...) by x of the numbers of scenes at the last x."""

        def every(scene: Scene, change: np.ndarray | Dual) -> DualArrays:
            last, besides = self._last
            besides = besides if scene is last else self.besides
            extra = self._numbers_of(scene, besides, self.besides)
            return numbers_of(scene, change) | extra

        changes = self.scenes.derivatives(self.x, self.scene, every)
        self.stats.difference_reason = self.scenes.reason
        return changes


class OfParameters:
    """A function of parameters x, called by one thread at a time; copies know of no call."""

    _arguments: tuple
    _parameters: Parametrised

    def _begin(self, *arguments) -> None:
        """Know of no call yet; copies and pickles begin with the same arguments."""
        raise NotImplementedError

    def __getstate__(self):
        return self._arguments

    def __setstate__(self, arguments):
        self._begin(*arguments)

    @property
    def _alone(self) -> RLock:
        return self._parameters.alone

    @property
    def stats(self) -> Stats:
        """Statistics of the last call."""
        return self._parameters.stats
