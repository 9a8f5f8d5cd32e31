"""What became of a run's energy: kept, lost, gained, blown up, or never finished."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .errors import SceneError, StepError
from .solution import Solution

#: Kept: the energy is off by no more than this part of what moves.
KEPT = 1e-8
#: Blown up: the energy was more than this many times what it should be.
BLOWN_UP = 10.0
KINDS = "kept", "lost", "gained", "blew up", "failed"


@dataclass(frozen=True)
class Verdict:
    """What became of the energy of a run.

    Parameters
    ----------
    kind : str
        One of `KINDS`.
    time : float
        Time reached [s].
    reached : float
        Part of the time that was asked for.
    highest, lowest : float
        Extremes of the ratio of the energy to what it should be; NaN if the run broke off before
        loads had ended or anything moved.
    steps, iterations, halvings : int
        Steps, Newton's corrections in all, and steps split in two.
    reason : str
        Why the run broke off; empty if it did not.
    """

    kind: str
    time: float
    reached: float
    highest: float
    lowest: float
    steps: int
    iterations: int
    halvings: int
    reason: str

    @property
    def worst(self) -> float:
        """Largest distance of the ratio from one; infinite where the energy is not finite."""
        return max(self.highest - 1, 1 - self.lowest)

    @property
    def gain(self) -> float:
        """Largest energy gained, as a part of what should be there; 0 for none."""
        return max(self.highest - 1, 0.0)


def energy_ratio(solution: Solution, start: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    r"""Energy over what it should be.

    .. math:: r = 1 + \frac{e(t) - e(t_0)}{E_0}, \qquad e = E - E(0) - W,

    with the work W of all loads, so that r = 1 holds under loads as well, and E_0 the kinetic and
    strain energy at `start` and the largest work since then; in a fall from rest, where both are
    zero, the largest change of the potential energy.

    Parameters
    ----------
    solution : Solution
        A run, as far as it went.
    start : float
        Time t_0 from which the energy is judged [s]; the end of loads whose work a scheme has but
        to second order.

    Returns
    -------
    t : (n,) float
        Times from `start` on [s].
    ratio : (n,) float
        The ratio at these; infinite where the energy is not finite.

    Raises
    ------
    SceneError
        If nothing moves, so that there is no energy to compare with.
    """
    after = solution.t >= start * (1 - 1e-9)
    energy, t = solution.energy, solution.t[after]
    if not len(t):
        return t, np.empty(0)
    error, work, potential = (
        np.asarray(values)[after]
        for values in (energy.balance_error, energy.work, energy.potential)
    )
    moving = (energy.kinetic + energy.strain)[after][0]
    scale = moving + _largest_change(work) or _largest_change(potential)
    if not scale > 0:
        if solution.stats.failure:  # before anything moved
            return t[:0], np.empty(0)
        raise SceneError(
            f"no energy moves from t = {start:g} to {t[-1]:g}: give a later start, or a scene with "
            "loads or velocities"
        )
    with np.errstate(invalid="ignore", over="ignore"):
        ratio = 1 + (error - error[0]) / scale
    return t, np.where(np.isfinite(ratio), ratio, np.inf)


def _largest_change(values: np.ndarray) -> float:
    changes = abs(values - values[0])
    return float(changes[np.isfinite(changes)].max())


def classify(run: Solution | StepError, t_end: float, start: float = 0.0) -> Verdict:
    """Verdict on a run.

    In this order: `blew up` if the ratio of the energy exceeded `BLOWN_UP` or was not finite, with
    or without a failure after it; `failed` if the run broke off otherwise; `kept` if the ratio was
    never further from one than `KEPT`; else `gained` or `lost`, whichever was more.

    Parameters
    ----------
    run : Solution or StepError
        What `simulate` gave or raised.
    t_end : float
        Time that was asked for [s].
    start : float
        Time from which the energy is judged [s].

    Returns
    -------
    Verdict
        The verdict.
    """
    solution = run.solution if isinstance(run, StepError) else run
    _, ratio = energy_ratio(solution, start)
    highest, lowest = (ratio.max(), ratio.min()) if len(ratio) else (np.nan, np.nan)
    stats, reason = solution.stats, solution.stats.failure
    if highest > BLOWN_UP:
        kind = "blew up"
    elif reason:
        kind = "failed"
    elif max(highest - 1, 1 - lowest) <= KEPT:
        kind = "kept"
    else:
        kind = "gained" if highest - 1 > 1 - lowest else "lost"
    time = run.time if isinstance(run, StepError) else float(solution.t[-1])
    return Verdict(
        kind=kind,
        time=time,
        reached=time / t_end,
        highest=float(highest),
        lowest=float(lowest),
        steps=stats.steps,
        iterations=stats.newton_iterations,
        halvings=stats.halvings,
        reason=reason,
    )
