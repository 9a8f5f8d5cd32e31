"""Parts of steps: they cover the grid, shrink where they must, and grow again."""

import numpy as np
import pytest
from scenes import FLYING

import fx_beam as fb
from fx_beam.stepping.substeps import Halving


def march(grid, longest, most=12):
    """Ends of parts, where those longer than `longest(t)` fail, and how many of them failed."""
    halving, ends, failures, done = Halving(most), [grid[0]], 0, 0
    while done < len(grid) - 1:
        for end in halving.ends(grid[done:]):
            if end - ends[-1] > longest(ends[-1]):
                failures += 1
                assert halving.fail()
                break
            ends.append(end)
            if steps := halving.take(1):
                done += steps
                assert end == grid[done]
                break  # the next step may be whole again
    return np.array(ends), failures


GRID = 0.3 + 0.1 * np.arange(41)


@pytest.mark.parametrize("finest", [0.051, 0.013, 1e-4])
def test_what_size_works_is_remembered(finest):
    ends, failures = march(GRID, lambda t: finest)
    assert np.isin(GRID, ends).all()
    size = 0.1 / 2 ** np.ceil(np.log2(0.1 / finest))
    assert np.diff(ends)[-len(ends) // 2 :] == pytest.approx(size, rel=1e-9)
    assert failures <= np.ceil(np.log2(0.1 / finest)) + 6 + len(ends) / 64


def test_steps_are_whole_again_within_five_after_a_hard_time():
    ends, _ = march(GRID, lambda t: 1e-3 if t < 1.0 else 1.0)
    after = np.diff(ends[ends >= 1.5])
    assert after == pytest.approx(np.full(len(after), 0.1))


@pytest.mark.parametrize("solver", ["compiled", "petsc"])
@pytest.mark.parametrize("size", [1e150, 1e300])
def test_a_load_that_overflows_ends_the_run_after_its_halvings(size, solver):
    scene = fb.Scene()
    arm = scene.add_beam([(0, 0), (1, 0)], FLYING, elements=4)
    scene.clamp(arm.start)
    scene.add_force(arm.end, lambda t: (0.0, size * (t > 0.05)))
    with pytest.raises(fb.StepError, match="failed after 12 halvings") as stop:
        fb.simulate(scene, dt=0.01, t_end=1.0, solver=solver)
    assert stop.value.solution.t[-1] == pytest.approx(0.05)


@pytest.mark.parametrize("size", [1e76, 1e308, 10**400], ids=["1e76", "1e308", "1e400"])
def test_numbers_whose_products_overflow_are_refused(size):
    scene = fb.Scene()
    arm = scene.add_beam([(0, 0), (1, 0)], FLYING)
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
    scene = fb.Scene()
    body = scene.add_body((0, 0), mass=1.0, inertia=0.1)
    scene.set_velocity(body, spin=5.0)
    options = fb.NewtonOptions(max_turn=0.3)
    for _ in range(3):
        stats = fb.simulate(scene, dt=0.1, t_end=1.0, newton=options).stats
        assert stats.halvings
    assert len([text for text in caplog.messages if "failed and were halved" in text]) == 1
    fb.simulate(scene, dt=0.1, t_end=1.1, newton=options)
    assert len([text for text in caplog.messages if "failed and were halved" in text]) == 2
