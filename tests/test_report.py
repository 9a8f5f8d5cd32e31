"""Reports: JSON that every reader understands, tables that line up, the machine they ran on."""

import json

import numpy as np
import pytest

from fx_beam.studies import reporting


def strict(path):
    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


def test_arrays_and_numpy_numbers_come_back_as_they_were(tmp_path):
    numbers = {"array": np.eye(2), "one": np.float64(0.1), "count": np.int64(3), 8: (True, None)}
    reporting.write_json(tmp_path / "new" / "directory" / "reporting.json", numbers)
    found = strict(tmp_path / "new" / "directory" / "reporting.json")
    assert found == {"array": [[1, 0], [0, 1]], "one": 0.1, "count": 3, "8": [True, None]}


def test_nan_and_infinity_are_written_as_strict_json(tmp_path):
    reporting.write_json(
        tmp_path / "r.json", {"x": [np.nan, np.inf, -np.inf], "y": np.array([np.inf])}
    )
    assert strict(tmp_path / "r.json") == {"x": [None, "inf", "-inf"], "y": ["inf"]}


def test_what_is_no_number_is_refused(tmp_path):
    with pytest.raises(TypeError):
        reporting.write_json(tmp_path / "r.json", {"scheme": object()})


def test_a_table_is_markdown_whose_columns_line_up():
    rows = [("EnergyMomentum", "1e-13", 8), ("Newmark", None, 128)]
    lines = reporting.table(["scheme", "drift", "elements"], rows).splitlines()
    assert len({len(line) for line in lines}) == 1
    places = [[i for i, c in enumerate(line) if c == "|"] for line in lines]
    assert places == [places[0]] * 4
    assert [cell.strip() for cell in lines[3].split("|")] == ["", "Newmark", "", "128", ""]


def test_columns_of_numbers_stand_to_the_right():
    rule = reporting.table(["name", "value"], [("a", "1.5e-3"), ("b", 10)]).splitlines()[1]
    left, right = rule.strip("|").split("|")
    assert ":" not in left and right.strip().endswith("-:")


def test_a_bar_in_a_cell_does_not_end_it():
    header, _, row = reporting.table(["|E|"], [("|N|",)]).splitlines()
    assert (header, row) == ("| \\|E\\| |", "| \\|N\\| |")


def test_a_row_that_is_too_short_is_refused():
    with pytest.raises(ValueError):
        reporting.table(["a", "b"], [("1",)])


def test_the_machine_and_all_versions_are_stated():
    found = reporting.machine()
    assert found["numpy"] == np.__version__
    assert {"processor", "cores", "python", "dolfinx", "petsc", "fx_beam"} <= set(found)
    assert found["cores"] >= 1 and all(found.values())
