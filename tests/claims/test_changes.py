"""Scenes that change between runs: released, cut, caught, other members, loads and supports."""

import copy
import operator
import pickle

import ufl

import numpy as np
import pytest
import scenes
from scenes import assert_refused, clamped_bar, held_body, one_bar, one_body, pinned_bar

import fx_beam as fb

MEMBER = fb.Section(EA=1e4, GA=1e4, EI=1e2, rhoA=1.0, rhoI=0.01)
SECTION = fb.Section(EA=1e6, GA=1e7, EI=1e3, rhoA=1.0, rhoI=1e-3)
CONSERVING = pytest.mark.parametrize(
    "scheme", [fb.EnergyMomentum(), fb.EnergyMomentum(order=4)], ids=["order 2", "order 4"]
)
SCHEMES = pytest.mark.parametrize(
    "scheme",
    [fb.EnergyMomentum(), fb.EnergyMomentum(order=4), fb.EnergyDecaying(), fb.Newmark()],
    ids=["order 2", "order 4", "decaying", "Newmark"],
)


def supplied_and_stored(energy, row):
    """Quantities that do not change, also where a scene changes."""
    stored = energy.total[row] + energy.algorithmic[row]
    return stored - energy.work[row] + energy.dissipated[row] + energy.impact[row]


def chain():
    """Two links that swing, the second with a mass at its end."""
    scene, first = pinned_bar((1, 0), MEMBER, elements=3, name="first", gravity=(0, -9.81))
    second = scene.add_beam([(1, 0), (2, 0)], MEMBER, elements=2, name="second")
    hinge = scene.add_joint(fb.Revolute(first.end, second.start))
    scene.add_mass(second.end, 0.5)
    return scene, first, second, hinge


def pendulum():
    scene = fb.Scene(gravity=(0, -9.81))
    body = scene.add_body((1, 0), mass=2.0, inertia=0.1, points={"pin": (0, 0)})
    return scene, body, scene.add_joint(fb.Revolute(fb.GROUND, body["pin"]))


def cantilever(elements=8):
    return clamped_bar((2, 0), SECTION, elements=elements, degree=2)


# -- Released and cut ------------------------------------------------------------------------------


@CONSERVING
def test_a_cut_pendulum_flies_on_a_parabola(scheme):
    scene, body, pin = pendulum()
    first = fb.simulate(scene, scheme, dt=0.01, t_end=0.5)
    scene.remove(pin)
    second = fb.simulate(scene, scheme, t_end=0.9, dt=0.01, start=first)
    t = (second.t - 0.5)[:, None]
    start, speed = first.position(body.centre)[-1], first.velocity(body.centre)[-1]
    parabola = start + t * speed + t**2 / 2 * np.array([0, -9.81])
    assert abs(second.position(body.centre) - parabola).max() < 1e-12
    assert np.ptp(second.spin(body.centre)) < 1e-11
    for momentum in ("linear_momentum", "angular_momentum"):
        jump = getattr(second, momentum)[0] - getattr(first, momentum)[-1]
        assert abs(jump).max() < 1e-12 * abs(first.angular_momentum).max()
    # Rates of steps have a part that the pin does not allow, of order 2; it ends with the pin.
    assert 0 <= second.energy.impact[0] < 1e-6
    assert abs(second.energy.balance_error).max() < 1e-11


@SCHEMES
def test_a_cut_keeps_momenta_and_the_balance(scheme):
    scene, first, second, hinge = chain()
    whole = fb.simulate(scene, scheme, dt=0.01, t_end=0.3)
    scene.remove(hinge)
    cut = fb.simulate(scene, scheme, dt=0.01, t_end=0.4, start=whole)
    assert abs(cut.linear_momentum[0] - whole.linear_momentum[-1]).max() < 1e-12
    assert abs(cut.angular_momentum[0] - whole.angular_momentum[-1]) < 1e-11
    before, after = supplied_and_stored(whole.energy, -1), supplied_and_stored(cut.energy, 0)
    assert after == pytest.approx(before, abs=1e-11)
    assert not cut.joint(hinge).force[1:].any()
    if cut.stats.level != 0.5:
        return  # forces are not means over the steps
    # What is cut off falls freely.
    fall = np.diff(cut.linear_momentum[:, 1]) - np.diff(cut.t) * -9.81 * 2.5
    up = cut.reaction(first.start)[1:, 1] * np.diff(cut.t)
    assert fall == pytest.approx(up, abs=1e-9)


