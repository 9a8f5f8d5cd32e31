"""Parts of steps: they cover the grid, shrink where they must, and grow again."""

import numpy as np
import pytest
from scenes import FLYING, clamped_bar, one_bar, one_body

import fx_beam as fb

MOST = fb.NewtonOptions(max_turn=0.3)


def turning(spin):
    """A body of 0.1 kg m^2 that turns freely."""
    scene, body = one_body((0, 0), mass=1.0, inertia=0.1)
    scene.set_velocity(body, spin=spin)
    return scene, body.centre


@pytest.mark.parametrize(("spin", "parts"), [(5.0, 2), (20.0, 8), (45.0, 16)])
def test_what_size_of_steps_works_is_remembered(spin, parts):
    stats = fb.simulate(turning(spin)[0], dt=0.1, t_end=4.0, newton=MOST).stats
    assert stats.substeps == 40 * parts
    assert stats.halvings <= np.log2(parts) + 6 + stats.substeps / 64


def test_steps_are_whole_again_within_five_after_a_hard_time():
    scene, centre = turning(45.0)
    scene.add_moment(centre, lambda t: -45.0 * (1.0 <= t < 1.1))  # it stops
    options = {"dt": 0.1, "newton": fb.NewtonOptions(max_turn=0.04)}
    early, late = (fb.simulate(scene, t_end=t, **options) for t in (1.6, 4.0))
    assert early.stats.substeps > 128 * 10
    assert late.stats.substeps - early.stats.substeps == 24


@pytest.mark.parametrize("size", [1e150, 1e300])
def test_a_load_that_overflows_ends_the_run_after_its_halvings(size):
    scene, arm = clamped_bar((1, 0), FLYING, elements=4, load=lambda t: (0.0, size * (t > 0.05)))
    with pytest.raises(fb.StepError, match="failed after 12 halvings") as stop:
        fb.simulate(scene, dt=0.01, t_end=1.0)
    assert stop.value.solution.t[-1] == pytest.approx(0.05)


@pytest.mark.parametrize("size", [1e76, 1e308, 10**400], ids=["1e76", "1e308", "1e400"])
def test_numbers_whose_products_overflow_are_refused(size):
    scene, arm = one_bar((1, 0), FLYING, elements=1)
    for add in (
        lambda: scene.add_mass(arm.end, size),
        lambda: scene.add_drag(arm.end, quadratic=size),
        lambda: scene.add_force(arm.end, (0.0, size)),
        lambda: fb.Section(EA=size, GA=1.0, EI=1.0),
        lambda: fb.Spring(size),
    ):
        with pytest.raises(fb.SceneError):
            add()


def test_equal_warnings_of_many_runs_come_once(caplog):
    scene, _ = turning(5.0)
    for _ in range(3):
        stats = fb.simulate(scene, dt=0.1, t_end=1.0, newton=MOST).stats
        assert stats.halvings
    assert len([text for text in caplog.messages if "failed and were halved" in text]) == 1
    fb.simulate(scene, dt=0.1, t_end=1.1, newton=MOST)
    assert len([text for text in caplog.messages if "failed and were halved" in text]) == 2


def test_a_motion_says_where_round_off_may_decide_which_steps_are_halved(caplog):
    # Whether three corrections are enough is decided by digits; that a step turns too far is not.
    scene = turning(4.0)[0]
    arm = scene.add_beam([(2, 0), (3, 0)], FLYING, elements=4)
    scene.pin(arm.start)
    scene.add_force(arm.end, (0.0, -5.0))
    few = fb.simulate(scene, dt=0.1, t_end=0.5, newton=fb.NewtonOptions(max_iterations=3)).stats
    assert few.unconverged == few.halvings > 0
    assert few.too_large == 0
    assert "the last digit of dt may decide" in caplog.text
    caplog.clear()
    wide = fb.simulate(turning(4.0)[0], dt=0.1, t_end=0.5, newton=MOST).stats
    assert (wide.unconverged, wide.too_large) == (0, 0)
    assert wide.halvings > 0
    assert "last digit" not in caplog.text
