"""Elements too coarse for a stepped section, or for layers, are told of; what is told helps."""

import re

import numpy as np
import pytest

import fx_beam as fb

JUMPS, LAYERS = "jumps inside an element", "two layers bend as one"
STIFF = {"EA": 1e9, "GA": 1e9}


def tip(elements, degree, jump, parts=False):
    """Tip deflection of a cantilever with EI = 100 up to a jump, 20 behind, relative to exact."""
    scene = fb.Scene()
    if parts:
        thick, thin = (fb.Section(**STIFF, EI=EI) for EI in (100.0, 20.0))
        first = scene.add_beam([(0, 0), (jump, 0)], thick, elements, degree)
        last = scene.add_beam([first.end, (1, 0)], thin, elements, degree)
    else:
        section = fb.Section(**STIFF, EI=lambda f: 100.0 if f < jump else 20.0)
        first = last = scene.add_beam([(0, 0), (1, 0)], section, elements, degree)
    scene.clamp(first.start)
    scene.add_force(last.end, (0, -1.0))
    exact = (1 - (1 - jump) ** 3) / 300 + (1 - jump) ** 3 / 60
    return -fb.static(scene, linear=True).displacement(last.end)[-1, 1] / exact


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("jump", [0.35, 0.61, 0.999])
def test_a_stiffness_that_jumps_inside_an_element_is_told(jump, degree, caplog):
    tip(None, degree, jump)
    (told,) = re.findall(r"EI jumps inside an element, near the fraction (\S+) of", caplog.text)
    assert float(told) == pytest.approx(jump, abs=1e-3)


@pytest.mark.parametrize("light", [0.0, 1.0])
def test_a_mass_that_jumps_inside_an_element_is_told(light, caplog):
    """A mass on the last 3 % of a cantilever: with two elements frequencies are 80 % off."""
    scene = fb.Scene()
    section = fb.Section(**STIFF, EI=10.0, rhoA=lambda f: light if f < 0.97 else 20.0)
    scene.add_beam([(0, 0), (1, 0)], section, elements=2, degree=3)
    (told,) = re.findall(r"rhoA jumps inside an element, near the fraction (\S+) of", caplog.text)
    assert float(told) == pytest.approx(0.97, abs=1e-3)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_new_beam_or_elements_that_end_at_the_jump_are_right(degree, caplog):
    assert tip(None, degree, 0.35, parts=True) == pytest.approx(1, abs=0.01)
    assert tip(20, degree, 0.35) == pytest.approx(1, abs=0.01)
    assert JUMPS not in caplog.text


@pytest.mark.parametrize(
    "EI", [lambda f: 100 - 80 * f, lambda f: 100 * (1 - 0.999 * f) ** 3, lambda f: 50.0]
)
@pytest.mark.parametrize("elements", [1, 2, 16])
def test_tapered_beams_are_not_told_of(EI, elements, caplog):
    fb.Scene().add_beam([(0, 0), (1, 0)], fb.Section(**STIFF, EI=EI), elements)
    assert not caplog.text


@pytest.mark.parametrize("elements", [None, 16])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_two_layers_bend_as_one_within_one_per_cent_or_are_told_of(degree, elements, caplog):
    thin, thick, whole = (fb.Section.rectangle(h, 0.02, 70e9, 0.3) for h in (0.01, 0.02, 0.03))
    scene = fb.Scene()
    plate = scene.add_beam([(0, 0), (1, 0)], thin, elements, degree)
    scene.add_beam(plate.nodes, thick, degree=degree, offset=-0.015)
    scene.clamp(plate.start)
    scene.add_force(plate.end, (0, -10.0))
    sunk = -fb.static(scene, linear=True).displacement(plate.end)[-1, 1]
    right = sunk == pytest.approx(10 / (3 * whole.EI), rel=0.01)
    assert right == (LAYERS not in caplog.text)


def test_members_of_a_mesh_are_told_of_too(caplog):
    section = fb.Section(**STIFF, EI=lambda f: 100.0 if f < 0.35 else 20.0)
    fb.Scene().add_mesh([(0, 0), (1, 0), (2, 1)], [(0, 1), (1, 2)], section, elements=2)
    assert caplog.text.count(JUMPS) == 2


def test_a_response_looks_for_jumps_at_each_x_by_few_calls_of_a_function(caplog):
    calls = []

    def build(x):
        def EI(f):
            calls.append(f)
            return np.interp(f, [0.0, 0.36, 0.36 + 1e-9, 1.0], [100.0, 100.0, x[0], x[0]])

        scene = fb.Scene()
        beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(**STIFF, EI=EI), elements=40)
        scene.clamp(beam.start)
        scene.add_force(beam.end, (0, -1.0))
        return scene, {"tip": fb.Output("position", beam.end)}

    run = fb.StaticResponse(build)
    run([100.0])
    assert len(calls) > 200  # all places, to learn that the function takes arrays
    run.jacobian()
    calls.clear()
    run([101.0])
    assert len(calls) < 20
    assert JUMPS not in caplog.text
    run([20.0])
    assert JUMPS in caplog.text
