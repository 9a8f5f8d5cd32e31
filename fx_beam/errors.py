"""The two kinds of error: bad input, found before a run, and a step that failed."""

from __future__ import annotations

from typing import Any


class SceneError(ValueError):
    """Bad input in a scene, section, scheme or time grid; raised before anything is computed.

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.Section(EA=-1.0, GA=1.0, EI=1.0)
    Traceback (most recent call last):
        ...
    fx_beam.errors.SceneError: Section: EA = -1.0 must be positive and finite
    """


class StepError(RuntimeError):
    """A step that failed.

    Parameters
    ----------
    message : str
        What happened, where, and what to try.
    time : float
        Time at the start of the failed step, or the time at which a user's function failed [s]. In
        statics it is the load factor.

    Examples
    --------
    The steps before the failure are kept in the attribute `solution`.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    >>> beam = scene.add_beam([(0, 0), (1, 0)], section)
    >>> scene.add_force(beam.end, lambda t: (0.0, 1.0 if t < 0.25 else float("nan")))
    >>> try:
    ...     fb.simulate(scene, dt=0.1, t_end=1.0)
    ... except fb.StepError as error:
    ...     print(f"{error.time:.1f}", error.solution.t.round(3))
    0.3 [0.  0.1 0.2]
    """

    def __init__(self, message: str, time: float):
        super().__init__(message)
        self.time = time
        #: The `Solution` up to the last step that succeeded.
        self.solution: Any = None

    def __reduce__(self):
        return type(self), (str(self), self.time), self.__dict__
