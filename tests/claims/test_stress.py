"""Stresses at the edges of sections: tables of profiles, closed forms, and derivatives."""

import numpy as np
import pytest
from derivatives import EXACT, difference
from scenes import assert_refused, clamped_bar

import fx_beam as fb

STEEL = fb.materials.steel


# -- Sections -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("section", "area", "second_moment", "lower"),
    [
        (fb.Section.i_beam(200, 100, 5.6, 8.5, 12, E=1.0), 28.5, 1943, 100),  # IPE 200
        (fb.Section.i_beam(300, 150, 7.1, 10.7, 15, E=1.0), 53.8, 8356, 150),  # IPE 300
        (fb.Section.i_beam(190, 200, 6.5, 10, 18, E=1.0), 53.8, 3692, 95),  # HEA 200
        (fb.Section.i_beam(290, 300, 8.5, 14, 27, E=1.0), 112.5, 18263, 145),  # HEA 300
        (fb.Section.channel(100, 50, 6, 8.5, 8.5, 0.08, 4.5, E=1.0), 13.5, 206, 50),  # UPN 100
        (fb.Section.channel(200, 75, 8.5, 11.5, 11.5, 0.08, 6, E=1.0), 32.2, 1910, 100),  # UPN 200
        (fb.Section.channel(300, 100, 10, 16, 16, 0.08, 8, E=1.0), 58.8, 8030, 150),  # UPN 300
        (fb.Section.angle(100, 100, 10, 12, 6, E=1.0), 19.15, 176.7, 28.2),  # L 100 x 100 x 10
        (fb.Section.angle(150, 100, 10, 12, 6, E=1.0), 24.15, 552.6, 48.1),  # L 150 x 100 x 10
    ],
)
def test_profiles_have_the_numbers_of_their_tables(section, area, second_moment, lower):
    """In cm^2, cm^4 and mm: EN 10365, EN 10056."""
    assert section.A / 100 == pytest.approx(area, rel=4e-3)
    assert section.I / 1e4 == pytest.approx(second_moment, rel=4e-3)
    assert -section.edges[0] == pytest.approx(lower, rel=2e-3)


def test_profiles_have_the_integrals_over_their_outline():
    """A, the centroid and I of a tee and a channel without fillets, by many strips."""
    y = (np.arange(400_000) + 0.5) / 400_000 * 0.2
    tee = fb.Section.tee(0.2, 0.1, 0.008, 0.011, E=1.0)
    channel = fb.Section.channel(0.2, 0.075, 0.0085, 0.0115, slope=0.08, E=1.0)
    flange = np.minimum(y, 0.2 - y)  # of the channel: where x(thickness) = flange
    tip = np.clip(0.0375 + (0.0115 - flange) / 0.08, 0.0085, 0.075)
    for section, width in ((tee, np.where(y > 0.189, 0.1, 0.008)), (channel, tip)):
        area = width.mean() * 0.2
        centre = (width * y).mean() / width.mean()
        second_moment = (width * (y - centre) ** 2).mean() * 0.2
        assert section.A == pytest.approx(area, rel=1e-5)
        assert section.I == pytest.approx(second_moment, rel=1e-5)
        assert section.edges == pytest.approx((-centre, 0.2 - centre), rel=1e-5)


@pytest.mark.parametrize(
    ("section", "shear_area"),
    [
        (fb.Section.i_beam(300, 150, 7.1, 10.7, 15, E=1.0), 2076),
        (fb.Section.channel(200, 75, 8.5, 11.5, 11.5, E=1.0), 1521),
        (fb.Section.angle(100, 100, 10, 12, 6, E=1.0), 847),
        (fb.Section.tee(200, 100, 8, 11, 11, E=1.0), 1389),
    ],
)
def test_shear_areas_are_near_those_of_finite_elements(section, shear_area):
    """By sectionproperties 3.10 without Poisson's ratio [mm^2]."""
    assert section.As == pytest.approx(shear_area, rel=0.06)
    assert section.GA == pytest.approx(section.As / 2.6)


