"""Warning: the energies of a motion do not balance."""

from __future__ import annotations

import logging

import numpy as np

from fx_beam.laws.resultants import Decaying
from fx_beam.laws.schemes import Scheme

_log = logging.getLogger("fx_beam")
# Signs of energies in their balance, in the order of `Energy`: not of the numerical part of losses.
_SIGNS = np.array([1.0, 1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 0.0])
# Error of the balance, relative to the largest of the energies, from which it is named; and what
# round-off of all of them may be.
_LARGE, _ROUND_OFF = 1e-3, 1e-9


def warn_of_balance(scheme: Scheme, t: np.ndarray, energies: np.ndarray) -> None:
    """Warn of the first of the rows (n, 8) of energies that gain or lose much without a cause.

    Schemes that do not balance energy may lose some; what they gain is named.
    """
    errors = energies @ _SIGNS
    errors -= errors[0]
    if not scheme.balances_energy and not isinstance(scheme.resultants, Decaying):
        errors = np.maximum(errors, 0.0)
    largest = abs(errors).max()
    if not largest > _ROUND_OFF * abs(energies).max():
        return
    kinetic, strain, potential, work, springs, dissipated, *_ = energies.T
    parts = kinetic, strain + springs, potential - potential[0], work, dissipated
    size = max(abs(part).max() for part in parts)
    if largest > _LARGE * size:
        k = int(np.argmax(abs(errors) > _LARGE * size))
        _log.warning(
            "simulate: the energies do not balance: from t = %.6g on the motion %s energy without "
            "a cause, up to %.3g J; its energies are %.3g J. Take shorter steps or a tolerance; "
            "energy.balance_error shows where it happens",
            *(t[k], "gains" if errors[k] > 0 else "loses", largest, size),
        )
