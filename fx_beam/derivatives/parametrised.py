"""Scenes as a function of parameters: what all responses have, and their states by threads."""

from __future__ import annotations

import copy
import functools
from collections.abc import Callable
from threading import Lock, RLock, local
from typing import Any, Generic, Self, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from fx_beam.dual import Dual
from fx_beam.errors import all_of, real_array, require
from fx_beam.results.records import Stats
from fx_beam.scene.functions import ArrayCalls
from fx_beam.scene.scene import Scene

from .built_scenes import NumbersOf, SceneGradient
from .gradient import DualArrays

_Method = TypeVar("_Method", bound=Callable)
_Built = TypeVar("_Built")
_Besides = TypeVar("_Besides")


def one_call(method: _Method) -> _Method:
    """A method of the state of its thread; all but `__call__` need a call before."""
    name = method.__name__
    begins = name == "__call__"

    @functools.wraps(method)
    def call(self, *arguments, **named):
        state = self._state(begins)
        with state._alone:
            if not begins:
                parameters, subject = state._parameters, f"{type(self).__name__}.{name}"
                expected = "called after run(x) without an error"
                require(len(parameters.x) > 0, subject, f"no {parameters.gives} yet", expected)
            return method(state, *arguments, **named)

    return call  # type: ignore[return-value]


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
        #: What is known of functions of the scenes.
        self.array_calls = ArrayCalls()
        #: Arguments of `build` after x.
        self.more: tuple[float, ...] = ()
        #: The parameters of the last call; empty until it succeeds.
        self.x = np.empty(0)
        #: Its scene, what `build` gave besides, and its statistics.
        self.scene: Scene
        self.besides: Any = None
        self.stats: Stats
        self.scenes = SceneGradient(lambda x: self.build_at(x)[0])

    def check_x(self, x: ArrayLike) -> np.ndarray:
        """The parameters of a call, which are checked; there are none until it succeeds."""
        self.x = np.empty(0)
        values = real_array(x)
        is_right = values.ndim == 1 and values.size > 0 and all_of(np.isfinite(values))
        require(is_right, "Response: x", x, "a sequence of finite numbers")
        return values

    def build_at(self, x: np.ndarray | Dual, *extra: float) -> tuple[Scene, _Besides]:
        """The scene that `build` makes of a copy of x, and the rest of its result."""
        own_x = x if isinstance(x, Dual) else x.copy()
        scene, besides = self._built(own_x, *(extra or self.more))
        scene.array_calls, self._last = self.array_calls, (scene, besides)
        return scene, besides

    def build_and_keep(self, x: np.ndarray | Dual) -> Scene:
        """Take the scene of x as that of this call."""
        self.scene, self.besides = self.build_at(x)
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


class ParameterFunction:
    """A function of parameters x; copies know of no call.

    The first thread that calls it has this object as its state, each other one a copy of its own.
    """

    _parameters: Parametrised

    def _begin(self, *arguments) -> None:
        """Know of no call yet; copies and pickles begin with the same arguments."""
        self._arguments = arguments
        # Held while this state is used, and by the first thread for good; states of other threads.
        self._alone, self._first, self._of_thread = RLock(), Lock(), local()

    def _state(self, begins: bool = False) -> Self:
        """The state of this thread; this object if the thread has none, and does not begin one."""
        states = self._of_thread.__dict__
        if begins and "state" not in states:
            states["state"] = None if self._first.acquire(blocking=False) else self._twin()
        return states.get("state") or self

    def _twin(self) -> Self:
        """A copy that calls functions of scenes with arrays where this object does."""
        twin = copy.copy(self)
        twin._parameters.array_calls = self._parameters.array_calls
        return twin

    def _last_x(self) -> np.ndarray:
        """The parameters of the last call in this thread; empty if it failed, or made none."""
        has_called = "state" in self._of_thread.__dict__
        return self._state()._parameters.x if has_called else np.empty(0)

    def __getstate__(self):
        return self._arguments

    def __setstate__(self, arguments):
        self._begin(*arguments)

    @property
    def stats(self) -> Stats:
        """Statistics of the last call."""
        return self._state()._parameters.stats
