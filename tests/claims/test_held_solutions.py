"""Solutions that are kept, and read when others of their program have run, to the digit."""

import numpy as np
import pytest
from scenes import pinned_bar

import fx_beam as fb


def all_that_is_read(solution):
    """Arrays of a solution by name, above all what is computed when it is read."""
    arrays = {name: solution.recorded(name) for name in ("q", "v", "a", "joint_forces")}
    arrays |= {"reactions": solution.reactions, "energy": solution.energy.total}
    for name in solution.beams:
        resultants = solution.resultants(name)
        arrays |= {f"{name} {part}": getattr(resultants, part) for part in "NQM"}
        try:
            ends = resultants.ends
        except ValueError:  # loads of which no history is known
            continue
        arrays |= {f"{name} {part} at ends": getattr(ends, part) for part in "NQM"}
    return arrays


def bar(EI, elements=4, load=None):
    """A heavy bar that swings on a spring, both of which are the stiffer the larger EI is."""
    section = fb.Section(EA=1e4, GA=1e4, EI=EI, rhoA=1.0, rhoI=0.1)
    scene, beam = pinned_bar((2, 1), section, elements=elements, gravity=(0.0, -9.81))
    scene.add_spring(beam.end, y=fb.Spring(EI))
    if load is not None:
        scene.add_moment(beam.end, load)
    return scene


def motion(EI, **options):
    return fb.simulate(bar(EI, **options), dt=0.01, t_end=0.1)


def test_a_load_may_read_an_earlier_solution_of_its_own_program():
    """In the middle of steps with other numbers."""
    earlier = motion(10.0, load=lambda t: t)
    moment = motion(10.0, load=lambda t: t).resultants("beam 1").M[-1, 0]
    read = []

    def load(t):
        if t > 0.05 and not read:
            read.append(earlier.resultants("beam 1").M[-1, 0])
        return 2 * t

    disturbed = fb.simulate(bar(12.0, load=load), dt=0.01, t_end=0.1, tolerance=1e-4)
    expected = fb.simulate(bar(12.0, load=lambda t: 2 * t), dt=0.01, t_end=0.1, tolerance=1e-4)
    assert read == [moment]
    np.testing.assert_array_equal(disturbed.q, expected.q)


def test_a_response_has_its_own_derivatives_after_a_solution_of_it_was_read():
    solutions = []

    def build(x):
        scene = bar(x[0])
        return scene, {
            "M": lambda solution: solutions.append(solution) or solution.t,
            "tip": fb.Output("position", scene.beams[0].end),
        }

    run = fb.Response(build, dt=0.01, t_end=0.1)
    run([10.0])
    run([12.0])
    tip = run.jacobian("tip")["tip"]
    run([10.0])
    run([12.0])
    for solution in solutions:
        all_that_is_read(solution)
    np.testing.assert_array_equal(run.jacobian("tip")["tip"], tip)


def column(EI, load=-4.0, height=1.0):
    """A column that buckles below its whole load, beside a spring that is under tension."""
    scene = fb.Scene()
    section = fb.Section(EA=1e4, GA=1e4, EI=EI, rhoA=height, rhoI=0.1)
    beam = scene.add_beam([(0, 0), (0, height)], section, elements=6)
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0.0, load))
    scene.add_force_between(beam.end, (0, 2), fb.Spring(0.1 * EI, 0.7))
    return scene


def all_of_a_path(solution):
    """Arrays of a path of equilibria by name, with its stability and critical points."""
    arrays = all_that_is_read(solution)
    arrays["unstable modes"] = solution.unstable_modes
    for i, point in enumerate(solution.critical_points):
        arrays[f"load {i}"], arrays[f"modes {i}"] = point.load_factor, point.modes.shapes
        arrays |= {f"point {i} {k}": x for k, x in all_that_is_read(point.solution).items()}
    return arrays


PATHS = {"load steps": {}, "arc length": {"continuation": "arc-length"}, "spin": {"spin": 0.5}}


@pytest.mark.parametrize("options", PATHS.values(), ids=PATHS)
def test_paths_that_are_kept_share_a_program_and_stay_what_they_are(options):
    numbers = (1.0, -4.0, 1.0), (1.2, -4.4, 1.1), (0.9, -3.8, 0.95)
    expected = [all_of_a_path(fb.static(column(*x), **options)) for x in numbers]
    paths = [fb.static(column(*x), **options) for x in numbers]
    assert len({id(path.load_path.model.program) for path in paths}) == 1
    assert "load 0" in expected[0]
    for path, arrays in [*zip(paths, expected, strict=True)][::-1]:
        for key, array in all_of_a_path(path).items():
            np.testing.assert_allclose(array, arrays[key], rtol=1e-9, atol=1e-9, err_msg=key)


