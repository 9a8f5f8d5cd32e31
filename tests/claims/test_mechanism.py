"""Mechanisms without mass or support: chains, loops, trusses, singular positions, in all units."""

import re

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, one_bar, pinned_bar

import fx_beam as fb

STIFF = {"EA": 1e6, "GA": 1e6, "EI": 1e3}
LIGHT, HEAVY = fb.Section(**STIFF), fb.Section(**STIFF, rhoA=1.0, rhoI=0.01)


def check_static(scene):
    """An equilibrium, for which no part may move freely."""
    fb.static(scene, load_steps=1)


def check_moving(scene):
    """A step, for which parts without mass may not move freely."""
    fb.simulate(scene, dt=0.01, t_end=0.01)


def chain(places, section=LIGHT, ends=(True, True), spring=lambda k: None):
    """Links from place to place, hinged to one another and, at held ends, to the ground."""
    scene = fb.Scene()
    links = [
        scene.add_beam([a, b], section, elements=1)
        for a, b in zip(places[:-1], places[1:], strict=True)
    ]
    for k, (first, second) in enumerate(zip(links[:-1], links[1:], strict=True), start=1):
        scene.add_joint(fb.Revolute(first.end, second.start, spring=spring(k)))
    if ends[0]:
        scene.pin(links[0].start)
    if ends[1]:
        scene.pin(links[-1].end)
    return scene, links


# -- Chains and singular positions -------------------------------------------------------------


def test_a_three_hinged_arch_holds_and_in_line_it_does_not():
    for size in (1e-9, 1.0, 1e9):
        section = fb.Section(**STIFF | {"EI": 1e3 * size**2})
        arch, _ = chain([(0, 0), (size, size), (2 * size, 0)], section)
        check_static(arch)
        check_moving(arch)
        flat, _ = chain([(0, 0), (size, 0), (2 * size, 0)], section)
        for check in (check_static, check_moving):
            assert_refused(r"can rotate about \((0|2e?[-+0-9]*), 0\)", check, flat)


@pytest.mark.parametrize("links", [3, 100])
def test_a_chain_without_mass_between_two_pins_is_refused_and_with_it_accepted(links):
    angles = np.linspace(0, np.pi, links + 1)
    places = np.column_stack([-np.cos(angles), np.sin(angles)])
    for check in (check_static, check_moving):
        with pytest.raises(fb.SceneError, match="can rotate about"):
            check(chain(places)[0])
    check_moving(chain(places, HEAVY)[0])
    with pytest.raises(fb.SceneError, match="Static analysis is singular: beam .* Add a support"):
        check_static(chain(places, HEAVY)[0])


@pytest.mark.parametrize("free", [None, 1, 50, 98])
def test_in_a_long_cantilever_of_springs_the_one_free_hinge_is_found(free):
    # All rates but one are held, over 99 joints in a row.
    def spring(k):
        return None if k == free else fb.Spring(1.0)

    places = np.column_stack([np.arange(100.0), np.zeros(100)])
    scene, links = chain(places, ends=(False, False), spring=spring)
    scene.clamp(links[0].start)
    if free is None:
        check_static(scene)
    else:
        assert_refused(rf"can rotate about \({free}, 0\) as a rigid", check_static, scene)


@pytest.mark.parametrize("angle", [1.0, 1e-3, 0.0])
def test_a_parallelogram_in_line_has_one_motion_more(angle):
    # Two cranks and a coupler, all without mass, the coupler held by a spring on the first crank.
    # In line the second crank may turn the other way.
    crank = np.array([np.cos(angle), np.sin(angle)])
    scene, first = one_bar([(0, 0), crank], LIGHT, elements=1)
    coupler = scene.add_beam([crank, crank + (3, 0)], LIGHT, elements=1)
    second = scene.add_beam([(3, 0), crank + (3, 0)], LIGHT, elements=1)
    scene.add_joint(fb.Revolute(fb.GROUND, first.start, spring=fb.Spring(stiffness=1.0)))
    scene.add_joint(fb.Revolute(fb.GROUND, second.start))
    scene.add_joint(fb.Revolute(first.end, coupler.start))
    scene.add_joint(fb.Revolute(coupler.end, second.end))
    if angle:
        check_static(scene)
    else:
        assert_refused("can rotate about", check_static, scene)


# -- What mass holds ---------------------------------------------------------------------------