def test_a_prestressed_cantilever_is_released():
    """The free vibration of the first mode, from the static deflection by an end force."""
    length, EI, rhoA = 1.0, 100.0, 1.0
    section = fb.Section(EA=1e8, GA=1e8, EI=EI, rhoA=rhoA)
    scene, beam = clamped_bar((length, 0), section, elements=8, degree=2)
    scene.prescribe(beam.end, y=lambda t: -1e-3 * t)
    held = fb.static(scene, t=1.0)
    scene.free(beam.end, "y")
    released = fb.simulate(scene, dt=2e-3, t_end=1.4, start=held)
    y = released.displacement(beam.end)[:, 1]
    assert y[0] == pytest.approx(-1e-3, rel=1e-9)
    omega = 1.875104**2 * np.sqrt(EI / rhoA) / length**2
    turning = np.flatnonzero((y[1:-1] < y[:-2]) & (y[1:-1] < y[2:]) & (y[1:-1] < -5e-4))
    assert released.t[turning[0] + 1] - 1.0 == pytest.approx(2 * np.pi / omega, rel=0.03)
    assert abs(released.energy.balance_error).max() < 1e-11 * abs(held.energy.total[-1])


# -- Caught ----------------------------------------------------------------------------------------


@SCHEMES
def test_a_falling_bar_that_is_caught_at_its_end_keeps_its_angular_momentum_about_it(scheme):
    m, half, v = 3.0, 0.5, 2.0
    scene, bar = one_body((half, 0), m, m * (2 * half) ** 2 / 12, points={"end": (0, 0)})
    scene.set_velocity(bar, (0.0, -v))
    falling = fb.simulate(scene, scheme, dt=0.01, t_end=0.1)
    scene.pin(bar["end"])
    caught = fb.simulate(scene, scheme, dt=0.01, t_end=0.2, start=falling)
    # m v L/2 = (m L^2 / 3) omega; a quarter of the energy is lost.
    assert caught.spin(bar.centre)[0] == pytest.approx(-1.5 * v / (2 * half), rel=1e-12)
    assert caught.energy.impact == pytest.approx(0.25 * m * v**2 / 2, rel=1e-12)
    assert caught.energy.kinetic[0] == pytest.approx(0.75 * m * v**2 / 2, rel=1e-12)
    assert caught.velocity(bar["end"])[0] == pytest.approx([0, 0], abs=1e-13)
    if scheme.name != "Newmark":
        assert abs(caught.energy.balance_error).max() < 1e-12
        stays = caught.position(bar["end"]) - falling.position(bar["end"])[-1]
        assert abs(stays).max() < 1e-13


def test_a_driven_support_that_catches_does_work():
    """A mass at rest that is caught by a carriage of the speed v: work m v^2, half of it lost."""
    scene, ball = one_body((0, 0), 2.0, 0.1)
    free = fb.simulate(scene, dt=0.1, t_end=1.0)
    scene.prescribe(ball.centre, x=lambda t: 3.0 * (t - 1.0) if t > 1 else 0.0)
    moved = fb.simulate(scene, dt=0.1, t_end=1.5, start=free)
    assert moved.velocity(ball.centre)[0] == pytest.approx([3.0, 0.0], abs=1e-9)
    assert moved.energy.impact[0] == pytest.approx(2.0 * 9 / 2, rel=1e-9)
    assert moved.energy.work[0] == pytest.approx(2.0 * 9, rel=1e-9)


# -- Members that come and go ----------------------------------------------------------------------


@CONSERVING
def test_a_member_that_is_taken_away_takes_its_energy_with_it(scheme):
    scene, first, second, hinge = chain()
    whole = fb.simulate(scene, scheme, dt=0.01, t_end=0.3)
    scene.remove(second)
    assert hinge not in scene.joints
    assert not scene.masses
    rest = fb.simulate(scene, scheme, dt=0.01, t_end=0.5, start=whole)
    assert supplied_and_stored(rest.energy, 0) == pytest.approx(
        supplied_and_stored(whole.energy, -1), abs=1e-11
    )
    assert rest.energy.work[0] < whole.energy.work[-1]
    assert (rest.q[0, : len(scene.nodes)] == whole.q[-1, : len(scene.nodes)]).all()
    assert np.ptp(rest.position(second.end), axis=0) == pytest.approx([0, 0])
    assert abs(rest.energy.balance_error).max() < 1e-10
    assert_refused("was taken away with its member", scene.add_mass, second.end, 1.0)


