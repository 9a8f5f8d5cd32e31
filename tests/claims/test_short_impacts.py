"""Restitution in steps that are not much shorter than a contact: a warning says so."""

import logging

import numpy as np
import pytest

import fx_beam as fb

TIME = np.pi * 1e-3  # of a contact of 1 kg on 1e6 N/m


def ball(dt, restitution=0.5):
    """Ratio of the speeds of a ball after and before it hits a floor."""
    scene = fb.Scene()
    centre = scene.add_body((0, 0.021), mass=1.0, inertia=0.1).centre
    loss = {"restitution": restitution, "speed": 0.01}
    scene.add_obstacle(centre, fb.Line((0, 0), (0, 1)), stiffness=1e6, **loss)
    scene.set_velocity(centre, (0, -1.0))
    return fb.simulate(scene, dt=dt, t_end=0.1).velocity(centre)[-1, 1]


def block(dt, restitution=0.5):
    """The same of a block on a rail that hits a stop."""
    scene = fb.Scene()
    centre = scene.add_body((0, 0), mass=1.0, inertia=0.1).centre
    stop = fb.Stop(None, 0.021, 1e6, restitution, speed=0.01)
    rail = fb.Prismatic(fb.GROUND, centre, axis=(1, 0), stop=stop)
    scene.add_joint(rail)
    scene.set_velocity(centre, (1.0, 0))
    return -fb.simulate(scene, dt=dt, t_end=0.1).velocity(centre)[-1, 0]


@pytest.mark.parametrize("hit", [ball, block])
def test_a_restitution_that_the_steps_change_is_named_with_the_steps_of_the_impact(hit, caplog):
    with caplog.at_level(logging.WARNING, "fx_beam"):
        assert hit(TIME / 15) == pytest.approx(0.5, abs=0.01)
        assert hit(TIME / 3, restitution=1.0) == pytest.approx(1.0, abs=1e-10)
        assert caplog.messages == []
        assert hit(TIME / 3) > 0.52
    (message,) = caplog.messages
    assert "takes 4 steps" in message
    assert "restitution 0.5 holds in contacts of 10 steps or more" in message
