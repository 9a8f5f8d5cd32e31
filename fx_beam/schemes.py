"""Time schemes: the stress resultants of a step in UFL, with a nodal rule for the rates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import ufl

from .errors import SceneError
from .kinematics import Step, director, perp
from .rates import MidPointRates, NewmarkRates, Rates
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
    N, Q, M = law.resultants(*step.strains)
    return Resultants(step.tangent, step.director, N, Q, M, m=M)


def averaged(step: Step, law: Law) -> Resultants:
    """Resultants of the averaged strains on the averaged directors (eqs 36 to 41 and 47)."""
    N, Q, M = discrete_gradient(law, step.strains0, step.strains1, _metric(step))
    dphi = step.t0 + step.prime(step.u0 + step.Du / 2)
    t = (director(step.psi0, step.t0) + director(step.psi0 + step.Dpsi, step.t0)) / 2
    m = M / (1 + ufl.tan(step.Dpsi / 2) ** 2)
    return Resultants(dphi, t, N, Q, M, m)


def energy_momentum(step: Step, law: Law) -> Resultants:
    """Averaged resultants, changed to do exactly the work that the strains store."""
    return with_exact_work(step, averaged(step, law))


def with_exact_work(step: Step, r: Resultants) -> Resultants:
    r"""Averaged resultants, changed to work on the step's motion as N, Q and M on its strains.

    The step's energy balance tests with the nodal Dtheta, interpolated, which at a quadrature
    point is not 2 tan(Dpsi/2) of the interpolated Dpsi; so eq. 47 balances energy only up to the
    element size. For the two-node element, with h = Dpsi/2 and d = l Dpsi'/4 at its mid-point,
    the nodal half increments are h - d and h + d, and

    .. math:: m = M \frac{2d}{\sin 2d} \cos(h-d) \cos(h+d)
                  + (n \cdot W\varphi'_m) \frac l2 \tan h \tan d

    makes Du'.n - Dtheta (W phi'_m).n + Dtheta' m equal to N.(E1 - E0) + M (K1 - K0)
    identically. For degree 2 and 3, where such an m is singular wherever Dtheta' vanishes, N, Q
    and m are changed together, as little as the same identity asks for (`closest`). Momenta allow
    any change, since a rigid motion does no work on any resultants.

    Parameters
    ----------
    step : Step
        Fields of the step.
    r : Resultants
        N, Q and M of any kind on the averaged director, as `averaged` gives them.

    Returns
    -------
    Resultants
        With another couple m, and for degree 2 and 3 other forces.
    """
    if step.degree > 1:
        work = sum(
            f * (b - a)
            for f, a, b in zip((r.N, r.Q, r.M), step.strains0, step.strains1, strict=True)
        )
        virtual = step.prime(step.Du) - step.Dtheta * perp(r.dphi)
        path = ufl.dot(virtual, r.t), ufl.dot(virtual, perp(r.t)), step.prime(step.Dtheta)
        N, Q, m = closest((r.N, r.Q, r.m), path, work, _metric(step), smallest=1e-8)
        return r._replace(N=N, Q=Q, m=m)
    h, d = step.Dpsi / 2, step.h * step.prime(step.Dpsi) / 4
    couple = r.M * _x_over_sin(2 * d) * ufl.cos(h - d) * ufl.cos(h + d)
    lever = ufl.dot(r.n, perp(r.dphi)) * (step.h / 2) * ufl.tan(h) * ufl.tan(d)
    return r._replace(m=couple + lever)


def _metric(step: Step):
    """Length that makes a curvature comparable with strains, in `closest`.

    A tenth of the element: of 0.03 to 100 elements, tried on the pinned beam and a free one with
    degree 2 and 3, it lets the fewest steps fail.
    """
    return step.h / 10


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
    increments = tuple(b - a for a, b in zip(e0, e1, strict=True))
    # The change is of the order of EA De^2, and the rounding of W makes eps EA / De of it: below
    # eps^(1/3) there is nothing to gain.
    gained = law.energy(*e1) - law.energy(*e0)
    return closest(mean, increments, gained, length, smallest=6e-6)


def closest(resultants, path, work, length, smallest):
    """Resultants closest to given ones that do given work on a path.

    Parameters
    ----------
    resultants : tuple of ufl scalars
        Two forces [N] and a couple [N m].
    path : tuple of ufl scalars
        Two increments of strain and one of curvature [1/m].
    work : ufl scalar
        What the resultants shall do on it [J/m].
    length : ufl scalar
        Length that makes the curvature comparable with the strains [m].
    smallest : float
        Size of the path below which the resultants stay as they are.

    Returns
    -------
    tuple of ufl scalars
        The changed resultants.
    """
    weighted = (path[0], path[1], length**2 * path[2])
    norm2 = ufl.dot(ufl.as_vector(weighted), ufl.as_vector(path))
    missing = work - ufl.dot(ufl.as_vector(resultants), ufl.as_vector(path))
    bound = smallest**2
    factor = ufl.conditional(ufl.gt(norm2, bound), missing / ufl.max_value(norm2, bound), 0)
    return tuple(r + factor * w for r, w in zip(resultants, weighted, strict=True))


def _x_over_sin(x):
    """x / sin(x), smooth at 0: below 0.02 the series is exact to round-off."""
    x2 = x**2
    series = 1 + x2 / 6 * (1 + x2 * 7 / 60 * (1 + x2 * 31 / 294))
    return ufl.conditional(ufl.lt(x2, 4e-4), series, x / ufl.sin(x))


# -- Named schemes ---------------------------------------------------------------------------


def MidPoint() -> Scheme:
    """Mid-point rule (eq. 31): second order, conserves both momenta.

    Returns
    -------
    Scheme
        The scheme.
    """
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
    """Modified mid-point scheme with resultants that conserve energy exactly.

    Second order; conserves energy and both momenta to solver accuracy. For degree 1 in closed
    form. For degree 2 and 3 the resultants have a pole where all strains of a Gauss point stand
    still while its element turns and bends: on coarse meshes a step in a hundred may have to be
    halved for it.

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
