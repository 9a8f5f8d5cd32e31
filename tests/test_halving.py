"""Parts of steps: they cover the grid, shrink where they must, and grow again."""

import numpy as np
import pytest

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


def test_without_failure_every_step_is_one_part():
    ends, failures = march(GRID, lambda t: 1.0)
    assert failures == 0
    assert (ends == GRID).all()


def test_a_single_hard_moment_halves_one_step():
    ends, failures = march(GRID, lambda t: 0.06 if 1.95 < t < 2.05 else 1.0)
    assert failures == 1
    assert np.diff(ends).min() == pytest.approx(0.05)
    assert len(ends) == len(GRID) + 1
    assert np.isin(GRID, ends).all()


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


def test_a_step_may_be_halved_no_more_than_it_may():
    halving = Halving(2)
    assert halving.fail() and halving.fail() and not halving.fail()
    assert halving.parts == 4
