"""The numbers of demos/relaxation.py."""

import pytest
from demo_runs import numbers
from scenes import demo

pytestmark = pytest.mark.slow


def test_relaxation_and_creep_converge_with_second_order():
    found = numbers("relaxation")
    assert len(found) == 4
    for run in found.values():
        assert run["errors"][-1] < 1e-4
        assert run["orders"][-1] == pytest.approx(2, abs=0.05)


def test_the_closed_solutions_satisfy_their_equations():
    # d/dt of M = EI kappa + EI_1 (kappa - a) with da/dt = (kappa - a) / tau.
    material, t, h = demo("relaxation"), 0.7, 1e-4
    EI, EI_1, tau, c = material.EI, material.EI_1, material.TAU, material.RATE

    def rate(function):
        return (function(t + h) - function(t - h)) / (2 * h)

    for kappa, M, kappa_t, M_t in (
        (c * t, material.moment(t), c, rate(material.moment)),
        (material.curvature(t), c * t, rate(material.curvature), c),
    ):
        assert tau * M_t + M == pytest.approx(EI * kappa + tau * (EI + EI_1) * kappa_t, rel=1e-7)
