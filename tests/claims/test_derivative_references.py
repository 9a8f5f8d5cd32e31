"""Derivatives of motions against references that share no code with them."""

import numpy as np
import pytest
from derivatives import Run
from test_adjoint import DATA, SCHEMES

import fx_beam as fb
from fx_beam.responses import response

OF_ALL_SCHEMES = pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)


def gradients(run, y):
    """Derivatives of the last row of all outputs, in both ways; each (rows of outputs, m)."""
    J, backward = run.jacobian(), []
    for name, values in y.items():
        for index in np.ndindex(values.shape[1:]):
            weights = np.zeros_like(values)
            weights[(-1, *index)] = 1.0
            backward.append(run.vjp({name: weights}))
    m = next(iter(J.values())).shape[-1]
    return np.vstack([J[name][-1].reshape(-1, m) for name in y]), np.array(backward)


# -- Complex steps through an oscillator of its own ------------------------------------------------

OSCILLATOR = np.array([2.0, 50.0, 0.8, 1.5, -9.81])  # mass, stiffness, rest, speed, gravity
DT, STEPS = 0.02, 100


def mass_on_spring(x):
    mass, stiffness, rest, speed, gravity = x
    scene = fb.Scene(gravity=(0, gravity))
    body = scene.add_body((1.0, 0.0), mass, 1.0)
    scene.add_force_between(body.centre, (0, 0), spring=fb.Spring(stiffness, rest=rest))
    scene.set_velocity(body, (0.3, speed))
    return scene, {
        "place": fb.Output("position", body.centre),
        "speed": fb.Output("velocity", body.centre),
    }


def oscillator(x, fractions):
    """Position and velocity at the end, of numbers that may be complex.

    The force acts along the mean position and does the work of the spring's energy.
    """
    mass, stiffness, rest, speed, gravity = x
    r0, v0 = np.array([1.0, 0.0], x.dtype), np.array([0.3, speed], x.dtype)
    for dt in DT * np.tile(fractions, STEPS):
        r1 = r0 + dt * v0
        for _ in range(20):  # contracts by k dt^2 / 4m = 0.0025
            length = (np.sqrt((r0 * r0).sum()) + np.sqrt((r1 * r1).sum())) / 2
            force = -stiffness * (length - rest) / length * (r0 + r1) / 2
            v1 = v0 + dt * (force / mass + [0, gravity])
            r1 = r0 + dt * (v0 + v1) / 2
        r0, v0 = r1, v1
    return np.concatenate([r0, v0])


ORDER_FOUR = [fb.MidPoint(order=4), fb.ModifiedMidPoint(order=4)]


@pytest.mark.parametrize("scheme", [*SCHEMES, *ORDER_FOUR], ids=lambda scheme: scheme.name)
def test_derivatives_are_those_of_an_oscillator_by_complex_steps(scheme):
    run = fb.Response(mass_on_spring, scheme, dt=DT, t_end=DT * STEPS)
    _, y = run(OSCILLATOR)
    end, h = oscillator(OSCILLATOR, scheme.fractions), 1e-30
    assert np.hstack([y["place"][-1], y["speed"][-1]]) == pytest.approx(end)
    ends = [oscillator(OSCILLATOR + 1j * h * e, scheme.fractions) for e in np.eye(5)]
    expected = np.array(ends).imag.T / h
    for found in gradients(run, y):
        assert found == pytest.approx(expected, rel=0, abs=1e-9 * abs(expected).max())


def mass_on_bar(x):
    """A mass that moves along a bar without mass; x: stiffness, mass, damping of the scheme."""
    scene = fb.Scene()
    bar = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=x[0], GA=1.0, EI=1.0), elements=1)
    scene.clamp(bar.start)
    scene.fix(bar.end, "y", "rotation")
    scene.add_mass(bar.end, x[1])
    scene.set_velocity(bar.end, (0.1, 0.0))
    scene.add_parameter(fb.Parameter("damping", x[2]))
    return scene, {"place": fb.Output("displacement", bar.end, "x")}


def damped_oscillator(x, order):
    """Its displacement at the end: each step is a linear equation for the increment."""
    stiffness, mass, damping = x
    u, v, before = np.array([0.0, 0.1, 0.0], x.dtype)
    for _ in range(STEPS):
        held = stiffness * damping / 2 * before if order == 2 else 0.0
        K = 2 * mass / DT**2 + stiffness * (1 + damping) / 2
        D = (2 * mass / DT * v - stiffness * u + held) / K
        u, v, before = u + D, 2 * D / DT - v, D
    return u


