"""Sweeps: a row for every case whatever befalls it, on any executor, and on where they stopped."""

import errno
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import BrokenExecutor, Executor, Future, ThreadPoolExecutor
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
import pytest
import sweep_cases
from mpirun import mpirun
from scenes import assert_refused

import fx_beam as fb
from fx_beam.results import export
from fx_beam.sweeps import sweep
from fx_beam.sweeps.sweep import Journal

HERE = Path(__file__).parents[1]


@pytest.fixture
def thread():
    """An executor of one thread, which runs functions of a test."""
    with ThreadPoolExecutor(1) as executor:
        yield executor


@pytest.fixture
def lists(monkeypatch):
    """Tables as without pandas."""
    monkeypatch.setattr(export, "of_rows", lambda rows: rows)


def script(tmp_path, text, *command, **keywords):
    """A script that is started, in a group of its own as by a terminal."""
    (tmp_path / "script.py").write_text(text)
    # A pool under mpirun needs more of Open MPI than ./run lets a single process have.
    known = {name: value for name, value in os.environ.items() if not name.startswith("OMPI_")}
    known["PYTHONPATH"] = os.pathsep.join([str(HERE.parent), str(HERE)])
    root = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    return subprocess.Popen(
        [*(command or (sys.executable,)), "script.py"],
        cwd=tmp_path,
        env=known | root,
        stdout=subprocess.PIPE,
        text=True,
        start_new_session=True,
        **keywords,
    )


def square(case):
    return {"square": case["x"] ** 2}


# -- Processes -----------------------------------------------------------------------------------


def test_each_of_many_short_cases_has_its_own_fate(lists):
    """One that kills its process, or cannot be sent, costs itself."""
    cases = [{"number": number} for number in range(120)]
    cases[30]["function"] = lambda: None
    rows = fb.sweep(sweep_cases.short, cases, 2)
    wrong = {row["number"]: row["error"] for row in rows if row["error"]}
    assert wrong.keys() == {30, 50, 77}
    assert "<lambda>" in wrong[30] and "<lambda>" in wrong[50] and "process died" in wrong[77]
    assert all(row["result"] == 2 * row["number"] for row in rows if not row["error"])


def test_processes_have_one_thread_and_a_killed_one_costs_its_case(lists):
    fates = ["fine", "slow", "broken", "killed", "fine", "fine", "slow", "slow"]
    cases = [{"number": n, "fate": fate} for n, fate in enumerate(fates)]
    rows = fb.sweep(sweep_cases.fate, cases, executor=2)
    pairs = zip(rows, cases, strict=True)
    assert [{name: row[name] for name in case} for row, case in pairs] == cases
    for row in rows:
        fine = row["fate"] in ("fine", "slow")
        assert bool(row["error"]) != fine and ("worker" in row) == fine
    assert rows[2]["error"] == "ZeroDivisionError: one over nothing"
    assert "its worker process died" in rows[3]["error"]
    fine = [row for row in rows if not row["error"]]
    assert {row["threads"] for row in fine} == {"1"}
    assert {row["own_threads"] for row in fine} == {1}
    assert all(row["seconds"] >= 0.1 for row in fine if row["fate"] == "slow")
    # The first one compiles what the others need.
    assert rows[0]["ended"] < min(row["began"] for row in fine[1:])


def test_workers_that_fill_all_cores_have_one_each(lists):
    number = sweep.cores()
    rows = fb.sweep(sweep_cases.fate, [{"fate": "slow"}] * (3 * number), executor=number)
    worker_cores = {row["worker"]: row["cpus"] for row in rows}
    assert {len(cpus) for cpus in worker_cores.values()} == {1}
    assert len({cpus[0] for cpus in worker_cores.values()}) == len(worker_cores)


