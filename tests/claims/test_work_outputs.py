"""Work and dissipated energy as outputs of a `Response`, and their derivatives."""

import numpy as np
import pytest
from test_internal_variables import PLASTIC
from test_joint_friction_derivatives import rail
from test_natural_strain_derivatives import bending
from test_observed_outputs import pushed, stored, yielding
from test_response import arm, bent, four_bar, free

import fx_beam as fb


def damped(x):
    """A viscous beam with a damped hinge and drag, under loads and a moment that vary."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    damping = {"retardation": 1e-3 * x[1]}
    section = fb.Section(EA=1e4, GA=5e3, EI=20 * x[0], rhoA=x[1], rhoI=1e-2, **damping)
    beam = scene.add_beam([(0, 0), (x[2], 0.2)], section, elements=3)
    scene.pin(beam.start)
    place = {"pin": (x[2], 0.2)}
    body = scene.add_body((x[2] + 0.2, 0.0), mass=x[1], inertia=0.02, points=place)
    damper = fb.Damper(0.3 * x[0])
    scene.add_joint(fb.Revolute(beam.end, body["pin"], damper=damper))
    scene.add_drag(body.centre, linear=0.2 * x[2], quadratic=0.1)
    scene.add_force(beam.end, lambda t: (20 * t, 5 * x[1]))
    scene.add_moment(body.centre, lambda t: 4 * x[2] * np.cos(9 * t))
    scene.add_line_load(beam, (0.3 * x[0], 0.1))
    return scene, {}


def with_work(build):
    """The same scene with its work, dissipated and total energy as outputs."""

    def observed(x):
        scene = build(x)[0]
        quantities = {"work": "work", "dissipated": "dissipated_energy", "total": "total_energy"}
        return scene, {name: fb.Output(of, scene) for name, of in quantities.items()}

    return observed


X = np.array([1.1, 0.9, 1.05])


def driven(x):
    """The same, and a body that is moved, with motors of a hinge and a slide on it."""
    scene, _ = damped(x)
    base = scene.add_body((0, 3), mass=1.0, inertia=0.1)
    scene.prescribe(base.centre, x=lambda t: x[0] * t * t)
    scene.fix(base.centre, "y")
    scene.fix(base.centre, "rotation")
    arm = scene.add_body((0.3, 2.6), mass=x[1], inertia=0.05, points={"pin": (0, 3)})
    scene.add_joint(fb.Revolute(base.centre, arm["pin"], motor=lambda t: 6 * x[2] * t * t))
    block = scene.add_body((0.3, 2.6), mass=0.5, inertia=0.02)
    along = {"axis": (0.6, -0.8), "motor": lambda t: 3 * x[0] * t * t}
    scene.add_joint(fb.Prismatic(arm.centre, block.centre, **along))
    scene.add_drag(block.centre, linear=0.5 * x[0])
    return scene, {}


def lossy(x):
    """All kinds of losses at once, while follower forces, a curvature and a parameter do work."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    damping = {"retardation": lambda f: 1e-3 * (1 + f * x[1])}
    section = fb.Section(EA=1e4, GA=5e3, EI=20 * x[0], rhoA=x[1], rhoI=1e-2, **damping)
    beam = scene.add_beam([(0, 0), (x[2], 0.1)], section, elements=3)
    law = fb.Damper(law=lambda rate: 0.1 * rate + 0.02 * rate**3)
    friction = fb.Friction(0.2 * x[0], speed=0.1)
    scene.add_joint(fb.Revolute(fb.GROUND, beam.start, damper=law, friction=friction))
    scene.add_drag(beam, linear=0.1 * x[2], quadratic=0.05 * x[0], rotation=0.02)
    scene.add_natural_strain(beam, curvature=lambda f, t: -x[1] * t * (1 + f))
    contact = {"stiffness": 500 * x[1], "restitution": 0.5, "speed": 0.3}
    contact["friction"] = fb.Coulomb(0.3 * x[0], stiffness=100.0)
    scene.add_obstacle(beam.end, fb.Line((0, -0.02 * x[2]), normal=(-0.1, 1)), **contact)
    scene.add_force(beam.end, (0, 2 * x[1]), follower=True)
    pull = fb.Parameter("pull", lambda t: 10 * x[2] * (1 + t))
    spring = fb.Spring(strain_energy=lambda r: pull * (r - 0.5) ** 2)
    scene.add_force_between(beam.end, (0.5, 1.0), spring=spring)
    scene.set_velocity(beam.end, (0, -6 * x[0]))
    return scene, {}


