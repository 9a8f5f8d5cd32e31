"""`./run` knows its commands and the systems it serves, and a set-up can be interrupted."""

import os
import shutil
import signal
import subprocess
import time
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]

# A system in which nothing is installed, and that offers one version of FFCx.
SYSTEM = {
    "dpkg-query": "exit 1",
    "apt-cache": 'echo "python3-ffcx:"; echo "  Candidate: $OFFERED"',
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
def clone(tmp_path):
    """A folder with what `./run` needs, a demo, and a place for programs that are called first."""
    (tmp_path / "demos").mkdir()
    (tmp_path / "demos" / "one.py").write_text("")
    for name in ("run", "pyproject.toml"):
        shutil.copy(ROOT / name, tmp_path)
    (tmp_path / "stubs").mkdir()
    return tmp_path


def stub(clone, scripts):
    """Put scripts in the place of programs; returns the environment."""
    for name, script in scripts.items():
        (clone / "stubs" / name).write_text(f"#!/bin/sh\n{script}\n")
        (clone / "stubs" / name).chmod(0o755)
    return os.environ | {"PATH": f"{clone / 'stubs'}:{os.environ['PATH']}"}


@pytest.fixture
def call(clone):
    """`./run demos one` on a system with a version of FFCx."""
    environment, calls = stub(clone, SYSTEM), clone / "calls"
    calls.touch()

    def run(offered):
        more = {"OFFERED": offered, "CALLS": str(calls)}
        command = [clone / "run", "demos", "one"]
        done = subprocess.run(command, env=environment | more, capture_output=True, text=True)
        return done, calls.read_text()

    return run


@pytest.mark.parametrize(
    ("offered", "version"), [("1:0.7.3-4", "0.7.3"), ("0.3.0-9", "0.3.0"), ("2:0.50-1", "0.50")]
)
def test_a_version_that_is_not_served_is_named_and_nothing_is_installed(call, offered, version):
    done, calls = call(offered)
    assert done.returncode == 1
    assert calls == ""
    assert f"has FFCx {version}. " in done.stderr
    assert (
        "Supported systems are Debian 12, 13 and sid, with FFCx 0.5, 0.9, 0.10, 0.11" in done.stderr
    )


def test_a_system_without_ffcx_is_asked_for_its_list_and_no_more(call):
    done, calls = call("(none)")
    assert done.returncode == 1
    assert calls.splitlines() == ["update -qq"]
    assert "has no package python3-ffcx" in done.stderr


@pytest.mark.parametrize("version", ["1:0.5.2-1", "1:0.9.0-11+b1", "1:0.11.0.post0-1"])
def test_a_version_that_is_served_is_installed_with_progress_on_one_line(call, clone, version):
    done, calls = call(version)
    assert "python3-ffcx" in calls.splitlines()[-1]
    first, progress, last = done.stderr.splitlines()
    assert "3.3 GB" in first and first.endswith("messages in results/set-up.log")
    tenths = " ".join(f"{tenth}0 %" for tenth in range(1, 11))
    assert progress == f"run: Debian packages: {tenths}"
    # The installation was none, which does not go unseen.
    assert done.returncode == 1
    assert "apt-get has not installed: python3-ffcx" in last and "see results/set-up.log" in last
    messages = (clone / "results" / "set-up.log").read_text().splitlines()
    assert "Need to get 304 MB of archives." in messages and "Setting up p10" in messages


def test_only_the_documentation_has_sphinx_installed():
    lines = (ROOT / "run").read_text().splitlines()
    prepared = [line.strip() for line in lines if "prepare " in line]
    assert [line for line in prepared if "docs" in line] == ["prepare plot docs"]
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    assert {name for name, wanted in extras.items() if "sphinx" in wanted} == {"docs"}


# -- Commands ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "reason"),
    [
        ("demos --quick", "no demo '--quick'; there are:"),
        ("demos one nothing", "no demo 'nothing'; there are:"),
        ("report everything", "no report 'everything'"),
        ("docs --fast", "no option '--fast'"),
        ("build", "no command 'build'"),
        ("--quick", "no command '--quick'"),
    ],
)
def test_what_is_not_known_gets_a_sentence_and_the_usage(clone, command, reason):
    done = subprocess.run([clone / "run", *command.split()], capture_output=True, text=True)
    assert done.returncode == 2 and done.stdout == ""
    first, *others = done.stderr.splitlines()
    assert first == f"run: {reason}"
    assert "usage: ./run demos" in done.stderr and "basename" not in done.stderr
    assert ("one" in others) == ("demo" in reason)


