"""Motions of scenes that differ in numbers only give what each gives by itself, to the digit."""

import ufl

import numpy as np
import pytest
from scenes import assert_refused, pinned_bar

import fx_beam as fb
from fx_beam.scene.structure import OtherStructureError

STEPS = {"dt": 0.01, "t_end": 0.1}
NUMBERS = [(1.0, 1.0), (1.2, 0.7), (0.9, 1.3)]
QUANTITIES = ["position", "displacement", "rotation", "velocity", "spin"]


def bar(x, velocity, spin=0.0, EA=1e3):
    """A bar of 40 elements that is held at its start."""
    section = fb.Section(EA=EA, GA=1e3 * x[0], EI=x[0], rhoA=1.0, rhoI=1e-3)
    scene, beam = pinned_bar((2, 1), section, elements=40, gravity=(0, -9.81))
    scene.set_velocity(beam, velocity, spin=spin)
    scene.make_velocities_compatible()
    return scene, beam


def check(build, quantities=QUANTITIES, **how):
    """Outputs of a `Response` are those of `simulate`; gives the last statistics."""

    def with_outputs(x):
        scene, beam = build(x)
        outputs = {name: fb.Output(name, beam.end) for name in quantities}
        return scene, outputs | {"rise": fb.Output("position", beam.node(0.5), "y")}

    run = fb.Response(with_outputs, **(STEPS | how))
    for x in NUMBERS:
        t, y = run(x)
        scene, beam = build(x)
        solution = fb.simulate(scene, **(STEPS | how))
        assert np.array_equal(t, solution.t)
        for name in quantities:
            assert np.array_equal(y[name], getattr(solution, name)(beam.end)), name
        assert np.array_equal(y["rise"], solution.position(beam.node(0.5))[:, 1])
    assert run.stats.setup_reason == ""
    counts = "steps", "substeps", "halvings", "newton_iterations", "ended_by"
    for name in counts:
        assert getattr(run.stats, name) == getattr(solution.stats, name), name
    return run.stats


def reduces(x, y):
    """Takes arrays, and gives something else for them."""
    return 0.0, np.linalg.norm((x, y))


def counts(x, y):
    """A load with a number for each place."""
    return 0.0, float(np.size(x))


def branches(x, y):
    return (0.0, x) if x < 1 else (y, 1.0)


def plain(x, y):
    return 0.1 * y**2, np.where(x > 1, x, abs(x - 2) / 3)


@pytest.mark.parametrize(
    "velocity", [reduces, counts, branches, plain], ids=lambda own: own.__name__
)
def test_functions_of_place_give_what_they_give_one_by_one(velocity):
    def build(x):
        return bar(x, lambda px, py: np.multiply(x[1], velocity(px, py)), lambda px, py: x[1] * px)

    check(build)


@pytest.mark.parametrize("EA", [lambda f: 1e3 + 2e2 * f, lambda f: 1e3 if f < 0.5 else 2e3])
def test_tapers_give_what_they_give_one_by_one(EA):
    check(lambda x: bar(x, (0.0, x[1]), EA=lambda f: x[0] * EA(f)))


def test_functions_that_take_arrays_are_called_once_for_all_places():
    sizes = []

    def build(x):
        def velocity(px, py):
            sizes.append(np.size(px))
            return 0.0, x[1] * px

        scene, beam = bar(x, velocity)
        return scene, {"end": fb.Output("position", beam.end)}

    run = fb.Response(build, **STEPS)
    run(NUMBERS[0]), run(NUMBERS[1])
    sizes.clear()
    run(NUMBERS[2])
    assert sizes.count(41) == 1  # and some by themselves: to be checked, and to be compared
    assert len(sizes) < 10


def test_a_velocity_that_is_not_finite_somewhere_is_named():
    def build(x):
        scene, beam = bar(x, lambda px, py: (0.0, 1 / (px - 1) if x[1] < 1 else px))
        return scene, {"end": fb.Output("position", beam.end)}

    run = fb.Response(build, **STEPS)
    run((1.0, 1.0)), run((1.0, 1.1))
    assert_refused(r"velocity of .* raised ZeroDivisionError", run, (1.0, 0.5))
    assert np.isfinite(run((1.0, 1.2))[1]["end"]).all()


def test_outputs_stay_what_they_are_in_the_next_motions():
    def build(x):
        scene, beam = bar(x, (0.0, 1.0))
        outputs = {
            f"{name}, {axis}": fb.Output(name, beam.end, axis) for name in parts for axis in "xy"
        }
        return scene, outputs | {name: fb.Output(name, beam.end) for name in QUANTITIES}

    parts = "position", "displacement", "velocity"
    run = fb.Response(build, **STEPS)
    motions = [run(x)[1] for x in NUMBERS]
    for x, y in zip(NUMBERS, motions, strict=True):
        again = run(x)[1]
        assert all(np.array_equal(y[name], again[name]) for name in y)


