"""Steps by dolfinx and PETSc are those in C: the scenes of the registry that the core leaves out.

Those by EnergyMomentum have the steps of one of two other schemes as well, in turn.
"""

import pytest
from dolfinx_steps import assert_same_steps
from registry import ONES, SCENES
from test_dolfinx import FEW

import fx_beam as fb

#: Scenes of bodies alone have no mesh.
WITH_BEAMS = [case for case in SCENES.values() if case.build(ONES).beams]
REST = [case for case in WITH_BEAMS if case.name not in FEW]
PLAIN = [case for case in WITH_BEAMS if case.scheme is fb.EnergyMomentum]


@pytest.mark.parametrize("case", REST, ids=lambda case: case.name)
def test_steps_by_dolfinx_are_those_in_c(case):
    assert_same_steps(case, case.scheme())


@pytest.mark.parametrize("case", PLAIN, ids=lambda case: case.name)
def test_so_they_are_by_other_schemes(case):
    scheme = (fb.ModifiedMidPoint, fb.Newmark)[PLAIN.index(case) % 2]
    assert_same_steps(case, scheme())
