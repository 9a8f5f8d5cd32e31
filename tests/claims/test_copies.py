"""What is copied or pickled gives the same results as the original, and shares nothing with it."""

import copy
import functools
import gc
import pickle
import weakref
from dataclasses import dataclass

import ufl

import numpy as np
import pytest
from jointed import MEMBER, pair
from scenes import assert_refused, clamped_bar, guided_body, one_bar

import fx_beam as fb


def pickled(thing):
    return pickle.loads(pickle.dumps(thing))


every_way = pytest.mark.parametrize("copied", [copy.copy, copy.deepcopy, pickled])


# Functions of a module can be pickled, those inside a test cannot.
def push(t):
    return 3.0 * np.cos(4 * t), 1.0


def taper(fraction):
    return 0.12 - 0.05 * fraction


def wave(fraction):
    return fraction, 0.2 * np.sin(2 * fraction)


def stiffening(eps, gamma, kappa):
    return 1e4 * (eps**2 / 2 + eps**4 / 4) + 5e3 * gamma**2 + 50 * kappa**2


@dataclass
class Softening:
    """A law with data, which makes it unhashable."""

    EI: float

    def __call__(self, eps, gamma, kappa):
        return 5e3 * (eps**2 + gamma**2) + self.EI * (kappa**2 / 2 - kappa**4 / 24)


def drag(step):
    return -0.5 * ufl.dot(step.v, step.virtual_u)


def whirl(x, y):
    return -0.5 * y, 0.5 * x


def swing(t):
    return 0.3 * (1 - np.cos(3 * t))


def jointed():
    """Jointed beams under gravity with a motor, a spring, a damper and a force that varies."""
    options = {"spring": fb.Spring(20.0, rest=0.1), "damper": fb.Damper(0.5)}
    scene, first, second, joint = pair("pin in slot with offset", gravity=(0.0, -9.81), **options)
    scene.add_joint(fb.Revolute(fb.GROUND, first.start, motor=swing))
    scene.prescribe(second.end, x=swing)
    scene.add_force(second.end, push)
    return scene, joint


def of_all_kinds():
    """Curved and tapered beams, own laws and loads, masses, velocities."""
    scene = fb.Scene()
    tapered = fb.Section.rectangle(height=taper, width=0.1, E=1e6, rho=100.0)
    lawful = fb.Section(rhoA=1.0, rhoI=0.1, strain_energy=stiffening)
    soft = fb.Section(rhoA=1.0, rhoI=0.1, strain_energy=Softening(EI=80.0))
    first = scene.add_beam(fb.arc((0, 0), (0.6, 0.2), (1, 0)), tapered, elements=2, degree=2)
    second = scene.add_beam(wave, lawful, elements=2, degree=2)
    third = scene.add_beam(fb.spline([first.end, (1.5, 0.2), (2, 0)]), soft, elements=2, degree=2)
    joint = scene.add_joint(fb.Revolute(first.start, second.start))
    scene.add_joint(fb.PinInSlot(third.end, fb.GROUND, axis=(1, 0)))
    scene.add_mass(second.end, 0.5, inertia=0.1)
    scene.add_line_load(third, (0.0, -2.0))
    scene.add_force(second.end, (1.0, 2.0), follower=True)
    scene.add_virtual_work(drag, second)
    scene.set_velocity(second, whirl, spin=0.5)
    scene.make_velocities_compatible()
    return scene, joint


