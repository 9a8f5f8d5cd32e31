"""Latches that close and joints that break within one call of `simulate`."""

import numpy as np
import pytest

import fx_beam as fb

SCHEMES = [fb.EnergyMomentum(), fb.EnergyMomentum(order=4), fb.EnergyDecaying(), fb.Newmark()]


def train(count, masses, speeds):
    """Bodies in a row, each on a guide of the one before."""
    scene = fb.Scene()
    bodies = [scene.add_body((x, 0), masses[x], 0.1).centre for x in range(count)]
    pairs = zip(bodies[:-1], bodies[1:], strict=True)
    guides = [scene.add_joint(fb.Prismatic(*pair, axis=(1, 0))) for pair in pairs]
    for body, speed in zip(bodies, speeds, strict=True):
        scene.set_velocity(body, (speed, 0.0))
    return scene, bodies, guides


def latches(guides, at):
    return {f"guide {i}": fb.Latch(guide, at) for i, guide in enumerate(guides)}


def test_ten_latches_close_one_after_the_other():
    """The last mass pulls the rest of a train along: momentum gives the time of each latch."""
    count = 11
    speeds = [0.0] * (count - 1) + [1.0]
    scene, bodies, guides = train(count, [1.0] * count, speeds)
    whole = fb.simulate(scene, dt=1.0, t_end=60.0, changes=latches(guides, 1.5))
    # n coupled masses have the speed 1/n; each latch needs another 0.5 m.
    exact = np.cumsum([0.5 * n for n in range(1, count)])
    times = [whole.stats.changes[f"guide {i}"] for i in reversed(range(count - 1))]
    assert times == pytest.approx(exact, abs=1e-9)
    assert whole.energy.kinetic[-1] == pytest.approx(0.5 / count, rel=1e-10)
    assert abs(whole.energy.balance_error).max() < 1e-11
    assert np.ptp(whole.linear_momentum[:, 0]) < 1e-11
    assert not whole.stats.until


def test_latches_of_a_symmetric_scene_close_together():
    scene = fb.Scene()
    hub = scene.add_body((0, 0), 3.0, 1.0).centre
    wings = []
    for side in (1, -1):
        points = {"root": (0, 0)}
        wing = scene.add_body((side * 0.6, 0.8), 1.0, 0.2, points, name=f"wing {side}")
        spring = fb.Spring(4.0, rest=-side * 2.0)
        wings.append(scene.add_joint(fb.Revolute(hub, wing["root"], spring=spring)))
    changes = {f"wing {i}": fb.Latch(wing, -1.5 * (-1) ** i) for i, wing in enumerate(wings)}
    whole = fb.simulate(scene, dt=0.01, t_end=1.5, changes=changes)
    first, second = whole.stats.changes.values()
    assert first == pytest.approx(second, abs=1e-9)
    late = whole.t > first + 1e-6
    assert whole.joint(wings[0]).angle[late] == pytest.approx(-1.5, abs=1e-8)
    assert whole.joint(wings[1]).angle[late] == pytest.approx(1.5, abs=1e-8)
    assert whole.energy.kinetic[-1] < 1e-12 * whole.energy.springs[0]  # by both momenta
    assert abs(whole.energy.balance_error).max() < 1e-11
    assert abs(whole.linear_momentum).max() < 1e-11
    assert abs(whole.angular_momentum).max() < 1e-11


def test_of_two_latches_of_a_joint_the_first_that_is_reached_closes():
    for speed, closed in ((0.6, "far"), (-0.6, "near")):
        scene, _, (guide,) = train(2, (2.0, 3.0), (0.0, speed))
        ends = {"near": fb.Latch(guide, 0.5), "far": fb.Latch(guide, 1.5)}
        ends["beyond"] = fb.Latch(guide, 1.75)
        whole = fb.simulate(scene, dt=0.1, t_end=2.0, changes=ends)
        assert whole.stats.changes == {closed: pytest.approx(0.5 / 0.6)}
        assert whole.slide(guide)[-1] == pytest.approx(ends[closed].at, abs=1e-12)


