"""Motions that start from another solution: continued runs, and states of static equilibrium."""

import itertools
import logging

import numpy as np
import pytest
from jointed import MEMBER, pair
from scenes import FLYING, free_flight, pinned_beam

import fx_beam as fb

SCHEMES = [
    fb.EnergyMomentum(),
    fb.ModifiedMidPoint(),
    fb.MidPoint(),
    fb.Newmark(),
    fb.GeneralizedAlpha(0.6),
]
HISTORIES = ("t", "t_level", "q", "v", "a", "reactions", "slides", "joint_forces")
MOMENTA = ("linear_momentum", "angular_momentum")
ENERGIES = ("kinetic", "strain", "potential", "work", "springs", "dissipated")


def driven_frame():
    """Loads, supports and forces of one's own that are functions of time."""
    scene = fb.Scene(gravity=(0.3, -9.81))
    post = scene.add_beam([(0, 0), (0, 1)], FLYING, elements=2)
    arm = scene.add_beam([post.end, (0.7, 1.4)], FLYING, elements=2)
    scene.prescribe(post.start, x=lambda t: 0.05 * np.sin(6 * t), rotation=lambda t: 0.2 * t**2)
    scene.fix(post.start, "y")
    scene.add_force(arm.end, lambda t: (3 * np.sin(t), 1.0))
    scene.add_line_load(arm, lambda t: (0.0, -2 * t))
    scene.add_virtual_work(lambda step: -step.t * step.v[0] * step.virtual_u[0])
    return scene


def linkage():
    """A motor, an offset, a slide, and joints to the ground."""
    scene = fb.Scene(gravity=(0, -9.81))
    crank = scene.add_beam([(0, 0), (0.5, 0)], FLYING)
    rod = scene.add_beam([(0.6, 0), (1.6, 0.3)], FLYING, elements=2)
    tail = scene.add_beam([(1.6, 0.3), (2.4, 0.3)], FLYING)
    scene.add_joint(fb.Revolute(fb.GROUND, crank.start, motor=lambda t: 1.5 * t**2))
    scene.add_joint(fb.Revolute(crank.end, rod.start, offset=(0.1, 0)))
    scene.add_joint(fb.Prismatic(rod.end, tail.start, axis=(1, 0.2)))
    scene.add_joint(fb.PinInSlot(fb.GROUND, tail.end, axis=(1, 0)))
    return scene


def sprung():
    """Springs and dampers on a slide and on a hinge, and a follower force."""
    acting = {"spring": fb.Spring(50.0, 0.1), "damper": fb.Damper(3.0)}
    scene, first, second, _ = pair("prismatic with offset", gravity=(0, -5.0), **acting)
    scene.pin(first.start)
    scene.add_force(second.end, lambda t: (0.0, 20.0 * np.sin(5 * t)), follower=True)
    return scene