@pytest.mark.parametrize("how", [signal.SIGINT, signal.SIGKILL], ids=["Ctrl-C", "kill"])
def test_no_process_outlives_its_sweep_and_the_next_one_goes_on(how, tmp_path):
    text = """
import signal, time
import fx_beam as fb

def sleep(case):
    print(f"{case['s']}\\n", end="", flush=True)  # one write: two processes share the pipe
    time.sleep(case["s"])

if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a background shell ignores it
    try:
        fb.sweep(sleep, [{"s": s} for s in (0, 100, 101)], executor=2, results="rows")
    except KeyboardInterrupt as stop:
        print("stopped", len(stop.rows))
"""
    started = script(tmp_path, text)
    assert {started.stdout.readline() for _ in range(3)} == {"0\n", "100\n", "101\n"}
    # Ctrl-C goes to all processes of a terminal.
    (os.killpg if how == signal.SIGINT else os.kill)(started.pid, how)
    # Its output ends with the last process that has it.
    assert started.communicate(timeout=30)[0] == ("stopped 1\n" if how == signal.SIGINT else "")
    (line,) = (tmp_path / "rows").read_text().splitlines()
    assert json.loads(line)["case"] == {"s": 0}
    rows = fb.sweep(lambda case: None, [{"s": 0}], results=tmp_path / "rows")
    assert len(rows) == 1


def test_a_script_without_a_main_guard_is_told_so(tmp_path):
    text = "import fx_beam as fb, sweep_cases\nfb.sweep(sweep_cases.fate, [{}], executor=1)\n"
    started = script(tmp_path, text, stderr=subprocess.PIPE)
    error = started.communicate(timeout=30)[1]
    assert started.returncode == 1 and error.count("the worker processes cannot start") == 1
    assert "its calls must stand under `if __name__ == '__main__':`" in error


def test_what_processes_cannot_import_is_refused(monkeypatch):
    with pytest.raises(fb.SceneError, match="Define functions with `def` at the top of a module"):
        fb.sweep(lambda case: None, [{"x": 1}])
    prompt = type(sys)("__main__")
    prompt.square = lambda case: None
    prompt.square.__module__, prompt.square.__qualname__ = "__main__", "square"
    monkeypatch.setitem(sys.modules, "__main__", prompt)
    assert_refused("is defined at a prompt", lambda: fb.sweep(prompt.square, [{"x": 1}]))


def said_by_two_ranks(tmp_path, text, *options):
    """Text of a script that mpirun starts twice."""
    command = [*mpirun(2), sys.executable, *options]
    started = script(tmp_path, text, *command, stderr=subprocess.STDOUT)
    try:
        said, _ = started.communicate(timeout=60)
    finally:
        with suppress(ProcessLookupError):
            os.killpg(started.pid, signal.SIGKILL)
    assert started.returncode == 0
    return said


@pytest.mark.skipif(not shutil.which("mpirun"), reason="no mpirun")
def test_two_ranks_that_compute_the_same_scene_warn_once(tmp_path):
    text = """
import sweep_cases

for _ in range(2):
    sweep_cases.arm({"EA": 4e7, "speed": 1.0})
print("done")
"""
    said = said_by_two_ranks(tmp_path, text)
    assert said.count("done") == 2
    assert said.count("mpirun started 2 processes: each of them computes the whole scene") == 1
    assert "fx_beam.sweep" in said


@pytest.mark.skipif(not shutil.which("mpirun"), reason="no mpirun")
def test_a_pool_of_mpi_gives_what_one_process_gives(tmp_path, lists):
    text = """
import json
import fx_beam as fb
import sweep_cases
from mpi4py.futures import MPIPoolExecutor

if __name__ == "__main__":
    cases = [{"EA": EA, "speed": speed} for EA in (4e7, 8e7) for speed in (10.0, 20.0)]
    with MPIPoolExecutor() as executor:
        rows = fb.sweep(sweep_cases.arm, cases, executor, results="rows")
"""
    assert "mpirun started" not in said_by_two_ranks(tmp_path, text, "-m", "mpi4py.futures")
    rows = [json.loads(line) for line in (tmp_path / "rows").read_text().splitlines()]
    assert len(rows) == 4
    for row in rows:
        assert not row["error"] and row["result"] == sweep_cases.arm(row["case"])


# -- Cases that take long --------------------------------------------------------------------------


def test_all_others_are_done_while_one_takes_long(tmp_path, lists):
    number, place = 200, 1
    cases = [{"number": k, "folder": str(tmp_path), "others": 0} for k in range(number)]
    cases[place]["others"] = number - 1
    rows = fb.sweep(sweep_cases.waits, cases, 2)
    assert not any(row["error"] for row in rows)
    assert rows[place]["seen"] == number - 1


