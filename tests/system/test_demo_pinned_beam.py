"""The numbers of demos/pinned_beam.py."""

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def pinned_beam(scheme):
    return numbers("pinned_beam")["schemes"][scheme]["dt 0.01"]


def test_pinned_beam_starts_with_the_papers_energy_and_momentum():
    found = numbers("pinned_beam")
    assert found["angular momentum at the start"] == pytest.approx(75_000, rel=1e-12)
    # 300 000 of translation; the spins of the nodes add the rest.
    assert found["energy at the start"] == pytest.approx(300_100, rel=1e-12)


def test_pinned_beam_keeps_energy_and_angular_momentum_over_ten_seconds():
    run = pinned_beam("EnergyMomentum")
    assert run["steps"] == 1000 and run["failure"] is None and run["halvings"] == 0
    assert run["energy drift"] < 1e-10
    assert run["angular momentum drift"] < 1e-10


def test_pinned_beam_published_scheme_keeps_angular_momentum_and_nearly_energy():
    run = pinned_beam("ModifiedMidPoint (as published)")
    assert run["angular momentum drift"] < 1e-10
    assert 1e-6 < run["energy drift"] < 1e-3


def test_pinned_beam_newmark_gains_energy_and_fails_and_hht_loses_energy():
    newmark, hht = pinned_beam("Newmark (trapezoidal)"), pinned_beam("HHT, alpha = -0.1")
    assert newmark["failed at"] < 1 and newmark["highest energy ratio"] > 2
    assert hht["failure"] is None and hht["lowest energy ratio"] < 0.95


@pytest.mark.parametrize(
    "discretisation", ["8 elements, dt 0.01", "8 elements, dt 0.001", "64 elements, dt 0.0005"]
)
def test_pinned_beam_tip_is_where_the_reference_has_it(discretisation):
    run = numbers("pinned_beam")["tip"][discretisation]
    # The reference is rounded to 0.01 in; the beam is 100 in long.
    assert run["largest difference"] < 0.01
