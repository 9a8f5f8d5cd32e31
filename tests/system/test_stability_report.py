"""The report on stability in its short form."""

import json

import numpy as np
import pytest
from scenes import benchmark

from fx_beam_studies import stability
from fx_beam_studies.stability import report as stability_report

OURS, DECAYING, PUBLISHED = "EnergyMomentum", "EnergyDecaying", "ModifiedMidPoint"
NEWMARK, HHT = "Newmark (trapezoidal)", "HHT, alpha = -0.1"


@pytest.fixture(scope="module")
def report(tmp_path_factory):
    """Cells that the short form returns, and the directory with what it wrote."""
    directory = tmp_path_factory.mktemp("stability")
    with pytest.MonkeyPatch.context() as patch:
        for name in ("draw_map", "draw_summary"):
            patch.setattr(stability_report, name, of_cases(getattr(stability_report, name)))
        return *benchmark("stability").main(quick=True, results=directory), directory


def of_cases(draw):
    """The pictures of the largest study: those of the others are drawn by the same functions."""

    def wrapper(path, cells, **look):
        if path.name.startswith("cases"):
            draw(path, cells, **look)

    return wrapper


def of_scheme(cells, scheme):
    return {cell.case.name: cell.verdict for cell in cells if cell.scheme == scheme}


def test_our_scheme_gains_no_energy_in_any_case(report):
    cells, *_ = report
    verdicts = of_scheme(cells, OURS)
    assert len(verdicts) > 30
    assert {verdict.kind for verdict in verdicts.values()} <= {"kept", "failed"}
    assert max(verdict.gain for verdict in verdicts.values()) < 1e-8


def test_the_decaying_scheme_gains_no_energy_in_any_case_and_ends_wherever_ours_does(report):
    cells, *_ = report
    ours, decaying = of_scheme(cells, OURS), [c for c in cells if c.scheme == DECAYING]
    assert [cell.case.name for cell in decaying] == [*ours]
    for cell in decaying:
        name = cell.case.name
        allowed = {"kept", "damped"} | ({ours[name].kind} & {"failed"})
        verdict = cell.verdict
        assert verdict.kind in allowed, name
        # Never more energy than at the start and from the loads, and never less than none.
        assert -1e-8 <= verdict.lowest <= verdict.highest <= 1 + 1e-8, name


def test_every_failure_says_what_when_and_where(report):
    failures = [cell.verdict for cell in report[0] if cell.verdict.kind == "failed"]
    assert failures
    for verdict in failures:
        assert "the step from t = " in verdict.reason and "of node " in verdict.reason
        assert 0 <= verdict.reached < 1


def test_every_cell_has_a_verdict_and_a_ratio(report):
    verdicts = [cell.verdict for cell in [*report[0], *report[1]]]
    assert "no verdict" not in {verdict.kind for verdict in verdicts}
    assert not any(np.isnan([verdict.highest, verdict.lowest]).any() for verdict in verdicts)
    for verdict in verdicts:
        assert verdict.substeps >= verdict.steps


def test_the_cases_cover_what_is_stiff_and_extreme(report):
    groups = {cell.case.group for cell in report[0]}
    kinds = "EA [N], highest frequency, mass, inertia, slenderness, elements, shortest element, "
    kinds += "turn in a step, in one step, jump, dt over, EI over, String, Bead, Many steps, "
    kinds += "stiffness of the peg, rigid bars, Crank with friction, Plank that slides"
    for kind in kinds.split(", "):
        assert any(kind in group for group in groups), kind


def test_the_published_scheme_drifts_where_ours_does_not(report):
    published = of_scheme(report[0], PUBLISHED)
    drifting = [name for name, verdict in published.items() if verdict.kind != "kept"]
    assert len(drifting) > len(published) / 2
    assert "blew up" not in {verdict.kind for verdict in published.values()}


def test_newmark_blows_up_and_hht_loses_energy_on_the_pinned_beam(report):
    name = "Pinned beam, dt = 0.01 s: EA and GA over the example's: 1e0"
    assert of_scheme(report[0], NEWMARK)[name].kind == "blew up"
    assert of_scheme(report[3], HHT)["Pinned beam: dt [s]: 0.01"].kind == "lost"


def test_newmarks_rule_blows_up_on_a_rigid_loop_however_small_the_steps(report):
    loops = [cell for cell in report[0] if "Slider crank of rigid" in cell.case.name]
    ours = [cell.verdict for cell in loops if cell.scheme == OURS]
    assert [verdict.kind for verdict in ours] == ["kept", "kept"]
    newmark = [cell for cell in loops if cell.scheme == NEWMARK]
    assert [cell.case.dt for cell in newmark] == [0.01, 0.0025]
    assert [cell.verdict.kind for cell in newmark] == ["blew up", "blew up"]


def test_our_scheme_drifts_with_rounding_only(report):
    drifts = [cell.drift for cell in report[0] if cell.drift and cell.scheme == OURS]
    assert [max(drift.steps) for drift in drifts] == [10_000, 1000]
    # A unit of rounding in each step, to one side: the last digit of 2 / dt is such a bias.
    for steps, error in [item for drift in drifts for item in drift.steps.items()]:
        assert error < 1e-13 + np.finfo(float).eps * steps


def test_units_do_not_matter(report):
    units = report[2]
    assert len(units) == 12
    for case, row in units.items():
        assert row["largest difference of motion"] < 1e-11, case
        assert row["largest difference of energy"] < 1e-11, case


def test_the_report_is_written_in_full(report):
    cells, *_, directory = report

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    cases = json.loads((directory / "cases.json").read_text(), parse_constant=refuse)
    assert (
        len(cases["cells"])
        == len(cells)
        == sum(row[kind] for row in cases["verdicts"].values() for kind in stability.KINDS)
    )
    assert {"processor", "FFCx"} <= set(cases["machine"])
    page = (directory / "cases.md").read_text()
    for picture in ("cases.png", "cases_summary.png"):
        assert f"]({picture})" in page and (directory / picture).stat().st_size > 20_000
    for group in {cell.case.group for cell in cells}:
        assert f"## {group}\n" in page
    assert "## Other units" in page and "## Reasons for failed runs" in page
    assert {"tolerances.md", "damping.md", "parameters.md", "units.json"} <= {
        path.name for path in directory.iterdir()
    }
