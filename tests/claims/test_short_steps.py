"""Accelerations and forces have their digits in steps of any length, also of joints with arms."""

import numpy as np
import pytest
from jointed import CORNERS, chain
from scenes import held_body, hinged_body

import fx_beam as fb

SECTION = fb.Section(EA=1e3, GA=1e3, EI=10.0, rhoA=2.0, rhoI=0.1)


def bodies(scene, joint=fb.Revolute):
    """Two bodies in a chain, the second of which may slide."""
    first = scene.add_body((0.5, 0.1), 2.0, 0.3, points={"pin": (0, 0), "end": (1, 0)})
    second = scene.add_body((1.5, 0.1), 1.0, 0.1, points={"start": (1, 0)})
    scene.pin(first["pin"])
    return second.centre, scene.add_joint(joint(first["end"], second["start"]))


def sliding(scene):
    return bodies(scene, lambda a, b: fb.Prismatic(a, b, axis=(1, 0.2)))


def loop(scene):
    """Four bars, one of which is the ground."""
    bars = chain(scene, CORNERS)
    scene.pin(bars[0]["a"])
    scene.pin(bars[-1]["b"])
    return bars[1].centre, scene.joints[0]


def tree(scene):
    """A chain of bodies that is long enough for auxiliary unknowns."""
    points = [{"start": (i, 0), "end": (i + 1, 0)} for i in range(30)]
    links = [scene.add_body((i + 0.6, 0.2), 1.0, 0.3, points=ends) for i, ends in enumerate(points)]
    joints = [fb.Revolute(a["end"], b["start"]) for a, b in zip(links, links[1:], strict=False)]
    scene.pin(links[0]["start"])
    return links[-1].centre, [scene.add_joint(joint) for joint in joints][0]


def rail(scene):
    """A mast whose foot slides on a beam."""
    beam = scene.add_beam([(0, 0), (1, 0.3), (2, 0)], SECTION, elements=6)
    mast = scene.add_beam([(0.5, 0.15), (0.5, 1.0)], SECTION, elements=2)
    scene.pin(beam.start)
    return mast.end, scene.add_joint(fb.Slider(beam, mast.start))


@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.EnergyMomentum(order=4), fb.Newmark()])
@pytest.mark.parametrize("build", [bodies, sliding, loop, tree, rail])
def test_accelerations_and_forces_have_no_noise_in_very_short_steps(build, scheme):
    scene = fb.Scene(gravity=(0, -9.81))
    node, joint = build(scene)
    solution = fb.simulate(scene, scheme, dt=1e-8, t_end=4e-7)
    for rows in (solution.a[:, node.number], solution.joint(joint).force):
        # The motion from rest is even in time: in such steps all but its constant part is none.
        noise = abs(np.diff(rows[6:], 3, axis=0)).max()
        assert noise < 1e-7 * abs(rows[6:]).max()


@pytest.mark.parametrize("build", [bodies, loop])
def test_energy_is_balanced_to_round_off_in_short_steps(build):
    scene = fb.Scene(gravity=(0, -9.81))
    build(scene)
    swung = fb.simulate(scene, dt=1e-3, t_end=0.3)
    solution = fb.simulate(scene, dt=1e-6, t_end=0.301, start=swung)
    assert abs(solution.energy.balance_error).max() < 1e-12


def test_short_steps_late_in_time_are_as_many_as_asked_for_or_refused():
    """A remainder that is a rounding error of the times is no step: it may have no length."""
    scene = fb.Scene()
    node, _ = bodies(scene, lambda a, b: fb.Revolute(a, b, spring=fb.Spring(10.0)))
    scene.prescribe(node, rotation=lambda t: np.sin(t) - np.sin(1000.0) * t / 1000.0)
    held = fb.static(scene, t=1000.0)
    scene.make_velocities_compatible()
    solution = fb.simulate(scene, dt=1e-8, t_end=1000.0 + 20e-8, start=held)
    assert len(solution.t) == 21
    assert np.isfinite(solution.v).all()
    with pytest.raises(fb.SceneError, match="dt = 1e-12 must be larger, as times near t = 1000"):
        fb.simulate(scene, dt=1e-12, t_end=1000.0 + 20e-12, start=held)


@pytest.mark.parametrize("dt", [1e-3, 1e-5])
def test_a_driven_node_starts_with_its_acceleration(dt):
    """From steps of 10 microseconds it was wrong by a hundredth, of one by a multiple of itself."""
    scene, node = held_body((0, 0), 1.0, 0.1)
    scene.prescribe(node, x=lambda t: 0.1 * np.cos(3 * t) - 0.1)
    start = fb.simulate(scene, dt=dt, t_end=2 * dt).acceleration(node)[0, 0]
    assert abs(start + 0.9) < 2e-4


@pytest.mark.parametrize("options", [{"dt": 1e-5}, {"dt": 1e-6}, {"tolerance": 1e-4}])
def test_a_smooth_motor_that_starts_at_rest_is_not_refused(options):
    """Rounding errors of its function were taken for a rate in steps of 10 microseconds."""
    for frequency in np.linspace(1.0, 10.0, 7):
        motor = lambda t, w=frequency: 1 - np.cos(w * t)  # noqa: E731
        scene, bar, _ = hinged_body((0.5, 0), 2.0, 0.3, {"pin": (0, 0)}, motor=motor)
        solution = fb.simulate(scene, t_end=2 * options.get("dt", 5e-4), **options)
        assert abs(solution.velocity(bar.centre)[0]).max() < 1e-8


@pytest.mark.parametrize("dt", [1e-3, 1e-4])
def test_the_first_acceleration_of_a_driven_node_has_derivatives(dt):
    """They were wrong by a sixth in steps of 0.1 ms."""

    def build(x):
        scene, node = held_body((0, 0), 1.0, 0.1)
        scene.prescribe(node, x=lambda t: x[0] * (1 - np.cos(x[1] * t)))
        return scene, {"a": fb.Output("acceleration", node, "x")}

    run = fb.Response(build, dt=dt, t_end=2 * dt)
    run([0.3, 3.0])
    assert run.jacobian()["a"][0] == pytest.approx([9.0, 1.8], rel=1e-2)
