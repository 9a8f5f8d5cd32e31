"""A motion as a function of numbers: these are set as by a new set-up, to the last digit."""

import dataclasses
import itertools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

import fx_beam as fb
from fx_beam.analyses.kept_setup import keeping_setup
from fx_beam.analyses.run_setup import RunSetup
from fx_beam.responses.numbers import numbers_of
from fx_beam.scene.scene import Scene
from fx_beam.stepping.substeps import Halving
from fx_beam.validation import Constant, _CheckedFunction

# -- Scenes with many kinds of numbers -------------------------------------------------------


def frame():
    """Curved and tapered beams without joints that turn, with loads and drag of all kinds."""
    scene = fb.Scene(gravity=(0.3, -9.81))
    tapered = fb.Section(
        EA=lambda s: 2e4 * (1 - s / 3),
        GA=8e3,
        EI=lambda s: 30 * (1 - s / 2),
        rhoA=lambda s: 1.2 - s / 4,
        rhoI=2e-3,
        retardation=(1e-3, 2e-3, 3e-3),
    )
    plain = fb.Section(EA=1e4, GA=7e3, EI=20.0, rhoA=0.8, rhoI=1e-3, retardation=2e-3)
    post = scene.add_beam([(0, 0), (0.1, 1)], plain, elements=2, degree=2)
    bow = scene.add_beam(fb.arc((0.1, 1), (0.6, 1.3), (1.2, 1.1)), tapered, elements=3, degree=2)
    scene.add_joint(fb.Revolute(post.end, bow.start, spring=fb.Spring(3.0, rest=0.1)))
    scene.clamp(post.start)
    scene.add_mass(bow.end, 0.3, 0.02)
    scene.add_force(bow.end, lambda t: (1 + t, 2.0))
    scene.add_force(bow.end, (0.2, 0.3), follower=True)
    scene.add_moment(bow.end, lambda t: 0.4 * t)
    scene.add_line_load(post, (0.3, 0.1))
    scene.add_line_load(bow, lambda s: (0.1 + s, 0.2), of="arc length")
    scene.add_drag(bow, linear=(0.1, 0.2), quadratic=0.05, rotation=0.01)
    scene.add_drag(post, linear=0.1)
    scene.add_drag(post.end, linear=0.2, quadratic=0.3, rotation=0.05)
    scene.add_obstacle(bow, fb.Line((1.203, 1.1), normal=(-1, 0.2)), stiffness=1e3)
    scene.add_obstacle(bow.end, fb.Circle((1.3, 0.5), 0.6), 1e3, restitution=0.5, speed=0.1)
    scene.add_force_between(
        bow.end, (1.5, 1.6), spring=fb.Spring(20.0, rest=0.4), damper=fb.Damper(0.3)
    )
    scene.set_velocity(bow, lambda x, y: (y - 1, 0.1 - x), spin=-0.2)
    scene.set_velocity(post, (0.0, 0.0))
    scene.make_velocities_compatible()
    return scene


