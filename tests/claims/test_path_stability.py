"""Stability along a path of equilibria: numbers of unstable modes."""

import pickle

import numpy as np
import pytest
from scenes import one_bar, pinned_bar, supported_bar

import fx_beam as fb

EI = 1.0
SECTION = fb.Section(EA=1e4, GA=4e3, EI=EI, rhoA=1.0, rhoI=1e-6)


def column(load):
    """A column of length 1 under a load, pinned at both ends."""
    scene, beam = supported_bar((0, 1), SECTION, 8, 3, held="x", load=(0, -load))
    return scene


def euler_load(k):
    """Smallest P of P (1 - P/EA + P/GA) = EI k^2."""
    c = 1 / SECTION.GA - 1 / SECTION.EA
    return (np.sqrt(1 + 4 * c * EI * k**2) - 1) / (2 * c)


@pytest.mark.parametrize("continuation", [None, "arc-length"])
def test_each_critical_load_of_a_column_makes_one_more_mode_unstable(continuation):
    path = fb.static(column(200.0), load_steps=30, continuation=continuation)
    loads = [euler_load(n * np.pi) for n in (1, 2, 3, 4)]
    expected = np.searchsorted(loads, 200.0 * path.load_factor)
    assert path.unstable_modes.tolist() == expected.tolist()
    assert path.unstable_modes[-1] == 4
    assert path.stable.tolist() == (expected == 0).tolist()


def arch(**changes):
    """A shallow arch of two members, joined by a hinge with a spring or rigidly."""
    scene, left = pinned_bar((1, 0.2), SECTION, 3, 2)
    if changes.get("hinge"):
        right = scene.add_beam([(1, 0.2), (2, 0)], SECTION, 3, 2)
        turning = fb.Spring(stiffness=5.0)
        scene.add_joint(fb.Revolute(left.end, right.start, spring=turning))
    else:
        right = scene.add_beam([left.end, (2, 0)], SECTION, 3, 2)
    scene.pin(right.end)
    scene.add_force(left.end, (0, -60.0))
    return scene


@pytest.mark.parametrize("hinge", [False, True])
def test_the_same_modes_grow_as_in_free_vibrations_of_a_row(hinge):
    scene = arch(hinge=hinge)
    path = fb.static(scene, load_steps=8, continuation="arc-length")
    assert path.unstable_modes.max() > 0
    for row in (len(path.t) // 3, len(path.t) - 1):
        load = path.load_factor[row]
        options = {"load_steps": 8, "continuation": "arc-length", "max_steps": row}
        state = fb.static(scene, **options) if row else path
        assert state.load_factor[-1] == load
        growing = int((fb.modes(scene, state, n=6).angular_frequencies < 0).sum())
        assert path.unstable_modes[row] == growing == state.unstable_modes[-1]


def test_a_closed_loop_of_joints_counts_as_its_modes():
    """A parallelogram of stiff bars with springs, loaded from above, tips over at 2 c / (P L)."""
    stiff = fb.Section(EA=1e6, GA=1e6, EI=1e4, rhoA=1.0, rhoI=0.01)
    scene, left = one_bar((0, 1), stiff, elements=1)
    right = scene.add_beam([(1, 0), (1, 1)], stiff, elements=1)
    top = scene.add_beam([(0, 1), (1, 1)], stiff, elements=2)
    turning = fb.Spring(stiffness=10.0)
    scene.add_joint(fb.Revolute(fb.GROUND, left.start, spring=turning))
    scene.add_joint(fb.Revolute(fb.GROUND, right.start, spring=turning))
    scene.add_joint(fb.Revolute(left.end, top.start))
    scene.add_joint(fb.Revolute(right.end, top.end))
    scene.add_force(top.node(0.5), (0, -42.0))
    path = fb.static(scene, load_steps=8)
    assert path.unstable_modes.tolist() == (42 * path.load_factor > 20).astype(int).tolist()


def test_stability_survives_copies_and_files(tmp_path):
    path = fb.static(column(15.0), load_steps=3)
    path.save(tmp_path / "path.npz")
    for other in (pickle.loads(pickle.dumps(path)), fb.load(tmp_path / "path.npz")):
        assert other.unstable_modes.tolist() == [0, 0, 1, 1]
        assert (other.load_factor == path.load_factor).all()
    path.to_csv(tmp_path / "path.csv", energies=True)  # equilibria have them when asked for
    assert (tmp_path / "path.csv").read_text(encoding="utf-8").startswith("load factor,")
