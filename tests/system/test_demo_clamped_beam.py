"""The numbers of demos/clamped_beam.py."""

import numpy as np
import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_the_backbone_is_a_little_softer_than_that_of_a_single_mode():
    found = numbers("clamped_beam")
    assert found["frequency of small vibrations over w0"] == pytest.approx(1, abs=1e-3)
    a, f, single = (np.array(found[n]) for n in ("amplitude", "frequency", "of a single mode"))
    assert (np.diff(a) > 0).all() and (np.diff(f) > 0).all() and a[-1] > 7
    within = a < 6
    assert (f[within] < single[within]).all()
    assert f[within] == pytest.approx(single[within], rel=4e-3)


def test_the_shape_changes_with_the_square_of_a_small_amplitude():
    found = numbers("clamped_beam")
    a, change = np.array(found["amplitude"]), np.array(found["change of shape"])
    assert (np.diff(change) > 0).all()
    low, high = np.searchsorted(a, (1.0, 1.5))
    order = np.log(change[high] / change[low]) / np.log(a[high] / a[low])
    assert order == pytest.approx(2, abs=0.2)


def test_motions_are_unstable_where_the_second_mode_grows_by_hills_equation():
    found = numbers("clamped_beam")
    a, stable = np.array(found["amplitude"]), np.array(found["stable"])
    low, high = found["second mode grows"]
    assert not stable.all()
    away = a[~stable]
    assert low - 0.5 < away.min() and away.max() < high + 0.5
    assert stable[a < low - 0.5].all()


def test_the_tongue_leads_to_the_third_mode_at_a_fifth_of_its_frequency():
    found = numbers("clamped_beam")
    assert found["fifth harmonic on the curve"] < 0.02
    assert found["fifth harmonic in the tongue"] > 1
    third = found["a fifth of that of the third mode"]
    assert found["frequency in the tongue"] == pytest.approx(third, rel=2e-3)
