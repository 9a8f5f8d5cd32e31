"""Each demo runs once, draws its pictures, and its numbers are those it claims."""

import ast
import json
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from demo_runs import PICTURES, RESULTS, numbers
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
            assert min(first.shape) > 300
            assert first.std() > 10, f"{file} is blank"
            if file.endswith(".gif"):
                assert (directory / file).stat().st_size < 2e6
                assert picture.n_frames * picture.info["duration"] < 10_000  # [ms]
                picture.seek(picture.n_frames // 2)
                assert (np.asarray(picture.convert("L")) != first).any(), f"{file} stands still"


@pytest.mark.parametrize("name", sorted(DEMOS))
def test_script_hands_its_argument_to_main(name):
    guard = ast.parse(DEMOS[name].read_text()).body[-1]
    assert ast.unparse(guard.test) == "__name__ == '__main__'"
    given = []
    # Not the real logging, which would be another one for the tests that follow.
    names = {"__file__": str(DEMOS[name]), "main": given.append, "Path": Path, "logging": Mock()}
    for arguments in ([], ["somewhere"]):
        names["sys"] = SimpleNamespace(argv=[str(DEMOS[name]), *arguments])
        exec(compile(ast.Module(guard.body, []), name, "exec"), names)
    assert given == [DEMOS[name].resolve().parents[1] / "results" / name, Path("somewhere")]


def test_a_demo_runs_as_a_script(tmp_path):
    # The quickest; the others differ in what main does, which the tests above have run.
    command = [sys.executable, DEMOS["relaxation"], tmp_path]
    script = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert script.returncode == 0, script.stderr
    assert (tmp_path / "summary.json").exists()
