"""Public names that changed: the former ones still work, with a warning."""

import pytest

import fx_beam as fb


def test_former_names_of_the_package_give_the_new_ones():
    with pytest.warns(DeprecationWarning, match="fx_beam.Rates is now fx_beam.UpdateRule"):
        assert fb.Rates is fb.UpdateRule


def test_former_names_of_statistics_give_the_new_ones():
    stats = fb.Stats("Newmark", 1.0, "band", 3, inverted=2)
    with pytest.warns(DeprecationWarning, match="Stats.inside_out is now Stats.inverted"):
        assert stats.inside_out == 2


def test_former_names_of_parameters_are_taken():
    floor = fb.Line((0, 0), normal=(0, 1))
    with pytest.warns(DeprecationWarning, match="places is now positions"):
        assert floor.gap(places=(3.0, 2.0)) == 2.0
