"""Damping in proportion to mass and stiffness, from two damping ratios."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.validation import require, vector


def rayleigh(frequencies: Sequence[float], ratios: Sequence[float]) -> tuple[float, float]:
    r"""Choose Rayleigh damping C = alpha M + tau K for two given damping ratios.

    A mode of angular frequency omega then has the damping ratio
    :math:`\zeta = \alpha / (2 \omega) + \tau \omega / 2`: less between the two frequencies, more
    outside.

    Parameters
    ----------
    frequencies : (f1, f2)
        Two different natural frequencies [Hz].
    ratios : (zeta1, zeta2)
        Their damping ratios.

    Returns
    -------
    alpha : float
        Mass factor [1/s] for ``add_drag(beam, linear=alpha * rhoA, rotation=alpha * rhoI)``.
    tau : float
        Retardation time [s] for ``Section(..., retardation=tau)``.

    Raises
    ------
    SceneError
        If one of both would be negative, or for frequencies that are equal or not positive.

    Examples
    --------
    Two per cent at 5 Hz and at 50 Hz.

    >>> import fx_beam as fb
    >>> alpha, tau = fb.rayleigh((5.0, 50.0), (0.02, 0.02))
    >>> round(alpha, 4), round(tau, 6)
    (1.1424, 0.000116)
    """
    f = vector(frequencies, 2, "rayleigh: frequencies")
    zeta = vector(ratios, 2, "rayleigh: ratios")
    require(
        f.min() > 0 and f[0] != f[1], "rayleigh: frequencies", frequencies, "positive and different"
    )
    require(zeta.min() >= 0, "rayleigh: ratios", ratios, "zero or positive")
    # alpha + tau omega^2 = 2 zeta omega, with the frequencies in order.
    (w1, z1), (w2, z2) = sorted(zip(2 * np.pi * f, zeta, strict=True))
    alpha = 2 * w1 * w2 * (z1 * w2 - z2 * w1) / (w2**2 - w1**2)
    tau = 2 * (z2 * w2 - z1 * w1) / (w2**2 - w1**2)
    # With one factor alone the ratios are as the frequencies, or inversely.
    for name, unit, value, bound in (
        ("mass factor alpha", "1/s", alpha, f"at most {z1 * w2 / w1:.4g}"),
        ("retardation time tau", "s", tau, f"at least {z1 * w1 / w2:.4g}"),
    ):
        if value < 0:
            raise SceneError(
                f"rayleigh: these ratios need a negative {name} = {value:.4g} {unit}, which would "
                f"drive the motion. Choose a ratio of {bound} at {w2 / (2 * np.pi):.4g} Hz"
            )
    return float(alpha), float(tau)
