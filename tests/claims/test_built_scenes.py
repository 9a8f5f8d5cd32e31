"""The function that builds the scenes of a `Response`: its derivatives, and what is noticed."""

import copy
import math

import numpy as np
import pytest
from derivatives import difference
from scenes import assert_refused, clamped_bar, guided_body, one_body

import fx_beam as fb
from fx_beam.step.program import PROGRAMS


def pushed(*forces):
    """A body under forces over time, and its speed at the end."""
    scene, body = one_body((0, 0), 1.0, 1.0)
    for force in forces:
        scene.add_force(body.centre, force)
    return scene, {"speed": fb.Output("velocity", body.centre, "x")}


@pytest.mark.parametrize("periods", [10, 100, 3000])
def test_derivative_by_a_frequency_is_exact_for_many_periods(periods, caplog):
    """The speed is a sum over the forces at both ends of steps, as its derivative is."""
    asked = []

    def force(t, x):
        asked.append(t)
        return np.sin(x[0] * t), 0.0

    run = fb.Response(lambda x: pushed(lambda t: force(t, x)), dt=0.2, t_end=1e3)
    frequency = 2 * np.pi * periods / 1e3
    run([frequency])
    J = run.jacobian()["speed"][:, 0]
    times = next(t for t in asked if np.size(t) == 10000).reshape(-1, 2).T  # just inside the steps
    exact = np.append(0.0, 0.1 * np.cumsum((times * np.cos(frequency * times)).sum(axis=0)))
    assert run.stats.difference_reason == ""
    largest = abs(np.cumsum(exact)).max() + 0.2 * times.max()  # of positions, and of a step
    assert J == pytest.approx(exact, abs=1e-12 * largest)
    assert not caplog.records


@pytest.mark.parametrize("size", [1.0, 1e-3, 1e-6])
def test_derivative_by_a_number_that_is_zero_is_the_same_in_small_scenes(size):
    """The rise of an arc, with all lengths scaled."""

    def build(x):
        section = fb.Section(EA=1.0, GA=0.4, EI=1e-3 * size**2)
        curve = fb.arc((0, 0), (size / 2, 0.1 * size + x[0]), (size, 0))
        scene, beam = clamped_bar(curve, section, elements=4, load=(0, -1e-4))
        return scene, {"tip": fb.Output("position", beam.end, "y")}

    run = fb.StaticResponse(build, load_steps=2)
    run([0.0])
    J = run.jacobian()["tip"][-1, 0]
    expected = difference(lambda step: run([step])[1]["tip"][-1], 1e-4 * size)
    assert J == pytest.approx(expected, rel=1e-6)


def test_a_start_by_order_four_has_derivatives_by_a_zero_in_small_scenes():
    """A number of metres moves the hinge of bodies of a millimetre; rates are found by a step."""
    size = 1e-3

    def build(x):
        scene, points = fb.Scene(), {"hinge": (0.3 * size, size + x[0])}
        link = scene.add_body((0, 0), 1.0, 0.1 * size**2, points=points)
        other = scene.add_body((size, 0), 1.0, 0.1 * size**2, points=points)
        scene.add_joint(fb.Revolute(link["hinge"], other["hinge"]))
        scene.set_velocity(link, (0.1 * size, size), spin=1.0)
        scene.make_velocities_compatible()
        return scene, {"speed": fb.Output("velocity", other.centre)}

    run = fb.Response(build, fb.EnergyMomentum(order=4), dt=1e-3, t_end=4e-3)
    run([0.0])
    J = run.jacobian()["speed"][..., 0]
    expected = difference(lambda step: run([step])[1]["speed"], 1e-3 * size)
    assert J == pytest.approx(expected, abs=1e-5 * abs(expected).max())


@pytest.mark.parametrize("power", [2, 3])
def test_a_derivative_that_is_zero_is_not_inaccurate(power, caplog):
    run = fb.Response(lambda x: pushed((x[0] ** power, 0.0)), dt=0.1, t_end=0.2)
    run([0.0])
    assert abs(run.jacobian()["speed"]).max() < 1e-15
    assert not caplog.records