@pytest.mark.parametrize("order", [1, 2])
def test_derivative_by_the_damping_of_a_scheme_is_that_by_complex_steps(order):
    x, h = np.array([50.0, 0.8, 0.4]), 1e-30
    scheme = fb.EnergyDecaying(damping=fb.Parameter("damping", 0.1), order=order)
    run = fb.Response(mass_on_bar, scheme, dt=DT, t_end=DT * STEPS)
    _, y = run(x)
    assert y["place"][-1] == pytest.approx(damped_oscillator(x, order), rel=1e-10)
    ends = [damped_oscillator(x + 1j * h * e, order) for e in np.eye(3)]
    expected = np.array([ends]).imag / h
    for found in gradients(run, y):
        assert found == pytest.approx(expected, rel=0, abs=1e-9 * abs(expected).max())


def test_the_damping_of_a_scheme_as_a_parameter_must_be_a_number_of_the_scene():
    scheme = fb.EnergyDecaying(damping=fb.Parameter("damping", 0.1))
    scene, _ = mass_on_bar([1.0, 1.0, 0.1])
    scene.parameters["damping"] = lambda t: 0.1 + t
    with pytest.raises(fb.SceneError, match="'damping' varies in time"):
        fb.simulate(scene, scheme, dt=DT, t_end=DT)
    scene, _ = mass_on_spring(OSCILLATOR)
    scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1.0, GA=1.0, EI=1.0), elements=1)
    with pytest.raises(fb.SceneError, match=r"'damping' is not in the scene.*add_parameter"):
        fb.simulate(scene, scheme, dt=DT, t_end=DT)


# -- Reciprocity -----------------------------------------------------------------------------------


