"""Differences of `build`: what is read for each number, and how often."""

import math
import re

import numpy as np
import pytest
from derivatives import difference
from scenes import clamped_bar, held_body, one_bar, one_body, pinned_bar

import fx_beam as fb
from fx_beam.dual import dual_array, slopes_by

STEPS, TIMES = 40, np.linspace(0, 1, 5)
X = np.array([0.3, -0.2, 0.5, 0.1, -0.4])


def _response(force):
    """A bar on a driven hinge with a force over time, and how often `build` was called."""
    calls = []

    def build(x):
        calls.append(x)
        section = fb.Section(EA=1e3, GA=1e3, EI=1.0, rhoA=1.0, rhoI=1e-3)
        scene, bar = one_bar((1, 0), section, elements=1)
        scene.add_joint(fb.Revolute(fb.GROUND, bar.start, motor=lambda t: 0.0))
        scene.add_force(bar.end, lambda t: force(t, x))
        return scene, {"end": fb.Output("position", bar.end)}

    return fb.Response(build, dt=1 / STEPS, t_end=1.0), calls


def _gradient(run):
    t, _ = run(X)
    return run.vjp({"end": np.column_stack([np.cos(t), np.sin(t)])})


def profile(t, x):
    return x @ [0, 0, 0, 0, 1], np.interp(t, TIMES, x)


def bent(t, x):
    return x[4] ** 3, np.interp(t, TIMES, np.sin(x))


def test_only_numbers_that_functions_take_as_floats_are_differenced():
    floated = lambda t, x: (float(x[4]), np.interp(t, TIMES, x))  # noqa: E731
    for force, more in ((profile, 0), (bent, 0), (floated, 2)):
        run, calls = _response(force)
        _gradient(run)
        calls.clear()
        _gradient(run)
        # The scene with slopes, which without `of_one` serves the motion.
        assert len(calls) == (2 + more if more else 1)
        assert ("x[4]: float()" in run.stats.difference_reason) == bool(more)


def test_a_scene_with_slopes_serves_its_analysis():
    """Where functions along a beam, or follower forces over time, have slopes as well."""
    calls = []

    def scene_of(x):
        calls.append(x)
        section = fb.Section(EA=lambda f: 1e3 * (1 + f * x[0]), GA=1e3, EI=1.0, rhoA=1.0, rhoI=1e-3)
        scene, bar = clamped_bar((1, 0), section, elements=1)
        scene.add_force(bar.end, lambda t: (x[1] * t, x[2]), follower=True)
        return scene, {"end": fb.Output("position", bar.end)}

    for run in (
        fb.Response(scene_of, dt=0.01, t_end=0.1),
        fb.ModalResponse(lambda x: scene_of(x)[0], n=2),
    ):
        for _ in range(2):
            calls.clear()
            y = run(X)
            run.vjp({"end": np.ones_like(y[1]["end"])} if isinstance(y, tuple) else np.ones(2))
        assert len(calls) == 1


def _arms(x):
    """Two arms with a spring in their joint, and a follower force."""
    section = fb.Section(EA=1e4 * x[0], GA=1e4, EI=10.0, rhoA=lambda f: x[0] * (1 + f), rhoI=1e-3)
    scene, first = pinned_bar((1, 0.1 * x[1]), section, elements=2, gravity=(0, -9.81 * x[1]))
    second = scene.add_beam([(1, 0.1 * x[1]), (2, 0)], section, elements=2)
    spring = fb.Spring(5 * x[0], rest=0.3 * x[1])
    joint = scene.add_joint(fb.Revolute(first.end, second.start, spring=spring))
    scene.add_force(second.end, lambda t: (x[0] * (1 + t), x[1]), follower=True)
    return scene, first, second.end, joint


def _light(x):
    """Two arms without rotary inertia, whose material is viscous."""
    data = {"EA": 1e4 * x[0], "GA": 1e4, "EI": 10.0 * x[0], "rhoA": x[1], "retardation": 0.01}
    scene, first = pinned_bar((1, 0.1 * x[0]), fb.Section(**data), elements=3, gravity=(0, -9.81))
    second = scene.add_beam([(1, 0.1 * x[0]), (2, 0)], fb.Section(**data), elements=2)
    joint = scene.add_joint(fb.Revolute(first.end, second.start, damper=fb.Damper(x[0])))
    return scene, first, second.end, joint


