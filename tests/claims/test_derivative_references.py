"""Derivatives of motions against references that share no code with them."""

import numpy as np
import pytest
from jointed import MEMBER
from scenes import assert_refused, clamped_bar, hinged_body, one_bar, one_body, pinned_bar

import fx_beam as fb

SCHEMES = [
    fb.EnergyMomentum(),
    fb.EnergyMomentum(order=4),
    fb.MidPoint(),
    fb.MidPoint(order=4),
    fb.ModifiedMidPoint(),
    fb.ModifiedMidPoint(order=4),
    fb.EnergyDecaying(),
]
DATA = {"EA": 1e4, "GA": 1e4, "EI": 100.0, "rhoA": 1.0, "rhoI": 0.1}


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
DT, STEPS = 0.02, 50


def mass_on_spring(x):
    mass, stiffness, rest, speed, gravity = x
    scene, body = one_body((1.0, 0.0), mass, 1.0, gravity=(0, gravity))
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


@pytest.mark.parametrize("scheme", SCHEMES, ids=lambda scheme: scheme.name)
def test_derivatives_are_those_of_an_oscillator_by_complex_steps(scheme):
    run = fb.Response(mass_on_spring, scheme, dt=DT, t_end=DT * STEPS)
    _, y = run(OSCILLATOR)
    end, h = oscillator(OSCILLATOR, scheme.fractions), 1e-30
    assert np.hstack([y["place"][-1], y["speed"][-1]]) == pytest.approx(end)
    ends = [oscillator(OSCILLATOR + 1j * h * e, scheme.fractions) for e in np.eye(5)]
    expected = np.array(ends).imag.T / h
    for gradient in gradients(run, y):
        assert gradient == pytest.approx(expected, rel=0, abs=1e-9 * abs(expected).max())


def mass_on_bar(x):
    """A mass that moves along a bar without mass; x: stiffness, mass, damping of the scheme."""
    scene, bar = clamped_bar((1, 0), fb.Section(EA=x[0], GA=1.0, EI=1.0), elements=1)
    scene.fix(bar.end, "y", "rotation")
    scene.add_mass(bar.end, x[1])
    scene.set_velocity(bar.end, (0.1, 0.0))
    scene.add_parameter(fb.Parameter("damping", x[2]))
    return scene, {"place": fb.Output("displacement", bar.end, "x")}


def damped_oscillator(x):
    """Its displacement at the end: each step is a linear equation for the increment."""
    stiffness, mass, damping = x
    u, v, before = np.array([0.0, 0.1, 0.0], x.dtype)
    for _ in range(STEPS):
        held = stiffness * damping / 2 * before
        K = 2 * mass / DT**2 + stiffness * (1 + damping) / 2
        D = (2 * mass / DT * v - stiffness * u + held) / K
        u, v, before = u + D, 2 * D / DT - v, D
    return u


def test_derivative_by_the_damping_of_a_scheme_is_that_by_complex_steps():
    x, h = np.array([50.0, 0.8, 0.4]), 1e-30
    scheme = fb.EnergyDecaying(damping=fb.Parameter("damping", 0.1))
    run = fb.Response(mass_on_bar, scheme, dt=DT, t_end=DT * STEPS)
    _, y = run(x)
    assert y["place"][-1] == pytest.approx(damped_oscillator(x), rel=1e-10)
    ends = [damped_oscillator(x + 1j * h * e) for e in np.eye(3)]
    expected = np.array([ends]).imag / h
    for gradient in gradients(run, y):
        assert gradient == pytest.approx(expected, rel=0, abs=1e-9 * abs(expected).max())


def test_the_damping_of_a_scheme_as_a_parameter_must_be_a_number_of_the_scene():
    scheme = fb.EnergyDecaying(damping=fb.Parameter("damping", 0.1))
    scene, _ = mass_on_bar([1.0, 1.0, 0.1])
    scene.parameters["damping"] = lambda t: 0.1 + t
    assert_refused("'damping' varies in time", fb.simulate, scene, scheme, dt=DT, t_end=DT)
    scene, _ = mass_on_spring(OSCILLATOR)
    scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1.0, GA=1.0, EI=1.0), elements=1)
    with pytest.raises(fb.SceneError, match=r"'damping' is not in the scene.*add_parameter"):
        fb.simulate(scene, scheme, dt=DT, t_end=DT)


# -- Nodes that slide ------------------------------------------------------------------------------


