"""Steps by dolfinx and PETSc held against those in C.

They share the weak form in UFL, masses, points and joints, but no assembly of beams, solver or
Newton's method.
"""

import numpy as np
import pytest
from registry import ONES

import fx_beam as fb

#: Relative differences; friction that follows a force is a fixed point, which ends earlier.
EXACT, FIXED_POINT = 1e-11, 1e-9


def assert_same_steps(case, scheme):
    """Positions, rates, forces of joints and supports, and energies of a case of the registry."""
    fenicsx = pytest.importorskip("fx_beam.fenicsx")
    t_end = case.steps * case.dt
    problem = fenicsx.Problem(case.build(ONES), scheme, dt=case.dt)
    here = problem.run(t_end)
    engine = fb.simulate(case.build(ONES), scheme, dt=case.dt, t_end=t_end, max_halvings=0)
    digits = FIXED_POINT if "friction that follows" in case.name else EXACT
    moved = abs(engine.q - engine.q[0]).max()
    np.testing.assert_allclose(here.q, engine.q, rtol=0, atol=digits * moved)
    for name in ("v", "slides", "joint_forces", "reactions", "motor_forces", "contact_forces"):
        values = getattr(engine, name)
        # Forces and fitted rates follow from configurations by differences, over dt and dt^2.
        size = 10 * digits * max(abs(values).max(initial=0.0), 1e-3)
        np.testing.assert_allclose(getattr(here, name), values, rtol=0, atol=size, err_msg=name)
    energy, size = engine.energy, max(engine.energy.kinetic.max(), engine.energy.strain.max())
    ours = problem.energies()
    for name in ("strain", "potential", "springs"):
        value = getattr(energy, name)[-1]
        assert ours[name] == pytest.approx(value, rel=0, abs=digits * size), name
    for name in ("work", "dissipated"):
        values = getattr(energy, name)
        np.testing.assert_allclose(getattr(here.energy, name), values, rtol=0, atol=digits * size)
    balance = abs(energy.balance_error).max()
    assert abs(here.energy.balance_error).max() <= balance + 1e-12 * size
