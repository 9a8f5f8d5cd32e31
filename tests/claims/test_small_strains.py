"""Strains far below the rounding error of 1, in beams of any direction."""

import numpy as np
import pytest
from scenes import clamped_bar

import fx_beam as fb

LENGTH, SECTION = 0.7, fb.Section(EA=7e11, GA=1e11, EI=1e10, rhoA=1e-5, rhoI=2e-7)
DIRECTIONS = (0.3, 1.0, 2.5)
# Strains are about 1e-20, 1e-13 and 1e-10.
FORCES = (1e-9, 0.01, 10.0)


def cantilever(angle):
    """A scene with a clamped beam, the beam, and its axis and the direction across it."""
    along = np.array([np.cos(angle), np.sin(angle)])
    scene, beam = clamped_bar(LENGTH * along, SECTION, elements=2, degree=2)
    return scene, beam, along, np.array([-along[1], along[0]])


@pytest.mark.parametrize("angle", DIRECTIONS)
@pytest.mark.parametrize("force", FORCES)
def test_deflection_of_a_stiff_beam_has_all_digits(angle, force):
    """The tip moves by F L / EA along the beam, and by F L / GA + F L^3 / (3 EI) across it."""
    scene, beam, along, across = cantilever(angle)
    scene.add_force(beam.end, force * (along + across))
    moved = fb.static(scene, load_steps=4).displacement(beam.end)[-1]
    stretched = force * LENGTH / SECTION.EA
    bent = force * LENGTH / SECTION.GA + force * LENGTH**3 / (3 * SECTION.EI)
    assert moved @ along == pytest.approx(stretched, rel=1e-10)
    assert moved @ across == pytest.approx(bent, rel=1e-10)


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.MidPoint(), fb.Newmark()])
@pytest.mark.parametrize("force", FORCES)
def test_small_vibration_does_not_depend_on_the_direction(force, scheme):
    """A cantilever that a tiny weight bends vibrates in the same way in any direction."""
    motions = []
    for angle in DIRECTIONS:
        scene, beam, along, across = cantilever(angle)
        scene.add_force(beam.end, force * (along + 0.3 * across))
        moved = fb.simulate(scene, scheme, dt=1e-3, t_end=0.02).displacement(beam.end)
        motions.append(moved @ np.column_stack([along, across]))
    size = abs(motions[0]).max()
    assert force * LENGTH / SECTION.EA < size < force * LENGTH**3 / SECTION.EI
    for other in motions[1:]:
        assert abs(other - motions[0]).max() < 1e-10 * size
