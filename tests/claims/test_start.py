"""Motions that start from another solution, from equilibrium, or with parts without mass."""

import functools
import itertools

import ufl

import numpy as np
import pytest
from jointed import MEMBER, pair, thrown, whirling
from scenes import FLYING, PLASTIC, clamped_bar, free_flight, guided_body, pinned_beam
from scipy.integrate import solve_ivp

import fx_beam as fb


def test_a_thin_file_keeps_all_that_a_continuation_needs(tmp_path):
    options = {"dt": 1 / 512, "newton": fb.NewtonOptions(tolerance=1e-13)}
    nothing = fb.Record(every=10, motion=False, rates=False, forces=False)
    scene, _ = thrown("pin in slot with offset", gravity=(0, -9.81))
    whole = fb.simulate(scene, t_end=1 / 8, **options)
    first = fb.simulate(scene, t_end=1 / 16, record=nothing, **options)
    first.save(tmp_path / "half.npz")
    rest = fb.simulate(scene, t_end=1 / 8, start=fb.load(tmp_path / "half.npz"), **options)
    assert abs(rest.q[-1] - whole.q[-1]).max() < 1e-12
    # So does the predictor.
    iterations = first.stats.newton_iterations + rest.stats.newton_iterations
    assert iterations == pytest.approx(whole.stats.newton_iterations, abs=1)


@pytest.mark.parametrize("kind", ["revolute", "prismatic with offset"])
@pytest.mark.parametrize("every", [1, 3])
def test_row_0_has_the_forces_of_the_last_step_also_if_none_were_recorded(kind, every):
    rows = []
    for record in (fb.Record(), fb.Record(every=every, rates=False, forces=False)):
        scene, first, second, _ = pair(kind, gravity=(0, -9.81))
        scene.pin(first.start)
        scene.add_contact(second.end, fb.Line((0, second.end.y), (0, 1)), stiffness=100.0)
        before = fb.simulate(scene, dt=1 / 128, t_end=0.25, record=record)
        rest = fb.simulate(scene, dt=1 / 128, t_end=0.28, start=before)
        rows.append([rest.joint_forces[0], rest.reactions[0], rest.contact_forces[0], rest.a[0]])
        assert all(force.any() for force in rows[-1])
    for full, left_out in zip(*rows, strict=True):
        # Those of a record change with rates that fit joints with an offset.
        assert abs(left_out - full).max() < (0.02 if "offset" in kind else 1e-12) * abs(full).max()


# -- Steps taken in parts --------------------------------------------------------------------------


@pytest.mark.exact_times
@pytest.mark.parametrize(
    "scheme", [fb.EnergyMomentum(), fb.HHT(-0.1)], ids=["energy-momentum", "hht"]
)
def test_parts_of_steps_go_on_as_if_the_motion_had_not_ended(scheme, tmp_path):
    # Times are without rounding, so that the two runs are the same to the last digit, however
    # chaotic the motion is.
    dt, steps = 1 / 4, 24
    whole = fb.simulate(whirling(), scheme, dt=dt, t_end=steps * dt)
    assert 0 < whole.stats.halvings < whole.stats.substeps
    part, substeps = None, 0
    for cut, end in itertools.pairwise((0, 3, 7, 11, 15, 19, 23, steps)):
        run = fb.simulate(whirling(), scheme, dt=dt, t_end=end * dt, start=part)
        run.save(tmp_path / "part.npz")
        part = fb.load(tmp_path / "part.npz")
        substeps += part.stats.substeps
        assert (part.q[1:] == whole.q[cut + 1 : end + 1]).all()
        assert (part.t_level[1:] == whole.t_level[cut + 1 : end + 1]).all()
    assert substeps == whole.stats.substeps


def test_another_scheme_finds_its_accelerations_anew():
    scene, beam = pinned_beam(4)
    options = {"dt": 0.0005, "newton": fb.NewtonOptions(tolerance=1e-12)}
    first = fb.simulate(scene, dt=0.0005, t_end=0.05)
    second = fb.simulate(scene, fb.Newmark(), t_end=0.1, start=first, **options)
    whole = fb.simulate(scene, fb.Newmark(), t_end=0.1, **options)
    assert second.position(beam.end)[-1] == pytest.approx(whole.position(beam.end)[-1], abs=0.1)
    # Not the mean over the last step of the mid-point scheme, but what balances the forces.
    close = whole.acceleration(beam.end)[100]
    assert np.hypot(*(second.acceleration(beam.end)[0] - close)) < 0.02 * np.hypot(*close)


# -- Other steps, schemes, loads -------------------------------------------------------------------


@pytest.mark.parametrize("steps", [2, 3])
@pytest.mark.parametrize("scheme", [fb.GeneralizedAlpha(0.5), fb.HHT()], ids=str)
def test_another_rule_goes_on_from_rates_that_fit(scheme, steps):
    """A motor starts at once: by the mid-point rule the spins of steps are 6, 0, 6, ... rad/s."""
    scene = fb.Scene()
    body = scene.add_body((0.5, 0), 2.0, 0.4, points={"pin": (0, 0)})
    scene.add_joint(fb.Revolute(fb.GROUND, body["pin"], motor=lambda t: 3.0 * max(0.0, t - 0.5)))
    first = fb.simulate(scene, dt=0.01, t_end=0.5 + 0.01 * steps)
    second = fb.simulate(scene, scheme, dt=0.01, t_end=1.0, start=first)
    assert abs(second.spin(body.centre) - 3.0).max() < 1e-9
    energy = first.then(second).energy
    assert energy.total[len(first.t) :] == pytest.approx(0.9 * 3.0**2 / 2, rel=1e-3)
    assert abs(energy.balance_error).max() < 1e-3


