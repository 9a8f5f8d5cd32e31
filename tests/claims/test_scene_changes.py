"""Motions that go on in a scene that has changed: released, cut, caught, with other members."""

import numpy as np
import pytest

import fx_beam as fb

MEMBER = fb.Section(EA=1e4, GA=1e4, EI=1e2, rhoA=1.0, rhoI=0.01)
SCHEMES = [
    fb.EnergyMomentum(),
    fb.EnergyMomentum(order=4),
    fb.MidPoint(),
    fb.EnergyDecaying(),
    fb.Newmark(),
    fb.GeneralizedAlpha(0.6),
]
CONSERVING = SCHEMES[:2]


def supplied_and_stored(energy, row):
    """What does not change, also where a scene changes."""
    stored = energy.total[row] + energy.algorithmic[row]
    return stored - energy.work[row] + energy.dissipated[row] + energy.impact[row]


def chain():
    """Two links that swing, the second with a mass at its end."""
    scene = fb.Scene(gravity=(0, -9.81))
    first = scene.add_beam([(0, 0), (1, 0)], MEMBER, elements=3, degree=2, name="first")
    second = scene.add_beam([(1, 0), (2, 0)], MEMBER, elements=2, degree=2, name="second")
    scene.pin(first.start)
    hinge = scene.add_joint(fb.Revolute(first.end, second.start))
    scene.add_mass(second.end, 0.5)
    return scene, first, second, hinge


def pendulum():
    scene = fb.Scene(gravity=(0, -9.81))
    body = scene.add_body((1, 0), mass=2.0, inertia=0.1, points={"pin": (0, 0)})
    return scene, body, scene.add_joint(fb.Revolute(fb.GROUND, body["pin"]))


# -- Release ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["auto", "petsc"])
@pytest.mark.parametrize("scheme", CONSERVING, ids=["order 2", "order 4"])
def test_a_cut_pendulum_flies_on_a_parabola(scheme, solver):
    scene, body, pin = pendulum()
    options = {"dt": 0.01, "solver": solver}
    first = fb.simulate(scene, scheme, t_end=0.5, **options)
    scene.remove(pin)
    second = fb.simulate(scene, scheme, t_end=0.9, start=first, **options)
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


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
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
    scene = fb.Scene()
    section = fb.Section(EA=1e8, GA=1e8, EI=EI, rhoA=rhoA)
    beam = scene.add_beam([(0, 0), (length, 0)], section, elements=8, degree=2)
    scene.clamp(beam.start)
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


# -- Catch -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_a_falling_bar_that_is_caught_at_its_end_keeps_its_angular_momentum_about_it(scheme):
    m, half, v = 3.0, 0.5, 2.0
    scene = fb.Scene()
    bar = scene.add_body((half, 0), m, m * (2 * half) ** 2 / 12, points={"end": (0, 0)})
    scene.set_velocity(bar, (0.0, -v))
    falling = fb.simulate(scene, scheme, dt=0.01, t_end=0.1)
    scene.pin(bar["end"])
    caught = fb.simulate(scene, scheme, dt=0.01, t_end=0.2, start=falling)
    # m v L/2 = (m L^2 / 3) omega; a quarter of the energy is lost.
    assert caught.spin(bar.centre)[0] == pytest.approx(-1.5 * v / (2 * half), rel=1e-12)
    assert caught.energy.impact == pytest.approx(0.25 * m * v**2 / 2, rel=1e-12)
    assert caught.energy.kinetic[0] == pytest.approx(0.75 * m * v**2 / 2, rel=1e-12)
    assert caught.velocity(bar["end"])[0] == pytest.approx([0, 0], abs=1e-13)
    if scheme in CONSERVING:
        assert abs(caught.energy.balance_error).max() < 1e-12
        stays = caught.position(bar["end"]) - falling.position(bar["end"])[-1]
        assert abs(stays).max() < 1e-13


def test_a_driven_support_that_catches_does_work():
    """A mass at rest that is caught by a carriage of the speed v: work m v^2, half of it lost."""
    scene = fb.Scene()
    ball = scene.add_body((0, 0), 2.0, 0.1)
    free = fb.simulate(scene, dt=0.1, t_end=1.0)
    scene.prescribe(ball.centre, x=lambda t: 3.0 * (t - 1.0) if t > 1 else 0.0)
    moved = fb.simulate(scene, dt=0.1, t_end=1.5, start=free)
    assert moved.velocity(ball.centre)[0] == pytest.approx([3.0, 0.0], abs=1e-9)
    assert moved.energy.impact[0] == pytest.approx(2.0 * 9 / 2, rel=1e-9)
    assert moved.energy.work[0] == pytest.approx(2.0 * 9, rel=1e-9)


def test_what_does_not_fit_a_new_joint_is_refused_with_its_gap():
    scene, body, pin = pendulum()
    first = fb.simulate(scene, dt=0.01, t_end=0.3)
    scene.remove(pin)
    flown = fb.simulate(scene, dt=0.01, t_end=0.5, start=first)
    scene.add_joint(fb.Revolute(fb.GROUND, body["pin"]))
    gap = np.hypot(*flown.displacement(body["pin"])[-1])
    with pytest.raises(fb.SceneError, match=f"joint 2, Revolute .* a gap of {gap:.3g} m"):
        fb.simulate(scene, dt=0.01, t_end=0.6, start=flown)


