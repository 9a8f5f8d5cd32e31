"""Springs with a stored energy of their own: hinges that yield or relax, springs that stiffen."""

import math

import ufl

import numpy as np
import pytest
from jointed import pair
from scenes import assert_refused, clamped_bar, forces_of_flow, one_bar

import fx_beam as fb

STIFF, HARDENING, YIELD = 400.0, 10.0, 3.0
SLOW, FAST, TAU = 40.0, 20.0, 0.5
LIGHT = fb.Section(EA=1e4, GA=1e4, EI=100.0)


def plastic(x, a):
    """Kinematic hardening: a[0] is the plastic part."""
    return STIFF / 2 * (x - a[0]) ** 2 + HARDENING / 2 * a[0] ** 2


def flow(old, strains0, strains, dt):
    trial = STIFF * (strains[0] - old[0]) - HARDENING * old[0]
    excess = ufl.max_value(abs(trial) - YIELD, 0)
    return [old[0] + ufl.sign(trial) * excess / (STIFF + HARDENING)]


def zener(x, a):
    return SLOW / 2 * x**2 + FAST / 2 * (x - a[0]) ** 2


def relax(old, strains0, strains, dt):
    (x,) = strains  # an update that fits springs only
    return [(old[0] + dt / TAU * x) / (1 + dt / TAU)]


def stiffening(x):
    return 5.0 * x**2 + 40.0 * x**4


PLASTIC = fb.Spring(strain_energy=plastic, internal=fb.InternalVariables(("a",), flow))
ZENER = fb.Spring(strain_energy=zener, internal=fb.InternalVariables(("dashpot",), relax))
STIFFENING = fb.Spring(strain_energy=stiffening)


def driven(spring, path, slides=False):
    """An arm on the ground with a coordinate that is prescribed over time."""
    scene, arm = one_bar((1, 0), LIGHT, elements=1)
    if slides:
        joint = fb.Prismatic(fb.GROUND, arm.start, axis=(1, 0), spring=spring, motor=path)
    else:
        joint = fb.Revolute(fb.GROUND, arm.start, spring=spring)
        scene.prescribe(arm.start, rotation=path)
    return scene, scene.add_joint(joint)


def swung(spring):
    """Two heavy arms, one on the ground, with springs in both hinges."""
    section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    scene = fb.Scene(gravity=(0, -9.81))
    arms = [scene.add_beam([(i, 0), (i + 1, 0)], section, elements=2) for i in (0, 1)]
    joints = [scene.add_joint(fb.Revolute(fb.GROUND, arms[0].start, spring=spring))]
    joints.append(scene.add_joint(fb.Revolute(arms[0].end, arms[1].start, spring=spring)))
    return scene, joints


# -- Closed solutions ------------------------------------------------------------------------------


def exact_forces(places):
    return forces_of_flow(places, STIFF, HARDENING, YIELD)


@pytest.mark.parametrize("slides", [False, True], ids=["hinge", "slide"])
def test_the_loop_of_moment_and_rotation_is_exact_at_ends_of_steps(slides):
    times, corners = [0.1, 1, 2, 3, 4], [0.0, 0.04, -0.05, 0.06, 0.0]
    scene, joint = driven(PLASTIC, lambda t: float(np.interp(t, times, corners)), slides)
    solution = fb.simulate(scene, dt=0.05, t_end=4.0)
    motion = solution.joint(joint)
    place = motion.slide if slides else motion.angle
    assert place == pytest.approx(np.interp(solution.t, times, corners), abs=1e-13)
    exact = exact_forces(place)
    assert abs(STIFF * (place - motion.internal("a")) - exact).max() < 1e-10
    # In a step the force on the node b is the mean of both ends; a moment works on 2 tan(Dpsi/2).
    means = -(exact[1:] + exact[:-1]) / 2
    if not slides:
        half = np.diff(place) / 2
        means *= np.cos(half) / np.sinc(half / np.pi)
    if slides:
        assert abs(motion.motor_force[1:] + means).max() < 1e-10
    else:
        assert abs(solution.reaction(joint.b)[1:, 2] + means).max() < 1e-10
        assert abs(motion.force[1:, 2] - means).max() < 1e-10
    lost = solution.energy.dissipated
    assert (np.diff(lost) >= 0).all() and lost[-1] > 0.4
    assert abs(solution.energy.balance_error).max() < 1e-13
    W = STIFF / 2 * (place - motion.internal("a")) ** 2
    W += HARDENING / 2 * motion.internal("a") ** 2
    assert solution.energy.springs == pytest.approx(W, abs=1e-14)


