"""Joined nodes of which one is held in x and the other in y: each component is held once."""

import numpy as np
import pytest
from jointed import KINDS, MEMBER, SLIDING, W, momenta, pair
from scenes import clamped_bar

import fx_beam as fb

RUN = {"dt": 0.01, "t_end": 0.3}


def pinned(*held):
    """Three bars on one pin under gravity, with what is held of which."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    ends = ((1, 0), (0.5, -1), (-1, -0.5))
    bars = [scene.add_beam([(0, 0), end], MEMBER, elements=2) for end in ends]
    joints = [
        scene.add_joint(fb.Revolute(bars[0].start, bars[1].start)),
        scene.add_joint(fb.Rigid(bars[2].start, bars[1].start)),
    ]
    for bar, component in held:
        scene.fix(bars[bar].start, component)
    return scene, bars, joints


@pytest.mark.parametrize(("x", "y"), [(1, 1), (0, 1), (2, 0), (1, 2)])
def test_a_pin_may_be_held_at_any_of_its_nodes(x, y):
    together, bars, _ = pinned((0, "x"), (0, "y"))
    expected = fb.simulate(together, **RUN)
    apart, own, _ = pinned((x, "x"), (y, "y"))
    solution = fb.simulate(apart, **RUN)
    assert abs(expected.q).max() > 0.3
    assert solution.q == pytest.approx(expected.q, rel=0, abs=1e-8)
    scale = 1e-7 * abs(expected.reactions).max()
    for i, bar in ((0, x), (1, y)):
        held, reference = solution.reaction(own[bar].start), expected.reaction(bars[0].start)
        assert held[:, i] == pytest.approx(reference[:, i], rel=0, abs=scale)
        assert x == y or not held[:, 1 - i].any()


@pytest.mark.parametrize("kind", KINDS)
def test_forces_balance_where_x_of_a_and_y_of_b_are_held(kind):
    scene, first, second, joint = pair(kind, gravity=(0.0, -9.81))
    scene.fix(first.end, "x")
    scene.fix(second.start, "y")
    scene.add_force(second.end, (3.0, 2.0))
    solution = fb.simulate(scene, **RUN)
    assert abs(solution.q).max() > 0.1
    assert abs(solution.joint(joint).gap).max() < 1e-12
    assert abs(solution.displacement(first.end)[:, 0]).max() == 0
    assert abs(solution.displacement(second.start)[:, 1]).max() == 0
    assert abs(solution.energy.balance_error).max() < 1e-10 * solution.energy.kinetic.max()

    # What the joint and the support do to the second beam moves it, along x and y and about b.
    joint_force = (solution.joint(joint).force + solution.reaction(second.start))[1:]
    scale = 1e-8 * abs(joint_force).max()
    wanted = momenta(solution.a, second)[1:]
    wanted[..., 1] += 9.81 * second.length / 2 * np.array([0.5, 1, 0.5])
    wanted[:, -1, :2] -= (3.0, 2.0)
    assert joint_force[:, :2] == pytest.approx(wanted[..., :2].sum(axis=1), rel=0, abs=scale)
    x = solution.shape(second)
    middle = (x[1:] + x[:-1]) / 2
    levers = (middle - middle[:, :1]) @ W.T
    moment = np.sum(levers * wanted[..., :2], axis=(1, 2)) + wanted[..., 2].sum(axis=1)
    assert joint_force[:, 2] == pytest.approx(moment, rel=0, abs=scale)


@pytest.mark.parametrize("kind", ["rigid", *SLIDING])
def test_both_may_be_moved(kind):
    scene, first, second, joint = pair(kind)
    scene.prescribe(first.end, x=lambda t: t**2)
    scene.prescribe(second.start, y=lambda t: -0.5 * t**2)
    solution = fb.simulate(scene, **RUN)
    assert solution.displacement(first.end)[:, 0] == pytest.approx(solution.t**2)
    assert solution.displacement(second.start)[:, 1] == pytest.approx(-0.5 * solution.t**2)
    assert abs(solution.joint(joint).gap).max() < 1e-12
    assert abs(solution.energy.balance_error).max() < 1e-10 * solution.energy.total.max()


def test_the_equilibrium_is_that_of_one_support():
    held = []
    for x, y in ((0, 0), (1, 2)):
        scene, bars, _ = pinned((x, "x"), (y, "y"))
        for bar in bars[:2]:
            scene.fix(bar.start, "rotation")
        held.append(fb.static(scene))
    assert abs(held[0].q).max() > 1e-3
    assert held[1].q == pytest.approx(held[0].q, rel=0, abs=1e-12)


@pytest.mark.parametrize("component", ["x", "y"])
def test_one_component_held_at_two_joined_nodes_is_refused_with_both_names(component):
    scene, *_ = pinned((0, component), (2, component))
    with pytest.raises(
        fb.SceneError,
        match=f"in {component} of node 0 at .* and of node 6 at .*supported; support one of them",
    ):
        fb.simulate(scene, **RUN)


def test_what_slides_at_a_support_goes_on_when_something_else_leaves_the_scene():
    """The node between the support and the slider belongs to no member."""

    def build(beside):
        section = fb.Section(EA=1e3, GA=1e3, EI=0.5, rhoA=1.0, rhoI=1e-2)
        scene, beam = clamped_bar((1, 0), section, elements=6, degree=2, gravity=(0, -1.0))
        bead = scene.add_body((0.1, 0), mass=0.05, inertia=0.01).centre
        scene.fix(bead, "rotation")
        scene.add_joint(fb.Slider(beam, bead, spring=fb.Spring(200.0, rest=0.12)))
        hook = scene.add_body((3, 0), mass=1.0, inertia=0.1).centre if beside else None
        return scene, bead, hook and scene.add_joint(fb.Rigid(fb.GROUND, hook))

    scene, bead, _ = build(beside=False)
    expected = fb.simulate(scene, dt=0.01, t_end=0.32).position(bead)[-1]
    scene, bead, held = build(beside=True)
    begun = fb.simulate(scene, dt=0.01, t_end=0.3)
    scene.remove(held)
    goes_on = fb.simulate(scene, dt=0.01, t_end=0.32, start=begun)
    assert goes_on.position(bead)[-1] == pytest.approx(expected, abs=1e-7)
