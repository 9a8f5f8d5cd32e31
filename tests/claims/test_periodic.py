"""Motions that repeat themselves: against closed solutions, other integrators and long motions."""

import math

import ufl

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, guided_body, one_body, pinned_bar, supported_bar
from scipy.integrate import solve_ivp
from scipy.special import ellipk

import fx_beam as fb

HARD = fb.Spring(stiffness=1.0, strain_energy=lambda x: x**4 / 4)


def duffing(damping=0.0, force=None, stop=None):
    """A body of 1 kg with the spring force x + x^3."""
    scene, body = one_body((0, 0), mass=1.0, inertia=1.0)
    damper = fb.Damper(damping) if damping else None
    spring = HARD if stop is None else fb.Spring(stiffness=1.0)
    scene.add_joint(
        fb.Prismatic(fb.GROUND, body.centre, (1, 0), spring=spring, damper=damper, stop=stop)
    )
    if force is not None:
        scene.add_force(body.centre, lambda t: (force(t), 0.0))
    return scene, body


@pytest.mark.parametrize("push", [0.0, 3.0])
def test_a_motion_within_the_elastic_range_keeps_the_plastic_strain_of_its_start(push):
    """A mass on a spring of 1 N/m that yields at 2 N; a push leaves a plastic slide."""

    def energy(x, a):
        return (x - a[0]) ** 2 / 2 + 0.05 * a[0] ** 2

    def flow(old, strains0, strains, dt):
        trial = strains[0] - 1.1 * old[0]
        excess = ufl.max_value(abs(trial) - 2.0, 0)
        return [old[0] + ufl.sign(trial) * excess / 1.1]

    spring = fb.Spring(
        strain_energy=energy, internal=fb.InternalVariables(("plastic slide",), flow)
    )
    laws = {"spring": spring, "damper": fb.Damper(0.2)}
    scene, body, guide = guided_body((0, 0), 1.0, 1.0, **laws)
    load = scene.add_force(body, (push, 0.0))
    pushed = fb.static(scene, load_steps=6)
    load = scene.change(load, (0.0, 0.0))
    released = fb.static(scene, start=pushed)
    scene.change(load, lambda t: (0.5 * math.sin(2 * t), 0.0))
    computed = fb.periodic(scene, start=released, period=math.pi, steps=101).solution.joint(guide)
    left = released.joint(guide).internal("plastic slide")[-1]
    assert left == pytest.approx(10 * max(push - 2.0, 0.0), rel=1e-9)
    assert computed.internal("plastic slide") == pytest.approx(np.full(102, left), abs=1e-12)
    assert np.ptp(computed.slide) / 2 == pytest.approx(0.5 / math.hypot(3.0, 0.4), rel=2e-3)
    assert computed.slide.max() + computed.slide.min() == pytest.approx(2 * left, abs=1e-3)


def frequency_of_duffing(amplitude):
    e = amplitude**2
    return math.pi * math.sqrt(1 + e) / (2 * ellipk(e / (2 * (1 + e))))


def pinned(slenderness, elements):
    section = fb.Section(EA=slenderness**2, GA=10 * slenderness**2, EI=1.0, rhoA=1.0)
    scene, beam = supported_bar((1, 0), section, elements=elements, degree=2, held="xy")
    return scene, beam


def pendulum():
    """A mass on a bar that is nearly rigid, released at 90 degrees."""
    section = fb.Section(EA=1e7, GA=1e7, EI=1e7)
    scene, bar = pinned_bar((1, 0), section, elements=1, gravity=(0, -9.81))
    scene.add_mass(bar.end, 1.0)
    return scene, bar


def two_bodies():
    scene = fb.Scene(gravity=(0, -9.81))
    one = scene.add_body((0.5, 0), mass=1.0, inertia=0.1, points={"a": (0, 0), "b": (1, 0)})
    two = scene.add_body((1.5, 0), mass=1.0, inertia=0.1, points={"b": (1, 0)})
    scene.add_joint(fb.Revolute(fb.GROUND, one["a"], spring=fb.Spring(stiffness=100.0)))
    scene.add_joint(fb.Revolute(one["b"], two["b"], spring=fb.Spring(stiffness=30.0)))
    return scene, two


SPEED = 20.0  # [rad/s]