def linkage():
    """Bodies, offsets, slides with springs, friction, stops and motors, a prescribed motion."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(EA=1e4, GA=7e3, EI=20.0, rhoA=0.8, rhoI=1e-3)
    rod = scene.add_beam([(0.5, 0.1), (1.5, 0.2)], section, elements=2)
    body = scene.add_body(
        (0.2, 0.1), mass=2.0, inertia=0.1, points={"pin": (0, 0), "end": (0.5, 0.1)}
    )
    scene.add_joint(
        fb.Revolute(
            fb.GROUND, body["pin"], damper=fb.Damper(0.2), friction=fb.Friction(0.3, speed=0.1)
        )
    )
    scene.add_joint(fb.Revolute(body["end"], rod.start, stop=fb.Stop(-0.5, 1e-4, 50.0)))
    block = scene.add_body((1.6, 0.3), mass=1.0, inertia=0.05)
    scene.add_joint(
        fb.Prismatic(
            rod.end,
            block.centre,
            axis=(1, 0.2),
            offset=(0.1 - 0.05, 0.1 - 0.01),
            spring=fb.Spring(40.0, rest=0.1),
            damper=fb.Damper(0.5),
            friction=fb.Friction(0.2, speed=0.05),
            stop=(-0.4, 0.055, 1e3),
        )
    )
    wheel = scene.add_body((2.0, 0.6), mass=0.5, inertia=0.02)
    scene.add_joint(fb.Revolute(fb.GROUND, wheel.centre, motor=lambda t: 3 * t**2))
    driven = scene.add_body((0.0, 1.0), mass=0.5, inertia=0.02)
    scene.prescribe(driven.centre, x=lambda t: 0.1 * t**2)
    scene.fix(driven.centre, "y")
    scene.add_force_between(driven.centre, body["end"], spring=fb.Spring(30.0, rest=0.8))
    scene.set_velocity(block.centre, (4.0, 0.3), spin=0.1)
    scene.make_velocities_compatible()
    return scene


SCENES = {"frame": frame, "linkage": linkage}
SCHEMES = {
    "EnergyMomentum": fb.EnergyMomentum(),
    "order 4": fb.EnergyMomentum(order=4),
    "decaying": fb.EnergyDecaying(),
    "HHT": fb.HHT(-0.1),
}

# -- Every number of a scene -----------------------------------------------------------------


def numbers_of_scene(value, seen, path="scene"):
    """Paths of all numbers, and functions that multiply them by 1.01."""
    if id(value) in seen or isinstance(value, str | bool | type(None)):
        return
    seen.add(id(value))
    if isinstance(value, np.ndarray) and value.dtype.kind == "f":
        for i in np.ndindex(value.shape):
            if np.isfinite(value[i]) and value[i]:
                yield f"{path}{list(i)}", (value, i)
    elif isinstance(value, dict):
        for key, part in value.items():
            yield from entry_or_inside(value, key, part, f"{path}[{key!r}]", seen)
    elif isinstance(value, list):
        for i, part in enumerate(value):
            yield from entry_or_inside(value, i, part, f"{path}[{i}]", seen)
    elif isinstance(value, tuple | set):
        for i, part in enumerate(value):
            yield from numbers_of_scene(part, seen, f"{path}[{i}]")
    elif isinstance(value, Scene | Constant | _CheckedFunction) or dataclasses.is_dataclass(value):
        for name, part in vars(value).items():
            yield from entry_or_inside(value, name, part, f"{path}.{name}", seen)


def entry_or_inside(owner, key, part, path, seen):
    is_number = isinstance(part, float | tuple) and not isinstance(part, bool)
    is_user = isinstance(owner, fb.Section) or (
        isinstance(owner, _CheckedFunction) and key == "function"
    )
    if isinstance(part, float) and np.isfinite(part) and part:
        yield path, (owner, key)
    elif callable(part) and is_user:
        yield path, (owner, key)
    elif isinstance(part, tuple) and part and all(isinstance(one, float | int) for one in part):
        for i, one in enumerate(part):
            if isinstance(one, float) and one:
                yield f"{path}[{i}]", (owner, key, i)
    elif not is_number or isinstance(part, tuple):
        yield from numbers_of_scene(part, seen, path)


def enlarged(value):
    if callable(value):
        return lambda *at: np.multiply(value(*at), 1.01)
    return 1.01 * value


def enlarge(place):
    """Multiply a number by 1.01."""
    owner, key, *inner = place
    if isinstance(owner, np.ndarray):
        owner.setflags(write=True)
        owner[key] *= 1.01
        return
    at = isinstance(owner, list | dict)
    value = owner[key] if at else getattr(owner, key)
    if inner:
        new = tuple(enlarged(one) if i == inner[0] else one for i, one in enumerate(value))
    else:
        new = enlarged(value)
    if at:
        owner[key] = new
    else:
        object.__setattr__(owner, key, new)


HISTORIES = (
    "t",
    "q",
    "v",
    "a",
    "slides",
    "reactions",
    "joint_forces",
    "motor_forces",
    "contact_forces",
)


def outcome(scene, **how):
    """All that a motion gives, as bytes; or the sentence of its error."""
    try:
        solution = fb.simulate(scene, **how)
    except (fb.SceneError, fb.StepError) as error:
        return str(error)
    found = {name: getattr(solution, name).tobytes() for name in HISTORIES}
    energy = {name: values.tobytes() for name, values in vars(solution.energy).items()}
    resultants = [solution.resultants(beam).M.tobytes() for beam in scene.beams]
    return found, energy, resultants, solution.stats.newton_iterations


@pytest.mark.parametrize(
    ("name", "scheme", "every"),
    [
        *((name, "EnergyMomentum", 1) for name in SCENES),
        *((n, s, 7) for n in SCENES for s in SCHEMES),
    ],
)
def test_every_number_of_a_scene_is_set(name, scheme, every):
    """Each is enlarged by 1 %: what was set up for the scene before gives what a new one gives."""
    how = {"scheme": SCHEMES[scheme], "dt": 0.01, "t_end": 0.03}
    build = SCENES[name]
    chosen = range(0, len(list(numbers_of_scene(build(), set()))), every)
    count = len(chosen)
    assert count > 60 / every
    reused, felt, missed = 0, 0, []
    first = outcome(build(), **how)
    assert not isinstance(first, str), first
    with keeping_setup() as kept:
        for k in chosen:
            scene = build()
            path, place = list(numbers_of_scene(scene, set()))[k]
            enlarge(place)
            again = outcome(scene, **how)
            reused += not kept.reason
            felt += again != first
            with keeping_setup(type(kept)()):
                if again != outcome(scene, **how):
                    missed.append(path)
    assert missed == []
    assert every > 1 or felt > 0.6 * count  # all but what only was a number on the way to others
    assert reused > 0.7 * count


@pytest.mark.parametrize("name", SCENES)
def test_what_changes_a_motion_changes_the_numbers_of_its_steps(name):
    """So their differences are all that a derivative needs."""
    how = {"dt": 0.01, "t_end": 0.02}
    ends = np.array([0.01, 0.02])

    def numbers(scene):
        setup = RunSetup(scene, fb.EnergyMomentum(), None, Halving(12, 0.01), "auto")
        found = numbers_of(setup, setup.first_state(0.01, None), ends - 0.01, ends)
        return {key: values.tobytes() for key, values in found.items()}

    build = SCENES[name]
    first, before = outcome(build(), **how), numbers(build())
    for k in range(0, len(list(numbers_of_scene(build(), set()))), 2):
        scene = build()
        path, owner = list(numbers_of_scene(scene, set()))[k]
        enlarge(owner)
        if outcome(scene, **how) != first:
            assert numbers(scene) != before, path


# -- Structure --------------------------------------------------------------------------------


def pendulum(x):
    """A bar with mass, pinned: stiffness, mass and initial spin."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(EA=1e3 * x[0], GA=1e3 * x[0], EI=x[0], rhoA=x[1], rhoI=1e-3)
    bar = scene.add_beam([(0, 0), (1, 0)], section, elements=4)
    scene.pin(bar.start)
    scene.set_velocity(bar, lambda px, py: (0, x[2] * px), spin=x[2])
    return scene, {
        "end": fb.Output("position", bar.end),
        "force": fb.Output("reaction", bar.start, "y"),
        "energy": lambda solution: solution.energy.total,
        "bending": lambda solution: solution.resultants(bar).M,
    }