def test_what_differences_lose_is_said(caplog):
    """The first force is known to four digits only; the second jumps."""

    def build(x):
        jump = lambda t: (float(x[1] >= 0.05), 0.0)  # noqa: E731
        return pushed((round(x[0] ** 2, 4), 0.0), jump, (0.0, x[2] ** 2))

    run = fb.Response(build, dt=0.1, t_end=0.2)
    run([0.7, 0.05, 0.3])
    J = run.jacobian()["speed"]
    run([0.7, 0.05, 0.3])
    run.jacobian()
    said = [record.getMessage() for record in caplog.records]
    assert sorted(text.split(" may")[0].split("by ")[1] for text in said) == [
        "x[0] at 0.7",
        "x[1] at 0.05",
    ]
    assert all("of their size" in text and "'loads'" in text for text in said)
    assert J[-1, 0] == pytest.approx(0.2 * 1.4, rel=0.5)


def test_a_build_that_gives_other_numbers_at_the_same_x_is_noticed():
    pulls = iter(range(100))

    def build(x):
        return pushed((x[0] + next(pulls), 0.0))

    for ask in (lambda run, y: run.vjp(y), lambda run, y: run.jacobian()):
        run = fb.Response(build, dt=0.1, t_end=0.2)
        _, y = run([1.0])
        assert_refused("gives other numbers than before at the same x", ask, run, y)


def sort_and_scale(x):
    x.sort()
    x *= 2
    return x


def test_a_build_may_change_its_numbers_in_place():
    """The speed is in proportion to the greater number, and to the inverse of the other."""

    def build(x):
        mass, force = sort_and_scale(x)
        scene, body = one_body((0, 0), mass, 1.0)
        scene.add_force(body.centre, (force, 0.0))
        return scene, {"speed": fb.Output("velocity", body.centre, "x")}

    run = fb.Response(build, dt=0.1, t_end=0.2)
    for _ in range(2):
        assert run([3.0, 2.0])[1]["speed"][-1] == pytest.approx(0.3, rel=1e-12)
        assert run.jacobian()["speed"][-1] == pytest.approx([0.1, -0.15], rel=1e-6)


def test_each_frequency_has_numbers_of_its_own():
    """A build that changes them is called for many frequencies of the same x."""

    def build(x, f):
        x *= 0.5
        laws = {"spring": fb.Spring(x[0], strain_energy=lambda s: s**4), "damper": fb.Damper(0.2)}
        scene, body, _ = guided_body((0, 0), 1.0, 1.0, **laws)
        scene.add_force(body, lambda t: (0.1 * np.cos(2 * np.pi * f * t), 0.0))
        return scene, {"T": fb.Output("period", scene)}

    seen = []

    def first(build):
        seen.extend(build(f).joints[0].slide.spring.stiffness for f in (0.1, 0.1, 0.2))
        family = fb.forced_response(build, (0.1, 0.2), steps=15)
        return family.motions[0]

    fb.PeriodicResponse(build, first)([2.0])
    assert seen == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("make", [fb.Response, fb.StaticResponse])
def test_more_elements_than_before_are_set_up_anew(make):
    def build(x):
        section = fb.Section(EA=1e4, GA=1e4, EI=20.0, rhoA=0.5)
        scene, beam = clamped_bar((1, 0), section, elements=int(x[0]), gravity=(0, -9.81))
        return scene, {"tip": fb.Output("position", beam.end)}

    options = {"dt": 0.01, "t_end": 0.05} if make is fb.Response else {"load_steps": 2}
    run = make(build, **options)
    alone = make(build, **options)([6])[1]["tip"]
    PROGRAMS.clear()  # which this one has made
    for elements in (4, 4, 6):
        _, y = run([elements])
    assert (y["tip"] == alone).all()
    if make is fb.Response:
        assert run.stats.setup_reason == "another number of nodes"


def test_a_motion_of_which_something_takes_floats_is_found_without_slopes():
    """Derivatives in the first motion, then in one where a mass takes a plain number only."""

    def build(x):
        scene, outputs = pushed((1.0, 0.0))
        mass = x[0] ** 2 if x[0] < 1 else math.exp(x[0])
        scene.add_mass(scene.bodies[0].centre, mass)
        return scene, outputs

    run = fb.Response(build, dt=0.1, t_end=0.2)
    for x, mass in (([0.5], 0.25), ([2.0], math.exp(2.0)), ([0.7], 0.49)):
        _, y = run(x)
        assert y["speed"][-1] == pytest.approx(0.2 / (1 + mass), rel=1e-12)
        J, slope = run.jacobian()["speed"][-1, 0], math.exp(x[0]) if x[0] > 1 else 2 * x[0]
        assert J == pytest.approx(-0.2 * slope / (1 + mass) ** 2, rel=1e-6)
    assert "float()" in run.stats.difference_reason


