"""Steps of paths by arc length: how far the load factor changes in one, and where they end."""

import numpy as np
import pytest
from scenes import clamped_bar

import fx_beam as fb

SECTION = fb.Section(EA=1e6, GA=1e6, EI=1.0)


def shortened(way):
    """A clamped member of length 1 whose end is pushed inwards."""
    scene, beam = clamped_bar((1, 0), SECTION, 8, 2)
    scene.fix(beam.end, "y", "rotation")
    scene.prescribe(beam.end, x=lambda t: -way)
    return scene, beam.end


@pytest.mark.parametrize(("way", "steps"), [(1e-4, 10), (1e-2, 20), (4e-5, 10)])
def test_no_step_on_a_branch_changes_the_load_factor_by_more_than_a_load_step(way, steps):
    scene, end = shortened(way)
    point, *_ = fb.static(scene, load_steps=20).critical_points
    branch = fb.static(scene, start=point.branch(), continuation="arc-length", load_steps=steps)
    assert np.diff(branch.load_factor).max() <= (1 + 1e-6) / steps
    assert branch.load_factor[-1] == 1
    assert branch.position(end)[-1, 0] == pytest.approx(1 - way, abs=1e-12)
    assert abs(branch.q[-1]).max() > abs(branch.q[0]).max()


def test_no_step_of_a_path_that_gets_stiffer_changes_the_load_factor_by_more():
    """A member that is pulled across becomes a cable."""
    scene, beam = clamped_bar((1, 0), SECTION, 8, 2)
    scene.clamp(beam.end)
    scene.prescribe(beam.node(0.5), y=lambda t: 0.05)
    scene.add_force(beam.node(0.25), (0, 100.0))
    path = fb.static(scene, load_steps=8, continuation="arc-length")
    assert np.diff(path.load_factor).max() <= (1 + 1e-6) / 8
    assert path.load_factor[-1] == 1