CHANGES = {
    "another number of nodes": lambda scene: scene.add_body((3, 3), mass=1.0, inertia=1.0),
    "scene.fixed differs": lambda scene: scene.fix(scene.beams[0].end, "y"),
    "scene.loads has another length": lambda scene: scene.add_force(scene.beams[0].end, (1, 0)),
    "scene.joints has another length": lambda scene: scene.add_joint(
        fb.Revolute(fb.GROUND, scene.beams[0].end)
    ),
    "scene.virtual_works has another length": lambda scene: scene.add_virtual_work(
        lambda step: step.virtual_psi * 0.1
    ),
    "scene.drags has another length": lambda scene: scene.add_drag(scene.beams[0].end, linear=1.0),
}


@pytest.mark.parametrize("reason", CHANGES)
def test_another_structure_is_set_up_anew_and_this_is_said(reason):
    def build(x):
        scene, outputs = pendulum(x)
        if x[3]:
            CHANGES[reason](scene)
        return scene, outputs

    run = fb.Response(build, dt=0.01, t_end=0.05)
    run([1.0, 1.0, 0.0, 0.0])
    assert run.stats.setup_reason == "the first scene"
    run([1.1, 1.0, 0.0, 0.0])
    assert run.stats.setup_reason == ""
    _, y = run([1.1, 1.0, 0.0, 1.0])
    assert run.stats.setup_reason == reason
    scene, _ = build([1.1, 1.0, 0.0, 1.0])
    assert (y["end"] == fb.simulate(scene, dt=0.01, t_end=0.05).position(scene.beams[0].end)).all()


