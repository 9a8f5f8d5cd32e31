"""What must not change when a scene is turned, moved, mirrored or divided."""

import ufl

import numpy as np
import pytest
from jointed import rotation
from scenes import FLYING, PINNED, free_flight, one_bar, pinned_bar, pinned_beam

import fx_beam as fb

SCHEMES = [(fb.EnergyMomentum(), 2), *((s(), 1) for s in (fb.ModifiedMidPoint, fb.HHT))]


def quartic(eps, gamma, kappa):
    """A stored energy that is not quadratic, about as stiff as the flying beam's."""
    return 5e3 * (eps**2 + gamma**2) + 50 * kappa**2 * ufl.sqrt(1 + kappa**2)


@pytest.mark.parametrize(("scheme", "degree"), SCHEMES, ids=["2", "published", "HHT"])
def test_turning_and_moving_the_scene_turns_and_moves_the_motion(scheme, degree):
    turn, shift = 2.1, np.array([3.0, -5.0])
    motions = []
    for angle, offset in ((0.0, (0.0, 0.0)), (turn, shift)):
        scene, beam = free_flight(degree=degree, turn=angle, shift=offset)
        solution = fb.simulate(scene, scheme, dt=0.05, t_end=4.0)
        motions.append((solution.shape(beam), solution.q[..., 2], solution.energy.total))
    (x, psi, energy), (turned_x, turned_psi, turned_energy) = motions
    assert abs(turned_x - (x @ rotation(turn).T + shift)).max() < 1e-9 * 10
    assert abs(turned_psi - psi).max() < 1e-9
    assert turned_energy == pytest.approx(energy, rel=1e-9)


def test_turning_does_not_change_which_of_equal_pieces_has_more_elements():
    corners, half = np.array([(0, 0), (1, 0.3), (2, 0)]), np.hypot(1, 0.3) / 2
    for angle in np.linspace(0, 6, 50):
        beam = fb.Scene().add_beam(corners @ rotation(angle).T, FLYING, elements=3)
        assert beam.s == pytest.approx([0, half, 2 * half, 4 * half])


def test_a_beam_in_several_members_moves_as_the_whole():
    whole, beam = pinned_beam(8)
    parts, first = pinned_bar((25, 0), PINNED, elements=2)
    # The middle is given backwards and last, so that neither order nor direction can matter.
    last = parts.add_beam([(75, 0), (100, 0)], PINNED, elements=2)
    middle = parts.add_beam([last.start, first.end], PINNED, elements=4)
    for member in (first, middle, last):
        parts.set_velocity(
            member, lambda x, y: (0, 12 * min(x, 100 - x)), spin=lambda x, y: 12 * np.sign(50 - x)
        )
    solution = fb.simulate(whole, dt=0.01, t_end=1.0)
    several = fb.simulate(parts, dt=0.01, t_end=1.0)
    assert abs(several.position(last.end) - solution.position(beam.end)).max() < 1e-9 * 100
    assert abs(several.position(middle.node(0.5)) - solution.position(beam.node(0.5))).max() < 1e-7
    assert several.energy.strain == pytest.approx(solution.energy.strain, rel=1e-9, abs=1e-6)
    # The reversed member's forces are those of the whole, in its own order.
    N = solution.resultants(beam).N[:, 2:6]
    assert several.resultants(middle).N[:, ::-1] == pytest.approx(N, rel=1e-8, abs=1e-5)


@pytest.mark.parametrize(
    ("degree", "section"),
    [(1, FLYING), (2, FLYING), (1, fb.Section(strain_energy=quartic, rhoA=1.0))],
)
def test_a_rigid_motion_strains_nothing(degree, section):
    scene, beam = one_bar([(0, 0), (1, 2), (3, 1)], section, elements=3, degree=degree)
    scene.prescribe(beam.start, x=lambda t: 5 * t, y=lambda t: -2 * t, rotation=lambda t: 0.9 * t)
    moved = fb.static(scene, load_steps=2, t=1.0)
    expected = rotation(0.9) @ (3, 1) + (5, -2)
    assert moved.position(beam.end)[-1] == pytest.approx(expected, abs=1e-12)
    EA, length = 1e4, 2 * 5**0.5
    # Strains of no more than some units in the last place of the displacement, 5.
    assert moved.energy.strain.max() < EA * length * (1e-14) ** 2