def test_a_branch_starts_from_a_path_that_was_kept():
    paths = [fb.static(column(*x)) for x in ((1.0, -4.0, 1.0), (1.2, -5.0, 1.1))]
    (point,) = paths[0].critical_points
    fb.static(column(1.3, -5.0, 1.2))
    branch = fb.static(column(1.0), start=point.branch(1), continuation="arc-length")
    (again,) = fb.static(column(1.0)).critical_points
    alone = fb.static(column(1.0), start=again.branch(1), continuation="arc-length")
    np.testing.assert_allclose(branch.q[-1], alone.q[-1], rtol=1e-7, atol=1e-9)


def test_static_responses_have_derivatives_of_their_own_path():
    """After `build`, or anything else, has computed other paths of the same structure."""

    def build(x):
        fb.static(column(2.0, load=-1.0))
        scene = column(x[0], load=-1.0)
        return scene, {"tip": fb.Output("position", scene.beams[0].end)}

    run = fb.StaticResponse(build)
    run([1.0])
    expected = run.jacobian("tip")["tip"]
    run([1.0])
    paths = [fb.static(column(EI, load=-1.0)) for EI in (1.4, 1.5)]
    for path in paths:
        all_of_a_path(path)
    np.testing.assert_array_equal(run.jacobian("tip")["tip"], expected)
    h, tips = 1e-5, []
    for EI in (1.0 - h, 1.0 + h):
        scene = column(EI, load=-1.0)
        tips.append(fb.static(scene).position(scene.beams[0].end))
    np.testing.assert_allclose(expected[..., 0], (tips[1] - tips[0]) / (2 * h), atol=1e-7)


def test_a_motion_goes_on_after_a_solution_of_its_program_was_read():
    def stepped(*earlier):
        steps = fb.Motion(bar(12.0), dt=0.01, record=fb.Record())
        for k in range(10):
            steps.step()
            if k == 4:
                for solution in earlier:
                    all_that_is_read(solution)
        return steps.solution()

    expected = all_that_is_read(stepped())
    for start in (lambda: motion(10.0), stepped):
        disturbed = stepped(start())
        assert not disturbed.stats.setup_reason
        for key, array in all_that_is_read(disturbed).items():
            np.testing.assert_array_equal(array, expected[key], err_msg=key)


RESPONSES = {
    "path": lambda build: fb.StaticResponse(build, load_steps=2),
    "motion from a path": lambda build: fb.Response(
        build, dt=0.01, t_end=0.02, start=lambda scene: fb.static(scene, load_steps=2)
    ),
}


@pytest.mark.parametrize("response", RESPONSES.values(), ids=RESPONSES)
def test_a_path_is_no_mechanism_after_its_program_has_served_one(response):
    """The work in load steps has derivatives only where no mechanism settles."""

    def held_bar(axis, load):
        section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.1)
        scene, beam = pinned_bar((1, 0), section, elements=2)
        scene.add_joint(fb.PinInSlot(fb.GROUND, beam.end, axis=axis))
        scene.add_force(beam.end, (load, 0.0))
        scene.add_moment(beam.end, 0.1 * load)
        return scene

    def build(x):
        scene = held_bar((1, 0), x[0])
        return scene, {"work": fb.Output("work", scene)}

    run = response(build)
    run([1.0])
    expected = run.jacobian()["work"]
    run([1.0])
    fb.static(held_bar((0, 1), 1.0), load_steps=2)  # free to turn until its load pulls
    np.testing.assert_array_equal(run.jacobian()["work"], expected)


def test_a_solution_of_a_motion_has_its_own_rows_after_further_steps():
    steps = fb.Motion(bar(12.0), dt=0.01, record=fb.Record())
    steps.step()
    read_at_once, solution = steps.solution(), steps.solution()
    expected = all_that_is_read(read_at_once)
    steps.run(0.05)
    for key, array in all_that_is_read(solution).items():
        np.testing.assert_array_equal(array, expected[key], err_msg=key)


@pytest.mark.parametrize("linear", [False, True])
def test_resultants_of_a_path_have_parameters_at_its_time(linear):
    """Not at the times that its load factors would be."""

    def path(EI):
        k = fb.Parameter("k", lambda t: EI * (1 + 2 * t))

        def energy(eps, gamma, kappa):
            return 5e3 * (eps**2 + gamma**2) + k * kappa**2 / 2

        scene = fb.Scene()
        beam = scene.add_beam([(0, 0), (1, 0.3)], fb.Section(strain_energy=energy), elements=4)
        scene.clamp(beam.start)
        scene.add_force(beam.end, (0.0, -20.0))
        return fb.static(scene, load_steps=3, t=0.25, linear=linear)

    expected, kept = path(100.0).resultants("beam 1"), path(100.0)
    path(130.0)
    np.testing.assert_array_equal(kept.resultants("beam 1").M, expected.M)
    np.testing.assert_array_equal(kept.resultants("beam 1").ends.M, expected.ends.M)
