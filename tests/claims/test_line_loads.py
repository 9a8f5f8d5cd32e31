"""Line loads that vary along their beam."""

import numpy as np
import pytest

import fx_beam as fb

LENGTH, LOAD = 2.0, 3.0
STIFF = fb.Section(EA=1e9, GA=1e9, EI=1e8, rhoA=1.0, rhoI=1e-3)


def cantilever(load, degree=1, **options):
    scene = fb.Scene()
    bar = scene.add_beam([(-1, 0), (0, 0)], STIFF, elements=2, degree=degree, name="before")
    points = [bar.end, (LENGTH, 0)]
    beam = scene.add_beam(points, STIFF, elements=4, degree=degree, name="loaded")
    scene.clamp(bar.start)
    scene.add_line_load(beam, load, **options)
    return scene, bar, beam


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_a_load_that_grows_along_a_beam_has_its_resultant_at_two_thirds(degree):
    scene, bar, beam = cantilever(lambda s: (0.0, -LOAD * s / LENGTH), degree, of="arc length")
    bent = fb.static(scene, steps=1)
    total = LOAD * LENGTH / 2
    lever = 1 + 2 * LENGTH / 3
    assert bent.reaction(bar.start)[-1] == pytest.approx([0, total, total * lever], rel=1e-6)
    # Shear force and moment of statics, at the Gauss points of the finest rule there is.
    r = bent.resultants(beam)
    if degree == 3:
        left = LENGTH - r.s
        shear = LOAD * (LENGTH**2 - r.s**2) / (2 * LENGTH)
        moment = LOAD * left**2 * (2 * LENGTH + r.s) / (6 * LENGTH)
        np.testing.assert_allclose(-r.Q[-1], shear, atol=2e-2 * total)
        np.testing.assert_allclose(-r.M[-1], moment, atol=2e-2 * total)


def test_a_load_along_the_arc_that_is_uniform_is_a_uniform_load():
    motions = []
    for load, of in (((1.0, -LOAD), "time"), (lambda s: (1.0, -LOAD), "arc length")):
        scene, _, beam = cantilever(load, of=of)
        motions.append(fb.simulate(scene, dt=0.01, t_end=0.1).displacement(beam.end))
    np.testing.assert_allclose(*motions, rtol=0, atol=1e-13 * abs(motions[0]).max())


@pytest.mark.parametrize(
    "load",
    [lambda s: (0.0, s), lambda x: (0.0, x), lambda x, y: (x, y), lambda s, t: (s, t)],
    ids=["s", "x", "x, y", "s, t"],
)
def test_a_function_of_the_place_is_refused_as_one_of_time(load):
    with pytest.raises(fb.SceneError, match="called with the time t only.*of='arc length'"):
        cantilever(load)


def test_a_load_that_is_not_finite_somewhere_names_the_beam_and_the_place():
    scene, _, _ = cantilever(lambda s: (0.0, np.inf if s > 1 else 0.0), of="arc length")
    with pytest.raises(fb.SceneError, match=r"line load on beam 'loaded' at s = 1\."):
        fb.simulate(scene, dt=0.1, t_end=0.1)
