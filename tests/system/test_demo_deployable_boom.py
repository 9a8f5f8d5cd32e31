"""The numbers of demos/deployable_boom.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_one_panel_latches_after_a_quarter_of_the_period():
    single = numbers("deployable_boom")["single"]
    assert single["time / exact"] == pytest.approx(1, abs=3e-6)
    assert single["impact / exact"] == pytest.approx(1, abs=1e-9)
    assert single["speed at the end"] < 1e-12


@pytest.mark.parametrize("panels", ["rigid", "flexible"])
def test_the_latches_of_the_boom_keep_momenta_and_the_balance(panels):
    run = numbers("deployable_boom")[panels]
    assert list(run["latches"]) == ["hinge 3", "hinge 2", "hinge 1"]
    assert run["relative balance error"] < 1e-11
    assert run["linear momentum / (m v)"] < 1e-12
    assert run["angular momentum / (m v l)"] < 1e-12


def test_rigid_panels_rest_after_the_last_latch():
    run = numbers("deployable_boom")["rigid"]
    assert run["impacts / energy of the springs"] == pytest.approx(1, abs=1e-11)
    assert run["speed at the end"] < 1e-11 * run["largest speed"]  # as exact as the momenta


def test_flexible_panels_lose_little_in_the_latches():
    rigid, flexible = (numbers("deployable_boom")[name] for name in ("rigid", "flexible"))
    assert 0 < flexible["impacts / energy of the springs"] < 1e-3
    first = [run["latches"]["hinge 3"][0] for run in (rigid, flexible)]
    assert first[0] == pytest.approx(first[1], rel=5e-3)
