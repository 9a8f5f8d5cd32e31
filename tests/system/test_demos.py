"""Each demo runs once, draws its pictures, and its numbers are those it claims."""

import ast
import json
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest
from demo_runs import FILMS, PICTURES, drawn, numbers
from scenes import DEMOS, demo

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("name", sorted(DEMOS))
def test_demo_returns_finite_numbers(name):
    demo_numbers = numbers(name)
    assert isinstance(demo_numbers, dict) and demo_numbers
    json.dumps(demo_numbers, allow_nan=False)


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

    demo_numbers, directory = numbers(name), drawn(name)
    assert json.loads((directory / "summary.json").read_text()).keys() == demo_numbers.keys()
    for file in PICTURES[name]:
        with Image.open(directory / file) as picture:
            first = np.asarray(picture.convert("L"), dtype=float)
            assert first.std() > (1 if file == "thumbnail.png" else 10), f"{file} is blank"
            # 2 inches less some pixels, on which fonts decide, at 150 dots per inch.
            assert file == "thumbnail.png" or min(first.shape) > 1.9 * 150
            if file.endswith(".gif"):
                frames, few, fps = FILMS[name] if file == "motion.gif" else (1, 1, 20)
                assert (directory / file).stat().st_size * frames / few < 2e6
                assert frames / fps < 10 and picture.n_frames <= max(few, 80)
                picture.seek(picture.n_frames // 2)
                assert (np.asarray(picture.convert("L")) != first).any(), f"{file} stands still"


def test_all_scripts_start_in_the_same_way():
    for name, path in DEMOS.items():
        *_, guard = ast.parse(path.read_text()).body
        assert ast.unparse(guard.test) == "__name__ == '__main__'", name
        (start,) = guard.body
        assert ast.unparse(start).startswith("script.run("), name


DEMO = """'''A demo.'''
from shared import script
def compute(): return {"x": 1}, ()
def report(numbers): print(numbers)
def draw(results): (results / "b.png").touch(), (results / "a.gif").touch()
if __name__ == "__main__": script.run()
"""


def test_a_demo_says_what_it_is_its_numbers_and_the_pictures_in_the_folder_given(tmp_path):
    shutil.copytree(DEMOS["ring"].parent / "shared", tmp_path / "demos" / "shared")
    (tmp_path / "demos" / "one.py").write_text(DEMO)
    for folder in ("somewhere", "results/one"):
        command = [sys.executable, "demos/one.py", *([folder] if folder == "somewhere" else [])]
        said = subprocess.check_output(command, cwd=tmp_path, text=True).splitlines()
        assert said[:2] == ["A demo.", "{'x': 1}"]
        assert re.fullmatch(rf"pictures in \S*{folder}: a.gif b.png", said[2]) and not said[3:]
        assert json.loads((tmp_path / folder / "summary.json").read_text()) == {"x": 1}
        assert (tmp_path / folder / "printed.txt").read_text() == "{'x': 1}\n"