@pytest.mark.parametrize(("mass", "size"), [(1e-30, 1e-9), (1.0, 1.0), (1e30, 1e9)])
def test_a_mass_counts_whatever_its_unit(mass, size):
    # One that is light beside another one, and inertia on an arm that turns about its pin.
    scene, arm = pinned_bar((size, 0), LIGHT, elements=1)
    other = scene.add_beam([(0, size), (size, size)], LIGHT, elements=1)
    scene.add_mass(other.start, 1.0, size**2)
    assert_refused(r"can rotate about \(0, 0\) .*without mass", check_moving, scene)
    scene.add_mass(arm.end, 0.0, mass * size**2)
    check_moving(scene)


def test_masses_in_one_place_let_a_part_turn_about_it_and_in_two_do_not():
    scene, beam = one_bar((3, 4), LIGHT, elements=2)
    scene.add_mass(beam.end, 1.0)
    scene.add_mass(beam.end, 2.0)
    assert_refused(r"beam 'beam 1' can rotate about \(3, 4\)", check_moving, scene)
    scene.add_mass(beam.start, 1e-20)
    check_moving(scene)


def test_the_beams_of_the_body_that_moves_are_named():
    scene, hub = one_bar((1, 0), LIGHT, name="spoke 0", elements=1)
    for k in (1, 2, 3, 4):
        scene.add_beam([hub.start, (np.cos(k), np.sin(k))], LIGHT, name=f"spoke {k}", elements=1)
    scene.clamp(scene.add_beam([(5, 0), (6, 0)], LIGHT, name="post", elements=1).start)
    scene.pin(hub.start)
    named = r"beams 'spoke 0', 'spoke 1', 'spoke 2' and 2 more can rotate about \(0, 0\) as a rigid"
    assert_refused(named, check_static, scene)


# -- Against another algorithm -----------------------------------------------------------------


def is_refused(check, scene):
    """Whether a check refuses a scene."""
    try:
        check(scene)
    except fb.SceneError as error:
        return bool(re.search("can (rotate|move)", str(error)))
    return False


def random_mechanism(rng):
    """Links on a grid, many of them in line or in loops, with or without mass, joined at random."""
    scene, nodes = fb.Scene(), {}
    grid = [(x, y) for x in range(3) for y in range(3)]
    for _ in range(rng.integers(2, 7)):
        ends = [grid[k] for k in rng.choice(9, 2, replace=False)]
        beam = scene.add_beam(ends, LIGHT if rng.random() < 0.7 else HEAVY, elements=1)
        for place, node in zip(ends, (beam.start, beam.end), strict=True):
            if place in nodes and rng.random() < 0.9:
                kind = rng.integers(4)
                if kind < 3:
                    scene.add_joint(fb.Revolute(nodes[place], node))
                else:
                    scene.add_joint(fb.PinInSlot(nodes[place], node, axis=(1, rng.integers(2))))
            nodes.setdefault(place, node)
    for node in nodes.values():
        for component, often in (("x", 0.7), ("y", 0.7), ("rotation", 0.2)):
            if rng.random() < often:
                scene.fix(node, component)
    return scene


def can_move(scene, at_rest):
    """Whether links can move, by dense algebra: velocities of both ends of each as unknowns."""
    links = scene.beams
    rows, columns = [], 4 * len(links)

    def end(node):
        """Velocity of a node (2, columns) and rotation of its link (columns)."""
        number = next(k for k, link in enumerate(links) if node in (link.start, link.end))
        link, own = links[number], np.eye(columns)[4 * number : 4 * number + 4]
        along = np.array([link.end.x - link.start.x, link.end.y - link.start.y])
        across = np.array([-along[1], along[0]]) / (along @ along)
        return own[:2] if node is link.start else own[2:], across @ (own[2:] - own[:2])

    for link in links:
        (start, _), (stop, _) = end(link.start), end(link.end)
        along = np.array([link.end.x - link.start.x, link.end.y - link.start.y])
        rows.append(along @ (stop - start))
        if not at_rest and link.section is HEAVY:
            rows += [*start, *stop]
    for number, component in scene.fixed:
        velocity, turn = end(scene.nodes[number])
        rows.append(turn if component == 2 else velocity[component])
    for joint in scene.joints:
        gap = end(joint.b)[0] - end(joint.a)[0]
        rows += (
            list(gap) if joint.axis is None else [np.array([-joint.axis[1], joint.axis[0]]) @ gap]
        )
    return np.linalg.matrix_rank(np.array(rows), tol=1e-8) < columns


