"""Steps by dolfinx and PETSc are those in C, for a few scenes; claims/test_dolfinx.py has all."""

import pytest
from dolfinx_steps import assert_same_steps
from registry import SCENES

import fx_beam as fb

#: Copies of degrees of freedom, maps of joints, loops, sliders, contact, sub-steps.
FEW = (
    "pinned beam",
    "revolute with spring and damper",
    "prismatic with laws",
    "closed loop",
    "slider on a beam",
    "member contact",
    "order four",
    "newmark",
)


@pytest.mark.parametrize("name", FEW)
def test_steps_by_dolfinx_are_those_in_c(name):
    assert_same_steps(SCENES[name], SCENES[name].scheme())


def test_a_scene_without_beams_has_no_mesh():
    fenicsx = pytest.importorskip("fx_beam.fenicsx")
    scene = fb.Scene()
    scene.add_body((0, 0), 1.0, 1.0)
    with pytest.raises(fb.SceneError, match="no beams, of which a mesh"):
        fenicsx.Problem(scene, dt=0.1)
