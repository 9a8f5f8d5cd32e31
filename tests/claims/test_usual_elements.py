"""The number of elements that a beam has by default."""

import math

import pytest

import fx_beam as fb

SECTION = fb.Section(EA=1e7, GA=1e7, EI=1e3, rhoA=1.0)
DEGREES = pytest.mark.parametrize(("degree", "elements"), [(1, 16), (2, 4), (3, 2)])


def beam_of(degree, points=((0, 0), (1, 0))):
    scene = fb.Scene()
    return scene, scene.add_beam(points, SECTION, degree=degree)


@DEGREES
def test_most_people_get_what_they_need(degree, elements):
    """Deflection, load of Euler's column and two frequencies to 1 %, the third one to 4 %."""
    scene, beam = beam_of(degree)
    assert beam.elements == elements
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0, -1.0))
    tip = fb.static(scene, linear=True).displacement(beam.end)[-1, 1]
    assert tip == pytest.approx(-1 / 3e3, rel=0.01)
    roots = 1.8751041, 4.6940911, 7.8547574
    frequencies = fb.modes(scene, n=3).angular_frequencies
    for frequency, root, error in zip(frequencies, roots, (0.01, 0.01, 0.04), strict=True):
        assert frequency == pytest.approx(root**2 * math.sqrt(1e3), rel=error)
    scene, beam = beam_of(degree)
    scene.pin(beam.start)
    scene.fix(beam.end, "y")
    scene.add_force(beam.end, (-1.0, 0))
    assert fb.buckling(scene, n=1).load_factors[0] == pytest.approx(math.pi**2 * 1e3, rel=0.01)


@DEGREES
def test_corners_and_curves(degree, elements):
    """Each piece of a polyline has one at least; a curve has as many as a straight beam."""
    _, frame = beam_of(degree, [(0, 0), (0, 1), (1, 1)])
    _, line = beam_of(degree, [(x, 0) for x in range(21)])
    _, bow = beam_of(degree, fb.arc((0, 0), (1, 1), (2, 0)))
    assert (frame.elements, line.elements, bow.elements) == (elements, 20, elements)