def test_a_scene_to_which_something_is_added_is_set_up_anew():
    scene, _ = pendulum([1.0, 1.0, 0.0])
    run = fb.Response(
        lambda x: (scene, {"end": fb.Output("position", scene.beams[0].end)}), dt=0.01, t_end=0.05
    )
    for reason in ("the first scene", ""):
        before = run([1.0])[1]["end"]
        assert run.stats.setup_reason == reason
    scene.fix(scene.beams[0].end, "y")
    after = run([1.0])[1]["end"]
    assert run.stats.setup_reason == "scene.fixed differs"
    assert (after != before).any()


def test_the_axis_of_a_slide_is_set_if_nothing_else_differs():
    """The body is at the start of the axis, so that no positions depend on it."""

    def build(x):
        scene = fb.Scene(gravity=(0, -9.81))
        section = fb.Section(EA=1e3, GA=1e3, EI=1.0, rhoA=1.0, rhoI=1e-3)
        bar = scene.add_beam([(0, 0), (1, 0)], section)
        scene.clamp(bar.start)
        body = scene.add_body((1, 0), mass=1.0, inertia=0.1)
        scene.add_joint(fb.Prismatic(bar.end, body.centre, axis=(1, x[0])))
        return scene, {"body": fb.Output("position", body.centre)}

    run, alone = (fb.Response(build, dt=0.01, t_end=0.05) for _ in range(2))
    run([0.1])
    assert (run([0.5])[1]["body"] == alone([0.5])[1]["body"]).all()
    assert run.stats.setup_reason == ""


def test_functions_in_ufl_are_compiled_anew():
    """They may depend on the numbers without showing it."""

    def build(x):
        scene = fb.Scene()
        section = fb.Section(
            strain_energy=lambda e, g, k: x[0] * (e**2 + g**2 + k**2) / 2, rhoA=1.0, rhoI=1e-3
        )
        bar = scene.add_beam([(0, 0), (1, 0)], section)
        scene.clamp(bar.start)
        scene.add_force(bar.end, (0, 0.1))
        return scene, {"end": fb.Output("position", bar.end)}

    run = fb.Response(build, dt=0.01, t_end=0.05)
    soft, stiff = run([10.0])[1]["end"], run([20.0])[1]["end"]
    assert "strain_energy" in run.stats.setup_reason
    assert (soft[-1] != stiff[-1]).all()


# -- Calls ------------------------------------------------------------------------------------

HOW = {
    "plain": {},
    "tolerance": {"dt": None, "tolerance": 1e-3},
    "order 4": {"scheme": fb.EnergyMomentum(order=4)},
    "rows": {"record": fb.Record(every=3)},
    "times": {"dt": None, "tolerance": 1e-3, "record": fb.Record(times=[0.0, 0.02, 0.1])},
    "Python": {"solver": "petsc"},
    "Newmark": {"scheme": fb.Newmark()},
    "halved": {"newton": fb.NewtonOptions(max_turn=0.2)},
}


