"""Lines of schemes in a diagram of error over run time, and which is the cheapest where."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from .run import Run

#: Run times closer than by this factor are a tie, as another machine may turn them round.
TIE = 1.2
#: Errors closer than by this factor are the same.
SAME = 1.1


@dataclass(frozen=True)
class Front:
    """Line of a scheme in a diagram of error over run time.

    Parameters
    ----------
    scheme : str
        Its label.
    runs : list of Run
        From the fastest to the most accurate; each is more accurate than all faster ones, by 10 %.
    errors : list of float
        With which they count.
    """

    scheme: str
    runs: list[Run]
    errors: list[float]

    def seconds(self, level: float) -> tuple[float, float, float] | None:
        """Run time at an error, on the straight line between runs in logarithmic scales.

        Parameters
        ----------
        level : float
            Relative error.

        Returns
        -------
        (float, float, float) or None
            Low quartile of the time for an error 10 % larger, median, and high quartile for one
            10 % smaller [s]; those of the first run where even that is more accurate. None where no
            run comes within the error, by 10 %.
        """
        if not self.runs or self.errors[-1] > SAME * level:
            return None
        low, high = np.transpose([run.quartiles for run in self.runs])
        return (
            self._at(SAME * level, low),
            self._at(level, [run.seconds for run in self.runs]),
            self._at(level / SAME, high),
        )

    def _at(self, level: float, seconds: Sequence[float]) -> float:
        accuracy = -np.log(self.errors)
        return float(np.exp(np.interp(-np.log(level), accuracy, np.log(seconds))))

    def run(self, level: float) -> Run:
        """Cheapest run that comes within an error, by 10 %.

        Parameters
        ----------
        level : float
            Relative error.

        Returns
        -------
        Run
            The run.
        """
        return next(r for r, e in zip(self.runs, self.errors, strict=True) if e <= SAME * level)


@dataclass(frozen=True)
class Winner:
    """Cheapest schemes over a range of errors.

    Parameters
    ----------
    loosest, tightest : float
        First and last error level of the range.
    schemes : tuple of str
        Those whose times at each of its levels cannot be told from the shortest, from the fastest
        at the last one on; empty where no run comes within the error.
    seconds : (float, float)
        The shortest times at the first and the last level [s].
    run : Run, optional
        The cheapest run of the fastest scheme that comes within the last level.
    next : str
        The next scheme there; empty if no other one comes within the error.
    ratio : float
        How many times as long that one takes.
    """

    loosest: float
    tightest: float
    schemes: tuple[str, ...] = ()
    seconds: tuple[float, float] = (np.nan, np.nan)
    run: Run | None = None
    next: str = ""
    ratio: float = np.nan


def cheapest(fronts: Sequence[Front], level: float) -> Winner:
    """Cheapest schemes at one error level.

    Parameters
    ----------
    fronts : sequence of Front
        The lines of the schemes.
    level : float
        Relative error.

    Returns
    -------
    Winner
        Those whose times are within 20 % of the shortest, or overlap it by quartiles and by 10 % in
        the error.
    """
    within = [(front, t) for front in fronts if (t := front.seconds(level))]
    if not within:
        return Winner(level, level)
    within.sort(key=lambda entry: entry[1][1])
    best, (_, shortest, high) = within[0]
    tie = max(high, TIE * shortest)
    tied = tuple(front.scheme for front, (low, _, _) in within if low <= tie)
    winner = Winner(level, level, tied, (shortest, shortest), best.run(level))
    for front, (low, middle, _) in within:
        if low > tie:
            return replace(winner, next=front.scheme, ratio=middle / shortest)
    return winner
