"""The numbers of demos/snapping_chain.py."""

import itertools

import pytest
from demo_runs import numbers

pytestmark = pytest.mark.slow


def test_each_cell_of_the_chain_snaps_at_its_limit_load():
    found = numbers("snapping_chain")
    assert found["kinds"] == ["limit point"]
    assert found["limit loads"] == pytest.approx(found["limit loads of cells"], rel=1e-4)


def test_the_path_of_the_chain_counts_through_all_states():
    states = numbers("snapping_chain")["states without load"]
    counting = [tuple(reversed(state)) for state in itertools.product((1, -1), repeat=3)]
    assert [tuple(state) for state in states] == counting


def test_the_energy_barrier_is_that_of_a_flat_cell():
    found = numbers("snapping_chain")
    assert found["barrier"] == pytest.approx(found["barrier of the first cell"], rel=1e-3)


def test_more_of_the_path_is_stable_under_a_displacement():
    found = numbers("snapping_chain")
    under_load, driven = (found[f"limit points under a {by}"] for by in ("load", "displacement"))
    assert 0 < driven < under_load
    shares = [found[f"stable part under a {by}"] for by in ("load", "displacement")]
    assert shares[0] < shares[1] < 1