def repeats(scene, motion, scheme=None):
    """Largest distance of all nodes from where they were, after periods of a simulation."""
    first = motion.solution
    dt = motion.period / (len(first.t) - 1)
    t_end = float(first.t[-1]) + 2 * motion.period
    later = fb.simulate(scene, scheme, dt=dt, t_end=t_end, start=first)
    row = 2 * (len(first.t) - 1)
    x = first.q[..., :2] + first.X
    return abs(later.q[row, :, :2] + later.X - x[-1]).max() / np.ptp(x, axis=0).max()


# -- Free motions ------------------------------------------------------------------------------


@pytest.mark.parametrize("order", [2, 4])
def test_the_period_of_a_hardening_spring_has_the_order_of_the_scheme(order):
    scene, body = duffing()
    errors = []
    for steps in (31, 61):
        scheme = fb.EnergyMomentum(order=order)
        swing = fb.periodic(scene, mode=0, amplitude=1.5, steps=steps, scheme=scheme)
        assert swing.error < 1e-9
        errors.append(2 * np.pi * swing.frequency / frequency_of_duffing(1.5) - 1)
    assert np.log(errors[0] / errors[1]) / np.log(61 / 31) == pytest.approx(order, abs=0.3)


def test_a_period_far_from_that_of_the_mode_is_not_taken_for_several():
    amplitude = 50.0
    scene, body = duffing()
    motion = fb.periodic(scene, mode=0, amplitude=amplitude, steps=101)
    exact = frequency_of_duffing(amplitude) / (2 * math.pi)
    assert motion.frequency == pytest.approx(exact, rel=1e-3)
    x = motion.solution.position(body.centre)[:, 0]
    assert abs(x).max() == pytest.approx(amplitude, rel=1e-4)


def test_the_period_of_a_pendulum_at_90_degrees():
    scene, bar = pendulum()
    motion = fb.simulate(scene, dt=0.02, t_end=3.0)
    scheme = fb.EnergyMomentum(order=4)
    swing = fb.periodic(scene, start=motion, energy=0.0, steps=61, scheme=scheme)
    small = 2 * np.pi / np.sqrt(9.81)
    assert swing.period / small == pytest.approx(1.18034, abs=2e-5)
    assert swing.amplitude(bar.end, "x") == pytest.approx(1.0, abs=1e-4)
    assert swing.stable


@pytest.mark.parametrize("ratio, known", [(1, 1.0892), (3, 1.6257)])
def test_a_beam_between_fixed_hinges_has_the_frequencies_of_woinowsky_krieger(ratio, known):
    # His single mode is that of slender beams; here L / r = 200, where they differ by 1e-3.
    scene, beam = pinned(200.0, elements=4)
    linear = float(fb.modes(scene, n=1).frequencies[0])
    scheme = fb.EnergyMomentum(order=4)
    motion = fb.periodic(scene, mode=0, amplitude=ratio / 200, steps=41, scheme=scheme)
    assert motion.frequency / linear == pytest.approx(known, rel=1.2e-3)
    assert motion.error < 1e-9
    energy = motion.solution.energy
    assert np.ptp(energy.total) < 1e-9 * energy.total[0]


def test_bodies_on_hinges_swing_and_repeat_themselves():
    scene, two = two_bodies()
    state = fb.static(scene)
    motion = fb.periodic(scene, mode=0, amplitude=0.5, state=state, steps=101)
    assert motion.error < 1e-9
    assert repeats(scene, motion) < 1e-8
    # Free motions without losses have the multiplier 1 twice, and the others on the unit circle.
    assert len(motion.multipliers) == 4
    assert np.sort(abs(motion.multipliers - 1))[:2] == pytest.approx([0, 0], abs=1e-4)
    assert abs(motion.multipliers) == pytest.approx(1.0, abs=1e-4)
    assert motion.stable


def test_a_motion_has_the_energy_that_is_wanted():
    scene, body = duffing()
    swing = fb.periodic(scene, mode=0, energy=0.75, steps=41)  # amplitude 1
    assert swing.energy == pytest.approx(0.75, rel=1e-9)
    assert swing.solution.energy.total == pytest.approx(0.75, rel=1e-9)
    assert swing.amplitude(body.centre, "x") == pytest.approx(1.0, abs=3e-3)


