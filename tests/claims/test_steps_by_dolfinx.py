"""Steps by dolfinx and PETSc are those in C, for all scenes of the registry and three schemes."""

import pytest
from dolfinx_steps import assert_same_steps
from registry import ONES, SCENES

import fx_beam as fb

#: Scenes of bodies alone have no mesh.
WITH_BEAMS = [case for case in SCENES.values() if case.build(ONES).beams]
OTHERS = fb.ModifiedMidPoint, fb.Newmark


@pytest.mark.parametrize("case", WITH_BEAMS, ids=lambda case: case.name)
def test_steps_by_dolfinx_are_those_in_c(case):
    assert_same_steps(case, case.scheme())


@pytest.mark.parametrize("scheme", OTHERS, ids=lambda scheme: scheme.__name__)
@pytest.mark.parametrize("case", WITH_BEAMS, ids=lambda case: case.name)
def test_so_they_are_by_other_schemes(case, scheme):
    if case.scheme is not fb.EnergyMomentum:
        pytest.skip("a scene that is there for its own scheme")
    assert_same_steps(case, scheme())
