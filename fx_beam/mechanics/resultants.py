"""Stress resultants n and m of each time scheme, in UFL."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import ufl

from fx_beam.scene.section import Law

from .kinematics import Step, director, perp, strains, tan, virtual_work


class Resultants(NamedTuple):
    """Stress resultants of one step as UFL expressions.

    Parameters
    ----------
    dphi : ufl vector (2,)
        The phi' in the virtual strains.
    t : ufl vector (2,)
        Director of N; Q acts along W t. Its length may differ from 1.
    N, Q, M : ufl scalar
        Axial force [N], shear force [N] and bending moment [N m], work-conjugate to the strains.
    m : ufl scalar
        The couple in the weak form [N m]; M itself unless the scheme modifies it (eq. 47).

    Examples
    --------
    >>> import ufl, fx_beam as fb
    >>> x = ufl.as_vector((1.0, 0.0))
    >>> r = fb.Resultants(dphi=x, t=x, N=100.0, Q=5.0, M=2.0, m=2.0)
    >>> [float(component) for component in r.n]
    [100.0, 5.0]
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

    def virtual_work(self, step: Step):
        """Internal virtual work per length of the resultants.

        Parameters
        ----------
        step : Step
            Fields of the step.

        Returns
        -------
        ufl scalar
            Eqs 15 to 17.
        """
        return virtual_work(step, self.dphi, self.n, self.m)


class WeightedResultants(NamedTuple):
    """Weighted mean of the resultants at the start and at the end of a step.

    Parameters
    ----------
    start, end : Resultants
        The resultants of both ends.
    level : float
        Weight of the end; the start has the weight 1 - level.

    Examples
    --------
    >>> import ufl, fx_beam as fb
    >>> x = ufl.as_vector((1.0, 0.0))
    >>> start, end = (fb.Resultants(x, x, N=N, Q=0.0, M=0.0, m=0.0) for N in (10.0, 20.0))
    >>> fb.WeightedResultants(start, end, level=0.9).N
    19.0
    """

    start: Resultants
    end: Resultants
    level: float

    @property
    def N(self):
        """Axial force [N]."""
        return self._mean(self.start.N, self.end.N)

    @property
    def Q(self):
        """Shear force [N]."""
        return self._mean(self.start.Q, self.end.Q)

    @property
    def M(self):
        """Bending moment [N m]."""
        return self._mean(self.start.M, self.end.M)

    def virtual_work(self, step: Step):
        """Internal virtual work per length of the resultants.

        Parameters
        ----------
        step : Step
            Fields of the step.

        Returns
        -------
        ufl scalar
            Weighted mean of both ends.
        """
        return self._mean(self.start.virtual_work(step), self.end.virtual_work(step))

    def _mean(self, start, end):
        return (1 - self.level) * start + self.level * end


def at_mid_step(step: Step, law: Law) -> Resultants:
    """Resultants of the configuration in the middle of the step (eq. 31)."""
    return _at(step, law, step.u0 + step.Du / 2, step.psi0 + step.Dpsi / 2)


@dataclass(frozen=True)
class AtEnds:
    """Resultants of both ends of the step; `level` is the weight of the end (Newmark family)."""

    level: float

    def __call__(self, step: Step, law: Law) -> WeightedResultants:
        """The resultants of a step."""
        start = _at(step, law, step.u0, step.psi0)
        end = _at(step, law, step.u0 + step.Du, step.psi0 + step.Dpsi)
        return WeightedResultants(start, end, self.level)


def _at(step: Step, law: Law, u, psi) -> Resultants:
    """Resultants of one configuration."""
    dphi = step.t0 + step.prime(u)
    N, Q, M = law.resultants(*strains(dphi, psi, step.prime(psi), step.t0))
    return Resultants(dphi, director(psi, step.t0), N, Q, M, m=M)


def averaged(step: Step, law: Law) -> Resultants:
    """Resultants of the averaged strains on the averaged directors (eqs 36 to 41 and 47)."""
    N, Q, M = discrete_gradient(law, step.strains0, step.strains1, _length_scale(step))
    dphi = step.t0 + step.prime(step.u0 + step.Du / 2)
    t = (director(step.psi0, step.t0) + director(step.psi0 + step.Dpsi, step.t0)) / 2
    m = M / (1 + tan(step.Dpsi / 2) ** 2)
    return Resultants(dphi, t, N, Q, M, m)


