"""The reports run in their short form, and what they say holds."""

import importlib.util
import json
import subprocess
import sys
from pathlib import Path

import pytest
from pytest import approx

ROOT = Path(__file__).parents[1]
EXAMPLES = "pendulum", "three_bar_swing", "multibody", "pinned_beam"
OURS, NEWMARK = "EnergyMomentum", "Newmark (trapezoidal)"


def benchmark(name):
    """A script of benchmarks/ as a module."""
    spec = importlib.util.spec_from_file_location(name, ROOT / "benchmarks" / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    # The scripts share a loader of the demos, which lies beside them.
    sys.path.insert(0, str(ROOT / "benchmarks"))
    try:
        spec.loader.exec_module(module)
    finally:
        sys.path.pop(0)
    return module


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    """Directory with what the short form wrote."""
    directory = tmp_path_factory.mktemp("work_precision")
    benchmark("work_precision").main(quick=True, results=directory)
    return directory


def numbers(results, example):
    """What the report has in its file."""

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads((results / f"{example}.json").read_text(), parse_constant=refuse)


def runs(results, example, scheme):
    return [run for run in numbers(results, example)["runs"] if run["scheme"] == scheme]


@pytest.mark.parametrize("example", EXAMPLES)
def test_work_precision_has_every_run_and_says_on_what_it_ran(results, example):
    found = numbers(results, example)
    module = benchmark("work_precision")
    settings = getattr(module, example)(quick=True)
    candidates = len(module.QUICK_SCHEMES) * len(settings["steps"]) * len(settings["meshes"])
    assert len(found["runs"]) == candidates
    assert {"processor", "dolfinx", "fx_beam"} <= set(found["machine"])
    for run in found["runs"]:
        assert run["failure"] or (
            run["seconds"] > 0 and set(run["errors"]) == set(settings["quantities"])
        )


@pytest.mark.parametrize("example", EXAMPLES)
def test_work_precision_page_has_its_picture_its_sentences_and_its_rows(results, example):
    found, page = numbers(results, example), (results / f"{example}.md").read_text()
    assert f"]({example}.png)" in page and (results / f"{example}.png").stat().st_size > 20_000
    for line in found["which scheme wins where"]:
        assert f"- {line}\n" in page
    rows = [line for line in page.splitlines() if line.startswith(f"| {OURS}")]
    assert len(rows) >= len(runs(results, example, OURS))


@pytest.mark.parametrize("example", EXAMPLES)
def test_our_scheme_has_no_error_of_energy_at_any_step(results, example):
    errors = [run["errors"]["energy"] for run in runs(results, example, OURS)]
    assert max(errors) < 1e-11


@pytest.mark.parametrize("example", EXAMPLES)
def test_newmark_has_an_error_of_energy_that_our_scheme_has_not(results, example):
    errors = [run["errors"].get("energy", 1) for run in runs(results, example, NEWMARK)]
    assert min(errors) > 1e-6


def test_references_are_exact_or_far_better_than_the_runs(results):
    for example in EXAMPLES:
        found = numbers(results, example)
        for quantity, error in found["relative errors of the references"].items():
            errors = [run["errors"][quantity] for run in found["runs"] if run["errors"]]
            assert error is None or error < max(errors), (example, quantity)
    exact = numbers(results, "pendulum")["relative errors of the references"]
    assert set(exact.values()) == {None}


@pytest.mark.parametrize("quantity", ["tip path", "period"])
def test_pendulum_is_second_order_in_the_step(results, quantity):
    (order,) = [
        row["orders"][quantity]
        for row in numbers(results, "pendulum")["orders in the time step"]
        if row["scheme"] == OURS
    ]
    assert order == approx(2, abs=0.1)


def test_newmark_loses_the_pendulums_path_at_every_step(results):
    errors = [run["errors"]["tip path"] for run in runs(results, "pendulum", NEWMARK)]
    assert min(errors) > 1
    line = numbers(results, "pendulum")["which scheme wins where"][0]
    assert line.startswith("tip path") and OURS in line and NEWMARK not in line


def test_joint_of_the_swing_is_second_order_in_the_step_and_mesh_errors_fall(results):
    found = numbers(results, "three_bar_swing")
    orders = [row["orders"]["joint path"] for row in found["orders in the time step"]]
    assert orders == approx([2] * 4, abs=0.1)
    coarse, fine = (row["errors"]["joint path"] for row in found["errors with a fine time step"])
    assert coarse / fine == approx(4, rel=0.2)


def test_the_report_command_knows_its_reports_only():
    done = subprocess.run([ROOT / "run", "report", "nothing"], capture_output=True, text=True)
    assert done.returncode == 2 and "./run report work-precision" in done.stderr
