"""The file of a sweep: rows that are damaged are computed again."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np

import fx_beam as fb
from fx_beam.sweeps.sweep import Journal

CASES = [{"x": 0.5 * k} for k in range(3)]


def written(path):
    """Rows of some cases in a new file."""
    path.unlink(missing_ok=True)
    journal = Journal(path)
    rows = [
        journal.append({"case": case, "result": {"y": 1.25 * k}, "seconds": 0.1, "error": ""})
        for k, case in enumerate(CASES)
    ]
    journal.close()
    return rows


def test_a_flipped_bit_changes_no_row_of_a_sweep(tmp_path):
    path = tmp_path / "rows.jsonl"
    rows = written(path)
    whole, random = path.read_bytes(), np.random.default_rng(1)
    lost = 0
    for place in random.permutation(len(whole))[:200]:
        content = bytearray(whole)
        content[place] ^= 1 << int(random.integers(8))
        path.write_bytes(content)
        journal = Journal(path)
        for case, row in zip(CASES, rows, strict=True):
            read = journal.finished(case)
            lost += read is None
            assert read is None or read == row
        journal.close()
    assert 150 < lost < 300


def test_a_damaged_row_is_computed_again_with_a_warning(tmp_path, caplog):
    calls, cases = [], [{"x": 1.5}, {"x": 2.5}]

    def double(case):
        calls.append(case["x"])
        return {"y": 2 * case["x"]}

    def doubled():
        with ThreadPoolExecutor(1) as executor:
            return list(fb.sweep(double, cases, executor, results=path)["y"])

    path = tmp_path / "rows.jsonl"
    assert doubled() == [3.0, 5.0]
    path.write_bytes(path.read_bytes().replace(b'"y": 3.0', b'"y": 7.0'))
    assert doubled() == [3.0, 5.0]
    assert calls == [1.5, 2.5, 1.5] and "damaged" in caplog.text


def test_a_row_whose_checksum_has_another_name_is_computed_again(tmp_path):
    path = tmp_path / "rows.jsonl"
    written(path)
    path.write_bytes(path.read_bytes().replace(b"checksum", b"checksun"))
    journal = Journal(path)
    assert [journal.finished(case) for case in CASES] == [None] * len(CASES)
    journal.close()
