"""Estimate of the local errors of steps, from the last configurations at ends of steps.

The local error of the mid-point rule is dt^3 q''' / 12, that of a composition of order 4 made of
it dt^5 q''''' / 80 times the sum of the fifth powers of its fractions (exactly so for a linear
oscillation). In terms of differences it is a fraction of the increment that a polynomial through
the last configurations does not predict. This is a divided difference of order p + 1, multiplied by
the times since the last p + 1 configurations: so a jump is not missed, however short the step.

Displacements are small in vibrations that are too fast for the steps, velocities and accelerations
are not: so the estimate does not use them.
"""

from __future__ import annotations

from fx_beam.errors import SceneError
from fx_beam.laws.rates import NewmarkRates
from fx_beam.laws.schemes import Scheme

#: Differences that are averaged with the weights 1/4, 1/2, 1/4.
AVERAGED = 3


def order_and_constant(scheme: Scheme) -> tuple[int, float]:
    """Order p of a scheme, and its local error as a fraction of what is not predicted.

    SceneError for a scheme of order 1.
    """
    rates, advice = scheme.rates, None
    if isinstance(rates, NewmarkRates):
        second = 0.5 - rates.alpha_m + rates.alpha_f
        advice = f"gamma = {second:g}" if abs(rates.gamma - second) > 1e-9 else None
    elif getattr(scheme.resultants, "order", 2) == 1:
        advice = "order=2"
    if advice:
        raise SceneError(
            f"tolerance: {scheme.name} is of order 1; its local errors are not known. Use "
            f"{advice}, or another scheme"
        )
    cubes = abs(sum(fraction**3 for fraction in scheme.fractions))
    if cubes > 1e-9:
        return 2, cubes / 12
    return 4, abs(sum(fraction**5 for fraction in scheme.fractions)) / 80