@pytest.mark.parametrize("build", [_arms, _light])
def test_accelerations_at_the_start_have_slopes(build):
    """From rest, by a short step of the same scene: a call with its gradient builds one."""
    calls, x = [], np.array([1.1, 0.9])

    def outputs(x):
        calls.append(x)
        scene, beam, node, joint = build(x)
        places = {"acceleration": node, "force": joint, "reaction": beam.start}
        return scene, {name: fb.Output(name, place) for name, place in places.items()}

    run = fb.Response(outputs, dt=0.01, t_end=0.05)
    for _ in range(2):
        calls.clear()
        _, y = run(x)
        gradient = run.vjp({name: np.ones_like(rows) for name, rows in y.items()})
    assert len(calls) == 1 and run.stats.difference_reason == ""
    J = run.jacobian()
    assert gradient == pytest.approx(sum(rows.sum(axis=(0, 1)) for rows in J.values()), rel=1e-10)
    for i, unit in enumerate(np.eye(2)):
        expected = difference(lambda h, u=unit: run(x + h * u)[1]["acceleration"][0], 1e-3)
        assert J["acceleration"][0, :, i] == pytest.approx(expected, rel=1e-7, abs=1e-7)


def test_functions_of_the_solution_stay_out_of_the_step_that_tells_accelerations():
    """A function that needs the third row, beside an output that has slopes at the start."""

    def outputs(x):
        scene, beam, node, _ = _arms(x)
        late = lambda solution: solution.position(node)[3]  # noqa: E731
        return scene, {"reaction": fb.Output("reaction", beam.start), "late": late}

    def without_late(x):
        scene, outputs_of_scene = outputs(x)
        return scene, {"reaction": outputs_of_scene["reaction"]}

    run, alone = (fb.Response(build, dt=0.01, t_end=0.05) for build in (outputs, without_late))
    _, y = run([1.1, 0.9])
    weights = {"reaction": np.ones_like(y["reaction"])}
    assert y["late"].shape == (2,)
    gradient = run.vjp(weights)
    alone([1.1, 0.9])
    assert gradient == pytest.approx(alone.vjp(weights), rel=1e-12)


@pytest.mark.parametrize("make", [fb.Response, fb.StaticResponse])
def test_slopes_of_the_weight_are_those_of_the_scene_beside_differences(make):
    """They are read after the scenes of the differences, whose gravity is another."""

    def build(x, taken):
        section = fb.Section(EA=1e3, GA=1e3, EI=1.0, rhoA=x[1], rhoI=1e-3)
        scene, bar = clamped_bar((1, 0), section, elements=1, gravity=(0, -taken(x[0])))
        scene.add_mass(bar.end, x[2])
        return scene, {"end": fb.Output("position", bar.end)}

    options = {"load_steps": 2} if make is fb.StaticResponse else {"dt": 0.01, "t_end": 0.1}
    gradients = []
    for taken in (float, lambda x: x):
        run = make(lambda x, taken=taken: build(x, taken), **options)
        for x in ([0.8, 0.3, 0.2], [0.9, 0.3, 0.2]):  # slopes are checked at the first
            _, y = run(x)
            by_x = run.vjp({"end": np.ones_like(y["end"])})
        gradients.append(by_x)
        jacobian = run.jacobian()["end"].sum(axis=(0, 1))
        assert jacobian == pytest.approx(gradients[-1], rel=1e-10)
    assert gradients[0] == pytest.approx(gradients[1], rel=1e-9)


def test_accelerations_of_loads_that_begin_at_zero_have_slopes():
    """They are zero at the start for all numbers."""

    def build(x):
        scene, body = held_body((0, 0), x[0], 0.1)
        scene.add_force(body, lambda t: (x[1] * np.sin(3 * t), 0.0))
        return scene, {"acceleration": fb.Output("acceleration", body, "x")}

    run = fb.Response(build, dt=0.01, t_end=0.05)
    _, y = run([2.0, 1.5])
    J = run.jacobian()["acceleration"]
    assert run.stats.difference_reason == ""
    expected = np.outer(y["acceleration"], [-1 / 2.0, 1 / 1.5])
    assert J == pytest.approx(expected, rel=1e-10, abs=1e-12)


