"""Parameters: numbers in functions of the user that change without compilation."""

import copy
import operator

import ufl

import numpy as np
import pytest
from scenes import assert_refused, guided_body, held_body, pinned_bar

import fx_beam as fb
from fx_beam import library_cache
from fx_beam.step.program import PROGRAMS

EA, GA, EI = 4e3, 2e3, 5.0
INERTIA = {"rhoA": 1.0, "rhoI": 0.01}


def energy_of(k, **options):
    """A section with EA, GA and EI in proportion to a parameter, 1 for the given ones."""

    def energy(e, g, c):
        return k / 2 * (EA * e**2 + GA * g**2 + EI * c**2)

    return fb.Section(strain_energy=energy, **INERTIA, **options)


def swinging(section=None, elements=4):
    """A heavy arm on a pin, and its end."""
    section = section or fb.Section(EA, GA, EI, **INERTIA)
    return pinned_bar((1, 0), section, elements=elements, degree=1, gravity=(0.0, -9.81))


def moved(scene, **options):
    """Displacements of a short motion."""
    return fb.simulate(scene, dt=0.01, t_end=0.2, **options).q


# -- They are the numbers ------------------------------------------------------------------------


def along_members(number):
    """A stored energy, the update of its internal variable, and a virtual work."""

    def relax(old, strains0, strains, dt):
        rate = number("update") * dt
        return [(old[0] + rate * strains[2]) / (1 + rate)]

    def energy(e, g, c, a):
        return number("energy") / 2 * (EA * e**2 + GA * g**2 + EI * c**2) + EI * (c - a[0]) ** 2 / 2

    internal = fb.InternalVariables(("dashpot",), relax)
    scene, _ = swinging(fb.Section(strain_energy=energy, internal=internal, **INERTIA))
    scene.add_virtual_work(lambda step: -number("work") * ufl.dot(step.v, step.virtual_u))
    return scene


def at_points(number):
    """A spring, a damper, friction, an obstacle and a force between points."""
    scene, arm = swinging()
    scene.add_force_between(
        arm.end,
        (0.5, 2),
        spring=fb.Spring(strain_energy=lambda x: 10 * number("spring") * x**2, rest=1.5),
        damper=fb.Damper(law=lambda rate: number("damper") * rate),
        friction=fb.SmoothFriction(lambda rate: number("friction") + 0 * rate, speed=0.1),
        force=lambda r, rate, t: number("force") * r,
    )
    ceiling = fb.Line((0, 0.01), normal=(0, -1))
    scene.add_contact(arm.end, ceiling, energy=lambda d: 1e3 * number("obstacle") * d**2)
    return scene


NAMES = {
    along_members: ("update", "energy", "work"),
    at_points: ("spring", "damper", "friction", "force", "obstacle"),
}
every_function = pytest.mark.parametrize("build", NAMES, ids=lambda build: build.__name__)


def valued(build, value=1.0, **others):
    """A scene with parameters of one value, but for others."""
    return build(lambda name: fb.Parameter(name, others.get(name, value)))


@every_function
def test_other_values_compile_nothing_and_are_the_numbers_that_would_be_compiled_in(
    build, monkeypatch
):
    first = moved(valued(build))
    with monkeypatch.context() as patch:
        patch.setattr(library_cache, "_built", lambda *_: pytest.fail("compiled"))
        computed, scene = moved(valued(build, 2.5)), valued(build)
        for name in NAMES[build]:
            assert abs(moved(valued(build, **{name: 2.5})) - first).max() > 1e-4, name
            scene.parameters[name] = 2.5
        changed = moved(scene)
    assert (changed == computed).all()
    assert computed == pytest.approx(moved(build(lambda name: 2.5)), abs=1e-9)


def ended(scene):
    return scene, {"end": fb.Output("position", scene.beams[0].end)}


@pytest.mark.parametrize("part", ["spring", "damper"])
def test_laws_of_joints_may_divide_by_a_parameter(part):
    def rolled(scale):
        changes = {
            "spring": fb.Spring(strain_energy=lambda x: 10 * (x / scale) ** 2),
            "damper": fb.Damper(law=lambda rate: 3 * ufl.tanh(rate / scale)),
        }
        law = {part: changes[part]}
        scene, block, _ = guided_body((0, 0), 1.0, 0.1, **law)
        scene.set_velocity(block, (1.0, 0.0))
        return moved(scene)

    assert abs(rolled(fb.Parameter("scale", 0.3)) - rolled(0.3)).max() < 1e-14
    assert_refused("must be finite", lambda: rolled(fb.Parameter("scale", 0.0)))