@pytest.mark.parametrize("check", [check_static, check_moving])
def test_random_mechanisms_are_refused_where_dense_algebra_finds_a_motion(check):
    rng = np.random.default_rng(10)
    moving = 0
    for _ in range(50):
        scene = random_mechanism(rng)
        expected = can_move(scene, check is check_static)
        assert is_refused(check, scene) == expected
        moving += expected
    assert 5 < moving < 45


# -- Point masses ------------------------------------------------------------------------------


def hanging(by_body, inertia=0.0, held=False):
    """A mass of 100 kg on a spring of 40 N/mm under its weight."""
    scene = fb.Scene(gravity=(0, -9.81))
    if by_body:
        node = scene.add_body((0, -0.3), mass=100.0, inertia=inertia).centre
    else:
        light = fb.Section(EA=1e4, GA=1e4, EI=1e4)
        node = scene.add_beam([(0, -0.3), (0.1, -0.3)], light, elements=1).start
        scene.add_mass(node, 100.0, inertia)
    scene.add_force_between(node, (0, 0), spring=fb.Spring(4e4, rest=0.2))
    if held:
        scene.fix(node, "rotation")
    return scene, node


@pytest.mark.parametrize(
    "analysis",
    [
        lambda scene: fb.simulate(scene, dt=1e-3, t_end=0.01),
        fb.modes,
        fb.linearise,
        lambda scene: fb.periodic(scene, mode=0, amplitude=0.01),
    ],
)
def test_a_point_mass_that_may_turn_is_told_of_its_inertia_or_a_support(analysis):
    scene, _ = hanging(True)
    with pytest.raises(fb.SceneError) as error:
        analysis(scene)
    for words in ("body 1 can rotate", "add_body(..., inertia=...)", 'fix(node, "rotation")'):
        assert words in str(error.value)
    assert "section" not in str(error.value)


def test_a_node_with_a_mass_that_may_turn_is_told_of_add_mass():
    scene, beam = clamped_bar((1, 0), fb.Section(EA=1e4, GA=1e4, EI=1e4, rhoA=1.0), elements=1)
    bob = scene.add_body((1, -1), mass=0.0).centre
    scene.add_force_between(bob, beam.end, spring=fb.Spring(10.0))
    assert_refused(r"add_mass\(node, mass, inertia=...\)", fb.modes, scene)
    scene.add_mass(bob, 1.0)
    assert_refused(r'inertia=...\).* fix\(node, "rotation"\)', fb.modes, scene)


@pytest.mark.parametrize(("inertia", "held"), [(0.3, False), (0.0, True), (0.3, True)])
def test_with_what_the_message_names_a_point_mass_swings_as_the_closed_form(inertia, held):
    # y = ye + (y0 - ye) cos(w t) with k (l - rest) = m g at rest.
    scene, node = hanging(True, inertia, held)
    w = np.sqrt(4e4 / 100)
    motion = fb.simulate(scene, dt=1e-3, t_end=1.0)
    still = -0.2 - 9.81 / w**2
    exact = still + (-0.3 - still) * np.cos(w * motion.t)
    phase = w * (w * 1e-3) ** 2 / 12  # after 1 s, as the periods of the scheme are longer
    assert abs(motion.position(node)[:, 1] - exact).max() < 1.1 * phase * abs(-0.3 - still)


@pytest.mark.parametrize("inertia", [0.0, 0.3])
def test_a_point_mass_in_statics_is_told_which_support_it_needs(inertia):
    scene, node = hanging(True, inertia)
    assert_refused(r'rotation of node 0 .* fix\(node, "rotation"\)', fb.static, scene)
    scene.fix(node, "rotation")
    end = fb.static(scene).position(node)[-1]
    assert end == pytest.approx([0.0, -0.2 - 100 * 9.81 / 4e4], abs=1e-9)


def test_a_mass_on_a_guide_that_may_turn_is_no_raw_error():
    scene = fb.Scene(gravity=(0, -9.81))
    a, b = (scene.add_body((0, y), mass=1.0).centre for y in (-0.3, -1.3))
    scene.add_joint(fb.Prismatic(fb.GROUND, a, axis=(1, 0)))
    scene.add_joint(fb.Revolute(a, b, offset=(0, -1.0)))
    assert_refused("nothing acts on rotation of node 1", fb.static, scene)
    scene.fix(b, "rotation")
    assert_refused(r'x of node 0 .*free.*fix\(node, "x"\)', fb.static, scene)