def lifted(x):
    """A cantilever under all kinds of loads with a spring, and two motors that lift a body."""
    scene = fb.Scene(gravity=(0.0, -9.81 * x[1]))
    section = fb.Section(EA=1e4, GA=5e3, EI=20 * x[0], rhoA=x[1], rhoI=1e-2)
    beam = scene.add_beam([(0, 0), (x[2], 0)], section, elements=3)
    scene.clamp(beam.start)
    scene.add_force(beam.end, (3 * x[0], 4 * x[2]))
    scene.add_moment(beam.end, 2 * x[1])
    scene.add_line_load(beam, (0.3 * x[0], 1.0))
    scene.add_force_between(beam.end, (1, 1.0), spring=fb.Spring(5 * x[0], rest=0.7))
    arm = scene.add_body((5, 0), 1.0, 0.1, points={"pin": (4.6, 0)})
    lift = {"motor": lambda t: 0.4 * x[1] * t * (2 - t)}
    scene.add_joint(fb.Revolute(fb.GROUND, arm["pin"], **lift))
    block = scene.add_body((5.5, 0), 0.5 * x[1], 0.1)
    slide = {"motor": lambda t: 0.2 * x[0] * t * (2 - t)}
    scene.add_joint(fb.Prismatic(arm.centre, block.centre, (1, 0), **slide))
    scene.add_force(block.centre, (x[2], 3.0))
    return scene, {}


def slowed(x):
    """A closed loop with a drag and a damper."""
    scene, _ = four_bar(x)
    scene.add_drag(scene.bodies[1].centre, linear=x[1], rotation=0.1)
    scene.add_force_between(scene.bodies[0]["end"], (1, 1), damper=fb.Damper(x[0]))
    return scene, {}


def curved(x):
    """A cantilever that bends itself."""
    return bending([10 * x[0], x[1], 0.0, 1.0, x[2]], False)


def dented(x):
    """A force bends a plastic cantilever."""
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (x[2], 0)], PLASTIC, elements=3)
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0, 20 * x[0]))
    return scene, {}


def rubbing(x):
    """A body slides on an arm that turns, with friction by the force across it."""
    return rail(x[0]), {}


SCENES = {
    "loads": (free, {}),
    "losses": (damped, {}),
    "losses, order 4": (damped, {"scheme": fb.EnergyMomentum(order=4), "t_end": 0.05}),
    "mid-point": (four_bar, {"scheme": fb.MidPoint()}),
    "motor": (arm, {}),
    "prescribed": (pushed, {}),
    "parameter": (stored, {}),
    "rows": (damped, {"record": fb.Record(every=4)}),
    "tolerance": (free, {"dt": None, "tolerance": 1e-3}),
    "losses, driven": (driven, {}),
    "losses, driven, order 4": (driven, {"scheme": fb.EnergyMomentum(order=4), "t_end": 0.05}),
    "losses, mid-point": (slowed, {"scheme": fb.MidPoint()}),
    "losses, mid-point, order 4": (slowed, {"scheme": fb.MidPoint(order=4)}),
    "losses, decaying": (arm, {"scheme": fb.EnergyDecaying()}),
    "losses and other work": (lossy, {}),
    "losses from an equilibrium": (bent, {"start": lambda scene: fb.static(scene, steps=2)}),
    "lifted": (lifted, {"start": lambda scene: fb.static(scene, 2, t=1.0), "t_end": 1.05}),
    "losses after plastic flow": (dented, {"start": lambda scene: fb.static(scene, steps=4)}),
    "equilibria": (lifted, {"steps": 3, "t": 1.0}),
    "losses in equilibria": (dented, {"steps": 4}),
    "losses and other work, in parts": (lossy, {"memory": 3e4}),
    "losses of plastic members": (yielding, {}),
    "losses, driven, in parts": (driven, {"memory": 2e4, "record": fb.Record(every=3)}),
}


