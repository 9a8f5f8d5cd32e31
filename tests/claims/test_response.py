"""A motion as a function of numbers: these are set as by a new set-up, to the last digit."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from derivatives import EXACT, assert_both_ways_agree, assert_derivatives, difference, size_of
from jointed import frame, linkage
from scenes import assert_refused, clamped_bar, held_body, pinned_bar

import fx_beam as fb
from fx_beam.motions.initial_state import Starts
from fx_beam.step.program import PROGRAMS

# -- Every number of a scene -----------------------------------------------------------------


def places_of_numbers(part, seen, *way):
    """Ways from a scene to each of its numbers, and functions of the user: owners and keys."""
    if isinstance(part, np.ndarray):
        parts = np.ndenumerate(part) if part.dtype.kind == "f" else ()
    elif isinstance(part, dict):
        parts = part.items()
    elif isinstance(part, list | tuple):
        parts = enumerate(part)
    else:
        parts = vars(part).items() if type(part).__module__.startswith("fx_beam.") else ()
    if id(part) in seen:
        return
    seen.append(id(part))
    for key, one in [*parts]:
        is_number = isinstance(one, float) and np.isfinite(one) and one
        if is_number or (callable(one) and getattr(one, "__module__", "") == frame.__module__):
            yield *way, (part, key)
        else:
            yield from places_of_numbers(one, seen, *way, (part, key))


def put(value, *before, last):
    """Set a number; tuples are replaced as a whole."""
    owner, key = last
    if isinstance(owner, tuple):
        parts = [value if i == key else one for i, one in enumerate(owner)]
        made = type(owner)(*parts) if hasattr(owner, "_make") else tuple(parts)
        put(made, *before[:-1], last=before[-1])
    elif isinstance(owner, np.ndarray | list | dict):
        if isinstance(owner, np.ndarray):
            owner.setflags(write=True)
        owner[key] = value
    else:
        object.__setattr__(owner, key, value)


def enlarged(old, factor):
    return (lambda *place: np.multiply(old(*place), factor)) if callable(old) else factor * old


def multiplied(scene, factors):
    """The scene with some of its numbers, by their places, multiplied by factors."""
    places = list(places_of_numbers(scene, []))
    for k, factor in factors.items():
        *before, (owner, key) = places[k]
        is_object = not isinstance(owner, np.ndarray | list | dict | tuple)
        old = getattr(owner, key) if is_object else owner[key]
        put(enlarged(old, factor), *before, last=(owner, key))
    return scene


HISTORIES = "t q v a slides reactions joint_forces motor_forces contact_forces".split()


def everything(solution):
    """All that a motion gives."""
    parts = [getattr(solution, name) for name in HISTORIES]
    parts += vars(solution.energy).values()
    parts += [solution.resultants(beam).M for beam in solution.beams.values()]
    return np.concatenate([np.ravel(part) for part in parts])


def outcome(get):
    """Bytes; or the sentence of an error."""
    try:
        return get().tobytes()
    except (fb.SceneError, fb.StepError) as error:
        return str(error)


@pytest.mark.parametrize(
    ("build", "scheme", "every"),
    [
        (frame, fb.EnergyMomentum(), 1),
        (linkage, fb.EnergyMomentum(), 1),
        (linkage, fb.EnergyMomentum(order=4), 7),
    ],
)
def test_every_number_of_a_scene_is_set(build, scheme, every):
    """Each is enlarged by 1 %: what was set up for the scene before gives what a new one gives."""
    how = {"scheme": scheme, "dt": 0.01, "t_end": 0.03}

    def changed(x):
        return multiplied(build(), {int(x[0]): 1.01} if x[0] >= 0 else {}), {"all": everything}

    run = fb.Response(changed, **how)
    first = outcome(lambda: run([-1.0])[1]["all"])
    chosen = range(0, len(list(places_of_numbers(build(), []))), every)
    assert len(chosen) > 60 / every
    reused, felt, missed = 0, 0, []
    for k in chosen:
        computed = outcome(lambda k=k: run([k])[1]["all"])
        reused += not run.stats.setup_reason
        felt += computed != first
        if computed != outcome(lambda k=k: everything(fb.simulate(changed([k])[0], **how))):
            missed.append(k)
    assert missed == []
    assert every > 1 or felt > 0.6 * len(chosen)  # others only were on the way to numbers
    assert reused > 0.7 * len(chosen)


@pytest.mark.parametrize("build", [frame, linkage])
def test_numbers_of_a_scene_have_derivatives_wherever_they_are(build):
    """Every fourth one, but for those that cannot be changed alone."""
    how = {"dt": 0.01, "t_end": 0.03}

    def has_motion(k):
        scene = multiplied(build(), {k: 1.001})
        return not isinstance(outcome(lambda: fb.simulate(scene, **how).q), str)

    chosen = [k for k in range(0, len(list(places_of_numbers(build(), []))), 4) if has_motion(k)]
    assert len(chosen) > 15

    def changed(x):
        scene = multiplied(build(), dict(zip(chosen, x, strict=True)))
        nodes = enumerate(scene.nodes)
        return scene, {f"node {k}": fb.Output("position", node) for k, node in nodes}

    run = fb.Response(changed, newton=fb.NewtonOptions(tolerance=1e-13), **how)
    assert_derivatives(run, np.ones(len(chosen)))


# -- Structure --------------------------------------------------------------------------------


def pendulum(x):
    """A bar with mass, pinned: stiffness, mass and initial spin."""
    section = fb.Section(EA=1e3 * x[0], GA=1e3 * x[0], EI=x[0], rhoA=x[1], rhoI=1e-3)
    scene, bar = pinned_bar((1, 0), section, elements=4, gravity=(0, -9.81))
    scene.set_velocity(bar, lambda px, py: (0, x[2] * px), spin=x[2])
    return scene, {
        "end": fb.Output("position", bar.end),
        "force": fb.Output("reaction", bar.start, "y"),
        "energy": lambda solution: solution.energy.total,
        "bending": lambda solution: solution.resultants(bar).M,
    }


CHANGES = {
    "another number of nodes": lambda scene, _: scene.add_body((3, 3), mass=1.0, inertia=1.0),
    "scene.fixed differs": lambda scene, end: scene.fix(end, "y"),
    "scene.loads has another length": lambda scene, end: scene.add_force(end, (1, 0)),
    "scene.joints has another length": lambda scene, end: scene.add_joint(
        fb.Revolute(fb.GROUND, end)
    ),
    "scene.virtual_works has another length": lambda scene, _: scene.add_virtual_work(
        lambda step: step.virtual_psi * 0.1
    ),
    "scene.drags has another length": lambda scene, end: scene.add_drag(end, linear=1.0),
}


@pytest.mark.parametrize("reason", CHANGES)
def test_another_structure_is_set_up_anew_and_this_is_said(reason):
    def build(x):
        scene, outputs = pendulum(x)
        if x[3]:
            CHANGES[reason](scene, scene.beams[0].end)
        return scene, outputs

    PROGRAMS.clear()  # which other tests may have made
    run = fb.Response(build, dt=0.01, t_end=0.05)
    run([1.0, 1.0, 0.0, 0.0])
    assert run.stats.setup_reason == "the first scene"
    run([1.1, 1.0, 0.0, 0.0])
    assert run.stats.setup_reason == ""
    _, y = run([1.1, 1.0, 0.0, 1.0])
    assert run.stats.setup_reason == reason
    scene, _ = build([1.1, 1.0, 0.0, 1.0])
    assert (y["end"] == fb.simulate(scene, dt=0.01, t_end=0.05).position(scene.beams[0].end)).all()
    with pytest.raises(fb.SceneError, match="has another structure"):
        steps = fb.Response(lambda x: build([*x, x[0] > 1]), dt=0.01, t_end=0.05)
        steps([1.0, 1.0, 0.0])
        steps.jacobian("end")


def test_a_scene_to_which_something_is_added_is_set_up_anew():
    scene, outputs = pendulum([1.0, 1.0, 0.0])
    run = fb.Response(lambda x: (scene, {"end": outputs["end"]}), dt=0.01, t_end=0.05)
    PROGRAMS.clear()
    for reason in ("the first scene", ""):
        before = run([1.0])[1]["end"]
        assert run.stats.setup_reason == reason
    scene.fix(scene.beams[0].end, "y")
    assert (run([1.0])[1]["end"] != before).any()
    assert run.stats.setup_reason == "scene.fixed differs"


def test_the_axis_of_a_slide_is_set_if_nothing_else_differs():
    """The body is at the start of the axis, so that no positions depend on it."""

    def build(x):
        scene = fb.Scene(gravity=(0, -9.81))
        hub, body = (scene.add_body((1, 0), mass=1.0, inertia=0.1) for _ in range(2))
        scene.add_joint(fb.Revolute(fb.GROUND, hub.centre))
        scene.add_joint(fb.Prismatic(hub.centre, body.centre, axis=(1, x[0])))
        return scene, {"body": fb.Output("position", body.centre)}

    run, alone = (fb.Response(build, dt=0.01, t_end=0.05) for _ in range(2))
    run([0.1])
    assert (run([0.5])[1]["body"] == alone([0.5])[1]["body"]).all()
    assert run.stats.setup_reason == ""


# -- Calls ------------------------------------------------------------------------------------

HOW = {
    "tolerance": {"dt": None, "tolerance": 1e-3},
    "rows": {"record": fb.Record(every=3)},
    "times": {"dt": None, "tolerance": 1e-3, "record": fb.Record(times=[0.0, 0.02, 0.1])},
    "Newmark": {"scheme": fb.Newmark()},
    "halved": {"newton": fb.NewtonOptions(max_turn=0.2)},
}


@pytest.mark.parametrize("name", HOW)
def test_values_are_those_of_simulate(name):
    how = {"dt": 0.01, "t_end": 0.1} | HOW[name]
    run = fb.Response(pendulum, **how)
    for x in ([1.0, 1.0, 0.0], [1.2, 0.8, 25.0 if name == "halved" else 5.0], [1.0, 1.0, 0.0]):
        t, y = run(x)
        scene, _ = pendulum(x)
        bar, solution = scene.beams[0], fb.simulate(scene, **how)
        assert (t == solution.t).all()
        assert (y["end"] == solution.position(bar.end)).all()
        assert (y["force"] == solution.reaction(bar.start)[:, 1]).all()
        assert (y["energy"] == solution.energy.total).all()
        assert (y["bending"] == solution.resultants(bar).M).all()
        if name == "halved" and x[2]:
            assert run.stats.halvings > 0
    assert run.stats.setup_reason == ""


def test_motions_start_from_statics():
    def build(x):
        scene, outputs = pendulum([*x, 1.0, 0.0])
        scene.fix(scene.beams[0].start, "rotation")
        return scene, {"end": outputs["end"]}

    how = {"dt": 0.01, "t_end": 0.1}
    run = fb.Response(build, start=lambda scene: fb.static(scene, load_steps=2), **how)
    for x in (5.0, 6.0):
        _, y = run([x])
        scene, _ = build([x])
        start = fb.static(scene, load_steps=2)
        bent = fb.simulate(scene, start=start, **how).position(scene.beams[0].end)
        assert (y["end"] == bent).all()
        assert bent[0, 1] < -0.01
    assert run.stats.setup_reason == ""


def swinging(scene):
    """A motion from which another goes on, as a function of the scene."""
    return fb.simulate(scene, fb.EnergyDecaying(), dt=0.01, t_end=0.1, newton=EXACT)


@pytest.mark.parametrize("start", [fb.static, swinging])
def test_the_step_before_the_first_one_counts_in_derivatives(start):
    """`EnergyDecaying` reads it, but after an equilibrium there is none."""

    def build(x):
        section = fb.Section(EA=1e4, GA=5e3, EI=20.0, rhoA=1.0, rhoI=0.01)
        scene, beam = clamped_bar((1, 0.1), section, elements=3, gravity=(0.0, -9.81 * x[0]))
        names = ("position", beam.end), ("velocity", beam.end), ("M", beam)
        names += ("strain_energy", scene), ("dissipated_energy", scene)
        return scene, {name: fb.Output(name, place) for name, place in names}

    dt = {"dt": 0.01, "t_end": 0.05 if start is fb.static else 0.15}
    run = fb.Response(build, fb.EnergyDecaying(), start=start, newton=EXACT, **dt)
    run([1.0])
    J = run.jacobian()
    assert_both_ways_agree(run, run([1.0])[1], J)
    for name, rows in J.items():
        expected = difference(lambda step, name=name: run([1 + step])[1][name], 1e-3)
        assert rows[..., 0] == pytest.approx(expected, abs=1e-6 * max(size_of(rows), 1.0))
    if start is fb.static:
        assert abs(J["velocity"]).max() < 1e-9


def test_what_a_motor_did_before_the_start_depends_on_no_number():
    """The first step has the moment J (x - 1) / dt, as the spin jumps from 1 rad/s to x."""

    def build(x):
        scene, wheel = held_body((0, 0), mass=1.0, inertia=0.3)
        turn = lambda t: t**2 if t <= 0.5 else 0.25 + x[0] * (t - 0.5)  # noqa: E731
        axle = scene.add_joint(fb.Revolute(fb.GROUND, wheel, motor=turn))
        return scene, {"moment": fb.Output("motor_force", axle)}

    before = fb.Motion(build([1.0])[0], dt=1 / 16)
    before.run(0.5)
    run = fb.Response(build, start=before.state, dt=1 / 16, t_end=0.75)
    moment = run([0.2])[1]["moment"]
    assert moment[1:] == pytest.approx(np.array([0.3 * -0.8 * 16, 0, 0, 0]), abs=1e-9)
    expected = np.array([0.3 * 16, 0, 0, 0])
    assert run.jacobian()["moment"][1:, 0] == pytest.approx(expected, abs=1e-9)


def measured(case, solutions=None):
    """The end of a pendulum, and how it was set up; the solution is kept, if a list is given."""
    scene, outputs = pendulum(case["x"])
    solution = fb.simulate(scene, dt=0.01, t_end=0.1)
    if solutions is not None:
        solutions.append(solution)
    end = solution.position(outputs["end"].of)
    return {"end": end.tolist(), "reason": solution.stats.setup_reason}


CASES = [{"x": [1.0 + 0.1 * k, 1.0 + 0.2 * k, float(k)]} for k in range(3)]


def test_sweeps_set_numbers_only_and_give_the_same():
    PROGRAMS.clear()
    with ThreadPoolExecutor(1) as executor:
        table = fb.sweep(measured, CASES, executor=executor)
    rows = table.to_dict("records") if hasattr(table, "to_dict") else table
    assert [row["reason"] for row in rows] == ["the first scene", "", ""]
    for row, case in zip(rows, CASES, strict=True):
        assert row["end"] == measured(case)["end"]


def test_solutions_of_a_sweep_that_are_kept_share_a_program():
    """Their resultants are computed when they are asked for."""
    PROGRAMS.clear()
    solutions = []
    with ThreadPoolExecutor(1) as executor:
        fb.sweep(lambda case: measured(case, solutions), CASES, executor=executor)
    assert [s.stats.setup_reason for s in solutions] == ["the first scene", "", ""]
    for solution, case in zip(solutions, CASES, strict=True):
        alone = fb.simulate(pendulum(case["x"])[0], dt=0.01, t_end=0.1)
        assert (solution.resultants("beam 1").M == alone.resultants("beam 1").M).all()


def test_failed_motions_are_followed_by_others_but_have_no_derivatives():
    run = fb.Response(pendulum, dt=0.01, t_end=0.1, max_halvings=0)
    _, y = run([1.0, 1.0, 0.0])
    weights = {"end": y["end"]}
    gradient = run.vjp(weights)
    for x, error in (([1.0, 1.0, 1e4], fb.StepError), ([1.0, -1.0, 0.0], fb.SceneError)):
        with pytest.raises(error, match="rhoA = -1" if x[1] < 0 else None) as stop:
            run(x)
        if error is fb.StepError:
            assert len(stop.value.solution.t) >= 1
        del stop
        assert_refused("without an error", run.vjp, weights)
        assert (run([1.0, 1.0, 0.0])[1]["end"] == y["end"]).all()
        assert (run.vjp(weights) == gradient).all()


def of_pendulum(outputs):
    return lambda x: (pendulum([1, 1, 0])[0], outputs)


ELSEWHERE = pendulum([1, 1, 0])[1]


@pytest.mark.parametrize(
    ("build", "x", "message"),
    [
        (lambda x: None, [1.0], "must give a scene and outputs, not None"),
        (lambda x: (fb.Scene(), {}), [1.0], "at least one output"),
        (of_pendulum({"end": 3}), [1.0], "'end'"),
        (of_pendulum(ELSEWHERE), [1.0], "belongs to another scene"),
        (of_pendulum({"T": fb.Output("work", fb.Scene())}), [1.0], "of the scene of the motion"),
        (pendulum, [1.0, np.nan, 0.0], "finite numbers"),
        (pendulum, "abc", "finite numbers"),
        (pendulum, 2.0, "a sequence"),
    ],
)
def test_errors_name_what_is_wrong(build, x, message):
    assert_refused(message, lambda: fb.Response(build, dt=0.01, t_end=0.05)(x))


def calls_of(function, x):
    """Number of calls of functions of Python in a call."""
    events = []
    sys.setprofile(lambda frame, event, argument: events.append(event))
    try:
        function(x)
    finally:
        sys.setprofile(None)
    return events.count("call")


def test_a_scene_of_a_known_structure_takes_few_calls():
    def build(x):
        section = fb.Section(EA=1e4 * x[0], GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.1)
        scene = fb.Scene()
        bar = scene.add_beam([(0, 0), (1, 0)], section, elements=8)
        scene.pin(bar.start)
        scene.set_velocity(bar, lambda X, Y: (0.0, x[1] * X), spin=x[1])
        return scene, {"end": fb.Output("position", bar.end)}

    run, x = fb.Response(build, dt=0.01, t_end=0.5), np.ones(2)
    for factor in (1.0, 1.1, 1.2):
        run(factor * x)
    assert calls_of(run, 1.3 * x) - calls_of(build, x) < 400


def test_beams_that_share_their_sections_in_another_way_have_their_own_masses():
    def momentum(*numbers):
        sections = [fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0 + i, rhoI=0.1) for i in range(2)]
        scene, node = fb.Scene(gravity=(0.0, -9.81)), (0.0, 0.0)
        for i, number in enumerate(numbers, start=1):
            node = scene.add_beam([node, (float(i), 0.0)], sections[number]).end
        return fb.simulate(scene, dt=0.01, t_end=0.1).linear_momentum[-1, 1]

    for numbers in ((0, 1, 0), (0, 1, 1), (0, 0, 1)):
        assert momentum(*numbers) == pytest.approx(-0.981 * (3 + sum(numbers)), rel=1e-9)


def test_other_outputs_than_before_are_refused():
    def build(x):
        scene, outputs = pendulum([1, 1, 0])
        return scene, {"end": outputs["end"]} if x[0] > 0 else outputs

    run = fb.Response(build, dt=0.01, t_end=0.05)
    run([1.0])
    assert_refused("as in the first call", run, [-1.0])


# -- What has no derivatives ------------------------------------------------------------------


def test_what_has_no_derivatives_is_refused_by_its_name():
    run = fb.Response(pendulum, dt=0.01, t_end=0.05)
    assert_refused("called after run", run.vjp, {})
    _, y = run([1.0, 1.0, 1.0])
    for weights, message in (
        ({"energy": y["energy"]}, "'energy' is a function of the solution"),
        ({"end": y["force"]}, "of the shape"),
        ({"end": np.where(y["end"] == y["end"][2], np.nan, 1)}, r"\[2\]\[0\] is no finite number"),
        ({"other": y["end"]}, "must be names of outputs"),
    ):
        assert_refused(message, run.vjp, weights)
    assert_refused("'energy' is a function of the solution", run.jacobian)
    assert run.vjp({"force": y["force"]}).any()
    assert run.jacobian("end")["end"].shape == (*y["end"].shape, 3)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"scheme": fb.Newmark()}, "Newmark.* no derivatives.* Use EnergyMomentum"),
        ({"record": fb.Record(times=[0.0, 0.025])}, "t = 0.025 is inside a step"),
    ],
)
def test_motions_without_derivatives_say_why(options, message):
    run = fb.Response(pendulum, dt=0.01, t_end=0.05, **options)
    _, y = run([1.0, 1.0, 1.0])
    assert_refused(message, lambda: run.vjp({"end": y["end"]}))


def test_numbers_at_the_end_of_their_range_have_no_derivatives():
    def build(x):
        scene, outputs = pendulum([1.0, 1.0, 1.0])
        scene.add_drag(scene.beams[0].end, linear=x[0], quadratic=0.1)
        return scene, {"end": outputs["end"]}

    run = fb.Response(build, dt=0.01, t_end=0.05)
    run([0.0])
    said = r"by x\[0\] at 0.0, since there is no scene at -9.5"
    assert_refused(said, run.jacobian)


OF_ALL_NUMBERS = """
import numpy as np
import fx_beam as fb