def two_loads(x):
    """Two small forces at A and B on a bent frame with a hinge and a body, at rest before."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(**DATA)
    first = scene.add_beam([(0, 0), (1, 0)], section, elements=3)
    second = scene.add_beam([(1, 0), (1.8, 0.4)], section, elements=3)
    body = scene.add_body((1.9, 0.4), 1.0, 0.1, points={"arm": (1.8, 0.4)})
    scene.clamp(first.start)
    scene.add_joint(fb.Revolute(first.end, second.start, spring=fb.Spring(40.0)))
    scene.add_joint(fb.Rigid(second.end, body["arm"]))
    a, b = first.end, body.centre
    scene.add_force(a, lambda t: (0.0, x[0] * np.sin(9 * t)))
    scene.add_force(b, lambda t: (x[1] * np.sin(9 * t), 0.0))
    return scene, {"a": fb.Output("position", a, "y"), "b": fb.Output("position", b, "x")}


@OF_ALL_SCHEMES
def test_a_place_answers_to_a_load_elsewhere_as_that_place_to_a_load_here(scheme):
    start = {"start": lambda scene: fb.static(scene, steps=2)}
    run = fb.Response(two_loads, scheme, dt=0.02, t_end=1.0, **start)
    _, y = run(np.zeros(2))
    assert np.ptp(y["b"]) < 1e-9  # it stays at rest
    J = run.jacobian()
    here, there = J["a"][:, 1], J["b"][:, 0]
    assert abs(here).max() > 1e-4
    assert here == pytest.approx(there, rel=0, abs=1e-8 * abs(here).max())
    assert abs(J["a"][:, 0] - J["b"][:, 1]).max() > 0.1 * abs(here).max()


# -- Roll-up ---------------------------------------------------------------------------------------

LENGTH, ELEMENTS = 2.0, 40


def roll_up(x):
    scene = fb.Scene()
    section = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
    beam = scene.add_beam([(0, 0), (LENGTH, 0)], section, elements=ELEMENTS)
    scene.clamp(beam.start)
    scene.add_moment(beam.end, np.pi * 100.0 / LENGTH * x[0])
    return scene, {"tip": fb.Output("position", beam.end)}


def test_tip_of_a_beam_bent_to_half_a_circle_by_its_load():
    start = {"start": lambda scene: fb.static(scene, steps=8)}
    run = fb.Response(roll_up, dt=0.01, t_end=0.2, **start)
    _, y = run([1.0])
    tips = run.jacobian()["tip"][..., 0]

    # Elements are straight between their ends, each turned by the same angle.
    def tip(load):
        turn = np.pi * load
        bent = np.sin(turn / 2) / np.sin(turn / (2 * ELEMENTS)) * np.exp(1j * turn / 2)
        return LENGTH / ELEMENTS * np.array([bent.real, bent.imag])

    h = 1e-5
    assert y["tip"][0] == pytest.approx(tip(1.0), abs=1e-9)
    discrete = (tip(1 + h) - tip(1 - h)) / (2 * h)
    assert tips[0] == pytest.approx(discrete, abs=1e-6)
    assert discrete == pytest.approx([-LENGTH, -2 * LENGTH / np.pi], rel=2e-3)
    # The start and the load change together, so that it stays in equilibrium.
    assert tips == pytest.approx(np.tile(discrete, (len(tips), 1)), abs=1e-5)
    weights = np.zeros_like(y["tip"])
    weights[-1] = 1.0
    assert run.vjp({"tip": weights}) == pytest.approx([discrete.sum()], abs=1e-5)


# -- Angular momentum ------------------------------------------------------------------------------


def angular_momentum_derivatives(model, state):
    """Derivatives by q and v of the angular momentum about the origin."""
    nodes = len(model.mesh.X)
    places = model.mesh.X[:, :2] + model.mesh.to_nodes(state.q)[:, :2]
    p = model.mesh.to_nodes(model.mass @ state.v)
    turn = np.column_stack([-places[:, 1], places[:, 0], np.ones(nodes)])
    by_q = np.column_stack([p[:, 1], -p[:, 0], np.zeros(nodes)])
    return {"q": model.from_nodes(by_q), "v": model.mass @ model.from_nodes(turn)}


@OF_ALL_SCHEMES
def test_angular_momentum_at_the_end_depends_on_the_start_as_at_the_start(scheme):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0.3)], fb.Section(**DATA), elements=4)
    scene.set_velocity(beam, lambda x, y: (3 * np.sin(5 * y), 2 * x * x), spin=2.0)
    run = Run(scene, scheme, 0.01, 300, taped=True)
    last = angular_momentum_derivatives(run.model, run.end)
    found = run.adjoint({name: row[None] for name, row in last.items()}, np.array([300]))
    expected = angular_momentum_derivatives(run.model, run.start)
    assert abs(last["q"] - expected["q"]).max() > 0.1  # it has moved
    size = abs(expected["v"]).max()
    for name in expected:
        assert found[name] == pytest.approx(expected[name], rel=0, abs=1e-7 * size)


# -- Exact solutions -------------------------------------------------------------------------------


def thrown(x):
    scene = fb.Scene(gravity=(0, x[2]))
    body = scene.add_body((0, 0), 2.0, 0.5)
    scene.set_velocity(body, (x[0], x[1]))
    return scene, {"path": fb.Output("position", body.centre)}


def test_gradient_of_the_error_of_a_thrown_body():
    """A parabola, which steps with mean rates follow exactly."""
    exact = np.array([3.0, 4.0, -9.81])
    run = fb.Response(thrown, dt=0.1, t_end=1.0)
    for x in exact, exact + [0.2, -0.3, 0.5]:
        t, y = run(x)
        by_x = np.array([[t, 0 * t], [0 * t, t], [0 * t, t * t / 2]])
        error = y["path"] - np.einsum("mit,m->ti", by_x, exact)
        found = run.vjp({"path": error})
        expected = np.einsum("mit,jit,j->m", by_x, by_x, x - exact)
        assert found == pytest.approx(expected, abs=1e-9)


AMPLITUDE = 1e-3


def bar(x, elements):
    """A free bar in its first axial mode."""
    scene = fb.Scene()
    section = fb.Section(EA=x[0], GA=1.0, EI=1.0, rhoA=x[1], rhoI=1.0)
    beam = scene.add_beam([(0, 0), (1, 0)], section, elements=elements)
    scene.set_velocity(beam, lambda X, Y: (AMPLITUDE * np.cos(np.pi * X), 0.0))
    return scene, {"end": fb.Output("displacement", beam.end, "x")}


def errors_of_bar(elements):
    """Gradient of the squared error at the exact numbers, and the error of the derivatives."""
    x = np.array([1.0, 1.0])
    run = fb.Response(lambda x: bar(x, elements), dt=0.4 / elements, t_end=4.0)
    t, y = run(x)
    angle = np.pi * np.sqrt(x[0] / x[1])
    exact = -AMPLITUDE * np.sin(angle * t) / angle
    by_angle = -AMPLITUDE * (t * np.cos(angle * t) / angle - np.sin(angle * t) / angle**2)
    by_x = np.outer(by_angle, [angle / (2 * x[0]), -angle / (2 * x[1])])
    error = y["end"] - exact
    gradient = run.vjp({"end": error}) / (len(t) * AMPLITUDE**2)
    return abs(gradient).max(), abs(run.jacobian()["end"] - by_x).max() / abs(by_x).max()


def test_derivatives_of_a_vibrating_bar_converge_with_order_two():
    coarse, fine = (np.array(errors_of_bar(elements)) for elements in (8, 16))
    assert np.log2(coarse / fine) == pytest.approx([2, 2], abs=0.2)
    assert (fine < 0.05).all()


# -- Numbers without derivatives -------------------------------------------------------------------


def test_numbers_that_derivatives_do_not_know_are_refused_by_both_ways(monkeypatch):
    run = fb.Response(mass_on_spring, dt=DT, t_end=5 * DT)
    _, y = run(OSCILLATOR)
    known = response.numbers_of

    def more(setup, state, t0, t1):
        return known(setup, state, t0, t1) | {"colour": setup.model.mass.data[:1].copy()}

    monkeypatch.setattr(response, "numbers_of", more)
    for derive in (run.jacobian, lambda: run.vjp(y)):
        with pytest.raises(fb.SceneError, match=r"x\[0\] changes 'colour'"):
            derive()
