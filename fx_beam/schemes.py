"""Time schemes: stress resultants of a step in UFL, and the nodal rule for the rates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np
import ufl

from .errors import SceneError
from .kinematics import Step, director, perp, strains
from .section import Law


class Resultants(NamedTuple):
    """Stress resultants of one step as UFL expressions.

    Parameters
    ----------
    dphi : ufl vector (2,)
        The phi' with which the virtual strains are formed.
    t : ufl vector (2,)
        Director on which N acts; Q acts on W t. Its length may differ from 1.
    N, Q, M : ufl scalar
        Axial force [N], shear force [N] and bending moment [N m], as energy sees them.
    m : ufl scalar
        The couple in the weak form [N m]; M itself unless the scheme modifies it (eq. 47).
    """

    dphi: Any
    t: Any
    N: Any
    Q: Any
    M: Any
    m: Any

    @property
    def n(self):
        """Spatial stress resultant n = N t + Q W t [N] (eq. 10)."""
        return self.N * self.t + self.Q * perp(self.t)


class Rates(Protocol):
    """Rule that gives the nodal rates from the increment over the step.

    Arrays run over all degrees of freedom; `turns` lists those that are rotations.
    """

    #: Where in the step the forces are taken: 0 its start, 1 its end.
    level: float

    def work_increment(self, D: np.ndarray, turns: np.ndarray) -> np.ndarray:
        """Increment on which the forces do the step's work."""

    def acceleration(
        self, D: np.ndarray, v0: np.ndarray, a0: np.ndarray, dt: float, turns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Acceleration in the equation of motion, and its derivative by the increment."""

    def end(
        self, D: np.ndarray, v0: np.ndarray, a0: np.ndarray, dt: float, turns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Velocity and acceleration at the end of the step."""

    def fields(self, Du, Dpsi, v0, a0, dt) -> tuple[Any, Any]:
        """Velocity and spin at the level of the forces, in UFL.

        `v0` and `a0` are pairs (translation, rotation) of the fields at the start.
        """


@dataclass(frozen=True)
class MidPointRates:
    """Mid-point rule for displacements and for the rotation matrix (eqs 27 to 30)."""

    level: float = 0.5

    def work_increment(self, D, turns):
        """Displacement increment and Dtheta = 2 tan(Dpsi/2) (eqs 32 and 33)."""
        work = D.copy()
        work[turns] = 2 * np.tan(D[turns] / 2)
        return work

    def acceleration(self, D, v0, a0, dt, turns):
        """a = (v1 - v0)/dt, alpha = (omega1 - omega0)/dt (eq. 30)."""
        increment = self.work_increment(D, turns)
        slope = np.full_like(D, 2 / dt**2)
        slope[turns] *= 1 + (increment[turns] / 2) ** 2
        return (2 / dt) * (increment / dt - v0), slope

    def end(self, D, v0, a0, dt, turns):
        """v1 = 2 Du/dt - v0, omega1 = 4 tan(Dpsi/2)/dt - omega0 (eqs 27 and 28)."""
        v1 = (2 / dt) * self.work_increment(D, turns) - v0
        return v1, (v1 - v0) / dt

    def fields(self, Du, Dpsi, v0, a0, dt):
        """Mean velocity Du/dt and mean spin 2 tan(Dpsi/2)/dt."""
        return Du / dt, 2 * ufl.tan(Dpsi / 2) / dt


@dataclass(frozen=True)
class NewmarkRates:
    """Newmark's formulas with the weights of the generalized-alpha method.

    The inertia is taken at level 1 - alpha_m and the forces at level 1 - alpha_f of the step.
    """

    beta: float
    gamma: float
    alpha_m: float = 0.0
    alpha_f: float = 0.0

    @property
    def level(self) -> float:
        """Level of the forces, 1 - alpha_f."""
        return 1 - self.alpha_f

    def work_increment(self, D, turns):
        """The increment itself."""
        return D

    def acceleration(self, D, v0, a0, dt, turns):
        """Acceleration at level 1 - alpha_m."""
        a1 = self._end_acceleration(D, v0, a0, dt)
        slope = np.full_like(D, (1 - self.alpha_m) / (self.beta * dt**2))
        return (1 - self.alpha_m) * a1 + self.alpha_m * a0, slope

    def end(self, D, v0, a0, dt, turns):
        """Newmark's velocity and acceleration."""
        a1 = self._end_acceleration(D, v0, a0, dt)
        return v0 + dt * ((1 - self.gamma) * a0 + self.gamma * a1), a1

    def fields(self, Du, Dpsi, v0, a0, dt):
        """Velocity and spin at level 1 - alpha_f."""
        D = (Du, Dpsi)
        ends = [self.end(D[i], v0[i], a0[i], dt, None)[0] for i in (0, 1)]
        return tuple(self.level * v1 + (1 - self.level) * v for v1, v in zip(ends, v0, strict=True))

    def _end_acceleration(self, D, v0, a0, dt):
        return (D - dt * v0) / (self.beta * dt**2) - (1 / (2 * self.beta) - 1) * a0


@dataclass(frozen=True)
class Scheme:
    """A time scheme: what it takes for the resultants, and its rule for the rates.

    Parameters
    ----------
    name : str
        Name in reports and pictures.
    resultants : callable
        ``resultants(step, law)`` gives the `Resultants` of a step as UFL expressions.
    rates : Rates
        Nodal rule that gives velocities and accelerations from the increment.
    """

    name: str
    resultants: Callable[[Step, Law], Resultants]
    rates: Rates


# -- Stress resultants -----------------------------------------------------------------------


def at_level(step: Step, law: Law) -> Resultants:
    """Resultants of the configuration at the scheme's level (eq. 31 at mid-step)."""
    dphi = step.tangent
    N, Q, M = law.resultants(*strains(dphi, step.psi, step.prime(step.psi), step.t0))
    return Resultants(dphi, step.director, N, Q, M, m=M)


def averaged(step: Step, law: Law) -> Resultants:
    """Resultants of the averaged strains on the averaged directors (eqs 36 to 41 and 47)."""
    dphi0 = step.t0 + step.prime(step.u0)
    dphi1 = dphi0 + step.prime(step.Du)
    psi1 = step.psi0 + step.Dpsi
    e0 = strains(dphi0, step.psi0, step.prime(step.psi0), step.t0)
    e1 = strains(dphi1, psi1, step.prime(psi1), step.t0)
    N, Q, M = discrete_gradient(law, e0, e1, step.h)
    t = (director(step.psi0, step.t0) + director(psi1, step.t0)) / 2
    m = M / (1 + ufl.tan(step.Dpsi / 2) ** 2)
    return Resultants((dphi0 + dphi1) / 2, t, N, Q, M, m)


def energy_momentum(step: Step, law: Law) -> Resultants:
    r"""Averaged resultants with the couple that conserves energy in the two-node element.

    The step's energy balance tests with the nodal Dtheta, interpolated linearly, which at the
    quadrature point is not 2 tan(Dpsi/2) of the interpolated Dpsi. With h = Dpsi/2 and
    d = l Dpsi'/4, both at the mid-point, the nodal half increments are h - d and h + d, and

    .. math:: m = M \frac{2d}{\sin 2d} \cos(h-d) \cos(h+d)
                  + (n \cdot W\varphi'_m) \frac l2 \tan h \tan d

    makes Du'.n - Dtheta (W phi'_m).n + Dtheta' m equal to N.(E1 - E0) + M (K1 - K0)
    identically. No closed form is known for degree 2 and 3; they use eq. 47.
    """
    r = averaged(step, law)
    if step.degree > 1:
        return r
    h, d = step.Dpsi / 2, step.h * step.prime(step.Dpsi) / 4
    couple = r.M * _x_over_sin(2 * d) * ufl.cos(h - d) * ufl.cos(h + d)
    lever = ufl.dot(r.n, perp(r.dphi)) * (step.h / 2) * ufl.tan(h) * ufl.tan(d)
    return r._replace(m=couple + lever)


def discrete_gradient(law: Law, e0, e1, length):
    r"""Resultants whose work on the strain increment is the increment of the stored energy.

    The resultants at the mean strain, which is all for a quadratic energy (eqs 40 and 41);
    otherwise with the smallest change that makes them satisfy
    :math:`N \Delta\varepsilon + Q \Delta\gamma + M \Delta\kappa = \Delta W`.

    Parameters
    ----------
    law : Law
        Stored energy.
    e0, e1 : tuple of ufl scalars
        Strains (eps, gamma, kappa) at the start and at the end of the step.
    length : ufl scalar
        Length that makes the curvature comparable with the strains [m].

    Returns
    -------
    tuple of ufl scalars
        N [N], Q [N] and M [N m].

    References
    ----------
    Gonzalez (1996), J. Nonlinear Sci. 6, 449-467, doi 10.1007/BF02440162.
    """
    mean = law.resultants(*((a + b) / 2 for a, b in zip(e0, e1, strict=True)))
    if law.quadratic:
        return mean
    De = [b - a for a, b in zip(e0, e1, strict=True)]
    missing = law.energy(*e1) - law.energy(*e0) - sum(r * d for r, d in zip(mean, De, strict=True))
    weighted = (De[0], De[1], length**2 * De[2])
    norm2 = sum(w * d for w, d in zip(weighted, De, strict=True))
    # The change is of second order in De; below this bound it is smaller than its round-off.
    tiny = 1e-20
    factor = ufl.conditional(ufl.gt(norm2, tiny), missing / ufl.max_value(norm2, tiny), 0)
    return tuple(r + factor * w for r, w in zip(mean, weighted, strict=True))


def _x_over_sin(x):
    """x / sin(x), smooth at 0: below 0.02 the series is exact to round-off."""
    x2 = x**2
    series = 1 + x2 / 6 * (1 + x2 * 7 / 60 * (1 + x2 * 31 / 294))
    return ufl.conditional(ufl.lt(x2, 4e-4), series, x / ufl.sin(x))


# -- Named schemes ---------------------------------------------------------------------------


def MidPoint() -> Scheme:
    """Mid-point rule (eq. 31): second order, conserves both momenta."""
    return Scheme("MidPoint", at_level, MidPointRates())


def ModifiedMidPoint() -> Scheme:
    """Modified mid-point scheme as published (eqs 39 to 41 and 47).

    Second order; conserves both momenta, and energy up to an error of the element size.

    Returns
    -------
    Scheme
        The scheme.
    """
    return Scheme("ModifiedMidPoint", averaged, MidPointRates())


def EnergyMomentum() -> Scheme:
    """Modified mid-point scheme with the couple that conserves energy exactly.

    Second order; conserves energy and both momenta to solver accuracy for degree 1.

    Returns
    -------
    Scheme
        The scheme.
    """
    return Scheme("EnergyMomentum", energy_momentum, MidPointRates())


def Newmark(beta: float = 0.25, gamma: float = 0.5) -> Scheme:
    """Newmark's scheme; by default the average acceleration (trapezoidal) rule.

    Parameters
    ----------
    beta, gamma : float
        Newmark's parameters.

    Returns
    -------
    Scheme
        The scheme; second order for gamma = 1/2, conserves linear momentum.
    """
    _check_parameter("Newmark", "beta", beta, 0, 1, low_open=True)
    _check_parameter("Newmark", "gamma", gamma, 0, 1)
    return Scheme("Newmark", at_level, NewmarkRates(beta, gamma))


def HHT(alpha: float = -0.1) -> Scheme:
    """Hilber-Hughes-Taylor scheme, forces at level 1 + alpha.

    Parameters
    ----------
    alpha : float
        In [-1/3, 0]; 0 is the trapezoidal rule, smaller damps high frequencies more.

    Returns
    -------
    Scheme
        The scheme, with beta = (1 - alpha)^2/4 and gamma = 1/2 - alpha; second order.

    References
    ----------
    Hilber, Hughes & Taylor (1977), doi 10.1002/eqe.4290050306.
    """
    _check_parameter("HHT", "alpha", alpha, -1 / 3, 0)
    rates = NewmarkRates((1 - alpha) ** 2 / 4, 0.5 - alpha, alpha_f=-alpha)
    return Scheme("HHT", at_level, rates)


def GeneralizedAlpha(rho_inf: float = 0.9) -> Scheme:
    """Generalized-alpha scheme.

    Parameters
    ----------
    rho_inf : float
        Spectral radius at infinite frequency, in [0, 1].

    Returns
    -------
    Scheme
        The scheme; second order.

    References
    ----------
    Chung & Hulbert (1993), doi 10.1115/1.2900803.
    """
    _check_parameter("GeneralizedAlpha", "rho_inf", rho_inf, 0, 1)
    alpha_m, alpha_f = (2 * rho_inf - 1) / (rho_inf + 1), rho_inf / (rho_inf + 1)
    beta, gamma = (1 - alpha_m + alpha_f) ** 2 / 4, 0.5 - alpha_m + alpha_f
    return Scheme("GeneralizedAlpha", at_level, NewmarkRates(beta, gamma, alpha_m, alpha_f))


def _check_parameter(scheme, name, value, low, high, low_open=False):
    if not (low < value <= high or (value == low and not low_open)):
        raise SceneError(
            f"{scheme}: {name} = {value!r} must lie in {'(' if low_open else '['}{low:.4g}, {high}]"
        )