def build(x):
    scene = fb.Scene()
    section = fb.Section(1e4 * x[0], 1e4 * x[1], 100 * x[2], rhoA=x[3], rhoI=0.1 * x[4])
    beam = scene.add_beam([(0, 0), (1, 0.3 * x[5])], section, elements=2)
    scene.set_velocity(beam, lambda X, Y: (-2 * x[6] * Y, 2 * x[6] * X), spin=2.0 * x[6])
    return scene, {"N": fb.Output("N", beam), "tip": fb.Output("position", beam.end)}

run = fb.Response(build, dt=0.01, t_end=0.04)
_, y = run(np.ones(7))
print([run.vjp({name: np.ones(rows.shape)}).tobytes().hex() for name, rows in y.items()])
"""


def test_derivatives_have_the_same_digits_in_all_processes():
    """Python gives names another order in each; sums over them are in one of their own."""
    command, digits = [sys.executable, "-c", OF_ALL_NUMBERS], set()
    for seed in "124":
        environment = os.environ | {"PYTHONHASHSEED": seed}
        process = subprocess.run(
            command, env=environment, stdout=subprocess.PIPE, text=True, check=True
        )
        digits.add(process.stdout)
    assert len(digits) == 1 and "[" in digits.pop()


def test_the_first_state_of_a_motion_is_found_once_for_it_and_its_derivatives(monkeypatch):
    def build(x):
        section = fb.Section(EA=1e3, GA=1e3, EI=10.0, rhoA=1.0, rhoI=0.01)
        scene, beam = clamped_bar((1, 0), section, elements=2)
        scene.add_force(beam.end, (0.0, x[0]))
        return scene, {"tip": fb.Output("position", beam.end)}

    run = fb.Response(build, dt=0.01, t_end=0.1)
    _, y = run([1.0])
    run.vjp({"tip": np.ones_like(y["tip"])})  # checks slopes by other scenes
    states, find = [], Starts.initial
    monkeypatch.setattr(Starts, "initial", lambda *x, **y: states.append(0) or find(*x, **y))
    run([1.1])
    run.vjp({"tip": np.ones_like(y["tip"])})
    assert len(states) == 1