def test_steps_that_fail_are_halved_as_in_a_motion_by_itself():
    """The first motion needs no halved steps; the others do."""
    force = dict(zip(NUMBERS, (10.0, 1e4, 1.1e4), strict=True))

    def build(x):
        scene, beam = bar((1.0, 1.0), (0.0, 0.0))
        scene.add_force(beam.end, (0.0, force[tuple(x)]))
        return scene, beam

    assert check(build, ["position"]).halvings > 0


def test_a_motion_whose_nodes_are_elsewhere_is_found_there():
    def longer(x):
        section = fb.Section(EA=1e3, GA=1e3, EI=1.0, rhoA=1.0, rhoI=1e-3)
        return pinned_bar((x[0], x[1]), section, elements=4, gravity=(0, -9.81))

    check(longer)


def test_a_motion_that_fails_costs_only_itself():
    def build(x):
        load = np.nan if x[1] > 1.2 else x[1]
        scene, beam = bar(x, (0.0, 0.0))
        scene.add_force(beam.end, lambda t: (0.0, load if t > 0.05 else 0.0))
        return scene, {"end": fb.Output("position", beam.end)}

    run = fb.Response(build, **STEPS)
    first = [run(x)[1]["end"] for x in NUMBERS[:2]]
    with pytest.raises(fb.StepError, match="which is not finite") as failure:
        run(NUMBERS[2])
    assert 0.04 < failure.value.solution.t[-1] < 0.06
    for x, end in zip(NUMBERS, first, strict=False):
        assert np.array_equal(run(x)[1]["end"], end)


def four_bars(x):
    """A closed loop of bodies: a derivative by its shape leaves another set-up behind."""
    scene = fb.Scene(gravity=(0, -9.81))
    corners = [(0, 0), (0.2, 1), (1.5 * x[0], 1.2), (1.5 * x[0], 0)]
    ends = fb.GROUND
    for a, b, mass in zip(corners[:-1], corners[1:], (1.0, x[1], 1.0), strict=True):
        body = scene.add_body(np.add(a, b) / 2, mass, 0.1 * mass, points={"a": a, "b": b})
        scene.add_joint(fb.Revolute(ends, body["a"]))
        ends = body["b"]
    scene.add_joint(fb.Revolute(ends, fb.GROUND))
    return scene, {"rate": fb.Output("velocity", scene.bodies[1]["b"])}


def test_a_motion_after_a_derivative_is_the_same_as_by_itself():
    run = fb.Response(four_bars, **STEPS)
    for x in ([1.0, 2.0], [1.0, 2.1]):
        _, y = run(x)
    run.vjp({"rate": np.ones_like(y["rate"])})
    x = [1.0, 9.0]
    scene, outputs = four_bars(x)
    expected = fb.simulate(scene, **STEPS).velocity(outputs["rate"].of)
    assert np.array_equal(run(x)[1]["rate"], expected)


def test_what_is_not_finite_in_one_motion_is_gone_in_the_next():
    """Also between the unknowns of a node with supports, which are no whole group of three."""
    spring = fb.Spring(1.0, rest=1.0, strain_energy=lambda x: x**2 - ufl.ln(0.5 - x))

    def end(speed):
        scene = fb.Scene()
        nodes = [scene.add_body((x, 0), mass=1.0, inertia=0.1).centre for x in (0, 1)]
        scene.fix(nodes[0], "y", "rotation")
        scene.add_force_between(*nodes, spring=spring)
        scene.set_velocity(nodes[1], (speed, 0.0))
        return fb.simulate(scene, dt=0.01, t_end=0.1).position(nodes[1])[-1]

    before = end(0.1)
    assert_refused("not finite", end, 1e3, error=fb.StepError)
    assert np.array_equal(end(0.1), before)


def test_an_error_in_a_scene_of_another_structure_has_no_other_cause():
    """The last structure, which this scene does not have, is no news for its user."""
    scene, _ = bar((1.0, 1.0), (0, 1.0))
    fb.simulate(scene, **STEPS)
    scene, _ = bar((1.0, 1.0), (0, 1.0))
    scene.add_virtual_work(lambda step: ufl.dot(step.v, step.v))
    with pytest.raises(fb.SceneError, match="linear") as caught:
        fb.simulate(scene, **STEPS)
    assert not isinstance(caught.value.__context__, OtherStructureError)