@every_function
def test_scenes_that_differ_in_parameters_only_share_their_program(build):
    run = fb.Response(lambda x: ended(valued(build, float(x[0]))), dt=0.01, t_end=0.2)
    run([1.0])
    _, y = run([2.5])
    assert run.stats.setup_reason == ""
    scene = valued(build, 2.5)
    end = fb.simulate(scene, dt=0.01, t_end=0.2).position(scene.beams[0].end)
    assert (y["end"] == end).all()
    if build is at_points:
        PROGRAMS.clear()  # others may have the same numbers
        compiled_in = fb.Response(lambda x: ended(build(lambda name: x[0])), dt=0.01, t_end=0.2)
        compiled_in([1.0])
        compiled_in([2.5])
        assert "of your own differs in more than parameters" in compiled_in.stats.setup_reason


def of_all_symbols(step):
    vector = step.u0 + step.Du + step.u + step.v + step.X + step.t0 + step.u_before
    scalar = step.psi0 + step.Dpsi + step.psi + step.omega + step.psi_before + step.h
    scalar += step.t + step.dt + step.load_factor + step.memory
    along = vector + step.prime(step.u)
    return 1e-3 * (ufl.dot(along, step.virtual_u) + scalar * step.virtual_psi)


def test_functions_are_compared_by_what_they_give():
    """Also where they use all symbols of a step."""
    terms = [
        of_all_symbols,
        lambda step: of_all_symbols(step) - step.prime(step.psi) * step.virtual_psi,
        lambda step: of_all_symbols(step) - step.prime(step.psi0) * step.virtual_psi,
    ]

    def build(x):
        scene, _ = swinging(elements=1)
        scene.add_virtual_work(terms[int(x[0])])
        return ended(scene)

    run = fb.Response(build, dt=0.01, t_end=0.02)
    reasons = [(run([k]), run.stats.setup_reason)[1] for k in (0, 0, 1, 1, 2)]
    assert [bool(reason) for reason in reasons] == [True, False, True, False, True]


# -- Functions of time ---------------------------------------------------------------------------


def pulse(t):
    return 1 + 0.5 * np.sin(30 * t)


def jump(t):
    return 1.0 if t < 0.1 else 3.0


def test_the_work_of_a_jump_is_the_change_of_the_stored_energy():
    scene, ball = held_body((1, 0), mass=2.0, inertia=0.1)
    k = fb.Parameter("k", jump)
    scene.add_force_between(
        ball, (0, 0), spring=fb.Spring(strain_energy=lambda x: 25 * k * x**2, rest=0.5)
    )
    solution = fb.simulate(scene, dt=0.001, t_end=0.2)
    before = int(np.searchsorted(solution.t, 0.1 - 1e-9))
    assert solution.energy.work[before] == 0
    stretch = solution.position(ball)[before, 0] - 0.5
    assert solution.energy.work[-1] == pytest.approx(50 * stretch**2, rel=1e-9)
    assert solution.parameter("k")[[before, before + 1]].tolist() == [1.0, 3.0]


def test_resultants_are_those_of_the_values_in_the_run():
    k = fb.Parameter("k", pulse)
    scene, arm = swinging(energy_of(k))
    solution = fb.simulate(scene, dt=0.001, t_end=0.1)
    scene.parameters["k"] = 100.0
    constant = solution.resultants(arm).M
    scene.parameters["k"] = pulse
    assert constant == pytest.approx(
        fb.simulate(scene, dt=0.001, t_end=0.1).resultants(arm).M, abs=1e-12
    )
    rows = solution.t_level
    curvature = constant / (EI * pulse(rows))[:, None]
    nodes = solution.nodes_of_beam[arm.name]
    turn = np.diff(solution.q[:, nodes, 2], axis=1) * 4
    assert curvature[1:] == pytest.approx((turn[1:] + turn[:-1]) / 2, abs=1e-9)


# -- Inputs ---------------------------------------------------------------------------------------


def test_an_input_sets_a_parameter():
    valve = fb.Parameter("valve", fb.Input("opening"))

    def build():
        scene, arm = swinging(energy_of(1 + valve))
        scene.add_virtual_work(lambda step: -3 * valve * ufl.dot(step.v, step.virtual_u))
        return scene, arm

    scene, arm = build()
    as_input = fb.simulate(scene, dt=0.01, t_end=0.2, inputs={"opening": lambda t: 5 * t})
    motion = fb.Motion(scene, dt=0.01, record=fb.Record())
    for n in range(1, 21):
        motion.step({"opening": 0.05 * n})
    stepped = motion.solution()
    assert stepped.q == pytest.approx(as_input.q, abs=1e-11)
    assert abs(stepped.energy.balance_error).max() < 1e-12
    assert stepped.parameter("valve") == pytest.approx(5 * stepped.t, abs=1e-12)
    assert stepped.resultants(arm).M == pytest.approx(as_input.resultants(arm).M, abs=1e-9)


@pytest.mark.parametrize("value", [2.5, np.array([2.5]), [2.5], (2.5,)], ids=repr)
def test_a_value_of_any_shape_is_shown(value):
    scene, _ = swinging(energy_of(fb.Parameter("stiffness", 1.0)))
    scene.parameters["stiffness"] = value
    assert str(scene.parameters) == "stiffness = 2.5"


