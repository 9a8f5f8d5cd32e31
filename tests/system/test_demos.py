"""Each demo runs once, draws its pictures, and its numbers are those it claims."""

import ast
import importlib
import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from demo_runs import FILMS, PICTURES, RESULTS, numbers
from scenes import DEMOS, demo

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", sorted(DEMOS))
def test_demo_returns_finite_numbers(name):
    found = numbers(name)
    assert isinstance(found, dict) and found
    json.dumps(found, allow_nan=False)


@pytest.mark.parametrize("name", ["pendulum", "three_bar_swing", "multibody", "pinned_beam"])
def test_demos_of_the_paper_say_what_is_not_in_it(name, capsys):
    own = numbers(name)["not in the paper"]
    demo(name).report(numbers(name))
    printed = capsys.readouterr().out
    assert "time steps" in " ".join(own) and "alpha of HHT" in own
    assert all(f"{what}: {why}" in printed for what, why in own.items())


@pytest.mark.plot
@pytest.mark.parametrize("name", sorted(DEMOS))
def test_demo_draws_its_pictures(name):
    from PIL import Image

    found, directory = numbers(name), Path(RESULTS.name) / name
    assert json.loads((directory / "summary.json").read_text()).keys() == found.keys()
    for file in PICTURES[name]:
        with Image.open(directory / file) as picture:
            first = np.asarray(picture.convert("L"), dtype=float)
            # 2 inches less some pixels, on which fonts decide, at 150 dots per inch.
            assert min(first.shape) > 1.9 * 150
            assert first.std() > 10, f"{file} is blank"
            if file.endswith(".gif"):
                frames, drawn, fps = FILMS[name]
                assert (directory / file).stat().st_size * frames / drawn < 2e6
                assert frames / fps < 10 and picture.n_frames <= drawn
                picture.seek(picture.n_frames // 2)
                assert (np.asarray(picture.convert("L")) != first).any(), f"{file} stands still"


def test_all_scripts_start_in_the_same_way():
    for name, path in DEMOS.items():
        *_, guard = ast.parse(path.read_text()).body
        assert ast.unparse(guard.test) == "__name__ == '__main__'", name
        (start,) = guard.body
        assert ast.unparse(start).startswith("script.run("), name


@pytest.mark.parametrize("argument", [[], ["somewhere"]])
def test_results_go_to_a_folder_named_after_the_demo_or_to_the_one_given(
    monkeypatch, caplog, argument
):
    given = []
    caplog.set_level("INFO", "fx_beam")  # is restored afterwards, as the next one
    caplog.set_level("INFO", "fx_beam.demo")
    script = importlib.import_module("shared.script")
    monkeypatch.setattr(script, "main", lambda demo, folder: given.append((demo, folder)))
    monkeypatch.setattr(script.logging, "basicConfig", lambda **_: None)
    ring = SimpleNamespace(__file__=str(DEMOS["ring"]))
    monkeypatch.setitem(sys.modules, "__main__", ring)
    monkeypatch.setattr(sys, "argv", ["ring.py", *argument])
    script.run()
    usual = DEMOS["ring"].resolve().parents[1] / "results" / "ring"
    assert given == [(ring, Path("somewhere") if argument else usual)]


def test_a_demo_runs_as_a_script(tmp_path):
    # The quickest; the others differ in what main does, which the tests above have run.
    command = [sys.executable, DEMOS["relaxation"], tmp_path]
    script = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert script.returncode == 0, script.stderr
    assert (tmp_path / "summary.json").exists()
    assert (tmp_path / "printed.txt").read_text() == script.stdout
