"""Cross-sections of a beam: stiffness, inertia and stored energy."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import ufl
from ufl.corealg.traversal import unique_pre_traversal

from .errors import SceneError
from .values import is_number

Energy = Callable[[Any, Any, Any], Any]


@dataclass(frozen=True)
class Section:
    r"""Stiffness and inertia of a cross-section, per reference length.

    The stored energy per length is quadratic in axial strain, shear strain and curvature,
    :math:`W = \frac12 (EA\,\varepsilon^2 + GA\,\gamma^2 + EI\,\kappa^2)` (eq. 11), unless
    `strain_energy` gives another one.

    Parameters
    ----------
    EA : float
        Axial stiffness [N].
    GA : float
        Shear stiffness, shear factor included [N].
    EI : float
        Bending stiffness [N m^2].
    rhoA : float
        Mass per length [kg/m]; zero for a beam whose mass is lumped or neglected.
    rhoI : float
        Rotary inertia per length [kg m].
    strain_energy : callable, optional
        ``strain_energy(eps, gamma, kappa)``, the stored energy per length [J/m] as a UFL
        expression in axial strain, shear strain and curvature [1/m]. It replaces the quadratic
        energy; EA, GA and EI may then be left out.

    Raises
    ------
    SceneError
        For a stiffness that is not positive and finite, a negative or non-finite inertia, or a
        `strain_energy` that gives no scalar UFL expression.

    References
    ----------
    Ibrahimbegovic & Mamouri (1999), eqs 8 and 11.
    """

    EA: float | None = None
    GA: float | None = None
    EI: float | None = None
    rhoA: float = 0.0
    rhoI: float = 0.0
    strain_energy: Energy | None = None

    def __post_init__(self):
        for name in ("EA", "GA", "EI"):
            value = getattr(self, name)
            if value is None and self.strain_energy is not None:
                continue
            if value is None:
                raise SceneError(f"Section: {name} is missing; give it or a strain_energy")
            if not (is_number(value) and value > 0):
                raise SceneError(f"Section: {name} = {value!r} must be positive and finite")
        for name in ("rhoA", "rhoI"):
            value = getattr(self, name)
            if not (is_number(value) and value >= 0):
                raise SceneError(f"Section: {name} = {value!r} must be zero or positive and finite")
        if self.strain_energy is not None:
            _check_energy(self.strain_energy)

    @classmethod
    def rectangle(
        cls,
        height: float,
        width: float,
        E: float,
        nu: float = 0.3,
        rho: float = 0.0,
        shear_factor: float = 5 / 6,
    ) -> Section:
        """Rectangular section.

        Parameters
        ----------
        height : float
            Depth in the plane of motion [m].
        width : float
            Depth across the plane [m].
        E : float
            Young's modulus [Pa].
        nu : float
            Poisson's ratio.
        rho : float
            Mass density [kg/m^3].
        shear_factor : float
            Part of the area that carries shear.

        Returns
        -------
        Section
            EA, GA, EI, rhoA and rhoI of the rectangle.
        """
        _check_positive(height=height, width=width)
        area, inertia = height * width, width * height**3 / 12
        return cls.from_area(area, inertia, E, nu, rho, shear_factor)

    @classmethod
    def circle(
        cls, diameter: float, E: float, nu: float = 0.3, rho: float = 0.0, shear_factor: float = 0.9
    ) -> Section:
        """Solid circular section.

        Parameters
        ----------
        diameter : float
            Diameter [m].
        E : float
            Young's modulus [Pa].
        nu : float
            Poisson's ratio.
        rho : float
            Mass density [kg/m^3].
        shear_factor : float
            Part of the area that carries shear.

        Returns
        -------
        Section
            EA, GA, EI, rhoA and rhoI of the circle.
        """
        _check_positive(diameter=diameter)
        area, inertia = math.pi * diameter**2 / 4, math.pi * diameter**4 / 64
        return cls.from_area(area, inertia, E, nu, rho, shear_factor)

    @classmethod
    def from_area(
        cls,
        area: float,
        second_moment: float,
        E: float,
        nu: float = 0.3,
        rho: float = 0.0,
        shear_factor: float = 5 / 6,
    ) -> Section:
        """Section of given area and second moment of area.

        Parameters
        ----------
        area : float
            Area [m^2].
        second_moment : float
            Second moment of area [m^4].
        E : float
            Young's modulus [Pa].
        nu : float
            Poisson's ratio.
        rho : float
            Mass density [kg/m^3].
        shear_factor : float
            Part of the area that carries shear.

        Returns
        -------
        Section
            EA, GA, EI, rhoA and rhoI.
        """
        _check_positive(area=area, second_moment=second_moment, E=E, shear_factor=shear_factor)
        if not (is_number(nu) and -1 < nu <= 0.5):
            raise SceneError(f"Section: nu = {nu!r} must lie in (-1, 0.5]")
        G = E / (2 * (1 + nu))
        return cls(
            EA=E * area,
            GA=shear_factor * G * area,
            EI=E * second_moment,
            rhoA=rho * area,
            rhoI=rho * second_moment,
        )


@dataclass(frozen=True)
class Law:
    """Stored energy per length as a UFL function of (eps, gamma, kappa).

    Parameters
    ----------
    energy : callable
        ``energy(eps, gamma, kappa)``, the stored energy per length [J/m].
    quadratic : bool
        Whether the resultants at the mean strain are the exact discrete gradient.
    """

    energy: Energy
    quadratic: bool

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


def quadratic_law(stiffness) -> Law:
    """Law of linear elasticity (eq. 11), `stiffness` the UFL vector (EA, GA, EI)."""

    def energy(eps, gamma, kappa):
        membrane = stiffness[0] * eps**2 / 2
        shear = stiffness[1] * gamma**2 / 2
        bending = stiffness[2] * kappa**2 / 2
        return membrane + shear + bending

    return Law(energy, quadratic=True)


def _check_positive(**values) -> None:
    for name, value in values.items():
        if not (is_number(value) and value > 0):
            raise SceneError(f"Section: {name} = {value!r} must be positive and finite")


def _check_energy(strain_energy: Energy) -> None:
    # Numbers, which the functions of `math` can take: UFL tries without end to make one of symbols.
    e = [ufl.variable(ufl.as_ufl(0.1)) for _ in range(3)]
    try:
        W = ufl.as_ufl(strain_energy(*e))
    except Exception as error:
        raise SceneError(
            "Section: strain_energy(eps, gamma, kappa) must give a UFL expression, written with "
            f"ufl.sqrt, ufl.exp, ... where it needs functions; it raised {error!r}"
        ) from error
    met = set(unique_pre_traversal(W))
    missing = [n for n, x in zip(("eps", "gamma", "kappa"), e, strict=True) if x not in met]
    if W.ufl_shape == () and missing:
        raise SceneError(
            f"Section: strain_energy does not depend on {missing}; take ufl.cos, ..., not math.cos"
        )
    if W.ufl_shape != ():
        raise SceneError(f"Section: strain_energy must be a scalar, not of shape {W.ufl_shape}")