def curved_beam():
    """An arc of degree 3 that swings under its weight."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    beam = scene.add_beam(fb.arc((0, 0), (1, 0.5), (2, 0)), FLYING, elements=2, degree=3)
    scene.pin(beam.start)
    return scene


SCENES = {
    "pinned beam": (lambda: pinned_beam(4)[0], 0.01),
    "pinned beam of degree 2": (lambda: pinned_beam(2, degree=2)[0], 0.01),
    "curved beam of degree 3": (curved_beam, 0.01),
    "driven frame": (driven_frame, 0.01),
    "linkage": (linkage, 0.01),
    "springs, dampers and a follower": (sprung, 0.01),
}


# Conserving schemes have the same state, and so has the family of Newmark: all in one scene.
RUNS = [
    (name, scheme, solver)
    for name in SCENES
    for scheme in SCHEMES
    for solver in ("auto", "petsc")
    if scheme in (SCHEMES[0], SCHEMES[-1]) or (solver == "auto" and name == "linkage")
]


@pytest.mark.parametrize(
    ("name", "scheme", "solver"), RUNS, ids=[f"{n}-{scheme.name}-{s}" for n, scheme, s in RUNS]
)
def test_a_continued_run_equals_the_uninterrupted_one(name, scheme, solver, tmp_path):
    build, dt = SCENES[name]
    scene, half, steps = build(), 5, 12
    # One iteration beyond the usual tolerance, lest the comparison be one of tolerances.
    options = {"dt": dt, "newton": fb.NewtonOptions(tolerance=1e-13), "solver": solver}
    whole = fb.simulate(scene, scheme, t_end=steps * dt, **options)
    fb.simulate(scene, scheme, t_end=half * dt, **options).save(tmp_path / "half.npz")
    # Through a file, and in a scene made anew: nothing but what was saved can carry over.
    first = fb.load(tmp_path / "half.npz")
    second = fb.simulate(build(), scheme, t_end=steps * dt, start=first, **options)
    assert len(second.t) == steps - half + 1
    rounding = {"v": 1e2, "a": 1e4, "reactions": 1e4, "joint_forces": 1e4}
    for history in (*HISTORIES, *MOMENTA):
        expected, found = getattr(whole, history)[half + 1 :], getattr(second, history)[1:]
        scale = abs(getattr(whole, history)).max(initial=1e-300)
        bound = 1e-12 * rounding.get(history, 1e2 if history in MOMENTA else 1.0)
        assert abs(found - expected).max(initial=0.0) <= bound * scale, history
    scale = abs(whole.energy.total).max() + whole.energy.kinetic.max()
    for part in ENERGIES:
        gap = getattr(second.energy, part) - getattr(whole.energy, part)[half:]
        assert abs(gap).max() <= 1e-11 * scale, part
    for beam in whole.beams:
        one, other = whole.resultants(beam), second.resultants(beam)
        assert other.M[1:] == pytest.approx(one.M[half + 1 :], abs=1e-9 * abs(one.M).max())


def test_the_first_row_of_a_continued_run_is_the_last_of_the_one_before():
    scene = linkage()
    first = fb.simulate(scene, fb.Newmark(), dt=0.01, t_end=0.1)
    second = fb.simulate(scene, fb.Newmark(), dt=0.01, t_end=0.2, start=first)
    for history in HISTORIES:
        assert np.array_equal(getattr(second, history)[0], getattr(first, history)[-1]), history
    # Sums, the last of which the loop has taken and the first numpy, in another order.
    for history in MOMENTA:
        one, other = getattr(second, history), getattr(first, history)
        assert abs(one[0] - other[-1]).max() <= 1e-14 * abs(other).max(), history
    assert second.energy.work[0] == first.energy.work[-1]
    assert abs(second.energy.balance_error[0]) == 0


def test_a_thinned_record_keeps_all_that_a_continuation_needs():
    scene, _ = pinned_beam(4)
    whole = fb.simulate(scene, dt=0.01, t_end=0.2)
    nothing = fb.Record(every=10, motion=False, rates=False, forces=False)
    first = fb.simulate(scene, dt=0.01, t_end=0.1, record=nothing)
    second = fb.simulate(scene, dt=0.01, t_end=0.2, start=first)
    assert abs(second.q[-1] - whole.q[-1]).max() < 1e-10


# -- Steps taken in parts --------------------------------------------------------------------------


def whirling(degree):
    """Two links thrown so fast that steps of 1/4 s fail every now and then.

    Springs on their hinges count turns, so that none are taken off the rotations on the way.
    """
    scene = fb.Scene(gravity=(0, -9.81))
    first = scene.add_beam([(0, 0), (1, 0)], MEMBER, elements=2, degree=degree)
    second = scene.add_beam([(1, 0), (1.8, 0.3)], MEMBER, elements=2, degree=degree)
    for a, b in ((fb.GROUND, first.start), (first.end, second.start)):
        scene.add_joint(fb.Revolute(a, b, spring=fb.Spring(1.0)))
    scene.make_velocities_compatible()
    scene.set_velocity(second, lambda x, y: (-60 * y, 60 * (x - 1)), spin=60)
    return scene


@pytest.mark.exact_times
@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.HHT(-0.1)], ids=lambda s: s.name)
@pytest.mark.parametrize(("solver", "degree"), [("compiled", 1), ("compiled", 2), ("petsc", 1)])
def test_parts_of_steps_go_on_as_if_the_motion_had_not_ended(solver, degree, scheme, tmp_path):
    # Times are without rounding, so that the two runs are the same to the last digit, however
    # chaotic the motion is.
    dt, steps = 1 / 4, 24
    whole = fb.simulate(whirling(degree), scheme, dt=dt, t_end=steps * dt, solver=solver)
    assert 0 < whole.stats.halvings < whole.stats.substeps
    part, substeps = None, 0
    for cut, end in itertools.pairwise((0, 3, 7, 11, 15, 19, 23, steps)):
        options = {"start": part, "solver": solver}
        fb.simulate(whirling(degree), scheme, dt=dt, t_end=end * dt, **options).save(
            tmp_path / "part.npz"
        )
        part = fb.load(tmp_path / "part.npz")
        substeps += part.stats.substeps
        assert (part.q[1:] == whole.q[cut + 1 : end + 1]).all()
        assert (part.t_level[1:] == whole.t_level[cut + 1 : end + 1]).all()
    assert substeps == whole.stats.substeps


def test_parts_are_not_taken_over_to_steps_of_another_length():
    first = fb.simulate(whirling(1), dt=1 / 4, t_end=1.0)
    assert first.stats.halvings
    finer = fb.simulate(whirling(1), dt=1 / 1024, t_end=1.0 + 1 / 64, start=first)
    assert finer.stats.substeps == finer.stats.steps == 16
    # Nor by a run that may not halve steps as often.
    with pytest.raises(fb.StepError):
        fb.simulate(whirling(1), dt=1 / 4, t_end=6.0, start=first, max_halvings=0)


def test_the_predictor_is_saved(tmp_path):
    solution = fb.simulate(whirling(1), dt=1 / 512, t_end=1 / 8)
    solution.save(tmp_path / "run.npz")
    past = fb.load(tmp_path / "run.npz").end.past
    assert past.orders == solution.end.past.orders > 0
    assert (past.differences == solution.end.past.differences).all()


@pytest.mark.parametrize("solver", ["compiled", "petsc"])
@pytest.mark.parametrize(("dt", "max_turn", "large"), [(1 / 4, 2.0, True), (1 / 512, 0.05, False)])
def test_the_log_says_when_steps_in_parts_are_too_large_for_the_motion(
    solver, dt, max_turn, large, caplog
):
    newton = fb.NewtonOptions(max_turn=max_turn)
    with caplog.at_level(logging.WARNING, logger="fx_beam"):
        run = fb.simulate(whirling(1), dt=dt, t_end=16 * dt, solver=solver, newton=newton)
    assert run.stats.halvings
    assert (run.stats.too_large > 0) == large
    assert run.stats.too_large <= run.stats.substeps
    (message,) = [record.message for record in caplog.records]
    assert ("is too large for this motion" in message) == large


# -- Other steps, schemes, loads -------------------------------------------------------------------


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


# -- From equilibrium ------------------------------------------------------------------------------


def arch():
    """Linkage of bent members under gravity, springs and a force; at rest it is deformed."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    left = scene.add_beam([(0, 0), (0.5, 0.6), (1, 0.8)], MEMBER, elements=3)
    right = scene.add_beam([(1.1, 0.8), (2, 0)], MEMBER, elements=2)
    scene.pin(left.start)
    scene.add_joint(fb.Revolute(left.end, right.start, offset=(0.1, 0), spring=fb.Spring(200.0)))
    scene.add_joint(fb.PinInSlot(fb.GROUND, right.end, axis=(1, 0), spring=fb.Spring(300.0)))
    scene.add_force(left.end, lambda t: (2.0, -8.0))
    scene.add_force(right.end, (1.0, 3.0), follower=True)
    scene.add_virtual_work(lambda step: -2.0 * step.load_factor * step.virtual_u[1], left)
    return scene


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda s: s.name)
def test_a_scene_in_equilibrium_stays_at_rest(scheme):
    scene = arch()
    rest = fb.static(scene, steps=4)
    bent = abs(rest.q[-1]).max()
    assert bent > 0.03
    motion = fb.simulate(scene, scheme, dt=0.01, t_end=0.2, start=rest)
    assert abs(motion.q - rest.q[-1]).max() < 1e-9 * bent
    assert motion.energy.kinetic.max() < 1e-16 * motion.energy.strain.max()
    assert motion.energy.work[0] == rest.energy.work[-1]


