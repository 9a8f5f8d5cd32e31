"""The virtual work of a step that equals exactly the increment of the stored energy.

The energy balance takes the nodal 2 tan(Dpsi/2) as the virtual rotation (eq. 33). Interpolated like
a rotation, this is not 2 tan(Dpsi/2) at a Gauss point, so the energy error of eq. 47 depends on the
element size. Here the virtual rotation is interpolated by functions of the step such that it is.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Any, NamedTuple

import ufl

from .kinematics import Step, perp, tan


class Nodes(NamedTuple):
    """Rotations at the nodes of an element, as UFL vectors in the order of `lagrange`."""

    #: Increments and virtual rotations.
    Dpsi: Any
    virtual_psi: Any
    #: Their interpolation N_a, and its derivative N_a' along the reference arc length.
    shape: Any
    slope: Any


def lagrange(x, degree: int):
    """Lagrange polynomials and their derivatives at x, for nodes at 0, `degree`, and 1, 2, ..."""
    shape, slope = [], []
    for a in (0, degree, *range(1, degree)):
        others = [b for b in range(degree + 1) if b != a]
        scale = 1 / math.prod(a - b for b in others)
        shape.append(scale * _product(x - b for b in others))
        slope.append(scale * sum(_product(x - b for b in others if b != c) for c in others))
    return ufl.as_vector(shape), ufl.as_vector(slope)


def _product(factors: Iterable):
    first, *others = [*factors] or [1.0]
    return math.prod(others, start=first)


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
    # zero and Dpsi'/2: those of S_a and B_a times 2 tan(x_a) are 2 tan(y) and Dpsi'.
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
    """The same for two nodes and the point in their middle.

    With h = Dpsi/2 and d = l Dpsi'/4 the nodal half increments are h - d and h + d.
    """
    d = step.h * step.prime(step.Dpsi) / 4
    tan_h, tan_d = tan(step.Dpsi / 2), tan(d)
    # m 2d / sin(2d) cos(h - d) cos(h + d) + lever l/2 tan(h) tan(d)
    couple = m * _x_over_tan(d, tan_d) * (1 - (tan_h * tan_d) ** 2) / (1 + tan_h**2)
    couple += lever * (step.h / 2) * tan_h * tan_d
    return step.prime(step.virtual_psi) * couple - step.virtual_psi * lever


def _sine_quotient(x):
    """sin(x) / x by ten terms of its series: exact to round-off up to 1.5, to 5e-14 up to 2."""
    x2, series = x * x, 0.0
    for n in reversed(range(10)):
        series = series * x2 + (-1) ** n / math.factorial(2 * n + 1)
    return series


def _x_over_tan(x, tan_x):
    """x / tan(x), smooth at 0: below 0.02 a series, exact to round-off."""
    x2 = x**2
    series = 1 - x2 / 3 * (1 + x2 / 15 * (1 + x2 * 2 / 21))
    return ufl.conditional(ufl.lt(x2, 4e-4), series, x / tan_x)
