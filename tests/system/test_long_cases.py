"""Cases of a sweep that take long: the others do not wait for them, and a limit ends them."""

import os
from concurrent.futures import Executor

import pytest
import sweep_cases

import fx_beam as fb
from fx_beam.results import export


@pytest.fixture(autouse=True)
def lists(monkeypatch):
    """Tables as without pandas."""
    monkeypatch.setattr(export, "of_rows", lambda rows: rows)


def test_all_others_are_done_while_one_takes_long(tmp_path):
    number, place = 200, 1
    cases = [{"number": k, "folder": str(tmp_path), "others": 0} for k in range(number)]
    cases[place]["others"] = number - 1
    rows = fb.sweep(sweep_cases.waits, cases, 2)
    assert not any(row["error"] for row in rows)
    assert rows[place]["seen"] == number - 1


def test_a_case_that_takes_too_long_fails_and_its_process_is_ended(tmp_path):
    cases = [{"number": k, "folder": str(tmp_path), "others": 0} for k in range(6)]
    cases[2]["others"] = 99  # never
    *rows, last = fb.sweep(sweep_cases.waits, cases, 1, timeout=2.0)
    assert [bool(row["error"]) for row in rows] == [False, False, True, False, False]
    assert "longer than timeout = 2 s" in rows[2]["error"] and rows[2]["seconds"] > 2
    assert rows[0]["worker"] == rows[1]["worker"] != last["worker"]
    with pytest.raises(ProcessLookupError):
        os.kill(rows[0]["worker"], 0)


def test_a_limit_may_be_longer_than_the_system_can_wait(tmp_path):
    (row,) = fb.sweep(
        sweep_cases.waits, [{"number": 0, "folder": str(tmp_path), "others": 0}], 1, timeout=1e12
    )
    assert not row["error"]


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"timeout": 0}, "timeout = 0 must be a positive number of seconds"),
        ({"timeout": "1"}, "timeout = '1' must be"),
        ({"timeout": 1, "executor": Executor()}, "timeout = 1 needs processes of this machine"),
    ],
)
def test_what_is_no_limit_is_refused(options, reason):
    with pytest.raises(fb.SceneError, match=reason):
        fb.sweep(sweep_cases.waits, [{}], **options)
