"""The package as it is installed, for scripts anywhere and without ./run."""

import os
import subprocess
import sys

import pytest


@pytest.fixture
def script(tmp_path):
    """Runs a script in a folder of its own, in an environment that knows nothing of the project."""

    def run(code, **environment):
        (tmp_path / "script.py").write_text(code)
        known = {
            name: os.environ[name]
            for name in ("PATH", "HOME", "XDG_CACHE_HOME")
            if name in os.environ
        }
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
    assert script("import fx_beam; print(fx_beam.Scene)") == "<class 'fx_beam.scene.Scene'>\n"


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
fb.plot.shapes(fb.simulate(scene, dt=0.1, t_end=0.1), [0, 1], "shapes.png")
"""
    assert script(code) == ""
