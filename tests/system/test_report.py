"""Reports: JSON that every reader understands, tables that line up, the machine they ran on."""

import csv
import json

import numpy as np

from fx_beam_studies import reporting


def strict(path):
    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(path.read_text(), parse_constant=refuse)


def test_arrays_and_numbers_come_back_as_they_were_from_strict_json(tmp_path):
    numbers = {"array": np.eye(2), "one": np.float64(0.1), "count": np.int64(3), 8: (True, None)}
    numbers |= {"x": [np.nan, np.inf, -np.inf], "y": np.array([np.inf])}
    reporting.write_json(tmp_path / "new" / "directory" / "reporting.json", numbers)
    expected = {"array": [[1, 0], [0, 1]], "one": 0.1, "count": 3, "8": [True, None]}
    expected |= {"x": [None, "inf", "-inf"], "y": ["inf"]}
    assert strict(tmp_path / "new" / "directory" / "reporting.json") == expected


def test_a_table_is_markdown_whose_columns_line_up():
    rows = [
        {"scheme": "EnergyMomentum", "drift": 1.234e-13, "elements": 8},
        {"scheme": "Newmark", "drift": None, "elements": 128},
    ]
    lines = reporting.table(rows).splitlines()
    assert len({len(line) for line in lines}) == 1
    places = [[i for i, c in enumerate(line) if c == "|"] for line in lines]
    assert places == [places[0]] * 4
    assert [cell.strip() for cell in lines[3].split("|")] == ["", "Newmark", "", "128", ""]
    assert "| 1.23e-13 |" in lines[2]


def test_csv_has_a_column_for_every_nested_number(tmp_path):
    rows = [
        {"scheme": "A", "mesh": {"elements": 8}, "errors": {"tip": 0.1}},
        {"scheme": "B, damped", "mesh": {"elements": 4}, "quartiles": (1.0, np.nan)},
    ]
    reporting.write_csv(tmp_path / "new" / "runs.csv", rows)
    text = (tmp_path / "new" / "runs.csv").read_text()
    first, second = csv.DictReader(text.splitlines())
    assert list(first) == ["scheme", "mesh.elements", "errors.tip", "quartiles.0", "quartiles.1"]
    assert list(first.values()) == ["A", "8", "0.1", "", ""]
    assert list(second.values()) == ["B, damped", "4", "", "1.0", ""]


def test_the_machine_and_all_versions_are_stated():
    machine = reporting.machine()
    assert machine["numpy"] == np.__version__
    assert {"processor", "system", "cores", "python", "FFCx", "numpy", "fx_beam"} <= set(machine)
    assert machine["cores"] >= 1 and all(machine.values())