@pytest.mark.parametrize("name", HOW)
def test_values_are_those_of_simulate(name):
    how = {"dt": 0.01, "t_end": 0.1} | HOW[name]
    run = fb.Response(pendulum, **how)
    for x in ([1.0, 1.0, 0.0], [1.2, 0.8, 25.0 if name == "halved" else 5.0], [1.0, 1.0, 0.0]):
        t, y = run(x)
        scene, outputs = pendulum(x)
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
        scene = fb.Scene()
        section = fb.Section(EA=1e3, GA=1e3, EI=x[0], rhoA=1.0, rhoI=1e-3)
        bar = scene.add_beam([(0, 0), (1, 0)], section, elements=4)
        scene.clamp(bar.start)
        scene.add_force(bar.end, lambda t: (0, 0.1 * (t <= 0)))
        return scene, {"end": fb.Output("position", bar.end)}

    run = fb.Response(build, dt=0.01, t_end=0.1, start=lambda scene: fb.static(scene, steps=2))
    for x in (1.0, 1.5):
        _, y = run([x])
        scene, _ = build([x])
        start = fb.static(scene, steps=2)
        bent = fb.simulate(scene, dt=0.01, t_end=0.1, start=start).position(scene.beams[0].end)
        assert (y["end"] == bent).all()
        assert bent[0, 1] > 0.01
    assert run.stats.setup_reason == ""


def test_a_solution_in_use_keeps_its_set_up():
    """Its resultants are computed when they are asked for."""
    with keeping_setup() as kept:
        scenes = [pendulum([k, 1.0, 3.0])[0] for k in (1.0, 2.0)]
        first = fb.simulate(scenes[0], dt=0.01, t_end=0.05)
        fb.simulate(scenes[1], dt=0.01, t_end=0.05)
        assert kept.reason == "the last solution is still in use"
    alone = fb.simulate(scenes[0], dt=0.01, t_end=0.05)
    found = (solution.resultants(solution.beams["beam 1"]).M for solution in (first, alone))
    assert (next(found) == next(found)).all()


def test_a_failed_motion_is_followed_by_others():
    run = fb.Response(pendulum, dt=0.01, t_end=0.1, max_halvings=0)
    first = run([1.0, 1.0, 0.0])[1]["end"]
    with pytest.raises(fb.StepError) as stop:
        run([1.0, 1.0, 1e4])
    assert len(stop.value.solution.t) >= 1
    with pytest.raises(fb.SceneError, match="rhoA = -1"):
        run([1.0, -1.0, 0.0])
    del stop
    assert (run([1.0, 1.0, 0.0])[1]["end"] == first).all()


@pytest.mark.parametrize(
    ("build", "x", "message"),
    [
        (lambda x: None, [1.0], "must give a scene and a dict of outputs, not None"),
        (lambda x: (fb.Scene(), {}), [1.0], "at least one output"),
        (lambda x: (pendulum([1, 1, 0])[0], {"end": 3}), [1.0], "'end'"),
        (
            lambda x: (pendulum([1, 1, 0])[0], pendulum([1, 1, 0])[1]),
            [1.0],
            "belongs to another scene",
        ),
        (pendulum, [1.0, np.nan, 0.0], "finite numbers"),
        (pendulum, "abc", "finite numbers"),
        (pendulum, 2.0, "a sequence"),
    ],
)
def test_errors_name_what_is_wrong(build, x, message):
    with pytest.raises(fb.SceneError, match=message):
        fb.Response(build, dt=0.01, t_end=0.05)(x)


def test_other_outputs_than_before_are_refused():
    def build(x):
        scene, outputs = pendulum([1, 1, 0])
        return scene, {"end": outputs["end"]} if x[0] > 0 else outputs

    run = fb.Response(build, dt=0.01, t_end=0.05)
    run([1.0])
    with pytest.raises(fb.SceneError, match="as in the first call"):
        run([-1.0])


def measured(case):
    scene, outputs = pendulum(case["x"])
    solution = fb.simulate(scene, dt=0.01, t_end=0.1)
    end = solution.position(outputs["end"].of)
    return {"end": end.tolist(), "reason": solution.stats.setup_reason}


