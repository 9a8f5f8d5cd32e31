"""Joints that are locked or made during a motion, latches, fuses; motions joined in one."""

import copy

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, held_body, hinged_body, one_body, pinned_bar

import fx_beam as fb

SCHEMES = [fb.EnergyMomentum(), fb.EnergyMomentum(order=4), fb.EnergyDecaying(), fb.Newmark()]
by_scheme = pytest.mark.parametrize("scheme", SCHEMES, ids=["2", "4", "decaying", "Newmark"])
SOFT = fb.Section(EA=1e5, GA=1e5, EI=50.0, rhoA=1.0, rhoI=1e-3)


def train(count, masses, speeds):
    """Bodies in a row, each on a guide of the one before."""
    scene = fb.Scene()
    bodies = [scene.add_body((x, 0), masses[x], 0.1).centre for x in range(count)]
    pairs = zip(bodies[:-1], bodies[1:], strict=True)
    guides = [scene.add_joint(fb.Prismatic(*pair, axis=(1, 0))) for pair in pairs]
    for body, speed in zip(bodies, speeds, strict=True):
        scene.set_velocity(body, (speed, 0.0))
    return scene, bodies, guides


def two_masses():
    """Of 2 and 3 kg, the second of which goes away by 0.6 m/s."""
    scene, bodies, (guide,) = train(2, (2.0, 3.0), (0.0, 0.6))
    return scene, bodies, guide


def apart_by(guide, distance):
    outputs = {"distance": fb.Output("slide", guide)}
    return {"outputs": outputs, "until": lambda t, y: y["distance"] - distance}


def hinged_arm():
    """A flexible arm that turns about the end of another one."""
    scene, root = clamped_bar((1, 0), SOFT, elements=3)
    arm = scene.add_beam([(1, 0), (2, 0)], SOFT, elements=3)
    hinge = scene.add_joint(fb.Revolute(root.end, arm.start))
    scene.set_velocity(arm, lambda x, y: (0.0, 4 * (x - 1)), 4.0)
    return scene, arm, hinge


@by_scheme
def test_two_masses_that_latch_lose_the_energy_of_their_reduced_mass(scheme):
    scene, (left, right), guide = two_masses()
    apart = fb.simulate(scene, scheme, t_end=9.0, dt=0.1, **apart_by(guide, 1.5))
    assert apart.t[-1] == pytest.approx(0.5 / 0.6, abs=1e-12)
    own = scene.lock(guide)
    latched = fb.simulate(scene, scheme, t_end=2.0, start=apart, dt=0.1)
    reduced = 2.0 * 3.0 / (2.0 + 3.0)
    assert latched.energy.impact == pytest.approx(reduced * 0.6**2 / 2, rel=1e-11)
    for body in (left, right):
        assert latched.velocity(body)[:, 0] == pytest.approx(3 * 0.6 / 5, rel=1e-11)
    assert abs(latched.linear_momentum - apart.linear_momentum[-1]).max() < 1e-12
    assert latched.joint(guide).slide == pytest.approx(1.5, abs=1e-12)
    assert abs(latched.joint(own).motor_force[1:]).max() < 1e-9
    assert abs(latched.energy.balance_error).max() < 1e-12


@pytest.mark.parametrize("scheme", SCHEMES[::3], ids=["2", "Newmark"])
def test_a_locked_hinge_keeps_its_angle_also_after_more_than_a_turn(scheme):
    scene, arm, hinge = hinged_arm()
    outputs = {"angle": fb.Output("angle", hinge)}
    opened = fb.simulate(
        scene, scheme, dt=5e-3, t_end=3.0, outputs=outputs, until=lambda t, y: y["angle"] - 7.0
    )
    scene.lock(hinge)
    held = fb.simulate(scene, scheme, dt=5e-3, t_end=opened.t[-1] + 0.2, start=opened)
    assert held.joint(hinge).angle == pytest.approx(7.0, abs=1e-11)
    assert 0 < held.energy.impact[0] < opened.energy.kinetic[-1]
    total = opened.energy.total[-1] + opened.energy.algorithmic[-1] + opened.energy.dissipated[-1]
    after = held.energy.total[0] + held.energy.impact[0] + held.energy.dissipated[0]
    assert after == pytest.approx(total, rel=1e-12)
    if scheme.name != "Newmark":
        assert abs(held.energy.balance_error).max() < 1e-11
    assert fb.static(scene, start=held).joint(hinge).angle[-1] == pytest.approx(7.0, abs=1e-11)