def test_a_joint_that_begins_at_its_latch_is_caught_when_it_comes_back():
    scene = fb.Scene()
    door = scene.add_body((0.5, 0), 1.0, 0.25, points={"hinge": (0, 0)})
    spring = fb.Spring(2.0)
    hinge = scene.add_joint(fb.Revolute(fb.GROUND, door["hinge"], spring=spring))
    scene.set_velocity(door, (0.0, 0.5), spin=1.0)
    whole = fb.simulate(scene, dt=0.01, t_end=4.0, changes={"shut": fb.Latch(hinge, 0.0)})
    # Half a period of sqrt(2 / (1/2)) rad/s: the inertia is 1/4 + 1 (1/2)^2 about the hinge.
    assert whole.stats.changes["shut"] == pytest.approx(np.pi / 2, rel=1e-4)
    late = whole.t > whole.stats.changes["shut"]
    assert whole.joint(hinge).angle[late] == pytest.approx(0.0, abs=1e-12)


def test_a_fuse_that_breaks_takes_the_latch_of_its_joint_along():
    scene, (_, right), (guide,) = train(2, (2.0, 3.0), (0.0, 0.1))
    scene.add_force(right, lambda t: (0.0, 10.0 * t))
    changes = {"fuse": fb.Fuse(guide, 0.3), "latch": fb.Latch(guide, 1.2)}
    whole = fb.simulate(scene, dt=0.01, t_end=3.0, changes=changes)
    assert [*whole.stats.changes] == ["fuse"] and not scene.joints


def chain_under_load(limits, rate=10.0):
    """Two masses and the ground in a row, their joints, and a force that grows at the end."""
    scene = fb.Scene()
    bodies = [scene.add_body((x, 0), 1.0, 0.1).centre for x in (1, 2)]
    joints = [
        scene.add_joint(fb.Rigid(fb.GROUND, bodies[0])),
        scene.add_joint(fb.Rigid(*bodies, offset=(1, 0))),
    ]
    scene.add_force(bodies[1], lambda t: (rate * t, 0.0))
    return scene, bodies, {f"joint {i}": fb.Fuse(joints[i], limits[i]) for i in (0, 1)}


@pytest.mark.parametrize("scheme", SCHEMES[:2], ids=["order 2", "order 4"])
def test_the_weaker_of_two_joints_breaks_at_its_force(scheme):
    scene, (near, far), fuses = chain_under_load((9.0, 8.0))
    whole = fb.simulate(scene, scheme, dt=0.01, t_end=1.2, changes=fuses)
    assert [*whole.stats.changes] == ["joint 1"]
    at = int(np.searchsorted(whole.t, whole.stats.changes["joint 1"]))
    # The force is that of the middle of the step.
    assert whole.t[at - 1 : at + 1].mean() == pytest.approx(0.8, abs=1e-9)
    assert abs(whole.q[:, near.number]).max() < 1e-13
    t1, t2 = whole.t[at], whole.t[-1]
    assert whole.velocity(far)[-1, 0] == pytest.approx(5 * (t2**2 - t1**2), rel=1e-9)
    assert whole.energy.impact[-1] == pytest.approx(0, abs=1e-12)
    assert abs(whole.energy.balance_error).max() < 1e-11 * whole.energy.work[-1]
    assert scene.joints == [fuses["joint 0"].joint]


def test_a_motion_with_changes_ends_by_its_own_condition_and_goes_on_elsewhere(tmp_path):
    scene, bodies, guides = train(3, (1.0, 1.0, 1.0), (-1.0, 0.0, 2.0))
    outputs = {"x": fb.Output("position", bodies[2], "x")}
    more = latches(guides, 1.5)
    options = {"dt": 0.05, "t_end": 5.0}
    first = fb.simulate(
        scene, changes=more, outputs=outputs, until={"far": lambda t, y: y["x"] - 2.6}, **options
    )
    assert first.stats.until == "far"
    assert [*first.stats.changes] == ["guide 1"]
    assert first.stats.changes["guide 1"] == pytest.approx(0.25, abs=1e-12)
    first.save(tmp_path / "first.npz")
    known = fb.load(tmp_path / "first.npz")
    assert known.stats.changes == first.stats.changes
    del more["guide 1"]
    second = fb.simulate(scene, changes=more, start=known, **options)
    whole = first.then(second)
    # Masses 2 and 3 move on together, by 1 m/s; 0.25 m were left of guide 0.
    assert second.stats.changes["guide 0"] == pytest.approx(0.25 + 0.25 / 2, abs=1e-12)
    assert [*whole.stats.changes] == ["guide 1", "guide 0"]
    assert abs(whole.energy.balance_error).max() < 1e-12


