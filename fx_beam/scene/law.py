"""Material laws of sections: stored energies, and the resultants that are their derivatives."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import ufl
from ufl.algorithms.apply_algebra_lowering import apply_algebra_lowering
from ufl.algorithms.apply_derivatives import apply_derivatives
from ufl.classes import EQ, GE, GT, LE, LT, NE, Abs, Conditional, MaxValue, MinValue
from ufl.constantvalue import Zero
from ufl.corealg.traversal import unique_pre_traversal

from fx_beam.errors import SceneError, fields_in, refuse_fields, require

from .internal_variables import InternalVariables, check_dissipation
from .parameters import Parameter, parameters_in
from .symbols import SCALARS, Symbol, expression_of

Energy = Callable[..., Any]

# Operators of functions that are defined piece by piece.
_OF_PIECES = Abs, Conditional, MaxValue, MinValue
# Strains at which a stored energy is compared with that of zero strain.
_SIZES = 1e-3, 1e-2, 0.1, 1.0, 10.0
# Comparisons of two numbers, of which conditions are made.
_COMPARISONS = EQ, GE, GT, LE, LT, NE


@dataclass(frozen=True)
class Law:
    """Stored energy per length as a UFL function of (eps, gamma, kappa).

    Parameters
    ----------
    energy : callable
        ``energy(eps, gamma, kappa)``, the stored energy per length [J/m].
    quadratic : bool
        Whether the energy is quadratic; the resultants at the mean strain are then the discrete
        gradient.
    data : tuple
        dolfinx functions and constants in it: stiffnesses of the sections.
    ends : tuple of two Laws, optional
        With internal variables, the laws at the start and at the end of the step; the law itself is
        at the mean of their variables.

    Examples
    --------
    >>> import ufl, fx_beam as fb
    >>> law = fb.Law(lambda eps, gamma, kappa: 50 * (eps**2 + gamma**2 + kappa**2), quadratic=True)
    >>> N, Q, M = law.resultants(*map(ufl.as_ufl, (0.01, 0.0, 0.1)))
    >>> round(N(()), 6), round(M(()), 6)
    (1.0, 10.0)
    """

    energy: Energy
    quadratic: bool
    data: tuple = ()
    ends: tuple[Law, Law] | None = None

    @property
    def start(self) -> Law:
        """The law at the start of the step."""
        return self if self.ends is None else self.ends[0]

    @property
    def end(self) -> Law:
        """The law at the end of the step."""
        return self if self.ends is None else self.ends[1]

    def resultants(self, eps, gamma, kappa):
        """Material stress resultants: the derivatives of the stored energy (eq. 11).

        Parameters
        ----------
        eps, gamma, kappa : ufl scalar
            Axial strain, shear strain and curvature [1/m].

        Returns
        -------
        tuple of ufl scalars
            N [N], Q [N] and M [N m].
        """
        e = [ufl.variable(x) for x in (eps, gamma, kappa)]
        W = self.energy(*e)
        return tuple(ufl.diff(W, x) for x in e)

    def linear(self, strains):
        """Stress resultants of small strains about the undeformed section.

        Parameters
        ----------
        strains : sequence of three ufl scalars
            Axial strain, shear strain and curvature [1/m].

        Returns
        -------
        tuple of ufl scalars
            N [N], Q [N] and M [N m]: the second derivatives of the stored energy, at zero strain,
            times the strains.
        """
        if self.quadratic and self.ends is None:
            return self.resultants(*strains)
        e = [ufl.variable(ufl.as_ufl(0.0)) for _ in range(3)]
        forces = [ufl.diff(self.energy(*e), x) for x in e]
        return tuple(
            sum(ufl.diff(force, x) * strain for x, strain in zip(e, strains, strict=True))
            for force in forces
        )


def quadratic_law(stiffness) -> Law:
    """Law of linear elasticity (eq. 11); `stiffness` is the UFL vector (EA, GA, EI)."""

    def energy(eps, gamma, kappa):
        membrane = stiffness[0] * eps**2 / 2
        shear = stiffness[1] * gamma**2 / 2
        bending = stiffness[2] * kappa**2 / 2
        return membrane + shear + bending

    return Law(energy, quadratic=True, data=tuple(fields_in(stiffness)))


def own_law(energy: Energy) -> Law:
    """Law of a stored energy of the user, a function of the three strains."""

    def along_a_line(s):
        return energy(0.3 + 0.7 * s, 0.2 - 1.1 * s, 0.5 + 1.3 * s)

    return Law(energy, is_quadratic(along_a_line))


def is_quadratic(energy: Energy) -> bool:
    """Whether the third derivative of a function of one variable is zero, and it has no pieces."""
    s = ufl.variable(ufl.as_ufl(0.1))
    third = ufl.as_ufl(energy(s))
    if any(isinstance(part, _OF_PIECES) for part in unique_pre_traversal(third)):
        return False  # between two pieces no derivative tells of the other
    for _ in range(3):
        third = ufl.diff(third, s)
    return isinstance(apply_derivatives(apply_algebra_lowering(third)), Zero)


def switches(expression: Any) -> list[Any]:
    """Values that change their sign where pieces of an expression meet."""
    values = []
    for part in unique_pre_traversal(ufl.as_ufl(expression)):
        operands = part.ufl_operands
        if isinstance(part, Abs):
            values.append(operands[0])
        elif isinstance(part, (*_COMPARISONS, MaxValue, MinValue)):
            values.append(operands[0] - operands[1])
    return values


def has_pieces(energy: Energy) -> bool:
    """Whether the stored energy of a section, without internal variables, has pieces."""
    strains = [ufl.variable(ufl.as_ufl(0.1)) for _ in range(3)]
    return bool(switches(energy(*strains)))


def check_energy(
    strain_energy: Energy,
    internal: InternalVariables | None,
    part: str = "Section",
    strains: tuple[str, ...] = ("eps", "gamma", "kappa"),
    name: str = "strain_energy",
) -> None:
    """Refuse a stored energy that is no scalar UFL expression of all its arguments."""
    e, names = [ufl.variable(ufl.as_ufl(0.1)) for _ in strains], [*strains]
    arguments: list[Any] = list(e)
    if internal is not None:
        a = [ufl.variable(ufl.as_ufl(0.0)) for _ in internal.names]
        e, names, arguments = [*e, *a], [*names, *internal.names], [*e, ufl.as_vector(a)]
    call = f"{name}({', '.join(strains)}{'' if internal is None else ', a'})"
    W = expression_of(strain_energy, arguments, f"{part}: {call}")
    refuse_fields(fields_in(W), f"{part}: {name}", parameters_in(W))
    met = set(unique_pre_traversal(W))
    missing = [n for n, x in zip(names, e, strict=True) if x not in met]
    if W.ufl_shape == () and missing:
        raise SceneError(f"{part}: {name} does not depend on {missing}. Use ufl.cos, not math.cos")
    if W.ufl_shape != ():
        raise SceneError(f"{part}: {name} must be a scalar, not of shape {W.ufl_shape}")
    if len(strains) == 3:
        _check_convexity(W, e[:3], f"{part}: {name}", strains)
    if internal is not None:
        check_dissipation(strain_energy, internal, len(strains))


def _check_convexity(W: Any, e: list[Any], what: str, strains: tuple[str, ...]) -> None:
    """Refuse a stored energy that falls along a strain, from zero on and without an end."""
    symbols = SCALARS[: len(e)]
    energy = ufl.replace(W, dict(zip(e, symbols, strict=True)))

    def at(name: str, value: float) -> float:
        """The energy at a value of one strain, the others being zero."""
        values = [value if name == strain else 0.0 for strain in strains]
        try:
            return float(energy((), dict(zip(symbols, values, strict=True))))
        except (ArithmeticError, ValueError, TypeError):
            return math.nan  # it is not defined there

    start = at(strains[0], 0.0)
    for name in strains:
        if all(at(name, sign * size) < start for size in _SIZES for sign in (1, -1)):
            slope = (at(name, _SIZES[0]) + at(name, -_SIZES[0]) - 2 * start) / _SIZES[0] ** 2
            raise SceneError(
                f"{what} falls as {name} grows in either direction: at zero strain its second "
                f"derivative by {name} is {slope:.6g}, which must be positive. Check the signs"
            )


def functions_of_energy(
    energy: Energy | None, internal: InternalVariables | None, strains: int
) -> Iterator[tuple[str, Any]]:
    """Expressions of a stored energy and its internal variables, by kind."""
    if energy is None:
        return
    e0, e, dt = SCALARS[:strains], SCALARS[3 : 3 + strains], SCALARS[6]
    if internal is None:
        yield "strain_energy", ufl.as_ufl(energy(*e))
        return
    a = _vector(len(internal.names))
    yield "strain_energy", ufl.as_ufl(energy(*e, a))
    yield "update", internal.updated(a, e0, e, dt)


@functools.cache
def _vector(size: int) -> Any:
    return ufl.as_vector([Symbol() for _ in range(size)])


def parameters_of_energy(
    energy: Energy | None, internal: InternalVariables | None, strains: int
) -> list[Parameter]:
    """Parameters in a stored energy and its internal variables."""
    functions = functions_of_energy(energy, internal, strains)
    return parameters_in(*(expression for _, expression in functions))


def check_internal(internal: Any, strain_energy: Energy | None, part: str, arguments: str) -> None:
    """Refuse internal variables of another type, or without a stored energy."""
    fits = isinstance(internal, InternalVariables)
    require(fits, f"{part}: internal", internal, "an fx_beam.InternalVariables")
    if strain_energy is None:
        raise SceneError(
            f"{part}: internal variables need a strain_energy({arguments}, a), which depends on "
            "them"
        )
