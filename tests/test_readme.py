"""The README's code runs as it stands, and its pictures are there."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_code_of_the_readme_runs_from_top_to_bottom(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    blocks = re.findall(r"```python\n(.*?)```", README, flags=re.DOTALL)
    names = {}
    for block in blocks:
        exec(compile(block, "README.md", "exec"), names)
    assert blocks and capsys.readouterr().out
    assert {path.suffix for path in Path("results").iterdir()} == {".json", ".md", ".png"}
    # What it is written for: the tip converges, and energy is kept.
    found = names["found"]
    errors = {run.dt: run.errors for run in found.runs if run.scheme == "EnergyMomentum"}
    assert max(error["energy"] for error in errors.values()) < 1e-9
    assert min(error["tip path"] for error in errors.values()) < 0.1


def test_pictures_of_the_readme_are_in_the_repository():
    pictures = re.findall(r"!\[.*?\]\((.*?)\)", README)
    assert pictures and all((ROOT / picture).is_file() for picture in pictures)