def test_a_force_between_points_is_a_number_or_an_input():
    scene, arm = swinging()
    by_number, by_input, by_law = (copy.copy(scene) for _ in range(3))
    for built, force in ((by_number, 3.0), (by_input, fb.Input("pull"))):
        built.add_force_between(built.beams[0].end, (0.5, 2), force=force)
    by_law.add_force_between(by_law.beams[0].end, (0.5, 2), force=lambda r, rate, t: 3.0 + 0 * r)
    expected = moved(by_law)
    assert moved(by_number) == pytest.approx(expected, abs=1e-12)
    assert moved(by_input, inputs={"pull": 3.0}) == pytest.approx(expected, abs=1e-12)


def test_linear_systems_have_the_derivative_by_inputs_that_set_parameters():
    scene, arm = swinging(energy_of(1 + fb.Parameter("k", fb.Input("u")) ** 2))
    scene.fix(arm.start, "rotation")
    output = {"y": fb.Output("position", arm.end)}
    state = fb.static(scene, inputs={"u": 1.0})
    system = fb.linearise(scene, state, outputs=output)
    assert system.inputs == ("u",)
    gain = system.D - system.C @ np.linalg.solve(system.A, system.B)
    h = 1e-4
    ahead, back = (fb.static(scene, inputs={"u": 1 + s * h}).position(arm.end)[-1] for s in (1, -1))
    assert gain[:, 0] == pytest.approx((ahead - back) / (2 * h), rel=1e-5)


# -- Scenes and solutions ------------------------------------------------------------------------


K = fb.Parameter("k", 2.0)
REFUSED = {
    "no parameter 'q'; it has \\['k'\\]": lambda scene: operator.setitem(
        scene.parameters, "q", 1.0
    ),
    "parameter 'k': 'stiff' has the wrong type": lambda scene: operator.setitem(
        scene.parameters, "k", "stiff"
    ),
    "parameter 'k': its value is .*, not a number": lambda scene: operator.setitem(
        scene.parameters, "k", K
    ),
    "the parameter 'k' = 3 is 2 elsewhere": lambda scene: scene.add_beam(
        [(0, 0), (1, 0)], energy_of(fb.Parameter("k", 3.0)), elements=1
    ),
    "k.* is a UFL symbol, not a number: use ufl.sqrt": lambda scene: fb.Section(
        strain_energy=lambda e, g, c: np.sqrt(float(K)) * e * g * c
    ),
    "a Parameter of your own": lambda scene: fb.Section(EA=lambda fraction: K, GA=1.0, EI=1.0),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_is_no_value_or_no_place_for_one_is_refused(message):
    scene, _ = swinging(energy_of(K))
    assert_refused(message, lambda: REFUSED[message](scene))


@pytest.mark.parametrize("scheme", [fb.Newmark(), fb.HHT()], ids=lambda s: s.name)
def test_the_work_of_parameters_is_of_second_order_by_newmarks_family(scheme):
    """Of a spring that stiffens: its balance tells the error."""

    def error(dt):
        k = fb.Parameter("k", lambda t: 20.0 + 30.0 * t)
        spring = fb.Spring(1.0, rest=-0.2, strain_energy=lambda x: k * x**2 / 2)
        scene, body, _ = guided_body((0, 0), 1.0, 1.0, spring=spring)
        energy = fb.simulate(scene, scheme, dt=dt, t_end=1.0).energy
        return abs(energy.balance_error[-1])

    assert error(0.01) > 3.5 * error(0.005) > 3.5**2 * error(0.0025)


def test_small_motions_about_a_state_have_the_parameters_of_its_time():
    """x'' + c(t) x' + k(t) x = F with k = 4 + 12 t and c = t, at t = 1: 4 rad/s, and F / 16."""
    k, c = fb.Parameter("k", lambda t: 4 + 12 * t), fb.Parameter("c", lambda t: t)
    scene, body = held_body((0, 0), 1.0, 0.0, "y", "rotation")
    spring = fb.Spring(rest=1.0, strain_energy=lambda x: k * x**2 / 2)
    damper = fb.Damper(law=lambda rate: c * rate)
    scene.add_force_between(body, (-1, 0), spring=spring, damper=damper)

    def check(state):
        (root,) = fb.modes(scene, state, n=1).eigenvalues
        assert root == pytest.approx(-0.5 + 15.75**0.5 * 1j, rel=1e-6)
        response = fb.frequency_response(scene, (body, (1.0, 0.0)), body, [0.0], state)
        assert response.values[0, 0] == pytest.approx(1 / 16, rel=1e-6)

    check(fb.simulate(scene, dt=0.1, t_end=1.0))
    scene.add_force(body, (8.0, 0.0))
    check(fb.static(scene, load_steps=1, t=1.0))