def test_a_scene_that_is_built_anew_goes_on_by_the_names_of_its_members(tmp_path):
    scene, first, second, hinge = chain()
    fb.simulate(scene, dt=0.01, t_end=0.3).save(tmp_path / "whole.npz")
    whole = fb.load(tmp_path / "whole.npz")
    alone, flying = one_bar([(1, 0), (2, 0)], MEMBER, elements=2, name="second", gravity=(0, -9.81))
    alone.add_mass(flying.end, 0.5)
    rebuilt = fb.simulate(alone, dt=0.01, t_end=0.4, start=whole)
    scene.remove(first)
    changed = fb.simulate(scene, dt=0.01, t_end=0.4, start=whole)
    assert rebuilt.position(flying.end) == pytest.approx(changed.position(second.end), abs=1e-12)
    motion = fb.Motion(scene, dt=0.01, start=whole)
    motion.run(0.4)
    ours = motion.q[second.end.number, :2]
    assert ours == pytest.approx(changed.displacement(second.end)[-1], abs=1e-10)


def test_a_new_member_begins_with_its_velocity():
    scene, body, _ = pendulum()
    first = fb.simulate(scene, dt=0.01, t_end=0.3)
    ball = scene.add_body((5, 0), 1.0, 0.1, name="ball")
    scene.set_velocity(ball, (1.0, 2.0))
    scene.set_velocity(body, (9.0, 9.0))  # of the start at t = 0
    second = fb.simulate(scene, dt=0.01, t_end=0.4, start=first)
    assert second.velocity(ball.centre)[0] == pytest.approx([1, 2])
    assert second.velocity(body.centre)[0] == pytest.approx(first.velocity(body.centre)[-1])
    assert second.energy.work[0] - first.energy.work[-1] == pytest.approx(2.5, rel=1e-6)


def test_a_new_beam_at_a_node_that_has_moved_is_refused():
    scene, first, _, _ = chain()
    whole = fb.simulate(scene, dt=0.01, t_end=0.3)
    scene.add_beam([first.end, (1, 1)], MEMBER, elements=1)
    with pytest.raises(fb.SceneError, match="is new, but its node .* has moved by"):
        fb.simulate(scene, dt=0.01, t_end=0.4, start=whole)


def test_internal_variables_of_members_that_stay_are_kept():
    def flow(old, strains0, strains, dt):
        return [(old[0] + dt * (strains0[-1] + strains[-1]) / 2) / (1 + dt)]

    creep = fb.InternalVariables(("creep",), flow)
    hinge = fb.Spring(strain_energy=lambda x, a: 50 * (x - a[0]) ** 2, internal=creep)
    scene = fb.Scene()
    arms = [
        scene.add_body((x, 0), 1.0, 0.1, points={"pin": (x - 1, 0)}, name=f"arm {x}")
        for x in (1, 3)
    ]
    pins = [scene.add_joint(fb.Revolute(fb.GROUND, arm["pin"], spring=hinge)) for arm in arms]
    for arm in arms:
        scene.add_moment(arm.centre, float(arm.centre.x))
    first = fb.simulate(scene, dt=0.05, t_end=1.0)
    scene.remove(arms[0])
    second = fb.simulate(scene, dt=0.05, t_end=1.5, start=first)
    before, after = (run.joint(pins[1]).internal("creep") for run in (first, second))
    assert after[0] == before[-1] != 0
    assert abs(second.energy.balance_error).max() < 1e-11


def wheels(places):
    """Wheels that roll and slip on a bar between two clamps, each with its contact, by places."""
    contacts = {}
    scene, bar = clamped_bar((1, 0), MEMBER, elements=4, name="bar", gravity=(0.5, -9.81))
    scene.clamp(bar.end)
    law = {"stiffness": 2e4, "friction": fb.Coulomb(0.5, 2e4)}
    for x in places:
        wheel = scene.add_body((x, 0.06), mass=0.5, inertia=1e-3, name=f"wheel at {x}")
        scene.set_velocity(wheel, (0.2, -0.1))
        contacts[x] = scene.add_contact(bar, fb.Circle(wheel.centre, 0.06), **law)
    return scene, contacts


