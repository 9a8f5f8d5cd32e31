"""Forces along beams over a step: stress resultants, the work that makes energy exact, drag."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

from fx_beam.scene.law import Law, has_pieces
from fx_beam.symbolic import Expr, ufl

from .kinematics import (
    Step,
    differences,
    director,
    elastic,
    perp,
    strains,
    tan,
    turn_of,
    virtual_work,
)

#: Added to the square of a speed, whose root then has a derivative at rest; below all rounding.
_AT_REST = 1e-300


class NodeRotations(NamedTuple):
    """Rotations at the nodes of an element, as UFL vectors in the order of `lagrange`."""

    #: Increments and virtual rotations.
    Dpsi: Expr
    virtual_psi: Expr
    #: Shape functions N_a, and their derivatives N_a' along the reference arc length.
    shape: Expr
    slope: Expr


def lagrange(x, degree: int):
    """Lagrange polynomials and their derivatives at x, for nodes at 0, `degree`, and 1, 2, ..."""
    shape, slope = [], []
    for a in (0, degree, *range(1, degree)):
        nodes = [b for b in range(degree + 1) if b != a]
        scale = 1 / math.prod(a - b for b in nodes)
        shape.append(scale * _product(x - b for b in nodes))
        slope.append(scale * sum(_product(x - b for b in nodes if b != c) for c in nodes))
    return ufl.as_vector(shape), ufl.as_vector(slope)


def _product(factors: Iterable):
    first, *rest = [*factors] or [1.0]
    return math.prod(rest, start=first)


def exact_virtual_work(step: Step, dphi, n, m):
    """Internal virtual work per length, which the step's increment makes N.(E1 - E0) + m (K1 - K0).

    The increment is Du and, at the nodes, 2 tan(Dpsi/2). Rigid motions do no work.
    """
    lever = ufl.dot(perp(dphi), n)
    turning = _turning_work_of_line if step.degree == 1 else turning_work
    return ufl.dot(step.prime(step.virtual_u), n) + turning(step, lever, m)


def turning_work(step: Step, lever, m):
    """Virtual psi' m - virtual psi lever, with functions S_a and B_a in place of N_a and N_a'.

    With x_a = Dpsi_a/2, y = Dpsi/2 and c_a = cos(x_a) (x_a - y) / sin(x_a - y) they are
        S_a = N_a c_a / sum_b N_b c_b,     B_a = cos(y) (N_a' c_a - S_a sum_b N_b' c_b).
    """
    # c_a (tan(x_a) - tan(y)) = (x_a - y) / cos(y). The sums of N_a (x_a - y) and N_a' (x_a - y) are
    # zero and Dpsi'/2, so that sums of S_a and B_a times 2 tan(x_a) are 2 tan(y) and Dpsi'.
    nodes, y = step.nodes, step.Dpsi / 2
    c = ufl.as_vector([ufl.cos(D / 2) / _sine_quotient(D / 2 - y) for D in nodes.Dpsi])
    # Collected by virtual_psi_a, which keeps the derivative short.
    couple = ufl.cos(y) * m
    force = (lever + couple * ufl.dot(nodes.slope, c)) / ufl.dot(nodes.shape, c)
    return sum(
        virtual * c_a * (slope * couple - shape * force)
        for virtual, c_a, slope, shape in zip(
            nodes.virtual_psi, c, nodes.slope, nodes.shape, strict=True
        )
    )


def _turning_work_of_line(step: Step, lever, m):
    """`turning_work` for two nodes, at the point midway between them.

    With h = Dpsi/2 and d = l Dpsi'/4 the nodal half increments are h - d and h + d.
    """
    d = step.h * step.prime(step.Dpsi) / 4
    tan_h, tan_d = tan(step.Dpsi / 2), tan(d)
    # m 2d / sin(2d) cos(h - d) cos(h + d) + lever l/2 tan(h) tan(d)
    couple = m * x_over_tan(d, tan_d) * (1 - (tan_h * tan_d) ** 2) / (1 + tan_h**2)
    couple += lever * (step.h / 2) * tan_h * tan_d
    return step.prime(step.virtual_psi) * couple - step.virtual_psi * lever


def _sine_quotient(x):
    """sin(x) / x by ten terms of its series: exact to round-off up to 1.5, to 5e-14 up to 2."""
    x2, series = x * x, 0.0
    for n in reversed(range(10)):
        series = series * x2 + (-1) ** n / math.factorial(2 * n + 1)
    return series


def x_over_tan(x, tan_x):
    """x / tan(x), smooth at 0: below 0.02 a series, exact to round-off."""
    x2 = x**2
    series = 1 - x2 / 3 * (1 + x2 / 15 * (1 + x2 * 2 / 21))
    return ufl.conditional(ufl.lt(x2, 4e-4), series, x / tan_x)


def work_of(forces, strains):
    """Work per length of the forces N, Q and M on strains."""
    return sum(force * strain for force, strain in zip(forces, strains, strict=True))


class Resultants(NamedTuple):
    """Stress resultants of one step as UFL expressions.

    Parameters
    ----------
    dphi : ufl vector (2,)
        Derivative phi' of the position along the arc length, in the virtual strains [1].
    t : ufl vector (2,)
        Director of N; Q acts along W t. Its length may differ from 1.
    N, Q, M : ufl scalar
        Axial force [N], shear force [N] and bending moment [N m], work-conjugate to the strains.
    m : ufl scalar
        The moment in the weak form [N m]: M, unless the scheme modifies it (eq. 47).

    Examples
    --------
    >>> import ufl, fx_beam as fb
    >>> x = ufl.as_vector((1.0, 0.0))
    >>> r = fb.Resultants(dphi=x, t=x, N=100.0, Q=5.0, M=2.0, m=2.0)
    >>> [float(component) for component in r.n]
    [100.0, 5.0]
    """

    dphi: Expr
    t: Expr
    N: Expr
    Q: Expr
    M: Expr
    m: Expr

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


class ExactResultants(Resultants):
    """Resultants whose work on the step's increment is N.(E1 - E0) + M (K1 - K0)."""

    def virtual_work(self, step: Step):
        """Internal virtual work per length of the resultants."""
        return exact_virtual_work(step, self.dphi, self.n, self.m)


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
    natural = None if step.natural0 is None else (step.natural0 + step.natural1) / 2
    return _at(step, law, step.u0 + step.Du / 2, step.psi0 + step.Dpsi / 2, natural)