def test_a_backbone_of_a_beam_begins_at_rest_and_ends_at_its_amplitude():
    ratio = 5.0
    scene, beam = pinned(200.0, elements=2)
    family = fb.backbone(scene, amplitude=ratio / 200, steps=41)
    for motion in family:
        assert abs(motion.solution.v[0]).max() < 1e-5 * abs(motion.solution.v).max()
    last = family[-1].solution
    middle = last.nodes_of_beam[beam.name]
    middle = middle[len(middle) // 2]
    assert last.q[0, middle, 1] == pytest.approx(ratio / 200, rel=1e-8)
    assert abs(last.q[:, middle, 1]).max() == pytest.approx(ratio / 200, rel=1e-6)


def test_a_backbone_ends_at_its_amplitude_beside_a_body_far_away():
    frequencies, sizes = [], []
    for far in (False, True):
        section = fb.Section(EA=1e3, GA=1e3, EI=0.1, rhoA=1.0, rhoI=0.01)
        scene, beam = clamped_bar((1, 0), section, elements=3)
        body = scene.add_body((1, 0), mass=0.5, inertia=0.01)
        scene.add_joint(fb.Rigid(beam.end, body.centre))
        if far:
            scene.clamp(scene.add_body((30, 5), mass=1.0, inertia=0.1).centre)
        last = fb.backbone(scene, amplitude=0.3, steps=41)[-1]
        frequencies.append(last.frequency)
        sizes.append(abs(last.solution.displacement(body.centre)[:, 1]).max())
    assert sizes == pytest.approx([0.3, 0.3], rel=1e-6)
    assert frequencies[1] == pytest.approx(frequencies[0], rel=1e-6)


@pytest.mark.parametrize("mode", [0, 1])
def test_a_backbone_of_bodies_ends_at_its_amplitude(mode):
    amplitude = 1.0
    scene, two = two_bodies()
    state = fb.static(scene)
    family = fb.backbone(scene, mode, amplitude=amplitude, state=state, steps=41)
    start = family[-1].solution.q[0] - state.q[-1]
    assert abs(start[:, :2]).max() == pytest.approx(amplitude, rel=1e-8)
    rates = abs(family[-1].solution.v)
    assert rates[0].max() < 1e-9 * rates.max()


# -- Forced motions ----------------------------------------------------------------------------


def exact_orbit(rates, period, start):
    """State of a motion of order two that repeats itself, and its multipliers, by solve_ivp."""

    def after(x):
        options = {"rtol": 1e-11, "atol": 1e-13, "max_step": period / 100}
        return solve_ivp(rates, (0, period), x, **options).y[:, -1]

    x, h = np.array(start), 1e-5
    for _ in range(5):  # Newton's method, down to the rounding errors of the integrator
        columns = [(after(x + h * e) - after(x - h * e)) / (2 * h) for e in np.eye(2)]
        after_period = np.column_stack(columns)
        x = x + np.linalg.solve(np.eye(2) - after_period, after(x) - x)
    return x, np.linalg.eigvals(after_period)


def by_size(values):
    return sorted(values, key=abs)


def test_a_forced_motion_and_its_multipliers_are_those_of_another_integrator():
    w, c = 1.3, 0.2

    def force(t):
        return 0.3 * math.cos(w * t)

    def rates(t, x):
        return [x[1], force(t) - c * x[1] - x[0] - x[0] ** 3]

    errors, exact = [], None
    for steps in (101, 51):
        scene, body = duffing(c, force)
        motion = fb.periodic(scene, period=2 * np.pi / w, steps=steps)
        start = motion.solution.displacement(body.centre)[0, 0]
        spin = motion.solution.velocity(body.centre)[0, 0]
        if not errors:
            exact, multipliers = exact_orbit(rates, motion.period, [start, spin])
            damped = np.prod(motion.multipliers).real
            assert by_size(motion.multipliers) == pytest.approx(by_size(multipliers), abs=3e-3)
            assert damped == pytest.approx(np.exp(-c * motion.period), rel=2e-3)
        errors.append([start - exact[0], spin - exact[1]])
    assert np.log2(abs(np.divide(*errors[::-1]))) == pytest.approx(2.0, abs=0.1)
    assert abs(errors[0][0]) < 2e-3


def test_an_impact_oscillator_repeats_its_impacts():
    w, c, k, gap = 1.4, 0.1, 50.0, 0.3

    def force(t):
        return 0.4 * math.cos(w * t)

    def rates(t, x):
        push = k * max(x[0] - gap, 0.0)
        return [x[1], force(t) - c * x[1] - x[0] - push]

    scene, body = duffing(c, force, fb.Stop(None, gap, stiffness=k))
    motion = fb.periodic(scene, period=2 * np.pi / w, steps=401)
    start = motion.solution.displacement(body.centre)[0, 0]
    spin = motion.solution.velocity(body.centre)[0, 0]
    exact, multipliers = exact_orbit(rates, motion.period, [start, spin])
    assert motion.solution.displacement(body.centre)[:, 0].max() > gap + 0.02
    assert [start, spin] == pytest.approx(exact, abs=2e-3)
    assert by_size(motion.multipliers) == pytest.approx(by_size(multipliers), abs=2e-2)


def test_motions_that_are_tiny_beside_the_scene_are_found():
    def response(load):
        section = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, retardation=5e-3)
        scene, beam = clamped_bar((1, 0), section, elements=3)
        scene.add_force(beam.end, lambda t: (0.0, load * math.cos(0.8 * math.pi * t)))
        return fb.periodic(scene, period=2.5, steps=41).amplitude(beam.end) / load

    assert response(1e-8) == pytest.approx(response(1e-5), rel=1e-6)