def test_loads_go_on_in_time_and_may_be_others():
    scene, beam = free_flight(3)
    pushed = fb.simulate(scene, dt=0.1, t_end=2.5)
    flown = fb.simulate(scene, dt=0.1, t_end=5.0, start=pushed)
    assert flown.t[0] == 2.5
    assert flown.linear_momentum[:, 0] == pytest.approx(np.full(26, 20.0))
    assert not np.diff(flown.energy.work).any()
    other, _ = free_flight(3)
    other.add_force(other.beams[0].end, (0.0, 1.0))
    assert fb.simulate(other, dt=0.1, t_end=3.5, start=pushed).linear_momentum[-1] == pytest.approx(
        [20.0, 1.0]
    )


@pytest.mark.exact_times
@pytest.mark.parametrize("order", [2, 4])
@pytest.mark.parametrize("file", [None, "run.pvd"])
def test_a_motor_that_stops_where_a_motion_goes_on_takes_the_momentum(order, file, tmp_path):
    """It moves a cart of 2 kg, at 1 m/s at last, and stops within a step."""
    scheme = fb.EnergyMomentum(order)
    slide = lambda t: min(t, 0.5) ** 2  # noqa: E731
    scene, cart, guide = guided_body((0, 0), 2.0, 0.1, motor=slide)
    scene.clamp(scene.add_beam([(0, 1), (1, 1)], MEMBER, elements=1).start)  # for a file
    record = fb.Record(file=file and tmp_path / file)
    first = fb.simulate(scene, scheme, dt=1 / 16, t_end=0.5, record=record)
    rest = fb.simulate(scene, scheme, dt=1 / 16, t_end=0.75, start=first)
    force = rest.joint(guide).motor_force[1:]
    assert force == pytest.approx(np.array([-2.0 * 1.0 * 16, 0, 0, 0]), abs=1e-9)
    assert rest.velocity(cart)[0, 0] == pytest.approx(1.0)
    assert np.diff(rest.linear_momentum[:, 0]) == pytest.approx(force / 16, abs=1e-11)
    energy = rest.energy
    assert first.energy.kinetic[-1] == pytest.approx(energy.kinetic[0]) == pytest.approx(1.0)
    assert abs(energy.balance_error).max() < 1e-13


# -- From equilibrium ------------------------------------------------------------------------------


def bent_pair(kind, **options):
    scene, left = clamped_bar((1, 0), MEMBER, elements=4, gravity=(0, -9.81))
    right = scene.add_beam([(1, 0), (1.8, 0.5)], MEMBER, elements=4)
    scene.pin(right.end)
    scene.add_joint(kind(left.end, right.start, **options))
    return scene


def test_a_scene_in_equilibrium_stays_at_rest():
    scene = bent_pair(fb.PinInSlot, axis=(0.9, 0.4), spring=fb.Spring(200.0))
    left, right = scene.beams
    scene.add_force(left.end, lambda t: (2.0, -8.0))
    scene.add_force(right.start, (1.0, 3.0), follower=True)
    scene.add_virtual_work(lambda step: -2.0 * step.load_factor * step.virtual_u[1], left)
    rest = fb.static(scene, load_steps=4)
    bent = abs(rest.q[-1]).max()
    assert bent > 0.03
    motion = fb.simulate(scene, dt=0.01, t_end=0.2, start=rest)
    assert abs(motion.q - rest.q[-1]).max() < 1e-9 * bent
    assert motion.energy.kinetic.max() < 1e-16 * motion.energy.strain.max()
    assert motion.energy.work[0] == rest.energy.work[-1]


@pytest.mark.parametrize("scheme", [fb.Newmark(), fb.HHT()])
def test_rates_of_massless_nodes_do_not_depend_on_the_load_steps_before(scheme):
    section = fb.Section(EA=1e4, GA=5e3, EI=20.0)
    scene, beam = clamped_bar((1, 0), section, elements=2, gravity=(0, -9.81))
    scene.add_mass(beam.end, 1.0, 0.01)
    scene.add_force(beam.end, lambda t: (0.0, 5.0 * np.sin(20 * t)))
    rates = []
    for load_steps in (1, 10):
        start = fb.static(scene, load_steps=load_steps)
        solution = fb.simulate(scene, scheme, dt=0.01, t_end=0.03, start=start)
        rates.append(solution.velocity(beam.nodes[1]))
    assert rates[0] == pytest.approx(rates[1], abs=1e-9)


