"""Springs, dampers and motors on the free coordinates of joints."""

import numpy as np
import pytest
from jointed import KINDS, MEMBER, SLIDING, drift, momenta, pair, throw
from scenes import one_bar

import fx_beam as fb

HINGED = [kind for kind in KINDS if "revolute" in kind]
SPRUNG = SLIDING + HINGED
STIFF = fb.Section(EA=1e9, GA=1e9, EI=1e9, rhoA=1.0, rhoI=0.1)


def scale(solution):
    return solution.energy.kinetic.max()


def balance(solution):
    return abs(solution.energy.balance_error).max() / scale(solution)


def angle(solution, joint):
    """Relative rotation of a joint."""
    ends = (0.0 if n is fb.GROUND else solution.rotation(n) for n in (joint.a, joint.b))
    a, b = ends
    return b - a


def coordinate(solution, joint):
    return angle(solution, joint) if joint.axis is None else solution.joint(joint).slide


# -- One degree of freedom -----------------------------------------------------------------------


def slider(rest=0.0, damper=None, velocity=0.0):
    """A block of mass 2 on a rail along (0.6, 0.8), and a spring to the ground."""
    scene, block = one_bar([(1, 1), (3, 1)], STIFF, elements=2, gravity=None)
    spring = fb.Spring(50.0, rest)
    joint = scene.add_joint(
        fb.Prismatic(fb.GROUND, block.start, axis=(3, 4), spring=spring, damper=damper)
    )
    scene.set_velocity(block, (0.6 * velocity, 0.8 * velocity))
    return scene, joint


def test_springs_and_dampers_accelerate_at_the_start():
    scene, joint = slider(rest=0.7, damper=fb.Damper(3.0), velocity=2.0)
    solution = fb.simulate(scene, fb.Newmark(), dt=0.01, t_end=0.01)
    force = momenta(solution.a, scene.beams[0], STIFF)[0, :, :2].sum(axis=0)
    assert force @ joint.axis == pytest.approx(50.0 * 0.7 - 3.0 * 2.0, rel=1e-9)


def test_a_critically_damped_slider_follows_its_closed_solution():
    # c = 2 sqrt(k m): x = v t exp(-5 t).
    for scheme in (fb.EnergyMomentum(), fb.GeneralizedAlpha(0.6)):
        scene, joint = slider(velocity=2.0, damper=fb.Damper(20.0))
        solution = fb.simulate(scene, scheme, dt=0.002, t_end=1.0)
        exact = 2.0 * solution.t * np.exp(-5 * solution.t)
        assert abs(solution.joint(joint).slide - exact).max() < 1e-4 * exact.max()


# -- Motors --------------------------------------------------------------------------------------


def smooth(size):
    """Motion from 0 to `size` in 0.8 s, without a jump of its rate."""
    return lambda t: size * np.sin(np.pi * min(t, 0.8) / 1.6) ** 2


@pytest.mark.parametrize("kind", [*SPRUNG, "motor in the hinge of a slot"])
def test_a_motor_between_free_members_does_its_work_and_changes_no_momentum(kind):
    size = 1.7
    options = {"motor": smooth(size)}
    if "motor" in kind:
        kind, options = "pin in slot", {"hinge": fb.Coordinate(**options)}
    scene, first, second, joint = pair(kind, **options)
    throw(scene, first, second, joint, slide=0.0 if "hinge" not in options else 1.0, hinge=0.0)
    solution = fb.simulate(scene, dt=0.01, t_end=1.0)
    moved = angle(solution, joint) if "hinge" in options else coordinate(solution, joint)
    expected = [smooth(size)(t) for t in solution.t]
    assert abs(moved - moved[0] - expected).max() < 1e-12
    assert balance(solution) < 1e-9
    assert np.ptp(solution.energy.work) > 0.01 * scale(solution)
    assert drift(solution.linear_momentum) < 1e-10
    assert drift(solution.angular_momentum) < 1e-10


@pytest.mark.parametrize("neighbour", [fb.Rigid, fb.Prismatic])
def test_a_rigid_joint_does_not_count_the_spring_of_its_neighbour(neighbour):
    # a = b = c, and a torsion spring from b to a bar that is held: a's moment is the spring's.
    scene, a = one_bar([(-1, 0), (0, 0)], MEMBER, elements=2)
    b = scene.add_beam([(0, 0), (1, 0)], MEMBER, elements=2)
    options = {} if neighbour is fb.Rigid else {"axis": (1, 0), "motor": lambda t: 0.0}
    joint = scene.add_joint(neighbour(a.end, b.start, **options))
    hinge = scene.add_joint(fb.Revolute(fb.GROUND, b.start, spring=fb.Spring(5.0, rest=1.0)))
    solution = fb.simulate(scene, dt=0.01, t_end=0.1)
    # Moments on b's own beam about its start: rate of its angular momentum about the origin.
    p = momenta(solution.v, b)
    x = solution.shape(b)
    L = np.sum(x[..., 0] * p[..., 1] - x[..., 1] * p[..., 0] + p[..., 2], axis=1)
    moments = solution.joint(joint).force[1:, 2] + solution.joint(hinge).force[1:, 2]
    assert abs(np.diff(L) / 0.01 - moments).max() < 1e-9 * abs(moments).max()
    assert abs(solution.joint(hinge).force[1, 2] - 5.0) < 0.5


# -- Coordinates, rates and power as they are read ------------------------------------------------

BAR = fb.Section(EA=1e6, GA=1e6, EI=1e3, rhoA=1.0, rhoI=1e-3)


