"""Laws of dampers, compiled: force and slope at a rate."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from typing import Any

import ufl

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.fem import dolfinx_api, ffcx_api

# Tensor, coefficients, constants, coordinates; the others have no meaning here. Later versions of
# FFCx have one more, which C ignores where there is none.
FUNCTION = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 7)


class DamperLaw:
    """The law of a damper as a C function of the rate, for the steps in Python and in C."""

    def __init__(self, law: Callable[[Any], Any]):
        rate = ufl.variable(ufl.Constant(dolfinx_api.domain(1)))
        force = law(rate)
        both = ufl.as_vector((force, ufl.diff(force, rate)))
        self._compiled = dolfinx_api.compile_form((both, np.array([[0.5]])), "law of a damper")
        #: Address of the function.
        self.address = ffcx_api.expression_function(self._compiled)
        self._function = FUNCTION(self.address)
        force, slope = self(0.0)
        if not np.isfinite([force, slope]).all():
            raise SceneError(
                f"Damper: law at the rate 0 is {force:g} and its derivative {slope:g}; both must "
                "be finite. Write ufl.sqrt(rate**2 + 1e-4) for abs(rate), for example"
            )

    def __call__(self, rate: float) -> tuple[float, float]:
        """Force and its derivative by the rate."""
        out, at = np.zeros(2), np.array([rate])
        self._function(out.ctypes.data, None, at.ctypes.data, None, None, None, None)
        return float(out[0]), float(out[1])
