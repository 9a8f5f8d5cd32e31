"""Steady vibrations of scenes whose base shakes, against closed solutions and long motions."""

import numpy as np
import pytest
from scenes import guided_body, one_bar

import fx_beam as fb

F = np.array([0.0, 0.3, 0.7, 0.95, 2.0])


def oscillators(stiff, turned=0.0):
    """A body on a damped spring to the ground, with a slide in a direction of the plane."""
    scene, (k, c) = fb.Scene(), stiff
    body = scene.add_body((0, 0), mass=1.2, inertia=0.1)
    axis = np.cos(turned), np.sin(turned)
    laws = {"spring": fb.Spring(k), "damper": fb.Damper(c)}
    return scene, body.centre, scene.add_joint(fb.Prismatic(fb.GROUND, body.centre, axis, **laws))


@pytest.mark.parametrize("turned", [0.0, 0.6, 2.0])
def test_an_oscillator_has_the_transmissibility_of_its_closed_form(turned):
    k, c = 40.0, 1.5
    scene, node, slide = oscillators((k, c), turned)
    w, axis = 2 * np.pi * F, np.array([np.cos(turned), np.sin(turned)])
    base = np.array([0.3, 0.2 - 0.1j])
    absolute = fb.frequency_response(scene, at=node, frequencies=F, base=base).values
    along = base @ axis  # of the base; across the slide the body moves as the base does
    ratio = (k + 1j * w * c) / (k + 1j * w * c - w**2 * 1.2)
    exact = base + np.outer((ratio - 1) * along, axis)
    assert absolute[:, :2] == pytest.approx(exact, rel=1e-12)
    assert not absolute[:, 2].any()
    relative = fb.frequency_response(scene, at=slide, frequencies=F, base=base).values[:, 0]
    assert relative == pytest.approx((ratio - 1) * along, rel=1e-12, abs=1e-15)


@pytest.mark.parametrize("support", ["clamp", "prescribed", "joint", "two ends"])
def test_a_beam_on_a_shaken_base_has_the_motion_of_euler_and_bernoulli(support):
    # EI u'''' = rhoA w^2 u for the absolute motion, with u = 1 at the supports, complex EI.
    EI, rhoA, L, tau, f = 3.15, 0.162, 0.4, 2e-4, np.array([3.0, 10.0, 40.0])
    section = fb.Section(EA=4.2e6, GA=4.2e7, EI=EI, rhoA=rhoA, rhoI=1e-12, retardation=tau)
    scene, beam = one_bar((L, 0), section, elements=12, degree=3)
    if support == "clamp":
        scene.clamp(beam.start)
    elif support == "prescribed":
        scene.fix(beam.start, "x", "rotation")
        scene.prescribe(beam.start, y=lambda t: 0.01 * np.sin(t))
    elif support == "joint":
        scene.add_joint(fb.Rigid(fb.GROUND, beam.start))
    else:
        scene.clamp(beam.start)
        scene.fix(beam.end, "y")
    tip_mass = 0.05
    scene.add_mass(beam.end, tip_mass)
    response = fb.frequency_response(
        scene, at=beam.node(0.5), frequencies=f, base=(0.0, 1.0)
    ).component("y")
    for value, w in zip(response, 2 * np.pi * f, strict=True):
        stiff = EI * (1 + 1j * w * tau)
        b = (rhoA * w**2 / stiff) ** 0.25
        # u = sum of c_i exp(r_i b s), with r = 1, -1, i, -i.
        r = b * np.array([1, -1, 1j, -1j])
        end = np.exp(r * L)
        shear = stiff * r**3 * end + tip_mass * w**2 * end  # EI u''' = - m w^2 u at the end
        held = end if support == "two ends" else shear
        rows = np.array([r**0, r, r**2 * end, held])
        sides = [1.0, 0.0, 0.0, 1.0 if support == "two ends" else 0.0]
        exact = np.linalg.solve(rows, sides) @ np.exp(r * L / 2)
        assert abs(value / exact - 1) < 1e-4


def test_a_pendulum_with_drag_hangs_on_a_shaken_pivot():
    """Relative to the pivot m L^2 phi'' + c L^2 phi' + m g L phi = m w^2 b L: the air moves too."""
    g, L, m, c = 9.81, 0.7, 2.0, 0.4
    rod = fb.Section(EA=1e9, GA=1e9, EI=1e9, rhoA=0.0, rhoI=0.0)
    scene, beam = one_bar((0, -L), rod, elements=1, gravity=(0, -g))
    hinge = scene.add_joint(fb.Revolute(fb.GROUND, beam.start))
    scene.add_mass(beam.end, m)
    scene.add_drag(beam.end, linear=c)
    state = fb.static(scene)
    w = 2 * np.pi * F
    exact = w**2 * m * L / (m * g * L + 1j * w * c * L**2 - w**2 * m * L**2)
    response = fb.frequency_response(scene, at=hinge, frequencies=F, state=state, base=(1, 0))
    assert response.component("angle") == pytest.approx(exact, rel=1e-6)
    tip = fb.frequency_response(scene, at=beam.end, frequencies=F, state=state, base=(1, 0))
    assert tip.component("x") == pytest.approx(1 + L * exact, rel=1e-6)
    # Up and down nothing but the weight changes, to first order.
    up = fb.frequency_response(scene, at=beam.end, frequencies=F, state=state, base=(0, 1))
    assert up.values == pytest.approx(np.tile([0, 1, 0], (len(F), 1)), abs=1e-6)


def test_what_floats_stays_where_it_is():
    section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=1e-3)
    scene, beam = one_bar((1, 0.3), section, elements=4)
    response = fb.frequency_response(scene, at=beam.end, frequencies=[0.1, 5.0], base=(1, 0.5))
    assert abs(response.values).max() < 1e-9


def test_what_is_no_base_motion_is_refused():
    scene, node, _ = oscillators((40.0, 1.5))
    for words, bad_call in (
        ("either a load", {}),
        ("either a load", {"load": (node, (1.0, 0.0)), "base": (1, 0)}),
        (r"base = \(0, 0\) must be the amplitudes", {"base": (0, 0)}),
        (r"base = 1.0 must be the amplitudes", {"base": 1.0}),
        (r"must be the amplitudes \(x, y\)", {"base": (1, 0, 0)}),
        (r"must be the amplitudes \(x, y\)", {"base": (np.nan, 0)}),
        ("at=beam.end", {"base": (1, 0), "at": None}),
        ("list of numbers", {"base": (1, 0), "frequencies": ()}),
    ):
        with pytest.raises(fb.SceneError, match=words):
            fb.frequency_response(scene, **({"at": node, "frequencies": [1.0]} | bad_call))
    turning, body, _ = guided_body((1, 0), 1.0, 1.0, spring=fb.Spring(100.0))
    state = fb.static(turning, spin=2.0)
    with pytest.raises(fb.SceneError, match="the state turns"):
        fb.frequency_response(turning, at=body, frequencies=[1.0], state=state, base=(1, 0))
