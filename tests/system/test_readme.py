"""The README is short, its code runs as it stands, and its picture is that of its code."""

import re

import pages
import pytest
from PIL import Image

README = pages.ROOT / "README.md"
PICTURE = pages.ROOT / "docs" / "pictures" / "double_pendulum.png"


def test_the_readme_is_short():
    assert len(pages.text(README).split()) <= 700


def test_its_first_commands_are_two_of_which_continuous_integration_calls_the_second():
    text = README.read_text()
    commands = [line.partition("#")[0].strip() for line in text.splitlines() if line[:4] == " " * 4]
    demo, test = commands[:2]
    assert demo == "./run demos slider_crank" and test == "./run test"
    # What the package is and a picture of it come before.
    assert text.index("Flexible multibody dynamics") < text.index("<picture>") < text.index(demo)
    assert f"{test} --all" in (pages.ROOT / ".ci" / "run").read_text()


@pytest.mark.slow
@pytest.mark.plot
def test_the_example_is_short_runs_and_draws_the_picture_below_it(tmp_path, monkeypatch, capsys):
    (block,) = pages.blocks(README)
    assert len(block.splitlines()) <= 15
    monkeypatch.chdir(tmp_path)
    names = pages.run(block, README)
    assert capsys.readouterr().out
    assert abs(names["solution"].energy.balance_error).max() < 1e-10
    with Image.open(tmp_path / PICTURE.name) as drawn, Image.open(PICTURE) as shown:
        assert max(abs(a - b) for a, b in zip(drawn.size, shown.size, strict=True)) < 50
    assert f"({PICTURE.relative_to(pages.ROOT)})" in pages.text(README)


def test_the_animated_pictures_for_light_and_dark_pages_are_small():
    animations = re.findall(r'(?:src|srcset)="([^"]+\.gif)"', pages.text(README))
    assert len(animations) == 2
    for animation in animations:
        assert (pages.ROOT / animation).stat().st_size < 1.5e6
        with Image.open(pages.ROOT / animation) as picture:
            assert picture.n_frames > 50


def test_the_paper_has_at_most_1000_words_and_cites_each_of_its_references():
    paper, references = (pages.text(pages.ROOT / "paper" / f"paper.{end}") for end in ("md", "bib"))
    assert len(paper.split()) <= 1000
    cited = set(re.findall(r"@(\w+)", paper))
    assert cited == set(re.findall(r"^@\w+\{(\w+),", references, flags=re.MULTILINE))