def test_contacts_in_another_order_keep_their_springs_in_a_scene_built_anew(tmp_path):
    scene, contacts = wheels((0.25, 0.75))
    first = fb.simulate(scene, dt=1e-3, t_end=0.03)
    first.save(tmp_path / "first.npz")
    stretched = {x: first.contact(c).stretch[-1] for x, c in contacts.items()}
    assert all(abs(z).max() > 1e-5 for z in stretched.values())

    onward = fb.simulate(scene, dt=1e-3, t_end=0.06, start=first)
    anew, others = wheels((0.75, 0.25))
    second = fb.simulate(anew, dt=1e-3, t_end=0.06, start=fb.load(tmp_path / "first.npz"))
    for x, contact in others.items():
        assert (second.contact(contact).stretch[0] == stretched[x]).all()
        apart = second.contact(contact).normal - onward.contact(contacts[x]).normal
        assert abs(apart[1:]).max() < 1e-8  # in row 0 is the step before
    assert abs(second.energy.balance_error).max() < 1e-12

    whole = first.then(second)
    for contact in others.values():
        assert (whole.contact(contact).stretch[31:] == second.contact(contact).stretch[1:]).all()
        assert (whole.contact(contact).gap[31:] == second.contact(contact).gap[1:]).all()
    own = [whole.contact(one) for one in whole.contacts if one.number > 1]
    assert len(own) == 2  # those of the first scene have other numbers now
    for one, contact in zip(own, contacts.values(), strict=True):
        assert (one.stretch[:31] == first.contact(contact).stretch).all()
        assert (one.gap[:31] == first.contact(contact).gap).all()
        assert (one.force[:31] == first.contact(contact).force).all()
        assert not one.force[31:].any()


# -- Loads and supports ----------------------------------------------------------------------------


def test_a_load_is_changed():
    scene, beam = cantilever()
    force, moment = scene.add_force(beam.end, (0.0, -1.0)), scene.add_moment(beam.end, 1.0)
    line = scene.add_line_load(beam, lambda s: (0.0, s), of="arc length")
    force = scene.change(force, (0.0, -2.0))
    scene.change(moment, lambda t: 3.0)
    scene.change(line, lambda s: (0.0, -s))
    other, same = cantilever()
    other.add_force(same.end, (0.0, -2.0))
    other.add_moment(same.end, 3.0)
    other.add_line_load(same, lambda s: (0.0, -s), of="arc length")
    assert (fb.static(scene).q[-1] == fb.static(other).q[-1]).all()
    scene.change(force, fb.Input("push"))
    assert fb.static(scene, inputs={"push": (0.0, -2.0)}).q[-1] == pytest.approx(
        fb.static(other).q[-1], abs=1e-15
    )


def test_gravity_is_set_and_set_anew():
    scene, ball = held_body((0, 0), mass=2.0, inertia=0.1)
    for gravity in ((0.0, -9.81), (0.0, -9.81), [1.0, 0.0], None, np.array([0.0, -1.62])):
        scene.gravity = gravity
        fallen = fb.simulate(scene, dt=0.1, t_end=1.0).displacement(ball)[-1]
        assert fallen == pytest.approx(0.5 * np.array((0, 0) if gravity is None else gravity))
    for wrong in (-9.81, "down", (0.0, -9.81, 0.0), (0.0, np.nan)):
        with pytest.raises(fb.SceneError, match="gravity: "):
            scene.gravity = wrong


