"""The numbers of demos/roll_up.py."""

import numpy as np
import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("name", "turns", "steps", "close"), [("once", 1, 10, 1e-6), ("twice", 2, 20, 1e-5)]
)
def test_roll_up_is_the_circle(name, turns, steps, close):
    run = numbers("roll_up")[name]
    assert (run["load steps"], run["cuts"]) == (steps, 0)
    assert run["turns of the tip"] == pytest.approx(turns, rel=1e-12)
    assert run["tip off at the end / L"] < 1e-12
    assert run["tip off on the way / L"] < close
    assert run["strain energy / exact"] == pytest.approx(1, rel=1e-12)
    assert run["relative balance error"] < 1e-12


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_roll_up_converges_with_twice_the_degree(degree):
    assert numbers("roll_up")["orders"][f"degree {degree}"] == pytest.approx(2 * degree, abs=0.1)


def test_roll_up_let_go_keeps_its_energy():
    free = numbers("roll_up")["let go"]
    assert free["energy at the start"] == pytest.approx(2 * np.pi**2 * 500 / 10, rel=1e-12)
    assert free["relative energy error"] < 1e-11
    assert free["largest kinetic energy"] > 0.5 * free["energy at the start"]
