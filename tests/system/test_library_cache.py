"""The cache of compiled libraries repairs itself, is shared, and is nobody else's."""

import ctypes
import errno
import os
import signal
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import ufl

import _cffi_backend
import numpy as np
import pytest

from fx_beam import c_library, errors, library_cache
from fx_beam.fem.compiled_laws import point_function


@pytest.fixture(autouse=True)
def cache(monkeypatch, tmp_path):
    """An empty cache, and an empty folder for when it cannot be written."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    (tmp_path / "temporary").mkdir(mode=0o700)
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "temporary"))
    errors.warn_once.cache_clear()
    forget(monkeypatch)
    return tmp_path / "cache" / "fx_beam"


def forget(monkeypatch):
    """As in a process that has loaded nothing."""
    for name in ("_things", "_user_things"):
        monkeypatch.setattr(c_library, name, {})
    c_library._facts.cache_clear()


def form():
    """3, by a form that FFCx compiles."""
    twice = point_function("twice", lambda x: ufl.as_vector([2 * x[0]]), 1)
    function = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 7)(twice.address)
    out, number = np.zeros(1), np.array([1.5])
    function(out.ctypes.data, None, number.ctypes.data, *[None] * 4)
    return out[0]


def loop():
    """3, by a library as those of the loop."""

    def loader(path):
        library = ctypes.CDLL(str(path))
        library.three.restype = ctypes.c_double
        return library.three()

    return c_library.load("three", "", lambda: "double three(void) { return 3; }", loader)


def build(name):
    """Its name, by a library of a kilobyte that is made where there is none."""

    def builder(scratch):
        (scratch / name).write_bytes(b"x" * 1000)
        return name

    return library_cache.loaded(name, lambda _: None, builder)


KINDS = pytest.mark.parametrize("kind", [form, loop])


def library_in(folder):
    (library,) = folder.glob("*.so")
    return library


@pytest.fixture
def compiled(monkeypatch):
    """Sources that are compiled, instead of taken from the cache."""
    names, built = [], library_cache._built

    def noted(place, name, builder):
        names.extend([name] * name.endswith(".so"))
        return built(place, name, builder)

    monkeypatch.setattr(library_cache, "_built", noted)
    return names


# -- What lies there -----------------------------------------------------------------------------


def foreign(path):
    """A library of something else, complete with its checksum."""
    content = Path(_cffi_backend.__file__).read_bytes()
    path.write_bytes(content + library_cache._checksum(content))


def replaced(make):
    """Damage by something else in the place of the file."""
    return lambda path: (path.unlink(), make(path))


DAMAGE = {
    "a pipe": replaced(os.mkfifo),
    "a folder": replaced(lambda path: (path.mkdir(), (path / "notes").write_text("of someone"))),
    "a link to nothing": replaced(lambda path: path.symlink_to("nothing")),
    "empty": lambda path: path.write_bytes(b""),
    "truncated": lambda path: os.truncate(path, path.stat().st_size // 2),
    "of other contents": lambda path: path.write_bytes(bytes(path.stat().st_size)),
    "foreign": foreign,
    "of any writer": lambda path: path.chmod(0o666),
}


@pytest.mark.parametrize(
    ("kind", "damage"), [*((loop, kind) for kind in DAMAGE), (form, "foreign")]
)
def test_a_library_that_is_not_as_it_was_built_is_built_again(
    kind, damage, cache, compiled, monkeypatch
):
    assert kind() == 3
    library = library_in(cache)
    size = library.stat().st_size
    DAMAGE[damage](library)
    forget(monkeypatch)
    assert kind() == 3
    assert compiled == [library.name] * 2
    assert len(library.read_bytes()) == size
    assert not library.stat().st_mode & 0o022


@pytest.mark.parametrize("obstacle", [os.mkfifo, Path.mkdir, lambda path: path.symlink_to("x")])
def test_what_lies_in_the_place_of_a_lock_is_taken_away(obstacle, cache):
    cache.mkdir(parents=True)
    obstacle(cache / "a.so.lock")
    assert build("a.so") == "a.so"
    assert [path.name for path in cache.iterdir()] == ["a.so"]


def test_a_folder_that_others_could_write_is_closed_before_more_goes_there(cache):
    assert form() == 3
    cache.chmod(0o777)
    assert loop() == 3
    assert not cache.stat().st_mode & 0o022


@KINDS
def test_a_library_is_not_loaded_from_another_user(kind, cache, compiled, monkeypatch, tmp_path):
    assert kind() == 3
    other = tmp_path / "temporary" / "fx_beam-4321"
    other.mkdir()
    if os.getuid() == 0:  # what belongs to the administrator is trusted
        for path in (library_in(cache), cache, other):
            os.chown(path, 1234, 1234)
    monkeypatch.setattr(os, "geteuid", lambda: 4321)
    forget(monkeypatch)
    # The file or, where the user is none of root's, the folder around it.
    with pytest.raises((OSError, c_library.CannotBuild), match="another user can write|built"):
        kind()
    assert len(compiled) == 1


@KINDS
def test_a_folder_that_others_can_exchange_is_not_used(kind, cache, compiled, monkeypatch, caplog):
    assert kind() == 3
    cache.parent.chmod(0o777)  # what is in it may be renamed
    forget(monkeypatch)
    assert kind() == 3
    assert len(compiled) == 2
    assert f"another user can write {cache.parent}" in caplog.text
    # Sticky, it is as safe as the folder for temporary files.
    cache.parent.chmod(0o1777)
    forget(monkeypatch)
    assert kind() == 3
    assert len(compiled) == 2


def test_a_library_comes_from_the_folder_that_was_checked(cache, compiled, monkeypatch):
    assert loop() == 3
    library, check = library_in(cache), library_cache._checksum

    def exchanged(content):
        monkeypatch.setattr(library_cache, "_checksum", check)
        cache.rename(cache.with_name("aside"))
        cache.mkdir()
        foreign(cache / library.name)
        return check(content)

    forget(monkeypatch)
    monkeypatch.setattr(library_cache, "_checksum", exchanged)
    assert loop() == 3
    assert len(compiled) == 1


def test_folders_relative_to_the_current_one_hold_no_cache(monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path / "home"))
    monkeypatch.setenv("XDG_CACHE_HOME", "cache")
    assert library_cache.folder() == tmp_path / "home" / ".cache" / "fx_beam"
    monkeypatch.setenv("HOME", "home")
    assert library_cache.folder().parent == tmp_path / "temporary"


def test_an_empty_cache_has_nothing_of_its_substitute(cache, compiled, monkeypatch, tmp_path):
    cache.parent.write_text("no folder")
    assert loop() == 3
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "empty"))
    assert loop() == 3
    assert len(compiled) == 2


# -- The compiler ----------------------------------------------------------------------------------


def test_each_compiler_and_each_of_its_versions_has_its_own_libraries(
    compiled, monkeypatch, tmp_path
):
    def install(name, version):
        (tmp_path / name).write_text(f'#!/bin/sh\n# {version}\nexec cc "$@"\n')
        (tmp_path / name).chmod(0o755)

    calls = {
        "gcc 12": lambda: (install("gcc", "12"), monkeypatch.setenv("CC", str(tmp_path / "gcc"))),
        "another": lambda: (install("other-cc", "1"), monkeypatch.setenv("CC", "other-cc")),
        "gcc 12.1": lambda: (install("gcc", "12.1"), monkeypatch.setenv("CC", "gcc")),
        "with an option": lambda: monkeypatch.setenv("CC", "gcc -O0"),
    }
    monkeypatch.setenv("PATH", f"{tmp_path}:{os.environ['PATH']}")
    for k, change in enumerate(calls.values()):
        change()
        for _ in range(2):
            forget(monkeypatch)
            assert loop() == 3
        assert len(set(compiled)) == len(compiled) == k + 1


# -- Processes that are killed, and several at once ------------------------------------------------

COMPILER = """#!/bin/sh
case "$*" in *-shared*) ;; *-c*) ;; *) exec cc "$@" ;; esac
kill -KILL $PPID
"""
SCRIPT = f"""
import sys
sys.path.insert(0, {str(Path(__file__).parent)!r})
import test_library_cache
print(test_library_cache.{{of}}())
"""


def script(kind, **environment):
    """The function in a process of its own."""
    command = [sys.executable, "-c", SCRIPT.format(of=kind.__name__)]
    return subprocess.run(
        command, env=os.environ | environment, capture_output=True, text=True, timeout=60
    )


@KINDS
def test_a_process_that_is_killed_while_it_compiles_is_in_nobodys_way(kind, cache, tmp_path):
    killer = tmp_path / "cc"
    killer.write_text(COMPILER)
    killer.chmod(0o755)
    done = script(kind, CC=str(killer))
    assert done.returncode == -signal.SIGKILL, done.stderr
    (scratch,) = cache.glob("building-*")
    assert not list(cache.glob("*.so"))
    # A day later also what it left goes.
    os.utime(scratch, (0, 0))
    done = script(kind)
    assert done.stdout == "3.0\n", done.stderr
    assert {path.suffix for path in cache.iterdir()} <= {".so", ".forms"}


def test_no_two_processes_compile_the_same(cache, compiled, monkeypatch):
    run = subprocess.run
    monkeypatch.setattr(
        c_library.subprocess,
        "run",
        lambda *args, **options: (time.sleep(0.1), run(*args, **options)),
    )
    # Locks are of open files: for them two threads are two processes.
    with ThreadPoolExecutor(2) as both:
        assert [future.result() for future in [both.submit(loop) for _ in range(2)]] == [3, 3]
    assert len(compiled) == 1
    assert [path.suffix for path in cache.iterdir()] == [".so"]


# -- A cache that cannot be written ----------------------------------------------------------------


def full(cache, monkeypatch):
    def no_space(file, start, size):
        if str(cache) in os.readlink(f"/proc/self/fd/{file}"):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", no_space)


def file(cache, monkeypatch):
    cache.parent.write_text("no folder")


def others(cache, monkeypatch):
    cache.mkdir(parents=True)
    if os.getuid():
        pytest.skip("only the administrator can give a folder away")
    os.chown(cache, 1234, 1234)


@KINDS
@pytest.mark.parametrize("obstacle", [full, file, others])
def test_a_cache_that_cannot_be_used_gets_a_substitute_and_one_warning(
    kind, obstacle, cache, compiled, monkeypatch, tmp_path, caplog
):
    obstacle(cache, monkeypatch)
    assert kind() == 3
    forget(monkeypatch)
    assert kind() == 3
    assert len(compiled) == 1
    (said,) = (record.getMessage() for record in caplog.records if record.levelname == "WARNING")
    assert "XDG_CACHE_HOME" in said and str(cache) in said
    library_in(tmp_path / "temporary" / f"fx_beam-{os.geteuid()}")


@pytest.mark.parametrize("closed", [True, False], ids=["a file", "a folder where others rename"])
def test_without_any_folder_a_sentence_says_what_to_set(cache, monkeypatch, tmp_path, closed):
    file(cache, monkeypatch)
    if closed:
        (tmp_path / "temporary" / f"fx_beam-{os.geteuid()}").write_text("no folder")
    else:
        (tmp_path / "temporary").chmod(0o777)
    with pytest.raises(OSError, match="nothing can be compiled: .* Set XDG_CACHE_HOME to a folder"):
        form()


def test_a_link_in_the_place_of_the_substitute_is_not_used(cache, monkeypatch, tmp_path):
    file(cache, monkeypatch)
    (tmp_path / "elsewhere").mkdir(mode=0o755)
    (tmp_path / "temporary" / f"fx_beam-{os.geteuid()}").symlink_to(tmp_path / "elsewhere")
    with pytest.raises(OSError, match="nothing can be compiled"):
        build("a.so")
    assert not list((tmp_path / "elsewhere").iterdir())


def test_a_full_cache_loses_what_was_not_used_for_longest(cache, monkeypatch):
    monkeypatch.setattr(library_cache, "LARGEST", 3500)
    for age, name in enumerate(("a.so", "b.so", "c.so")):
        build(name)
        os.utime(cache / name, (1e9 + age, 1e9 + age))
    assert library_cache.load_cached("a.so", Path.exists)  # used again
    build("d.so")
    assert {file.name for file in cache.glob("*.so")} == {"a.so", "c.so", "d.so"}


ARM = """
import fx_beam as fb
scene = fb.Scene()
scene.clamp(scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0)).start)
fb.static(scene)
"""


def test_without_a_compiler_one_sentence_names_what_to_install():
    command, own = [sys.executable, "-c", ARM], {"CC": "no-such-compiler"}
    run = subprocess.run(command, capture_output=True, text=True, env=os.environ | own)
    last = run.stderr.strip().splitlines()[-1]
    assert last.startswith("RuntimeError: there is no C compiler 'no-such-compiler'")
    assert "apt-get install gcc" in last and run.stderr.count("Traceback") == 1
