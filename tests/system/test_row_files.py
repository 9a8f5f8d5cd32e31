"""Rows that go to files as they come are those of a solution in memory."""

import numpy as np
import process_cases
import pytest
from process_cases import CASES

import fx_beam as fb
from fx_beam.motions import run
from fx_beam.results import paraview

# What a solution has in memory beside the files.
IN_MEMORY = "t", "t_level", "reactions", "joint_forces", "motor_forces", "contact_forces", "slides"


@pytest.fixture
def few(monkeypatch):
    """Rows are written after a few steps."""
    monkeypatch.setattr(run, "_BLOCK", 400)
    monkeypatch.setattr(paraview, "_NUMBERS", 100)


def grids(file):
    """Times, and the grid at each, in turn."""
    pv = pytest.importorskip("pyvista")
    reader = pv.get_reader(str(file))
    for t in reader.time_values:
        reader.set_active_time_value(t)
        (grid,) = reader.read()
        yield t, grid


OPTIONS = {
    "jointed": {},
    "decaying": {"every": 3},
    "flung": {"rates": False},
    "flung with a tolerance": {},
    "yielding": {},
}


@pytest.mark.plot
@pytest.mark.parametrize("name", OPTIONS)
def test_files_have_the_rows_and_the_solution_all_else(name, few, tmp_path):
    kinds = OPTIONS[name]
    whole = CASES[name](record=fb.Record(**kinds))
    whole.to_paraview(tmp_path / "whole.pvd")
    found = CASES[name](record=fb.Record(file=tmp_path / "rows.pvd", **kinds))
    rows, wanted = (list(grids(tmp_path / f"{name}.pvd")) for name in ("rows", "whole"))
    assert [t for t, _ in rows] == [t for t, _ in wanted]
    for (_, one), (_, other) in zip(rows, wanted, strict=True):
        assert one.point_data.keys() == other.point_data.keys()
        for kind in other.point_data:
            np.testing.assert_array_equal(one[kind], other[kind])
        np.testing.assert_array_equal(one.points, other.points)
        np.testing.assert_array_equal(one.cell_data["beam"], other.cell_data["beam"])
    files = [sorted(tmp_path.glob(f"{name}/*.vtu")) for name in ("rows", "whole")]
    for row, wanted_row in zip(*files, strict=True):
        assert row.read_bytes() == wanted_row.read_bytes()
    assert not list(tmp_path.glob("*/.*"))
    for kind in IN_MEMORY:
        np.testing.assert_array_equal(getattr(found, kind), getattr(whole, kind))
    for kind, values in vars(whole.energy).items():
        np.testing.assert_array_equal(getattr(found.energy, kind), values)


def test_a_motion_goes_on_from_its_end_also_from_the_file(few, tmp_path):
    scene, file = process_cases.jointed(), tmp_path / "rows.pvd"
    whole = fb.simulate(scene, dt=0.01, t_end=0.2)
    first = fb.simulate(scene, dt=0.01, t_end=0.1, record=fb.Record(file=file))
    for start in (first, fb.load(tmp_path / "rows" / "end.npz")):
        rest = fb.simulate(scene, dt=0.01, t_end=0.2, start=start)
        assert abs(rest.q[-1] - whole.q[-1]).max() < 1e-13
        # The work is 0.05 J in a motion of 740 J, whose round-off it has.
        round_off = 1e-15 * whole.energy.total.max()
        assert abs(rest.energy.work[-1] - whole.energy.work[-1]) < round_off


def test_what_is_in_the_file_is_said_where_it_is_asked_for(tmp_path):
    file = tmp_path / "rows.pvd"
    found = CASES["flung"](record=fb.Record(file=file))
    assert found.stats.file == str(file)
    for ask in (
        lambda: found.position(next(iter(found.beams.values())).end),
        lambda: found.resultants(next(iter(found.beams))),
        lambda: fb.plot.shapes(found, rows=[0]),
    ):
        with pytest.raises(ValueError, match=r"motion not in memory: the rows are in .*rows.pvd"):
            ask()


def test_steps_before_a_failure_are_in_the_file(few, tmp_path):
    def fail():
        raise ValueError("no such load")

    scene = process_cases.loaded(process_cases.Stops(0.055, fail))
    with pytest.raises(fb.StepError) as caught:
        fb.simulate(scene, dt=0.01, t_end=0.1, record=fb.Record(file=tmp_path / "rows.pvd"))
    text = (tmp_path / "rows.pvd").read_text()
    assert text.count("DataSet ") == len(caught.value.solution.t) == 6


def test_what_a_file_cannot_have_is_refused(tmp_path):
    file, scene = tmp_path / "rows.pvd", process_cases.held()
    for wrong in ({"times": [0.0, 0.1]}, {"motion": False}):
        with pytest.raises(fb.SceneError, match="a file needs"):
            fb.Record(file=file, **wrong)
    with pytest.raises(ValueError, match="its name must end with .pvd"):
        fb.Record(file=tmp_path / "rows.vtk")
    record = fb.Record(file=file)
    with pytest.raises(fb.SceneError, match="not possible with until or changes"):
        fb.simulate(scene, dt=0.01, t_end=0.1, record=record, until=lambda t, y: t - 0.05)
    with pytest.raises(fb.SceneError, match="Motion: a record to a file is not possible"):
        fb.Motion(scene, dt=0.01, record=record)
    with pytest.raises(fb.SceneError, match="Response: a record to a file is not possible"):
        fb.Response(lambda x: (scene, {}), dt=0.01, t_end=0.1, record=record)
    bare = fb.Scene()
    bare.add_body((0, 0), 1.0, 0.1)
    with pytest.raises(fb.SceneError, match="needs beams"):
        fb.simulate(bare, dt=0.01, t_end=0.1, record=record)
    assert not list(tmp_path.iterdir())
