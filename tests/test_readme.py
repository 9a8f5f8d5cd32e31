"""The README's code runs as it stands, and its pictures are there."""

import re
from pathlib import Path

import pytest

import fx_beam as fb

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


BLOCKS = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)


@pytest.mark.slow
@pytest.mark.parametrize("block", BLOCKS, ids=lambda block: block.splitlines()[-1][:30])
def test_each_piece_of_code_in_the_readme_runs_alone(block, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    names = {}
    exec(compile(block, "README.md", "exec"), names)
    assert capsys.readouterr().out
    written = {path.suffix for path in tmp_path.rglob("*.*") if path.is_file()}
    if "motion" in names:
        assert written == {".png", ".gif", ".csv", ".npz"}
        assert (fb.load("motion.npz").q == names["motion"].q).all()
    if "found" in names:
        assert written == {".csv", ".json", ".md", ".png"}
        # What it is written for: the tip converges, and energy is kept.
        runs = names["found"].runs
        errors = {run.dt: run.errors for run in runs if run.scheme == "EnergyMomentum"}
        assert max(error["energy"] for error in errors.values()) < 1e-9
        assert min(error["tip path"] for error in errors.values()) < 0.1


def test_the_readme_has_code():
    assert len(BLOCKS) == 3


def test_pictures_of_the_readme_are_in_the_repository():
    pictures = re.findall(r"!\[.*?\]\((.*?)\)", README)
    assert pictures and all((ROOT / picture).is_file() for picture in pictures)
