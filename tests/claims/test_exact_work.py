"""`EnergyMomentum`: the work of a step is the increment of the stored energy, for every degree."""

import ufl

import pytest
from scenes import FLYING, free_flight, one_bar, pinned_beam, relative_drift

import fx_beam as fb


def stiffening(eps, gamma, kappa):
    """A stored energy that is not quadratic, of the size of the flying beam's."""
    return 5e3 * (eps**2 + gamma**2) + 1e5 * eps**4 + 50 * kappa**2 + 10 * ufl.sin(kappa) ** 4


def whirling_arc(degree, section):
    """A free arc of two elements that turns by up to 1.2 rad a step."""
    scene, arc = one_bar(fb.arc((0, 0), (2, 1), (4, 0)), section, elements=2, degree=degree)
    scene.set_velocity(arc, lambda x, y: (-8 * y, 8 * (x - 2) + 3 * y**2), spin=8.0)
    return scene


STIFFENING = fb.Section(strain_energy=stiffening, rhoA=1.0, rhoI=10.0)
COARSE = {
    "pinned, degree 3": (lambda: pinned_beam(1, degree=3)[0], 0.02, 8.0),
    "pinned, degree 2": (lambda: pinned_beam(2, degree=2)[0], 0.01, 4.0),
    "free, degree 3": (lambda: free_flight(5, degree=3)[0], 0.1, 10.0),
    "arc, degree 1": (lambda: whirling_arc(1, FLYING), 0.15, 3.0),
    "arc, degree 3": (lambda: whirling_arc(3, FLYING), 0.15, 3.0),
    "stiffening arc, degree 2": (lambda: whirling_arc(2, STIFFENING), 0.15, 3.0),
}


@pytest.mark.parametrize("name", COARSE)
def test_the_work_of_large_steps_on_coarse_meshes_is_the_energy_gained(name):
    # Steps were halved when N, Q and m were changed to make the work exact.
    scene, dt, t_end = COARSE[name]
    solution = fb.simulate(scene(), dt=dt, t_end=t_end, max_halvings=0)
    scale = solution.energy.total.max()
    assert solution.energy.strain.max() > 1e-6 * scale
    assert abs(solution.energy.balance_error).max() < 1e-11 * scale
    late = solution.t > 2.5 + 1e-6 if "free" in name else slice(None)
    assert relative_drift(solution.angular_momentum[late]) < 1e-11
