"""Error against run time: the error measure is right, and the words follow from the numbers."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import scenes
from pytest import approx
from scenes import assert_refused, clamped_bar

import fx_beam as fb
from fx_beam_studies import work_precision
from fx_beam_studies.work_precision import Mesh, Precision, Run, accuracy, sentence, study
from fx_beam_studies.work_precision.accuracy import History, counted
from fx_beam_studies.work_precision.report import mesh_order, step_order

T = np.linspace(0, 2, 41)
PENDULUM = scenes.demo("pendulum")
MESH = Mesh(1, 1)


def error_of(quantity, exact, solution):
    """Relative error of a quantity of interest."""
    history = accuracy.measure("q", quantity, solution)
    return accuracy.error("q", history, accuracy.exact("q", exact, T[-1]))


def pendulum(elements=1, degree=1):
    return PENDULUM.scene(elements, degree)[0]


def tip(t):
    """Path of the pendulum's tip on a rigid rod."""
    return PENDULUM.rigid(t)[0]


def small(**change):
    """A study of the pendulum that takes no time, with a change."""
    usual = {"scene": pendulum, "quantities": {"tip": PENDULUM.displacement}, "exact": {"tip": tip}}
    usual |= {"schemes": [fb.EnergyMomentum()], "dt": [0.1], "meshes": [(1, 1)], "t_end": 0.2}
    return study(**usual | {"repetitions": 1} | change)


# -- The error of a made-up solution is the one that was put in --------------------------------


def test_a_quantity_that_is_not_there_has_no_error():
    assert np.isnan(error_of(lambda s: None, 1.0, SimpleNamespace(t=T)))
    assert np.isnan(error_of(lambda s: np.where(s.t > 1, np.nan, 0.0), 0.0, SimpleNamespace(t=T)))


def test_a_force_is_compared_only_at_times_at_which_the_reference_has_it():
    # A mid-point scheme has its last force half a step before the end.
    reference = History(T[:-1] + 0.025, T[:-1, None] + 0.025, size=2.0)
    history = History(T, T[:, None] + np.where(T == 1, 0.5, 0)[:, None])
    assert accuracy.error("q", history, reference) == approx(0.25)
    with pytest.raises(fb.SceneError, match="no time between"):
        accuracy.error("q", History(T[-1:], T[-1:, None]), reference)


# -- Orders, and the error of the reference ------------------------------------------------------


STEPS = [0.1, 0.2, 0.4, 0.8, 1.6]


@pytest.mark.parametrize(
    ("errors", "order"),
    [
        ([*(0.5 * h**3.5 for h in STEPS[:3]), 0.9, 0.9], 3.5),  # of the three finest
        ([3e-12, 1e-4, 4e-4, 1.6e-3, np.nan], 2),  # without round-off
        ([1e-12, 1e-4, 4e-4, 5.0, np.inf], None),
        ([3e-4, 1e-4, 4e-4], None),  # they do not fall steadily
        ([4e-4, 2e-4, 1e-4], None),
        ([1e-5, 3e-4, 4e-4], None),
        ([1e-4, 1e-4, 4e-4], None),
    ],
)
def test_the_order_is_that_of_errors_that_fall_steadily_and_are_no_round_off(errors, order):
    slope = accuracy.observed_order(zip(STEPS, errors, strict=False), 1e-10)
    assert slope == (None if order is None else approx(order))


def test_estimated_error_of_a_computed_pendulum_bounds_its_distance_from_the_exact_one():
    precision = small(exact=None, t_end=2.0)
    reference = fb.simulate(pendulum(4), dt=0.1 / 16, t_end=2.0)
    true = error_of(PENDULUM.displacement, tip, reference)
    assert true <= precision.references["tip"] <= 5 * true


# -- Quantities of interest of real motions, against exact ones ----------------------------------


def test_error_of_the_momentum_of_free_flight_is_what_a_step_misses_of_the_force():
    # The force of 8 ends at 2.5 s, at the end of a step of 0.1; one of 0.15 from 2.4 s on takes the
    # mean of 8 and 0, which is 0.6 in place of 0.8 of 20.
    precision = small(
        scene=lambda elements, degree: scenes.free_flight(elements, degree)[0],
        quantities={"momentum": lambda s: s.linear_momentum},
        exact={"momentum": lambda t: np.column_stack([8 * np.minimum(t, 2.5), 0 * t])},
        dt=[0.1, 0.15],
        meshes=[(2, 1)],
        t_end=3.0,
    )
    errors = [run.errors["momentum"] for run in precision.runs]
    assert errors == approx([0, 0.01], abs=1e-12)


