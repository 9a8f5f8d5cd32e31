"""Derivatives of rates, forces and energies as outputs of a `Response`."""

import numpy as np
import pytest
from test_internal_variables import PLASTIC
from test_response import arm, bent, four_bar, free, guided

import fx_beam as fb


def outputs_of(scene):
    """All outputs of the nodes, joints and energies of a scene that it has."""
    found = {}
    nodes = [*scene.nodes][:: max(1, len(scene.nodes) - 1)]
    nodes += [body.centre for body in scene.bodies]
    for i, node in enumerate(nodes):
        for quantity in ("velocity", "spin", "acceleration", "reaction"):
            found[f"{quantity} {i}"] = fb.Output(quantity, node)
    for joint in scene.joints:
        for quantity in ("angle", "slide", "spin", "rate", "force", "motor_force"):
            if not joint.lacks(quantity):
                found[f"{quantity} of {joint.number}"] = fb.Output(quantity, joint)
    for beam in scene.beams:
        for quantity in "NQM":
            found[f"{quantity} of {beam.name}"] = fb.Output(quantity, beam)
    for kind in ("kinetic", "strain", "potential", "spring", "total"):
        found[kind] = fb.Output(f"{kind}_energy", scene)
    return found


def observed(build):
    """The scene of another response with all outputs that it has."""

    def with_outputs(x):
        scene = build(x)[0]
        return scene, outputs_of(scene)

    return with_outputs


def yielding(x):
    """A plastic cantilever on a spring whose law has a parameter that varies."""
    pull = fb.Parameter("pull", lambda t: 10 * x[0] * (1 + t))
    scene = fb.Scene(gravity=(0.0, -9.81 * x[1]))
    beam = scene.add_beam([(0, 0), (x[2], 0)], PLASTIC, elements=3)
    scene.clamp(beam.start)
    spring = fb.Spring(strain_energy=lambda r: pull * (r - 0.5) ** 2)
    scene.add_force_between(beam.end, (0.5, 1.0), spring=spring)
    scene.add_force(beam.end, lambda t: (0, 30 * x[0] * np.sin(6 * t)))
    return scene, {}


def stored(x):
    """A section's energy with a parameter, on a floor."""
    k = fb.Parameter("stiffness", lambda t: 1e4 * x[0] * (1 + t))
    scene = fb.Scene(gravity=(0.0, -9.81))
    section = fb.Section(
        strain_energy=lambda e, g, c: k / 2 * (e**2 + g**2 + c**2 / 200), rhoA=x[1], rhoI=0.01
    )
    beam = scene.add_beam([(0, 0), (1, 0)], section, elements=3)
    scene.pin(beam.start)
    scene.add_obstacle(beam, fb.Line((0, -0.02 * x[2]), normal=(0.1, 1)), stiffness=1e3 * x[0])
    return scene, {}


