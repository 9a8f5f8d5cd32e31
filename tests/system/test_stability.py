"""Verdicts on energies, laws of drift, studies of one's own and their tables."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from pytest import approx
from scenes import assert_refused, benchmark, pendulum

import fx_beam as fb
from fx_beam_studies import stability

# -- Verdicts ----------------------------------------------------------------------------------


def history(ratio, failure="", t_end=1.0, kinetic=2.0, work=0.0, potential=0.0):
    """A run whose energy is this many times what it should be."""
    ratio = np.asarray(ratio, dtype=float)
    zero = np.zeros_like(ratio)
    work, potential = zero + work, zero + potential
    energy = fb.Energy(kinetic * ratio + work - potential, zero, potential, work)
    reached = t_end / 2 if failure else t_end
    broken = fb.Failure(failure, failure, reached) if failure else None
    stats = fb.Stats("made up", 0.5, "none", 1, steps=len(ratio) - 1, failure=broken)
    return SimpleNamespace(t=np.linspace(0, reached, len(ratio)), energy=energy, stats=stats)


@pytest.mark.parametrize(
    ("ratio", "kind"),
    [
        ([1, 1 + 9e-9, 1 - 9e-9], "kept"),
        ([1, 1 - 2e-8, 1], "lost"),
        ([1, 1 + 2e-8, 1], "gained"),
        ([1, 1.01, 0.98], "lost"),
        ([1, 9.9, 1], "gained"),
        ([1, 10.1, 1], "blew up"),
        ([1, np.nan, 1], "blew up"),
        ([1, -0.5, 1], "lost"),
    ],
)
def test_verdict_on_a_run_that_ends(ratio, kind):
    verdict = stability.classify(history(ratio), 1.0)
    assert (verdict.kind, verdict.time, verdict.reached, verdict.reason) == (kind, 1.0, 1.0, "")
    assert verdict.steps == 2


@pytest.mark.parametrize(("stated", "kind"), [(1.0, "damped"), (0.5, "lost")])
def test_what_the_scheme_states_that_it_took_is_damped_and_what_else_is_missing_lost(stated, kind):
    run = history([1, 0.9])
    took = stated * (run.energy.kinetic[0] - run.energy.kinetic)
    run.energy = replace(run.energy, dissipated=took, numerical=took)
    verdict = stability.classify(run, 1.0)
    assert (verdict.kind, verdict.amount) == (kind, approx(0.1))


@pytest.mark.parametrize(
    ("ratio", "kinetic", "kind"),
    [([1, 3], 2.0, "failed"), ([1, 30], 2.0, "blew up"), ([1, 1], 0.0, "failed")],
    ids=["failed", "blew up", "before anything moved"],
)
def test_verdict_on_a_run_that_breaks_off(ratio, kinetic, kind):
    error = fb.StepError(fb.Failure("no convergence", "no convergence", 0.5))
    error.solution = history(ratio, "no convergence", kinetic=kinetic)
    verdict = stability.classify(error, 1.0)
    assert (verdict.kind, verdict.reason) == (kind, "no convergence")
    assert (verdict.time, verdict.reached) == (0.5, 0.5)
    assert kinetic or (verdict.highest, verdict.lowest) == (1, 1)


@pytest.mark.parametrize(
    ("acts", "ratio"),
    [
        ({}, 1.5),  # 1 J too much in the end, of 2 J at the start
        ({"work": [0, 2, 0]}, 1.25),
        ({"potential": [0, -6, -2]}, 1.125),
        # What brakes or lifts takes none of what was there at the start.
        ({"work": [0, -1, -2], "potential": [0, 1, 0]}, 1.5),
    ],
    ids=["alone", "loaded", "falling", "braked"],
)
def test_ratio_is_to_the_most_kinetic_and_strain_energy_that_should_be_there(acts, ratio):
    acts = {name: np.array(values, dtype=float) for name, values in acts.items()}
    assert stability.energy_ratio(history([1, 1, 1.5], **acts))[-1] == approx(ratio)


def test_what_the_scheme_takes_and_holds_counts_as_lost_and_what_dampers_take_does_not():
    # Of 2 J at the start and 4 J of work the scheme takes 3 J and holds 1 J, a damper takes 1 J.
    run, parts = history([1, 1, 1], work=np.array([0, 4, 4.0])), np.array([0, 0, 1.0])
    taken = {"dissipated": 4 * parts, "algorithmic": parts, "numerical": 3 * parts}
    run.energy = replace(run.energy, kinetic=np.array([2.0, 6.0, 1.0]), **taken)
    assert abs(run.energy.balance_error).max() < 1e-15
    assert stability.energy_ratio(run) == approx([1, 1, 1 - 4 / 6])
    # A run that goes on from there begins with a ratio of 1, whatever was taken before.
    for name in ("dissipated", "algorithmic", "numerical"):
        taken[name] = taken[name] + 7
    run.energy = replace(run.energy, **taken)
    assert stability.energy_ratio(run) == approx([1, 1, 1 - 4 / 6])
    # All energy taken while a load drives is a ratio of zero.
    driven, work = history([1, 1, 1], kinetic=0.0), np.array([0, 1, 5.0])
    driven.energy = replace(driven.energy, work=work, dissipated=work, numerical=work)
    assert stability.energy_ratio(driven) == approx([1, 1 - 1 / 5, 0])


def test_a_scene_at_rest_has_no_energy_to_judge():
    assert_refused("no energy moves", lambda: stability.classify(history([1, 1], kinetic=0.0), 1.0))


@pytest.mark.parametrize(
    ("options", "reason"),
    [
        ({"dt": -0.1}, "dt = -0.1 must be a positive number"),
        ({"dt": "0.1"}, "dt = '0.1' must be"),
        ({"t_end": np.inf}, "t_end = inf must be"),
        ({"dt": 2.0}, "a run needs 1 or more steps, not 0.5"),
        ({"drifts": True}, "the law of a drift needs 100 or more steps, not 10"),
        ({"scene": fb.Scene()}, "scene must be a function"),
        ({"label": 0.1}, "must be texts"),
    ],
)
def test_a_case_that_cannot_be_run_is_refused_at_once(options, reason):
    arguments = {"group": "swing", "label": "fast", "scene": fb.Scene, "dt": 0.1, "t_end": 1.0}
    assert_refused(f"swing: .*{reason}", lambda: stability.Case(**arguments | options))


# -- Drift -------------------------------------------------------------------------------------


def steps(size):
    return np.random.default_rng(7).standard_normal(size)


@pytest.mark.parametrize(
    ("errors", "exponent", "law"),
    [
        (steps((50, 2000)), 0.0, "stays within bounds"),
        (np.cumsum(steps((50, 2000)), axis=1), 0.5, "random walk"),
        (np.arange(2000.0) + 10 * steps((50, 2000)), 1.0, "drifts to one side"),
        (np.zeros((1, 2000)), 0.0, "stays within bounds"),
    ],
    ids=["noise", "walk", "line", "none"],
)
def test_drift_finds_the_law_of_made_up_errors(errors, exponent, law):
    drifts = [stability.drift_of(1e-15 * error) for error in errors]
    assert np.mean([drift.exponent for drift in drifts]) == approx(exponent, abs=0.05)
    # The exponent of a single walk scatters by 0.1.
    assert sum(drift.law == law for drift in drifts) > 0.9 * len(drifts)


def test_errors_in_a_list_or_a_column_of_a_table_drift_alike():
    walk = np.cumsum(steps(2000))
    column = pytest.importorskip("pandas").Series(walk)
    assert stability.drift_of(walk) == stability.drift_of(walk.tolist())
    assert stability.drift_of(walk) == stability.drift_of(column)


@pytest.mark.parametrize("errors", [np.zeros(99), np.full(200, np.nan)], ids=["few", "no number"])
def test_drift_needs_enough_errors(errors):
    assert_refused("100 finite errors", stability.drift_of, errors)


# -- A study of one's own ----------------------------------------------------------------------


@pytest.fixture(scope="module")
def cells():
    """Cells of a stiff and of a very stiff pendulum."""
    schemes = {"ours": fb.EnergyMomentum(), "theirs": fb.Newmark()}
    cases = [
        stability.Case("EA", f"{EA:g}", lambda EA=EA: pendulum(EA)[0], dt=0.1, t_end=5.0)
        for EA in (1e4, 1e10)
    ]
    return stability.study(schemes, cases)


def test_a_study_has_a_cell_for_every_scheme_in_every_case(cells, tmp_path):
    assert [(cell.case.label, cell.scheme) for cell in cells] == [
        (EA, scheme) for EA in ("10000", "1e+10") for scheme in ("ours", "theirs")
    ]
    assert [cell.verdict.kind for cell in cells[::2]] == ["kept", "kept"]
    assert {cell.verdict.kind for cell in cells[1::2]} & {"gained", "blew up"}
    stability.write(tmp_path / "new" / "arm", cells, "an arm", "## More\n")
    page = (tmp_path / "new" / "arm.md").read_text()
    assert page.startswith("# Stability: an arm\n") and "## More\n" in page
    written = {path.name.removeprefix("arm") for path in (tmp_path / "new").iterdir()}
    assert written == {".csv", ".json", ".md", ".png", "_summary.png"}


def arm(label, scene=lambda: pendulum(1e4)[0]):
    return stability.Case("EA", label, scene, dt=0.1, t_end=1.0)


@pytest.mark.parametrize(
    ("schemes", "cases", "reason"),
    [
        ([fb.Newmark()], [arm("1"), arm("1")], "cases: 'EA: 1' is given twice"),
        ([fb.Newmark()], [], "a study needs cases; none"),
        ([fb.Newmark()], ["1"], "'1' is no fx_beam_studies.stability.Case"),
        ({}, [arm("1")], "a study needs schemes; none"),
        ([fb.HHT(-0.1), fb.HHT(-0.2)], [arm("1")], "several schemes are called HHT"),
        ([fb.Newmark], [arm("1")], "unknown scheme .*with brackets"),
    ],
)
def test_a_study_that_cannot_be_made_is_refused_before_anything_runs(schemes, cases, reason):
    assert_refused(reason, stability.study, schemes, cases)


@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (lambda run: stability.study([fb.Newmark()], 3), "3 is no fx_beam_studies.stability.Case"),
        (lambda run: stability.study([], [], max_halvings=-1), "max_halvings = -1 must be a who"),
        (lambda run: stability.study([], [], repeats="four"), "repeats = 'four' must be a whole"),
        (lambda run: stability.counts(3), "3 is no fx_beam_studies.stability.Cell"),
        (lambda run: stability.counts(["kept"]), "'kept' is no fx_beam_studies.stability.Cell"),
        (lambda run: stability.classify("kept", 1.0), "classify: run = 'kept' must be"),
        (lambda run: stability.classify(run, 0.0), "classify: t_end = 0.0 must be a positive"),
    ],
)
def test_what_is_no_case_cell_or_run_is_refused_by_name(call, reason):
    scene, _ = pendulum(1e4)
    assert_refused(reason, lambda: call(fb.simulate(scene, dt=0.1, t_end=0.1)))


def at_rest():
    scene = fb.Scene()
    section = fb.Section(EA=1.0, GA=1.0, EI=1.0)
    scene.clamp(scene.add_beam([(0, 0), (1, 0)], section, elements=1).start)
    return scene


def broken():
    raise OSError("no such file")


def test_a_case_that_cannot_be_computed_is_a_cell_that_says_why(tmp_path):
    makers = {"has no beams": fb.Scene, "no energy moves": at_rest, "no such file": broken}
    cases = [arm("fine"), *(arm(*case) for case in makers.items()), arm("fine too")]
    fine, *wrong, fine_too = stability.study([fb.EnergyMomentum()], cases)
    assert fine.verdict.kind == fine_too.verdict.kind == "kept"
    for cell in wrong:
        assert cell.verdict.kind == "no verdict" and cell.case.label in cell.verdict.reason
    stability.write(tmp_path / "arm", [fine, *wrong], "an arm")
    page = (tmp_path / "arm.md").read_text()
    assert "no such file" in page and "| no verdict" in page and "nan" not in page
    assert stability.counts(wrong)["EnergyMomentum"]["no verdict"] == 3


def test_an_interrupt_carries_the_cells_that_were_found():
    def interrupted():
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt) as stop:
        stability.study([fb.EnergyMomentum()], [arm("1"), arm("2", interrupted)])
    assert [cell.case.label for cell in stop.value.cells] == ["1"]


# -- Rounding ----------------------------------------------------------------------------------


def verdict(ratio, reason=""):
    return stability.classify(history([1, ratio], reason), 1.0)


@pytest.mark.parametrize(
    ("one", "others", "apart"),
    [
        (verdict(1.5), [verdict(1.52)], None),
        (verdict(1.5), [verdict(1.6)], 0),
        (verdict(1.5), [verdict(1.6), verdict(1.7)], 1),
        (verdict(1.5), [verdict(1.7), verdict(0.5)], 1),
        (verdict(np.inf), [verdict(np.inf)], None),
        (verdict(1 + 1e-15), [verdict(1 + 1e-12)], None),
        (verdict(1 + 1e-15), [verdict(1 + 1e-7)], 0),
        (verdict(1.5, "why"), [verdict(1.5, "why")], None),
        (verdict(1.5), [], None),
    ],
)
def test_a_number_that_rounding_turns_is_marked_by_the_farthest_other(one, others, apart):
    cell = stability.Cell(arm("1"), "ours", one, tuple(others))
    assert cell.other is (None if apart is None else others[apart])


def test_what_is_not_kept_is_repeated_with_other_rounding(cells):
    for cell in cells:
        assert bool(cell.others) == (cell.verdict.kind != "kept" or cell.halved_often)
    # A pendulum's loss by HHT is none of rounding.
    (cell,) = stability.study([fb.HHT(-0.1)], [arm("1")])
    assert cell.verdict.kind == "lost" and cell.others and cell.other is None
    assert cell.others[0].time != cell.verdict.time  # its steps have another last digit


def test_halved_steps_are_counted_and_marked(tmp_path):
    bench = benchmark("stability")
    case = bench.on_pendulum("turn", "2.1", 0.01, SPEED=100 * np.tan(2.1 / 2))
    (cell,) = stability.study([fb.EnergyMomentum()], [case])
    assert cell.verdict.kind == "kept" and cell.halved_often
    assert cell.verdict.parts == cell.verdict.substeps / 500 >= 2
    stability.write(tmp_path / "turn", [cell], "a turn")
    page = (tmp_path / "turn.md").read_text()
    assert "; steps x2" in page and "after 12 halvings" in page
    assert stability.counts([cell])["EnergyMomentum"]["steps halved often"] == 1


# -- Tables ------------------------------------------------------------------------------------


def made_up(group, label, ratios):
    """A cell for each of the ratios."""
    case = stability.Case(group, label, fb.Scene, dt=0.1, t_end=1.0)
    return [stability.Cell(case, str(k), verdict(ratio)) for k, ratio in enumerate(ratios)]


def test_the_table_says_how_often_each_verdict_was_had_and_how_large_it_was(tmp_path):
    cells = [
        cell
        for label, ratios in (("1", (1, 0.9)), ("2", (1 + 3e-12, 30)), ("3", (0.5, 1.2)))
        for cell in made_up("a", label, ratios)
    ]
    first, second = stability.counts(cells).values()
    assert [first[kind] for kind in stability.KINDS] == [2, 0, 1, 0, 0, 0, 0]
    assert [second[kind] for kind in stability.KINDS] == [0, 0, 1, 1, 1, 0, 0]
    numbers = "largest error where kept", "largest loss", "largest gain"
    assert [first[name] for name in numbers] == approx([3e-12, 0.5, 3e-12], rel=1e-3)
    assert [second[name] for name in numbers] == approx([np.nan, 0.1, 29], nan_ok=True)
    stability.write(tmp_path / "made up", cells, "a table", findings=["It was found."])
    page = (tmp_path / "made up.md").read_text()
    rows = [[cell.strip() for cell in line.split("|")] for line in page.splitlines()]
    assert ["", "0", *"2010000", "3e-12", "0.5", "3e-12", *"000", ""] in rows
    assert ["", "1", *"0011100", "", "0.1", "29", *"000", ""] in rows
    assert ["", "2", "0.1", "1", "kept 3e-12", "blew up \u00d730", ""] in rows
    assert "- It was found.\n" in page


def test_the_report_says_from_which_tolerance_on_verdicts_stay_and_how_large_errors_are():
    rows = {"1e-2": (1 + 1e-5, 0.9), "1e-4": (1 + 1e-6, 1.1), "1e-6": (1 + 2**-43, 1.1)}
    cells = [
        stability.Cell(arm(label), scheme, verdict(ratio))
        for label, ratios in rows.items()
        for scheme, ratio in zip("AB", ratios, strict=True)
    ]
    lines = benchmark("stability").tolerances_page(cells).splitlines()
    table = [line.strip("|").split("|") for line in lines if line.startswith("|")]
    head, _, *computed = [[cell.strip() for cell in row] for row in table]
    assert head[2:] == [f"largest error, {label}" for label in rows]
    assert computed == [
        ["A", "1e-6", "1e-05", "1e-06", "1.14e-13"],
        ["B", "1e-4", "0.1", "0.1", "0.1"],
    ]
