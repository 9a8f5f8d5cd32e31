"""The documentation: its code runs, its links lead somewhere, and all that is public is in it."""

import importlib
import itertools
import re

import pages
import pytest
from PIL import Image

import fx_beam as fb
from fx_beam_studies import stability, work_precision

DOCS = pages.ROOT / "docs"
PAGES = sorted(
    page
    for page in DOCS.rglob("*.md")
    if not {"_build", "gallery"} & set(page.relative_to(DOCS).parts[:-1])
)
DEMOS = sorted((pages.ROOT / "demos").glob("*.py"))
BLOCKS = [(page, number) for page in PAGES for number in range(len(pages.blocks(page)))]
MODULES = {
    "fx_beam": fb,
    "fx_beam.plot": fb.plot,
    "fx_beam.materials": fb.materials,
    "fx_beam_studies.work_precision": work_precision,
    "fx_beam_studies.stability": stability,
}


def name_of(page):
    return str(page.relative_to(DOCS).with_suffix(""))


def public():
    pytest.importorskip("dolfinx")
    modules = MODULES | {"fx_beam.fenicsx": importlib.import_module("fx_beam.fenicsx")}
    return [f"{name}.{public}" for name, module in modules.items() for public in module.__all__]


@pytest.mark.slow
@pytest.mark.plot
@pytest.mark.parametrize(
    ("page", "number"), BLOCKS, ids=[f"{name_of(page)}-{number}" for page, number in BLOCKS]
)
def test_each_piece_of_code_runs_alone(page, number, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    block = pages.blocks(page)[number]
    monkeypatch.syspath_prepend(tmp_path)
    for other in pages.blocks(page):  # some are files that the others import
        if name := re.match(r"# (\w+\.py)\n", other):
            (tmp_path / name[1]).write_text(other, encoding="utf-8")
    if page.stem in ("libraries", "fenicsx", "section_forces"):
        for name in re.findall(r"^(?:import|from) (\w+)", block, flags=re.MULTILINE):
            pytest.importorskip(name)
    names = pages.run(block, page)
    said = capsys.readouterr().out
    assert said
    if page.stem == "failing_steps":
        assert "a node turns by" in said
    if "peg" in names:
        assert names["contact"].gap.min() < 0  # it is met
    # Pictures beside the code are those that it draws.
    for shown, _ in pages.links(page):
        if (tmp_path / shown.name).is_file():
            with Image.open(tmp_path / shown.name) as ours, Image.open(shown) as theirs:
                assert max(abs(a - b) for a, b in zip(ours.size, theirs.size, strict=True)) < 50
    if isinstance(names.get("motion"), fb.Solution):
        assert {path.suffix for path in tmp_path.iterdir()} == {".png", ".gif", ".csv", ".npz"}
        assert (fb.load("motion.npz").q == names["motion"].q).all()
    if "upright" in names:
        assert abs(names["motion"].outputs["spin"]) < 1e-3  # it rests, and does not ring
    if "second" in names:
        assert abs(names["second"].q[-1] - names["whole"].q[-1]).max() < 1e-9
    if "study" in names:
        # What it is written for: the tip converges, and energy is conserved.
        errors = [run.errors for run in names["study"].runs if run.scheme == "EnergyMomentum"]
        assert max(error["energy"] for error in errors) < 1e-9
        assert min(error["tip path"] for error in errors) < 0.1


@pytest.mark.parametrize("page", PAGES + list(pages.ROOT.glob("*.md")), ids=lambda p: p.name)
def test_links_and_names_of_files_lead_to_files_and_definitions(page):
    assert not pages.missing(page)
    folders = "demos|tests|benchmarks|fx_beam"
    for file in re.findall(rf"`((?:{folders})/[\w/]+\.\w+)`", pages.text(page)):
        assert (pages.ROOT / file).is_file(), file


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_each_page_can_be_reached(page):
    if page == DOCS / "index.md":
        return
    if page.parent.name == "outcomes":  # part of a demo's page
        assert (pages.ROOT / "demos" / f"{page.stem}.py").is_file()
        return
    home = page.parent if page.name != "index.md" else page.parent.parent
    home = DOCS / "index.md" if home == DOCS else home / "index.md"
    entry = name_of(page).removeprefix(f"{name_of(home.parent / 'x')[:-1]}")
    assert re.search(rf"^({entry}|[\w -]+ <{entry}>)$", pages.text(home), flags=re.MULTILINE)


def test_the_home_has_the_example_of_the_readme():
    assert pages.blocks(DOCS / "index.md") == pages.blocks(pages.ROOT / "README.md")


def test_each_demo_is_in_the_gallery_once_and_has_a_text_on_its_results():
    links = [file for file, _ in pages.links(DOCS / "gallery.md")]
    shown = sorted(file.stem for file in links if file.suffix == ".py")
    demos = {demo.stem for demo in DEMOS}
    assert shown == sorted([*demos, *demos])  # its picture and its name
    assert {page.stem for page in (DOCS / "outcomes").glob("*.md")} == demos  # on their pages


def test_all_that_is_public_is_in_the_interface_once():
    interface = "\n".join(pages.text(page) for page in (DOCS / "interface").glob("*.md"))
    listed = re.findall(r"^\.\. auto\w+:: (\S+)", interface, flags=re.MULTILINE)
    methods = [
        f"fx_beam.{kind.__name__}.{name}"
        for kind in (fb.Scene, fb.Solution)
        for name in dir(kind)
        if not name.startswith("_")
    ]
    assert sorted(listed) == sorted([*public(), *methods])


@pytest.mark.parametrize("kind", [fb.Scene, fb.Solution])
def test_each_method_is_in_a_table_of_its_page(kind):
    page = pages.text(DOCS / "interface" / f"{kind.__name__.lower()}.md")
    listed = re.findall(rf"^   ~fx_beam\.{kind.__name__}\.(\w+)$", page, flags=re.MULTILINE)
    assert sorted(listed) == [name for name in dir(kind) if not name.startswith("_")]


def test_the_tables_and_the_first_page_of_the_interface_name_what_its_pages_have():
    folder = DOCS / "interface"
    for page in set(folder.glob("*.md")) - {folder / "index.md"}:
        text = pages.text(page)
        entries = re.findall(r"^\.\. auto\w+:: (\S+)", text, flags=re.MULTILINE)
        entries = [name for name in entries if not re.match(r"fx_beam\.(Scene|Solution)\.", name)]
        listed = re.findall(r"^   ~(\S+)$", text, flags=re.MULTILINE)
        listed = [name for name in listed if not re.search(r"[A-Z]\w+\.", name)]
        assert sorted(listed) == sorted(entries)
        row = re.search(rf"\({page.name}\) \|(.*)\|", pages.text(folder / "index.md"))[1]
        names = [re.sub(r"^fx_beam(_studies)?\.", "", name) for name in entries]
        assert sorted(re.findall(r"`(\S+)`", row)) == sorted(names)


def test_every_equation_of_the_paper_is_in_the_table():
    rows = re.findall(r"^\| ([\d, to]+) \|", pages.text(DOCS / "theory" / "equations.md"), re.M)
    names = set()
    for part in ",".join(rows).split(","):
        first, _, last = part.strip().partition(" to ")
        names |= set(range(int(first), int(last or first) + 1))
    assert names == set(range(1, 55))


def test_formulas_have_braces_around_parts_of_fractions():
    """A renderer reads two digits as one number."""
    for page in PAGES + DEMOS:
        for formula in itertools.chain(*pages.formulas(page)):
            assert not re.search(r"frac\s*\d", formula)


def test_formulas_are_ones_that_can_be_drawn():
    latex = pytest.importorskip("docutils.utils.math.latex2mathml")
    for page in PAGES + DEMOS:
        for formula in itertools.chain(*pages.formulas(page)):
            assert latex.tex2mathml(formula)


def test_formulas_that_schemes_write_can_be_drawn(monkeypatch):
    latex = pytest.importorskip("docutils.utils.math.latex2mathml")
    monkeypatch.syspath_prepend(str(DOCS / "extensions"))
    from written import formulas

    text = formulas(pages.text(DOCS / "theory" / "equations.md"))
    written = re.findall(r"\$\$(.*?)\$\$", text, flags=re.DOTALL)
    assert len(written) == 4
    assert all(latex.tex2mathml(formula, as_block=True) for formula in written)


@pytest.mark.parametrize("demo", DEMOS, ids=lambda demo: demo.stem)
def test_a_demo_has_its_formulas_in_latex_and_no_indented_lines(demo):
    words = re.sub(r"\$\$.*?\$\$|\$[^$]+\$", "x", pages.prose(demo), flags=re.DOTALL)
    assert not re.search(r"^ {4}\S|[\^$]|\bsqrt\b", words, flags=re.MULTILINE)