def test_a_beam_let_go_keeps_the_energy_that_bent_it():
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], FLYING, elements=4)
    scene.clamp(beam.start)
    scene.add_force(beam.end, lambda t: (0.0, 60.0 if t <= 0 else 0.0))
    bent = fb.static(scene, steps=10)
    motion = fb.simulate(scene, dt=0.01, t_end=1.0, start=bent)
    energy = motion.energy
    assert energy.total[0] == bent.energy.strain[-1]
    assert abs(energy.total - energy.total[0]).max() < 1e-11 * energy.total[0]
    assert energy.kinetic.max() > 0.5 * energy.total[0]
    thrown = fb.Scene()
    arm = thrown.add_beam([(0, 0), (1, 0)], FLYING, elements=4)
    thrown.set_velocity(arm, (0.0, 2.0))
    flight = fb.simulate(thrown, dt=0.01, t_end=0.1, start=bent)  # neither clamp nor force
    assert flight.linear_momentum == pytest.approx(np.tile([0.0, 2.0], (11, 1)), abs=1e-9)


def test_a_static_state_is_one_of_its_time():
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], FLYING, elements=2)
    scene.clamp(beam.start)
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


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.Newmark()], ids=lambda s: s.name)
@pytest.mark.parametrize("dt", [1e-3, 1e-6])
def test_nodes_held_where_they_were_moved_to_do_not_accelerate(dt, scheme):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], MEMBER, elements=4)
    scene.clamp(beam.start)
    scene.prescribe(beam.end, x=lambda t: -0.05, y=lambda t: 0.07)
    motion = fb.simulate(scene, scheme, dt=dt, t_end=4 * dt, start=fb.static(scene))
    assert not motion.acceleration(beam.end).any()
    assert not motion.velocity(beam.end).any()
    assert abs(motion.a).max() < 1e-7


