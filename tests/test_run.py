"""`./run` knows the systems it serves, and installs nothing on others."""

import os
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# A system in which nothing is installed, and that offers one version of dolfinx.
SYSTEM = {
    "dpkg-query": "exit 1",
    "apt-cache": 'echo "python3-dolfinx:"; echo "  Candidate: $OFFERED"',
    "sudo": 'exec "$@"',
    "apt-get": r"""
echo "$*" >>"$CALLS"
case $* in *install*) ;; *) exit ;; esac
echo "0 upgraded, 10 newly installed, 0 to remove and 0 not upgraded."
echo "Need to get 304 MB of archives."
for name in 1 2 3 4 5 6 7 8 9 10; do
    echo "Get:$name somewhere"
    echo "Unpacking p$name"
    echo "Setting up p$name"
done
""",
}


@pytest.fixture
def call(tmp_path):
    """`./run demos one` in a clone of its own, on a system with a version of dolfinx."""
    (tmp_path / "demos").mkdir()
    (tmp_path / "demos" / "one.py").write_text("")
    for name in ("run", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    stubs = tmp_path / "stubs"
    stubs.mkdir()
    for name, script in SYSTEM.items():
        (stubs / name).write_text(f"#!/bin/sh\n{script}\n")
        (stubs / name).chmod(0o755)
    calls = tmp_path / "calls"
    calls.touch()

    def run(offered):
        environment = os.environ | {
            "PATH": f"{stubs}:{os.environ['PATH']}",
            "OFFERED": offered,
            "CALLS": str(calls),
        }
        done = subprocess.run(
            [tmp_path / "run", "demos", "one"],
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        return done, calls.read_text()

    return run


@pytest.mark.parametrize(
    ("offered", "version"),
    [("1:0.7.3-4", "0.7.3"), ("1:0.10.0-1", "0.10.0"), ("0.3.0-9", "0.3.0"), ("2:0.50-1", "0.50")],
)
def test_a_version_that_is_not_served_is_named_and_nothing_is_installed(call, offered, version):
    done, calls = call(offered)
    assert done.returncode == 1
    assert calls == ""
    assert f"has dolfinx {version}. " in done.stderr
    assert "Supported systems are Debian 12, 13 and sid, with dolfinx 0.5, 0.9, 0.11" in done.stderr


def test_a_system_without_dolfinx_is_asked_for_its_list_and_no_more(call):
    done, calls = call("(none)")
    assert done.returncode == 1
    assert calls.splitlines() == ["update -qq"]
    assert "has no package python3-dolfinx" in done.stderr


@pytest.mark.parametrize("version", ["1:0.5.2-1", "1:0.9.0-11+b1", "1:0.11.0.post0-1"])
def test_a_version_that_is_served_is_installed_with_progress(call, version):
    done, calls = call(version)
    assert "python3-dolfinx" in calls.splitlines()[-1]
    said = done.stderr.splitlines()
    assert "run: Need to get 304 MB of archives." in said
    assert [line for line in said if "%" in line] == [
        f"run: Debian packages: {tenth}0 %" for tenth in range(1, 11)
    ]
    # The installation was none, which does not go unseen.
    assert done.returncode == 1
    assert "apt-get has not installed: python3-dolfinx" in said[-1]


def test_only_the_documentation_has_sphinx_installed():
    prepared = [
        line.strip() for line in (ROOT / "run").read_text().splitlines() if "prepare " in line
    ]
    assert [line for line in prepared if "docs" in line] == ["prepare plot docs"]
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"][
        "optional-dependencies"
    ]
    assert {name for name, wanted in extras.items() if "sphinx" in wanted} == {"docs"}