@dataclass(frozen=True)
class AtEnds:
    """Resultants of both ends of the step; `level` is the weight of the end (Newmark family)."""

    level: float

    def __call__(self, step: Step, law: Law) -> WeightedResultants:
        """The resultants of a step."""
        start = _at(step, law.start, step.u0, step.psi0, step.natural0)
        end = _at(step, law.end, step.u0 + step.Du, step.psi0 + step.Dpsi, step.natural1)
        return WeightedResultants(start, end, self.level)


def _at(step: Step, law: Law, u, psi, natural) -> Resultants:
    """Resultants of one configuration, with its natural strains."""
    du, turn = step.prime(u), turn_of(step.t0, psi)
    t = step.t0 + turn
    N, Q, M = law.resultants(*elastic(strains(du, t, turn, step.prime(psi)), natural))
    return Resultants(step.t0 + du, t, N, Q, M, m=M)


def averaged(step: Step, law: Law) -> Resultants:
    """Resultants of the averaged strains on the averaged directors (eqs 36 to 41 and 47)."""
    return at_averages(step, *discrete_gradient(law, step.strains0, step.strains1, step.h / 10))


def at_averages(step: Step, N, Q, M) -> Resultants:
    """Resultants on the means of phi' and of the directors of both ends (eqs 36 and 47)."""
    dphi = step.t0 + step.prime(step.u0 + step.Du / 2)
    t = (step.director0 + step.director1) / 2
    m = M / (1 + tan(step.Dpsi / 2) ** 2)
    return Resultants(dphi, t, N, Q, M, m)