def test_a_static_state_is_one_of_its_time():
    scene, beam = clamped_bar((1, 0), FLYING, elements=2)
    scene.prescribe(beam.end, y=lambda t: 0.1 * t)
    moved = fb.static(scene, t=2.0)
    motion = fb.simulate(scene, dt=0.05, t_end=2.2, start=moved)
    assert motion.t == pytest.approx([2.0, 2.05, 2.1, 2.15, 2.2])
    assert motion.displacement(beam.end)[:, 1] == pytest.approx(0.1 * motion.t)
    assert motion.velocity(beam.end)[0, 1] == pytest.approx(0.1)
    with pytest.raises(fb.SceneError, match=r"y of node 2 .* is 0.1 at t = 1, but .* from 0.2"):
        other = fb.static(scene, t=1.0)
        other.end.q[:] = moved.end.q
        fb.simulate(scene, dt=0.05, t_end=2.0, start=other)


@pytest.mark.parametrize(
    ("y", "first", "scheme", "dt"),
    [
        (lambda t: 0.07, (0.0, 0.0), fb.EnergyMomentum(), 1e-6),
        (lambda t: 0.07, (0.0, 0.0), fb.Newmark(), 1e-3),
        (lambda t: 0.07 + 0.01 * t**2 - 0.02 * np.sin(2 * t), (-0.04, 0.02), None, 1e-2),
        (lambda t: 0.07 + 0.01 * t**2 - 0.02 * np.sin(2 * t), (-0.04, 0.02), None, 1e-4),
    ],
    ids=["held", "held, newmark", "moved on", "moved on in small steps"],
)
def test_nodes_held_where_they_were_moved_to_start_with_their_own_rates(y, first, scheme, dt):
    scene, beam = clamped_bar((1, 0), MEMBER, elements=4)
    scene.prescribe(beam.end, x=lambda t: -0.05, y=y)
    motion = fb.simulate(scene, scheme, dt=dt, t_end=2 * dt, start=fb.static(scene))
    assert motion.velocity(beam.end)[0] == pytest.approx([0, first[0]], abs=1e-8)
    # Along x what the equilibrium leaves by rounding: 1e-11 m/s^2.
    assert motion.acceleration(beam.end)[0] == pytest.approx([0, first[1]], rel=0.01, abs=1e-8)
    if not any(first):
        assert not motion.acceleration(beam.end).any() and not motion.velocity(beam.end).any()
        assert abs(motion.a).max() < 1e-7


# -- Wrong starts ----------------------------------------------------------------------------------


def test_wrong_starts_are_refused_by_name(tmp_path):
    scene, _ = pinned_beam(4)
    first = fb.simulate(scene, dt=0.01, t_end=0.1)
    with pytest.raises(fb.SceneError, match="start must be a Solution, not 3"):
        fb.simulate(scene, dt=0.01, t_end=0.2, start=3)
    with pytest.raises(fb.SceneError, match="t_end = 0.1 .* after the start at t = 0.1"):
        fb.simulate(scene, dt=0.01, t_end=0.1, start=first)
    other, _ = pinned_beam(5)
    with pytest.raises(fb.SceneError, match="has other nodes than the scene"):
        fb.simulate(other, dt=0.01, t_end=0.2, start=first)
    jointed, beam = pinned_beam(4)
    jointed.add_joint(fb.PinInSlot(fb.GROUND, beam.end, axis=(1, 0)))
    with pytest.raises(fb.SceneError, match="violates joint 0, PinInSlot .* a gap of"):
        fb.simulate(jointed, dt=0.01, t_end=0.2, start=first)
    first.save(tmp_path / "run.npz")
    endless = fb.load(tmp_path / "run.npz")
    endless.end = None
    with pytest.raises(fb.SceneError, match="has no last state"):
        fb.simulate(scene, dt=0.01, t_end=0.2, start=endless)


def test_a_state_that_a_joint_cannot_be_in_is_refused_and_the_joint_named():
    guide = {"axis": (0.9, 0.4)}
    slid, hinged = (
        fb.static(bent_pair(kind, **axis))
        for kind, axis in ((fb.Prismatic, guide), (fb.Revolute, {}))
    )
    gap = abs(slid.slides[-1, 0])
    options = {"dt": 1e-3, "t_end": 2e-3}
    with pytest.raises(
        fb.SceneError, match=f"joint 0, Revolute .* nodes have a gap of {gap:.3g} m"
    ):
        fb.simulate(bent_pair(fb.Revolute), start=slid, **options)
    with pytest.raises(
        fb.SceneError, match="joint 0, Prismatic .* the rotation of node b deviates by"
    ):
        fb.simulate(bent_pair(fb.Prismatic, **guide), start=hinged, **options)
    with pytest.raises(fb.SceneError, match="the solution violates joint 0, Rigid"):
        fb.simulate(bent_pair(fb.Rigid), start=hinged, **options)
    # A pin in a slot can be where either of the others is.
    for state in (slid, hinged):
        motion = fb.simulate(bent_pair(fb.PinInSlot, **guide), start=state, **options)
        assert (motion.q[0] == state.q[-1]).all()