def test_the_force_of_a_latch_is_the_motor_force_of_its_joint():
    scene, (left, right), (guide,) = train(2, (2.0, 3.0), (0.0, 0.6))
    load = scene.add_force(right, (1.0, 0.0))
    whole = fb.simulate(scene, dt=0.1, t_end=2.0, changes={"latch": fb.Latch(guide, 1.5)})
    held = whole.t > whole.stats.changes["latch"] + 1e-9
    # On b: the left mass is pulled along, with 2/5 of the load.
    assert whole.joint(guide).motor_force[held] == pytest.approx(-0.4, rel=1e-9)
    assert not whole.joint(guide).motor_force[~held].any()
    scene.remove(load)
    scene.unlock(guide)
    with pytest.raises(ValueError, match="motor"):
        _ = fb.simulate(scene, dt=0.1, t_end=0.5).joint(guide).motor_force


def test_a_failure_after_a_change_keeps_the_whole_motion():
    scene, bodies, guides = train(3, (1.0, 1.0, 1.0), (-1.0, 0.0, 2.0))
    stop = {"until": lambda t, y: 1.0 if t < 0.6 else np.nan, "dt": 0.1, "t_end": 2.0}
    with pytest.raises(fb.SceneError, match="until gives nan") as error:
        fb.simulate(scene, changes=latches(guides[1:], 1.5), **stop)
    kept = error.value.solution
    assert kept.t[0] == 0 and kept.t[-1] > 0.5
    assert kept.stats.changes["guide 0"] == pytest.approx(0.25, abs=1e-12)


def test_wrong_changes_are_refused():
    scene, bodies, guides = train(3, (1.0, 1.0, 1.0), (-1.0, 0.0, 2.0))
    other = train(2, (1.0, 1.0), (0.0, 1.0))[2][0]
    options = {"dt": 0.1, "t_end": 1.0}
    slot = scene.add_joint(fb.PinInSlot(fb.GROUND, bodies[0], axis=(1, 0)))
    rigid = fb.Rigid(bodies[0], bodies[1], offset=(1, 0))
    for wrong, words in (
        (fb.Latch(guides[0], 1.5), "a dictionary of fx_beam.Latch and fx_beam.Fuse by names"),
        ({"a": 1.5}, "a dictionary of fx_beam.Latch and fx_beam.Fuse by names"),
        ({"a": fb.Latch(other, 1.5)}, "a joint that add_joint of this scene returned"),
        ({"a": fb.Latch(slot, 1.5)}, "Name one of them"),
        ({"a": fb.Fuse(rigid, 1.5)}, "a joint that add_joint of this scene returned"),
    ):
        with pytest.raises(fb.SceneError, match=words):
            fb.simulate(scene, changes=wrong, **options)
    with pytest.raises(fb.SceneError, match="force = -1 must be finite and positive"):
        fb.Fuse(guides[0], -1)
    with pytest.raises(fb.SceneError, match="at = None must be a finite number"):
        fb.Latch(guides[0], None)
    with pytest.raises(fb.SceneError, match="Use two names"):
        until = {"a": lambda t, y: t - 0.5}
        fb.simulate(scene, changes={"a": fb.Latch(guides[0], 1.5)}, until=until, **options)
    with pytest.raises(fb.SceneError, match="rows at the ends of steps, with motion and forces"):
        record = fb.Record(times=[0.0, 0.5])
        fb.simulate(scene, changes={"a": fb.Latch(guides[0], 1.5)}, record=record, **options)
    scene.lock(guides[0])
    with pytest.raises(fb.SceneError, match="holds its slide already"):
        fb.simulate(scene, changes={"a": fb.Latch(guides[0], 1.5)}, **options)
