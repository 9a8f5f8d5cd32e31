"""Influence lines: against statics of one force after the other, and closed forms."""

import numpy as np
import pytest
from scenes import assert_refused

import fx_beam as fb

STIFF = fb.Section(EA=1e9, GA=1e9, EI=1e4)


def bridge(degree, elements=20, section=STIFF):
    """Two spans of 4 m."""
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), (8, 0)], section, elements=elements, degree=degree)
    scene.pin(beam.start)
    for node in (beam.node(0.5), beam.end):
        scene.fix(node, "y")
    return scene, beam


@pytest.mark.parametrize(("degree", "most"), [(1, 5e-3), (2, 1e-5), (3, 1e-5)])
def test_two_equal_spans_have_the_ordinates_of_tables(degree, most):
    """Anger's: a force in the tenths of the first span, the moment over the support over L."""
    scene, beam = bridge(degree)
    places = 0.4 * np.arange(1, 10)
    outputs = {"M": fb.Output("M", beam.at(4.0)), "middle": fb.Output("M", beam.at(2.0))}
    outputs |= {
        name: fb.Output("reaction", node, "y")
        for name, node in (("A", beam.start), ("B", beam.node(0.5)), ("C", beam.end))
    }
    lines = fb.influence(scene, outputs, beam, s=places)
    of_support = [0.0248, 0.0480, 0.0683, 0.0840, 0.0938, 0.0960, 0.0893, 0.0720, 0.0428]
    assert isinstance(lines, fb.InfluenceLines) and lines.s is not None
    assert abs(lines.values["M"]) / 4 == pytest.approx(of_support, abs=6e-5 + most)
    x = np.arange(1, 10) / 10
    support = (x - x**3) / 4
    assert lines.values["A"] == pytest.approx(1 - x - support, abs=most)
    assert lines.values["B"] == pytest.approx(x + 2 * support, abs=most)
    assert lines.values["C"] == pytest.approx(-support, abs=most)
    middle = np.minimum(x, 1 - x) / 2 - support / 2
    assert abs(lines.values["middle"]) == pytest.approx(4 * middle, abs=4 * most)


def test_a_clamped_beam_that_shears_has_its_closed_form():
    """M_A = a b (b + L phi / 2) / (L^2 (1 + phi)), phi = 12 EI / (GA L^2)."""
    EI, GA, L = 2.0, 1.5, 3.0
    scene = fb.Scene()
    section = fb.Section(EA=1e9, GA=GA, EI=EI)
    beam = scene.add_beam([(0, 0), (L, 0)], section, elements=6, degree=3)
    scene.clamp(beam.start)
    scene.clamp(beam.end)
    lines = fb.influence(scene, {"M": fb.Output("reaction", beam.start, "moment")}, beam)
    a, phi = lines.s, 12 * EI / (GA * L**2)
    expected = a * (L - a) * (L - a + L * phi / 2) / (L**2 * (1 + phi))
    assert lines.values["M"] == pytest.approx(expected, abs=1e-5)


