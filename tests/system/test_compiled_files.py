"""Compiled libraries: what is said without a compiler, and which ones the cache keeps."""

import os
import subprocess
import sys
from pathlib import Path

from fx_beam import library_cache

SCRIPT = """
import fx_beam as fb
scene = fb.Scene()
scene.clamp(scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0)).start)
fb.static(scene)
"""


def test_without_a_compiler_one_sentence_names_what_to_install(tmp_path):
    own = {"XDG_CACHE_HOME": str(tmp_path), "CC": "no-such-compiler"}
    call = [sys.executable, "-c", SCRIPT]
    run = subprocess.run(call, capture_output=True, text=True, env={**os.environ, **own})
    last = run.stderr.strip().splitlines()[-1]
    assert last.startswith("RuntimeError: there is no C compiler 'no-such-compiler'")
    assert "apt-get install gcc" in last and run.stderr.count("Traceback") == 1


def _build(name):
    def builder(scratch):
        (scratch / name).write_bytes(b"x" * 1000)
        return name

    return library_cache.loaded(name, lambda _: None, builder)


def test_a_full_cache_loses_what_was_not_used_for_longest(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.setattr(library_cache, "LARGEST", 3500)
    place = library_cache.folder()
    for age, name in enumerate(("a.so", "b.so", "c.so")):
        _build(name)
        os.utime(place / name, (1e9 + age, 1e9 + age))
    assert library_cache.load("a.so", Path.exists)  # used again
    _build("d.so")
    assert {file.name for file in place.glob("*.so")} == {"a.so", "c.so", "d.so"}


def test_a_link_in_the_place_of_the_second_folder_is_not_used(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "file"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    (tmp_path / "elsewhere").mkdir(mode=0o755)
    (tmp_path / f"fx_beam-{os.geteuid()}").symlink_to(tmp_path / "elsewhere")
    try:
        _build("a.so")
    except OSError as error:
        assert "nothing can be compiled" in str(error)
    assert not list((tmp_path / "elsewhere").iterdir())
