"""The step that a virtual work is given, as symbols, for when there is no mesh yet."""

from __future__ import annotations

from typing import Any

import ufl
from ufl.domain import AbstractDomain

_NOWHERE = AbstractDomain(1, 2)
_VECTORS = (
    "u0",
    "Du",
    "u",
    "v",
    "virtual_u",
    "X",
    "t0",
    "u_before",
    "director0",
    "director1",
    "director",
)
_STRAINS = "strains0", "strains1", "strain_increments", "strains_before"
_SCALARS = (
    *("psi0", "Dpsi", "psi", "omega", "virtual_psi", "h", "t", "dt", "load_factor"),
    *("psi_before", "memory"),
)


class StepSymbols:
    """An `fx_beam.Step` whose fields are symbols of the same shape, on no mesh."""

    degree, nodes = 1, None

    def __init__(self) -> None:
        self.__dict__ |= {name: ufl.Constant(_NOWHERE, shape=(2,)) for name in _VECTORS}
        self.__dict__ |= {name: ufl.Constant(_NOWHERE) for name in _SCALARS}
        self.__dict__ |= {
            name: tuple(ufl.Constant(_NOWHERE) for _ in range(3)) for name in _STRAINS
        }

    def prime(self, field: Any) -> Any:
        """A symbol in the place of a derivative, which has the same symbols in it."""
        return 2 * field


#: The symbols, made once: each new one would count.
STEP: Any = StepSymbols()
