"""What a terminal and a notebook show of objects, and the notebooks of demos."""

import importlib
import re

import pages
import pytest
from scenes import DEMOS, clamped_bar

import fx_beam as fb

SECTION = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.01)


@pytest.fixture(scope="module")
def objects():
    """Each object that users look at, by its name."""
    scene, upper = clamped_bar((1, 0), SECTION, elements=4, name="upper", gravity=(0, -9.81))
    lower = scene.add_beam([(1, 0), (2, 0)], SECTION, elements=4, name="<lower>")
    pin = scene.add_joint(fb.Revolute(upper.end, lower.start, spring=fb.Spring(3.0)))
    scene.add_force_between(lower.end, (2, 5), spring=fb.Spring(2.0), damper=fb.Damper(0.5))
    scene.add_contact(lower, fb.Line((0, -3), (0, 1)), 1e3)
    solution = fb.simulate(scene, dt=0.01, t_end=0.1)
    return {
        "Scene": scene,
        "Joint": pin,
        "Contact": scene.contacts[0],
        "ForceBetween": scene.forces_between[0],
        "Solution": solution,
        "Energy": solution.energy,
        "Stats": solution.stats,
        "BeamResultants": solution.resultants("upper"),
        "Modes": fb.modes(scene),
    }


def test_a_terminal_shows_a_line_and_no_arrays(objects):
    for kind, thing in objects.items():
        text = repr(thing)
        assert "\n" not in text and len(text) < 300 and "array(" not in text, kind
        assert text[0] == "<" and text[-1] == ">"


def test_the_line_has_the_numbers_of_the_object(objects):
    assert "members 2: upper, <lower>" in repr(objects["Scene"])
    assert re.search("joint 0, Revolute of node 4", repr(objects["Joint"]))
    energy = objects["Energy"]
    assert f"total {energy.total[0]:.6g} to {energy.total[-1]:.6g} J" in repr(energy)
    assert "10 steps with 0 halvings" in repr(objects["Stats"])
    assert "force 0, between node 9 at (2, 0) and (2, 5)" in repr(objects["ForceBetween"])
    frequencies = objects["Modes"].frequencies
    assert f"from {frequencies.min():.4g} to {frequencies.max():.4g} Hz" in repr(objects["Modes"])


def test_a_notebook_shows_a_table_without_what_users_named_as_html(objects):
    for kind in ("Scene", "Joint", "ForceBetween", "Solution", "Energy", "Stats", "Modes"):
        text = objects[kind]._repr_html_()
        assert "<lower>" not in text, kind
        assert "<table>" in text or "<pre>" in text, kind


@pytest.mark.parametrize(("kind", "lines"), [("Scene", 2), ("Solution", 10), ("Energy", 4)])
def test_a_notebook_shows_a_small_picture(objects, kind, lines):
    text = objects[kind]._repr_html_()
    assert len(re.findall(r"M-?[\d.]+,", text)) == lines
    width, height = map(int, re.search('<svg width="(\\d+)" height="(\\d+)"', text).groups())
    assert 0 < width <= 240 and 0 < height <= 240
    places = re.findall(r"(-?[\d.]+),(-?[\d.]+)", text[text.index("<path") :])
    assert all(-1 <= float(x) <= width + 1 and -1 <= float(y) <= height + 1 for x, y in places)


def test_tables_name_what_acts_and_nothing_else(objects):
    assert "stiffness=3.0" in objects["Joint"]._repr_html_()
    between = objects["ForceBetween"]._repr_html_()
    assert "stiffness=2.0" in between and "viscosity=0.5" in between and "motor" not in between
    numbers = re.findall(r"\d+\.\d+", objects["Stats"]._repr_html_())
    assert max(map(len, numbers)) < 10


def test_an_empty_scene_and_a_solution_without_motion_are_shown_too():
    assert "<svg" not in fb.Scene()._repr_html_()
    scene = fb.Scene()
    scene.clamp(scene.add_beam([(0, 0), (1, 0)], SECTION, elements=1).start)
    solution = fb.simulate(scene, dt=0.1, t_end=0.2, record=fb.Record(motion=False))
    assert "<table>" in solution._repr_html_()
    every_second = fb.simulate(scene, dt=0.1, t_end=0.4, record=fb.Record(every=2))
    assert "2 steps to t = 0.2" in repr(solution)
    assert "3 rows to t = 0.4" in repr(every_second)


@pytest.mark.slow
@pytest.mark.plot
@pytest.mark.parametrize("name", ["shallow_arch", "slider_crank"])
def test_the_notebook_of_a_demo_runs_and_has_its_motion_inline(name, monkeypatch):
    client = pytest.importorskip("nbclient")
    pytest.importorskip("jupytext")
    monkeypatch.syspath_prepend(str(pages.ROOT / "docs" / "extensions"))
    notebooks = importlib.import_module("notebooks")
    book = client.execute(notebooks.of_demo(DEMOS[name]))
    *_, report, motion = (cell.outputs for cell in book.cells if cell.cell_type == "code")
    assert name in notebooks.SHOWN and report[0].text
    assert re.match("<iframe.*canvas.*</iframe>", motion[-1].data["text/html"], re.DOTALL)


@pytest.mark.slow
@pytest.mark.plot
def test_the_tutorial_is_a_notebook_that_runs(tmp_path, monkeypatch):
    client = pytest.importorskip("nbclient")
    pytest.importorskip("jupytext")
    monkeypatch.syspath_prepend(str(pages.ROOT / "docs" / "extensions"))
    monkeypatch.chdir(tmp_path)
    page = pages.ROOT / "docs" / "tutorial.md"
    client.execute(importlib.import_module("notebooks").of_page(pages.text(page)))
    assert (tmp_path / "latch.py").is_file() and (tmp_path / "latch_bolt.png").is_file()