def assert_same(solution, other):
    """Motion, forces and energy agree to far below their size, over more than one swing."""
    for name in ("t", "q", "v", "a", "reactions", "slides", "joint_forces"):
        values = getattr(solution, name)
        size = 1e-9 * abs(values).max(initial=1e-3)
        assert getattr(other, name) == pytest.approx(values, rel=0, abs=size), name
    assert other.energy.total == pytest.approx(solution.energy.total, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("make", [jointed, of_all_kinds])
def test_a_copied_scene_moves_as_the_original(make):
    scene, joint = make()
    run = functools.partial(fb.simulate, dt=0.02, t_end=0.2)
    solution = run(scene)
    assert abs(solution.q).max() > 1e-2
    for copied in (copy.copy, copy.deepcopy, pickled):
        other = copied(scene)
        moved = run(other)
        assert_same(solution, moved)
        own = other.joints[joint.number]
        assert moved.joint(own).gap == pytest.approx(0 * moved.t, abs=1e-12)
        assert moved.joint(own).force == pytest.approx(solution.joint(joint).force, rel=1e-6)


@every_way
def test_the_ground_stays_the_ground(copied):
    assert copied(fb.GROUND) is fb.GROUND
    scene, _ = jointed()
    for joint in (copied(scene).joints[1], copied(scene.joints[1])):
        assert joint.a is fb.GROUND
        assert str(joint) == str(scene.joints[1])


@every_way
def test_a_copied_scene_is_one_of_its_own(copied):
    scene, _ = jointed()
    other = copied(scene)
    bar = other.beams[0]
    other.fix(bar.end, "rotation")
    other.add_force(bar.end, (1.0, 0.0))
    other.add_line_load(bar, (0.0, 1.0))
    other.add_beam([bar.end, (2, 2)], MEMBER, elements=1)
    other.add_joint(fb.Revolute(bar.end, other.beams[-1].end, offset=(2, 2)))
    assert (len(scene.beams), len(scene.nodes), len(scene.joints)) == (2, 6, 2)
    assert not scene.fixed and len(scene.loads) == 1
    assert_refused("belongs to another scene", lambda: other.pin(scene.beams[0].end))
    assert_refused("belongs to another scene", scene.add_line_load, bar, (0.0, 1.0))


def test_nodes_copied_with_their_scene_belong_to_it():
    scene, _ = jointed()
    node = scene.beams[0].end
    for pair_ in ((scene, node), (node, scene)):
        for copied in (copy.deepcopy, pickled):
            (other, its) = sorted(copied(pair_), key=lambda thing: isinstance(thing, fb.Node))
            other.add_force(its, (1.0, 0.0))
            assert len(other.loads) == 2
    assert len(scene.loads) == 1


@every_way
def test_a_copied_solution_gives_all_that_the_original_gives(copied):
    scene, joint = of_all_kinds()
    scene.add_force(scene.beams[1].end, lambda t: (np.sin(9 * t), 0.0))  # none of a solution's data
    solution = fb.simulate(scene, dt=0.02, t_end=0.2)
    other = copied(solution)
    assert_same(solution, other)
    onwards = {"dt": 0.02, "t_end": 0.3}
    assert_same(
        fb.simulate(scene, start=solution, **onwards), fb.simulate(scene, start=other, **onwards)
    )
    for beam in scene.beams:
        for part in ("s", "N", "Q", "M"):
            computed = getattr(other.resultants(beam), part)
            assert (computed == getattr(solution.resultants(beam), part)).all()
        assert (other.shape(beam) == solution.shape(beam)).all()
        # By the beams and nodes that the copy has itself, too.
        own = other.beams[beam.name]
        assert (other.position(own.end) == solution.position(beam.end)).all()
        assert (other.resultants(own).M == solution.resultants(beam).M).all()
    assert (other.joint(joint).force == solution.joint(joint).force).all()
    assert (other.joint(pickled(joint)).force == solution.joint(joint).force).all()
    assert str(other) == str(solution)
    assert other.stats == solution.stats


@every_way
def test_a_solution_without_motion_and_one_of_statics_can_be_copied(copied):
    scene, joint = jointed()
    other = copied(fb.simulate(scene, dt=0.02, t_end=0.1, record=fb.Record(motion=False)))
    assert len(other.joint(joint).force) == 6
    with pytest.raises(ValueError, match="motion not recorded"):
        other.resultants(scene.beams[0])
    scene, beam = clamped_bar((1, 0), MEMBER, elements=1, load=(0.0, 1.0))
    solution, modes = fb.static(scene, load_steps=2), fb.modes(scene, n=1)
    assert (copied(solution).resultants(beam).M == solution.resultants(beam).M).all()
    assert (copied(solution).load_factor == solution.load_factor).all()
    assert (copied(modes).shapes == modes.shapes).all()


@every_way
@pytest.mark.parametrize("turns", [False, True])
def test_a_linear_system_can_be_copied_and_reads_the_same_states(copied, turns):
    scene, beam = one_bar([(1, 0), (2, 0)], MEMBER, elements=3, gravity=None if turns else (0, -1))
    hub = scene.add_body((0, 0), 1.0, 0.1, points={"rim": (1, 0)})
    scene.add_joint(fb.Rigid(hub["rim"], beam.start))
    scene.add_force(beam.end, fb.Input("push", factor=(0, 1)))
    if turns:
        scene.clamp(hub.centre)
        about, motion = (fb.static(scene, spin=spin, load_steps=1) for spin in (0.5, 0.6))
    else:
        scene.add_joint(fb.Revolute(fb.GROUND, hub.centre, motor=fb.Input("drive")))
        about, motion = None, fb.simulate(scene, dt=0.01, t_end=0.1)
    outputs = {"tip": fb.Output("displacement", beam.end, "y")}
    system = fb.linearise(scene, about, outputs=outputs)
    for original in (system, system.slowest(3)):
        other = copied(original)
        for name in "ABCD":
            assert (getattr(other, name) == getattr(original, name)).all()
        assert (other.inputs, other.outputs) == (original.inputs, original.outputs)
        assert original.deviation(motion).any()
        assert (other.deviation(motion) == original.deviation(motion)).all()


@every_way
def test_periodic_motions_and_families_can_be_copied(copied):
    scene, body, _ = guided_body((0, 0), 1.0, 1.0, spring=fb.Spring(stiffness=1.0))
    swing = fb.periodic(scene, mode=0, amplitude=0.1)
    family = fb.backbone(scene, amplitude=0.2)
    assert (copied(swing).solution.q == swing.solution.q).all()
    assert copied(swing).amplitude(body, "x") == swing.amplitude(body, "x")
    assert (copied(family).frequencies == family.frequencies).all()
    assert len(copied(family).critical) == len(family.critical)


@every_way
def test_sections_curves_schemes_and_options_can_be_copied(copied):
    fractions = np.linspace(0, 1, 5)
    for section in (
        MEMBER,
        fb.Section.rectangle(height=taper, width=taper, E=1e6, rho=100.0),
        fb.Section.circle(diameter=taper, E=1e6, rho=100.0),
        fb.Section(strain_energy=stiffening),
    ):
        for name in ("EA", "GA", "EI", "rhoA", "rhoI"):
            expected = section.values(name, fractions)
            assert (copied(section).values(name, fractions) == expected).all()
    for curve in (fb.arc((0, 0), (1, 1), (2, 0)), fb.spline([(0, 0), (1, 1), (2, 0)])):
        for fraction in fractions:
            assert (copied(curve).function(fraction) == curve.function(fraction)).all()
    plain = [fb.Record(every=3), fb.NewtonOptions(tolerance=1e-9), fb.Spring(2.0, 0.1)]
    for thing in (*plain, fb.EnergyMomentum(order=4), fb.HHT(-0.1), fb.EnergyDecaying()):
        assert copied(thing) == thing


@every_way
def test_an_error_keeps_its_time_and_its_solution(copied):
    def fails(t):
        return 1 / (t < 0.05)

    scene, _ = jointed()
    scene.add_moment(scene.beams[0].end, fails)
    with pytest.raises(fb.StepError) as raised:
        fb.simulate(scene, dt=0.02, t_end=0.2)
    other = copied(raised.value)
    assert str(other) == str(raised.value) and other.time == raised.value.time
    assert len(other.solution.t) == len(raised.value.solution.t) > 1


def test_a_function_inside_another_is_refused_by_pickle_with_its_name():
    scene, _ = jointed()
    scene.add_force(scene.beams[0].end, lambda t: (t, 0.0))
    with pytest.raises((pickle.PicklingError, AttributeError), match="lambda"):
        pickle.dumps(scene)
    assert len(copy.deepcopy(scene).loads) == 2


def test_equilibria_that_follow_each_other_hold_no_earlier_ones_nor_functions_of_loads():
    scene, beam = clamped_bar((1, 0), MEMBER, elements=1, load=lambda t: (0.0, -2.0 * t))
    first = fb.static(scene, load_steps=1, t=1.0)
    second = fb.static(scene, load_steps=1, t=2.0, start=first)
    last = fb.static(scene, load_steps=1, t=3.0, start=second)
    earlier = weakref.ref(first), weakref.ref(second)
    del first, second
    gc.collect()
    assert [solution() for solution in earlier] == [None, None]
    assert_same(last, pickled(last))