def test_a_forced_response_passes_folds_between_which_it_is_unstable():
    def build(f):
        scene, build.body = duffing(0.1, lambda t: 0.3 * math.cos(2 * math.pi * f * t))
        return scene

    curve = fb.forced_response(build, (0.15, 0.4), steps=51)
    w, stable = 2 * np.pi * curve.frequencies, curve.stable
    back = np.diff(w) < 0
    assert back.any() and not stable[1:][back].all()
    kinds = {motion.instability for motion in curve}
    assert kinds == {"", "fold"}
    # Stability changes where the frequency turns back.
    turns = [k for k in range(1, len(w) - 1) if (w[k + 1] - w[k]) * (w[k] - w[k - 1]) < 0]
    assert [kind for _, kind, _ in curve.critical] == ["fold", "fold"]
    assert [k for k, *_ in curve.critical] == pytest.approx(turns, abs=1)
    # The equation of the first harmonic: ((1 - w^2) a + 3/4 a^3)^2 + (c w a)^2 = F^2.
    a = curve.amplitudes(build.body.centre, "x")
    force = np.hypot((1 - w**2) * a + 0.75 * a**3, 0.1 * w * a)
    assert force[(w > 1.2) & (a < 0.7)] == pytest.approx(0.3, rel=0.05)
    # The amplitude at the peak is that of the backbone, where damping balances the force.
    peak = np.argmax(a)
    assert a[peak] * 0.1 * w[peak] == pytest.approx(0.3, rel=0.05)
    assert w[peak] == pytest.approx(frequency_of_duffing(a[peak]), rel=0.02)


def dry_friction(w, steps):
    """A block of 1 kg on a spring of 1 N/m and a rail with friction, and its motion under 1 N."""
    own = {"spring": fb.Spring(1.0), "friction": fb.Coulomb(0.03, 1e5)}
    scene, block, _ = guided_body((0, 0), 1.0, 1.0, **own, gravity=(0, -10.0))
    if w is None:
        return scene
    scene.add_force(block, lambda t: (math.cos(w * t), 0.0))
    motion = fb.periodic(scene, period=2 * math.pi / w, steps=steps)
    assert repeats(scene, motion) < 1e-9
    return motion.amplitude(block, "x")


def test_dry_friction_of_a_joint_leaves_the_amplitude_of_den_hartog():
    w = 1.4
    # Without stops: (1 / (1 - w^2))^2 - (F_f / F)^2 (tan(pi / (2 w)) / w)^2, F_f = mu m g.
    exact = math.sqrt((1 / (1 - w**2)) ** 2 - (0.3 * math.tan(math.pi / (2 * w)) / w) ** 2)
    errors = [dry_friction(w, steps) / exact - 1 for steps in (101, 401)]
    assert abs(errors[1]) < 1.5e-3 and abs(errors[0]) < 1e-2


