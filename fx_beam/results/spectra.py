"""Largest responses to a shaken ground, of which a spectrum of accelerations is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.dual import floats
from fx_beam.errors import SceneError, real_array, require

# Ordinates of a plateau differ by less, relative to the largest.
_EQUAL = 1e-6


@dataclass(frozen=True, repr=False)
class SpectrumResponse:
    """Largest responses to a shaken ground, by the parts of the modes.

    Returned by `Modes.spectrum`.

    Parameters
    ----------
    values : dict of (...) float
        Largest sizes of the outputs, by name, without a sign.
    modal : dict of (n, ...) float
        What each mode gives at its largest, with the sign that it has beside others.
    rest : dict of (...) float
        What the mass gives that no mode has: it moves with the ground.
    accelerations : (n,) float
        Ordinates of the spectrum at the periods of the modes [m/s^2].
    rigid : (n,) float
        Part alpha of each mode that moves with the ground.
    share : float
        Sum of the effective masses of the modes, relative to that of all modes.

    Examples
    --------
    Of two modes without a rigid part the root of squares, as their periods are far apart.

    >>> import numpy as np, fx_beam as fb
    >>> modal = {"drift": np.array([3e-3, -4e-3])}
    >>> parts = {"modal": modal, "rest": {"drift": np.array(0.0)}}
    >>> fb.SpectrumResponse({"drift": np.array(5e-3)}, **parts, accelerations=np.ones(2),
    ...                     rigid=np.zeros(2), share=0.97)
    <SpectrumResponse: 2 modes with 97.0 % of the mass, drift>
    """

    values: dict[str, np.ndarray]
    modal: dict[str, np.ndarray]
    rest: dict[str, np.ndarray]
    accelerations: np.ndarray
    rigid: np.ndarray
    share: float

    def __repr__(self):
        names = ", ".join(self.values)
        modes = f"{len(self.rigid)} modes with {100 * self.share:.1f} % of the mass"
        return f"<SpectrumResponse: {modes}, {names}>"


class Spectrum:
    """Pseudo-accelerations (n,) [m/s^2] over periods (n,) [s], straight between them."""

    def __init__(self, spectrum: Any):
        is_pair = isinstance(spectrum, list | tuple) and len(spectrum) == 2
        parts = [floats(real_array(part)) for part in spectrum] if is_pair else []
        ok = is_pair and parts[0].ndim == 1 and parts[0].shape == parts[1].shape
        ok = ok and len(parts[0]) > 1 and bool(np.isfinite(parts).all())
        expected = "two lists of the same length: periods [s] and accelerations [m/s^2]"
        require(ok, "spectrum", spectrum, expected)
        self._periods, self._values = parts
        expected = "periods that rise from 0, where the ordinate is the ground's own acceleration"
        rises = self._periods[0] == 0 and bool((np.diff(self._periods) > 0).all())
        require(rises, "spectrum: periods", self._periods, expected)
        positive = bool((self._values > 0).all())
        require(positive, "spectrum: accelerations", self._values, "positive numbers")

    @property
    def ground(self) -> float:
        """Largest acceleration of the ground [m/s^2]."""
        return float(self._values[0])

    def at(self, periods: np.ndarray) -> np.ndarray:
        """Ordinates at periods (n,) [s]."""
        last = self._periods[-1]
        for number in np.flatnonzero(periods > last):
            raise SceneError(
                f"spectrum: it ends at the period {last:g} s, but mode {number} has "
                f"{periods[number]:.4g} s. Extend it"
            )
        return np.interp(periods, self._periods, self._values)

    def rigid(self, periods: np.ndarray) -> np.ndarray:
        """Parts (n,) of modes of some periods [s] that move with the ground.

        Beyond the peak of the spectrum, at shorter periods, the ratio of the ground's acceleration
        to that of the mode (Lindley and Yow 1980).
        """
        peak = self._periods[(self._values >= (1 - _EQUAL) * self._values.max()).argmax()]
        return np.where(periods < peak, np.minimum(self.ground / self.at(periods), 1.0), 0.0)


def correlations(frequencies: np.ndarray, damping: float) -> np.ndarray:
    """Correlation (n, n) of modes with one damping ratio under white noise.

    Der Kiureghian (1981), doi 10.1002/eqe.4290090205.
    """
    r = frequencies[:, None] / frequencies
    apart = (1 - r**2) ** 2 + 4 * damping**2 * r * (1 + r) ** 2
    return 8 * damping**2 * (1 + r) * r**1.5 / apart


def combined(
    modal: Mapping[str, np.ndarray],
    rest: Mapping[str, np.ndarray],
    rigid: np.ndarray,
    correlation: np.ndarray,
) -> dict[str, np.ndarray]:
    """Largest sizes (...) of outputs from what modes (n, ...) and the remaining mass give.

    What moves with the ground adds with its sign, the rest by the correlation (n, n) of modes, and
    both by the root of the sum of squares.
    """
    largest, own = dict[str, np.ndarray](), np.sqrt(1 - rigid**2)
    for name, values in modal.items():
        with_ground = np.tensordot(rigid, values, axes=1) + rest[name]
        parts = np.moveaxis(values, 0, -1) * own
        squares = ((parts @ correlation) * parts).sum(axis=-1)
        largest[name] = np.sqrt(with_ground**2 + np.maximum(squares, 0.0))
    return largest