def test_walls_that_do_not_fit_are_refused():
    profile = fb.Section.i_beam
    assert_refused("web.*less than the width, 0.1", profile, 0.2, 0.1, 0.1, 0.01, **STEEL)
    assert_refused("flange.*less than 0.1", profile, 0.2, 0.1, 0.01, 0.1, **STEEL)
    assert_refused("radius.*from 0 to 0.09", profile, 0.2, 0.1, 0.01, 0.01, 0.2, **STEEL)
    assert_refused("edges.*two distances", fb.Section, EA=1, GA=1, EI=1, edges=0.1)
    assert_refused("upper edge.*finite", fb.Section, EA=1, GA=1, EI=1, edges=(-1, np.inf))


# -- Stresses -------------------------------------------------------------------------------------


def test_a_cantilever_has_the_stresses_of_its_moment_and_its_shear():
    """sigma = M e / I with M = P (L - s), tension above; tau = P / As."""
    section = fb.Section.rectangle(0.2, 0.1, **STEEL)
    scene, beam = clamped_bar((2.0, 0), section, 4, load=(5e3, -1e3))
    stress = fb.static(scene, linear=True).stress(beam)
    s = np.array([0.0, 0.5, 1.3])
    bending, axial = 1e3 * (2 - s) * 0.1 / (0.1 * 0.2**3 / 12), 5e3 / 0.02
    at = stress.at(s)
    np.testing.assert_allclose(at.upper[-1], axial + bending, rtol=1e-9)
    np.testing.assert_allclose(at.lower[-1], axial - bending, rtol=1e-9)
    np.testing.assert_allclose(at.largest[-1], axial + bending, rtol=1e-9)
    np.testing.assert_allclose(at.shear[-1], -1e3 / (0.02 * 5 / 6), rtol=1e-9)
    np.testing.assert_allclose(stress.ends.upper[-1], [axial + bending[0], axial], rtol=1e-6)
    assert stress.lower.shape == stress.s[None].repeat(2, axis=0).shape


def test_a_beam_drawn_the_other_way_has_its_edges_exchanged():
    section = fb.Section.tee(0.2, 0.1, 0.008, 0.011, **STEEL)
    mirrored = fb.Section(**vars(section) | {"edges": tuple(-e for e in section.edges[::-1])})
    values = []
    for ends, shape in ([(0, 0), (2, 0)], section), ([(2, 0), (0, 0)], mirrored):
        scene = fb.Scene()
        beam = scene.add_beam(ends, shape, elements=4)
        nodes = beam.nodes if ends[0] == (0, 0) else beam.nodes[::-1]
        scene.clamp(nodes[0])
        scene.add_force(nodes[-1], (3e3, -1e3))
        stress = fb.static(scene, linear=True).stress(beam).ends
        values.append([stress.lower[-1], stress.upper[-1]])
    np.testing.assert_allclose(values[0], np.array(values[1])[::-1, ::-1], rtol=1e-9)


def test_a_tapered_cantilever_is_stressed_most_inside():
    """h = h0 (1 - s/L) + h1 s/L of constant width: sigma = 6 P (L - s) / (b h^2)."""
    section = fb.Section.rectangle(lambda f: 0.2 - 0.15 * f, 0.1, **STEEL)
    scene, beam = clamped_bar((2.0, 0), section, 16, load=(0, -1e3))
    s = np.linspace(0, 1.9, 9)
    stress = fb.static(scene, linear=True).stress(beam).at(s).upper[-1]
    h = 0.2 - 0.15 * s / 2
    np.testing.assert_allclose(stress, 6e3 * (2 - s) / (0.1 * h**2), rtol=1e-9)