def with_exact_work(step: Step, r: Resultants) -> ExactResultants:
    """Resultants with N, Q and M of r, and the work N.(E1 - E0) + M (K1 - K0) in every step."""
    return ExactResultants(*r._replace(m=r.M))


def discrete_gradient(law: Law, e0, e1, length):
    """N, Q and M whose work on the strain increment is the increment of the stored energy.

    They are taken at the mean strain (eqs 40 and 41), and unless the energy is quadratic get the
    smallest correction (Gonzalez 1996, doi 10.1007/BF02440162). `length` makes curvatures
    comparable.
    """
    mean = law.resultants(*((a + b) / 2 for a, b in zip(e0, e1, strict=True)))
    if law.quadratic:
        return mean
    path = differences(e0, e1)
    weighted = path[0], path[1], length**2 * path[2]
    gained = law.energy(*e1) - law.energy(*e0)
    missing = gained - ufl.dot(ufl.as_vector(mean), ufl.as_vector(path))
    norm2 = ufl.dot(ufl.as_vector(weighted), ufl.as_vector(path))
    # The correction is of order EA De^2; round-off of W adds an error of eps EA / De. Below
    # eps^(1/3) the correction is smaller than this error. Where pieces meet at small strains, both
    # are relative to these, if it is more than round-off of W, and norm2 has a reciprocal.
    long_enough = ufl.gt(norm2, 6e-6**2)
    if has_pieces(law.energy):
        size2 = sum(x * x * (length**2 if i % 3 == 2 else 1) for i, x in enumerate((*e0, *e1)))
        certain = ufl.gt(abs(missing), 2e-14 * (abs(law.energy(*e0)) + abs(law.energy(*e1))))
        long_enough = ufl.Or(long_enough, ufl.And(certain, ufl.gt(norm2, 6e-6**2 * size2 + 1e-100)))
    factor = ufl.conditional(long_enough, missing / ufl.conditional(long_enough, norm2, 1), 0)
    return tuple(r + factor * w for r, w in zip(mean, weighted, strict=True))


class DecayingResultants(ExactResultants):
    """Resultants whose work is that of the stored energy, plus what the scheme takes."""

    #: Resultants of the stored energy alone.
    mean: Resultants
    #: Energy per length that the scheme takes in the step.
    loss: Expr
    #: Energy per length that it holds for the next step, and that it held at the start, both with
    #: the stiffness of this step; None with order 1.
    held: Expr
    held_before: Expr


@dataclass(frozen=True)
class Decaying:
    """The averaged resultants plus damping/2 C (dE - r dE_before).

    dE are the increments of the strains in this step, dE_before in the last one, C the stiffness,
    and r the ratio of the steps' lengths, at most 1. With order 1, r is 0.
    """

    damping: float | Expr
    order: int

    def __call__(self, step: Step, law: Law) -> DecayingResultants:
        """The resultants of a step."""
        # Of the motion alone: what natural strains do is no vibration.
        change = differences(step.total_strains0, step.total_strains1)
        rest, held_energy, held_before, lost_before = change, None, None, 0.0
        if self.order == 2:
            change_before = differences(step.strains_before, step.total_strains0)
            rest = [a - step.memory * b for a, b in zip(change, change_before, strict=True)]
            # The work of the added resultants is the loss plus what the held energy gains:
            # 2 dE.C rest = dE.C dE - r^2 dE_before.C dE_before + rest.C rest
            held_energy = self.damping / 4 * work_of(law.linear(change), change)
            last_work = work_of(law.linear(change_before), change_before)
            held_before = self.damping / 4 * last_work
            lost_before = (1 - step.memory**2) * last_work
        forces = law.linear(rest)
        N, Q, M = (self.damping / 2 * force for force in forces)
        share = 2 if self.order == 1 else 1
        loss = self.damping / 4 * (share * work_of(forces, rest) + lost_before)
        mean = averaged(step, law)
        total = mean._replace(N=mean.N + N, Q=mean.Q + Q, M=mean.M + M)
        r = DecayingResultants(*with_exact_work(step, total))
        r.mean, r.loss, r.held, r.held_before = mean, loss, held_energy, held_before
        return r


