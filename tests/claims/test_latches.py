"""Joints that are locked during a motion, and fuses that break; motions joined in one solution."""

import copy

import numpy as np
import pytest

import fx_beam as fb

SCHEMES = [
    fb.EnergyMomentum(),
    fb.EnergyMomentum(order=4),
    fb.EnergyDecaying(),
    fb.Newmark(),
]
SOFT = fb.Section(EA=1e5, GA=1e5, EI=50.0, rhoA=1.0, rhoI=1e-3)


def two_masses():
    scene = fb.Scene()
    bodies = [
        scene.add_body((x, 0), mass=m, inertia=0.1, name=f"m{m:g}") for x, m in ((0, 2.0), (1, 3.0))
    ]
    guide = scene.add_joint(fb.Prismatic(*(body.centre for body in bodies), axis=(1, 0)))
    scene.set_velocity(bodies[1], (0.6, 0.0))
    return scene, bodies, guide


def apart_by(guide, distance):
    outputs = {"distance": fb.Output("slide", guide)}
    return {"outputs": outputs, "until": lambda t, y: y["distance"] - distance}


def hinged_arm():
    """A flexible arm that turns about the end of another one."""
    scene = fb.Scene()
    root = scene.add_beam([(0, 0), (1, 0)], SOFT, elements=3)
    arm = scene.add_beam([(1, 0), (2, 0)], SOFT, elements=3)
    scene.clamp(root.start)
    hinge = scene.add_joint(fb.Revolute(root.end, arm.start))
    scene.set_velocity(arm, lambda x, y: (0.0, 4 * (x - 1)), 4.0)
    return scene, arm, hinge


@pytest.mark.parametrize("solver", ["auto", "petsc"])
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_two_masses_that_latch_lose_the_energy_of_their_reduced_mass(scheme, solver):
    scene, (left, right), guide = two_masses()
    options = {"dt": 0.1, "solver": solver}
    apart = fb.simulate(scene, scheme, t_end=9.0, **options, **apart_by(guide, 1.5))
    assert apart.t[-1] == pytest.approx(0.5 / 0.6, abs=1e-12)
    own = scene.lock(guide)
    latched = fb.simulate(scene, scheme, t_end=2.0, start=apart, **options)
    reduced = 2.0 * 3.0 / (2.0 + 3.0)
    assert latched.energy.impact == pytest.approx(reduced * 0.6**2 / 2, rel=1e-11)
    for body in (left, right):
        assert latched.velocity(body.centre)[:, 0] == pytest.approx(3 * 0.6 / 5, rel=1e-11)
    assert abs(latched.linear_momentum - apart.linear_momentum[-1]).max() < 1e-12
    assert latched.slide(guide) == pytest.approx(1.5, abs=1e-12)
    assert abs(latched.joint(own).motor_force[1:]).max() < 1e-9
    assert abs(latched.energy.balance_error).max() < 1e-12


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_a_locked_hinge_keeps_its_angle_also_after_more_than_a_turn(scheme, tmp_path):
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
    # Files, statics, motions step by step and their copies hold it as well.
    held.save(tmp_path / "held.npz")
    again = {"dt": 5e-3, "t_end": held.t[-1] + 0.05, "start": fb.load(tmp_path / "held.npz")}
    assert np.ptp(fb.simulate(scene, scheme, **again).joint(hinge).angle) < 1e-12
    assert fb.static(scene, start=held).joint(hinge).angle[-1] == pytest.approx(7.0, abs=1e-11)
    motion = fb.Motion(scene, scheme, dt=5e-3, start=held)
    motion.run(held.t[-1] + 0.05)
    other = copy.deepcopy(motion)
    for one in (motion, other):
        one.run(held.t[-1] + 0.1)
    assert abs(motion.q - other.q).max() < 1e-12


