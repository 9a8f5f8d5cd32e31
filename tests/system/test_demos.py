"""Each demo runs once, draws its pictures, and its numbers are those it claims."""

import ast
import json
import shutil
import subprocess
import sys
from pathlib import Path

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


def test_a_demo_runs_as_a_script_and_writes_into_the_folder_given_or_that_of_its_name(tmp_path):
    # The quickest, in a copy of the folder of demos; the others differ in what main does.
    copy = tmp_path / "demos" / "relaxation.py"
    shutil.copytree(DEMOS["relaxation"].parent / "shared", copy.parent / "shared")
    shutil.copy(DEMOS["relaxation"], copy)
    for given, folder in ((tmp_path / "there", "there"), (None, "results/relaxation")):
        command = [sys.executable, copy, *filter(None, [given])]
        script = subprocess.run(command, capture_output=True, text=True, timeout=300)
        assert script.returncode == 0, script.stderr
        assert (tmp_path / folder / "summary.json").exists()
        assert (tmp_path / folder / "printed.txt").read_text() == script.stdout
