"""What is compiled and run comes from the package: not from the current folder, nor the home."""

import os
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from fx_beam import c_library

HERE = Path(__file__).parent
FORM = f"""
import sys
sys.path.insert(0, {str(HERE)!r})
import test_library_cache
print(test_library_cache.form())
"""
ROWS = """
from fx_beam import c_library
print(len(c_library.open_library("rows", "elimination.h", "sparse_rows.h", (), (), ("-O1",))) + 1.0)
"""


def run(code, cwd=None, **environment):
    """The last line that a process says."""
    command, own = [sys.executable, "-c", code], os.environ | environment
    done = subprocess.run(command, cwd=cwd, env=own, capture_output=True, text=True, timeout=100)
    return (done.stdout + done.stderr).strip().splitlines()[-1]


# -- Options of FFCx -------------------------------------------------------------------------------

OPTIONS = '{"tabulate_tensor_void": true, "scalar_type": "float32", "language": "os"}'
NAMES = "ffcx_parameters.json", "ffcx_options.json"


@pytest.mark.parametrize("unreadable", [False, True])
@pytest.mark.parametrize("place", [".", ".config/ffcx"])
def test_options_of_ffcx_that_lie_about_change_nothing(place, unreadable, tmp_path):
    (tmp_path / place).mkdir(parents=True, exist_ok=True)
    for name in NAMES:
        path = tmp_path / place / name
        path.mkdir() if unreadable else path.write_text(OPTIONS)
    home, cache = str(tmp_path), str(tmp_path / "cache")
    config = str(tmp_path / ".config")
    said = run(FORM, tmp_path, HOME=home, XDG_CACHE_HOME=cache, XDG_CONFIG_HOME=config)
    assert said == "3.0"


def test_a_current_folder_that_is_gone_is_in_nobodys_way(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    code = FORM.replace("print(", f"import os; os.rmdir({str(gone)!r})\nprint(")
    assert run(code, gone, XDG_CACHE_HOME=str(tmp_path / "cache")) == "3.0"


# -- The compiler ----------------------------------------------------------------------------------


@pytest.mark.parametrize("code", [FORM, ROWS], ids=["form", "rows"])
def test_headers_that_lie_about_are_not_compiled(code, tmp_path):
    ours = [path.name for path in c_library.SOURCES.glob("*.h")]
    for name in (*ours, "math.h", "stdlib.h", "string.h", "ufcx.h"):
        (tmp_path / name).write_text("#error a header that lies about\n")
    # Places where compilers look for headers, libraries and parts of theirs.
    names = "CPATH", "C_INCLUDE_PATH", "LIBRARY_PATH", "GCC_EXEC_PREFIX", "COMPILER_PATH"
    places = dict.fromkeys(names, f"{tmp_path}/")
    (tmp_path / "as").write_text("#!/bin/sh\nexit 1\n")
    (tmp_path / "as").chmod(0o755)
    said = run(code, tmp_path, XDG_CACHE_HOME=str(tmp_path / "cache"), **places)
    assert said == "3.0"


def test_a_compiler_in_the_current_folder_is_not_meant(tmp_path):
    (tmp_path / "cc").write_text("#!/bin/sh\nexit 1\n")
    (tmp_path / "cc").chmod(0o755)
    for first in ("", ".", ".:"):
        own = {"PATH": f"{first}:{os.environ['PATH']}", "CC": "cc"}
        cache = tempfile.mkdtemp(dir=tmp_path)
        assert run(FORM, tmp_path, XDG_CACHE_HOME=cache, **own) == "3.0"


WRAPPERS = {
    "says no text": (r"printf '\377 error: \303' >&2; exit 1", "error: "),
    "writes nothing": ("exit 0", "No such file"),
    "writes half": (
        'cc "$@"; while [ "$1" != -o ]; do shift; done; truncate -s 4096 "$2"',
        "incomplete: it has only 4096 bytes",
    ),
}


@pytest.mark.parametrize("fault", WRAPPERS)
def test_what_a_compiler_does_wrong_is_said(fault, tmp_path):
    does, reason = WRAPPERS[fault]
    (tmp_path / "wrong").write_text(f"#!/bin/sh\n{does}\n")
    (tmp_path / "wrong").chmod(0o755)
    said = run(FORM, XDG_CACHE_HOME=str(tmp_path), CC=str(tmp_path / "wrong"))
    assert said.startswith("fx_beam.c_library.CannotBuild: ")
    assert reason in said and "Check the C compiler (environment variable CC)" in said


def test_a_compiler_that_is_named_by_no_command_is_refused_by_name(tmp_path):
    said = run(FORM, XDG_CACHE_HOME=str(tmp_path), CC="cc -I'x")
    assert said.startswith('RuntimeError: the environment variable CC = "cc -I\'x" is no command')
    assert run(FORM, XDG_CACHE_HOME=str(tmp_path), CC="  ") == "3.0"
    info = subprocess.run(
        [sys.executable, "-m", "fx_beam", "info"],
        env=os.environ | {"CC": "cc -I'x"},
        capture_output=True,
        text=True,
    )
    assert "CC = " in info.stdout and not info.stderr


@pytest.mark.parametrize("code", [FORM, ROWS], ids=["form", "rows"])
def test_paths_may_have_letters_that_the_locale_lacks(code, tmp_path):
    plain = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}
    for _ in range(2):  # compiled, and from the cache
        said = run(code, XDG_CACHE_HOME=str(tmp_path / "ü"), **plain)
        assert said == "3.0"
    assert list((tmp_path / "ü" / "fx_beam").glob("*.so"))