@pytest.mark.parametrize("tension", [0.05, -0.5])
def test_springs_that_are_beyond_their_limit_at_the_start_have_yielded_without_loads(tension):
    # A cantilever that gives way to the spring at its end as what holds it fades; this unloads.
    scene, arm = clamped_bar((1, 0), LIGHT, elements=4)
    spring = fb.Spring(rest=-tension, strain_energy=plastic, internal=PLASTIC.internal)
    joint = scene.add_joint(fb.Revolute(fb.GROUND, arm.end, spring=spring))
    scene.add_moment(arm.end, -math.copysign(1.0, tension))
    solution = fb.static(scene, load_steps=2)
    motion = solution.joint(joint)
    whole = tension + motion.angle
    exact = [exact_forces([tension, *whole[: k + 1]])[-1] for k in range(3)]
    assert -motion.force[:, 2] == pytest.approx(exact, rel=1e-9)
    assert (abs(np.diff(motion.angle)) > 1e-4).all()
    (a,) = flow([0.0], None, [tension], 0.0)
    lost = plastic(tension, [0.0]) - plastic(tension, [float(a)])
    assert solution.energy.dissipated == pytest.approx(lost, rel=1e-9)


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.HHT(-0.2)], ids=lambda s: s.name)
def test_a_zener_hinge_relaxes_with_second_order(scheme):
    errors, c = [], 0.8
    for dt in (0.1, 0.05):
        scene, joint = driven(ZENER, lambda t: c * t)
        solution = fb.simulate(scene, scheme, dt=dt, t_end=1.0)
        t = solution.t_level[-1]
        exact = SLOW * c * t + FAST * c * TAU * (1 - math.exp(-t / TAU))
        errors.append(abs(solution.joint(joint).force[-1, 2] + exact))
    assert math.log2(errors[0] / errors[1]) > 1.9
    assert errors[1] < 0.01


def test_load_steps_follow_the_flow_exactly_and_stiff_members_may_turn_about_a_hinge():
    scene, arm = one_bar((1, 0), fb.Section(EA=1e9, GA=1e9, EI=1e9), elements=1)
    joint = scene.add_joint(fb.Revolute(fb.GROUND, arm.start, spring=PLASTIC))
    scene.add_moment(arm.end, 6.0)
    solution = fb.static(scene, load_steps=6)
    assert solution.stats.halvings == 0
    moments = 6.0 * solution.t
    flown = np.maximum(moments - YIELD, 0) / HARDENING
    assert solution.joint(joint).internal("a") == pytest.approx(flown, abs=1e-9)
    assert solution.joint(joint).angle == pytest.approx(moments / STIFF + flown, abs=1e-9)
    motion = fb.simulate(scene, dt=0.05, t_end=0.2, start=solution)
    assert abs(motion.joint(joint).internal("a") - flown[-1]).max() < 1e-9


# -- Steps in parts, restarts, records -------------------------------------------------------------


def test_no_step_fails_where_hinges_unload_that_have_flowed():
    # A portal frame whose hinges are far stiffer than its members, pushed and let back.
    k, moment = 1e11, 1e5

    def energy(x, a):
        return k / 2 * (x - a[0]) ** 2 + 1e3 / 2 * a[0] ** 2

    def yields(old, strains0, strains, dt):
        trial = k * (strains[0] - old[0]) - 1e3 * old[0]
        excess = ufl.max_value(abs(trial) - moment, 0)
        return [old[0] + ufl.sign(trial) * excess / (k + 1e3)]

    spring = fb.Spring(strain_energy=energy, internal=fb.InternalVariables(("a",), yields))
    scene, section = fb.Scene(), fb.Section(EA=6e9, GA=2e9, EI=2e8)
    corners = [(0, 0), (0, 3), (3, 3), (6, 3), (6, 0)]
    beams = [
        scene.add_beam(ends, section, elements=1)
        for ends in zip(corners[:-1], corners[1:], strict=True)
    ]
    ends = [fb.GROUND, *(beam.end for beam in beams)]
    starts = [*(beam.start for beam in beams), fb.GROUND]
    for a, b in zip(ends, starts, strict=True):
        scene.add_joint(fb.Revolute(a, b, spring=spring))
    scene.prescribe(beams[0].end, x=lambda t: 0.02 * float(np.interp(t, (0.1, 1, 2), (0, 1, 0.5))))
    solution = fb.simulate(scene, dt=0.05, t_end=2.0)
    assert solution.stats.halvings == 0
    assert solution.energy.dissipated[-1] > 0
    balance = abs(solution.energy.balance_error).max()
    assert balance < 1e-11 * solution.energy.dissipated[-1]