# Soft enough for the steps below to resolve all of its vibrations.
RESOLVED = fb.Section(EA=1e4, GA=1e4, EI=1e2, rhoA=1.0, rhoI=1e-2)


def arm_with_slider(motor=None, spring=None, section=BAR):
    """An arm that a motor turns, and a bar that slides along its end."""
    scene, arm = one_bar((1, 0), section, elements=4)
    bar = scene.add_beam([(1, 0), (1.6, 0.8)], section, elements=2)
    hinge = scene.add_joint(fb.Revolute(fb.GROUND, arm.start, motor=motor))
    slide = scene.add_joint(fb.PinInSlot(arm.end, bar.start, axis=(0.6, 0.8), spring=spring))
    return scene, arm, bar, hinge, slide


def turning(t):
    return 0.5 * (1 - np.cos(4 * t))


def test_the_angle_of_a_motor_is_what_it_was_told_and_rates_are_derivatives():
    scene, arm, _, hinge, slide = arm_with_slider(turning, fb.Spring(200.0), RESOLVED)
    solution = fb.simulate(scene, dt=1e-4, t_end=0.2)
    motion = solution.joint(hinge)
    assert motion.angle == pytest.approx(turning(solution.t), abs=1e-13)
    assert motion.rate == pytest.approx(2 * np.sin(4 * solution.t), abs=1e-2)
    assert (motion.rate == motion.spin).all()
    assert (motion.angle == solution.rotation(arm.start)).all()
    motion = solution.joint(slide)
    assert np.ptp(motion.slide) > 0.01 and np.ptp(motion.angle) > 0.1
    for rate, place in ((motion.rate, motion.slide), (motion.spin, motion.angle)):
        central = (place[2:] - place[:-2]) / (solution.t[2:] - solution.t[:-2])
        assert rate[1:-1] == pytest.approx(central, abs=2e-3 * abs(central).max())


@pytest.mark.parametrize(("scheme", "off"), [(fb.EnergyMomentum(), 1e-5), (fb.Newmark(), 1e-3)])
def test_the_motors_power_adds_up_to_the_work_and_to_the_energy_gained(scheme, off):
    dt = 1e-3
    scene, *_, hinge, slide = arm_with_slider(turning, fb.Spring(200.0))
    solution = fb.simulate(scene, scheme, dt=dt, t_end=0.2)
    work = np.concatenate([[0], np.cumsum(solution.joint(hinge).motor_power[1:] * dt)])
    # The only work there is, to second order in a step's angle.
    np.testing.assert_allclose(work, solution.energy.work, atol=off * abs(work).max())
    gained = solution.energy.total - solution.energy.total[0]
    np.testing.assert_allclose(work, gained, atol=2e-3 * abs(gained).max())
    with pytest.raises(ValueError, match="has no motor"):
        solution.joint(slide).motor_power  # noqa: B018


def test_the_power_of_a_motor_is_known_in_the_rows_since_a_return():
    scene, bar = one_bar((1, 0), BAR, elements=2)
    joint = scene.add_joint(fb.Prismatic(fb.GROUND, bar.start, (1, 0), motor=fb.Input("x")))
    motion = fb.Motion(scene, dt=1e-3, record=fb.Record())
    speed_up = lambda t, y: {"x": 0.1 * (t + 1e-3) ** 2}  # noqa: E731
    motion.run(0.05, speed_up)
    snapshot = motion.snapshot()
    motion.run(0.1, speed_up)
    whole = motion.solution().joint(joint).motor_power
    motion.restore(snapshot)
    motion.run(0.1, speed_up)
    solution = motion.solution()
    assert len(solution.t) == 51 == solution.stats.steps + 1
    power = solution.joint(joint).motor_power
    np.testing.assert_allclose(power[1:], whole[51:], atol=1e-9 * abs(whole).max())


def test_the_power_of_a_motor_on_a_slide_is_exact_and_without_its_spring(tmp_path):
    scene, bar = one_bar((1, 0), BAR, elements=2)
    laws = {"motor": lambda t: 0.1 * t**2, "spring": fb.Spring(30.0)}
    joint = scene.add_joint(fb.Prismatic(fb.GROUND, bar.start, (1, 0), **laws))
    solution = fb.simulate(scene, dt=1e-3, t_end=0.5)
    solution.save(tmp_path / "run.npz")
    for known in (solution, fb.load(tmp_path / "run.npz")):
        motion = known.joint(joint)
        work = np.cumsum(motion.motor_power * 1e-3)
        np.testing.assert_allclose(work, solution.energy.work, atol=1e-12 * work.max())
    # The motor pushes the bar and its spring; the joint is both of them.
    pushed = solution.joint(joint).motor_force[1:]
    total = solution.joint(joint).force[1:, 0]
    middle = (solution.joint(joint).slide[1:] + solution.joint(joint).slide[:-1]) / 2
    np.testing.assert_allclose(pushed - 30.0 * middle, total, atol=1e-9 * abs(pushed).max())


def test_what_was_not_recorded_or_is_not_there_is_named():
    scene, *_, hinge, slide = arm_with_slider(turning)
    thin = fb.simulate(scene, dt=1e-3, t_end=0.01, record=fb.Record(rates=False, every=5))
    with pytest.raises(ValueError, match="rates not recorded"):
        thin.joint(slide).rate  # noqa: B018
    with pytest.raises(ValueError, match=r"needs every step; simulate with record=Record\(every"):
        thin.joint(hinge).motor_power  # noqa: B018