def test_parts_without_mass_that_a_damper_holds_keep_their_slopes(caplog):
    """At the start the hinge of two beams without rotary inertia turns by their round-off."""

    def build(x):
        section = fb.Section(EA=1e4, GA=5e3, EI=30.0 * x[0], rhoA=1.0)
        scene, upper = pinned_bar((1, 0), section, elements=2, gravity=(0, -9.81))
        lower = scene.add_beam([(1, 0), (1.5, 0)], section, elements=2)
        scene.add_joint(fb.Revolute(upper.end, lower.start, damper=fb.Damper(0.3 * x[1])))
        scene.set_velocity(upper, lambda X, Y: (-2 * Y, 2 * X), spin=2.0)
        scene.set_velocity(lower, lambda X, Y: (-5 * Y, 5 * X - 3), spin=5.0)
        places = {"acceleration": upper.end, "rotation": lower.start}
        return scene, {name: fb.Output(name, node) for name, node in places.items()}

    run = fb.Response(build, dt=0.01, t_end=0.05)
    run([1.0, 1.0])
    J = run.jacobian()
    assert "'q'" not in run.stats.difference_reason and not caplog.records
    assert not J["rotation"][0].any()


def test_velocities_of_bodies_have_slopes_by_their_places():
    """Velocities of its points are (x - 2 y, 2 x) from the centre, whose velocity is (X, 0)."""

    def build(x):
        scene, body = one_body((x[0], 0), 1.0, 0.1, points={"end": (3, x[1])})
        scene.set_velocity(body, lambda X, Y: (X, 0.0), spin=2.0)
        return scene, {"velocity": fb.Output("velocity", body["end"])}

    run = fb.Response(build, dt=0.01, t_end=0.05)
    run([1.0, 1.0])
    J = run.jacobian()["velocity"][0]
    assert run.stats.difference_reason == ""
    assert J == pytest.approx(np.array([[1.0, -2.0], [-2.0, 0.0]]), abs=1e-12)


def test_velocities_that_are_projected_beside_a_driven_node_have_slopes():
    """The start of an element is pulled along, its end answers by half of that."""

    def build(x):
        section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=x[0], rhoI=0.1)
        scene, bar = one_bar((1, 0), section, elements=1)
        scene.prescribe(bar.start, x=lambda t: x[1] * t, y=0.0)
        scene.set_velocity(bar, (x[2], 0.0))
        scene.make_velocities_compatible()
        return scene, {"end": fb.Output("velocity", bar.end, "x")}

    run = fb.Response(build, dt=0.01, t_end=0.02)
    _, y = run([1.0, 2.0, 3.0])
    assert y["end"][0] == pytest.approx(3.0 - (2.0 - 3.0) / 2)
    assert run.jacobian()["end"][0] == pytest.approx([0.0, -0.5, 1.5], abs=1e-9)
    assert run.stats.difference_reason == ""


def test_slopes_are_those_of_functions():
    """Against differences that are extrapolated twice."""
    x, A, t = np.array([0.3, 0.7, 1.2]), np.arange(6.0).reshape(2, 3), np.linspace(0, 1, 30)
    functions = [
        lambda x: A @ x + np.hypot(x[0], x[1:]) * np.linalg.norm(x) / np.max(x),
        lambda x: np.interp(t * x[0], np.cumsum(x) / 3, x ** x[0]) * np.where(t > 0.5, x[1], t),
        lambda x: np.hstack([np.exp(-x) / x, np.arctan2(x, 2.0), np.linspace(x[0], x[2], 3)]),
        lambda x: np.stack([x, np.tanh(x), [1.0, x[0], 2.0]], axis=-1).T @ np.array([x[0], 0, 1]),
        lambda x: np.interp(3 * t - 1, [0.0, 1.0, 1.0, 1.5], x[[0, 1, 2, 0]] ** 2),
        lambda x: np.interp(t, [0.5], x[:1] ** 2) + np.interp(0.3, [0.5], x[:1]),
    ]
    for function in functions:
        steps = [(h, h * row) for h in (4e-3, 2e-3, 1e-3) for row in np.eye(3)]
        ends = [(function(x + e) - function(x - e)) / (2 * h) for h, e in steps]
        expected = np.tensordot([1 / 45, -20 / 45, 64 / 45], np.reshape(ends, (3, 3, -1)), 1)
        assert dual_array(function(slopes_by(x))).slopes.T == pytest.approx(expected, abs=2e-12)