# -- A set-up that is interrupted ------------------------------------------------------------------

# In the place of Debian's Python: it makes a .venv, whose pip waits if there is a file for that.
PYTHON = r"""
case $* in *" venv "*) ;; *) exit ;; esac
mkdir -p .venv/bin .venv/lib/python3/site-packages
cat >.venv/bin/python <<'END'
#!/bin/sh
echo "$*" >>pips
[ -f wait ] || exit 0
echo $$ >pid
exec sleep 60
END
chmod +x .venv/bin/python
"""


@pytest.fixture
def set_up(clone):
    """Starts `./run` with a command, in a clone of its own with the packages of Debian."""
    script = clone / "run"
    script.write_text(script.read_text().replace("/usr/bin/python3", f"{clone}/stubs/python3"))
    query = 'case $* in *Version*) echo "1:0.9.0-1" ;; *) echo installed ;; esac'
    environment = stub(clone, {"python3": PYTHON, "dpkg-query": query, "apt-get": ""})

    def start(*command):
        how = {"env": environment, "cwd": clone, "preexec_fn": heed_ctrl_c}
        return subprocess.Popen([script, *command], **how)

    return start


def heed_ctrl_c():
    """Tests in the background of a shell ignore SIGINT, and so would what they start."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)


def is_running(pid):
    try:
        return "sleep" in Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return False


def wait_until(condition):
    for _ in range(1000):
        if condition():
            return
        time.sleep(0.01)
    raise AssertionError("it does not happen")


def extras(tmp_path):
    """Extras that each call of pip was to install."""
    calls = (tmp_path / "pips").read_text().splitlines()
    return [call.partition("[")[2].rstrip("]") for call in calls if "install" in call]


@pytest.mark.parametrize(
    ("command", "last"),
    [
        ("test", "run: passed: the core: a scene for each law"),
        ("test --all", "run: passed: all: the core, the claims"),
        ("test -k pendulum", "run: passed: the tests named"),
        ("demos one", "run: next: your own mechanism"),
    ],
)
def test_the_last_line_says_what_was_tested_or_what_is_next(set_up, capfd, command, last):
    assert set_up(*command.split()).wait() == 0
    assert capfd.readouterr().err.splitlines()[-1].startswith(last)


def test_an_environment_that_is_the_users_own_is_left_as_it_is(set_up, tmp_path, capfd):
    (tmp_path / ".venv").mkdir()
    (tmp_path / ".venv" / "own").touch()
    assert set_up("test").wait() == 1
    assert [file.name for file in (tmp_path / ".venv").iterdir()] == ["own"]
    assert ".venv was not made by ./run." in capfd.readouterr().err


@pytest.mark.parametrize("how", [signal.SIGTERM, signal.SIGINT, signal.SIGKILL])
def test_a_set_up_that_is_killed_leaves_nothing_behind_and_forgets_nothing(set_up, tmp_path, how):
    assert set_up("test").wait() == 0
    (tmp_path / "wait").touch()
    killed = set_up("docs")
    wait_until(lambda: (tmp_path / "pid").exists() and (tmp_path / "pid").read_text())
    pid = int((tmp_path / "pid").read_text())
    wait_until(lambda: is_running(pid))
    (tmp_path / ".venv" / "partly").touch()
    killed.send_signal(how)
    killed.wait()
    wait_until(lambda: not is_running(pid))
    (tmp_path / "wait").unlink()
    # The lock is free, and all that was asked for is installed, in an empty folder.
    assert set_up("demos", "one").wait(timeout=20) == 0
    assert extras(tmp_path) == ["plot,test", "docs,plot,test", "docs,plot,test"]
    assert not (tmp_path / ".venv" / "partly").exists()
    assert set_up("docs").wait() == 0
    assert len(extras(tmp_path)) == 3


def test_another_project_file_installs_again_all_that_was_there(set_up, tmp_path):
    assert set_up("docs").wait() == 0
    with open(tmp_path / "pyproject.toml", "a") as file:
        file.write("\n# changed\n")
    (tmp_path / ".venv" / "kept").touch()
    assert set_up("test").wait() == 0
    assert extras(tmp_path) == ["docs,plot", "docs,plot,test"]
    assert (tmp_path / ".venv" / "kept").exists()
