"""The site: its formulas, drawn by a browser that has no font for them, and its pages of demos."""

import ast
import importlib
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import browser
import pages
import pytest

DOCS = pages.ROOT / "docs"
LONG = r"\int_0^L \frac{\bar R}{1 + \tan^2(\Delta\psi/2)} \sqrt{\frac{a}{b}}\, ds"

# What is measured: 1 if the font of the site is there, the height of an integral over that of a
# letter, for each formula what is cut above or below, and the italic letters, Latin and Greek, that
# the font lacks: they have the same box without it.
SCRIPT = """
document.fonts.load('16px "fx_beam Math"').then(async fonts => {
  await document.fonts.ready;
  const height = one => one.getBoundingClientRect().height;
  const symbol = name => [...document.querySelectorAll('.formula mo, .formula mi')]
    .find(one => one.textContent == name);
  const pen = document.createElement('canvas').getContext('2d');
  const box = (letter, font) => {
    pen.font = `40px ${font}`;
    const {width, actualBoundingBoxAscent, actualBoundingBoxRight} = pen.measureText(letter);
    return `${width} ${actualBoundingBoxAscent} ${actualBoundingBoxRight}`;
  };
  const range = (first, count) => [...Array(count).keys()].map(n => first + n);
  const letters = [0x210E, ...range(0x1D434, 52), ...range(0x1D6FC, 25)]
    .filter(code => code != 0x1D455).map(code => String.fromCodePoint(code));
  document.title = JSON.stringify({
    fonts: fonts.length,
    missing: letters.filter(one => box(one, '"fx_beam Math", serif') == box(one, 'serif')),
    integral: height(symbol('∫')) / height(symbol('L')),
    cut: [...document.querySelectorAll('.formula')]
      .map(one => one.scrollHeight - one.clientHeight),
  });
});
"""


@pytest.fixture
def extension(monkeypatch):
    """Imports an extension of the site."""
    pytest.importorskip("docutils.utils.math.latex2mathml")
    monkeypatch.syspath_prepend(str(DOCS / "extensions"))
    return importlib.import_module


@pytest.fixture
def drawn(extension):
    """Function that makes MathML of LaTeX."""
    return extension("mathml").block


@pytest.mark.slow
@browser.needed
def test_formulas_are_whole_where_the_system_has_no_font_for_them(drawn, tmp_path, monkeypatch):
    matplotlib = pytest.importorskip("matplotlib")
    letters = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    (tmp_path / "fonts.conf").write_text(f"<fontconfig><dir>{letters}</dir></fontconfig>")
    monkeypatch.setenv("FONTCONFIG_FILE", str(tmp_path / "fonts.conf"))
    for name in ("style.css", "math.woff2"):
        shutil.copy(DOCS / "_static" / name, tmp_path)
    written = [*DOCS.rglob("*.md"), *(pages.ROOT / "demos").glob("*.py")]
    blocks = [block for page in sorted(written) for block in pages.formulas(page)[0]]
    formulas = [LONG, *blocks]
    page = tmp_path / "page.html"
    page.write_text(
        '<!DOCTYPE html><meta charset="utf-8"><link rel="stylesheet" href="style.css">'
        + "".join(map(drawn, formulas))
        + f"<script>{SCRIPT}</script>"
    )
    dom = browser.dom(page, tmp_path)
    measured = json.loads(re.search("<title>(.*?)</title>", dom)[1])
    assert measured["fonts"] == 1
    assert not measured["missing"]
    assert measured["integral"] > 1.5
    assert len(measured["cut"]) == len(formulas) > 20
    assert max(measured["cut"]) <= 0


def built_page(text, folder):
    """Folder of a site of one page with the settings of the whole site."""
    (folder / "index.md").write_text(text)
    command = [sys.executable, "-m", "sphinx", "-q", "-c", str(DOCS), str(folder)]
    subprocess.run(
        [*command, str(folder / "html"), "-D", "extensions=myst_parser,mathml"],
        check=True,
        capture_output=True,
        timeout=120,
    )
    return folder / "html"


@pytest.mark.slow
def test_the_search_knows_the_words_of_other_fields(tmp_path):
    search = pytest.importorskip("sphinx.search.en").SearchEnglish({})
    pytest.importorskip("pydata_sphinx_theme")
    html = built_page(pages.text(DOCS / "howto" / "index.md"), tmp_path)
    index = re.search(r"\((\{.*\})\)", (html / "searchindex.js").read_text(), re.DOTALL)[1]
    known = {*json.loads(index)["terms"]}
    words = (
        "belt tendon rope cable chain hinge pin Kelvin Voigt Rayleigh Riks linkage muscle bumper "
        "FMU Gymnasium JAX PyTorch DXF SVG Jupyter units brace stress envelope spectrum"
    )
    assert not {word for word in words.split() if search.stem(word.lower()) not in known}


def test_a_quick_build_shows_what_an_earlier_run_has_printed(extension, tmp_path, monkeypatch):
    [pytest.importorskip(name) for name in ("sphinx", "jupytext")]
    gallery = extension("gallery")
    monkeypatch.setattr(gallery, "ROOT", tmp_path)
    monkeypatch.setattr(gallery, "RESULTS", tmp_path / "built")
    monkeypatch.setenv("FX_BEAM_DOCS", "quick")
    demo = tmp_path / "demos" / "ring.py"
    assert gallery.run(demo) == tmp_path / "built" / "ring"
    (tmp_path / "results" / "ring").mkdir(parents=True)
    (tmp_path / "results" / "ring" / "printed.txt").write_text("1.5 Hz")
    assert gallery.run(demo) == tmp_path / "results" / "ring"


def test_a_page_of_the_gallery_has_all_code_of_its_demo(extension):
    for demo in (pages.ROOT / "demos").glob("*.py"):
        pieces = extension("scripts").pieces(pages.text(demo))
        code = "\n".join("\n".join(code) for _, code in pieces)
        for tree in (joined := ast.parse(code), wanted := ast.parse(pages.text(demo))):
            for node in ast.walk(tree):
                if isinstance(node, (ast.Module, ast.FunctionDef)) and ast.get_docstring(node):
                    node.body = node.body[1:]
        assert ast.dump(joined) == ast.dump(wanted), demo


@pytest.mark.slow
@pytest.mark.plot
def test_the_code_on_a_page_of_the_gallery_runs_where_it_is_copied(
    extension, tmp_path, monkeypatch
):
    monkeypatch.setenv("FX_BEAM_DOCS", "quick")
    gallery = extension("gallery")
    for demo in (pages.ROOT / "demos").glob("*.py"):
        page = gallery.page(demo, tmp_path)
        code = "\n\n".join(re.findall(r"```python\n(.*?)\n```", page, flags=re.DOTALL))
        assert "shared" not in code and compile(code, demo.name, "exec"), demo
        if demo.stem == "moving_mass":
            (tmp_path / "copied.py").write_text(code, encoding="utf-8")
    subprocess.run([sys.executable, "copied.py"], cwd=tmp_path, check=True)
    assert (tmp_path / "scene.png").is_file()