def test_a_joint_that_is_unlocked_goes_on_freely():
    scene, _, guide = two_masses()
    apart = fb.simulate(scene, dt=0.1, t_end=9.0, **apart_by(guide, 1.5))
    scene.lock(guide)
    latched = fb.simulate(scene, dt=0.1, t_end=2.0, start=apart)
    scene.unlock(guide)
    load = scene.add_force(guide.b, (3.0, 0.0))
    free = fb.simulate(scene, dt=0.1, t_end=3.0, start=latched)
    assert free.joint(guide).slide[-1] == pytest.approx(1.5 + 3.0 / 3.0 * 1.0**2 / 2, abs=1e-9)
    assert free.energy.impact[-1] == pytest.approx(latched.energy.impact[-1], rel=1e-12)
    assert load in scene.loads


def test_a_solution_does_not_depend_on_what_becomes_of_its_scene():
    """Also where it is read only after the change."""
    scene, arm, hinge = hinged_arm()
    scene.add_joint(fb.PinInSlot(fb.GROUND, arm.end, axis=(0, 1)))
    other = copy.deepcopy(scene)
    options = {"dt": 5e-3, "t_end": 0.05}
    one, two = (fb.simulate(scene_or_copy, **options) for scene_or_copy in (scene, other))
    expected = [two.resultants(arm.name).M, two.joint_forces, two.v, two.energy.kinetic, two.a]
    scene.remove(scene.joints[1], arm)
    ball = scene.add_body((5, 5), 1.0, 0.1, points={"a": (6, 5)})
    scene.add_joint(fb.Revolute(fb.GROUND, ball["a"]))
    computed = [one.resultants(arm.name).M, one.joint_forces, one.v, one.energy.kinetic, one.a]
    for ours, theirs in zip(computed, expected, strict=True):
        assert ours.shape == theirs.shape
        assert np.array_equal(ours, theirs)


# -- Joints that are made in a motion ------------------------------------------------------------


@by_scheme
def test_bodies_that_dock_have_the_common_motion_of_both(scheme):
    """Two free bodies whose ports meet."""
    scene, one = one_body((0, 0), 2.0, 0.3, points={"port": (0.5, 0.1)}, name="one")
    two = scene.add_body((3, 0.2), 3.0, 0.4, points={"port": (2.6, 0.1)}, name="two")
    scene.set_velocity(one, (1.0, 0.0))
    scene.set_velocity(two, (-0.4, 0.0))
    outputs = {b.name: fb.Output("position", b["port"], "x") for b in (one, two)}
    meet = {"outputs": outputs, "until": lambda t, y: y["two"] - y["one"]}
    flight = fb.simulate(scene, scheme, dt=0.05, t_end=9.0, **meet)
    port = scene.add_joint(fb.Rigid(one["port"], two["port"]), at=flight)
    docked = fb.simulate(scene, scheme, t_end=flight.t[-1] + 1, start=flight, dt=0.05)
    # The velocity of the common centre, and the spin by the angular momentum about it.
    m, J = np.array([2.0, 3.0]), np.array([0.3, 0.4])
    x = np.array([flight.position(body.centre)[-1] for body in (one, two)])
    v = np.array([[1.0, 0.0], [-0.4, 0.0]])
    centre, common = m @ x / 5, m @ v / 5
    (rx, ry), (vx, vy) = (x - centre).T, (v - common).T
    spin = (m * (rx * vy - ry * vx)).sum() / (J.sum() + (m * (rx**2 + ry**2)).sum())
    lost = (m * (vx**2 + vy**2)).sum() / 2
    lost -= spin**2 * (J.sum() + (m * (rx**2 + ry**2)).sum()) / 2
    assert docked.energy.impact[0] == pytest.approx(lost, rel=1e-10)
    assert docked.spin(one.centre)[0] == pytest.approx(spin, rel=1e-10)
    assert docked.spin(two.centre) == pytest.approx(spin, rel=2e-5)
    assert docked.joint(port).gap.max() < 1e-13
    if scheme.name != "Newmark":
        assert abs(docked.energy.balance_error).max() < 1e-12
        moved = docked.angular_momentum - flight.angular_momentum[0]
        assert abs(moved).max() < 1e-12