def soft_arm(elements, degree):
    """A clamped arm with a tip force that rises smoothly; the steps below resolve its waves."""
    section = fb.Section(EA=200.0, GA=100.0, EI=2.0, rhoA=1.0, rhoI=0.1)
    ends = (0, 0), (1, 0)
    scene, arm = clamped_bar(ends, section, elements=elements, degree=degree, name="arm")
    scene.add_force(arm.end, lambda t: (0.0, 10 * np.sin(3 * t) ** 4))
    return scene


def test_errors_of_step_and_mesh_are_told_apart():
    precision = small(
        scene=soft_arm,
        quantities={"tip": lambda s: s.displacement(s.beams["arm"].end)},
        exact=None,
        dt=[0.02, 0.01, 0.005],
        meshes=[(3, 1), (6, 1), (12, 1)],
        t_end=0.6,
    )
    assert mesh_order(precision, "tip", 1) == approx(2, abs=0.1)
    coarse, finest = precision.runs[0].mesh, precision.runs[2]
    assert finest.errors["tip"] == approx(precision.mesh_errors[coarse]["tip"], rel=0.2)
    assert finest.step_errors["tip"] < finest.errors["tip"] / 5
    assert step_order(precision, "tip", "EnergyMomentum", coarse) == approx(2, abs=0.1)


# -- The cheapest run for an error ----------------------------------------------------------------


def made_up(runs, mesh_errors=None, **references):
    """A study with runs (scheme, seconds, error), the slower the finer, as if it had been done."""
    rows = []
    for scheme, seconds, error, *more in runs:
        options = {
            "mesh": MESH,
            "dt": 1e-4 / seconds,
            "unknowns": 4,
            "steps": 10,
            "energy_error": 0.0,
        }
        options |= {"errors": {"q": error}, "seconds": seconds, "step_seconds": seconds / 10}
        rows.append(Run(scheme, scheme, **options | dict(*more)))
    return Precision(1.0, 5, {"q": None} | references, "", rows, mesh_errors or {})


TWO = [("A", 1e-3, 5e-2), ("A", 2e-3, 5e-3), ("B", 1.5e-3, 4e-2), ("B", 1e-2, 6e-4)]


def seconds_at(precision, error):
    """Time of the fastest run of each scheme."""
    return {scheme: run.seconds for scheme, run in precision.cheapest("q", error).items()}


def test_the_fastest_run_of_each_scheme_is_found_the_fastest_scheme_first():
    precision = made_up(TWO)
    assert list(seconds_at(precision, 1e-1).items()) == [("A", 1e-3), ("B", 1.5e-3)]
    assert list(seconds_at(precision, 1e-2).items()) == [("A", 2e-3), ("B", 1e-2)]
    assert seconds_at(precision, 1e-3) == {"B": 1e-2}
    assert seconds_at(precision, 1e-4) == {}


def test_the_sentence_swaps_with_the_numbers():
    swap = {"A": "B", "B": "A"}
    there = sentence(made_up(TWO), "q")
    back = sentence(made_up([(swap[scheme], *numbers) for scheme, *numbers in TWO]), "q")
    assert there == (
        "q: the smallest error is 6e-4, by B, dt = 0.01 s, 1 element of degree 1, in 10 ms. "
        "The reference is exact. 0 of 4 runs broke off or have an error above 1."
    )
    assert there.replace("by B", "by A") == back != there


def test_a_run_that_finer_steps_do_not_confirm_counts_with_their_error():
    # The error changes its sign near the first step.
    precision = made_up([("A", 1e-3, 3e-4), ("A", 2e-3, 7.6e-3), ("B", 2e-3, 5e-3)])
    assert [counted(precision, "q", run) for run in precision.runs] == [7.6e-3, 7.6e-3, 5e-3]
    assert seconds_at(precision, 1e-3) == {} and set(seconds_at(precision, 1e-2)) == {"A", "B"}


def test_a_run_whose_errors_of_step_and_mesh_cancel_counts_with_that_of_the_mesh():
    meshes = [Mesh(4, 1), Mesh(8, 1), Mesh(2, 2)]
    runs = [("A", 1e-3, 1e-5, {"mesh": mesh}) for mesh in meshes]
    left = dict(zip(meshes, ({"q": 1e-4}, {"q": 3e-4}, {"q": 1e-6}), strict=True))
    precision = made_up(runs, left)
    assert [counted(precision, "q", run) for run in precision.runs] == [3e-4, 3e-4, 1e-5]


