"""The table of what the paper says: its numbers are the demos', and what it names is there."""

import re
from pathlib import Path

import pytest
from demo_runs import PICTURES, numbers

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "theory" / "paper.md").read_text(encoding="utf-8")
# A number, perhaps with a bound before it, and the comment that says whose it is.
NUMBER = re.compile(
    r"(below |above |less than |more than )?(-?\d[\d.]*(?:e-?\d+)?)<!--(\w+): (.+?)-->"
)
CLAIMS = NUMBER.findall(PAGE)
ROWS = [line for line in PAGE.splitlines() if line.startswith("| ") and "|---" not in line]


def looked_up(demo, path):
    """A number of a demo by the keys that lead to it."""
    value = numbers(demo)
    for key in path.split(" > "):
        value = value[int(key)] if isinstance(value, list) else value[key]
    return value


def last_digit(printed):
    """Worth of one unit of the last digit of a printed number."""
    mantissa, _, exponent = printed.partition("e")
    _, _, decimals = mantissa.partition(".")
    return 10.0 ** (int(exponent or 0) - len(decimals))


@pytest.mark.parametrize("demo", sorted({demo for _, _, demo, _ in CLAIMS}))
def test_numbers_of_the_page_are_those_that_the_demos_compute(demo):
    for bound, printed, demo_name, path in CLAIMS:
        if demo_name != demo:
            continue
        computed = looked_up(demo, path)
        if bound in ("below ", "less than "):
            assert abs(computed) < float(printed), path
        elif bound in ("above ", "more than "):
            assert abs(computed) > float(printed), path
        else:
            assert computed == pytest.approx(float(printed), abs=1.01 * last_digit(printed)), path


def test_each_comment_of_the_page_is_one_that_is_checked():
    assert len(CLAIMS) == PAGE.count("<!--") > 50


def test_each_figure_of_the_paper_has_a_row():
    figures = re.findall(r"^\| Fig\. (\d+)", "\n".join(ROWS), flags=re.MULTILINE)
    assert sorted(map(int, figures)) == [*range(1, 21)]


def test_files_and_pictures_of_the_page_are_there():
    files = re.findall(r"`((?:demos|tests|benchmarks|fx_beam)/[\w.]+)`", PAGE)
    places = "\n".join(row.split("|")[2] for row in ROWS)
    shown = re.findall(r"`demos/(\w+)\.py`((?:, \w+\.(?:png|gif))*)", places)
    assert len(files) > 10 and any(pictures for _, pictures in shown)
    for file in files:
        assert (ROOT / file).is_file(), file
    for demo, pictures in shown:
        assert set(pictures.split(", ")[1:]) <= set(PICTURES[demo]), demo