@pytest.mark.exact_times
def test_a_run_that_broke_off_goes_on_from_its_last_step():
    scene, _ = pinned_beam(4)
    scene.add_force(scene.beams[0].end, lambda t: (0.0, 0.0) if t < 0.07 else 1 / 0)
    options = {"dt": 1 / 64, "t_end": 0.125}
    with pytest.raises(fb.StepError) as caught:
        fb.simulate(scene, **options)
    rest = fb.simulate(pinned_beam(4)[0], start=caught.value.solution, **options)
    assert rest.t[0] == caught.value.solution.t[-1] == 1 / 16
    whole = fb.simulate(pinned_beam(4)[0], **options)
    np.testing.assert_array_equal(rest.q, whole.q[4:])


# -- Parts without mass under loads that are there at the start ----------------------------------


SCHEMES = [fb.EnergyMomentum(), fb.EnergyMomentum(order=4), fb.EnergyDecaying(), fb.Newmark()]
LIGHT = fb.Section(EA=1e4, GA=1e4, EI=10.0)


def bent(**section):
    """A massless cantilever under a moment, and a heavy one, since a motion needs a mass."""
    section = fb.Section(LIGHT.EA, LIGHT.GA, LIGHT.EI, **section)
    scene, beam = clamped_bar((1, 0), section, elements=4)
    other = scene.add_beam([(0, 1), (1, 1)], fb.Section(1e4, 1e4, 10.0, 1.0, 0.01), elements=1)
    scene.clamp(other.start)
    scene.add_moment(beam.end, 20.0)
    return scene, beam


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_a_massless_member_has_the_rotation_of_its_moment_in_every_row(scheme):
    scene, beam = bent()
    solution = fb.simulate(scene, scheme, dt=0.01, t_end=0.05)
    assert solution.rotation(beam.end) == pytest.approx(np.full(6, 2.0), abs=1e-9)
    assert abs(solution.energy.balance_error).max() < 1e-12
    assert solution.energy.strain[0] == pytest.approx(20.0)
    motion = fb.Motion(scene, scheme, dt=0.01)
    for _ in range(2):
        assert motion.q[beam.end.number, 2] == pytest.approx(2.0, abs=1e-9)
        motion.step()


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_what_hangs_on_a_mass_follows_it_at_its_own_stretch(scheme):
    k, force, mass = 40.0, 3.0, 2.0
    scene = fb.Scene()
    bar = scene.add_beam([(0, 0), (2, 0)], fb.Section(EA=k, GA=1.0, EI=1.0), elements=2)
    middle = bar.node(0.5)
    scene.fix(bar.start, "x", "y", "rotation")
    for node in (middle, bar.end):
        scene.fix(node, "y", "rotation")
    scene.add_mass(middle, mass)
    scene.add_force(bar.end, (force, 0.0))
    solution = fb.simulate(scene, scheme, dt=0.01, t_end=1.0)
    x = solution.displacement(middle)[:, 0]
    stretch = solution.displacement(bar.end)[:, 0] - x
    assert stretch == pytest.approx(np.full(len(x), force / k), rel=1e-3)
    assert abs(x[0]) < 1e-15
    # The force pulls the mass from the first step on.
    assert solution.acceleration(middle)[0, 0] == pytest.approx(force / mass)
    omega = np.sqrt(k / mass)
    assert x == pytest.approx(force / k * (1 - np.cos(omega * solution.t)), abs=0.02 * force / k)


def beside_its_end(held, **section):
    """A mass without rotary inertia beside the end of a beam that a moment and a force bend."""
    scene, beam = massless_cantilever(**section)
    bob = scene.add_body((1.2, 0.2), mass=0.5).centre
    if held:
        scene.pin(bob)
    scene.add_joint(fb.Rigid(beam.end, bob, offset=(0.2, 0.2)))
    scene.add_moment(beam.end, 5.0)
    scene.add_force(beam.nodes[1], (0.0, 10.0))
    return scene


def along_it(held):
    """Two masses that slide along a beam with natural strains."""
    scene, beam = massless_cantilever()
    for joint, node in ((fb.Slider, beam.nodes[1]), (fb.Sleeve, beam.nodes[3])):
        bead = scene.add_body((node.x, node.y), mass=0.5, inertia=0.03).centre
        if held:
            scene.clamp(bead)
        scene.add_joint(joint(beam, bead))
    scene.add_natural_strain(beam, axial=1e-3, curvature=lambda f: 0.5 * f)
    return scene


def massless_cantilever(**section):
    section = fb.Section(LIGHT.EA, LIGHT.GA, LIGHT.EI, **section)
    return clamped_bar((1, 0), section, elements=4, gravity=(0, -9.81))


@pytest.mark.parametrize("dt", [1e-5, 0.02])
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
@pytest.mark.parametrize("masses", [beside_its_end, along_it])
def test_a_massless_beam_begins_as_if_the_masses_that_it_carries_were_held(masses, scheme, dt):
    solution = fb.simulate(masses(held=False), scheme, dt=dt, t_end=4 * dt)
    held = fb.static(masses(held=True))
    (nodes,) = held.nodes_of_beam.values()
    assert solution.q[0, nodes] == pytest.approx(held.q[-1, nodes], abs=1e-7)
    assert len(solution.t) == 5


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_damping_holds_a_massless_beam_that_carries_a_mass_at_the_start(scheme):
    scene = beside_its_end(held=False, retardation=1e-4)
    solution = fb.simulate(scene, scheme, dt=0.02, t_end=0.04)
    assert abs(solution.q[0]).max() < 1e-7
    assert abs(solution.q[1]).max() > 1e-3


