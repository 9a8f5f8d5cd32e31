"""Symbols for the arguments of a user's functions: what these give is known before a mesh is."""

from __future__ import annotations

from typing import Any

import ufl

from .symbols import NOWHERE

_VECTORS = (
    *("u0", "Du", "u", "v", "virtual_u", "X", "t0", "u_before"),
    *("director0", "director1", "director"),
)
_STRAINS = (
    *("strains0", "strains1", "strain_increments", "strains_before"),
    *("total_strains0", "total_strains1", "natural0", "natural1", "natural_increments"),
)
_SCALARS = (
    *("psi0", "Dpsi", "psi", "omega", "virtual_psi", "h", "t", "dt", "load_factor"),
    *("psi_before", "memory"),
)


class Symbol(ufl.Constant):
    """A symbol that varies along a beam, so that UFL keeps its derivatives."""

    def __init__(self, *shape: int):
        super().__init__(NOWHERE, shape=shape)

    def is_cellwise_constant(self) -> bool:
        """It is not."""
        return False


class StepSymbols:
    """An `fx_beam.Step` whose fields are symbols of the same shape, on no mesh."""

    degree, nodes = 1, None

    def __init__(self) -> None:
        self.__dict__ |= {name: Symbol(2) for name in _VECTORS}
        self.__dict__ |= {name: Symbol() for name in _SCALARS}
        self.__dict__ |= {name: (Symbol(), Symbol(), Symbol()) for name in _STRAINS}

    def prime(self, field: Any) -> Any:
        """Derivative along the reference arc length."""
        return ufl.dot(ufl.grad(field), self.__dict__["t0"])


#: The symbols, made once: they are the same for all functions, so that these can be compared.
STEP: Any = StepSymbols()
SCALARS = tuple(Symbol() for _ in range(8))