def test_a_quick_return_mechanism_whose_pin_slides_on_a_beam_repeats_itself():
    scheme = fb.EnergyDecaying()
    section = fb.Section(EA=2e5, GA=8e4, EI=20.0, rhoA=0.3, rhoI=1e-5, retardation=1e-3)
    stiff = fb.Section(EA=2e6, GA=8e5, EI=2e3, rhoA=1.0, rhoI=1e-3, retardation=1e-3)
    scene, rocker = pinned_bar((0, 1), section, elements=4)
    crank = scene.add_beam([(0, 0.45), (0, 0.65)], stiff, elements=1)
    motor = scene.add_joint(fb.Revolute(fb.GROUND, crank.start, motor=lambda t: SPEED * t))
    pin = scene.add_joint(fb.Slider(rocker, crank.end))
    scene.make_velocities_compatible()
    cycle = fb.periodic(scene, period=2 * np.pi / SPEED, steps=101, scheme=scheme)
    assert cycle.stable and cycle.error < 1e-9 and cycle.iterations < 10
    assert repeats(scene, cycle, scheme) < 1e-8
    assert np.ptp(cycle.solution.joint(pin).slide) > 0.39
    energy = cycle.solution.energy
    assert np.ptp(energy.work[[0, -1]]) == pytest.approx(energy.dissipated[-1], rel=1e-7)
    assert abs(energy.balance_error).max() < 1e-9 * energy.dissipated[-1]
    assert cycle.solution.stats.steps == 101
    power = cycle.solution.joint(motor).motor_power[1:]
    work = np.sum(power * np.diff(cycle.solution.t))
    assert work == pytest.approx(energy.dissipated[-1], rel=1e-3)


# -- At rest -----------------------------------------------------------------------------------


def test_a_hanging_beam_at_rest_has_the_multipliers_of_its_vibrations():
    def hanging(held):
        section = fb.Section(EA=1e3, GA=1e3, EI=1.0, rhoA=1.0)
        scene, beam = pinned_bar((0, -1), section, elements=2, gravity=(0, -9.81))
        if held:
            scene.fix(beam.end, "x")
        return scene

    rest, scene = fb.static(hanging(held=True)), hanging(held=False)
    motion = fb.periodic(scene, start=rest, period=0.5, steps=401)
    assert motion.stable and motion.iterations == 0 and motion.error < 1e-12
    assert abs(motion.multipliers) == pytest.approx(1.0, abs=1e-6)
    turned = np.angle(motion.multipliers)
    for f in fb.modes(scene, n=2, state=rest).frequencies:
        assert abs(np.exp(1j * turned) - np.exp(1j * np.pi * f)).min() < 2e-3


@pytest.mark.parametrize("pulse, kind", [(0.3, "period doubling"), (0.1, "")])
def test_a_spring_that_pulsates_at_rest_has_the_multipliers_of_mathieus_equation(pulse, kind):
    scene, body = one_body((0, 0), mass=1.0, inertia=1.0)
    k = fb.Parameter("k", lambda t: 1 + pulse * math.cos(2 * t))
    spring = fb.Spring(strain_energy=lambda x: k * x**2 / 2)
    joint = fb.Prismatic(fb.GROUND, body.centre, (1, 0), spring=spring, damper=fb.Damper(0.1))
    scene.add_joint(joint)
    rest = fb.periodic(scene, period=np.pi, steps=201)

    def rates(t, x):
        return [x[1], -(1 + pulse * math.cos(2 * t)) * x[0] - 0.1 * x[1]]

    _, exact = exact_orbit(rates, np.pi, [0.0, 0.0])
    assert by_size(rest.multipliers) == pytest.approx(by_size(exact), abs=1e-3)
    assert rest.instability == kind


# -- What is refused ---------------------------------------------------------------------------


def test_an_amplitude_that_the_family_of_a_mode_does_not_reach_is_refused():
    scene, _ = two_bodies()  # its amplitude turns back at 1.28 m
    with pytest.raises(RuntimeError, match="nor does the family of the mode come to it"):
        fb.periodic(scene, mode=1, amplitude=1.5, state=fb.static(scene), steps=41)