@pytest.mark.parametrize(
    ("kind", "side"),
    [("Revolute", "a"), ("Rigid", "b"), ("Prismatic", "a"), ("PinInSlot", "b"), ("Rigid", "a")],
)
def test_a_hook_on_the_ground_catches_a_body_where_it_is(kind, side, tmp_path):
    scene, body = one_body((0, 0), 1.0, 0.1, points={"eye": (0.5, 0)}, gravity=(0, -9.81))
    scene.set_velocity(body, (2.0, 1.0), 5.0)
    flight = fb.simulate(scene, dt=0.01, t_end=0.33)
    axis = {"axis": (1, 1)} if kind in ("Prismatic", "PinInSlot") else {}
    ends = (fb.GROUND, body["eye"]) if side == "a" else (body["eye"], fb.GROUND)
    hook = scene.add_joint(getattr(fb, kind)(*ends, **axis), at=flight)
    caught = fb.simulate(scene, dt=0.01, t_end=0.6, start=flight)
    assert caught.joint(hook).gap.max() < 1e-13
    assert abs(caught.energy.balance_error).max() < 1e-11
    way = caught.position(body["eye"]) - flight.position(body["eye"])[-1]
    if not axis:
        assert abs(way).max() < 1e-13
    if kind == "Rigid":
        assert caught.energy.impact[0] == pytest.approx(flight.energy.kinetic[-1], rel=1e-12)
        assert np.ptp(caught.rotation(body.centre)) < 1e-13
    # A run goes on from a file as if it had not ended.
    caught.save(tmp_path / "caught.npz")
    again = fb.simulate(scene, dt=0.01, t_end=0.7, start=fb.load(tmp_path / "caught.npz"))
    whole = fb.simulate(scene, dt=0.01, t_end=0.7, start=flight)
    assert abs(again.q[-1] - whole.q[-1]).max() < 1e-12


def test_a_joint_that_closes_a_loop_in_a_motion():
    scene, left = one_body((0.5, 0), 1.0, 0.1, points={"pin": (0, 0)}, gravity=(0, -9.81))
    right = scene.add_body((2.6, 0), 1.0, 0.1, points={"pin": (3.2, 0), "end": (2, 0)})
    for body in (left, right):
        scene.add_joint(fb.Revolute(fb.GROUND, body["pin"]))
    swing = fb.simulate(scene, dt=5e-3, t_end=0.2)
    apart = swing.position(right["end"])[-1] - swing.position(left.centre)[-1]
    psi = swing.rotation(left.centre)[-1]
    axis = np.array([[np.cos(psi), np.sin(psi)], [-np.sin(psi), np.cos(psi)]]) @ apart
    slot = scene.add_joint(fb.PinInSlot(left.centre, right["end"], axis=axis), at=swing)
    closed = fb.simulate(scene, dt=5e-3, t_end=0.5, start=swing)
    assert closed.joint(slot).slide[0] == pytest.approx(np.hypot(*apart), rel=1e-12)
    assert closed.joint(slot).gap.max() < 1e-12
    assert closed.energy.impact[0] > 0
    assert abs(closed.energy.balance_error).max() < 1e-10


# -- Joined motions --------------------------------------------------------------------------------


