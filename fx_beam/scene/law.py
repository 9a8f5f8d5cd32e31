"""Material laws of sections: stored energies, and the resultants that are their derivatives."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import ufl
from ufl.corealg.traversal import unique_pre_traversal

from fx_beam.errors import SceneError
from fx_beam.validation import fields_in, refuse_fields

Energy = Callable[[Any, Any, Any], Any]


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
        if self.quadratic:
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


def check_energy(strain_energy: Energy) -> None:
    """Refuse a stored energy that is no scalar UFL expression of all three strains."""
    # UFL numbers, not symbols: a function of `math` would try forever to convert a symbol.
    e = [ufl.variable(ufl.as_ufl(0.1)) for _ in range(3)]
    try:
        W = ufl.as_ufl(strain_energy(*e))
    except Exception as error:
        raise SceneError(
            "Section: strain_energy(eps, gamma, kappa) must give a UFL expression. Use ufl.sqrt, "
            f"ufl.exp, ... in place of functions of math or NumPy. It raised {error!r}"
        ) from error
    refuse_fields(fields_in(W), "Section: strain_energy")
    met = set(unique_pre_traversal(W))
    missing = [n for n, x in zip(("eps", "gamma", "kappa"), e, strict=True) if x not in met]
    if W.ufl_shape == () and missing:
        raise SceneError(
            f"Section: strain_energy does not depend on {missing}. Use ufl.cos, not math.cos"
        )
    if W.ufl_shape != ():
        raise SceneError(f"Section: strain_energy must be a scalar, not of shape {W.ufl_shape}")