@pytest.mark.parametrize("lost", [{"energy_error": 0.6}, {"failure": "blew up", "errors": {}}])
def test_a_lost_motion_wins_nothing_nor_does_one_that_smaller_steps_lose(lost):
    runs = [("A", 1e-3, 5e-2), ("A", 2e-3, 1e-4, lost), ("A", 3e-3, 5e-3), ("B", 9e-3, 5e-3)]
    precision = made_up(runs)
    assert [counted(precision, "q", run) for run in precision.runs] == [np.inf, np.inf, 5e-3, 5e-3]
    assert seconds_at(precision, 1e-1) == {"A": 3e-3, "B": 9e-3}
    assert "by A, dt = 0.0333 s" in sentence(precision, "q")


def test_errors_below_that_of_the_reference_are_not_shown_as_known(tmp_path):
    precision = made_up([*TWO, ("B", 2e-2, 1e-5)], q=1e-3)
    errors = [counted(precision, "q", run) for run in precision.runs]
    assert errors == [5e-2, 5e-3, 4e-2, 3e-3, 3e-3]
    assert seconds_at(precision, 1e-3) == {} and set(seconds_at(precision, 1e-2)) == {"A", "B"}
    assert "the smallest error is 3e-3, by B, dt = 0.01 s" in sentence(precision, "q")
    assert "The reference is known to 0.001." in sentence(precision, "q")
    assert_refused(r"quantity = 'p' must be one of \['q'\]", sentence, precision, "p")
    with pytest.raises(ValueError, match="path = 3 must be the name of a file"):
        work_precision.write(3, precision)
    work_precision.write(tmp_path / "q", precision)
    rows = [line.split("|") for line in (tmp_path / "q.md").read_text().splitlines()]
    errors = [row[-3].strip() for row in rows if len(row) > 12 and row[1].strip() in "AB"]
    assert errors == ["0.05", "0.005", "0.04", "< 0.003", "< 0.003"]


# -- Running -----------------------------------------------------------------------------------


def test_a_run_that_fails_is_a_row_with_its_reason(tmp_path):
    precision = small(
        scene=lambda elements, degree: scenes.pinned_beam(elements, degree)[0],
        quantities={"energy": lambda s: s.energy.balance_error / s.energy.total[0]},
        exact={"energy": 0.0},
        schemes={"ours": fb.EnergyMomentum(), "trapezoidal": fb.Newmark()},
        dt=[0.02],
        meshes=[(8, 1)],
        t_end=1.0,
        results=tmp_path / "pinned",
    )
    ours, newmark = precision.runs
    assert ours.errors["energy"] < 1e-11 and not ours.failure
    assert newmark.errors == {} and "t = " in newmark.failure and newmark.reached < 1
    # The steps are a part of the call; a run that broke off has its times too.
    assert all(run.seconds >= run.step_seconds > 0 for run in precision.runs)
    page = (tmp_path / "pinned.md").read_text()
    assert newmark.failure in page and sentence(precision, "energy") in page
    assert "by ours, dt = 0.02 s" in sentence(precision, "energy")
    assert "1 of 2 runs broke off" in sentence(precision, "energy")
    row = json.loads((tmp_path / "pinned.json").read_text())["Runs"][1]
    assert row["failure"] == newmark.failure and row["seconds"] > 0
    for picture in ("pinned.png", "pinned_curves.png"):
        assert (tmp_path / picture).stat().st_size > 10_000 and f"({picture})" in page


def test_a_motion_starts_from_the_static_solution_that_is_given(tmp_path):
    def pulled(elements, degree):
        scene = pendulum(elements, degree)
        tip = scene.beams[0].end
        scene.fix(tip, "x")
        scene.add_force(tip, (0.0, -20.0))
        return fb.static(scene)

    force = {"force": lambda s: s.resultants("rod").N[0, 0]}
    start = 20.0 + PENDULUM.MASS * PENDULUM.GRAVITY
    more = {"start": pulled, "meshes": [(2, 2)], "results": tmp_path / "pulled"}
    precision = small(quantities=force, exact={"force": start}, **more)
    assert precision.runs[0].errors["force"] < 1e-6
    assert "from the solutions that `pulled` gives" in (tmp_path / "pulled.md").read_text()
    assert small(quantities=force, exact={"force": start}).runs[0].errors["force"] == approx(1)


