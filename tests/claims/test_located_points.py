"""Critical points that are hard to locate: many in a step, at a row, or not at all."""

import numpy as np
import pytest
from scenes import assert_refused, clamped_bar, supported_bar

import fx_beam as fb
from fx_beam.equilibria import critical_points
from fx_beam.step.stepper import StepFailed


def rigid_columns(stiffnesses, load):
    """Rigid columns of length 1 on hinges, each with its own spring: P L = c."""
    scene = fb.Scene()
    for x, stiffness in enumerate(stiffnesses):
        bar = scene.add_body((x, 1), 1.0, 1.0, points={"foot": (x, 0)})
        scene.add_joint(fb.Revolute(fb.GROUND, bar["foot"], spring=fb.Spring(stiffness)))
        scene.add_force(bar.centre, (0, -load))
    return scene


def test_a_single_step_may_pass_eighty_points():
    stiffnesses = 1.0 + np.arange(80)
    path = fb.static(rigid_columns(stiffnesses, 100.0), load_steps=1)
    points = path.critical_points
    # A step that passes so many is cut without a search, and its parts are rows.
    assert path.unstable_modes[[0, -1]].tolist() == [0, 80]
    assert {point.kind for point in points} == {"bifurcation"}
    loads = [100 * point.load_factor for point in points]
    assert loads == pytest.approx(stiffnesses.tolist(), rel=1e-7)


def test_steps_may_meet_one_of_several_points():
    path = fb.static(rigid_columns((2.0, 5.0, 8.0), 10.0), load_steps=2)
    assert path.unstable_modes.tolist() == [0, 1, 3]
    loads = [10 * point.load_factor for point in path.critical_points]
    assert loads == pytest.approx([2.0, 5.0, 8.0], rel=1e-9)


@pytest.fixture
def missed_point(monkeypatch):
    """The second mode that becomes unstable in a step is missed."""

    def root_of(piece, measure, place):
        if place.few == 1:
            raise StepFailed("singular", "no pivot", np.zeros(1), [])
        return located(piece, measure, place)

    located = critical_points.root_of
    monkeypatch.setattr(critical_points, "root_of", root_of)


@pytest.mark.usefixtures("missed_point")
def test_a_step_in_which_a_mode_becomes_unstable_at_no_point_is_refused():
    message = "1 are unstable at its start and 2 at its end, with no critical point between"
    with pytest.raises(fb.StepError, match=message) as caught:
        fb.static(rigid_columns((2.0, 5.0, 8.0), 10.0), load_steps=4)
    assert 10 * caught.value.solution.load_factor[-1] == pytest.approx(5.0, abs=0.01)


@pytest.mark.usefixtures("missed_point")
def test_what_is_not_located_is_in_the_list_with_one_warning(monkeypatch, caplog, tmp_path):
    """Some steps are accepted without a look at their points, as those to limit points."""
    monkeypatch.setattr(critical_points.Crossings, "check_stability", lambda *_: None)
    path = fb.static(rigid_columns((2.0, 5.0, 8.0), 10.0), load_steps=1)
    caplog.clear()
    first, second, missed = sorted(path.critical_points, key=lambda point: point.kind)
    assert [10 * point.load_factor for point in (first, second)] == pytest.approx([2.0, 8.0])
    assert (missed.kind, missed.row) == ("not located", 0) and np.isnan(missed.load_factor)
    assert str(missed) == "<CriticalPoint: not located, between the rows 0 and 1>"
    (record,) = caplog.records
    assert "between the rows 0 and 1 were not located" in record.message
    fb.plot.equilibrium_paths(path, lambda s: s.q[:, 0, 2], tmp_path / "path.png")
    assert_refused("no path branches off", missed.branch)


def test_where_modes_are_unknown_there_are_no_points_but_a_warning(caplog):
    scene, beam = clamped_bar((0, 1), fb.Section(EA=1e4, GA=1e4, EI=1.0), 4)
    scene.add_force(beam.end, (0, -2.0), follower=True)
    path = fb.static(scene, load_steps=2)
    assert path.critical_points == []
    assert "stability depends on masses" in caplog.text
    assert_refused("depends on masses", lambda: path.unstable_modes, error=ValueError)


@pytest.mark.parametrize(("load", "push"), [(1 - 7e-10, 1e-9), (1.0, 1e-8), (1 + 1e-12, 1e-9)])
def test_an_error_names_a_bifurcation_one_step_ahead_whatever_the_rounding(load, push):
    """Steps that are halved end one of the last steps before the bifurcation."""

    def column(load):
        scene, beam = supported_bar((0, 1), fb.Section(EA=1e4, GA=4e3, EI=1.0), 4, 2, held="x")
        scene.add_force(beam.end, (0, -load))
        return scene

    (point,) = fb.static(column(14.0), load_steps=4).critical_points
    scene = column(14.0 * point.load_factor * load)
    scene.add_force(scene.beams[0].node(0.5), (push, 0))
    # With more cuts the path goes on along the arc length, past its sharp bend.
    with pytest.raises(fb.StepError, match=r"a bifurcation near load factor 1\. Follow"):
        fb.static(scene, load_steps=4, max_cuts=4)


@pytest.mark.parametrize("stiffness", [1e4, 1e10])
def test_a_limit_point_of_a_driven_rotation_is_one_for_any_stiffness(stiffness):
    """A buckled member whose end is turned against its bow snaps through."""
    scene, beam = clamped_bar((1, 0), fb.Section(EA=stiffness, GA=stiffness, EI=1.0), 8, 2)
    scene.fix(beam.end, "y", "rotation")
    scene.prescribe(beam.end, x=lambda t: -0.01)
    point = fb.static(scene, load_steps=4).critical_points[0]
    bent = fb.static(scene, start=point.branch(), continuation="arc-length", load_steps=4)
    scene.free(beam.start, "rotation")
    scene.prescribe(beam.start, rotation=lambda t: -0.22)
    how = {"continuation": "arc-length", "load_steps": 10, "max_steps": 25}
    turned = fb.static(scene, start=bent, **how)
    assert turned.critical_points[0].kind == "limit point"
    assert turned.critical_points[0].load_factor == pytest.approx(turned.stats.limit_points[0])