def test_all_that_was_added_is_taken_away_again():
    scene, beam = cantilever()
    reference = fb.simulate(scene, dt=0.01, t_end=0.1)
    parts = [
        scene.add_force(beam.end, (0.0, -1.0)),
        scene.add_force(beam.end, (0.0, -1.0)),
        scene.add_line_load(beam, (1.0, 0.0)),
        scene.add_mass(beam.end, 2.0),
        scene.add_mass(beam.end, 2.0),
        scene.add_drag(beam, linear=1.0),
        scene.add_virtual_work(lambda step: ufl.dot(step.v, step.virtual_u)),
        scene.add_force_between(beam.end, (0, 3), force=5.0),
    ]
    assert abs(fb.simulate(scene, dt=0.01, t_end=0.1).q).max() > 1e-6
    scene.remove(*parts)
    assert not any((scene.loads, scene.masses, scene.drags, scene.virtual_works))
    assert (fb.simulate(scene, dt=0.01, t_end=0.1).q == reference.q).all()
    scene.add_force_between(beam.end, (0, 3), force=7.0)
    lane = scene.add_beam([(0, -1), (2, -1)], SECTION, degree=2, elements=1)
    scene.add_contact(beam, lane, stiffness=1e3, radius=0.1)
    scene.remove(lane)
    assert not scene.contacts


def test_a_support_is_taken_away():
    scene, beam = cantilever()
    scene.prescribe(beam.end, y=lambda t: 0.1 * t)
    scene.free(beam.end, "y")
    scene.free(beam.start)
    assert not scene.fixed and not scene.prescribed
    scene.pin(beam.start)
    with pytest.raises(
        fb.SceneError, match="free node 0.*'rotation' must be one that is supported"
    ):
        scene.free(beam.start, "rotation")
    assert_refused("free node 8", scene.free, beam.end)


def test_what_belongs_to_another_scene_is_refused():
    scene, beam = cantilever()
    load = scene.add_force(beam.end, (0.0, -1.0))
    other = copy.deepcopy(scene)
    for use in (other.remove, lambda load: other.change(load, (0, 0))):
        assert_refused("the scene does not have", use, load)
    other.remove(other.loads[0])
    assert scene.loads == [load]
    assert_refused("the scene does not have", lambda: scene.remove(other.beams[0]))


CHANGES = {
    "change": lambda scene, beam, load: scene.change(load, (0.0, -2.0)),
    "remove": lambda scene, beam, load: scene.remove(load),
    "free": lambda scene, beam, load: scene.free(beam.start, "rotation"),
    "swap": lambda scene, beam, load: (scene.remove(load), scene.add_moment(beam.end, 1.0)),
    "add": lambda scene, beam, load: scene.add_moment(beam.end, 1.0),
    "gravity": lambda scene, beam, load: setattr(scene, "gravity", (0.0, -20.0)),
    "parameter": lambda scene, beam, load: operator.setitem(scene.parameters, "gain", 5.0),
    "velocity": lambda scene, beam, load: scene.set_velocity(beam, (0.0, 0.0)),
}


@pytest.mark.parametrize("way", CHANGES)
def test_a_motion_notices_a_change_and_another_one_goes_on_from_its_state(way):
    scene, beam = cantilever()
    gain = fb.Parameter("gain", 0.0)
    scene.add_virtual_work(lambda step: gain * step.virtual_u[1])
    load = scene.add_force(beam.end, (0.0, -1.0))
    motion = fb.Motion(scene, dt=0.01, outputs={"tip": fb.Output("position", beam.end)})
    before = motion.step()["tip"]
    CHANGES[way](scene, beam, load)
    assert_refused("added to the scene since the motion .* changed", motion.step)
    assert (motion.outputs["tip"] == before).all()
    follower = fb.Motion(scene, dt=0.01, start=motion.state)
    follower.step()
    assert follower.t == pytest.approx(0.02)


# -- Equilibria one after the other ----------------------------------------------------------------


def test_a_new_support_holds_a_node_where_it_is():
    scene, beam = cantilever()
    load = scene.add_force(beam.end, (0.0, -10.0))
    bent = fb.static(scene)
    scene.fix(beam.end, "y")
    scene.remove(load)
    held = fb.static(scene, start=bent)
    assert held.displacement(beam.end)[:, 1] == pytest.approx(bent.displacement(beam.end)[-1, 1])
    # The support takes over what the load leaves.
    assert held.reaction(beam.end)[:, 1] == pytest.approx(-10.0 * held.load_factor, abs=1e-5)


