"""Recorded forces are means over whole steps, also halved ones: impulses add up to momenta."""

from types import SimpleNamespace

import numpy as np
import pytest

import fx_beam as fb

DT, SMALL = 0.1, 1e-5
SCHEMES = {
    "order 2": fb.EnergyMomentum(),
    "order 4": fb.EnergyMomentum(order=4),
    "decaying": fb.EnergyDecaying(),
}


def workshop():
    """Masses of 2 kg on springs, a floor and a rail; a rotor that is at first too fast."""
    scene, mass = fb.Scene(), {"mass": 2.0, "inertia": 1.0}
    rotor = scene.add_beam(
        [(5, 0), (6, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e4, rhoA=1, rhoI=0.1), elements=1
    )
    scene.set_velocity(rotor, lambda x, y: (-50 * y, 50 * (x - 5.5)), spin=50.0)
    scene.add_moment(rotor.start, -3.0)
    rod = scene.add_beam([(0, 0), (0, 1)], fb.Section(EA=200.0, GA=200.0, EI=50.0), elements=1)
    strip = scene.add_beam([(0, 2), (1, 2)], fb.Section(EA=1e6, GA=1e6, EI=50.0), elements=1)
    for beam in (rod, strip):
        scene.clamp(beam.start)
        scene.add_mass(beam.end, 2.0)
    scene.set_velocity(rod.end, (0, 1.0))
    scene.set_velocity(strip.end, (0, SMALL))
    ball, cart, pusher = (scene.add_body((x, 0.1), **mass) for x in (2.0, 3.0, 4.0))
    scene.fix(ball.centre, "x", "rotation")
    scene.set_velocity(ball, (0, -1.0))
    floor = scene.add_contact(ball.centre, fb.Line((0, 0), normal=(0, 1)), 300.0)
    drive = lambda t: 0.2 * np.sin(9 * t) ** 2  # noqa: E731
    rail = fb.Prismatic(fb.GROUND, cart.centre, axis=(1, 0), motor=drive)
    rail = scene.add_joint(rail)
    scene.fix(pusher.centre, "y", "rotation")
    scene.prescribe(pusher.centre, x=lambda t: 0.1 * np.sin(9 * t) ** 2)
    return scene, SimpleNamespace(**locals())


def assert_impulses_are_momenta(solution, its):
    """In each row the mean forces times the step are the changes of momentum in it."""
    dt = np.diff(solution.t)

    def gain(node, i):
        return 2.0 * np.diff(solution.velocity(node)[:, i])

    forces = {
        "contact": (solution.contact(its.floor).force[:, 0, 1], gain(its.ball.centre, 1)),
        "joint": (solution.joint(its.rail).force[:, 0], gain(its.cart.centre, 0)),
        "motor": (solution.joint(its.rail).motor_force, gain(its.cart.centre, 0)),
        "driven": (solution.reaction(its.pusher.centre)[:, 0], gain(its.pusher.centre, 0)),
        "support": (solution.reaction(its.rod.start)[:, 1], gain(its.rod.end, 1)),
        "N": (-solution.resultants(its.rod).N[:, 0], gain(its.rod.end, 1)),
        "Q": (-solution.resultants(its.strip).Q[:, 0], gain(its.strip.end, 1)),
        "M": (-2 * solution.resultants(its.strip).M[:, 0], gain(its.strip.end, 1)),
        "accelerations": (
            2 * solution.acceleration(its.ball.centre)[:, 1],
            gain(its.ball.centre, 1),
        ),
    }
    for name, (force, momentum) in forces.items():
        largest = abs(momentum).max()
        assert largest > 0.1 * (SMALL if name in "QM" else 1), name
        wrong = abs(force[1:] * dt - momentum).max()
        assert wrong < 1e-6 * largest, (name, wrong / largest)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_impulses_of_all_forces_are_the_changes_of_momentum_in_halved_steps(scheme):
    scene, its = workshop()
    solution = fb.simulate(scene, SCHEMES[scheme], dt=DT, t_end=1.2)
    assert solution.stats.substeps > solution.stats.steps + 2
    assert solution.t_level[1:] == pytest.approx(solution.t[1:] - DT / 2)
    assert_impulses_are_momenta(solution, its)


def test_rows_of_some_steps_have_the_same_means_as_rows_of_all():
    every, third = (
        fb.simulate(workshop()[0], dt=DT, t_end=1.2, record=record)
        for record in (fb.Record(), fb.Record(every=3))
    )
    assert third.t == pytest.approx(every.t[::3])
    for name in ("reactions", "joint_forces", "motor_forces", "contact_forces", "a", "t_level"):
        assert getattr(third, name) == pytest.approx(getattr(every, name)[::3], abs=1e-12), name
    for name in every.beams:
        N, expected = (solution.resultants(name).N for solution in (third, every))
        assert pytest.approx(expected[::3], abs=1e-9) == N


def test_outputs_of_a_motion_are_means_over_halved_steps():
    scene, its = workshop()
    expected = fb.simulate(scene, dt=DT, t_end=1.0)
    outputs = {
        "force": fb.Output("force", its.rail),
        "motor": fb.Output("motor_force", its.rail),
        "reaction": fb.Output("reaction", its.rod.start),
        "acceleration": fb.Output("acceleration", its.ball.centre),
    }
    motion = fb.Motion(scene, dt=DT, outputs=outputs, record=fb.Record())
    rows = [motion.step() for _ in range(10)]
    assert motion.stats.substeps > motion.stats.steps == 10
    assert_impulses_are_momenta(motion.solution(), its)
    histories = {
        "force": expected.joint(its.rail).force,
        "motor": expected.joint(its.rail).motor_force,
        "reaction": expected.reaction(its.rod.start),
        "acceleration": expected.acceleration(its.ball.centre),
    }
    for name, history in histories.items():
        computed = np.array([row[name] for row in rows])
        assert computed == pytest.approx(history[1:], abs=1e-9), name