def test_a_case_that_takes_too_long_fails_and_its_process_is_ended(tmp_path, lists):
    cases = [{"number": k, "folder": str(tmp_path), "others": 0} for k in range(6)]
    cases[2]["others"] = 99  # never
    *rows, last = fb.sweep(sweep_cases.waits, cases, 1, timeout=2.0)
    assert [bool(row["error"]) for row in rows] == [False, False, True, False, False]
    assert "longer than timeout = 2 s" in rows[2]["error"] and rows[2]["seconds"] > 2
    assert rows[0]["worker"] == rows[1]["worker"] != last["worker"]
    with pytest.raises(ProcessLookupError):
        os.kill(rows[0]["worker"], 0)


def test_a_limit_may_be_longer_than_the_system_can_wait(tmp_path, lists):
    (row,) = fb.sweep(
        sweep_cases.waits, [{"number": 0, "folder": str(tmp_path), "others": 0}], 1, timeout=1e12
    )
    assert not row["error"]


# -- Executors -----------------------------------------------------------------------------------


@pytest.mark.parametrize("package", ["joblib", "distributed"])
def test_executors_of_joblib_and_dask_give_what_one_process_gives(package, lists):
    module = pytest.importorskip(package)
    cases = [{"EA": EA, "speed": 10.0} for EA in (4e7, 8e7, -1.0)]
    with ExitStack() as stack:
        if package == "joblib":
            executor = module.externals.loky.get_reusable_executor(max_workers=1)
            stack.enter_context(executor)
        else:
            options = {"n_workers": 1, "threads_per_worker": 1, "dashboard_address": None}
            executor = stack.enter_context(module.Client(**options)).get_executor()
        *rows, failed = fb.sweep(sweep_cases.arm, cases, executor)
    for row, case in zip(rows, cases, strict=False):
        assert not row["error"] and {name: row[name] for name in "xy"} == sweep_cases.arm(case)
    assert failed["error"] == "Section: EA = -1.0 must be positive and finite"


class Breaking(Executor):
    """An executor that breaks after its first call, as one whose process is killed."""

    def __init__(self):
        self.calls = 0

    def submit(self, function, *arguments):
        self.calls += 1
        if self.calls > 2:
            raise BrokenExecutor("it broke")
        future = Future()
        if self.calls == 1:
            future.set_result(function(*arguments))
        else:
            future.set_exception(BrokenExecutor("it broke"))
        return future


def test_an_executor_of_the_user_that_breaks_leaves_its_rows(tmp_path, thread, lists):
    cases, results = [{"x": 1}, {"x": 2}], tmp_path / "rows"
    with pytest.raises(BrokenExecutor) as broken:
        fb.sweep(square, cases, Breaking(), results)
    assert [row["square"] for row in broken.value.rows] == [1]
    rows = fb.sweep(square, cases, thread, results)
    assert [row["square"] for row in rows] == [1, 4]


def test_only_bars_that_are_asked_for_are_drawn_by_workers(thread, capfd, lists):
    def run(case):
        scene, _ = sweep_cases.scenes.pendulum()
        fb.simulate(scene, dt=0.1, t_end=0.2, progress=case["progress"])

    fb.sweep(run, [{"progress": None}], thread)
    assert capfd.readouterr().err == ""
    fb.sweep(run, [{"progress": True}], thread)
    assert "s" in capfd.readouterr().err


# -- Cases and rows ------------------------------------------------------------------------------


def test_rows_have_the_cases_that_were_given_whatever_the_function_does_with_them(
    tmp_path, thread, lists
):
    calls = []

    def run(case):
        calls.append(case["x"])
        case["x"] *= 2
        case["shape"].append(case.pop("name"))
        return {"double": case["x"]}

    cases = [{"x": x, "name": "a", "shape": [1, 2]} for x in (1.0, 3.0)]
    for _ in range(2):  # from the file the second time
        rows = fb.sweep(run, cases, thread, results=tmp_path / "rows.jsonl")
        assert [(row["x"], row["name"], row["shape"]) for row in rows] == [
            (1.0, "a", [1, 2]),
            (3.0, "a", [1, 2]),
        ]
        assert [row["double"] for row in rows] == [2.0, 6.0] and calls == [1.0, 3.0]
    assert cases == [{"x": x, "name": "a", "shape": [1, 2]} for x in (1.0, 3.0)]


