"""Steps by dolfinx are those in C, in a few scenes; claims/test_steps_by_dolfinx.py has all."""

import numpy as np
import pytest
import scipy.sparse
from dolfinx_steps import assert_same_steps
from registry import ONES, SCENES

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


def test_what_is_left_of_the_residual_is_the_force_of_supports():
    fenicsx = pytest.importorskip("fx_beam.fenicsx")
    case = SCENES["revolute with spring and damper"]
    problem = fenicsx.Problem(case.build(ONES), case.scheme(), dt=case.dt)
    solution = problem.run(case.dt)
    r = problem.system.residual
    size = abs(r).max()
    assert abs(problem.system.Tv.T @ r).max() < 1e-9 * size
    held = abs(solution.reactions[-1]).max(axis=1) > 1e-6 * size
    nodes = r.reshape(-1, 3)
    np.testing.assert_allclose(nodes[held], solution.reactions[-1][held], rtol=0, atol=1e-9 * size)


def test_degrees_of_freedom_of_the_space_have_rows_of_the_scene():
    fenicsx = pytest.importorskip("fx_beam.fenicsx")
    case = SCENES["order four"]
    problem = fenicsx.Problem(case.build(ONES), dt=case.dt)
    solution = problem.run(case.steps * case.dt)
    x = np.empty(problem.system.M.size[0])
    x[problem.system.dofs] = problem.q.x.array
    np.testing.assert_array_equal(x.reshape(solution.q[-1].shape), solution.q[-1])


@pytest.mark.parametrize("name", ["closed loop", "slider on a beam"])
def test_the_tangent_through_joints_is_the_derivative_of_the_residual(name):
    """Against differences of order four."""
    fenicsx = pytest.importorskip("fx_beam.fenicsx")
    case = SCENES[name]
    problem = fenicsx.Problem(case.build(ONES), case.scheme(), dt=case.dt)
    for _ in range(3):
        problem.advance()
    with problem.begin() as step:
        y, r = step.y, step.y.duplicate()
        indptr, indices, data = step.tangent(y).getValuesCSR()
        K = scipy.sparse.csr_matrix((data, indices, indptr)).toarray().copy()
        h, slopes = 1e-3, np.zeros(K.shape)
        for i in range(y.size):
            for place, weight in ((1, 8), (-1, -8), (2, -1), (-2, 1)):
                moved = y.copy()
                moved.array[i] += place * h
                step.residual(moved, r)
                slopes[:, i] += weight * r.array / (12 * h)
    np.testing.assert_allclose(K, slopes, rtol=0, atol=1e-11 * abs(K).max())
