"""Contact of members with members and with themselves: invariants, balances, search, bad input."""

import re

import numpy as np
import pytest
from scenes import clamped_bar, one_bar, one_body, supported_bar

import fx_beam as fb

SECTION = fb.Section(EA=1e4, GA=4e3, EI=10.0, rhoA=1.0, rhoI=1e-3)


def tip_on_beam(stiffness=1e5, **options):
    """A free beam that falls with its tip on another one, which is free as well."""
    scene, below = one_bar((2, 0), SECTION, elements=8, name="below")
    above = scene.add_beam([(0.7, 0.3), (1.1, 1.6)], SECTION, elements=8, name="above")
    contact = scene.add_contact(above, below, stiffness=stiffness, radius=0.05, **options)
    scene.set_velocity(above, (0.3, -2.0), spin=0.5)
    return scene, contact


def assert_conserved(solution):
    start = solution.energy.kinetic[0]
    assert abs(solution.energy.balance_error).max() < 1e-12 * start
    assert np.ptp(solution.linear_momentum, axis=0).max() < 1e-12
    assert np.ptp(solution.angular_momentum) < 1e-12


def test_an_impact_where_nodes_slide_on_beams_keeps_energy_and_both_momenta():
    """A bar hits a beam, and the rod on which both ends of this beam slide, about such an end."""
    friction = fb.Coulomb(0.4, 5e4)
    scene, rod = one_bar((2, 0), SECTION, elements=8)
    shuttle = scene.add_beam([(0.6, 0), (0.9, 0.3), (1.2, 0)], SECTION, elements=4)
    scene.add_joint(fb.Slider(rod, shuttle.start))
    scene.add_joint(fb.Sleeve(rod, shuttle.end))
    bar = scene.add_beam([(0.45, 0.08), (0.4, 1.0)], SECTION, elements=7)
    for other in (shuttle, rod):
        scene.add_contact(bar, other, stiffness=1e5, radius=0.03, friction=friction)
    scene.set_velocity(bar, (3.0, -0.6), spin=-0.5)
    solution = fb.simulate(scene, dt=2e-3, t_end=0.1)
    assert_conserved(solution)
    # It touches beam and rod about the end that slides; the tangent is exact. Its sections turn on
    # those of the beam: some steps find where they stick, with an iteration more.
    assert all(solution.contact(one).normal.max() > 1 for one in scene.contacts)
    assert solution.stats.newton_iterations < 3.5 * solution.stats.steps


@pytest.mark.parametrize("dt", [1e-3, 4e-3])
def test_sliding_from_segment_to_segment_and_over_ends_keeps_them(dt):
    """A bar slides along another one, and over its end."""
    scene, below = one_bar((2, 0), SECTION, elements=16)
    above = scene.add_beam([(0.3, 0.1005), (2.2, 0.1005)], SECTION, elements=13)
    contact = scene.add_contact(above, below, stiffness=1e5, radius=(0.04, 0.06))
    scene.set_velocity(above, (4.0, -0.2), spin=0.3)
    solution = fb.simulate(scene, dt=dt, t_end=0.8)
    assert_conserved(solution)
    pushed = abs(solution.contact(contact).force[..., 1]) > 1e-9
    # Many nodes touch one after the other, until the bar is behind the end.
    assert pushed.any(axis=0).sum() > 6
    assert solution.position(above.start)[-1, 0] > 2.0
    assert solution.stats.halvings == 0


def test_a_node_may_slide_by_most_of_an_element_in_a_step():
    scene, below = clamped_bar((2, 0), SECTION, elements=100, gravity=(0, -9.81))
    above = scene.add_beam([(0.21, 0.1005), (0.81, 0.1005)], SECTION, elements=5)
    scene.clamp(below.end)
    scene.add_contact(above, below, stiffness=1e4, radius=0.05)
    scene.set_velocity(above, (4.0, -0.1))
    solution = fb.simulate(scene, dt=4e-3, t_end=0.2)
    assert solution.stats.halvings == 0
    assert solution.energy.springs.max() > 1e-3
    assert abs(solution.energy.balance_error).max() < 1e-12 * solution.energy.kinetic[0]