def test_rows_are_those_of_the_steps_that_are_recorded():
    scene, joints = swung(PLASTIC)
    every, some = (
        fb.simulate(scene, dt=0.02, t_end=0.8, record=fb.Record(every=n)) for n in (1, 7)
    )
    rows = [*range(0, 40, 7), 40]
    flown = every.joint(joints[1]).internal("a")
    assert (some.joint(joints[1]).internal("a") == flown[rows]).all()
    some_rows = fb.simulate(
        scene, tolerance=1e-3, t_end=0.8, record=fb.Record(times=[0.0, 0.33, 0.8])
    )
    assert abs(some_rows.energy.balance_error).max() < 1e-11 * every.energy.kinetic.max()
    assert abs(some_rows.joint(joints[1]).internal("a")[-1] - flown[-1]) < 0.02


# -- Refusals --------------------------------------------------------------------------------------


def test_order_four_is_refused_with_a_memory_only():
    with pytest.raises(fb.SceneError, match="goes back in time.*of a spring"):
        fb.simulate(swung(PLASTIC)[0], fb.EnergyMomentum(order=4), dt=0.1, t_end=1.0)
    elastic = fb.simulate(swung(STIFFENING)[0], fb.EnergyMomentum(order=4), dt=0.02, t_end=0.2)
    assert abs(elastic.energy.balance_error).max() < 1e-11 * elastic.energy.kinetic.max()


def made(update):
    """A plastic spring with another update."""
    return lambda: {"strain_energy": plastic, "internal": fb.InternalVariables(("a",), update)}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (made(lambda old, e0, e, dt: [old[0] - 0.1 * e[0]]), "gives energy to the motion: .* J in"),
        (made(lambda old, e0, e, dt: [old[0] + 0.1 * e[2]]), "tuple index out of range"),
        (lambda: {"strain_energy": lambda x: 2.0}, r"Spring: .*does not depend on \['x'\]"),
        (lambda: {"strain_energy": math.cos}, "Spring: .*(UFL expression|does not depend on)"),
        (lambda: {"strain_energy": lambda x: ufl.as_vector((x, x))}, "Spring: .*must be a scalar"),
        (lambda: {"strain_energy": lambda x, y: x * y}, "Spring: .*UFL expression"),
        (lambda: {"strain_energy": 3.0}, "Spring: .*UFL expression"),
        (lambda: {"stiffness": 5.0, "internal": PLASTIC.internal}, r"need a strain_energy\(x, a\)"),
        (
            lambda: {"strain_energy": lambda x, a: x**2, "internal": PLASTIC.internal},
            r"strain_energy does not depend on \['a'\]",
        ),
        (lambda: {"strain_energy": plastic, "internal": flow}, "Spring: internal = .* must be"),
    ],
)
def test_springs_that_do_not_fit_are_refused(data, message):
    assert_refused(message, lambda: fb.Spring(**data()))


def test_springs_that_do_not_fit_their_joint_are_refused():
    with pytest.raises(fb.SceneError, match="variables of the same name"):
        pair("pin in slot", spring=PLASTIC, hinge=fb.Coordinate(spring=PLASTIC))
    scene, _ = swung(fb.Spring(strain_energy=lambda x: abs(x) ** 1.5))
    assert_refused("Spring: at its rest .* must be finite", fb.simulate, scene, dt=0.1, t_end=0.1)