def test_a_rib_beside_its_axis_bends_with_the_offset_of_its_force():
    """A bar at the offset e under a pull at its nodes: N = P, M = P e about its own centroid."""
    scene = fb.Scene()
    bar = fb.Section.rectangle(0.02, 0.01, **STEEL)
    beam = scene.add_beam([(0, 0), (1, 0)], bar, elements=4, offset=0.05)
    scene.pin(beam.start)
    scene.fix(beam.end, "y")
    scene.add_force(beam.end, (100.0, 0.0))
    stress = fb.static(scene, linear=True).stress(beam).at(0.5)
    axial, bending = 100 / 2e-4, 100 * 0.05 * 0.01 / (0.01 * 0.02**3 / 12)
    # The nodes lie on the right side of the bar, which the pull there stretches.
    assert stress.lower[-1] == pytest.approx([axial + bending], rel=1e-6)
    assert stress.upper[-1] == pytest.approx([axial - bending], rel=1e-6)


def test_a_quarter_ring_has_the_stresses_of_its_section_forces():
    """N = -P cos a and M = -P R (1 - cos a) at the angle a from a force P along its free end."""
    R, P, c = 1.0, 100.0, np.sqrt(0.5)
    section = fb.Section.rectangle(0.1, 0.05, **STEEL)
    scene = fb.Scene()
    ring = scene.add_beam(fb.arc((R, 0), (R * c, R * c), (0, R)), section, elements=32, degree=2)
    scene.clamp(ring.end)
    scene.add_force(ring.start, (0.0, P))
    stress = fb.static(scene, linear=True).stress(ring)
    a = np.array([0.0, 0.7, 1.2])
    at = stress.at(R * a)
    N, M = -P * np.cos(a), -P * R * (1 - np.cos(a))
    np.testing.assert_allclose(at.lower[-1], N / 5e-3 + M * 0.05 / (0.05 * 1e-3 / 12), rtol=2e-3)


def test_an_axis_that_turns_is_stretched_as_its_closed_form():
    """sigma = rho w^2 (L^2 - s^2) / 2 in a bar that turns about its end."""
    scene = fb.Scene()
    bar = fb.Section.circle(0.02, **STEEL)
    beam = scene.add_beam([(0, 0), (1, 0)], bar, elements=8, degree=2)
    scene.pin(beam.start)
    scene.set_velocity(beam, lambda x, y: (-20.0 * y, 20.0 * x), spin=20.0)
    stress = fb.simulate(scene, fb.EnergyDecaying(1.0), dt=1e-3, t_end=0.1).stress(beam)
    expected = 7850 * 400 * (1 - 0.3**2) / 2
    assert stress.at(0.3).upper[-1] == pytest.approx([expected], rel=2e-3)
    assert stress.at(0.3).lower[-1] == pytest.approx([expected], rel=2e-3)


def test_what_has_no_stress_says_why(tmp_path):
    plain = fb.Section(EA=1e6, GA=1e6, EI=1e3)
    own = fb.Section(strain_energy=lambda eps, gamma, kappa: 1e4 * (eps**2 + gamma**2 + kappa**2))
    for section, words in (
        (plain, "has no A.*Section.rectangle"),
        (fb.Section.from_area(1e-2, 1e-5, E=2e11), "has no edges.*height="),
        (own, "strain_energy.*another distribution"),
    ):
        scene, beam = clamped_bar((1.0, 0), section, 2, load=(0, -1.0))
        solution = fb.static(scene, load_steps=1)
        assert_refused(words, lambda: solution.stress(beam).lower)  # noqa: B023
        output = fb.Output("stress", beam.at(0.5), edge="lower")
        assert_refused(words, solution.value, output)
    scene, beam = clamped_bar((1.0, 0), fb.Section.circle(0.01, **STEEL), 2, load=(0, -1.0))
    fb.static(scene, load_steps=1).save(tmp_path / "bar.npz")
    loaded = fb.load(tmp_path / "bar.npz")
    assert_refused("saved file", lambda: loaded.stress(beam.name).lower)
    assert_refused("edge.*'lower' or 'upper'", fb.Output, "stress", beam.at(0.5))
    assert_refused("edge.*left out", fb.Output, "N", beam.at(0.5), edge="lower")