def test_a_massless_slide_starts_where_its_spring_balances_the_force():
    scene, guide = clamped_bar((1, 0), fb.Section(1e4, 1e4, 10.0, 1.0, 0.1), elements=2)
    tail = scene.add_beam([(1, 0), (2, 0)], LIGHT, elements=2)
    joint = fb.Prismatic(guide.end, tail.start, axis=(1, 0), spring=fb.Spring(50.0))
    joint = scene.add_joint(joint)
    scene.add_force(tail.end, (10.0, 0.0))
    solution = fb.simulate(scene, dt=1e-3, t_end=0.05)
    assert solution.joint(joint).slide == pytest.approx(np.full(51, 0.2), abs=1e-6)
    assert abs(solution.energy.balance_error).max() < 1e-12


def ball_over_a_rough_floor(scene):
    ball = scene.add_body((5, 1), mass=1.0, inertia=0.1).centre
    scene.add_contact(ball, fb.Line((0, 0), (0, 1)), 1e4, friction=fb.Coulomb(0.3, 1e4))


def members_on_a_rough_hinge(scene):
    bars = [scene.add_beam([(5, 0), (5 + x, 0)], MEMBER, elements=1) for x in (-1, 1)]
    friction = fb.Coulomb(0.3, 1e4, radius=0.1)
    scene.add_joint(fb.Revolute(bars[0].start, bars[1].start, friction=friction))


def member_that_yields(scene):
    scene.add_beam([(5, 0), (6, 0)], PLASTIC, elements=1)


@pytest.mark.parametrize(
    "add", [ball_over_a_rough_floor, members_on_a_rough_hinge, member_that_yields]
)
def test_what_remembers_its_past_elsewhere_does_not_change_how_massless_parts_start(add):
    spins = []
    for beside in (lambda scene: None, add):
        scene, beam = massless_cantilever(rhoA=1.0)
        scene.add_moment(beam.end, 5.0)
        beside(scene)
        spins.append(fb.simulate(scene, dt=1e-3, t_end=0.01).spin(beam.end))
    assert spins[1] == pytest.approx(spins[0], abs=1e-6)


def test_a_load_that_begins_at_zero_finds_the_start_as_it_is():
    scene, beam = bent()
    scene.loads.clear()
    scene.add_moment(beam.end, lambda t: 20.0 * t)
    solution = fb.simulate(scene, dt=0.01, t_end=0.1)
    assert not solution.q[0].any()
    assert solution.rotation(beam.end) == pytest.approx(2 * solution.t, abs=2e-5)  # of second order


def remembering(update):
    """A massless cantilever under a moment of 0.3 N m: EI = 1 N m^2, with a memory 3 N m^2."""

    def energy(eps, gamma, kappa, a):
        return 5e3 * eps**2 + 2e3 * gamma**2 + kappa**2 / 2 + (kappa - a[0]) ** 2

    section = fb.Section(strain_energy=energy, internal=fb.InternalVariables(("dashpot",), update))
    scene, beam = clamped_bar((1, 0), section, elements=4)
    scene.add_moment(beam.end, 0.3)
    return scene, beam


def relax(old, strains0, strains, dt):
    return [(old[0] + dt / 0.5 * strains[2]) / (1 + dt / 0.5)]


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.EnergyDecaying(), fb.Newmark()])
def test_a_massless_member_creeps_from_its_elastic_bend_on(scheme):
    """Zener: of the moment that a jump finds, two of three parts relax in 0.5 s at a strain."""
    scene, beam = remembering(relax)
    solution = fb.simulate(scene, scheme, dt=0.01, t_end=1.0)
    exact = 0.3 * (1 - 2 / 3 * np.exp(-solution.t / 1.5))
    assert solution.rotation(beam.end) == pytest.approx(exact, abs=2e-4)
    assert abs(solution.energy.balance_error).max() < 1e-12


def test_a_massless_member_that_may_yield_starts_as_it_is_with_a_warning(caplog):
    def flow(old, strains0, strains, dt):
        return [ufl.conditional(abs(strains[2] - old[0]) > 5, strains[2], old[0])]

    scene, _ = remembering(flow)
    solution = fb.simulate(scene, dt=0.01, t_end=0.01)
    assert not solution.q[0].any()
    assert "no equilibrium was found at the start for nodes without mass" in caplog.text


def test_a_load_without_equilibrium_is_named_before_the_step_fails(caplog):
    law = fb.Spring(strain_energy=lambda turn: 10 * ((1 + turn**2) ** 0.5 - 1))
    scene, _ = bent()
    flap = scene.add_beam([(0, -1), (1, -1)], LIGHT, elements=1)
    scene.add_joint(fb.Revolute(fb.GROUND, flap.start, spring=law))
    scene.add_moment(flap.end, 12.0)
    with pytest.raises(fb.StepError):
        fb.simulate(scene, dt=0.01, t_end=0.02)
    assert "no equilibrium was found at the start for nodes without mass" in caplog.text