def test_a_bead_on_a_turning_rod_has_the_derivatives_of_cosh():
    """Its place s0 cosh(w t) by s0 and w; the error of the steps is of order 2."""

    def build(x):
        stiff = fb.Section(EA=1e9, GA=1e9, EI=1e8, rhoA=1e-3, rhoI=1e-4)
        scene, rod = one_bar((4, 0), stiff, elements=4)
        scene.add_joint(fb.Revolute(fb.GROUND, rod.start, motor=lambda t: x[1] * t))
        bead = scene.add_body((x[0], 0), mass=1.0, inertia=0.1)
        joint = scene.add_joint(fb.Slider(rod, bead.centre))
        scene.set_velocity(rod, lambda a, b: (-x[1] * b, x[1] * a), spin=x[1])
        scene.set_velocity(bead.centre, (0.0, x[0] * x[1]))
        return scene, {"slide": fb.Output("slide", joint)}

    s0, w, errors = 0.7, 2.0, []
    exact = np.array([np.cosh(w), s0 * np.sinh(w)])
    for dt in (0.04, 0.02):
        run = fb.Response(build, fb.EnergyMomentum(), dt=dt, t_end=1.0)
        run([s0, w])
        errors.append(run.jacobian()["slide"][-1] / exact - 1)
    assert errors[0] / errors[1] == pytest.approx([4, 4], abs=0.2)
    assert abs(errors[1]).max() < 8e-3


# -- Work and losses -------------------------------------------------------------------------------


def with_work(build):
    """A scene with its work, dissipated and total energy as outputs."""

    def observed(x):
        scene = build(x)
        quantities = {"work": "work", "lost": "dissipated_energy", "total": "total_energy"}
        return scene, {name: fb.Output(quantity, scene) for name, quantity in quantities.items()}

    return observed


def test_work_on_a_free_body_and_what_its_drag_takes():
    """W = F^2 t^2 / 2m; and of steps with drag the factor of the speed, (1 - a)/(1 + a)."""

    def build(x):
        scene, pushed = one_body((0, 0), mass=x[0], inertia=1.0)
        scene.add_force(pushed.centre, (x[1], 0.0))
        slowed = scene.add_body((0, 1), mass=x[0], inertia=1.0)
        scene.set_velocity(slowed.centre, (0.0, 2.0))
        scene.add_drag(slowed.centre, linear=x[2])
        return scene

    m, F, c = x = np.array([2.0, 3.0, 0.5])
    run = fb.Response(with_work(build), dt=0.1, t_end=2.0)
    t, y = run(x)
    J, n = run.jacobian(), np.arange(len(t))
    work = F**2 * t**2 / (2 * m)
    assert y["work"] == pytest.approx(work, abs=1e-9)
    expected = np.column_stack([-work / m, 2 * work / F, 0 * t])
    assert J["work"] == pytest.approx(expected, abs=1e-9)
    a = c * 0.1 / (2 * m)
    left = ((1 - a) / (1 + a)) ** (2 * n)
    assert y["lost"] == pytest.approx(2 * m * (1 - left), abs=1e-9)
    by_a = 8 * n * m * left / (1 - a**2)
    expected = np.column_stack([2 * (1 - left) - by_a * a / m, 0 * t, by_a * a / c])
    assert J["lost"] == pytest.approx(expected, abs=1e-8)


def damped(x):
    """A beam and a body on a damped hinge, with drag, under loads that vary."""
    section = fb.Section(EA=1e4, GA=5e3, EI=20 * x[0], rhoA=x[1], rhoI=1e-2)
    scene, beam = pinned_bar((x[2], 0.2), section, elements=2, gravity=(0.0, -9.81))
    place = {"pin": (x[2], 0.2)}
    body = scene.add_body((x[2] + 0.2, 0.0), mass=x[1], inertia=0.02, points=place)
    scene.add_joint(fb.Revolute(beam.end, body["pin"], damper=fb.Damper(0.3 * x[0])))
    scene.add_drag(body.centre, linear=0.2 * x[2], quadratic=0.1)
    scene.add_force(beam.end, lambda t: (20 * t, 5 * x[1]))
    return scene


X = np.array([1.1, 0.9, 1.05])


def test_work_goes_on_from_a_solution_that_does_not_depend_on_x():
    def build(x):
        return damped([*x, X[2]])

    first = fb.simulate(build(X[:2]), dt=0.01, t_end=0.05, progress=False)
    whole = fb.Response(with_work(build), dt=0.01, t_end=0.1)
    rest = fb.Response(with_work(build), dt=0.01, t_end=0.1, start=first)
    y, y_rest = whole(X[:2])[1], rest(X[:2])[1]
    for key in ("work", "lost"):
        assert y_rest[key] == pytest.approx(y[key][5:], abs=1e-12)
        J, h = rest.jacobian(key)[key], 1e-4
        # The energy that the state has more with other numbers came from outside: it is work.
        assert key == "work" or (J[0] == 0).all()
        low, high = (rest([X[0] + side * h, X[1]])[1][key] for side in (-1, 1))
        assert J[:, 0] == pytest.approx((high - low) / (2 * h), abs=1e-6 * abs(J).max())
        rest(X[:2])


