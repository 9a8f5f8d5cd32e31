"""Slack cables: beams of so little bending stiffness that their loads alone give them a shape."""

import numpy as np
import pytest
import scipy.optimize
from scenes import assert_refused, pinned_bar, supported_bar

import fx_beam as fb

G = 10.0


def catenary(length, across, up):
    """Horizontal force, and that up at the higher end, of an inextensible cable per weight."""
    chord = np.sqrt(length**2 - up**2)
    a = scipy.optimize.brentq(
        lambda a: 2 * a * np.sinh(across / 2 / a) - chord, across / 500, 1e3 * length
    )
    return a, length / 2 + up / 2 / np.tanh(across / 2 / a)


SAG = np.sqrt(6.0**2 - 5.0**2)
SHAPES = {
    "V": [(0, 0), (5, -SAG), (10, 0)],
    "arc": fb.arc((0, 0), (5, -2.8205), (10, 0)),
    "straight": [(0, 0), (12, 0)],
}


def hung(shape, section, load_steps, **options):
    """A cable of 12 m and 12 kg between two points 10 m apart; the straight one is led there."""
    scene = fb.Scene(gravity=(0, -G))
    cable = scene.add_beam(SHAPES[shape], section, elements=24)
    scene.pin(cable.start)
    scene.fix(cable.end, "y")
    back = 2.0 if shape == "straight" else 0.0
    scene.prescribe(cable.end, x=lambda t: -back * t)
    path = fb.static(scene, load_steps, t=1.0, **options)
    assert path.load_factor[-1] == 1 and not path.unstable_modes[-1]
    return path.reaction(cable.end)[-1, :2]


@pytest.mark.parametrize("load_steps", [1, 3, 10, 50, 200])
@pytest.mark.parametrize("EI", [1e-12, 1e-10, 1e-7, 1e-4, 1e-2])
@pytest.mark.parametrize("shape", SHAPES)
def test_a_slack_cable_hangs_as_a_catenary(shape, EI, load_steps):
    section = fb.Section(EA=1e6, GA=5e5, EI=EI, rhoA=1.0)
    a, up = catenary(12.0, 10.0, 0.0)
    assert hung(shape, section, load_steps) == pytest.approx([G * a, G * up], rel=2e-3)


@pytest.mark.parametrize("shape", ["V", "arc"])
def test_a_slack_cable_hangs_as_a_catenary_along_an_arc_length(shape):
    section = fb.Section(EA=1e6, GA=5e5, EI=1e-4, rhoA=1.0)
    a, up = catenary(12.0, 10.0, 0.0)
    computed = hung(shape, section, 10, continuation="arc-length")
    assert computed == pytest.approx([G * a, G * up], rel=2e-3)


@pytest.mark.parametrize("load_steps", [1, 10])
def test_a_stiff_one_is_a_frame(load_steps):
    """By forces: H = int M0 y / int y^2, with M0 of the weight on a beam that is free to slide."""
    stiff = fb.Section(EA=1e10, GA=1e10, EI=1e7, rhoA=1.0)
    H = 12 * (10 * 5**3 / 3 - 5**4 / 4) / 10 / (5 / 3) / SAG
    assert hung("V", stiff, load_steps) == pytest.approx([H, 60], rel=5e-3)


@pytest.mark.parametrize("load_steps", [1, 10, 100])
@pytest.mark.parametrize("EI", [1e-10, 1e-4, 1e-1, 1e4, 1e7])
@pytest.mark.parametrize("middle", [(431.075581, -198.60465), (431.08, -198.6)])
def test_a_mooring_line_of_a_kilometre_hangs_as_a_catenary(middle, EI, load_steps):
    section = fb.Section(EA=64e9, GA=64e9, EI=EI, rhoA=200.0)
    scene, line = supported_bar(
        fb.arc((0, 0), middle, (800, 100)), section, elements=50, gravity=(0, -9.81), held="xy"
    )
    path = fb.static(scene, load_steps)
    a, up = catenary(1000.0, 800.0, 100.0)
    weight = 200 * 9.81
    assert path.reaction(line.end)[-1, :2] == pytest.approx([weight * a, weight * up], rel=5e-4)
    assert not path.unstable_modes[-1]


@pytest.mark.parametrize("load_steps", [1, 5, 50])
@pytest.mark.parametrize("EI", [1e-2, 1e2, 1e4])
def test_a_line_that_is_led_to_its_end_touches_down_on_a_bed(EI, load_steps):
    """A cable in the depth h has the length sqrt(h^2 + 2 a h) and spans a acosh(1 + h / a)."""
    length, across, depth, weight = 340.0, 300.0, 100.0, 1000.0
    section = fb.Section(EA=1e9, GA=1e9, EI=EI, rhoA=weight / G)
    scene, line = pinned_bar((length, 0), section, elements=80, gravity=(0, -G))
    scene.prescribe(line.end, x=lambda t: (across - length) * t, y=lambda t: depth * t)
    scene.add_contact(line, fb.Line((0, 0), (0, 1)), stiffness=1e4)
    path = fb.static(scene, load_steps, t=1.0)

    def too_long(a):
        return length - np.sqrt(depth**2 + 2 * a * depth) + a * np.arccosh(1 + depth / a) - across

    a = scipy.optimize.brentq(too_long, 1.0, 1e3)
    exact = weight * np.array([a, np.sqrt(depth**2 + 2 * a * depth)])
    assert path.reaction(line.end)[-1, :2] == pytest.approx(exact, rel=4e-3)
    assert not path.unstable_modes[-1]


@pytest.mark.parametrize("load_steps", [1, 20])
def test_an_arch_that_buckles_under_its_weight_does_not_fall_silently(load_steps):
    section = fb.Section(EA=1e6, GA=5e5, EI=100.0, rhoA=1.0)
    scene, arch = supported_bar(
        fb.arc((0, 0), (5, 2.8), (10, 0)), section, elements=24, gravity=(0, -G), held="xy"
    )
    assert_refused("failed after 8 cuts", fb.static, scene, load_steps, error=fb.StepError)