@pytest.mark.parametrize("rho", [0.0, 1000.0])
@pytest.mark.parametrize("run", [fb.static, lambda scene: fb.simulate(scene, dt=0.1, t_end=0.1)])
def test_gravity_that_acts_on_no_mass_is_named(run, rho, caplog):
    scene, beam = clamped_bar(
        (1, 0), fb.Section.rectangle(0.1, 0.1, E=1e9, rho=rho), elements=1, gravity=(0, -9.81)
    )
    run(scene)
    assert ("gravity acts on no mass" in caplog.text) == (rho == 0)


def test_a_record_that_needs_more_than_the_memory_is_named_with_the_way_out(caplog, monkeypatch):
    monkeypatch.setattr("fx_beam.motions.run._MEMORY", 1e-4)  # [GB]
    scene = fb.Scene()
    scene.set_velocity(scene.add_body((0, 0), mass=1.0, inertia=1.0).centre, (1.0, 0.0))
    fb.simulate(scene, dt=1e-4, t_end=1.0, record=fb.Record(every=10))
    assert "the record" not in caplog.text
    fb.simulate(scene, dt=1e-4, t_end=1.0)
    # Three components of position, velocity and acceleration in each of 10 001 rows.
    assert "the record needs up to 0.00072 GB. Use Record(every=...) for less" in caplog.text


def test_a_lever_of_round_off_does_not_change_the_accelerations_at_the_start():
    """A body hangs on a beam without rotary inertia, which has a moment at its end."""

    def start(offset):
        section = fb.Section(EA=2e4, GA=1e4, EI=30.0, rhoA=1.5, retardation=0.002)
        scene, beam = clamped_bar((1, 0), section, elements=3, gravity=(1.0, -9.81))
        body = scene.add_body((1.1, 0.2), 1.2, 0.03, points={"pin": (1, 0)})
        scene.add_joint(fb.PinInSlot(beam.end, body["pin"], axis=(1, 0.3), offset=offset))
        scene.add_moment(beam.end, 1.0)
        return fb.simulate(scene, dt=1e-4, t_end=1e-4).acceleration(body.centre)[0]

    assert start((2e-17, -1e-17)) == pytest.approx(start((0.0, 0.0)), rel=1e-8)


@pytest.mark.parametrize("scheme", [fb.HHT(-0.3), fb.GeneralizedAlpha(0.8)], ids=str)
@pytest.mark.parametrize("goes_on", [False, True])
def test_a_support_that_jumps_just_after_the_start_does_as_one_that_jumps_later(scheme, goes_on):
    dt, size = 1e-4, 1e-3
    first = 5 * dt if goes_on else 0.0

    def end(t0):
        section = fb.Section(EA=1e5, GA=1e5, EI=1e3, rhoA=5.0, rhoI=1e-3, retardation=0.01)
        scene = fb.Scene()
        beam = scene.add_beam([(0, 0), (1, 0)], section, elements=2, degree=2)
        still = {"y": lambda t: 0.0, "rotation": lambda t: 0.0}
        scene.prescribe(beam.start, x=lambda t: size * (t > t0 + dt / 1e9), **still)
        rest = fb.simulate(scene, dt=dt, t_end=first) if goes_on else None
        run = fb.simulate(scene, scheme, dt=dt, t_end=first + 4e-3, start=rest)
        return run.displacement(beam.end)[:, 0]

    at_once, later = end(first), end(first + 2 * dt)
    assert abs(at_once[-1]) > size / 2
    assert abs(at_once[:-2] - later[2:]).max() < 1e-6 * size


@pytest.mark.parametrize("at", [0.0, 0.1, 0.1009])
@pytest.mark.parametrize("scheme", [fb.Newmark(), fb.HHT(-0.1), fb.GeneralizedAlpha(0.8)], ids=str)
@pytest.mark.parametrize("kind", ["support", "motor", "crank"])
def test_what_jumps_rests_a_few_steps_later_by_newmarks_family(kind, scheme, at, caplog):
    """Beside it a mass behind a spring, u'' = w^2 (x - u); a crank holds its weight."""
    scene = fb.Scene(gravity=(0, -9.81 * (kind == "crank")))
    driven, mass = (scene.add_body((x, 0), 1.0, 0.1, points={"O": (x - 0.5, 0)}) for x in (0, 1))
    for node in [driven.centre][: kind == "support"] + [mass.centre]:
        scene.fix(node, "y", "rotation")

    def law(t):
        return 0.1 * (t > at)

    if kind == "support":
        scene.prescribe(driven.centre, x=law)
    elif kind == "motor":
        scene.add_joint(fb.Prismatic(fb.GROUND, driven.centre, axis=(1, 0), motor=law))
    else:
        crank = scene.add_joint(fb.Revolute(fb.GROUND, driven["O"], motor=law))
    if kind != "crank":
        scene.add_force_between(driven.centre, mass.centre, spring=fb.Spring(40.0, rest=1.0))
    motion = fb.simulate(scene, scheme, dt=2e-3, t_end=0.3)
    later = motion.t > at + 9e-3
    assert abs(motion.acceleration(driven.centre)[later]).max() < 1e-6
    assert abs(motion.velocity(driven.centre)[later]).max() < 1e-9
    assert "jumps" not in caplog.text
    if kind == "crank":
        torque = motion.motor_forces[:, crank.number][later]
        assert torque == pytest.approx(9.81 * 0.5 * np.cos(0.1), rel=1e-6)
        return
    w, t = np.sqrt(40.0), np.maximum(motion.t - at, 0.0)
    exact = 0.1 * (1 - np.cos(w * t))
    np.testing.assert_allclose(motion.displacement(mass.centre)[:, 0], exact, rtol=0, atol=1e-3)
    work = motion.energy.work[-1]
    assert work == pytest.approx(40.0 * 0.1**2 / 2, rel=0.001)  # of the spring alone


