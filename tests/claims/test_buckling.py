"""Linear buckling against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from growth import tower
from scenes import assert_refused, held_body, one_bar
from scipy.linalg import eigh
from scipy.optimize import brentq

import fx_beam as fb

STIFF = fb.Section(EA=1e8, GA=1e8, EI=1.0, rhoA=1.0)
EULER = math.pi**2


def column(elements=8, **scene):
    """An upright column of length 1, without supports."""
    made = fb.Scene(**scene)
    # Round-off of the stiffness matrix is 2e-5 of factors at EA = 1e8 with 40 elements.
    section = STIFF if elements < 40 else replace(STIFF, EA=1e7, GA=1e7)
    return made, made.add_beam([(0, 0), (0, 1)], section, elements=elements, degree=3)


def two_hinges(scene, beam):
    scene.pin(beam.start)
    scene.fix(beam.end, "x")


def cantilever(scene, beam):
    scene.clamp(beam.start)


def two_clamps(scene, beam):
    scene.clamp(beam.start)
    scene.fix(beam.end, "x", "rotation")


def clamp_and_hinge(scene, beam):
    scene.clamp(beam.start)
    scene.fix(beam.end, "x")


CLAMP_AND_HINGE = brentq(lambda k: math.tan(k) - k, 4.4, 4.6) ** 2


# Full matrices, and sparse ones.
@pytest.mark.parametrize(("elements", "error"), [(8, 5e-4), (40, 2e-5)])
@pytest.mark.parametrize(
    ("hold", "loads"),
    [
        (two_hinges, [EULER, 4 * EULER, 9 * EULER]),
        (cantilever, [EULER / 4, 9 * EULER / 4, 25 * EULER / 4]),
        (two_clamps, [4 * EULER, 4 * 4.49340946**2, 16 * EULER]),
        (clamp_and_hinge, [CLAMP_AND_HINGE]),
    ],
)
def test_columns_buckle_at_eulers_loads(hold, loads, elements, error):
    scene, beam = column(elements)
    hold(scene, beam)
    scene.add_force(beam.end, (0, -2.0))
    modes = fb.buckling(scene, n=len(loads))
    assert 2 * modes.load_factors == pytest.approx(loads, rel=error)


def test_the_shape_of_a_column_is_half_a_wave():
    scene, beam = column()
    two_hinges(scene, beam)
    scene.add_force(beam.end, (0, -1.0))
    x, y = fb.buckling(scene, n=1).shape(beam, mode=0, size=0.1).T
    assert abs(abs(x) - 0.1 * np.sin(np.pi * y)).max() < 1e-5


def test_a_heated_column_buckles_at_its_thermal_force():
    scene, beam = column()
    scene.pin(beam.start)
    scene.pin(beam.end)
    scene.add_natural_strain(beam, axial=1e-7)
    assert fb.buckling(scene, n=1).load_factors[0] * 1e-7 * 1e8 == pytest.approx(EULER, rel=1e-5)


def test_a_column_buckles_under_its_weight_as_greenhill_says():
    # The zero of the Bessel function of order -1/3: q L^3 / EI = 9/4 j^2.
    scene, beam = column(gravity=(0, -1.0))
    scene.clamp(beam.start)
    assert fb.buckling(scene, n=1).load_factors[0] == pytest.approx(9 / 4 * 1.86635086**2, rel=1e-5)


def test_prestress_stays_while_the_loads_rise():
    tight, beam = column()
    two_hinges(tight, beam)
    tight.add_force(beam.end, (0, 5.0))
    scene, beam = column()
    two_hinges(scene, beam)
    scene.add_force(beam.end, (0, -1.0))
    factors = fb.buckling(scene, fb.static(tight), n=1).load_factors
    assert factors == pytest.approx([EULER + 5.0], rel=1e-5)


def test_natural_strains_of_a_state_stay():
    """A bar and a spring behind it of the same stiffness: half of the load compresses the bar."""

    def held(strains, load=0.0):
        scene, bar = one_bar((0, 1), fb.Section(EA=1e6, GA=1e6, EI=1.0), 8, 3, load=(0, -load))
        two_hinges(scene, bar)
        scene.add_force_between(bar.end, (0, 3), spring=fb.Spring(1e6, rest=2.0))
        for strain in strains:
            scene.add_natural_strain(bar, axial=strain)
        return scene

    cold = fb.static(held([-5e-6]))
    load = fb.buckling(held([0.0], 1.0), cold, n=1).load_factors
    assert load == pytest.approx([2 * (EULER + 2.5)], rel=1e-4)
    assert_refused("natural strains", fb.buckling, held([], 1.0), cold)


def test_a_state_of_first_order_is_refused():
    """In its shape the beam is stretched, with a thousand times the force."""
    scene, beam = column()
    cantilever(scene, beam)
    scene.add_force(beam.end, (0.2, -0.3))
    assert_refused("first order", fb.buckling, scene, fb.static(scene, linear=True))


def test_a_state_that_turns_is_refused():
    scene, beam = column()
    scene.clamp(beam.start)
    turning = fb.static(scene, spin=5.0)
    scene.add_force(beam.end, (0, -1.0))
    assert_refused("turns", fb.buckling, scene, turning)


def test_rigid_links_with_springs_buckle_as_their_two_by_two_matrix_says():
    scene, links = fb.Scene(), []
    for y in (0, 1):
        points = {"foot": (0, y), "top": (0, y + 1)}
        links.append(scene.add_body((0, y + 0.5), 1.0, 1.0, points=points))
    spring = fb.Spring(3.0)
    scene.add_joint(fb.Revolute(fb.GROUND, links[0]["foot"], spring=spring))
    scene.add_joint(fb.Revolute(links[0]["top"], links[1]["foot"], spring=spring))
    scene.add_force(links[1]["top"], (0, -1.0))
    root = math.sqrt(5)
    loads = fb.buckling(scene).load_factors
    assert loads == pytest.approx([1.5 * (3 - root), 1.5 * (3 + root)], rel=1e-10)


@pytest.mark.parametrize("n", [4, 62, 64, 110, 256])
def test_a_tower_of_closed_loops_buckles_as_its_tridiagonal_matrix_says(n):
    # The links of a storey turn alike, and rungs do not turn. A storey carries half of its own two
    # links, its rung, and all above.
    turns, above = np.eye(n) - np.eye(n, k=-1), n - 1 - np.arange(n)
    K, weights = 2 * n**2 * (turns.T @ turns + np.eye(n)), 9.81 * (2 * (0.5 + above) + 1 + above)
    expected = 1 / eigh(np.diag(weights), K, eigvals_only=True)[:-4:-1]
    assert fb.buckling(tower(n)[0], n=3).load_factors == pytest.approx(expected, rel=1e-10)


def test_a_tower_of_closed_loops_yields_as_its_tridiagonal_matrix_says():
    n = 256
    scene, centre = tower(n)  # of the last link, which moves by half of its turn
    turns, lever = np.eye(n) - np.eye(n, k=-1), np.append(np.ones(n - 1), 0.5)
    sway = lever @ np.linalg.solve(2 * n**2 * (turns.T @ turns + np.eye(n)), lever)
    response = fb.frequency_response(scene, (centre, (1.0, 0.0, 0.0)), centre, [0.0])
    assert response.values[0, 0] == pytest.approx(sway, rel=1e-12)


def portal(load):
    scene, section = fb.Scene(), fb.Section(EA=1e7, GA=1e7, EI=10.0, rhoA=1.0)
    left, right = (scene.add_beam([(x, 0), (x, 3)], section, elements=4, degree=3) for x in (0, 4))
    scene.add_beam([left.end, right.end], section, elements=4, degree=3)
    for post in (left, right):
        scene.clamp(post.start)
        scene.add_force(post.end, (0, -load))
    return scene, left


def test_a_portal_frame_sways_at_the_root_of_its_stability_functions():
    # Clamped posts of length h, a girder of length l: kh cot(kh) = -6 h/l, with P = k^2 EI.
    scene, _ = portal(1.0)
    kh = brentq(lambda kh: kh / math.tan(kh) + 6 * 3 / 4, 1.6, 3.1)
    assert fb.buckling(scene, n=1).load_factors == pytest.approx([10 * (kh / 3) ** 2], rel=1e-4)


def test_a_stiff_frame_buckles_where_its_path_of_equilibria_branches():
    scene, _ = portal(8.0)
    (point,) = fb.static(scene, load_steps=4).critical_points
    assert fb.buckling(scene, n=1).load_factors == pytest.approx([point.load_factor], rel=1e-5)


@pytest.mark.parametrize("side", [0.0, 0.1, 1.0])
def test_bending_before_the_critical_load_does_not_count(side):
    scene, beam = column()
    scene.clamp(beam.start)
    scene.add_force(beam.end, (side, -1.0))
    assert fb.buckling(scene, n=1).load_factors == pytest.approx([EULER / 4], rel=1e-5)


def test_a_strut_of_a_spring_on_a_side_spring_buckles_at_its_stiffness_times_its_length():
    scene, node = held_body((0, 2.0), 1.0, 1.0, "rotation")
    scene.add_force_between(node, (0, 0), spring=fb.Spring(1e6, rest=2.0))
    scene.add_force_between(node, (3.0, 2.0), spring=fb.Spring(7.0, rest=3.0))
    scene.add_force(node, (0, -1.0))
    assert fb.buckling(scene).load_factors == pytest.approx([14.0], rel=1e-7)


def test_a_force_across_a_rod_couples_its_stretch_with_its_turn():
    """K of stretch e and turn psi, with an inclined spring: N psi^2 - 2 Q e psi by the forces."""
    EA, turning, inclined = 100.0, 2.0, 3.0
    scene, rod = one_bar((1, 0), fb.Section(EA=EA, GA=1e9, EI=1e9), elements=1, load=(0.0, 1.0))
    scene.add_joint(fb.Revolute(fb.GROUND, rod.start, spring=fb.Spring(turning)))
    scene.add_spring(rod.end, x=fb.Spring(inclined), axis=(1, 1))
    K = np.diag([EA, turning]) + inclined / 2
    N, Q = np.linalg.solve(K, [0.0, 1.0]) * (EA, turning)
    factors = 1 / np.linalg.eigvals(np.linalg.solve(K, [[0.0, Q], [Q, -N]])).real
    lowest = factors[factors > 0].min()
    assert fb.buckling(scene, n=1).load_factors[0] == pytest.approx(lowest, rel=1e-6)


def test_a_force_across_a_slide_couples_it_with_the_turn_of_its_guide():
    """A block at the hinge of its guide: K of turn psi and slide s, and -P s psi by the force."""
    scene, turning, sliding = fb.Scene(), 2.0, 8.0
    guide, block = (scene.add_body((0, 0), mass=1.0, inertia=1.0).centre for _ in range(2))
    scene.add_joint(fb.Revolute(fb.GROUND, guide, spring=fb.Spring(turning)))
    scene.add_joint(fb.Prismatic(guide, block, axis=(1, 0), spring=fb.Spring(sliding)))
    scene.add_force(block, (0, 1.0))
    factor = math.sqrt(turning * sliding)
    assert fb.buckling(scene).load_factors == pytest.approx([factor], rel=1e-9)


def frame_with_brackets(load, stiff):
    """A deck on two posts, on brackets that are stiff members or rigid joints."""
    scene, section = fb.Scene(), fb.Section(EA=1e4, GA=1e4, EI=10.0)
    left = scene.add_beam([(0, 0), (0, 1)], section, elements=4)
    right = scene.add_beam([(2, 0), (2, 1.2)], section, elements=4)
    deck = scene.add_beam([(0.2, 1.1), (1.7, 1.3)], section, elements=4)
    scene.clamp(left.start)
    scene.pin(right.start)
    for a, b in ((left.end, deck.start), (deck.end, right.end)):
        if stiff:
            scene.add_beam([a, b], fb.Section(EA=stiff, GA=stiff, EI=stiff), elements=1)
        else:
            scene.add_joint(fb.Rigid(a, b, offset=(b.x - a.x, b.y - a.y)))
    scene.add_force(deck.node(0.5), load)
    return scene


def test_about_a_state_a_rigid_joint_is_a_stiff_member():
    stiff, rigid = (
        fb.buckling(
            frame_with_brackets((0.3, -1.0), EA),
            fb.static(frame_with_brackets((1.0, -3.0), EA)),
            n=3,
        ).load_factors
        for EA in (1e8, None)
    )
    assert rigid == pytest.approx(stiff, rel=1e-5)


def with_stop(gap):
    scene, beam = column()
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0.1, -1.0))
    scene.add_force_between(beam.end, (1.0, 1.0), stop=(1.0 - gap, None, 1e5))
    return scene


@pytest.mark.parametrize("gap", [1e-3, 0.5])
def test_a_stop_that_is_open_stays_open(gap):
    assert fb.buckling(with_stop(gap), n=1).load_factors == pytest.approx([EULER / 4], rel=1e-5)


def test_a_stop_that_touches_is_refused():
    with pytest.raises(fb.SceneError, match="buckling: a stop, .* switches where the scene is at"):
        fb.buckling(with_stop(0.0))


def test_the_little_tension_of_a_spring_on_an_arm_does_not_count():
    """The line is long and soft: it has a force in the reference, and hardly a stiffness."""
    scene, beam = column()
    cantilever(scene, beam)
    arm = scene.add_body((0.5, 1), 1.0).centre
    scene.add_joint(fb.Rigid(beam.end, arm, offset=(0.5, 0)))
    scene.add_force_between(arm, (1e7, 1), fb.Spring(1e-4, rest=1e7 - 0.5 - 0.2))
    scene.add_force(beam.end, (0, -1.0))
    assert fb.buckling(scene, n=1).load_factors == pytest.approx([EULER / 4], rel=1e-3)


def test_a_frame_with_a_slide_has_the_load_factors_of_its_mirror_image():
    """One after the other: the second has the set-up of the first, with its own joints."""

    def frame(side):
        scene, section = fb.Scene(), fb.Section(EA=1e5, GA=1e5, EI=50.0)
        left = scene.add_beam([(0, 0), (0.3 * side, 1)], section, elements=4)
        right = scene.add_beam([(0.4 * side, 1.05), (0.5 * side, 2)], section, elements=4)
        scene.clamp(left.start)
        slide = {"axis": (side, 0.4), "offset": (0.1 * side, 0.05), "spring": fb.Spring(300.0)}
        scene.add_joint(fb.Prismatic(left.end, right.start, **slide))
        scene.add_force(right.end, (3.0 * side, -10.0))
        return scene

    frames = [frame(side) for side in (1.0, -1.0)]
    first, other = (fb.buckling(scene, n=2).load_factors for scene in frames)
    assert other == pytest.approx(first, rel=1e-8)


def test_a_beam_under_a_moment_alone_has_no_load_factor_of_round_off():
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (0.7, 0.4), (1.1, 1.3)], STIFF, elements=[3, 4], degree=2)
    scene.clamp(beam.start)
    scene.add_moment(beam.end, 0.3)
    assert_refused("no positive load factor", fb.buckling, scene)


def test_pictures_have_the_load_factors(tmp_path):
    scene, _ = portal(1.0)
    modes = fb.buckling(scene, n=2)
    picture = fb.plot.modes(modes, tmp_path / "modes.png")
    assert [ax.get_title() for ax in picture.axes] == [
        f"mode {k + 1}: load factor {factor:.3g}" for k, factor in enumerate(modes.load_factors)
    ]


def following(scene, beam):
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0, -1.0), follower=True)


def pulled(scene, beam):
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0, 1.0))


def heated_later(scene, beam):
    two_clamps(scene, beam)
    scene.add_natural_strain(beam, axial=lambda t: 1e-7 * t)


def loose(scene, beam):
    scene.pin(beam.start)
    scene.add_force(beam.end, (0, -1.0))


@pytest.mark.parametrize("elements", [4, 40])
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (following, "the scene has loads that follow the motion"),
        (pulled, "no positive load factor: the loads make nothing unstable"),
        (cantilever, "no load acts at t = 0"),
        (heated_later, "no load acts at t = 0. .* the t at which loads"),
        (loose, "no stable equilibrium|can rotate about"),
    ],
)
def test_what_has_no_buckling_load_is_refused(make, message, elements):
    scene, beam = column(elements)
    make(scene, beam)
    assert_refused(message, fb.buckling, scene)


@pytest.mark.parametrize("degree", [1, 3])
def test_a_bar_in_tension_buckles_by_shear_alone_which_is_said(caplog, degree):
    """Its factor is that of N = GA, where steel would be stretched by a third."""
    section = fb.Section.rectangle(0.01, 0.02, *fb.materials.steel)
    scene, bar = one_bar((1, 0), section, 8, degree)
    scene.clamp(bar.start)
    load = scene.add_force(bar.end, (section.GA, 0.0))
    assert fb.buckling(scene, n=1).load_factors == pytest.approx([1.0], rel=1e-3)
    assert "stretched by 32 %" in caplog.text and "by shear only, near N = GA" in caplog.text
    caplog.clear()
    scene.change(load, (-1.0, 0.0))
    euler = EULER / 4 * section.EI
    assert fb.buckling(scene, n=4).load_factors[0] == pytest.approx(euler, rel=1e-2)
    assert not caplog.records


def test_a_state_that_is_unstable_is_refused():
    scene, beam = column()
    two_hinges(scene, beam)
    scene.add_force(beam.end, (0, -12.0))
    state = fb.static(scene, load_steps=1)
    assert_refused("no stable equilibrium", fb.buckling, scene, state)