def test_functions_of_a_scene_that_is_copied_keep_their_slopes():
    def build(x):
        scene, _ = pushed(lambda t: (x[0] * np.cos(t), 0.0))
        scene = copy.copy(scene)
        return scene, {"speed": fb.Output("velocity", scene.bodies[0].centre, "x")}

    run = fb.Response(build, dt=0.01, t_end=0.2)
    for x in ([0.5], [0.7]):
        _, y = run(x)
        assert run.jacobian()["speed"][-1, 0] == pytest.approx(y["speed"][-1] / x[0], rel=1e-12)
    assert run.stats.difference_reason == ""


def test_the_rate_of_a_slide_has_derivatives_by_its_axis_also_if_the_scene_has_slopes():
    """A body falls along a guide, from the second call on in a scene with slopes."""

    def build(x):
        axis = np.cos(x[0]), np.sin(x[0])
        scene, body, rail = guided_body((0, 0), 1.0, 1.0, axis=axis, gravity=(0, -10.0))
        return scene, {"rate": fb.Output("rate", rail)}

    run = fb.Response(build, dt=0.1, t_end=0.2)
    for _ in range(2):
        assert run([0.3])[1]["rate"][-1] == pytest.approx(-2 * np.sin(0.3))
        assert run.jacobian()["rate"][-1, 0] == pytest.approx(-2 * np.cos(0.3))
        assert run.vjp({"rate": np.ones(3)})[0] == pytest.approx(-3 * np.cos(0.3))
    assert run.stats.difference_reason == ""


def test_a_number_in_ufl_that_is_no_parameter_is_refused_also_beside_others():
    """UFL must not be asked for the value of its symbols, which takes it for ever."""

    def build(x):
        scene, outputs = pushed((x[1], 0.0))
        spring = fb.Spring(strain_energy=lambda r: x[0] * (r - 1) ** 4)
        scene.add_force_between(scene.bodies[0].centre, (1, 1), spring=spring)
        return scene, outputs

    run = fb.Response(build, dt=0.1, t_end=0.2)
    run([1.0, 1.0])
    assert_refused("Numbers in it that change must be fb.Parameter", run.jacobian)


def oscillator():
    """A body on a spring, whose stiffness is a parameter; and its slide."""
    k = fb.Parameter("k", 1.0)
    spring = fb.Spring(strain_energy=lambda s: k * s**2 / 2)
    scene, body, joint = guided_body((0, 0), 1.0, 1.0, spring=spring)
    scene.set_velocity(body, (1.0, 0.0))
    return scene, joint


@pytest.mark.parametrize("kind", [fb.Response, fb.ModalResponse])
def test_a_scene_that_all_calls_have_may_get_its_parameters_in_each(kind):
    """Also where slopes are compared with differences again, in the third call."""
    scene, joint = oscillator()
    outputs = {"slide": fb.Output("slide", joint)}

    def build(x):
        scene.parameters["k"] = x[0]
        return scene if kind is fb.ModalResponse else (scene, outputs)

    options = {"n": 1} if kind is fb.ModalResponse else {"dt": 0.01, "t_end": 1.0}
    run = kind(build, **options)
    for k in (4.0, 5.0, 6.0, 7.0):
        run([k])
        J, w = run.jacobian(), k**0.5
        if kind is fb.ModalResponse:
            assert J[0, 0] == pytest.approx(1 / (2 * w), rel=1e-9)
        else:
            exact = (np.cos(w) / w - np.sin(w) / w**2) / (2 * w)
            assert J["slide"][-1, 0] == pytest.approx(exact, rel=1e-3)


class Pull:
    """A force that all scenes have in common, of a size that `build` sets."""

    size, takes_floats = 0.0, False

    def __call__(self, t):
        return (float(self.size) if self.takes_floats else self.size * np.cos(t)), 0.0


