"""Derivatives of motions whose friction follows the forces of joints."""

import pytest
from derivatives import both, forward_and_backward
from jointed import pendulum_with_friction as pendulum

import fx_beam as fb

DATA = {"EA": 1e4, "GA": 1e4, "EI": 100.0, "rhoA": 1.0, "rhoI": 0.1}


def chain(x):
    """A flexible arm with a body on two pins, each with friction by its own force."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(**DATA | {"EI": 100 * x})
    arm = scene.add_beam([(0, 0), (1, 0.2)], section, elements=3)
    body = scene.add_body((1.3, 0.1), 2.0 * x, 0.05, points={"pin": (1, 0.2)})
    friction = fb.Coulomb(0.5 * x, 500.0, radius=0.1)
    scene.add_joint(fb.Revolute(fb.GROUND, arm.start, friction=friction))
    scene.add_joint(fb.Revolute(arm.end, body["pin"], friction=friction))
    scene.set_velocity(body, (0.0, 0.0), spin=2.0)
    scene.make_velocities_compatible()
    return scene


def rail(x):
    """A body slides along a turning arm, with friction by the force across it."""
    scene = fb.Scene(gravity=(0, -9.81))
    arm = scene.add_body((0.4, 0), 1.0, 0.2, points={"pin": (0, 0)})
    block = scene.add_body((0.5, 0), 0.5 * x, 0.01)
    scene.add_joint(fb.Revolute(fb.GROUND, arm["pin"]))
    friction = fb.Coulomb(0.3 * x, 300.0)
    scene.add_joint(fb.Prismatic(arm.centre, block.centre, axis=(1, 0), friction=friction))
    return scene


def rubbing(x, make=fb.Slider):
    """A bead that slides on a bridge, with friction by the force across it."""
    scene = fb.Scene(gravity=(0, -9.81))
    section = fb.Section(**DATA | {"EI": 200 * x, "rhoI": 0.01})
    bridge = scene.add_beam([(0, 0.3 * x), (4, 0)], section, elements=8)
    scene.pin(bridge.start)
    scene.fix(bridge.end, "y")
    at = bridge.nodes[2]
    bead = scene.add_body((at.x, at.y), mass=2.0 * x, inertia=0.05)
    scene.add_joint(make(bridge, bead.centre, friction=fb.Coulomb(0.3 * x, 2000.0)))
    scene.set_velocity(bead.centre, (1.5, 0.0))
    scene.make_velocities_compatible()
    return scene


SCENES = {
    "pendulum": lambda x: pendulum(0.4 * x)[0],
    "chain": chain,
    "rail": rail,
    "bead": rubbing,
    "sleeve": lambda x: rubbing(x, fb.Sleeve),
}


@pytest.mark.parametrize("name", SCENES)
def test_the_adjoint_is_the_derivative_of_the_motion(name):
    found, low, size = both(SCENES[name], steps=25, h=5e-4)
    _, high, _ = both(SCENES[name], steps=25, h=1e-3)
    assert size > 1e-2
    assert abs(found - (4 * low - high) / 3) < 3e-8 * size


@pytest.mark.parametrize("name", SCENES)
@pytest.mark.parametrize("scheme", [fb.EnergyMomentum(), fb.EnergyDecaying()])
def test_forwards_and_backwards_agree(name, scheme):
    forward, backward = forward_and_backward(SCENES[name], scheme, steps=25)
    assert forward == pytest.approx(backward, rel=1e-10)