def test_sweeps_set_numbers_only_and_give_the_same():
    cases = [{"x": [1.0 + 0.1 * k, 1.0 + 0.2 * k, float(k)]} for k in range(4)]
    with ThreadPoolExecutor(1) as executor:
        table = fb.sweep(measured, cases, executor=executor)
    rows = table.to_dict("records") if hasattr(table, "to_dict") else table
    assert [row["reason"] for row in rows] == ["the first scene", "", "", ""]
    for row, case in zip(rows, cases, strict=True):
        assert row["end"] == measured(case)["end"]


# -- Derivatives ------------------------------------------------------------------------------


def arm(x):
    """A driven flexible arm with a body on a sprung hinge."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    section = fb.Section(EA=1e4 * x[0], GA=5e3 * x[0], EI=20 * x[0], rhoA=x[1], rhoI=1e-2)
    beam = scene.add_beam([(0, 0), (x[2], 0)], section, elements=3)
    scene.add_joint(fb.Revolute(fb.GROUND, beam.start, motor=lambda t: 2 * x[1] * t**2))
    place = {"pin": (x[2], 0)}
    body = scene.add_body((x[2] + 0.2, 0.0), mass=x[1], inertia=0.02, points=place)
    spring = fb.Spring(stiffness=3 * x[0])
    hinge = scene.add_joint(fb.Revolute(beam.end, body["pin"], spring=spring))
    return scene, {
        "body": fb.Output("position", body.centre),
        "angle": fb.Output("angle", hinge),
        "turn": fb.Output("rotation", body.centre),
        "strain": fb.Output("strain_energy", scene),
        "potential": fb.Output("potential_energy", scene),
    }


def free(x):
    """A free bar with an initial spin, a mass and a load; its rates are outputs as well."""
    scene = fb.Scene()
    section = fb.Section(EA=1e4, GA=5e3, EI=lambda s: 20 * x[0] * (1 - s / 2), rhoA=x[1], rhoI=0.01)
    bar = scene.add_beam(fb.arc((0, 0), (0.5, 0.1 * x[2]), (1, 0)), section, 2, degree=2)
    scene.add_mass(bar.end, x[1])
    scene.add_force(bar.start, lambda t: (x[0] * t, x[2]))
    scene.set_velocity(bar, lambda px, py: (-x[1] * py, x[1] * px), spin=x[1])
    return scene, {
        "end": fb.Output("velocity", bar.end, "y"),
        "spin": fb.Output("spin", bar.start),
        "start": fb.Output("displacement", bar.start),
        "kinetic": fb.Output("kinetic_energy", scene),
        "strain": fb.Output("strain_energy", scene),
    }


def bent(x):
    """A cantilever that is let go from static equilibrium."""
    scene = fb.Scene()
    section = fb.Section(EA=1e4, GA=5e3, EI=20 * x[0], rhoA=x[1], rhoI=1e-2, retardation=1e-3)
    bar = scene.add_beam([(0, 0), (1, 0)], section, elements=3)
    scene.clamp(bar.start)
    scene.add_force(bar.end, lambda t: (0.0, 5 * x[2] * (t <= 0)))
    return scene, {"end": fb.Output("position", bar.end)}


def four_bar(x):
    """A closed loop of rigid bodies, by its lengths and an inertia."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    ends = np.array([(0, 0), (0.2, 0.4 * x[0]), (1.0, 0.6 * x[1]), (1.1, 0)])
    bodies = [
        scene.add_body((a + b) / 2, 1.0, 0.05 * x[2], {"start": a, "end": b})
        for a, b in itertools.pairwise(ends)
    ]
    first, coupler, last = bodies
    scene.add_joint(fb.Revolute(fb.GROUND, first["start"]))
    scene.add_joint(fb.Revolute(first["end"], coupler["start"]))
    scene.add_joint(fb.Revolute(coupler["end"], last["start"]))
    scene.add_joint(fb.Revolute(fb.GROUND, last["end"]))
    scene.add_force(coupler.centre, lambda t: (20.0, 0.0))
    return scene, {
        "coupler": fb.Output("position", coupler.centre),
        "kinetic": fb.Output("kinetic_energy", scene),
        "turn": fb.Output("rotation", first.centre),
    }


