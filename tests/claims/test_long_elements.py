"""Elements that are too long for what they do: a warning names the beam."""

import math

import pytest
from scenes import clamped_bar, one_bar

import fx_beam as fb

SECTION = fb.Section(EA=1e6, GA=1e6, EI=100.0, rhoA=1.0, rhoI=1e-3)


def rolled(elements, angle, degree=1):
    """The error of the tip of a strip of 4 m that a moment rolls up by an angle."""
    scene, strip = clamped_bar((4, 0), SECTION, elements, degree, name=f"{elements} {angle}")
    scene.add_moment(strip.end, 100.0 * angle / 4)
    radius = 4 / angle
    x, y = fb.static(scene).position(strip.end)[-1]
    return math.hypot(x - radius * math.sin(angle), y - radius * (1 - math.cos(angle))) / 4


def test_the_warning_names_the_error_of_an_arc(caplog):
    error = rolled(5, 3.0)
    (record,) = caplog.records
    assert "static: an element of beam '5 3.0' bends by 0.6 rad at load factor 1" in record.message
    assert "about 1.2 % of its length. The beam has 5 of degree 1" in record.message
    assert 0.006 < error < 0.024


@pytest.mark.parametrize(("elements", "degree"), [(8, 1), (2, 2)])
def test_enough_elements_are_not_warned_of(elements, degree, caplog):
    assert rolled(elements, 3.0, degree) < 0.01
    assert not caplog.records


def test_a_motion_is_looked_at_also_between_its_ends(caplog):
    """Two members: the bend is that of the second one, not what is between both."""
    scene, still = one_bar([(0, 1), (1, 1)], SECTION, elements=2, name="still")
    moved = scene.add_beam([(0, 0), (0, -1)], SECTION, elements=2, name="moved")
    for beam in (still, moved):
        scene.clamp(beam.start)
    scene.prescribe(moved.end, rotation=lambda t: 1.5 * math.sin(math.pi * t) ** 2)
    fb.simulate(scene, dt=0.02, t_end=1.0)
    (record,) = caplog.records
    assert "beam 'moved'" in record.message