@pytest.mark.parametrize("takes_floats", [False, True])
def test_a_function_that_all_scenes_have_is_asked_anew_in_each(takes_floats):
    """By slopes, and by differences where the function takes floats alone."""
    pull = Pull()
    pull.takes_floats = takes_floats

    def build(x):
        pull.size = 1.0 * x[0]
        return pushed(pull, (0.0, x[1]))

    run = fb.Response(build, dt=0.1, t_end=0.2)
    for x in ([0.5, 1.0], [0.7, 2.0], [0.9, 1.0]):
        _, y = run(x)
        J = run.jacobian()["speed"][-1]
        assert J == pytest.approx([y["speed"][-1] / x[0], 0.0], rel=1e-8, abs=1e-12)
    assert bool(run.stats.difference_reason) == takes_floats


def length_without_slopes(scene, x):
    """The distance of two nodes, which NumPy computes without slopes: x[0]."""
    ends = [scene.add_body((place, 1), mass=1.0, inertia=1.0).centre for place in (0.0, x[0])]
    for end in ends:
        scene.clamp(end)
    return np.hypot(*np.array([ends[1].x - ends[0].x, ends[1].y - ends[0].y]))


def small_parameter(scene, length, large):
    """Beside a large one: the joint whose spring it is, and what is asked of that."""
    k, other = fb.Parameter("k", 1e-2 * length), fb.Parameter("other", large)
    energies = (lambda z: 1e4 * k * z**2), (lambda z: 1e-6 * other * z**2)
    joints = []
    for place, energy in enumerate(energies):
        body = scene.add_body((place, 0), mass=1.0, inertia=0.1)
        spring = fb.Spring(1.0, strain_energy=energy)
        joint = fb.Prismatic(fb.GROUND, body.centre, axis=(0, 1), spring=spring)
        joints.append(scene.add_joint(joint))
    return joints[0], "slide"


def small_mass(scene, length, large):
    """Joint of a rotor beside a heavy body, and the output that is asked of it."""
    scene.clamp(scene.add_body((3, 0), large, 0.1).centre)
    rotor = scene.add_body((0.5, 0), 1e-3, 1e-7 * length**2)
    spring = fb.Spring(1e-3, rest=0.5)
    return scene.add_joint(fb.Revolute(fb.GROUND, rotor.centre, spring=spring)), "angle"


@pytest.mark.parametrize("large", [1.0, 1e4, 1e9])
@pytest.mark.parametrize("small", [small_parameter, small_mass])
def test_slopes_that_are_lost_are_missed_also_beside_large_numbers(small, large):
    """Parameters, masses and others in one list may have different units."""

    def build(x):
        scene = fb.Scene(gravity=(0, -9.81))
        joint, quantity = small(scene, length_without_slopes(scene, x), large)
        return scene, {"y": fb.Output(quantity, joint)}

    run = fb.Response(build, dt=2e-3, t_end=0.1)
    run([1.0])
    J = run.jacobian()["y"][-1, 0]
    assert "x[0]" in run.stats.difference_reason
    expected = difference(lambda step: run([1 + step])[1]["y"][-1], 1e-4)
    assert pytest.approx(expected, rel=1e-6) == J


@pytest.mark.parametrize("kind", [fb.Response, fb.StaticResponse])
def test_beams_may_be_equal_where_derivatives_are_taken(kind):
    """As at the start of a design. Their sections are objects of their own, as are their drags."""

    def build(x):
        scene, start = fb.Scene(gravity=(0, -9.81)), (0, 0)
        for i in range(2):
            section = fb.Section(EA=2e4, GA=1e4, EI=20 * x[i], rhoA=0.5, rhoI=1e-3)
            beam = scene.add_beam([start, (i + 1, 0)], section, elements=2)
            scene.add_drag(beam, linear=0.1 * x[i])
            start = beam.end
        scene.clamp(scene.beams[0].start)
        return scene, {"end": fb.Output("position", start, "y")}

    steps = {"load_steps": 2} if kind is fb.StaticResponse else {"dt": 0.01, "t_end": 0.1}
    run, h = kind(build, **steps), 1e-4
    run([1.0, 1.0])
    J = run.jacobian()["end"][-1]
    for i, unit in enumerate(h * np.eye(2)):
        below, above = (run(np.ones(2) + change)[1]["end"][-1] for change in (-unit, unit))
        assert J[i] == pytest.approx((above - below) / (2 * h), rel=1e-6)
