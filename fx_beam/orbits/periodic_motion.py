"""A motion that repeats itself, with what its neighbours do."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.results.solution import Solution
from fx_beam.scene.beam import COMPONENTS, Node
from fx_beam.validation import is_one_of, require

from .closing import Closed
from .shooting import Shooting

# Multipliers that are larger than 1 by less are round-off.
_NEUTRAL = 1e-5


def multipliers_of(closed: Closed) -> np.ndarray:
    """Multipliers (n,), largest first, of what steps resolve.

    Without changes that turn by more than a quarter in the first step, as those that alternate.
    """
    own = closed.by.own
    unit = closed.by.matrix[own]
    values, vectors = np.linalg.eig(np.linalg.solve(unit, closed.monodromy[own]))
    after = np.linalg.solve(unit, closed.first_step[own]) @ vectors
    along = np.real(np.einsum("ij,ij->j", vectors.conj(), after))
    slow = values[(along > 0) | (abs(values) < _NEUTRAL)]
    return slow[np.lexsort((-slow.imag, -abs(slow)))]


def instability_of(multipliers: np.ndarray, trivial: int) -> str:
    """How a motion is unstable, by the largest multiplier; empty if it is stable.

    Some multipliers are `trivial`: 1 for shifts in time, and for the energy of a family.
    """
    others = np.delete(multipliers, np.argsort(abs(multipliers - 1))[:trivial])
    growing = others[abs(others) > 1 + _NEUTRAL]
    if not len(growing):
        return ""
    largest = growing[np.argmax(abs(growing))]
    if abs(largest.imag) > _NEUTRAL:
        return "Neimark-Sacker"
    return "fold" if largest.real > 0 else "period doubling"


# Losses in a period that are round-off, relative to the energy of the motion.
_NO_LOSS = 1e-12


class PeriodicMotion:
    """A motion that repeats itself; `periodic`, `backbone` and `forced_response` find it.

    Parameters
    ----------
    period : float
        Its length [s].
    energy : float
        Energy at its start [J], zero in the reference configuration: kinetic, stored, of the
        weight, and of dead loads if these are constant. Without losses and other loads it is that
        of all times.
    multipliers : (n,) complex
        Floquet multipliers, largest first: a small deviation that is an eigenvector of the
        monodromy matrix is so many times as large after a period. Those of deviations that turn by
        more than a quarter in one step, which steps do not resolve, are left out. A free motion has
        the multiplier 1 for a shift in time, and once more if it belongs to a family.
    instability : str
        "fold" if the largest multiplier is real and above 1, "period doubling" if it is below -1,
        "Neimark-Sacker" for a complex pair outside the unit circle; empty for a stable motion. A
        multiplier counts from 1 + 1e-5 on.
    error : float
        Distance of the states before and after the period, relative to the largest distance in it;
        to the scene for one at rest.
    iterations : int
        Number of Newton's iterations.
    run : callable
        ``run()`` gives the solution.

    Examples
    --------
    A body that swings on a spring.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> body = scene.add_body((0, 0), mass=1.0, inertia=1.0)
    >>> spring = fb.Spring(stiffness=4.0)
    >>> joint = scene.add_joint(fb.Prismatic(fb.GROUND, body.centre, axis=(1, 0), spring=spring))
    >>> swing = fb.periodic(scene, mode=0, amplitude=0.1)
    >>> swing.stable, round(swing.frequency, 3), round(swing.amplitude(body.centre, "x"), 3)
    (True, 0.318, 0.1)
    """

    def __init__(
        self,
        period: float,
        energy: float,
        multipliers: np.ndarray,
        instability: str,
        error: float,
        iterations: int,
        run: Callable[[], Solution],
    ):
        self.period, self.energy, self.multipliers = period, energy, multipliers
        self.instability, self.error, self.iterations = instability, error, iterations
        self._run = run

    @property
    def frequency(self) -> float:
        """How often it repeats itself [Hz]."""
        return 1 / self.period

    @property
    def stable(self) -> bool:
        """Whether no small deviation grows."""
        return not self.instability

    @cached_property
    def solution(self) -> Solution:
        """The motion over one period; `simulate(scene, start=...)` continues it."""
        return self._run()

    def amplitude(self, node: Node, component: str = "y") -> float:
        """Half of the distance between the ends of the motion of a node.

        Parameters
        ----------
        node : Node
            A node of the scene.
        component : {"x", "y", "rotation"}
            Component of its motion.

        Returns
        -------
        float
            Amplitude [m or rad].

        Raises
        ------
        SceneError
            For a node that is none, or another component.
        """
        fits = is_one_of(component, COMPONENTS)
        require(fits, "amplitude: component", component, f"one of {list(COMPONENTS)}")
        if not isinstance(node, Node):
            raise SceneError(f"amplitude: {node!r} is no node of the scene")
        rows = self.solution.rotation(node)
        if component != "rotation":
            rows = self.solution.displacement(node)[:, COMPONENTS.index(component)]
        return float(np.ptp(rows)) / 2

    def __repr__(self):
        verdict = self.instability or "stable"
        return f"<PeriodicMotion: {self.frequency:.6g} Hz, {verdict}, {self.energy:.4g} J>"


def motion_of(shooting: Shooting, closed: Closed, free: bool) -> PeriodicMotion:
    """What users get of a periodic motion."""
    period = closed.period
    energy, multipliers = shooting.energy(period.start), multipliers_of(closed)
    conserves = period.lost <= _NO_LOSS * max(1.0, abs(energy))
    return PeriodicMotion(
        float(period.length),
        energy,
        multipliers,
        instability_of(multipliers, free * (1 + conserves)),
        float(period.error),
        closed.iterations,
        lambda: shooting.solution(period),
    )
