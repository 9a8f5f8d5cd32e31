"""The package as it is installed, for scripts anywhere and without ./run."""

import os
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import fx_beam

ROOT = Path(__file__).parents[2]


@pytest.fixture
def script(tmp_path):
    """Runs a script in a folder of its own, in an environment that knows nothing of the project."""

    def run(code, **environment):
        (tmp_path / "script.py").write_text(code)
        names = "PATH", "HOME", "XDG_CACHE_HOME"
        known = {name: os.environ[name] for name in names if name in os.environ}
        done = subprocess.run(
            [sys.executable, tmp_path / "script.py"],
            cwd=tmp_path,
            env=known | environment,
            capture_output=True,
            text=True,
            check=True,
        )
        return done.stdout + done.stderr

    return run


def test_a_script_beside_a_clone_imports_the_package_and_not_the_clones_folder(script, tmp_path):
    (tmp_path / "fx_beam" / "fx_beam").mkdir(parents=True)
    assert script("import fx_beam; print(fx_beam.Scene.__name__)") == "Scene\n"


def test_packages_of_the_users_own_folder_are_not_seen(script, tmp_path):
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    packages = tmp_path / "home" / ".local" / "lib" / version / "site-packages"
    packages.mkdir(parents=True)
    (packages / "numpy.py").write_text("raise ImportError('the one of the user')\n")
    code = "import numpy; print(numpy.ndarray)"
    assert script(code, HOME=str(tmp_path / "home")) == "<class 'numpy.ndarray'>\n"


@pytest.mark.plot
def test_a_picture_is_drawn_without_a_display_and_without_a_word(script):
    code = """
import fx_beam as fb

scene = fb.Scene()
beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=10.0))
scene.set_velocity(beam, (1.0, 0.0))
fb.plot.shapes(fb.simulate(scene, dt=0.1, t_end=0.1), "shapes.png")
"""
    assert script(code) == ""


def test_info_says_what_a_bug_report_needs(script):
    code = """
import runpy, sys

sys.argv = ["fx_beam", "info"]
runpy.run_module("fx_beam", run_name="__main__")
"""
    # Also of a processor that the compiler does not know.
    said = script(code, FX_BEAM_MARCH="abacus")
    lines = dict(re.split(r":\s+", line, maxsplit=1) for line in said.splitlines())
    assert lines["compiled loop"].startswith("not available: FX_BEAM_MARCH = 'abacus'")
    assert lines["fx_beam"].startswith(f"{fx_beam.__version__}, ")
    assert re.match(r"\d+\.\d+\.\d+", lines["ffcx"])
    assert lines["numpy"] != "not installed"
    assert {"Python", "system", "petsc4py", "compiled loop", "compiler"} <= set(lines)
    assert "fx_beam, " in lines["cache"]


def test_after_warm_a_first_call_of_a_usual_kind_compiles_nothing(script, tmp_path):
    caches = {"XDG_CACHE_HOME": str(tmp_path), "PYTHONPATH": str(Path(fx_beam.__file__).parents[1])}

    def called(command):
        call = [sys.executable, "-m", "fx_beam", command]
        return subprocess.check_output(call, env=os.environ | caches, text=True)

    assert re.search("usual kinds: +not yet", called("info"))
    called("warm")
    assert re.search("usual kinds: +compiled: static and EnergyMomentum", called("info"))
    files = {file.name for file in (tmp_path / "fx_beam").iterdir()}
    script(
        """
import fx_beam as fb

scene = fb.Scene(gravity=(0, -9.81))
section = fb.Section.rectangle(height=0.01, width=0.02, E=70e9, nu=0.3, rho=2700.0)
beam = scene.add_beam([(0, 0), (0, 2)], section, degree=2)
arm = scene.add_beam([(0, 2), (1, 2)], section, degree=2)
scene.clamp(beam.start)
scene.add_joint(fb.Revolute(beam.end, arm.start))
fb.simulate(scene, fb.GeneralizedAlpha(), dt=0.01, t_end=0.1)
""",
        **caches,
        CC=os.environ.get("CC", "cc"),
    )
    assert {file.name for file in (tmp_path / "fx_beam").iterdir()} == files


def test_without_ffcx_an_import_says_in_one_sentence_how_to_get_it(script):
    code = """
import importlib.util

known = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name == "ffcx" else known(name, *more)
try:
    import fx_beam
except ImportError as error:
    print(error)
"""
    said = script(code)
    assert said.startswith("fx_beam needs FEniCSx") and "python3-ffcx" in said
    assert said.count("\n") == 1


def test_without_matplotlib_pictures_say_in_one_sentence_how_to_get_it(script):
    code = """
import importlib.util
import fx_beam

known = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: name != "matplotlib" and known(name, *more)
try:
    fx_beam.plot.shapes
except ImportError as error:
    print(error)
"""
    assert script(code) == (
        "pictures need matplotlib, not installed here: in a clone pip install '.[plot]'\n"
    )


def test_the_version_is_that_of_the_citation_the_recipe_and_the_changelog():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "version" not in project["project"]
    assert project["tool"]["hatch"]["version"]["path"] == "fx_beam/__init__.py"
    citation = (ROOT / "CITATION.cff").read_text()
    assert f"\nversion: {fx_beam.__version__}\n" in citation
    (date,) = re.findall(r"\ndate-released: (\d{4}-\d\d-\d\d)\n", citation)
    assert f'version: "{fx_beam.__version__}"' in (ROOT / "recipe" / "recipe.yaml").read_text()
    changes = (ROOT / "CHANGELOG.md").read_text().splitlines()
    assert f"## {fx_beam.__version__} ({date})" in changes and len(changes) <= 80


def test_what_is_imported_is_what_the_project_asks_for():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    asked = {*project["dependencies"], *project["optional-dependencies"]["plot"]}
    packages = ROOT / "fx_beam", ROOT / "benchmarks" / "fx_beam_studies"
    sources = "\n".join(path.read_text() for p in packages for path in p.rglob("*.py"))
    modules = {"pillow": "PIL", "fenics-ffcx": "ffcx"}
    for name in asked:
        module = modules.get(name, name.replace("-", "_"))
        assert re.search(rf"^\s*(import|from) {module}\b", sources, flags=re.MULTILINE), name


def test_types_are_had_by_those_who_use_the_package():
    assert (Path(fx_beam.__file__).parent / "py.typed").is_file()