def test_joined_motions_have_the_rows_and_the_balance_of_both(tmp_path):
    scene, first = pinned_bar((1, 0), SOFT, elements=2, degree=2, name="first", gravity=(0, -9.81))
    second = scene.add_beam([(1, 0), (2, 0)], SOFT, elements=2, degree=2, name="second")
    hinge = scene.add_joint(fb.Revolute(first.end, second.start))
    whole = fb.simulate(scene, dt=0.01, t_end=0.2)
    scene.remove(hinge)
    cut = fb.simulate(scene, dt=0.01, t_end=0.3, start=whole)
    scene.remove(second)
    ball = scene.add_body((3, 0), 1.0, 0.1)
    rest = fb.simulate(scene, dt=0.01, t_end=0.4, start=cut)
    joined = whole.then(cut).then(rest)
    assert joined.t == pytest.approx(np.arange(41) * 0.01)
    assert abs(joined.energy.balance_error).max() < 1e-11
    assert joined.stats.steps == 40
    for one, node, rows in (
        (whole, second.end, slice(0, 21)),
        (cut, second.end, slice(20, 31)),
        (rest, first.end, slice(30, 41)),
        (rest, ball.centre, slice(30, 41)),
    ):
        n = len(one.t) - 1
        assert abs(joined.position(node)[rows][-n:] - one.position(node)[-n:]).max() == 0
    for name in ("first", "second"):
        assert joined.resultants(name).M.shape == (41, 4)
        assert np.isfinite(joined.shape(name)).all()
    assert joined.resultants(first).M[35] == pytest.approx(rest.resultants(first).M[5])
    # What was taken away stays where it was.
    assert np.ptp(joined.q[30:, joined.nodes_of_beam["second"]], axis=0).max() == 0
    joined.save(tmp_path / "joined.npz")
    assert fb.load(tmp_path / "joined.npz").position(first.end) == pytest.approx(
        joined.position(first.end)
    )
    more = {"dt": 0.01, "t_end": 0.45}
    one, other = (fb.simulate(scene, start=start, **more) for start in (joined, rest))
    assert abs(one.position(ball.centre) - other.position(ball.centre)).max() < 1e-12
    assert_refused("the second one starts at t = 0.3", whole.then, rest, error=ValueError)
    assert_refused("then needs a solution, not 3", whole.then, 3, error=ValueError)


# -- Latches and fuses within one call -------------------------------------------------------------


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
    scene, hub = held_body((0, 0), 3.0, 1.0)
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


def test_a_joint_that_begins_at_its_latch_is_caught_when_it_comes_back():
    scene, door, hinge = hinged_body((0.5, 0), 1.0, 0.25, {"hinge": (0, 0)}, spring=fb.Spring(2.0))
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


@pytest.mark.parametrize("scheme", SCHEMES[:2], ids=["order 2", "order 4"])
def test_the_weaker_of_two_joints_breaks_at_its_force(scheme):
    """Of two masses and the ground in a row, under a force that grows at the end."""
    scene = fb.Scene()
    near, far = (scene.add_body((x, 0), 1.0, 0.1).centre for x in (1, 2))
    joints = [
        scene.add_joint(fb.Rigid(fb.GROUND, near)),
        scene.add_joint(fb.Rigid(near, far, offset=(1, 0))),
    ]
    scene.add_force(far, lambda t: (10.0 * t, 0.0))
    fuses = {"joint 0": fb.Fuse(joints[0], 9.0), "joint 1": fb.Fuse(joints[1], 8.0)}
    whole = fb.simulate(scene, scheme, dt=0.01, t_end=1.2, changes=fuses)
    assert [*whole.stats.changes] == ["joint 1"]
    row = int(np.searchsorted(whole.t, whole.stats.changes["joint 1"]))
    # Means of steps lead to the force at the end.
    assert whole.t[row] == pytest.approx(0.8, abs=1e-9)
    assert abs(whole.q[:, near.number]).max() < 1e-13
    t1, t2 = whole.t[row], whole.t[-1]
    assert whole.velocity(far)[-1, 0] == pytest.approx(5 * (t2**2 - t1**2), rel=1e-9)
    assert whole.energy.impact[-1] == pytest.approx(0, abs=1e-12)
    assert abs(whole.energy.balance_error).max() < 1e-11 * whole.energy.work[-1]
    assert scene.joints == [fuses["joint 0"].joint]


@pytest.mark.exact_times
def test_a_joint_breaks_where_a_motor_stops_at_once():
    """The mean force is 4 N while it moves 2 kg faster and faster, and 32 N in the next step."""
    scene = fb.Scene()
    cart, load = (scene.add_body((0, 0), m, 0.1).centre for m in (1.0, 2.0))
    slide = lambda t: min(t, 0.5) ** 2  # noqa: E731
    scene.add_joint(fb.Prismatic(fb.GROUND, cart, (1, 0), motor=slide))
    fuse = fb.Fuse(scene.add_joint(fb.Rigid(cart, load)), 30.0)
    whole = fb.simulate(scene, dt=1 / 16, t_end=1.0, changes={"fuse": fuse})
    # It breaks after a tenth of a step, in which the force is larger still.
    assert whole.stats.changes["fuse"] == pytest.approx(0.5 + 0.1 / 16)


