"""Laws of dampers, compiled: force and slope at a rate."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import ufl

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.fem.point_functions import PointFunction


class DamperLaw:
    """The law of a damper as a C function of the rate, for the steps in Python and in C."""

    def __init__(self, law: Callable[[Any], Any]):
        def values(given):
            rate = ufl.variable(given[0])
            return ufl.as_vector((law(rate), ufl.diff(law(rate), rate)))

        self._function = PointFunction(values, 1, "law of a damper")
        #: Address of the function.
        self.address = self._function.address
        force, slope = self(0.0)
        if not np.isfinite([force, slope]).all():
            raise SceneError(
                f"Damper: law at the rate 0 is {force:g} and its derivative {slope:g}; both must "
                "be finite. Write ufl.sqrt(rate**2 + 1e-4) for abs(rate), for example"
            )

    def __call__(self, rate: float) -> tuple[float, float]:
        """Force and its derivative by the rate."""
        force, slope = self._function(np.array([rate]))
        return float(force), float(slope)
