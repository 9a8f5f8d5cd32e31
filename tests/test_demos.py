"""Each demo runs once, draws its pictures, and its numbers are those it claims."""

import ast
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
            assert min(first.shape) > 300
            assert first.std() > 10, f"{file} is blank"
            if file.endswith(".gif"):
                frames, drawn, fps = FILMS[name]
                assert (directory / file).stat().st_size * frames / drawn < 2e6
                assert frames / fps < 10 and picture.n_frames <= drawn
                picture.seek(picture.n_frames // 2)
                assert (np.asarray(picture.convert("L")) != first).any(), f"{file} stands still"


def test_scripts_hand_their_argument_to_main():
    guards = {name: ast.parse(path.read_text()).body[-1] for name, path in DEMOS.items()}
    ends = {ast.unparse(ast.Module(guard.body[-2:], [])) for guard in guards.values()}
    assert len(ends) == 1, "the scripts start main in the same way"
    for name, guard in guards.items():
        assert ast.unparse(guard.test) == "__name__ == '__main__'"
        assert all(ast.unparse(line).startswith("logging.") for line in guard.body[:-2]), name
    given = []
    names = {"__file__": str(DEMOS["ring"]), "main": given.append, "Path": Path}
    for arguments in ([], ["somewhere"]):
        names["sys"] = SimpleNamespace(argv=["ring.py", *arguments])
        exec(ends.copy().pop(), names)
    assert given == [DEMOS["ring"].resolve().parents[1] / "results" / "ring", Path("somewhere")]


def test_a_demo_runs_as_a_script(tmp_path):
    # The quickest; the others differ in what main does, which the tests above have run.
    command = [sys.executable, DEMOS["relaxation"], tmp_path]
    script = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert script.returncode == 0, script.stderr
    assert (tmp_path / "summary.json").exists()