def response(name):
    build, options = SCENES[name]
    if "equilibria" in name:
        return fb.StaticResponse(with_work(build), **options)
    return fb.Response(with_work(build), **({"dt": 0.01, "t_end": 0.1} | options))


@pytest.mark.parametrize("name", SCENES)
def test_derivatives_of_work_and_losses_are_those_of_the_motion(name):
    """By extrapolated differences of motions, adjoint and forwards."""
    run, rng, h = response(name), np.random.default_rng(0), 1e-4
    _, y = run(X)
    assert abs(y["work"]).max() > 1e-6
    assert ("losses" in name or name == "rows") == bool(y["dissipated"].any())
    keys = ["work", "dissipated"]
    weights = {key: rng.standard_normal(len(y[key])) for key in keys}
    gradients = {key: run.vjp({key: own}) for key, own in weights.items()}
    J = run.jacobian(*keys)
    for key, gradient in gradients.items():
        size = abs(weights[key] @ abs(J[key])).max() + abs(gradient).max()
        assert abs(weights[key] @ J[key] - gradient).max() <= 1e-9 * size
    for i in range(3):
        ends = [run(X + side * h * np.eye(3)[i])[1] for side in (-2, -1, 1, 2)]
        for key, gradient in gradients.items():
            low2, low, high, high2 = (weights[key] @ end[key] for end in ends)
            expected = (8 * (high - low) - (high2 - low2)) / (12 * h)
            assert gradient[i] == pytest.approx(expected, abs=2e-7 * (1 + abs(gradient).max()))


@pytest.mark.parametrize("name", ["loads", "losses", "motor", "parameter"])
def test_values_are_those_of_the_solution_and_derivatives_balance(name):
    """Total energy and losses less the work change with x as the energy at the start does.

    With loads alone work is summed over the steps, and the balance is a test of both.
    """
    build, options = SCENES[name]
    run = response(name)
    _, y = run(X)
    motion = fb.simulate(build(X)[0], dt=0.01, t_end=0.1, progress=False, **options)
    assert abs(y["work"] - motion.energy.work).max() <= 1e-12
    assert abs(y["dissipated"] - motion.energy.dissipated).max() <= 1e-12
    J = run.jacobian()
    balance = J["total"] + J["dissipated"] - J["work"]
    # With a motor, rates at the start that fit the joints have done work there already.
    assert abs(balance - balance[0]).max() < 1e-8 * max(1.0, abs(J["total"]).max())


def test_losses_summed_over_the_steps_are_those_that_the_balance_of_energy_leaves():
    """With a follower force of zero other work is possible, and each step's losses are derived."""

    def followed(x):
        scene, _ = driven(x)
        scene.add_force(scene.beams[0].end, (0.0, 0.0), follower=True)
        return scene, {}

    balance, sums = (fb.Response(with_work(of), dt=0.01, t_end=0.1) for of in (driven, followed))
    balance(X), sums(X)
    expected, found = (run.jacobian("dissipated")["dissipated"] for run in (balance, sums))
    assert abs(found - expected).max() < 1e-11 * abs(expected).max()


def test_work_of_loads_on_a_closed_loop_balances_its_energy():
    run = fb.Response(with_work(four_bar), dt=0.01, t_end=0.1)
    run(X)
    J = run.jacobian()
    assert abs(J["work"][-1]).min() > 0.1
    balance = J["total"] - J["work"]
    assert abs(balance - balance[0]).max() < 1e-9 * abs(J["total"]).max()


# -- Against what is known otherwise -----------------------------------------------------------


def test_work_on_a_free_body_and_what_its_drag_takes():
    """W = F^2 t^2 / 2m; and of steps with drag the factor of the speed, (1 - a)/(1 + a)."""

    def build(x):
        scene = fb.Scene()
        pushed = scene.add_body((0, 0), mass=x[0], inertia=1.0)
        scene.add_force(pushed.centre, (x[1], 0.0))
        slowed = scene.add_body((0, 1), mass=x[0], inertia=1.0)
        scene.set_velocity(slowed.centre, (0.0, 2.0))
        scene.add_drag(slowed.centre, linear=x[2])
        return scene, {}

    m, F, c = x = np.array([2.0, 3.0, 0.5])
    run = fb.Response(with_work(build), dt=0.1, t_end=2.0)
    t, y = run(x)
    J, n = run.jacobian(), np.arange(len(t))
    work = F**2 * t**2 / (2 * m)
    assert y["work"] == pytest.approx(work, abs=1e-9)
    expected = np.column_stack([-work / m, 2 * work / F, 0 * t])
    assert J["work"] == pytest.approx(expected, abs=1e-9)
    a = c * 0.1 / (2 * m)
    kept = ((1 - a) / (1 + a)) ** (2 * n)
    assert y["dissipated"] == pytest.approx(2 * m * (1 - kept), abs=1e-9)
    by_a = 8 * n * m * kept / (1 - a**2)
    expected = np.column_stack([2 * (1 - kept) - by_a * a / m, 0 * t, by_a * a / c])
    assert J["dissipated"] == pytest.approx(expected, abs=1e-8)