def block_on_a_guide():
    """A block on a guide that sticks, with a weak spring and a load along the guide and across."""
    scene, block = one_body((0.5, 0), 1.0, 0.1)
    laws = {"spring": fb.Spring(10.0), "friction": fb.Coulomb(0.5, 1e4)}
    guide = scene.add_joint(fb.Prismatic(fb.GROUND, block.centre, axis=(1, 0), **laws))
    return scene, block, guide, scene.add_force(block.centre, (2.0, -10.0))


@pytest.mark.parametrize("continuation", [None, "arc-length"])
def test_forces_of_joints_and_supports_go_on_from_those_of_the_start(continuation, tmp_path):
    scene, beam = cantilever()
    block = scene.add_body((beam.end.x, beam.end.y), 2.0, 0.1)
    joint = scene.add_joint(fb.Prismatic(beam.end, block.centre, (1, 0), spring=fb.Spring(50.0)))
    load = scene.add_force(beam.start, (0.0, -7.0))
    first = fb.static(scene)
    first.save(tmp_path / "first.npz")
    loaded = fb.load(tmp_path / "first.npz")
    same = fb.static(scene, 4, start=loaded, continuation=continuation)
    for now, then in (
        (same.joint(joint).force, first.joint(joint).force[-1]),
        (same.reaction(beam.start), first.reaction(beam.start)[-1]),
    ):
        np.testing.assert_allclose(now, np.broadcast_to(then, now.shape), atol=1e-7)
    scene.change(load, (0.0, -9.0))
    scene.add_beam([(5, 0), (6, 0)], beam.section, elements=beam.elements, degree=beam.degree)
    scene.clamp(scene.beams[-1].start)
    more = fb.static(scene, 4, start=loaded, continuation=continuation)
    reaction = first.reaction(beam.start)[-1, 1] + 2.0 * more.load_factor
    assert more.reaction(beam.start)[:, 1] == pytest.approx(reaction, rel=1e-7)


def test_friction_that_sticks_in_a_joint_holds_on_in_further_load_steps():
    scene, block, guide, load = block_on_a_guide()
    first = fb.static(scene, 5)
    stuck = first.joint(guide).slide[-1]
    assert stuck == pytest.approx(2.0 / (1e4 + 10.0))
    moved = fb.simulate(scene, dt=0.01, t_end=0.1, start=first)
    for start in (first, moved):
        same = fb.static(scene, 3, start=start)
        assert same.joint(guide).slide == pytest.approx(stuck)
        assert abs(same.energy.balance_error).max() < 1e-12
    load = scene.change(load, (1.0, -10.0))
    assert fb.static(scene, 3, start=first).joint(guide).slide[-1] == pytest.approx(stuck / 2)
    scene.change(load, (2.0, -1.0))  # less than it needs: it slips until the spring holds the rest
    slipped = fb.static(scene, 10, start=first)
    assert slipped.joint(guide).slide[-1] == pytest.approx((2.0 - 0.5 * 1.0) / 10.0)


def test_friction_alone_that_holds_a_block_holds_on_in_further_load_steps():
    scene, block, guide, _ = block_on_a_guide()
    scene.remove(guide)
    friction = fb.Coulomb(0.5, 1e4)
    guide = scene.add_joint(fb.Prismatic(fb.GROUND, block.centre, axis=(1, 0), friction=friction))
    first = fb.static(scene, 5)
    scene.add_force(block.centre, (1.0, 0.0))
    assert fb.static(scene, 3, start=first).joint(guide).slide[-1] == pytest.approx(3.0 / 1e4)


@pytest.mark.parametrize("follower", [True, False])
def test_friction_sticks_while_followers_go_on(follower):
    scene, block, guide, load = block_on_a_guide()
    scene.remove(load)
    load = scene.add_force(block.centre, (2.0, -10.0), follower=True)
    first = fb.static(scene, 5)
    if not follower:  # a load that follows gives way to a dead one
        scene.remove(load)
        scene.add_force(block.centre, (2.0, -10.0))
    moved = fb.simulate(scene, dt=0.01, t_end=0.1, start=first)
    for start in (first, moved):
        same = fb.static(scene, 3, start=start)
        assert same.joint(guide).slide == pytest.approx(2.0 / (1e4 + 10.0))
        assert same.joint(guide).force[:, 1] == pytest.approx(10.0)
        assert abs(same.energy.balance_error).max() < 1e-12


