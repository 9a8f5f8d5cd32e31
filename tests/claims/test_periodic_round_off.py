"""Periodic motions of stiff scenes, whose states after a period are known up to round-off."""

import math
import re

import pytest
from scenes import clamped_bar, supported_bar

import fx_beam as fb


def bar(load, steady=0.0):
    """A stiff cantilever with hardly any damping, and a load at its end that repeats itself."""
    section = fb.Section(EA=1e9, GA=4e8, EI=1e5, rhoA=1.0, rhoI=1e-4, retardation=1e-6)
    scene, beam = clamped_bar((1, 0), section, elements=4)
    scene.add_force(beam.end, lambda t: (0.0, steady + load * math.cos(2 * math.pi * t)))
    return scene, beam.end


def test_the_search_ends_at_round_off_and_says_so(caplog):
    scene, end = bar(10.0)
    motion = fb.periodic(scene, period=1.0, steps=101)
    assert motion.iterations < 20 and motion.error < 1e-6
    if motion.error > 1e-9:
        assert "tolerance" in caplog.text and f"{motion.error:.1e}" in caplog.text
    # The small motion is linear, that of a load 100 times as large nearly so.
    larger, its_end = bar(1000.0)
    amplitude = fb.periodic(larger, period=1.0, steps=101).amplitude(its_end)
    assert 100 * motion.amplitude(end) == pytest.approx(amplitude, rel=1e-3)


def test_a_motion_below_round_off_needs_a_tolerance_that_the_error_names(caplog):
    # About a bent state: from the straight one small strains have all their digits.
    scene, _ = bar(0.01, steady=1e4)
    with pytest.raises(RuntimeError, match="as with round-off, give tolerance = "):
        fb.periodic(scene, period=1.0, steps=401)
    assert 1e-9 < fb.periodic(scene, period=1.0, steps=401, tolerance=1e-2).error <= 1e-2
    assert not caplog.text


def test_a_family_tells_once_of_all_motions_that_round_off_leaves_open(caplog):
    section = fb.Section(EA=1e8, GA=1e8, EI=1.0, rhoA=1.0, rhoI=1e-4)
    scene, beam = supported_bar((1, 0), section, elements=3)
    family = fb.backbone(scene, amplitude=0.1, most=8, tolerance=1e-14)
    (warning,) = caplog.messages
    assert "backbone: round-off leaves" in warning and f"of {len(family)} motions" in warning
    left = float(re.search(r"period (\S+) of the motion away", warning)[1])
    assert left == pytest.approx(max(motion.error for motion in family), rel=0.5)