def rubbing(x):
    """An arm on a pin with friction that follows the force there."""
    friction = fb.Coulomb(0.3 * x[1], 300.0, radius=0.1)
    scene, arm, _ = hinged_body(
        (0.4, 0), x[0], 0.2, {"pin": (0, 0)}, friction=friction, gravity=(0, -9.81)
    )
    return scene


def followed(x):
    """A body that a follower force pushes."""
    scene, body = one_body((0, 0), x[0], 0.2)
    scene.add_force(body.centre, (x[1], x[2]), follower=True)
    scene.set_velocity(body, (0.0, 0.0), spin=1.0)
    return scene


def bending(x):
    """A cantilever that bends itself."""
    scene, beam = clamped_bar((1, 0), fb.Section(**DATA | {"EI": 10 * x[0]}), elements=2)
    scene.add_natural_strain(beam, curvature=x[1])
    return scene


@pytest.mark.parametrize(
    ("build", "options", "key", "message"),
    [
        (followed, {"scheme": fb.MidPoint()}, "work", "not exact with MidPoint"),
        (rubbing, {"scheme": fb.MidPoint()}, "lost", "the force of a joint. Use EnergyM"),
        (damped, {"scheme": fb.EnergyDecaying(), "memory": 1e3}, "lost", "more memory"),
        (bending, {"start": fb.static}, "work", "has none where natural strains do work"),
    ],
)
def test_work_and_losses_without_derivatives_are_refused_by_their_names(
    build, options, key, message
):
    run = fb.Response(with_work(build), **({"dt": 0.01, "t_end": 0.1} | options))
    _, y = run(X)
    assert_refused(message, lambda: run.vjp({key: np.ones_like(y[key])}))
    assert_refused(message, run.jacobian, key)
    assert run.jacobian("total")["total"].shape == (len(y["total"]), 3)


# -- What is said, and refused ---------------------------------------------------------------------


def touching(x):
    """Two beams; one falls with its tip on the other and slides along it."""
    scene, below = one_bar((2, 0), MEMBER, elements=4)
    above = scene.add_beam([(0.7, 0.11), (1.1, 1.2)], MEMBER, elements=2)
    friction = fb.Coulomb(0.2, 1e3)
    scene.add_contact(above, below, stiffness=1e4 * x[1], radius=0.05, friction=friction)
    scene.set_velocity(above, (0.3, -2.0 * x[0]))
    return scene


def test_contact_of_members_beside_a_node_that_slides_is_refused():
    def build(x):
        scene = touching([x[0], 1.0])
        bead = scene.add_body((0.3, 0.0), 0.1 * x[0], 0.01)
        scene.add_joint(fb.Slider(scene.beams[0], bead.centre))
        return scene, {"bead": fb.Output("position", bead.centre)}

    run = fb.Response(build, dt=2e-3, t_end=4e-3)
    t, _ = run([1.0])
    with pytest.raises(fb.SceneError, match="in a scene with nodes that slide on beams"):
        run.vjp({"bead": np.ones((len(t), 2))})


def growth(t_end):
    """Growth of the derivatives of the end of a double pendulum that is released horizontally."""

    def build(x):
        scene, last = fb.Scene(gravity=(0, -9.81)), None
        for k in range(2):
            ends = {"a": (k, 0.0), "b": (k + 1, 0.0)}
            link = scene.add_body((k + 0.5, 0.0), x[0], 0.1, points=ends)
            scene.add_joint(fb.Revolute(last or fb.GROUND, link["a"]))
            last = link["b"]
        return scene, {"end": fb.Output("position", last)}

    run = fb.Response(build, dt=0.01, t_end=t_end)
    _, y = run([1.0])
    weights = np.zeros_like(y["end"])
    weights[-1] = 1.0
    run.vjp({"end": weights})
    return run.stats.gradient_growth


def test_growth_of_derivatives_shows_a_chaotic_motion(caplog):
    assert growth(1.0) < 100
    assert "chaotic" not in caplog.text
    assert growth(30.0) > 1e6
    assert "the motion is chaotic" in caplog.text