def viscous(step: Step, law: Law, tau, level: float) -> Resultants | ExactResultants:
    """C (tau Edot), with the stiffness C of the undeformed section and three retardation times.

    At mid-step the strain rate is dE/dt, so that the loss is exact. Other schemes take the rate at
    their level.
    """
    if level == 0.5:
        return with_exact_work(step, at_averages(step, *_mean_forces(step, law, tau)))
    dphi, t = step.t0 + step.prime(step.u), director(step.psi, step.t0)
    rate = step.prime(step.v)
    rates = (
        ufl.dot(rate, t) + step.omega * ufl.dot(dphi, perp(t)),
        ufl.dot(rate, perp(t)) - step.omega * ufl.dot(dphi, t),
        step.prime(step.omega),
    )
    natural = step.natural_increments
    N, Q, M = law.linear([tau[i] * (rates[i] - natural[i] / step.dt) for i in range(3)])
    return Resultants(dphi, t, N, Q, M, m=M)


def viscous_loss(step: Step, law: Law, tau):
    """Energy per length that viscous forces take in a step, dE . C (tau dE) / dt >= 0."""
    return work_of(_mean_forces(step, law, tau), step.strain_increments)


def _mean_forces(step: Step, law: Law, tau):
    """C (tau dE / dt)."""
    return law.linear([tau[i] * dE / step.dt for i, dE in enumerate(step.strain_increments)])


def actuation(step: Step, r: Resultants | WeightedResultants):
    """Work per length -N.DE* of natural strains that change by DE* over a step.

    With N.D(E - E*), the increment of the stored energy, it gives the work N.DE on the motion.
    """
    if isinstance(r, WeightedResultants):
        r = r._replace(level=0.5)
    elif isinstance(r, DecayingResultants):
        r = r.mean
    return -work_of((r.N, r.Q, r.M), step.natural_increments)


def drag_work(step: Step, coefficients: Mapping[str, Expr]):
    """Virtual work per length against the drag, at the scheme's level in the step.

    Coefficients: "linear" and "quadratic" in all directions, "linear along and across", "quadratic
    along and across", and "rotation".
    """
    work = ufl.dot(_force(step, coefficients, step.v), step.virtual_u)
    if "rotation" in coefficients and step.nodes is not None:
        # The virtual rotation that is 2 tan(Dpsi/2) on the step's own increment.
        return work - turning_work(step, coefficients["rotation"] * step.omega, 0)
    return work + coefficients.get("rotation", 0) * step.omega * step.virtual_psi


def drag_loss(step: Step, coefficients: Mapping[str, Expr]):
    """Energy per length that the drag at the mean velocity takes in a step; never negative."""
    turn = step.Dpsi if step.nodes is None else 2 * ufl.tan(step.Dpsi / 2)
    lost = ufl.dot(_force(step, coefficients, step.Du / step.dt), step.Du)
    return lost + coefficients.get("rotation", 0) * turn**2 / step.dt


def _force(step: Step, coefficients: Mapping[str, Expr], v):
    """Resisting force per length at the velocity v."""
    force = coefficients.get("linear", 0) * v
    force += coefficients.get("quadratic", 0) * ufl.sqrt(ufl.dot(v, v) + _AT_REST) * v
    t = director(step.psi, step.t0)
    linear = coefficients.get("linear along and across", (0, 0))
    quadratic = coefficients.get("quadratic along and across", (0, 0))
    for i, direction in enumerate((t, perp(t))):
        speed = ufl.dot(v, direction)
        force += (linear[i] + quadratic[i] * abs(speed)) * speed * direction
    return force