@pytest.mark.parametrize("rises", [True, False])
def test_reactions_to_a_virtual_work_go_on_from_those_of_the_start(rises):
    def weighs(step):
        return -3.0 * (step.load_factor if rises else 1.0) * step.virtual_u[1]

    scene, beam = cantilever()
    scene.add_virtual_work(weighs, beam)
    first = fb.static(scene)
    for start in (first, fb.static(scene, start=first, continuation="arc-length")):
        same = fb.static(scene, 4, start=start)
        then = np.broadcast_to(first.reaction(beam.start)[-1], (5, 3))
        np.testing.assert_allclose(same.reaction(beam.start), then, atol=1e-7)
        assert abs(same.energy.balance_error).max() < 1e-12


def test_driven_motions_go_on_from_where_they_are():
    scene, beam = cantilever()
    scene.prescribe(beam.end, y=lambda t: 0.1 * t)
    first = fb.static(scene, t=1.0)
    second = fb.static(scene, t=3.0, start=first, load_steps=4)
    assert second.displacement(beam.end)[:, 1] == pytest.approx([0.1, 0.15, 0.2, 0.25, 0.3])


def test_arc_length_goes_on_from_a_prestressed_state():
    """A shallow arch, prestressed by heat-like thrust, snaps through: both ways end alike."""
    section = fb.Section(EA=1e5, GA=5e4, EI=1.0)
    arch, beam = scenes.supported_bar(
        [(0, 0), (1, 0.05), (2, 0)], section, elements=[4, 4], degree=2
    )
    arch.add_force(beam.end, (-5.0, 0.0))
    first = fb.static(arch)
    arch.fix(beam.end, "x")
    arch.add_force(beam.node(0.5), (0.0, -40.0))
    path = fb.static(arch, start=first, continuation="arc-length")
    assert path.load_factor[-1] == pytest.approx(1.0)
    again = fb.static(arch, start=path)
    assert abs(again.q - path.q[-1]).max() < 1e-8
    assert abs(path.energy.balance_error).max() < 0.02 * abs(path.energy.work).max()


def test_a_start_that_does_not_fit_is_refused():
    scene, beam = cantilever()
    other, _ = cantilever(elements=4)
    with pytest.raises(fb.SceneError, match="start: the solution has other nodes"):
        fb.static(scene, start=fb.static(other))
    assert_refused("start must be a Solution", fb.static, scene, start=scene)
    hanging = fb.Scene(gravity=(0, -9.81))
    hanging.pin(hanging.add_body((1, 0), mass=1.0, inertia=0.1, points={"a": (0, 0)})["a"])
    assert_refused("start must be a Solution", fb.static, hanging, start=scene)
    scene.add_force(beam.end, (0.0, -1.0))
    assert_refused("start with a spin", lambda: fb.static(scene, start=fb.static(scene), spin=1.0))
    assert np.isfinite(fb.static(scene).q).all()


@pytest.mark.parametrize("change", ["mass", "spring", "weight", "natural strain"])
def test_whatever_changes_between_motions_is_in_the_balance(change):
    scene, first, second, _ = chain()
    if change == "natural strain":
        strain = scene.add_natural_strain(first, curvature=0.5)
    before = fb.simulate(scene, dt=0.002, t_end=0.3)
    if change == "mass":
        scene.add_mass(first.end, 1.0)
    elif change == "spring":
        scene.add_force_between(second.end, (3.0, 2.0), spring=fb.Spring(20.0))
    elif change == "weight":
        scene.gravity = (0.0, 0.0)
    else:
        scene.remove(strain)
    after = fb.simulate(scene, dt=0.002, t_end=0.5, start=before)
    come = after.energy.total[0] - before.energy.total[-1]
    assert abs(come) > 0.1
    assert after.energy.work[0] - before.energy.work[-1] == pytest.approx(come, abs=1e-11)
    assert abs(before.then(after).energy.balance_error).max() < 1e-10


def yielding(rest):
    """A bar that yields at 1 N; under a force F it is longer by F / 100 + (F - 1) / 10 [m]."""
    k, H, Fy = 100.0, 10.0, 1.0

    def flow(old, strains0, strains, dt):
        trial = k * (strains[0] - old[0]) - H * old[0]
        excess = ufl.max_value(abs(trial) - Fy, 0)
        return [old[0] + ufl.sign(trial) * excess / (k + H)]

    energy = {"strain_energy": lambda x, a: k / 2 * (x - a[0]) ** 2 + H / 2 * a[0] ** 2}
    return fb.Spring(**energy, internal=fb.InternalVariables(("set",), flow), rest=rest)


