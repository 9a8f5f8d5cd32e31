"""The schema of the state: what follows from it for C, records, files and the manual."""

import dataclasses
import inspect

import numpy as np
import pytest
from scenes import pinned_beam

import fx_beam as fb
from fx_beam.compiled import build
from fx_beam.results.histories import HISTORIES
from fx_beam.results.state import ARRAYS, NUMBERS, State


def test_the_state_in_c_has_all_numbers_and_arrays():
    ffi, _ = build.load_library()
    members = dict(ffi.typeof("Problem").fields)
    assert {members[name].type.cname for name in NUMBERS} == {"double"}
    assert {members[name].type.cname for name in ARRAYS} == {"double *"}
    floats = {f.name for f in dataclasses.fields(State) if f.type == "float"}
    assert floats == {*NUMBERS, "impact"}  # which is constant in a run


@pytest.fixture(scope="module")
def beating():
    """A spring beam that beats a wall, as a function of what is recorded."""

    def run(**options):
        scene, beam = pinned_beam(4)
        scene.add_obstacle(beam.end, fb.Line((0, -1.0), normal=(0, 1)), stiffness=1e3)
        scene.add_joint(fb.PinInSlot(fb.GROUND, beam.end, axis=(0, 1), spring=fb.Spring(1.0)))
        return fb.simulate(scene, t_end=0.1, **options)

    return run


def test_histories_of_the_schema_are_in_files_and_in_the_manual(beating, tmp_path):
    solution = beating(dt=0.01)
    solution.save(tmp_path / "run.npz")
    again = fb.load(tmp_path / "run.npz")
    for name, history in HISTORIES.items():
        rows = getattr(solution, name)
        assert rows.ndim == 1 + len(history.shape) and len(rows) == 11
        np.testing.assert_array_equal(getattr(again, name), rows)
        assert f"\n{name} : (n" in inspect.getdoc(fb.Solution)


def test_histories_of_the_schema_have_rows_between_steps(beating):
    steps = beating(tolerance=1e-3)
    between = beating(tolerance=1e-3, record=fb.Record(times=[0.0, 0.033, 0.07]))
    for name in HISTORIES:
        rows = getattr(between, name)
        assert len(rows) == 3 and rows.shape[1:] == getattr(steps, name).shape[1:]


@pytest.mark.parametrize("kind", ["rates", "forces"])
def test_a_record_without_a_kind_has_no_rows_of_it(beating, kind):
    solution = beating(dt=0.01, record=fb.Record(**{kind: False}))
    for name, history in HISTORIES.items():
        assert len(getattr(solution, name)) == (0 if history.record == kind else 11)