def pushed(x):
    """A motor pushes a body along a slide that turns, past a prescribed node."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    section = fb.Section(EA=1e4, GA=5e3, EI=20 * x[0], rhoA=1.0, rhoI=1e-2)
    guide = scene.add_beam([(0, 0), (1, 0)], section, elements=2)
    scene.pin(guide.start)
    scene.prescribe(guide.end, y=lambda t: 0.5 * x[1] * t**2)
    body = scene.add_body((1.2, 0.1 * x[2]), 0.5 * x[1], 0.05)
    motor = {"motor": lambda t: x[2] * t**2}
    scene.add_joint(fb.Prismatic(guide.end, body.centre, (1.0, 0.5 * x[2]), **motor))
    return scene, {}


SCENES = {
    "free": (free, {}),
    "arm": (arm, {}),
    "loop": (four_bar, {}),
    "guided": (guided, {}),
    "pushed": (pushed, {}),
    "yielding": (yielding, {}),
    "stored": (stored, {}),
    "order 4": (arm, {"scheme": fb.EnergyMomentum(order=4)}),
    "decaying": (guided, {"scheme": fb.EnergyDecaying()}),
    "rows": (arm, {"record": fb.Record(every=3)}),
    "tolerance": (guided, {"dt": None, "tolerance": 1e-3}),
    "statics": (bent, {"start": lambda scene: fb.static(scene, steps=2)}),
}


@pytest.mark.parametrize("name", SCENES)
def test_derivatives_of_outputs_are_those_of_the_motion(name):
    """By extrapolated differences of motions, adjoint and forwards."""
    build, options = SCENES[name]
    build = observed(build)
    options = {"dt": 0.01, "t_end": 0.1} | options
    x, rng, h = np.array([1.1, 0.9, 1.05]), np.random.default_rng(0), 1e-4
    run = fb.Response(build, **options)
    t, y = run(x)
    weights = {
        name: rng.standard_normal(rows.shape) / abs(rows).max(initial=1e-3)
        for name, rows in y.items()
    }
    gradients = {name: run.vjp({name: weights[name]}) for name in y}
    J = run.jacobian()
    for i in range(3):
        ends = []
        for side in (-2, -1, 1, 2):
            times, found = run(x + side * h * np.eye(3)[i])
            assert (times == t).all() or "tolerance" in options
            ends.append({name: (weights[name] * found[name]).sum() for name in y})
        for key, gradient in gradients.items():
            low2, low, high, high2 = (end[key] for end in ends)
            expected = (8 * (high - low) - (high2 - low2)) / (12 * h)
            size = abs(gradient).max()
            assert gradient[i] == pytest.approx(expected, abs=2e-6 * size + 1e-6), (key, i)
    for key in y:
        assert J[key].shape == (*y[key].shape, 3)
        products = np.tensordot(weights[key], J[key], weights[key].ndim)
        largest = abs(gradients[key]).max()
        assert abs(products - gradients[key]).max() < 1e-8 * largest + 1e-10, key


def test_rows_without_weight_cost_nothing_and_change_nothing():
    run = fb.Response(observed(arm), dt=0.01, t_end=0.1)
    _, y = run([1.1, 0.9, 1.05])
    for name in ("force of 0", "velocity 0", "M of beam 1", "kinetic"):
        J, none = run.jacobian(name)[name], np.zeros_like(y[name])
        assert (run.vjp({name: none}) == 0).all()
        one = none.copy()
        one[4] = 1.0
        expected = J[4].reshape(-1, 3).sum(axis=0)
        assert run.vjp({name: one}) == pytest.approx(expected, rel=1e-9, abs=1e-9 * abs(J).max())
    assert (run.vjp({}) == 0).all()


# -- Against what is known otherwise -----------------------------------------------------------


def test_rate_of_a_driven_body_without_joints():
    def build(x):
        scene = fb.Scene()
        body = scene.add_body((0, 0), mass=1.0, inertia=1.0)
        scene.prescribe(body.centre, x=lambda t: x[0] * t * t)
        return scene, {"rate": fb.Output("velocity", body.centre, "x")}

    run = fb.Response(build, dt=0.1, t_end=1.0)
    t, y = run([3.0])
    assert run.jacobian()["rate"][:, 0] == pytest.approx(2 * t, abs=1e-9)
    assert run.vjp({"rate": np.ones_like(t)}) == pytest.approx([2 * t.sum()], abs=1e-8)


def test_reaction_of_a_cantilever_by_its_load():
    """At rest it is minus the load, and its moment minus the load times where the tip is."""

    def build(x):
        scene = fb.Scene()
        section = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=0.01)
        beam = scene.add_beam([(0, 0), (1, 0)], section, elements=4)
        scene.clamp(beam.start)
        scene.add_force(beam.end, (0.0, x[0]))
        tip, root = fb.Output("position", beam.end, "x"), fb.Output("reaction", beam.start)
        return scene, {"tip": tip, "root": root, "M": fb.Output("M", beam)}

    load = 2.0
    static = fb.StaticResponse(build, steps=3)
    moving = fb.Response(build, dt=0.01, t_end=0.05, start=lambda scene: fb.static(scene, steps=3))
    for run, factors in ((static, static([load])[0]), (moving, np.ones(6))):
        _, y = run([load])
        J = run.jacobian()
        root, tip = J["root"][..., 0], J["tip"][:, 0]
        assert abs(root[:, 0]).max() < 1e-8
        assert abs(root[:, 1] + factors).max() < 1e-8
        moment = -factors * y["tip"] - factors * load * tip
        assert root[1:, 2] == pytest.approx(moment[1:], abs=1e-7)
        # The last element's mean moment has half its length as the arm.
        x = y["tip"][-1] - static([load])[1]["tip"][-1]
        assert abs(x) < 1e-9
    assert abs(moving.jacobian("M")["M"] - moving.jacobian("M")["M"][:1]).max() < 1e-6


def pendulum(x):
    """A rigid pendulum that is let go at the angle x[0], with the mass x[1]."""
    scene, c, s = fb.Scene(gravity=(0.0, -9.81)), np.cos(x[0]), np.sin(x[0])
    body = scene.add_body((s, -c), x[1], 1e-9, points={"pin": (0, 0)})
    pin = scene.add_joint(fb.Revolute(fb.GROUND, body["pin"]))
    outputs = {"pin": fb.Output("force", pin), "a": fb.Output("acceleration", body.centre)}
    return scene, outputs | {"speed": fb.Output("velocity", body.centre)}


def test_force_of_a_pendulums_pin():
    """Balance of momentum in each step, and m g (3 - 2 cos x) where it is lowest."""
    run = fb.Response(pendulum, dt=0.01, t_end=0.8)
    x = np.array([1.0, 2.0])
    t, y = run(x)
    J = run.jacobian()
    assert J["pin"][1:, :2, 0] == pytest.approx(x[1] * J["a"][1:, :, 0], abs=1e-7)
    by_mass = y["a"][1:] + (0, 9.81) + x[1] * J["a"][1:, :, 1]
    assert J["pin"][1:, :2, 1] == pytest.approx(by_mass, abs=1e-7)
    lowest = np.argmax(y["pin"][:, 1])
    assert y["pin"][lowest, 1] == pytest.approx(x[1] * 9.81 * (3 - 2 * np.cos(x[0])), rel=1e-3)
    assert J["pin"][lowest, 1, 0] == pytest.approx(x[1] * 9.81 * 2 * np.sin(x[0]), rel=2e-2)
    # The energy at any time is that of the start.
    height = 9.81 * np.sin(x[0])
    fastest = np.argmax(y["speed"][:, 0] ** 2)
    speed = y["speed"][fastest] @ J["speed"][fastest, :, 0]
    assert speed == pytest.approx(height, rel=2e-2)
