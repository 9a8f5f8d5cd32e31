"""Loads at places inside elements, on parts of beams and by projected length, against statics."""

import numpy as np
import pytest
from scenes import clamped_bar, supported_bar

import fx_beam as fb

SECTION = fb.Section(EA=1e6, GA=1e6, EI=1e4, rhoA=2.0, rhoI=1e-3)
every_degree = pytest.mark.parametrize("degree", [1, 2, 3])


def beam_on_two_supports(points=((0, 0), (3, 0)), elements=4, degree=1):
    scene, beam = supported_bar(points, SECTION, elements=elements, degree=degree)
    return scene, beam


def reactions(scene, beam):
    rest = fb.static(scene, linear=True)
    return [rest.reaction(node)[-1, :2] for node in (beam.start, beam.end)]


@every_degree
def test_a_force_and_a_moment_inside_elements_have_the_reactions_of_their_places(degree):
    scene, beam = beam_on_two_supports(degree=degree)
    scene.add_force(beam.at(0.8), (5.0, -60.0))
    scene.add_moment(beam.at(1.1), 9.0)
    left, right = reactions(scene, beam)
    assert left == pytest.approx([-5, 60 * 2.2 / 3 + 3])
    assert right == pytest.approx([0, 60 * 0.8 / 3 - 3])


def test_a_place_at_a_node_is_the_node():
    displacements = []
    for inside in (False, True):
        scene, beam = beam_on_two_supports()
        scene.add_force(beam.at(1.5) if inside else beam.node(0.5), (0.0, -60.0))
        displacements.append(fb.static(scene, linear=True).displacement(beam.node(0.25))[-1])
    assert displacements[0] == pytest.approx(displacements[1], rel=1e-12)


def test_a_force_inside_a_curved_element_bends_it_as_the_theory_of_the_arc_says():
    """Of a quarter circle, clamped below, with a vertical force at 60 degrees."""
    r, angle, P = 1.0, np.pi / 3, 1e-2
    ends = (r, 0), (r / np.sqrt(2), r / np.sqrt(2)), (0, r)
    scene, beam = clamped_bar(fb.arc(*ends), SECTION, elements=7, degree=3)
    place = beam.at(r * angle)
    scene.add_force(place, (0.0, -P))
    turned = fb.static(scene, linear=True).rotation(beam.end)[-1]
    # M(a) = P r (cos(a) - cos(angle)), integrated up to the force.
    expected = P * r**2 * (np.sin(angle) - angle * np.cos(angle)) / 1e4
    assert turned == pytest.approx(expected, rel=1e-4)


@every_degree
@pytest.mark.parametrize("part", [(0.0, 1.0), (0.5, 2.2), (1.3, 1.3001), (0.0, 3.0)])
@pytest.mark.parametrize("in_time", [False, True], ids=["constant", "of time"])
def test_a_load_on_a_part_has_its_sum_and_its_centre(degree, part, in_time):
    scene, beam = beam_on_two_supports(degree=degree)
    load = (lambda t: (0, -60)) if in_time else (0, -60)
    scene.add_line_load(beam, load, between=part)
    left, right = reactions(scene, beam)
    total, centre = 60 * (part[1] - part[0]), sum(part) / 2
    assert left[1] + right[1] == pytest.approx(total, rel=1e-10)
    assert right[1] == pytest.approx(total * centre / 3, rel=1e-10)


@every_degree
def test_a_trapezoidal_load_has_its_sum_and_its_centre(degree):
    scene, beam = beam_on_two_supports(degree=degree)
    load = scene.add_line_load(beam, [(0, -60), (0, -10)], between=(0.5, 2.2))
    left, right = reactions(scene, beam)
    whole, tip = 10 * 1.7, 50 * 1.7 / 2
    assert left[1] + right[1] == pytest.approx(whole + tip)
    assert 3 * right[1] == pytest.approx(whole * 1.35 + tip * (0.5 + 1.7 / 3))
    load = scene.change(load, [(0, -10), (0, -10)])
    assert sum(reactions(scene, beam))[1] == pytest.approx(whole)
    scene.remove(load)
    assert not scene.loads


def test_a_function_of_the_arc_length_acts_on_its_part_alone():
    scene, beam = beam_on_two_supports(degree=2)
    scene.add_line_load(beam, lambda s: (0, -(s**2)), of="arc length", between=(0.5, 2.2))
    assert sum(reactions(scene, beam))[1] == pytest.approx((2.2**3 - 0.5**3) / 3)


@pytest.mark.parametrize(
    ("points", "degree"),
    [([(0, 0), (3, 4)], 1), ([(0, 0), (1, 3), (3, 4)], 1), (fb.arc((0, 0), (1.5, 1), (3, 0)), 2)],
    ids=["line", "corner", "arc"],
)
def test_snow_weighs_by_the_length_below_it(points, degree):
    scene, beam = beam_on_two_supports(points, 8, degree)
    scene.add_line_load(beam, (7.0, -60.0), of="projected length")
    left, right = reactions(scene, beam)
    assert (left + right)[1] == pytest.approx(60 * 3, rel=1e-6)
    height = 4 if degree == 1 else 2  # up and down again
    assert (left + right)[0] == pytest.approx(-7 * height, rel=1e-6)


def test_a_beam_that_is_removed_takes_the_loads_at_its_places_with_it():
    scene, beam = beam_on_two_supports()
    other = scene.add_beam([(0, 1), (3, 1)], SECTION, elements=1)
    scene.clamp(other.start)
    scene.add_force(beam.at(1.0), (0, -1.0))
    other_load = scene.add_force(other.at(1.0), (0, -1.0))
    scene.remove(beam)
    assert scene.loads == [other_load]


def test_a_place_on_a_beam_of_another_scene_is_refused():
    scene, _ = beam_on_two_supports()
    with pytest.raises(fb.SceneError, match="belongs to another scene"):
        scene.add_force(beam_on_two_supports()[1].at(1.0), (0, 1))
