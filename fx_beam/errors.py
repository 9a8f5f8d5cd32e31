"""The two kinds of error: a scene that cannot be right, and a step that could not be taken."""

from __future__ import annotations

from typing import Any


class SceneError(ValueError):
    """A scene, section, scheme or time grid that cannot be computed, found before it runs."""


class StepError(RuntimeError):
    """A time step that could not be taken.

    Parameters
    ----------
    message : str
        What happened, where, and what to try.
    time : float
        Start of the step that failed, or the time at which a function of time failed [s].
    """

    def __init__(self, message: str, time: float):
        super().__init__(message)
        self.time = time
        #: The `Solution` up to the last step that succeeded.
        self.solution: Any = None

    def __reduce__(self):
        return type(self), (str(self), self.time), self.__dict__
