"""The two kinds of error: bad input, found before a run, and a step that failed."""

from __future__ import annotations

from dataclasses import dataclass
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


@dataclass(frozen=True)
class Failure:
    """Why a run ended early.

    Parameters
    ----------
    kind : str
        What happened: "no convergence" of Newton's method, "singular" tangent, "large rotation" in
        one step, "off the end" for a node that runs off the beam on which it slides, "large slide"
        for one that passes more than two ends of elements in one step, "off the path" for a load
        step that ends on another equilibrium path, "function" for a function of the user's that
        fails or is not finite, "interrupted" by Ctrl-C or another exception, "too many steps", "too
        short" for steps far shorter than a motion needs, or "not converged" for a quantity of
        `converge`.
    reason : str
        One sentence.
    time : float
        Time at the start of the failed step, or the time at which a user's function failed [s]. In
        statics it is the load factor.
    where : str
        The node that moves most in the failed step, and the last residuals.
    advice : str
        What to try.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    >>> beam = scene.add_beam([(0, 0), (1, 0)], section)
    >>> scene.set_velocity(beam, lambda x, y: (0.0, 100 * x), spin=lambda x, y: 100.0)
    >>> scene.pin(beam.start)
    >>> try:
    ...     fb.simulate(scene, dt=0.1, t_end=1.0, max_halvings=0)
    ... except fb.StepError as error:
    ...     print(error.failure.kind)
    large rotation
    """

    kind: str
    reason: str
    time: float
    where: str = ""
    advice: str = ""

    def __str__(self):
        return ". ".join(filter(None, (self.reason, self.where, self.advice)))


class StepError(RuntimeError):
    """A step that failed.

    Parameters
    ----------
    failure : Failure
        What happened, where, and what to try.

    Examples
    --------
    The steps before the failure are kept in the attribute `solution`.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    >>> beam = scene.add_beam([(0, 0), (1, 0)], section)
    >>> load = scene.add_force(beam.end, lambda t: (0.0, 1.0 if t < 0.25 else float("nan")))
    >>> try:
    ...     fb.simulate(scene, dt=0.1, t_end=1.0)
    ... except fb.StepError as error:
    ...     print(f"{error.time:.1f}", error.solution.t.round(3))
    0.3 [0.  0.1 0.2]
    """

    def __init__(self, failure: Failure):
        super().__init__(str(failure))
        self.failure = failure
        #: The `Solution` up to the last step that succeeded.
        self.solution: Any = None

    @property
    def time(self) -> float:
        """Time or load factor of the failure, as `Failure` has it."""
        return self.failure.time

    def __reduce__(self):
        return type(self), (self.failure,), self.__dict__