@pytest.mark.parametrize("dt", [1e-2, 1e-3, 1e-4])
def test_nodes_that_are_moved_on_have_their_acceleration(dt):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], MEMBER, elements=4)
    scene.clamp(beam.start)
    scene.prescribe(beam.end, y=lambda t: 0.07 + 0.01 * t**2 - 0.02 * np.sin(2 * t))
    motion = fb.simulate(scene, dt=dt, t_end=2 * dt, start=fb.static(scene))
    assert motion.velocity(beam.end)[0] == pytest.approx([0, -0.04], abs=1e-8)
    # Along x what the equilibrium leaves by rounding: 1e-11 m/s^2.
    assert motion.acceleration(beam.end)[0] == pytest.approx([0, 0.02], rel=0.01, abs=1e-8)


# -- Wrong starts ----------------------------------------------------------------------------------


def test_wrong_starts_are_refused_by_name():
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


def bent_pair(kind, **axis):
    scene = fb.Scene(gravity=(0, -9.81))
    left = scene.add_beam([(0, 0), (1, 0)], MEMBER, elements=4)
    right = scene.add_beam([(1, 0), (1.8, 0.5)], MEMBER, elements=4)
    scene.clamp(left.start)
    scene.pin(right.end)
    scene.add_joint(kind(left.end, right.start, **axis))
    return scene


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
@pytest.mark.parametrize("solver", ["compiled", "petsc"])
def test_a_run_that_broke_off_goes_on_from_its_last_step(solver):
    scene, _ = pinned_beam(4)
    scene.add_force(scene.beams[0].end, lambda t: (0.0, 0.0) if t < 0.07 else 1 / 0)
    options = {"dt": 1 / 64, "t_end": 0.125, "solver": solver}
    with pytest.raises(fb.StepError) as caught:
        fb.simulate(scene, **options)
    rest = fb.simulate(pinned_beam(4)[0], start=caught.value.solution, **options)
    assert rest.t[0] == caught.value.solution.t[-1] == 1 / 16
    whole = fb.simulate(pinned_beam(4)[0], **options)
    np.testing.assert_array_equal(rest.q, whole.q[4:])


def test_a_file_without_a_last_state_is_no_start(tmp_path):
    scene, _ = pinned_beam(4)
    fb.simulate(scene, dt=0.01, t_end=0.02).save(tmp_path / "new.npz")
    with np.load(tmp_path / "new.npz") as file:
        old = {name: file[name] for name in file if not name.startswith("end_")}
    np.savez(tmp_path / "old.npz", **old)
    with pytest.raises(fb.SceneError, match="has no last state"):
        fb.simulate(scene, dt=0.01, t_end=0.1, start=fb.load(tmp_path / "old.npz"))