@pytest.mark.parametrize(
    "scheme", [fb.Newmark(), fb.HHT(-0.1), fb.GeneralizedAlpha(0.8), fb.EnergyMomentum()], ids=str
)
@pytest.mark.parametrize("begins", ["as drawn", "static", "another scheme", "later"])
def test_a_jump_does_the_work_of_the_mean_forces(scheme, begins):
    """On a bar of 40 N/m between two nodes, and on a bed of 30 N/m^2 that a user adds.

    In the first step, or in the eleventh.
    """
    section = fb.Section(EA=40.0, GA=40.0, EI=1.0, rhoA=1.0, rhoI=0.1)
    scene, last = fb.Scene(), 0.1
    bar = scene.add_beam([(0, 0), (1, 0)], section, elements=1)
    scene.add_virtual_work(lambda step: -30.0 * step.u[0] * step.virtual_u[0])
    scene.clamp(bar.end)
    goes_on = begins == "another scheme"
    t0 = 0.1 if goes_on else 0.0
    jumps = t0 + 0.0101 * (begins == "later")
    still = {"y": lambda t: 0.0, "rotation": lambda t: 0.0}
    scene.prescribe(bar.start, x=lambda t: last * (t > jumps), **still)
    start = None
    if begins == "static":
        start = fb.static(scene)
    elif goes_on:
        other = fb.EnergyMomentum() if scheme == fb.Newmark() else fb.Newmark()
        start = fb.simulate(scene, other, dt=1e-3, t_end=t0)
    energy = fb.simulate(scene, scheme, dt=1e-3, t_end=t0 + 0.02, start=start).energy
    stored = 40.0 * last**2 / 2
    assert energy.strain[-1] == pytest.approx(stored, rel=1e-6)
    if scheme != fb.EnergyMomentum():  # with which the masses are in motion from then on
        assert energy.work[-1] == pytest.approx(stored, rel=1e-6)
    assert abs(energy.balance_error).max() < 1e-6 * stored


@pytest.mark.parametrize("scheme", [fb.Newmark(), fb.HHT(-0.1), fb.GeneralizedAlpha(0.8)], ids=str)
def test_the_power_of_a_line_has_the_work_of_a_jump(scheme):
    """k x^2/2 + c x^2/dt, with a damper that acts on the rate x/dt of one step."""
    k, c, last, dt = 40.0, 0.002, 0.1, 2e-3
    scene = fb.Scene()
    block = scene.add_body((0, 0), 1.0, 0.1).centre
    scene.prescribe(block, x=lambda t: last * (t > 0.1009))
    scene.fix(block, "y", "rotation")
    laws = {"spring": fb.Spring(k, rest=1.0), "damper": fb.Damper(c)}
    line = scene.add_force_between(block, (-1, 0), **laws)
    motion = fb.simulate(scene, scheme, dt=dt, t_end=0.2)
    taken = k * last**2 / 2 + c * last**2 / dt
    assert motion.joint(line).power.sum() * dt == pytest.approx(taken, rel=1e-9)
    assert motion.energy.work[-1] == pytest.approx(taken, rel=1e-9)


def hung_on(place):
    """A bob on a block that moves to place(t) along x."""
    scene = fb.Scene(gravity=(0, -9.81))
    block = scene.add_body((0, 0), 1.0, 0.1).centre
    bob = scene.add_body((0, -1), 1.0, 0.1, points={"P": (0, 0)})
    scene.add_joint(fb.Revolute(block, bob["P"]))
    scene.prescribe(block, x=place)
    scene.fix(block, "y", "rotation")
    return scene


def by_motion(scene, scheme, t_end=0.12, **inputs):
    motion = fb.Motion(scene, scheme, dt=2e-3)
    for _ in range(round(t_end / 2e-3)):
        motion.step({name: place(motion.t) for name, place in inputs.items()})


def by_dolfinx(scene, scheme, t_end):
    fenicsx = pytest.importorskip("fx_beam.fenicsx")
    scene.clamp(scene.add_beam([(5, 0), (6, 0)], MEMBER, elements=1).start)
    problem = fenicsx.Problem(scene, scheme, dt=2e-3)
    for _ in range(round(t_end / 2e-3)):
        problem.advance()


def by_simulate(scene, scheme, t_end, **options):
    fb.simulate(scene, scheme, t_end=t_end, **options)


FEW_ROWS = fb.Record(every=7, rates=False)
WAYS = {
    "steps": functools.partial(by_simulate, dt=2e-3),
    "few rows": functools.partial(by_simulate, dt=2e-3, record=FEW_ROWS),
    "tolerance": functools.partial(by_simulate, tolerance=1e-3, breaks=[0.1]),
    "motion": by_motion,
    "dolfinx": by_dolfinx,
}