def guided(x):
    """A body on a slide of a flexible guide, whose axis and length at the start depend on x."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    section = fb.Section(EA=1e4, GA=5e3, EI=20 * x[0], rhoA=1.0, rhoI=1e-2)
    guide = scene.add_beam([(0, 0), (1, 0)], section, elements=2)
    scene.clamp(guide.start)
    axis = np.array([1.0, 0.2 * x[1]])
    body = scene.add_body((1, 0) + x[2] * 0.1 * axis, 0.5, 0.05)
    slide = scene.add_joint(fb.Prismatic(guide.end, body.centre, axis, spring=fb.Spring(40.0)))
    return scene, {"body": fb.Output("position", body.centre), "slide": fb.Output("slide", slide)}


TAPED = {
    "loop": (four_bar, {}),
    "guided": (guided, {}),
    "arm": (arm, {}),
    "free": (free, {}),
    "order 4": (free, {"scheme": fb.EnergyMomentum(order=4)}),
    "decaying": (arm, {"scheme": fb.EnergyDecaying()}),
    "rows": (arm, {"record": fb.Record(every=3)}),
    "tolerance": (free, {"dt": None, "tolerance": 1e-3}),
    "statics": (bent, {"start": lambda scene: fb.static(scene, steps=2)}),
}


@pytest.mark.parametrize("name", TAPED)
def test_derivatives_are_those_of_the_motion(name):
    """By differences of motions, whose steps have the same lengths where a tolerance chose them."""
    build, options = TAPED[name]
    options = {"dt": 0.01, "t_end": 0.1} | options
    x, rng = np.array([1.1, 0.9, 1.05]), np.random.default_rng(0)
    run = fb.Response(build, **options)
    run(1.02 * x)
    t, y = run(x)
    weights = {name: rng.standard_normal(rows.shape) for name, rows in y.items()}
    gradient = run.vjp(weights)
    for i in range(3):
        sides = []
        for side in (1, -1):
            moved = x.copy()
            moved[i] += side * 1e-5
            times, found = run(moved)
            assert (times == t).all() or name == "tolerance"
            sides.append(sum((weights[name] * found[name]).sum() for name in weights))
        expected = (sides[0] - sides[1]) / 2e-5
        assert abs(gradient[i] - expected) < 1e-6 * abs(gradient).max() + 1e-8
    run(x)
    assert (run.vjp(weights) == gradient).all()  # with the tape of that motion
    J = run.jacobian()
    products = [np.tensordot(weights[name], J[name], weights[name].ndim) for name in J]
    assert abs(np.sum(products, axis=0) - gradient).max() < 1e-10 * abs(gradient).max()
    assert all(J[name].shape == (*y[name].shape, 3) for name in y)
    # The differences of `build` leave nothing behind, also where the next motion is one of them.
    x[2] += 2.0**-17 * x[2]
    again, alone = run(x)[1], fb.Response(build, **options)(x)[1]
    assert all((again[name] == alone[name]).all() for name in y)


def test_what_has_no_derivatives_is_refused_by_its_name():
    run = fb.Response(pendulum, dt=0.01, t_end=0.05)
    with pytest.raises(fb.SceneError, match="called after run"):
        run.vjp({})
    _, y = run([1.0, 1.0, 1.0])
    for weights, message in (
        ({"energy": y["energy"]}, "'energy' is a function of the solution"),
        ({"end": y["force"]}, "of the shape"),
        ({"end": np.where(y["end"] == y["end"][2], np.nan, 1)}, r"\[2\]\[0\] is no finite number"),
        ({"other": y["end"]}, "must be names of outputs"),
    ):
        with pytest.raises(fb.SceneError, match=message):
            run.vjp(weights)
    with pytest.raises(fb.SceneError, match="'energy' is a function of the solution"):
        run.jacobian()
    assert run.vjp({"force": y["force"]}).any()
    assert run.jacobian("end")["end"].shape == (*y["end"].shape, 3)
    for options, message in (
        ({"scheme": fb.Newmark()}, "Newmark"),
        ({"solver": "petsc"}, "were not compiled"),
        ({"record": fb.Record(times=[0.0, 0.025])}, "t = 0.025 is inside a step"),
    ):
        run = fb.Response(pendulum, dt=0.01, t_end=0.05, **options)
        _, y = run([1.0, 1.0, 1.0])
        with pytest.raises(fb.SceneError, match=message):
            run.vjp({"end": y["end"]})


def test_a_motion_that_failed_has_no_derivatives():
    run = fb.Response(pendulum, dt=0.01, t_end=0.1, max_halvings=0)
    _, y = run([1.0, 1.0, 0.0])
    weights = {"end": y["end"]}
    gradient = run.vjp(weights)
    for x, error in (([1.0, 1.0, 1e4], fb.StepError), ([-1.0, 1.0, 0.0], fb.SceneError)):
        with pytest.raises(error):
            run(x)
        with pytest.raises(fb.SceneError, match="without an error"):
            run.vjp(weights)
        run([1.0, 1.0, 0.0])
        assert (run.vjp(weights) == gradient).all()


def test_numbers_at_the_end_of_their_range_have_no_derivatives():
    def build(x):
        scene = fb.Scene()
        section = fb.Section(EA=1e3, GA=1e3, EI=1.0, rhoA=1.0, rhoI=1e-3)
        bar = scene.add_beam([(0, 0), (1, 0)], section)
        scene.add_joint(fb.Revolute(fb.GROUND, bar.start, damper=fb.Damper(x[0])))
        return scene, {"end": fb.Output("position", bar.end)}

    run = fb.Response(build, dt=0.01, t_end=0.05)
    run([0.0])
    with pytest.raises(
        fb.SceneError, match=r"by x\[0\] at 0.0, since there is no scene at -0.0004"
    ):
        run.jacobian()


def energies(x):
    """An elastic pendulum that is let go."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    section = fb.Section(EA=1e3 * x[0], GA=1e3, EI=x[0], rhoA=1.0, rhoI=1e-2)
    bar = scene.add_beam([(0, 0), (1, 0)], section, elements=3, degree=2)
    scene.pin(bar.start)
    kinds = "kinetic_energy", "strain_energy", "potential_energy"
    total = {"total": lambda solution: solution.energy.total}
    return scene, {kind: fb.Output(kind, scene) for kind in kinds} | total