def test_the_thrust_of_a_portal_with_hinged_feet_is_that_of_kleinlogel():
    """H = 3 a b / (2 h L (2 k + 3)), k = (J_girder / J_column) h / L."""
    h, L, column, girder = 3.0, 5.0, 2e4, 6e4
    scene = fb.Scene()
    sections = [fb.Section(EA=1e11, GA=1e11, EI=EI) for EI in (column, girder)]
    left = scene.add_beam([(0, 0), (0, h)], sections[0], elements=4, degree=3)
    over = scene.add_beam([left.end, (L, h)], sections[1], elements=4, degree=3)
    right = scene.add_beam([over.end, (L, 0)], sections[0], elements=4, degree=3)
    scene.pin(left.start)
    scene.pin(right.end)
    lines = fb.influence(scene, {"H": fb.Output("reaction", left.start, "x")}, over)
    k = girder / column * h / L
    expected = 3 * lines.s * (L - lines.s) / (2 * h * L * (2 * k + 3))
    assert lines.values["H"] == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_beam_with_a_hinge_has_the_lines_of_its_mechanism(degree):
    """A cantilever of 2 m with a beam of 3 m hinged to it, over both."""
    scene = fb.Scene()
    arm = scene.add_beam([(0, 0), (2, 0)], STIFF, elements=3, degree=degree)
    span = scene.add_beam([(2, 0), (5, 0)], STIFF, elements=4, degree=degree)
    scene.clamp(arm.start)
    hinge = scene.add_joint(fb.Revolute(arm.end, span.start))
    scene.fix(span.end, "y")
    outputs = {"clamp": fb.Output("reaction", arm.start, "moment")}
    outputs["hinge"] = fb.Output("force", hinge, "y")
    outputs["M"], outputs["Q"] = (fb.Output(q, span.at(1.3)) for q in "MQ")
    s = np.array([0.0, 0.7, 2.0, 2.9, 3.25, 3.35, 4.4, 5.0])
    lines = fb.influence(scene, outputs, [arm, span], s=s)
    there = np.clip((5 - s) / 3, 0, 1) * (s > 2) + (s <= 2)
    assert abs(lines.values["clamp"]) == pytest.approx(np.where(s <= 2, s, 2 * there), abs=1e-7)
    assert abs(lines.values["hinge"][3:]) == pytest.approx(there[3:], abs=1e-7)
    x = np.clip(s - 2, 0, None)
    M = np.where(x < 1.3, x * (3 - 1.3) / 3, 1.3 * (3 - x) / 3)
    assert abs(lines.values["M"]) == pytest.approx(M, abs=1e-7)
    Q = np.where(x < 1.3, x / 3, (3 - x) / 3)
    assert abs(lines.values["Q"]) == pytest.approx(Q, abs=1e-7)


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_lines_are_statics_of_one_force_after_the_other(degree):
    """By reciprocity, inside elements too, in a braced frame whose ropes are pulled tight."""

    def frame():
        scene = fb.Scene(gravity=(0, -9.81))
        section = fb.Section.rectangle(0.2, 0.1, E=1e8, nu=0.3, rho=1e3)
        curve = fb.arc((0, 2), (1.5, 2.6), (3, 2)) if degree > 1 else [(0, 2), (3, 2.4)]
        roof = scene.add_beam(curve, section, elements=3, degree=degree)
        post = scene.add_beam([roof.end, (3, 0)], section, elements=2, degree=degree)
        scene.pin(roof.start)
        hinge = scene.add_joint(fb.Revolute(fb.GROUND, post.end, spring=fb.Spring(200.0)))
        rope = scene.add_rope([(0, 0), roof.end], spring=fb.Spring(5e3), pretension=80.0)
        outputs = {f"{q} at {s}": fb.Output(q, roof.at(s)) for q in "NQM" for s in (0.4, 1.31)}
        outputs |= {"u": fb.Output("displacement", roof.at(1.31)), "rope": fb.Output("force", rope)}
        outputs |= {"R": fb.Output("reaction", roof.start), "turn": fb.Output("angle", hinge)}
        outputs |= {"hinge": fb.Output("force", hinge), "M": fb.Output("M", post.at(0.0))}
        outputs["stress"] = fb.Output("stress", roof.at(1.31), edge="lower")
        return scene, roof, outputs

    scene, roof, outputs = frame()
    s = np.array([0.0, 0.2, 0.39, 0.41, 1.1, 1.3, 1.32, 2.6])
    lines = fb.influence(scene, outputs, [roof], direction=(1, -2), s=s)
    largest = {name: abs(values).max() for name, values in lines.values.items()}
    for k, place in enumerate(s):
        scene, roof, outputs = frame()
        scene.gravity = (0, 0)
        scene.add_force(roof.at(place), np.array([1, -2]) / np.sqrt(5))
        linear = fb.static(scene, linear=True)
        for name, output in outputs.items():
            before, after = linear.value(output)
            allowed = 1e-7 * largest[name]
            assert lines.values[name][k] == pytest.approx(after - before, abs=allowed), name


def test_what_has_no_influence_lines_is_refused():
    scene, beam = bridge(1)
    outputs = {"M": fb.Output("M", beam.at(1.0))}
    assert_refused("along.*one or more beams", fb.influence, scene, outputs, "beam 1")
    assert_refused("along.*one or more beams", fb.influence, scene, outputs, bridge(1)[1])
    assert_refused("direction", fb.influence, scene, outputs, beam, (0, 0))
    assert_refused("arc lengths from 0", fb.influence, scene, outputs, beam, s=[9.0])
    outputs = {"v": fb.Output("velocity", beam.end)}
    assert_refused("no rate and no energy", fb.influence, scene, outputs, beam)
    scene.prescribe(beam.node(0.25), x=0.01)
    outputs = {"M": fb.Output("M", beam.at(1.0))}
    assert_refused("without loads the scene does not rest", fb.influence, scene, outputs, beam)