def jump(t):
    return 0.1 * (t > 0.1)


@pytest.mark.parametrize("scheme", [fb.Newmark(), fb.HHT(-0.1), fb.GeneralizedAlpha(0.8)], ids=str)
@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("t_end", [0.12, 0.102])
def test_newmarks_family_tells_of_driven_motions_that_jump_and_have_bodies_on_joints(
    t_end, way, scheme, caplog
):
    """Also in the last step."""
    WAYS[way](hung_on(jump), scheme, t_end)
    assert caplog.text.count("jumps in the step to t = 0.10") == 1
    caplog.clear()
    WAYS[way](hung_on(lambda t: 0.1 * np.sin(30 * t) ** 2), scheme, t_end)
    WAYS[way](hung_on(lambda t: 0.5 * max(t - 0.1013, 0.0)), scheme, t_end)
    WAYS[way](hung_on(jump), fb.EnergyMomentum(), t_end)
    assert "jumps" not in caplog.text


def test_newmarks_family_tells_of_inputs_that_jump(caplog):
    by_motion(hung_on(fb.Input("x")), fb.HHT(), x=jump)
    assert caplog.text.count("jumps in the step to t = 0.10") == 1
    caplog.clear()
    by_motion(hung_on(fb.Input("x")), fb.HHT(), x=np.sin)
    assert "jumps" not in caplog.text


@pytest.mark.parametrize(
    "scheme",
    [fb.Newmark(), fb.HHT(0), fb.GeneralizedAlpha(1.0), fb.Newmark(0.25, 0.6), fb.Newmark(0.4, 0.5),
     fb.Newmark(0.35, 0.6), fb.HHT(-0.1), fb.GeneralizedAlpha(0.8), fb.EnergyMomentum()],
    ids=str,
)  # fmt: skip
def test_rules_by_which_accelerations_of_bodies_do_not_converge_say_so(scheme, caplog):
    """A pendulum (2 kg, 0.3 kg m^2, arm 0.8 m) from its lowest place with 4 rad/s."""
    m, inertia, arm, spin, g = 2.0, 0.3, 0.8, 4.0, 9.81

    def swing(_, y):
        return y[1], -m * g * arm / (inertia + m * arm**2) * np.sin(y[0])

    exact = solve_ivp(swing, (0, 1), (0, spin), rtol=1e-10, atol=1e-12, dense_output=True).sol
    errors = []
    for dt in (0.01, 0.0025):
        scene = fb.Scene(gravity=(0, -g))
        bob = scene.add_body((0, -arm), m, inertia, points={"O": (0, 0)})
        scene.add_joint(fb.Revolute(fb.GROUND, bob["O"]))
        scene.set_velocity(bob, (spin * arm, 0), spin=spin)
        motion = fb.simulate(scene, scheme, dt=dt, t_end=1.0)
        angle, rate = exact(motion.t)
        bend, c, s = swing(0, (angle, rate))[1], np.cos(angle), np.sin(angle)
        expected = arm * np.stack([c * bend - s * rate**2, s * bend + c * rate**2], axis=1)
        errors.append(abs(motion.acceleration(bob.centre) - expected)[1:].max())
    told = "accelerations of bodies that turn on joints" in caplog.text
    assert told == (errors[1] > errors[0] / 2)


def test_what_hangs_on_a_support_that_starts_with_a_speed_has_the_rates_of_the_blow():
    """The projection by hand, with the consistent mass of elements of degree 1."""
    V, n, rhoA, length = 0.7, 3, 2.0, 1.5
    scene = fb.Scene()
    section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=rhoA, rhoI=0.1)
    beam = scene.add_beam([(0, 0), (length, 0)], section, elements=n, degree=1)
    scene.prescribe(beam.start, x=lambda t: V * t, y=lambda t: 0.0, rotation=lambda t: 0.0)
    M = np.zeros((n + 1, n + 1))
    for i in range(n):
        M[i : i + 2, i : i + 2] += rhoA * length / n * np.array([[2, 1], [1, 2]]) / 6
    rates = np.append(V, -np.linalg.solve(M[1:, 1:], M[1:, 0] * V))
    run = fb.simulate(scene, dt=1e-5, t_end=1e-3)
    x = [run.velocity(beam.node(i / n))[0, 0] for i in range(n + 1)]
    assert x == pytest.approx(rates, rel=1e-6)
    assert run.energy.kinetic[0] == pytest.approx(rates @ M @ rates / 2, rel=1e-6)
    assert abs(run.energy.balance_error).max() < 1e-9 * run.energy.kinetic[0]
    # As one that starts a step later, in which it has the same speed.
    scene.prescribed.clear()
    scene.prescribe(
        beam.start, x=lambda t: V * max(t - 1e-5, 0), y=lambda t: 0.0, rotation=lambda t: 0.0
    )
    later = fb.simulate(scene, dt=1e-5, t_end=1e-3).displacement(beam.end)[1:, 0]
    assert run.displacement(beam.end)[:-1, 0] == pytest.approx(later, abs=1e-3 * V * 1e-3)