def test_energies_are_outputs_by_their_names():
    run = fb.Response(energies, dt=0.01, t_end=0.1)
    _, y = run([1.0])
    parts = sum(y[f"{kind}_energy"] for kind in ("kinetic", "strain", "potential"))
    assert abs(parts - y["total"]).max() == 0
    # Nothing is supplied: with the start at rest in the reference configuration, the sum stays zero
    # for all stiffnesses, and so do its derivatives, but not those of its parts.
    J = run.jacobian("kinetic_energy", "strain_energy", "potential_energy")
    largest = max(abs(part).max() for part in J.values())
    assert largest > 1e-3
    assert abs(sum(J.values())).max() < 1e-9 * largest


def test_energies_of_another_scene_or_of_a_motion_are_refused():
    other = fb.Output("kinetic_energy", fb.Scene())
    with pytest.raises(fb.SceneError, match="of the scene of the motion"):
        fb.Response(lambda x: (arm(x)[0], {"T": other}), dt=0.01, t_end=0.02)([1.0, 1.0, 1.0])
    scene = arm([1.0, 1.0, 1.0])[0]
    with pytest.raises(fb.SceneError, match="a node or a joint"):
        fb.Motion(scene, dt=0.01, outputs={"T": fb.Output("kinetic_energy", scene)})


def test_a_structure_that_changes_has_no_derivatives():
    def build(x):
        scene = fb.Scene()
        bar = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e3, GA=1e3, EI=1.0, rhoA=1.0, rhoI=1))
        scene.clamp(bar.start)
        if x[0] > 1:
            scene.add_mass(bar.end, 1.0)
        return scene, {"end": fb.Output("position", bar.end)}

    run = fb.Response(build, dt=0.01, t_end=0.05)
    _, y = run([1.0])
    with pytest.raises(fb.SceneError, match="has another structure"):
        run.vjp(y)