def test_what_takes_energy_from_free_motions_is_refused():
    scene, _ = pinned(10.0, elements=1)
    with pytest.raises(fb.SceneError, match="EnergyDecaying.* takes energy from a free motion"):
        fb.periodic(scene, mode=0, amplitude=0.1, scheme=fb.EnergyDecaying())
    with pytest.raises(fb.SceneError, match="friction of joints takes energy"):
        fb.periodic(dry_friction(None, steps=None), mode=0, amplitude=0.1)


def test_a_free_motion_that_loses_energy_does_not_repeat_itself():
    scene, _ = duffing(0.1)
    with pytest.raises(RuntimeError, match="there is none if energy is lost"):
        fb.periodic(scene, mode=0, amplitude=1.0, steps=21)


def test_a_scheme_of_ones_own_follows_forced_motions():
    """The springs of joints do not depend on it: amplitudes of x'' + c x' + x = F cos(w t)."""

    def build(f):
        scene, build.body, _ = guided_body(
            (0, 0), 1.0, 1.0, spring=fb.Spring(1.0), damper=fb.Damper(0.2)
        )
        scene.add_force(build.body, lambda t: (0.1 * math.cos(2 * math.pi * f * t), 0.0))
        return scene

    def resultants(step, law):
        return fb.MidPoint().resultants(step, law)

    own = fb.Scheme("own", resultants, fb.MidPointRates())
    curve = fb.forced_response(build, (0.1, 0.14), scheme=own)
    w = 2 * np.pi * curve.frequencies
    exact = 0.1 / np.hypot(1 - w**2, 0.2 * w)
    assert len(curve) > 2 and curve.amplitudes(build.body, "x") == pytest.approx(exact, rel=5e-3)


def test_a_scene_that_build_changes_in_more_than_numbers_is_refused():
    def build(f):
        scene, body = duffing(0.1, lambda t: 0.1 * math.cos(2 * math.pi * f * t))
        if f > 0.1:
            scene.add_mass(body.centre, 1.0)
        return scene

    assert_refused("another structure", fb.forced_response, build, (0.1, 0.3), steps=21)


def cycle_of_van_der_pol(sense, c, unit, damped):
    """Scene of x'' + s c x' (1 - 4 x^2) + x = 0, by a pull with or without a damper."""
    laws = {"spring": fb.Spring(unit), "damper": fb.Damper(c * unit) if damped else None}
    scene, body, _ = guided_body((0, 0), unit, unit, **laws)

    def pull(distance, rate, t):
        return c * unit * (sense - damped - 4 * sense * (distance - 3) ** 2) * rate

    scene.add_force_between(body, (-3, 0), force=pull)
    scene.set_velocity(scene.bodies[0], (1.0, 0.0))
    start = fb.simulate(scene, dt=0.05, t_end=7.0 if sense > 0 else 30.0)
    return fb.periodic(scene, start=start, steps=101)


@pytest.mark.parametrize(("sense", "kind"), [(1, "fold"), (-1, "")])
@pytest.mark.parametrize("unit", [1.0, 1e-15])
def test_a_cycle_that_a_force_drives_is_unstable_or_stable_in_all_units(sense, kind, unit):
    for damped in (False, True):
        cycle = cycle_of_van_der_pol(sense, 0.3, unit, damped)
        assert cycle.instability == kind
        # Liouville: the other multiplier is e^(mean divergence times the period).
        expected = math.exp(sense * 0.6 * math.pi)
        assert np.prod(cycle.multipliers) == pytest.approx(expected, rel=0.05)


def test_a_weak_cycle_of_a_force_and_a_damper_is_no_family():
    """Its other multiplier is e^(2 pi c), as near to 1 as errors move the two of a family."""
    cycle = cycle_of_van_der_pol(1, 1e-4, 1.0, damped=True)
    assert np.prod(cycle.multipliers) == pytest.approx(1 + 2e-4 * math.pi, abs=1e-5)
    assert cycle.instability == "fold"


def test_a_load_that_is_the_same_at_all_parts_of_a_second_is_not_constant():
    scene, _ = duffing(force=lambda t: 0.1 * math.cos(2 * math.pi * 41 * t))
    with pytest.raises(fb.SceneError, match="depend on time"):
        fb.backbone(scene, amplitude=0.5, state=fb.static(scene), steps=41)