def test_cases_may_be_the_rows_of_a_table_and_rows_are_one_where_pandas_is(thread):
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame({"x": [1, 2], "name": ["a", "b"]})
    table_of_rows = fb.sweep(square, table, thread)
    assert list(table_of_rows.columns) == ["x", "name", "square", "seconds", "error"]
    assert list(table_of_rows["square"]) == [1, 4] and list(table_of_rows["name"]) == ["a", "b"]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"cases": []}, "a sweep needs cases"),
        ({"cases": {"x": 1}}, "cases must be a sequence of dicts"),
        ({"cases": [1]}, "the case 1 must be a dict"),
        ({"cases": [{"error": 1}]}, "'error' is a column of the results"),
        ({"executor": 0}, "executor = 0 must be an executor"),
        ({"executor": True}, "executor = True must be"),
        ({"executor": "dask"}, "executor = 'dask' must be"),
        ({"results": "no/such/folder/rows"}, "make the folder no/such/folder first"),
        ({"cases": [{"x": object()}], "results": "rows"}, "cases are made of numbers"),
        ({"chunksize": 0}, "chunksize = 0 must be a whole number from 1 on"),
        ({"timeout": 0}, "timeout = 0 must be a positive number of seconds"),
        ({"timeout": "1"}, "timeout = '1' must be"),
        ({"timeout": 1, "executor": Executor()}, "timeout = 1 needs processes of this machine"),
        ({"threads": 0}, "threads = 0 must be a whole number from 1"),
        ({"threads": 2, "executor": 2}, "give no executor, and no timeout"),
        ({"threads": 2, "timeout": 1.0}, "give no executor, and no timeout"),
    ],
)
def test_what_makes_no_sense_is_refused(change, reason, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert_refused(reason, lambda: fb.sweep(**{"function": square, "cases": [{"x": 1}]} | change))


# -- Threads -------------------------------------------------------------------------------------


def of_arms(cases, threads):
    """Rows of a sweep by a local function, without their run times; the threads that it used."""

    def arm(case):
        return sweep_cases.arm(case) | {"thread": threading.get_ident()}

    rows = fb.sweep(arm, cases, threads=threads)
    used = {row.pop("thread", None) for row in rows}
    return [row | {"seconds": None} for row in rows], used - {None}


def test_threads_give_what_one_process_gives_and_an_error_costs_its_case(lists):
    cases = [{"EA": EA, "speed": float(k % 7)} for k in range(20) for EA in (4e7, 8e7)]
    cases[5]["EA"] = cases[-1]["EA"] = -1.0
    rows, used = of_arms(cases, 4)
    expected, one = of_arms(cases, 1)
    assert rows == expected and 1 < len(used) <= 4 and len(one) == 1
    assert threading.get_ident() not in used | one
    wrong = [k for k, row in enumerate(rows) if row["error"]]
    assert wrong == [5, len(cases) - 1] and "EA = -1.0 must be positive" in rows[5]["error"]
    for row, case in zip(rows[:4], cases[:4], strict=True):
        assert {name: row[name] for name in "xy"} == sweep_cases.arm(case)


def test_the_first_case_is_alone_and_others_are_at_once(lists):
    together, alone = threading.Barrier(2, timeout=60), []

    def meet(case):
        if not alone:
            alone.append(case)
            time.sleep(0.2)
            return len(alone)
        alone.append(case)
        together.wait()
        return 0

    rows = fb.sweep(meet, [{"x": x} for x in range(5)], threads=2)
    assert [row["result"] for row in rows] == [1, 0, 0, 0, 0] and not any(r["error"] for r in rows)


def test_ctrl_c_ends_a_sweep_in_threads_after_the_cases_that_run(tmp_path, lists):
    called, ended = [], []

    def run(case):
        called.append(case["x"])
        if len(called) == 8:
            os.kill(os.getpid(), signal.SIGINT)
        time.sleep(0.01)
        ended.append(case["x"])

    cases = [{"x": x} for x in range(5000)]
    with pytest.raises(KeyboardInterrupt) as stop:
        fb.sweep(run, cases, results=tmp_path / "rows", threads=2)
    assert sorted(called) == sorted(ended) and 8 <= len(called) < 5000
    finished = {row["x"] for row in stop.value.rows}
    assert 0 in finished and finished <= {*called}
    fb.sweep(run, cases[:20], results=tmp_path / "rows", threads=2)
    assert {*range(20)} <= {*called}
    assert all(called.count(x) == 1 for x in finished)


# -- Tables one after another --------------------------------------------------------------------


def test_only_the_cases_of_one_table_are_taken_at_a_time(tmp_path, thread, lists):
    taken, results = [], tmp_path / "rows"

    def cases(number):
        for x in range(number):
            taken.append(x)
            yield {"x": x}

    tables = fb.sweep(square, cases(7), thread, results, chunksize=3)
    assert not taken
    sizes = [(len(table), len(taken)) for table in tables]
    assert sizes == [(3, 3), (3, 6), (1, 7)]
    # The file has all of them; the next call computes what is new, and its rows are in order.
    tables = fb.sweep(square, cases(9), thread, results, chunksize=5)
    rows = [row for table in tables for row in table]
    assert [row["square"] for row in rows] == [x**2 for x in range(9)]
    assert len(results.read_text().splitlines()) == 9
    assert list(fb.sweep(square, iter([]), thread, chunksize=2)) == []


def test_files_of_the_parts_of_a_sweep_are_one_after_another_that_of_the_whole(
    tmp_path, thread, lists
):
    cases, whole = [{"x": x} for x in (1, 2, 2, 3, 2)], tmp_path / "whole"
    for part in range(2):
        fb.sweep(square, cases[part::2], thread, tmp_path / f"{part}")
    whole.write_bytes(b"".join((tmp_path / f"{part}").read_bytes() for part in range(2)))

    def refused(case):
        raise AssertionError

    rows = fb.sweep(refused, cases, thread, whole)
    assert [row["square"] for row in rows] == [1, 4, 4, 9, 4] and not any(r["error"] for r in rows)
    # Each line is one run: of a case that is asked for once more there is none.
    assert fb.sweep(refused, [{"x": 2}] * 4, thread, whole)[3]["error"]


# -- The file ------------------------------------------------------------------------------------


def test_an_interrupted_sweep_goes_on_where_it_stopped(tmp_path, thread, lists):
    called, results, limits = [], tmp_path / "rows", [3, 9]
    values = {1: np.float64(0.1) + 0.2, 2: np.arange(2), 3: np.nan, 4: {"a": np.int64(4)}}

    def run(case):
        if case["x"] >= limits[0]:
            raise KeyboardInterrupt
        called.append(case["x"])
        if case["x"] == 5:
            raise fb.SceneError("the fifth")
        return values[case["x"]]

    cases = [{"x": np.int64(x)} for x in (1, 2, 3, 4, 5)] + [{"x": 3}]
    with pytest.raises(KeyboardInterrupt) as stop:
        fb.sweep(run, cases, thread, results)
    assert [row["x"] for row in stop.value.rows] == [1, 2]
    with results.open("a") as file:
        file.write('{"case": {"x": 3}, "res')  # cut off when the machine went down
    limits.pop(0)
    rows = fb.sweep(run, cases, thread, results)
    assert called == [1, 2, 3, 4, 5, 3]
    assert [row["x"] for row in rows] == [1, 2, 3, 4, 5, 3]
    assert rows[0]["result"] == 0.1 + 0.2 and rows[1]["result"] == [0, 1] and rows[3]["a"] == 4
    assert np.isnan(rows[2]["result"]) and rows[4]["error"] == "the fifth"
    # All is there: nothing is called, and the rows are the same, also of the case that failed.
    again = fb.sweep(run, cases[::-1], thread, results)
    assert len(called) == 6 and len(results.read_text().splitlines()) == 6
    assert [row["error"] for row in again] == ["", "the fifth", "", "", "", ""]
    assert {row["seconds"] for row in again} == {row["seconds"] for row in rows}


class AtOnce(Executor):
    """All futures are finished when the sweep looks at them, so that they come in any order."""

    def submit(self, function, /, *args, **kwargs):
        future = Future()
        try:
            future.set_result(function(*args, **kwargs))
        except BaseException as error:
            future.set_exception(error)
        if args[-1]["x"] == 20 and future.exception() is None:
            future = Future()
            future.set_exception(BrokenExecutor())
        return future


@pytest.mark.parametrize("error", [KeyboardInterrupt, BrokenExecutor])
def test_cases_that_finish_with_the_interrupted_one_are_not_lost(tmp_path, error, lists):
    def run(case):
        if case["x"] == 20 and error is KeyboardInterrupt:
            raise error
        return case["x"]

    with pytest.raises(error) as stop:
        fb.sweep(run, [{"x": x} for x in range(40)], AtOnce(), tmp_path / "rows")
    assert [row["x"] for row in stop.value.rows] == [x for x in range(40) if x != 20]
    assert len((tmp_path / "rows").read_text().splitlines()) == 39


def test_a_file_that_is_none_of_a_sweep_is_left_alone(tmp_path, thread):
    for text in ("x,y\n1,2\n", '{"x": 1}\n', "[1]\n", "a letter"):
        (tmp_path / "table").write_text(text)
        with pytest.raises(fb.SceneError, match="line 1 of .* is not a row of a sweep"):
            fb.sweep(square, [{"x": 1}], thread, tmp_path / "table")
        assert (tmp_path / "table").read_text() == text


CASES = [{"x": 0.5 * k} for k in range(3)]


def written(path):
    """Rows of some cases in a new file."""
    path.unlink(missing_ok=True)
    journal = Journal(path)
    rows = [
        journal.append({"case": case, "result": {"y": 1.25 * k}, "seconds": 0.1, "error": ""})
        for k, case in enumerate(CASES)
    ]
    journal.close()
    return rows


def test_a_flipped_bit_changes_no_row_of_a_sweep(tmp_path):
    path = tmp_path / "rows.jsonl"
    rows = written(path)
    whole, random = path.read_bytes(), np.random.default_rng(1)
    lost = 0
    for place in random.permutation(len(whole))[:200]:
        content = bytearray(whole)
        content[place] ^= 1 << int(random.integers(8))
        path.write_bytes(content)
        journal = Journal(path)
        for case, row in zip(CASES, rows, strict=True):
            read = journal.finished(case)
            lost += read is None
            assert read is None or read == row
        journal.close()
    assert 150 < lost < 300


def test_a_damaged_row_is_computed_again_with_a_warning(tmp_path, caplog, thread, lists):
    calls, cases = [], [{"x": 1.5}, {"x": 2.5}]

    def double(case):
        calls.append(case["x"])
        return {"y": 2 * case["x"]}

    path = tmp_path / "rows.jsonl"
    for _ in range(2):
        rows = fb.sweep(double, cases, thread, results=path)
        assert [row["y"] for row in rows] == [3.0, 5.0]
        path.write_bytes(path.read_bytes().replace(b'"y": 3.0', b'"y": 7.0'))
    assert calls == [1.5, 2.5, 1.5] and "damaged" in caplog.text


def test_two_sweeps_do_not_write_to_one_file(tmp_path, thread, lists):
    def inner(case):
        with pytest.raises(fb.SceneError, match="another sweep writes to"):
            fb.sweep(square, [case], thread, tmp_path / "rows")
        return 1

    assert fb.sweep(inner, [{"x": 1}], thread, tmp_path / "rows")[0]["error"] == ""


def test_processes_need_no_shared_memory(monkeypatch, lists):
    def refused(*_):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr("multiprocessing.synchronize._multiprocessing.SemLock", refused)
    (row,) = fb.sweep(sweep_cases.fate, [{"fate": "fine"}], 1)
    assert not row["error"] and row["worker"] != os.getpid()


# -- Studies -------------------------------------------------------------------------------------
