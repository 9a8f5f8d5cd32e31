"""The jobs of the documentation give the values that their formulas and tables have."""

import numpy as np
import pages
import pytest

PAGE = pages.ROOT / "docs" / "howto" / "jobs.md"


@pytest.fixture
def job(tmp_path, monkeypatch):
    """Run the job whose code has some words; the names of its code."""
    monkeypatch.chdir(tmp_path)

    def run(words):
        (block,) = (block for block in pages.blocks(PAGE) if words in block)
        return pages.run(block, PAGE)

    return run


def test_a_cable_with_a_lamp(job):
    names = job(", lamp =")
    H = names["hanging"].reaction(names["cable"].end)[-1, 0]
    assert names["across"](H) == pytest.approx(0, abs=0.002)


def test_a_column_by_the_second_order(job):
    """Printed values of the table, the last row."""
    names = job("column = ")
    bent, post = names["bent"], names["post"]
    assert bent.reaction(post.start)[-1, 2] == pytest.approx(856, rel=0.002)
    assert bent.displacement(post.end)[-1, 0] == pytest.approx(2.60, abs=0.005)


def test_a_rack_with_semi_rigid_joints(job):
    names = job("shelf")
    H, h, EI, P = (names[name] for name in ("H", "h", "EI", "P"))
    assert names["first"] == pytest.approx(H * h**2 * (h / (6 * EI) + names["turn"] / 2), rel=2e-4)
    assert names["n"] == pytest.approx(names["x"] ** 2 * EI / h**2 / P, rel=2e-4)
    assert names["sway"] == pytest.approx(names["first"] / (1 - 1 / names["n"]), rel=0.002)


def test_a_robot_on_two_cables(job):
    names = job("winches")
    tensions, place, k = names["tensions"], names["place"], names["k"]
    assert names["away"] < 2 * tensions.max() / k
    t, h = names["led"].t[1:-1], 1e-4
    acceleration = np.array([(place(s + h) - 2 * place(s) + place(s - h)) / h**2 for s in t])
    ways = names["winches"][:, None] - np.array([place(s) for s in t])
    ways /= np.linalg.norm(ways, axis=-1, keepdims=True)
    needed = names["mass"] * (acceleration + (0, 9.81))
    exact = np.linalg.solve(np.moveaxis(ways, 0, -1), needed[..., None])[..., 0].T
    # What is left is a vibration on the cables, which nothing damps.
    error = tensions[:, 1:-1] - exact
    assert np.sqrt((error**2).mean()) < 0.05 * exact.max()


def test_a_floor_on_a_shaking_table(job):
    """The formula has no mass of the posts and small angles; 1 % is left."""
    names = job("floor")
    assert abs(names["sway"] - names["exact"]).max() < 0.02 * abs(names["exact"]).max()


def test_an_arm_behind_a_gearbox(job):
    names = job("fb.Gear")
    turned, gone, n = names["turned"], names["gone"], names["n"]
    assert turned == pytest.approx(-gone[-1] / n, rel=1e-3)
    least = names["stall"] * (1 - names["J"] / names["felt"]) * n
    assert names["couple"] == pytest.approx(least, rel=2e-3)