# -- Members that come and go ----------------------------------------------------------------------


@pytest.mark.parametrize("scheme", CONSERVING, ids=["order 2", "order 4"])
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
    with pytest.raises(fb.SceneError, match="was taken away with its member"):
        scene.add_mass(second.end, 1.0)


def test_a_scene_that_is_built_anew_goes_on_by_the_names_of_its_members(tmp_path):
    scene, first, second, hinge = chain()
    fb.simulate(scene, dt=0.01, t_end=0.3).save(tmp_path / "whole.npz")
    whole = fb.load(tmp_path / "whole.npz")
    alone = fb.Scene(gravity=(0, -9.81))
    flying = alone.add_beam([(1, 0), (2, 0)], MEMBER, elements=2, degree=2, name="second")
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
    scene.add_beam([first.end, (1, 1)], MEMBER, degree=2)
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


def test_friction_of_contacts_that_stay_keeps_its_stretch():
    """A block rests on two feet, pushed sideways; then something else, and a foot, are removed."""
    scene = fb.Scene(gravity=(0, -10.0))
    block = scene.add_body((0, 0.5), 1.0, 0.1, points={"l": (-0.3, 0), "r": (0.3, 0)}, name="block")
    law = {"stiffness": 1e4, "restitution": 0.2, "speed": 0.01, "friction": fb.Coulomb(0.5, 1e4)}
    floor = fb.Line((0, 0), normal=(0, 1))
    left, right = (scene.add_contact(block[point], floor, **law) for point in "lr")
    scene.add_force(block.centre, (2.0, 0.0))
    other = scene.add_body((3, 3), 1.0, 0.1)
    scene.add_joint(fb.Revolute(fb.GROUND, other.centre))
    first = fb.simulate(scene, dt=2e-3, t_end=0.4)
    scene.remove(other)
    second = fb.simulate(scene, dt=2e-3, t_end=0.5, start=first)
    scene.remove(left)
    third = fb.simulate(scene, dt=2e-3, t_end=0.51, start=second)
    for contact in (left, right):
        before, after = (run.variables_of_contact[contact.number] for run in (first, second))
        assert np.array_equal(before[-1], after[0])
        assert abs(after[0, 0, 0]) > 1e-5
    before, after = (run.variables_of_contact[right.number] for run in (second, third))
    assert np.array_equal(before[-1], after[0])
    whole = first.then(second).then(third)
    assert abs(whole.energy.balance_error).max() < 1e-11
    assert whole.contact(left).force.shape == whole.contact(right).force.shape
    assert not whole.contact(left).force[-1].any()
    assert abs(whole.contact(right).force[250] - second.contact(right).force[-1]).max() == 0


# -- Contacts --------------------------------------------------------------------------------------


def wheels(places, friction=0.5):
    """Wheels that roll and slip on a bar between two clamps, each with its contact, by places."""
    scene = fb.Scene(gravity=(0.5, -9.81))
    bar = scene.add_beam([(0, 0), (1, 0)], MEMBER, elements=4, name="bar")
    scene.clamp(bar.start)
    scene.clamp(bar.end)
    found = {}
    for x in places:
        wheel = scene.add_body((x, 0.06), mass=0.5, inertia=1e-3, name=f"wheel at {x}")
        scene.set_velocity(wheel, (0.2, -0.1))
        found[x] = contact_of(scene, wheel, friction)
    return scene, found


def contact_of(scene, wheel, friction=0.5, **options):
    shape, law = fb.Circle(wheel.centre, 0.06), fb.Coulomb(friction, 2e4)
    return scene.add_contact(scene.beams[0], shape, stiffness=2e4, friction=law, **options)


def test_contacts_in_another_order_keep_their_springs_in_a_scene_built_anew(tmp_path):
    scene, contacts = wheels((0.25, 0.75))
    first = fb.simulate(scene, dt=1e-3, t_end=0.03)
    first.save(tmp_path / "first.npz")
    stretched = {x: first.contact(c).stretch[-1] for x, c in contacts.items()}
    assert all(abs(z).max() > 1e-5 for z in stretched.values())

    on = fb.simulate(scene, dt=1e-3, t_end=0.06, start=first)
    anew, others = wheels((0.75, 0.25))
    second = fb.simulate(anew, dt=1e-3, t_end=0.06, start=fb.load(tmp_path / "first.npz"))
    for x, contact in others.items():
        assert (second.contact(contact).stretch[0] == stretched[x]).all()
        apart = second.contact(contact).normal - on.contact(contacts[x]).normal
        assert abs(apart[1:]).max() < 1e-8  # in row 0 is the step before
    assert abs(second.energy.balance_error).max() < 1e-12

    whole = first.then(second)
    for contact in others.values():
        assert (whole.contact(contact).stretch[31:] == second.contact(contact).stretch[1:]).all()
        assert (whole.contact(contact).gap[31:] == second.contact(contact).gap[1:]).all()
    own = [whole.contact(one) for one in whole.obstacles if one.number > 1]
    assert len(own) == 2  # those of the first scene have other numbers now
    for one, contact in zip(own, contacts.values(), strict=True):
        assert (one.stretch[:31] == first.contact(contact).stretch).all()
        assert (one.gap[:31] == first.contact(contact).gap).all()
        assert (one.force[:31] == first.contact(contact).force).all()
        assert not one.force[31:].any()