def test_a_member_touches_itself_and_not_its_neighbours():
    """A bent rod whose legs swing against one another."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 9)
    bend = np.column_stack([0.3 * np.cos(angle), 0.3 * np.sin(angle)])
    leg = np.column_stack([np.linspace(-1.5, -0.1, 10), np.full(10, -0.3)])
    points = np.vstack([leg, bend, leg[::-1] * (1, -1)])
    scene, rod = one_bar(points.tolist(), SECTION, elements=len(points) - 1)
    contact = scene.add_contact(rod, rod, stiffness=1e5, radius=0.05)
    scene.set_velocity(rod, lambda x, y: (0.0, -3 * np.sign(y) if x < -0.5 else 0.0))
    solution = fb.simulate(scene, dt=1e-3, t_end=0.4)
    assert_conserved(solution)
    gap, force = solution.contact(contact).gap, solution.contact(contact).force
    assert -0.05 < gap.min() < -1e-3
    assert abs(force).max() > 1.0
    # Forces of a member on itself have no sum; at the start nothing touches.
    assert abs(force.sum(axis=1)).max() < 1e-11 * abs(force).max()
    assert not force[:50].any()


def test_what_restitution_takes_is_in_the_balance():
    scene, _ = tip_on_beam(restitution=0.5, speed=0.01)
    solution = fb.simulate(scene, dt=2e-3, t_end=0.3)
    assert_conserved(solution)
    assert solution.energy.dissipated[-1] > 0.05
    assert np.diff(solution.energy.dissipated).min() > -1e-14


@pytest.mark.parametrize("turned", [False, True])
def test_slip_stretch_and_force_of_friction_are_recorded(turned, tmp_path):
    scene = fb.Scene()
    ends = [(0, 0), (1, 0)]
    bed = scene.add_beam(ends[::-1] if turned else ends, SECTION, elements=7)
    for node in bed.nodes:
        scene.clamp(node)
    ball = scene.add_body((0.3, 0.0501), mass=1.0, inertia=0.1).centre
    scene.fix(ball, "rotation")
    scene.prescribe(ball, y=lambda t: -1.1e-3 * min(t / 0.01, 1.0))
    scene.set_velocity(ball, (1.0, 0.0))
    options = {"stiffness": 1e4, "friction": fb.Coulomb(0.3, 1e4, damping=0.0)}
    touch = scene.add_contact(ball, bed, radius=(0.03, 0.02), **options)
    fb.simulate(scene, dt=2e-3, t_end=0.5).save(tmp_path / "run.npz")
    solution = fb.load(tmp_path / "run.npz")
    contact, x = solution.contact(touch), solution.position(ball)[:, 0]
    normal, tangential, stretch = contact.normal, contact.tangential, contact.stretch
    assert normal[10:] == pytest.approx(10.0, rel=1e-7)
    # Who looks along the normal, upwards, has -x to the left: there the friction is positive.
    assert tangential == pytest.approx(-1e4 * stretch, abs=1e-6)
    assert (abs(tangential) <= 0.3 * normal * (1 + 1e-7)).all()
    assert tangential[20:100] == pytest.approx(3.0, rel=1e-7)
    way = -(contact.slip + stretch)[:, 0]
    assert way[10:] - way[10] == pytest.approx(x[10:] - x[10], abs=1e-12)
    # While the force rises from 0 to 10 N, in 10 ms, the ball loses 0.015 m/s.
    assert x[-1] - 0.3 == pytest.approx(0.01 - 5e-5 + 0.985**2 / 6, rel=1e-3)


def test_no_contact_is_lost_where_nodes_stand_between_elements():
    scene, below = clamped_bar((2, 0), SECTION, elements=10)
    above = scene.add_beam([(0.5, 0.2), (1.5, 0.2)], SECTION, elements=5)
    for node in above.nodes:
        scene.prescribe(node, y=lambda t: -0.5 * t * t)
        scene.fix(node, "x")
    scene.add_contact(below, above, stiffness=1e5, radius=0.03)
    solution = fb.simulate(scene, dt=1e-3, t_end=0.8)
    assert solution.energy.springs.max() > 0.1
    assert abs(solution.energy.balance_error).max() < 1e-12 * solution.energy.work.max()


def test_the_stiffness_is_that_of_both_members_per_length():
    scene, bed = one_bar((2, 0), SECTION, elements=8, gravity=(0, -9.81))
    for node in bed.nodes:
        scene.clamp(node)
    plank = scene.add_beam([(0, 0.1), (2, 0.1)], SECTION, elements=8)
    scene.fix(plank.start, "x")
    contact = scene.add_contact(plank, bed, stiffness=1e5, radius=0.05)
    scene.set_velocity(plank, (0.0, -1e-9))
    # It sinks in by q / k, and swings about there.
    solution = fb.simulate(scene, fb.EnergyDecaying(), dt=1e-3, t_end=0.4)
    sunk = -solution.contact(contact).gap[-200:].mean(axis=0)
    shares = [0.5, *[1.0] * 7, 0.5]
    assert np.average(sunk, weights=shares) == pytest.approx(9.81 / 1e5, rel=0.01)
    force = solution.contact(contact).force[-200:, :, 1].sum(axis=1).mean()
    assert force == pytest.approx(2.0 * 9.81, rel=0.01)


def test_in_equilibrium_the_reaction_is_the_force_of_the_contact():
    """A cantilever whose loaded tip rests on another one."""
    scene, below = clamped_bar((1, 0), SECTION, elements=6)
    above = scene.add_beam([(0.3, 0.11), (1.2, 0.11)], SECTION, elements=6)
    scene.clamp(above.end)
    scene.add_force(above.start, (0.0, -20.0))
    contact = scene.add_contact(above, below, stiffness=1e6, radius=0.05)
    solution = fb.static(scene)
    force = solution.contact(contact).force[-1].sum(axis=0)
    reaction = solution.reaction(below.start)[-1, :2]
    other = solution.reaction(above.end)[-1, :2]
    assert force == pytest.approx(reaction, abs=1e-8)
    assert reaction + other == pytest.approx([0.0, 20.0], abs=1e-8)
    assert force[1] > 10
    # In modes about this state the contact is a spring: the tips do not move apart.
    held = fb.modes(scene, solution, n=2).frequencies
    scene.remove(contact)
    free = fb.modes(scene, n=2).frequencies
    assert held[1] > 2 * free[1]
    assert held[0] < 2 * free[0]


def test_along_the_arc_length_an_arch_snaps_through_onto_a_member():
    x = np.linspace(-1, 1, 13)
    axis = np.column_stack([x, 0.2 * np.cos(np.pi * x / 2)])
    scene, arch = one_bar(axis.tolist(), SECTION, elements=12)
    below = scene.add_beam([(-0.28, -0.25), (0.33, -0.25)], SECTION, elements=5)
    for beam, hold in ((arch, scene.pin), (below, scene.clamp)):
        hold(beam.start)
        hold(beam.end)
    scene.add_force(arch.nodes[6], (0.0, -60.0))
    alone = fb.static(scene, load_steps=10, continuation="arc-length")
    contact = scene.add_contact(arch, below, stiffness=1e5, radius=0.02)
    solution = fb.static(scene, load_steps=10, continuation="arc-length")
    # Before it touches, the path is that without contact; then it ends higher.
    first = solution.stats.limit_points[0]
    assert first == pytest.approx(alone.stats.limit_points[0], abs=1e-8)
    assert solution.position(arch.nodes[6])[-1, 1] > alone.position(arch.nodes[6])[-1, 1] + 0.01
    assert solution.t[-1] == 1.0
    force = solution.contact(contact).force[-1].sum(axis=0)
    held = sum(solution.reaction(end)[-1, :2] for end in (arch.start, arch.end))
    below = sum(solution.reaction(end)[-1, :2] for end in (below.start, below.end))
    assert force == pytest.approx(below, abs=1e-7)
    assert held + below == pytest.approx([0.0, 60.0], abs=1e-7)
    assert force[1] > 10


@pytest.mark.parametrize("mu", [0.0, 0.4])
def test_a_closed_profile_has_no_seam(mu):
    """A roller on an eccentric disc that turns three times, wherever its profile begins."""
    radius, off, count = 0.05, 0.02, 60

    def lifted(first):
        scene, shaft = one_body((0, 0), mass=1.0, inertia=1e-2)
        scene.add_joint(fb.Revolute(fb.GROUND, shaft.centre, motor=lambda t: 2 * np.pi * t**2))

        def outline(f):
            angle = 2 * np.pi * (f + first / count)
            return radius * np.cos(angle), off + radius * np.sin(angle)

        rim = scene.add_beam(fb.Curve(outline), fb.Section(EA=1e6, GA=1e6, EI=1e2), elements=count)
        for node in rim.nodes:
            scene.add_joint(fb.Rigid(shaft.centre, node, offset=(node.x, node.y)))
        roller = scene.add_body((0, off + radius + 0.01), mass=0.2).centre
        spring = fb.Spring(2000.0, rest=-0.08)
        scene.add_joint(fb.Prismatic(fb.GROUND, roller, axis=(0, 1), spring=spring))
        friction = fb.Coulomb(mu, 1e5, damping=1e-3) if mu else None
        law = {"stiffness": 1e5, "friction": friction}
        contact = scene.add_contact(roller, rim, radius=(0.01, 1e-6), **law)
        solution = fb.simulate(scene, dt=5e-4, t_end=1.75)
        touch = solution.contact(contact)
        return solution.position(roller), touch.force, touch.gap, touch.normal

    for here, there in zip(lifted(0), lifted(17), strict=True):
        assert abs(here - there).max() < 1e-4 * abs(there).max()


def ball_over_beam(gap, **gravity):
    """A ball on a vertical rail over a clamped beam that is far thinner than the steps are long."""
    scene = fb.Scene(**gravity)
    section = fb.Section(EA=1e5, GA=1e5, EI=100.0, rhoA=1.0, rhoI=1e-4)
    beam = scene.add_beam([(0, 0), (2, 0)], section, elements=16)
    scene.clamp(beam.start)
    scene.clamp(beam.end)
    ball = scene.add_body((1.03, 0.025 + gap), mass=0.1, inertia=0.01).centre
    scene.fix(ball, "x", "rotation")
    return scene, ball, scene.add_contact(ball, beam, 1e5, radius=(0.02, 0.005))


@pytest.mark.parametrize("gap", [1e-6, 0.01, 0.3])
def test_a_ball_that_only_a_thin_beam_holds_comes_to_rest_on_it(gap):
    """Wherever it starts; without a stiffness it settles in steps of 0.4 m."""
    scene, ball, contact = ball_over_beam(gap, gravity=(0, -10))
    touch = fb.static(scene).contact(contact)
    assert touch.force[-1].sum(axis=0) == pytest.approx([0.0, 1.0], abs=1e-3)
    assert touch.gap[-1].min() == pytest.approx(-1e-5, rel=1e-5)


def test_a_thrown_ball_does_not_jump_over_a_thin_beam_between_two_steps():
    scene, ball, _ = ball_over_beam(0.475)
    scene.set_velocity(ball, (0, -20.0))
    solution = fb.simulate(scene, dt=0.01, t_end=0.1)
    assert solution.velocity(ball)[-1, 1] > 10.0
    assert abs(solution.energy.balance_error).max() < 1e-11


def test_a_node_that_would_pass_through_a_member_ends_the_run():
    scene, _ = tip_on_beam(stiffness=100.0)
    with pytest.raises(fb.StepError, match="passes through the middle of a member.*stiffness"):
        fb.simulate(scene, dt=2e-3, t_end=0.5)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"radius": 0.4}, "overlap at the start: at .* lies 0.5.* deep in beam 'below'"),
        ({}, "radius = 0.0 must be half of the thickness"),
        ({"radius": (0.1, -1)}, "radius = .* must be half of the thickness"),
        ({"radius": 0.1, "along": 2}, "along = 2, but members touch at their nodes"),
    ],
)
def test_bad_contact_of_members_is_an_error_that_says_what_to_do(options, message):
    scene, contact = tip_on_beam()
    scene.remove(contact)
    with pytest.raises(fb.SceneError, match=message):
        scene.add_contact(scene.beams[1], scene.beams[0], stiffness=1e5, **options)
    assert not scene.contacts


@pytest.mark.parametrize("thickness", [0.3, 0.1])
def test_a_member_that_rolls_up_tighter_than_what_touches_it_is_named(thickness, caplog):
    """A moment bends it to the radius EI / M = 0.29 about a pin."""
    scene, rolled = clamped_bar((1, 0), SECTION, elements=24, name="rolled")
    pin = scene.add_body((0.4, 0.06 + thickness), mass=1.0, inertia=1.0).centre
    scene.clamp(pin)
    scene.add_contact(pin, rolled, stiffness=2e4, radius=(thickness, 0.05))
    scene.add_moment(rolled.end, lambda t: 70.0 * t)
    if thickness < 0.2:
        fb.simulate(scene, dt=2e-3, t_end=0.5)
        assert not caplog.text
    else:  # the nearest point of the member is nowhere any more
        with pytest.raises(fb.StepError):
            fb.simulate(scene, dt=2e-3, t_end=0.5)
        said = r"'rolled' has the radius of curvature 0\.3\d+ at .* touched inside its bend"
        assert re.search(said, caplog.text)


def test_an_open_contact_does_not_change_the_modes_of_a_beam_with_a_bead_on_it():
    def frequencies(contact):
        scene, below = supported_bar((2, 0), SECTION, elements=8)
        above = scene.add_beam([(0.7, 0.3), (1.1, 1.6)], SECTION, elements=2)
        bead = scene.add_beam([(0.5, 0), (0.5, 0.3)], SECTION, elements=1)
        scene.clamp(above.end)
        scene.add_joint(fb.Slider(below, bead.start, spring=fb.Spring(50.0)))
        if contact:
            scene.add_contact(above, below, stiffness=1e5, radius=0.05)
        return fb.modes(scene, n=8).angular_frequencies

    assert frequencies(contact=True) == pytest.approx(frequencies(contact=False), rel=1e-9)