def test_a_quantity_that_fails_for_one_scheme_is_noted_and_all_else_is_kept(tmp_path):
    def picky(solution):
        if solution.stats.scheme == "Newmark":
            raise ZeroDivisionError("nothing to divide by")
        return PENDULUM.displacement(solution)

    precision = small(
        quantities={"tip": PENDULUM.displacement, "picky": picky},
        exact={"tip": tip, "picky": tip},
        schemes=[fb.EnergyMomentum(), fb.Newmark()],
        results=tmp_path / "picky",
    )
    ours, newmark = precision.runs
    assert ours.errors["picky"] == ours.errors["tip"] and not ours.notes
    assert np.isnan(newmark.errors["picky"]) and newmark.errors["tip"] > 0
    assert "'picky' failed, ZeroDivisionError: nothing to divide by" in newmark.notes["picky"]
    assert newmark.notes["picky"] in (tmp_path / "picky.md").read_text()


def test_a_reference_that_fails_is_said_and_exact_quantities_keep_their_errors(tmp_path):
    def fast(elements, degree):
        scene = pendulum(elements, degree)
        scene.add_force(scene.beams[0].end, lambda t: (1 / 0 if t > 0.1 else 0.0, 0.0))
        return scene

    quantities = {"tip": PENDULUM.displacement, "energy": lambda s: PENDULUM.energy_ratio(s) - 1}
    precision = small(
        scene=lambda elements, degree: (fast if elements > 1 else pendulum)(elements, degree),
        quantities=quantities,
        exact={"energy": 0.0},
        results=tmp_path / "lost",
    )
    (run,) = precision.runs
    assert run.errors["energy"] < 1e-12 and run.seconds > 0
    assert np.isnan(run.errors["tip"]) and np.isnan(precision.references["tip"])
    assert (
        "there is no reference: EnergyMomentum, dt = 0.00625 s, 4 elements of degree 1: "
        in sentence(precision, "tip")
    )
    assert precision.missing["tip"] in (tmp_path / "lost.md").read_text()


def test_steps_and_meshes_may_be_arrays():
    precision = small(dt=np.array([0.1, 0.05]), meshes=np.array([[1, 1], [2, 1]]))
    assert [(run.mesh.elements, run.dt) for run in precision.runs] == [
        (1, 0.1), (1, 0.05), (2, 0.1), (2, 0.05)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"quantities": [PENDULUM.displacement]}, "quantities = .* must be a dict"),
        ({"dt": []}, "needs dt"),
        ({"dt": [0.1, 0.3]}, "dt = 0.3 must be a positive number, at most t_end = 0.2"),
        ({"dt": [0.1, 0.05, 0.1]}, "dt: 0.1 is given twice"),
        ({"meshes": [4, 8]}, "mesh = 4 must be a pair"),
        ({"finer": None}, "finer = None must be a pair of whole numbers"),
        ({"finer": (16, 3)}, r"finer = \(16, 3\) must be .* the second one even"),
        ({"repetitions": 0}, "repetitions = 0"),
        ({"exact": {"tap": 1.0}}, "'tap'"),
        ({"exact": {"tip": np.nan}}, "exact value of 'tip' is not a finite number"),
        ({"exact": {"tip": lambda t: t[1:]}}, "exact value of 'tip' has 1000 rows"),
        ({"exact": {"tip": lambda t: t.tap}}, "exact value of 'tip' failed, AttributeError"),
        ({"scene": PENDULUM.scene}, r"scene\(1, 1\) gives .*, which is not a Scene"),
        ({"scene": lambda n, degree: pendulum(n / 0)}, r"scene\(1, 1\) failed, ZeroDivisionError"),
        ({"results": Path(__file__) / "arm"}, "results = .* cannot be written"),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(change, message):
    assert_refused(message, small, **change)


@pytest.mark.parametrize(
    ("quantity", "message"),
    [
        (lambda s: 1 / 0, "'tip' failed, ZeroDivisionError"),
        (lambda s: s.beams["arm"], "'tip' failed, KeyError: 'arm'"),
        (lambda s: (s.t, s.t, s.t), "'tip': a tuple"),
        (lambda s: s.t[1:], "'tip' has 2 rows for 3 times"),
        (lambda s: s.t, "'tip' has 1 values at a time, its reference 2"),
        (lambda s: s.v, r"'tip' must be .* with the shape \(3, 2, 3\)"),
    ],
)
def test_a_wrong_quantity_is_refused_by_name(quantity, message):
    with pytest.raises(fb.SceneError, match=message) as refused:
        small(quantities={"tip": quantity}, dt=[0.05, 0.1])
    assert "(EnergyMomentum, dt = 0.1 s, 1 element of degree 1)" in str(refused.value)