def test_a_joint_that_is_unlocked_goes_on_freely():
    scene, _, guide = two_masses()
    apart = fb.simulate(scene, dt=0.1, t_end=9.0, **apart_by(guide, 1.5))
    scene.lock(guide)
    latched = fb.simulate(scene, dt=0.1, t_end=2.0, start=apart)
    scene.unlock(guide)
    load = scene.add_force(guide.b, (3.0, 0.0))
    free = fb.simulate(scene, dt=0.1, t_end=3.0, start=latched)
    assert free.slide(guide)[-1] == pytest.approx(1.5 + 3.0 / 3.0 * 1.0**2 / 2, abs=1e-9)
    assert free.energy.impact[-1] == pytest.approx(latched.energy.impact[-1], rel=1e-12)
    assert load in scene.loads


def test_wrong_locks_are_refused():
    scene, _, guide = two_masses()
    slot = scene.add_joint(fb.PinInSlot(fb.GROUND, guide.a, axis=(1, 0)))
    rigid = fb.Rigid(guide.a, guide.b, offset=(1, 0))
    with pytest.raises(fb.SceneError, match="coordinates. Name one of them"):
        scene.lock(slot)
    with pytest.raises(fb.SceneError, match="coordinate = 'turn' must be one of"):
        scene.lock(slot, "turn")
    with pytest.raises(fb.SceneError, match="lock = .*Rigid.* must be a joint that add_joint"):
        scene.lock(rigid)
    with pytest.raises(fb.SceneError, match="no slide and no relative rotation to lock"):
        scene.lock(scene.add_joint(rigid))
    with pytest.raises(fb.SceneError, match="unlock .* is not locked"):
        scene.unlock(guide)
    scene.lock(guide)
    with pytest.raises(fb.SceneError, match="holds its slide already"):
        scene.lock(guide)
    scene.remove(guide)  # also by the joint that add_joint returned
    assert guide.number not in [joint.number for joint in scene.joints]


@pytest.mark.parametrize("scheme", SCHEMES[:2], ids=["order 2", "order 4"])
def test_a_fuse_breaks_at_its_force(scheme):
    """Two masses that a growing force pulls: the joint between them carries a part of it."""
    scene = fb.Scene()
    left, right = (scene.add_body((x, 0), m, 0.1).centre for x, m in ((0, 2.0), (1, 3.0)))
    fuse = scene.add_joint(fb.Rigid(left, right, offset=(1, 0)))
    scene.add_force(right, lambda t: (10.0 * t, 0.0))
    outputs = {"force": fb.Output("force", fuse)}
    whole = fb.simulate(
        scene,
        scheme,
        dt=0.01,
        t_end=9.0,
        outputs=outputs,
        until={"fuse": lambda t, y: np.hypot(*y["force"][:2]) - 8.0},
    )
    # The left mass needs 2/5 of the load, at the middle of the last step.
    assert np.diff(whole.t).min() > 0.009
    assert whole.t_level[-1] == pytest.approx(8.0 / (0.4 * 10.0), abs=1e-9)
    assert abs(whole.joint(fuse).force[-1, 0]) == pytest.approx(8.0, rel=1e-10)
    scene.remove(fuse)
    parted = fb.simulate(scene, scheme, dt=0.01, t_end=3.0, start=whole)
    assert parted.energy.impact[-1] == pytest.approx(0, abs=1e-12)
    assert np.ptp(parted.velocity(left)[:, 0]) < 1e-11
    assert abs(parted.energy.balance_error).max() < 1e-11 * parted.energy.work[-1]


def test_a_solution_does_not_depend_on_what_becomes_of_its_scene():
    """Also where it is read only after the change."""
    scene, arm, hinge = hinged_arm()
    scene.add_joint(fb.PinInSlot(fb.GROUND, arm.end, axis=(0, 1)))
    other = copy.deepcopy(scene)
    options = {"dt": 5e-3, "t_end": 0.05}
    one, two = (fb.simulate(of, **options) for of in (scene, other))
    expected = [two.resultants(arm.name).M, two.joint_forces, two.v, two.energy.kinetic, two.a]
    scene.remove(scene.joints[1], arm)
    ball = scene.add_body((5, 5), 1.0, 0.1, points={"a": (6, 5)})
    scene.add_joint(fb.Revolute(fb.GROUND, ball["a"]))
    found = [one.resultants(arm.name).M, one.joint_forces, one.v, one.energy.kinetic, one.a]
    for ours, theirs in zip(found, expected, strict=True):
        assert ours.shape == theirs.shape
        assert np.array_equal(ours, theirs)


