"""How the error of an invariant grows with the number of steps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fx_beam.errors import SceneError

#: Lags of the fit, as parts of the run: longer ones are seen too seldom, shorter ones are hidden
#: by the rounding of the energy itself.
LAGS = 1 / 50, 1 / 5
#: Fewest errors that show a law.
FEWEST = 100


@dataclass(frozen=True)
class Drift:
    """Growth of an error with the number of steps.

    Parameters
    ----------
    exponent : float
        Slope p of rms(e(n + k) - e(n)) ~ k^p: 0 for an error that stays within bounds, 1/2 for a
        random walk, as rounding gives it, and 1 for a drift to one side.
    steps : dict
        Largest magnitude of the error so far, by number of steps.
    """

    exponent: float
    steps: dict[int, float]

    @property
    def law(self) -> str:
        """Which of the three is nearest."""
        laws = {0.0: "stays within bounds", 0.5: "random walk", 1.0: "drifts to one side"}
        return laws[min(laws, key=lambda p: abs(p - self.exponent))]


def drift_of(error: np.ndarray) -> Drift:
    """Drift of an invariant.

    Parameters
    ----------
    error : (n,) float
        Error of the invariant after each step, from the start on.

    Returns
    -------
    Drift
        Its law.

    Raises
    ------
    SceneError
        For fewer than `FEWEST` errors, or values that are not finite.
    """
    n = len(error)
    if n < FEWEST or not np.isfinite(error).all():
        raise SceneError(f"the law of a drift needs {FEWEST} finite errors and more, not {n}")
    lags = np.unique(np.geomspace(LAGS[0] * n, LAGS[1] * n, 20).astype(int))
    rms = np.array([np.sqrt(np.mean((error[k:] - error[:-k]) ** 2)) for k in lags])
    moved = rms > 0
    exponent = np.polyfit(np.log(lags[moved]), np.log(rms[moved]), 1)[0] if moved.any() else 0.0
    largest = np.maximum.accumulate(abs(error - error[0]))
    decades = [10**k for k in range(1, 10) if 10**k < n]
    return Drift(float(exponent), {k: float(largest[k]) for k in sorted({*decades, n - 1})})