@pytest.mark.parametrize("names", [("first", "second"), ("second", "first")])
@pytest.mark.parametrize(("jump", "later"), [(0.03, 0.001), (0.0501, 0.0)])
def test_of_fuses_that_a_jump_overloads_the_most_loaded_one_breaks(names, jump, later):
    """Of three equal bodies in a row the last one is pulled: by 30 and 60 N in the joints.

    After a jump at the end of a step it breaks a tenth of a step later, with the momentum of this.
    """
    scene = fb.Scene()
    bodies = [scene.add_body((x, 0), 1.0, 0.1).centre for x in range(3)]
    pairs = zip(bodies[:-1], bodies[1:], strict=True)
    joints = [scene.add_joint(fb.Rigid(*pair, offset=(1, 0))) for pair in pairs]
    scene.add_force(bodies[2], lambda t: (90.0 if t > jump else 0.0, 0.0))
    fuses = dict(zip(("first", "second"), (fb.Fuse(joint, 20.0) for joint in joints), strict=True))
    changes = {name: fuses[name] for name in names}
    motion = fb.simulate(scene, dt=0.01, t_end=0.1, changes=changes)
    assert motion.stats.changes == {"second": pytest.approx(jump + later, abs=1e-9)}
    if later:
        row = int(np.searchsorted(motion.t, 0.0309))
        assert motion.linear_momentum[row, 0] == pytest.approx(90.0 * later)


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
    scene, (_, right), guide = two_masses()
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
    first_part = error.value.solution
    assert first_part.t[0] == 0 and first_part.t[-1] > 0.5
    assert first_part.stats.changes["guide 0"] == pytest.approx(0.25, abs=1e-12)


# -- Refusals --------------------------------------------------------------------------------------


def run(scene, changes, **options):
    fb.simulate(scene, changes=changes, dt=0.1, t_end=1.0, **options)


TIMES = fb.Record(times=[0.0, 0.5])
REFUSED = [
    (lambda s, g, slot: s.lock(slot), "coordinates. Name one of them"),
    (lambda s, g, slot: s.lock(slot, "turn"), "coordinate = 'turn' must be one of"),
    (lambda s, g, slot: s.lock(fb.Rigid(g.a, g.b)), "lock = .*Rigid.* must be a joint that add"),
    (
        lambda s, g, slot: s.lock(s.add_joint(fb.Rigid(g.a, g.b, offset=(1, 0)))),
        "no slide and no relative rotation to lock",
    ),
    (lambda s, g, slot: s.unlock(g), "unlock .* is not locked"),
    (lambda s, g, slot: (s.lock(g), s.lock(g)), "holds its slide already"),
    (lambda s, g, slot: run(s, fb.Latch(g, 1.5)), "a dictionary of fx_beam.Latch and fx_beam.Fuse"),
    (
        lambda s, g, slot: run(s, {"a": fb.Latch(two_masses()[2], 1.5)}),
        "a joint that add_joint of this scene returned",
    ),
    (lambda s, g, slot: run(s, {"a": fb.Latch(slot, 1.5)}), "Name one of them"),
    (lambda s, g, slot: (s.lock(g), run(s, {"a": fb.Latch(g, 1.5)})), "holds its slide already"),
    (lambda s, g, slot: fb.Latch(g, None), "at = None must be a finite number"),
    (
        lambda s, g, slot: run(s, {"a": fb.Latch(g, 1.5)}, until={"a": lambda t, y: t - 0.5}),
        "Use two names",
    ),
    (
        lambda s, g, slot: run(s, {"a": fb.Latch(g, 1.5)}, record=TIMES),
        "rows at the ends of steps, with motion and forces",
    ),
]


@pytest.mark.parametrize(("wrong", "words"), REFUSED, ids=[words for _, words in REFUSED])
def test_wrong_locks_and_changes_are_refused(wrong, words):
    scene, _, guide = two_masses()
    slot = scene.add_joint(fb.PinInSlot(fb.GROUND, guide.a, axis=(1, 0)))
    assert_refused(words, wrong, scene, guide, slot)
    scene.remove(guide)  # also by the joint that add_joint returned, and if it is locked
    assert guide.number not in [joint.number for joint in scene.joints]