def with_exact_work(step: Step, r: Resultants) -> Resultants:
    """Averaged resultants, modified so that their work equals N.(E1 - E0) + M (K1 - K0).

    For degree 2 and 3, N, Q and m change as little as possible (`closest`).
    """
    if step.degree > 1:
        work = sum(
            f * (b - a)
            for f, a, b in zip((r.N, r.Q, r.M), step.strains0, step.strains1, strict=True)
        )
        virtual = step.prime(step.Du) - step.Dtheta * perp(r.dphi)
        path = ufl.dot(virtual, r.t), ufl.dot(virtual, perp(r.t)), step.prime(step.Dtheta)
        N, Q, m = closest((r.N, r.Q, r.m), path, work, _length_scale(step), smallest=1e-8)
        return r._replace(N=N, Q=Q, m=m)
    # The energy balance tests with the interpolated nodal Dtheta. At a quadrature point this is not
    # 2 tan(Dpsi/2), so the energy error of eq. 47 depends on the element size. With h = Dpsi/2 and
    # d = l Dpsi'/4 at the mid-point, the nodal half increments are h - d and h + d, and
    #     m = M 2d / sin(2d) cos(h-d) cos(h+d) + (n . W phi'_m) l/2 tan(h) tan(d)
    #       = M d / tan(d) (1 - tan^2 h tan^2 d) / (1 + tan^2 h) + (n . W phi'_m) l/2 tan(h) tan(d)
    # gives Du'.n - Dtheta (W phi'_m).n + Dtheta' m = N.(E1 - E0) + M (K1 - K0) identically. For
    # degree 2 and 3 such an m is singular where Dtheta' = 0. Momenta are conserved in any case, as
    # no resultants do work in a rigid motion.
    d = step.h * step.prime(step.Dpsi) / 4
    tan_h, tan_d = tan(step.Dpsi / 2), tan(d)
    couple = r.M * _x_over_tan(d, tan_d) * (1 - (tan_h * tan_d) ** 2) / (1 + tan_h**2)
    lever = ufl.dot(r.n, perp(r.dphi)) * (step.h / 2) * tan_h * tan_d
    return r._replace(m=couple + lever)


def _length_scale(step: Step):
    """Length that makes a curvature comparable with strains, in `closest`.

    Of 0.03 to 100 elements, 0.1 gave the fewest failed steps (pinned and free beams, degrees 2, 3).
    """
    return step.h / 10


def discrete_gradient(law: Law, e0, e1, length):
    """N, Q and M whose work on the strain increment is the increment of the stored energy.

    Those at the mean strain for a quadratic energy (eqs 40 and 41), else with the smallest
    correction (Gonzalez 1996, doi 10.1007/BF02440162).
    """
    mean = law.resultants(*((a + b) / 2 for a, b in zip(e0, e1, strict=True)))
    if law.quadratic:
        return mean
    increments = tuple(b - a for a, b in zip(e0, e1, strict=True))
    # The correction is of order EA De^2; round-off of W adds an error of eps EA / De. Below
    # eps^(1/3) the correction is smaller than this error.
    gained = law.energy(*e1) - law.energy(*e0)
    return closest(mean, increments, gained, length, smallest=6e-6)


def closest(resultants, path, work, length, smallest):
    """Resultants closest to the given ones that do the given work on a path of strain increments.

    `length` [m] makes curvatures comparable with strains. Below the size `smallest` of the path the
    resultants are not changed.
    """
    weighted = (path[0], path[1], length**2 * path[2])
    norm2 = ufl.dot(ufl.as_vector(weighted), ufl.as_vector(path))
    missing = work - ufl.dot(ufl.as_vector(resultants), ufl.as_vector(path))
    long_enough = ufl.gt(norm2, smallest**2)
    factor = ufl.conditional(long_enough, missing / ufl.conditional(long_enough, norm2, 1), 0)
    return tuple(r + factor * w for r, w in zip(resultants, weighted, strict=True))


def _x_over_tan(x, tan_x):
    """x / tan(x), smooth at 0: below 0.02 a series, exact to round-off."""
    x2 = x**2
    series = 1 - x2 / 3 * (1 + x2 / 15 * (1 + x2 * 2 / 21))
    return ufl.conditional(ufl.lt(x2, 4e-4), series, x / tan_x)