# -- Joints that are made in a motion ------------------------------------------------------------


def docking():
    """Two free bodies whose ports meet."""
    scene = fb.Scene()
    one = scene.add_body((0, 0), 2.0, 0.3, points={"port": (0.5, 0.1)}, name="one")
    two = scene.add_body((3, 0.2), 3.0, 0.4, points={"port": (2.6, 0.1)}, name="two")
    scene.set_velocity(one, (1.0, 0.0))
    scene.set_velocity(two, (-0.4, 0.0))
    outputs = {b.name: fb.Output("position", b["port"], "x") for b in (one, two)}
    meet = {"outputs": outputs, "until": lambda t, y: y["two"] - y["one"]}
    return scene, one, two, meet


@pytest.mark.parametrize("solver", ["auto", "petsc"])
@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_bodies_that_dock_have_the_common_motion_of_both(scheme, solver):
    scene, one, two, meet = docking()
    options = {"dt": 0.05, "solver": solver}
    flight = fb.simulate(scene, scheme, t_end=9.0, **options, **meet)
    port = scene.add_joint(fb.Rigid(one["port"], two["port"]), at=flight)
    docked = fb.simulate(scene, scheme, t_end=flight.t[-1] + 1, start=flight, **options)
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


@pytest.mark.parametrize("kind", ["Revolute", "Rigid", "Prismatic", "PinInSlot"])
@pytest.mark.parametrize("side", ["a", "b"])
def test_a_hook_on_the_ground_catches_a_body_where_it_is(kind, side, tmp_path):
    scene = fb.Scene(gravity=(0, -9.81))
    body = scene.add_body((0, 0), 1.0, 0.1, points={"eye": (0.5, 0)})
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
    scene = fb.Scene(gravity=(0, -9.81))
    left = scene.add_body((0.5, 0), 1.0, 0.1, points={"pin": (0, 0)})
    right = scene.add_body((2.6, 0), 1.0, 0.1, points={"pin": (3.2, 0), "end": (2, 0)})
    for body in (left, right):
        scene.add_joint(fb.Revolute(fb.GROUND, body["pin"]))
    swing = fb.simulate(scene, dt=5e-3, t_end=0.2)
    apart = swing.position(right["end"])[-1] - swing.position(left.centre)[-1]
    psi = swing.rotation(left.centre)[-1]
    axis = np.array([[np.cos(psi), np.sin(psi)], [-np.sin(psi), np.cos(psi)]]) @ apart
    slot = scene.add_joint(fb.PinInSlot(left.centre, right["end"], axis=axis), at=swing)
    closed = fb.simulate(scene, dt=5e-3, t_end=0.5, start=swing)
    assert closed.slide(slot)[0] == pytest.approx(np.hypot(*apart), rel=1e-12)
    assert closed.joint(slot).gap.max() < 1e-12
    assert closed.energy.impact[0] > 0
    assert abs(closed.energy.balance_error).max() < 1e-10


# -- Joined motions --------------------------------------------------------------------------------


def test_joined_motions_have_the_rows_and_the_balance_of_both(tmp_path):
    scene = fb.Scene(gravity=(0, -9.81))
    first = scene.add_beam([(0, 0), (1, 0)], SOFT, elements=2, degree=2, name="first")
    second = scene.add_beam([(1, 0), (2, 0)], SOFT, elements=2, degree=2, name="second")
    scene.pin(first.start)
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
    with pytest.raises(ValueError, match="the second one starts at t = 0.3"):
        whole.then(rest)
    with pytest.raises(ValueError, match="then needs a solution, not 3"):
        whole.then(3)
