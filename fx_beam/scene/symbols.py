"""UFL symbols in the hands of a user's functions, and the domain of those without a mesh."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import ufl
from ufl.core.expr import Expr
from ufl.domain import AbstractDomain

from fx_beam.errors import SceneError


class _Nowhere(AbstractDomain):
    """A domain that is no mesh, as UFL wants one for each symbol, with what its versions ask."""

    def __init__(self) -> None:
        super().__init__(1, 2)

    @property
    def meshes(self) -> tuple[AbstractDomain]:
        """It is its only part."""
        return (self,)

    def ufl_cell(self) -> Any:
        """An interval."""
        return ufl.interval

    def ufl_id(self) -> int:
        """No number of a mesh."""
        return -1

    def _ufl_sort_key_(self) -> tuple[int, str, int]:
        return 1, "nowhere", -1


#: Domain of symbols that belong to no mesh; in forms others are in their place.
NOWHERE = _Nowhere()


@contextmanager
def not_numbers() -> Iterator[None]:
    """Calls in which a symbol refuses to be a number, as functions of math and NumPy want it.

    UFL would try it over and over, with a warning each time, and never end.
    """

    def refuse(self):
        raise TypeError("a UFL symbol is not a number. Use ufl.exp, not math.exp")

    usual = Expr.__float__
    Expr.__float__ = refuse  # numbers of UFL have their own
    try:
        yield
    finally:
        Expr.__float__ = usual


def expression_of(function: Callable, arguments: Sequence, call: str) -> Any:
    """The UFL expression that a user's function gives; SceneError, named by the call, for none."""
    try:
        with not_numbers():
            return ufl.as_ufl(function(*arguments))
    except Exception as error:
        raise SceneError(
            f"{call} must give a UFL expression. Use ufl.sqrt, ufl.exp, ... in place of functions "
            f"of math or NumPy. It raised {error!r}"
        ) from error


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