def test_shapes_have_the_colours_of_the_larger_stress(tmp_path):
    from fx_beam.results.member_fields import along_all

    section = fb.Section.tee(0.2, 0.1, 0.008, 0.011, **STEEL)
    scene, beam = clamped_bar((2.0, 0), section, 4, load=(5e3, -1e3))
    solution = fb.static(scene, load_steps=1)
    values = along_all(solution, ["stress"], [0, 1], np.array([0.25, 0.75]))["stress"]
    places = (beam.s[:-1, None] + 0.5 * np.array([0.25, 0.75])).ravel()
    np.testing.assert_allclose(values[1].ravel(), solution.stress(beam).at(places).largest[1])
    fb.plot.shapes(solution, tmp_path / "stress.png", colour="stress")
    assert (tmp_path / "stress.png").stat().st_size > 0


# -- Outputs --------------------------------------------------------------------------------------


def tee(x, taper):
    height, width, place, force = x
    depth = (lambda f: height * (1 + f)) if taper else height
    section = fb.Section.tee(depth, width, 0.01, 0.012, **STEEL)
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), (1.2, 1.6)], section, elements=8)
    scene.clamp(beam.start)
    scene.add_force(beam.end, (300.0, -force))
    return scene, {
        "upper": fb.Output("stress", beam.at(place), edge="upper"),
        "lower": fb.Output("stress", beam.at(place), edge="lower"),
        "shear": fb.Output("shear_stress", beam.at(place)),
    }


@pytest.mark.parametrize("taper", [False, True])
@pytest.mark.parametrize("kind", ["static", "motion", "order 4"])
def test_derivatives_of_stresses_are_those_of_differences(kind, taper):
    """By sizes, the place and the load; the section varies along the place as well."""

    def build(x):
        return tee(x, taper)

    x = np.array([0.1, 0.06, 0.3, 1e3])
    steps = {"dt": 1e-3, "t_end": 4e-3, "newton": EXACT}
    run = {
        "static": lambda: fb.StaticResponse(build, 2, newton=EXACT),
        "motion": lambda: fb.Response(build, **steps),
        "order 4": lambda: fb.Response(build, fb.EnergyMomentum(order=4), **steps),
    }[kind]()
    _, y = run(x)
    J = {name: np.array(values) for name, values in run.jacobian().items()}
    weights = {name: np.linspace(1, 2, len(values)) for name, values in y.items()}
    gradient = run.vjp(weights)
    assert kind == "order 4" or not run.stats.difference_reason
    for i, size in enumerate(x):
        unit = np.eye(4)[i]
        for name, slopes in J.items():

            def value(h, name=name, unit=unit):
                return run(x + h * unit)[1][name]

            expected = difference(value, 1e-4 * size)
            np.testing.assert_allclose(slopes[:, i], expected, atol=1e-6 * abs(expected).max())
    total = sum(weights[name] @ J[name] for name in J)
    np.testing.assert_allclose(gradient, total, rtol=1e-9)


def test_a_stress_is_measured_ends_a_motion_and_has_a_unit_and_a_name():
    scene, outputs = tee([0.1, 0.06, 0.3, 1e3], False)
    output = outputs["upper"]
    assert (output.unit, output.label.split(" of ")[0]) == ("Pa", "stress upper")
    motion = fb.Motion(scene, dt=1e-3, outputs={"stress": output}, record=fb.Record())
    for _ in range(5):
        measured = motion.step()["stress"]
    whole = fb.simulate(scene, dt=1e-3, t_end=5e-3)
    assert measured == pytest.approx(whole.value(output)[-1], rel=1e-12)
    level = 0.5 * measured
    ended = fb.simulate(
        scene,
        dt=1e-3,
        t_end=5e-3,
        until=lambda t, y: y["stress"] - level,
        outputs={"stress": output},
    )
    assert ended.t[-1] < 5e-3
    # The line through the last two means, each in the middle of its step, meets it at the end.
    t, means = ended.t_level, ended.value(output)
    slope = (means[-1] - means[-2]) / (t[-1] - t[-2])
    assert means[-1] + slope * (ended.t[-1] - t[-1]) == pytest.approx(level, rel=1e-9)