def _pulse(t, x):
    """A function that takes an array of times, but for a single time."""
    return (x[0] if np.any(t > 0.9) else 0.0), np.interp(t, TIMES, x)


def test_functions_that_give_other_values_for_arrays_are_called_one_by_one():
    def alone(t, x):
        return _pulse(float(t), x)

    computed, known = (_gradient(_response(own)[0]) for own in (_pulse, alone))
    assert computed == pytest.approx(known, rel=1e-11, abs=1e-13)


@pytest.mark.parametrize(
    "function", [np.nan_to_num, lambda a: (1j * a * -1j).real, lambda a: np.logaddexp(a, 1.0)]
)
def test_what_has_no_slopes_has_differences_for_its_numbers_alone(function):
    def build(x):
        scene, body = one_body((0, 0), mass=1.0, inertia=1.0)
        scene.add_force(body.centre, (function(x[0]), x[1] ** 2))
        scene.add_drag(body.centre, linear=x[2])
        return scene, {"speed": fb.Output("velocity", body.centre)}

    run = fb.Response(build, dt=0.1, t_end=0.2)
    run([0.3, 0.4, 0.5])
    run.jacobian()
    assert re.findall(r"x\[\d\]", run.stats.difference_reason) == ["x[0]"]


def test_a_load_that_jumps_between_steps_has_exact_derivatives():
    """By its values before and after: they count in steps on one side each, despite round-off."""
    for steps in range(101, 1000, 37):
        jump = np.linspace(0, 1, steps + 1)[2 * steps // 3]

        def build(x, jump=jump):
            scene, body = one_body((0, 0), mass=1.0, inertia=1.0)
            scene.add_force(body.centre, lambda t: (x[0] if t < jump else x[1], 0.0))
            return scene, {"speed": fb.Output("velocity", body.centre, "x")}

        run = fb.Response(build, dt=1 / steps, t_end=1.0)
        for _ in range(2):  # then by the scene of the motion
            run([1.0, 2.0])
            J = run.jacobian()["speed"][-1]
            assert J == pytest.approx([jump, 1 - jump], abs=1e-9)


STRAINS = {
    "strain": lambda scene, beam, x: scene.add_natural_strain(
        beam, curvature=x[0], axial=lambda t: 0.01 * x[1] * t
    ),
    "strain along the beam": lambda scene, beam, x: scene.add_natural_strain(
        beam, curvature=lambda f: x[0] * f * x[1]
    ),
    "strain in time along the beam": lambda scene, beam, x: scene.add_natural_strain(
        beam, curvature=lambda f, t: x[0] * f * (1 + t * x[1])
    ),
}


@pytest.mark.parametrize("start", [None, lambda scene: fb.static(scene, load_steps=2)])
@pytest.mark.parametrize("strain", STRAINS)
def test_natural_strains_that_damp_have_slopes_and_serve_the_motion_as_well(strain, start):
    """Of place and time, also at the start, on which a viscous section depends."""
    options = {"dt": 0.01, "t_end": 0.1, "start": start}

    def build(x):
        data = {"rhoA": 1.0, "rhoI": 0.01, "retardation": 0.01}
        section = fb.Section(EA=1e4, GA=1e4, EI=100.0, **data)
        scene, beam = clamped_bar((1, 0), section, elements=3, gravity=(0, -9.81))
        STRAINS[strain](scene, beam, x)
        return scene, {"tip": fb.Output("position", beam.end)}

    def sum_at(x):
        return (weights["tip"] * floats(x)[1]["tip"]).sum()

    run, floats = (fb.Response(build, **options) for _ in range(2))
    x, h = np.array([1.1, 0.9]), 1e-3
    _, y = run(x)
    weights = {"tip": np.arange(y["tip"].size, dtype=float).reshape(y["tip"].shape)}
    first = run.vjp(weights)
    assert run.stats.difference_reason == ""
    # With slopes from here on.
    assert (run(x)[1]["tip"] == y["tip"]).all()
    ends = [[sum_at(x + k * h * row) for k in (-2, -1, 1, 2)] for row in np.eye(2)]
    expected = np.array(ends) @ [1, -8, 8, -1] / (12 * h)
    for gradient in (first, run.vjp(weights)):
        assert gradient == pytest.approx(expected, rel=1e-6, abs=1e-9)


def test_accelerations_at_the_start_of_a_motion_have_slopes_beside_much_larger_ones():
    """A body that drag slows down, beside a light one that is pushed."""

    def build(x):
        scene, light = one_body((0, 0), mass=1e-3, inertia=1e-3)
        scene.add_force(light.centre, (20.0, 0.0))
        body = scene.add_body((1, 0), mass=1.0, inertia=1.0)
        scene.set_velocity(body, (1.0, 0.0))
        scene.add_drag(body.centre, linear=x[0])
        return scene, {"a": fb.Output("acceleration", body.centre)}

    run = fb.Response(build, dt=1e-3, t_end=2e-3)
    _, y = run([1.0])
    assert y["a"][0] == pytest.approx([-1.0, 0.0], abs=1e-9)
    assert run.jacobian()["a"][0, :, 0] == pytest.approx([-1.0, 0.0], abs=1e-6)


@pytest.mark.parametrize(
    "force",
    [
        lambda x: np.diff(x, 2)[0],
        lambda x: np.linalg.norm(x, 1),
        lambda x: (np.diag(x) @ np.ones(3))[0],
        lambda x: (x[0] * np.exp(1j * np.float64(1.0))).real,
    ],
)
def test_functions_with_other_arguments_give_what_they_give_of_floats(force):
    def build(x):
        scene, body = one_body((0, 0), mass=1.0, inertia=1.0)
        scene.add_force(body.centre, (force(x), 0.0))
        return scene, {"x": fb.Output("position", body.centre, "x")}

    run, x = fb.Response(build, dt=0.1, t_end=1.0), np.array([1.1, 0.9, 1.3])
    first = run(x)[1]["x"]
    slopes = run.jacobian()["x"][-1]
    assert np.array_equal(run(x)[1]["x"], first)
    expected = [(force(x + h) - force(x - h)) / 2e-4 / 2 for h in 1e-4 * np.eye(3)]  # x = f t^2 / 2
    assert slopes == pytest.approx(expected, abs=1e-9)


def test_the_loss_of_slopes_that_are_zero_at_first_is_seen_later():
    """A length by a force that takes floats alone, of a place on a line of symmetry."""

    def build(x):
        scene, body = one_body((1, x[0]), mass=1.0, inertia=1.0)
        rest = 0.5 * math.hypot(body.centre.x, body.centre.y)
        scene.add_force_between(body.centre, (0.0, 0.0), spring=fb.Spring(50.0, rest=rest))
        return scene, {"place": fb.Output("position", body.centre)}

    gradients = []
    for first in (0.0, 0.3):
        run = fb.Response(build, dt=0.01, t_end=0.1)
        for x in (first, 0.3):
            run([x])
            J = run.jacobian()["place"][-1, :, 0]
        gradients.append(J)
    assert gradients[0] == pytest.approx(gradients[1], rel=1e-8)


def test_another_count_of_parameters_has_derivatives_as_well():
    def build(x):
        scene, body = one_body((0, 0), mass=1.0, inertia=1.0)
        scene.add_force(body.centre, (sum(x), 0.0))
        return scene, {"place": fb.Output("position", body.centre)}

    run = fb.Response(build, dt=0.1, t_end=0.2)
    for x in ([0.0, 1.0], [1.0, 2.0, 3.0]):
        run(x)
        assert run.jacobian()["place"][-1, 0] == pytest.approx([0.02] * len(x))  # f t^2 / 2