def test_a_bar_that_yielded_keeps_its_set_where_another_one_is_removed_or_added():
    """Of two equal bars each has half of the force; what has yielded stays."""
    scene, body = held_body((0, 0), 1.0, 0.0, "y", "rotation")
    first, _ = (scene.add_force_between(body, (-x, 0), spring=yielding(x)) for x in (1.0, 2.0))
    load = scene.add_force(body, (3.0, 0.0))
    loaded = fb.static(scene, load_steps=4)
    assert loaded.displacement(body)[-1, 0] == pytest.approx(0.015 + 0.05, rel=1e-9)
    scene.remove(first, load)
    alone = fb.static(scene, load_steps=4, start=loaded)
    assert alone.displacement(body)[-1, 0] == pytest.approx(0.05, rel=1e-9)
    scene.add_force_between(body, (-1, 0), spring=yielding(1.05))  # free of force there
    for start in (alone, fb.simulate(scene, dt=0.01, t_end=0.1, start=alone)):
        again = fb.static(scene, load_steps=4, start=start)
        assert again.displacement(body)[-1, 0] == pytest.approx(0.05, rel=1e-9)


def test_a_bar_that_yielded_keeps_its_set_where_its_fixed_point_and_something_else_change():
    """Its set is 0.5 N / 10 N/m; the fixed point is 1 mm farther away."""

    def build(x, hold):
        scene, body = held_body((0, 0), 1.0, 0.0, "y", "rotation")
        scene.add_force_between(body, (x, 0), spring=yielding(1.0))
        hold(scene, scene.add_body((5, 5), mass=1.0, inertia=1.0).centre)
        return scene, body

    scene, body = build(-1.0, lambda scene, hook: scene.add_joint(fb.Rigid(fb.GROUND, hook)))
    scene.add_force(body, (1.5, 0.0))
    loaded = fb.static(scene, load_steps=4)
    assert loaded.displacement(body)[-1, 0] == pytest.approx(0.015 + 0.05, rel=1e-9)
    scene, body = build(-1.001, lambda scene, hook: scene.clamp(hook))
    (start, _) = fb.simulate(scene, dt=1e-3, t_end=1e-3, start=loaded).energy.springs
    assert start == pytest.approx(100 / 2 * (0.066 - 0.05) ** 2 + 10 / 2 * 0.05**2, rel=1e-9)


def test_parts_are_found_in_their_order_however_often_the_scene_changes():
    scene = fb.Scene()
    nodes = [scene.add_body((x, 0), mass=1.0).centre for x in range(6)]
    loads = [scene.add_force(node, (1.0, 0.0)) for node in 4 * nodes]
    rng, gone = np.random.default_rng(0), []
    for step in range(400):
        k, kind = int(rng.integers(len(loads))), step % 7
        if kind < 3:
            loads.append(scene.add_force(nodes[k % 6], (1.0, 0.0)))
        elif kind == 3:
            gone.append(loads[k])
            loads[k] = scene.change(loads[k], (2.0, 0.0))
        elif kind == 4:
            gone.append(loads.pop(k))
            scene.remove(gone[-1])
        elif kind == 5:
            parts = [loads.pop(k % len(loads)) for k in rng.integers(9, size=2)]
            scene.remove(*parts, parts[0])
        elif step % 3 == 0:
            scene.gravity = lambda t: (0.0, -t)  # a load before all others
            scene.change(scene.loads[0], (0.0, -1.0))
        assert [load for load in scene.loads if load.kind == "force"] == loads
    for load in gone:
        with pytest.raises(fb.SceneError, match="does not have"):
            scene.change(load, (1.0, 0.0))
    scene.gravity = None
    for other in copy.deepcopy(scene), pickle.loads(pickle.dumps(scene)):
        rest = [*other.loads[2:]]
        other.remove(other.loads[1], other.loads[0])
        assert other.loads == rest
        with pytest.raises(fb.SceneError, match="does not have"):
            other.remove(loads[0])
