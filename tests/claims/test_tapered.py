"""Tapered and stepped members: against integrals, and that they keep what uniform ones keep."""

import math

import ufl

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, one_bar
from scipy.integrate import quad

import fx_beam as fb

DEGREES = pytest.mark.parametrize("degree", [1, 2, 3])


def end_of_cantilever(section, force, elements, degree):
    """Displacement of the end of a cantilever of length 2 in equilibrium."""
    scene, beam = clamped_bar((2, 0), section, elements=elements, degree=degree, load=force)
    solution = fb.static(scene, load_steps=1)
    return solution.displacement(beam.end)[-1]


# -- Statics -----------------------------------------------------------------------------------


@DEGREES
def test_a_tapered_cantilever_bends_by_the_integral_of_its_flexibility(degree):
    force = 1e-6
    section = fb.Section(EA=1.0, GA=lambda s: 30 * (2 - s), EI=lambda s: (1 - s / 3) ** 3)
    exact, _ = quad(
        lambda x: force * ((2 - x) ** 2 / section.EI(x / 2) + 1 / section.GA(x / 2)), 0, 2
    )
    computed = [end_of_cantilever(section, (0, force), n, degree)[1] for n in (8, 16)]
    errors = abs(np.array(computed) / exact - 1)
    assert np.log2(errors[0] / errors[1]) > 2 * degree - 0.4
    assert errors[1] < {1: 1e-2, 2: 1e-4, 3: 1e-6}[degree]


# -- Data --------------------------------------------------------------------------------------


def test_mass_and_weight_are_the_integrals_of_the_density():
    section = fb.Section(EA=1, GA=1, EI=1, rhoA=lambda s: 3 - 2 * s, rhoI=lambda s: s)

    def start(velocity, spin):
        scene, beam = one_bar([(1, 0), (5, 3)], section, elements=3, degree=2, gravity=(0, -10))
        scene.set_velocity(beam, velocity, spin)
        return fb.simulate(scene, dt=1e-3, t_end=1e-3)

    fall = start((0.0, 1.0), 0.0)
    assert fall.linear_momentum[0] == pytest.approx([0, 5 * 2], rel=1e-14, abs=1e-14)
    assert start((0.0, 0.0), 1.0).energy.kinetic[0] == pytest.approx(5 / 2 / 2, rel=1e-14)
    assert fall.linear_momentum[1, 1] - 10 == pytest.approx(-10 * 10 * 1e-3, rel=1e-10)
    assert fall.q[1, :, 1] == pytest.approx(1e-3 - 5e-6, abs=1e-13)


def test_a_rectangle_of_varying_height_has_the_data_of_each_height():
    def height(s):
        return 0.1 * (1 - s / 2)

    for make, size in (
        (lambda h: fb.Section.rectangle(h, 0.02, E=2e11, rho=7800), "EI"),
        (lambda h: fb.Section.circle(h, E=2e11, rho=7800), "rhoI"),
        (lambda h: fb.Section.from_area(h, 1e-6, E=2e11, rho=7800), "EA"),
    ):
        varying = make(height)
        for name in ("EA", "GA", "EI", "rhoA", "rhoI"):
            values = varying.values(name, np.array([0.0, 0.3, 1.0]))
            each = [getattr(make(height(s)), name) for s in (0.0, 0.3, 1.0)]
            assert values == pytest.approx(each, rel=1e-14)
        assert varying.varies(size)


def test_hollow_sections_have_the_areas_and_second_moments_of_their_standard():
    # EN 10210-2: 48.3 x 3.2 mm has 4.53 cm^2 and 11.6 cm^4.
    tube = fb.Section.tube(0.0483, 0.0032, E=1.0, nu=0.0, retardation=(1e-3, 2e-3, 3e-3))
    assert (round(1e4 * tube.EA, 2), round(1e8 * tube.EI, 1)) == (4.53, 11.6)
    assert tube.retardation == (1e-3, 2e-3, 3e-3)
    # Four walls by Steiner's theorem: flanges of 10 by 1 at 4.5 from the axis, webs of 8 by 1.
    box = fb.Section.box(height=10.0, width=10.0, thickness=1.0, E=1.0, nu=0.0)
    assert box.EA == pytest.approx(36.0)
    assert box.EI == pytest.approx(2 * (10 / 12 + 10 * 4.5**2) + 2 * 8**3 / 12)
    assert box.GA == pytest.approx(2 * 10.0 / 2)  # G = 1/2 of the webs over the whole depth
    half = fb.Section.box(lambda s: 10.0 - 5 * s, 10.0, 1.0, E=1.0, nu=0.0)
    end = fb.Section.box(5.0, 10.0, 1.0, E=1.0, nu=0.0)
    for name in ("EA", "GA", "EI"):
        assert half.values(name, np.array([1.0])) == pytest.approx(getattr(end, name))