def test_work_goes_on_from_a_solution_that_does_not_depend_on_x():
    def build(x):
        return damped([*x, X[2]])

    first = fb.simulate(build(X[:2])[0], dt=0.01, t_end=0.05, progress=False)
    whole = fb.Response(with_work(build), dt=0.01, t_end=0.1)
    rest = fb.Response(with_work(build), dt=0.01, t_end=0.1, start=first)
    y, y_rest = whole(X[:2])[1], rest(X[:2])[1]
    for key in ("work", "dissipated"):
        assert y_rest[key] == pytest.approx(y[key][5:], abs=1e-12)
        J, h = rest.jacobian(key)[key], 1e-4
        assert (J[0] == 0).all()
        low, high = (rest([X[0] + side * h, X[1]])[1][key] for side in (-1, 1))
        assert J[:, 0] == pytest.approx((high - low) / (2 * h), abs=1e-6 * abs(J).max())
        rest(X[:2])


def test_work_of_a_moment_that_bends_a_cantilever():
    """W = M^2 L / 2 EI; of equal load steps as well, as the rotation is linear in M."""

    def build(x):
        scene = fb.Scene()
        section = fb.Section(EA=1e4, GA=1e4, EI=x[1])
        beam = scene.add_beam([(0, 0), (x[2], 0)], section, elements=3)
        scene.clamp(beam.start)
        scene.add_moment(beam.end, x[0])
        return scene, {}

    M, EI, L = x = np.array([2.0, 3.0, 0.8])
    run = fb.StaticResponse(with_work(build), steps=4)
    factors, y = run(x)
    assert y["work"] == pytest.approx(factors**2 * M**2 * L / (2 * EI), abs=1e-12)
    expected = [M * L / EI, -(M**2) * L / (2 * EI**2), M**2 / (2 * EI)]
    J = run.jacobian("work", "dissipated")
    assert J["work"] == pytest.approx(np.outer(factors**2, expected), abs=1e-10)
    assert not J["dissipated"].any()


# -- What is refused ----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("build", "options", "key", "message"),
    [
        (yielding, {"scheme": fb.MidPoint()}, "work", "not exact with MidPoint"),
        (rubbing, {"scheme": fb.MidPoint()}, "dissipated", "the force of a joint. Use EnergyM"),
        (damped, {"scheme": fb.EnergyDecaying(), "memory": 5e3}, "dissipated", "more memory"),
        (curved, {"start": fb.static}, "work", "has none where natural strains do work"),
    ],
)
def test_what_has_no_derivatives_is_refused_by_its_name(build, options, key, message):
    run = fb.Response(with_work(build), **({"dt": 0.01, "t_end": 0.1} | options))
    _, y = run(X)
    with pytest.raises(fb.SceneError, match=message):
        run.vjp({key: np.ones_like(y[key])})
    with pytest.raises(fb.SceneError, match=message):
        run.jacobian(key)
    assert run.jacobian("total")["total"].shape == (len(y["total"]), 3)


@pytest.mark.parametrize(
    ("build", "key", "message"),
    [
        (four_bar, "work", "of a mechanism, which also depends on how it settles"),
        (curved, "work", "in equilibria where natural strains do work"),
    ],
)
def test_what_has_none_in_equilibria_is_refused_by_its_name(build, key, message):
    run = fb.StaticResponse(with_work(build), steps=2)
    _, y = run(X)
    with pytest.raises(fb.SceneError, match=message):
        run.vjp({key: np.ones_like(y[key])})