def test_timber_has_a_shear_modulus_of_its_own_and_named_sizes_a_material():
    beam = fb.Section.rectangle(height=0.2, width=0.1, **fb.materials.softwood)
    assert beam.GA == pytest.approx(5 / 6 * 0.69e9 * 0.02)
    in_mm = fb.Section.rectangle(height=200.0, width=100.0, **fb.materials.softwood.in_mm)
    assert in_mm.GA == pytest.approx(beam.GA)
    steel = fb.materials.steel
    assert fb.Section.circle(diameter=0.1, **steel) == fb.Section.circle(0.1, *steel)


def test_a_graded_material_has_the_data_of_each_modulus_and_density():
    def E(s):
        return 2e11 * (1 + s)

    def rho(s):
        return ufl.exp(-s) * 7800

    def make(E, rho):
        return fb.Section.rectangle(lambda s: 0.1 + s, 0.02, E, nu=0.2, rho=rho, shear_factor=0.8)

    for name in ("EA", "GA", "EI", "rhoA", "rhoI"):
        values = make(E, rho).values(name, np.array([0.2, 0.9]))
        each = [make(E(s), 7800 * math.exp(-s)).values(name, np.array([s]))[0] for s in (0.2, 0.9)]
        assert values == pytest.approx(each, rel=1e-14)
    section = fb.Section.circle(0.1, E=E, rho=7800)
    assert section.varies("EI") and not section.varies("rhoA")


@pytest.mark.parametrize(
    ("section", "message"),
    [
        (lambda: fb.Section.circle(lambda s: 0.9 - s, E=1.0), "diameter = -0.037.* at the fract"),
        (lambda: fb.Section(lambda s: 1 - 1.1 * s, 1.0, 1.0), "EA = -0.031.* fraction 0.9375"),
        (lambda: fb.Section(lambda s: math.nan if s > 0.9 else 1.0, 1.0, 1.0), "nan at the fract"),
        (lambda: fb.Section(1.0, 1.0, 1.0, lambda s: 0.7 - s), "rhoA = -0.*must be zero or"),
    ],
)
def test_a_value_that_is_bad_only_near_the_tip_is_named_with_its_beam(section, message):
    scene = fb.Scene()
    scene.clamp(scene.add_beam([(0, 0), (1, 0)], section(), elements=8, name="rod").start)
    assert_refused(f"beam 'rod': Section: .*{message}", fb.simulate, scene, dt=0.1, t_end=0.1)


def test_functions_of_numpy_of_math_and_of_ufl_are_the_same():
    def run(EI, rhoA):
        section = fb.Section(EA=1e4, GA=1e4, EI=EI, rhoA=rhoA, rhoI=1.0)
        scene = fb.Scene(gravity=(0, -9.81))
        scene.pin(scene.add_beam([(0, 0), (1, 0)], section, elements=4, degree=2).start)
        return fb.simulate(scene, dt=0.02, t_end=0.4).q

    ways = [
        run(lambda s: np.where(s < 0.5, 100, 50), lambda s: np.exp(-s)),
        run(lambda s: 100 if s < 0.5 else 50, lambda s: math.exp(-s)),
        run(lambda s: ufl.conditional(ufl.lt(s, 0.5), 100, 50), lambda s: ufl.exp(-s)),
    ]
    assert abs(ways[0] - ways[1]).max() < 1e-11 and abs(ways[0] - ways[2]).max() < 1e-11
    assert abs(ways[0]).max() > 0.1


# -- Motion ------------------------------------------------------------------------------------


def test_a_stepped_member_moves_as_the_two_it_is_made_of():
    thick = fb.Section(EA=1e4, GA=1e4, EI=100, rhoA=1.0, rhoI=10.0)
    thin = fb.Section(EA=5e3, GA=5e3, EI=20, rhoA=0.5, rhoI=3.0)

    def stepped(name):
        return lambda s: getattr(thick if s < 0.6 else thin, name)

    data = {name: stepped(name) for name in ("EA", "GA", "EI", "rhoA", "rhoI")}
    arc = fb.arc((0, 0), (5, 1), (10, 0))
    middle, inner, outer = (arc.function(f) for f in (0.6, 0.3, 0.8))
    whole, parts = fb.Scene(gravity=(0, -9.81)), fb.Scene(gravity=(0, -9.81))
    one = whole.add_beam(arc, fb.Section(**data), elements=5, degree=2)
    a = parts.add_beam(fb.arc((0, 0), inner, middle), thick, elements=3, degree=2)
    b = parts.add_beam(fb.arc(a.end, outer, (10, 0)), thin, elements=2, degree=2)
    tips = []
    for scene, start, end in ((whole, one.start, one.end), (parts, a.start, b.end)):
        scene.pin(start)
        tips.append(fb.simulate(scene, dt=0.02, t_end=1.0).position(end))
    assert abs(tips[0] - tips[1]).max() < 1e-10
    assert abs(tips[0] - tips[0][0]).max() > 1
