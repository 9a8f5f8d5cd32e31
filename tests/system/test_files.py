"""Files are written as a whole: a failure leaves the earlier one, and nothing beside it."""

import csv
import gc
import os
import resource
import stat
import sys
import zipfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager

import numpy as np
import pytest
from scenes import FLYING, assert_refused, clamped_bar

import fx_beam as fb
from fx_beam.results.export import HISTORIES, replacing
from fx_beam_studies.reporting import write_csv, write_json

EARLIER = b"what was there before"


@contextmanager
def full_disk():
    """No file may become larger than 1 kB."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    writes, sys.dont_write_bytecode = sys.dont_write_bytecode, True  # else of cut modules
    try:
        yield
    finally:
        sys.dont_write_bytecode = writes
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.fixture(scope="module")
def fall():
    scene, arm = clamped_bar((1, 0), FLYING, elements=8, name="arm", gravity=(0.0, -9.81))
    solution = fb.simulate(scene, dt=0.02, t_end=1.0)
    _ = solution.a, solution.resultants(arm)  # on a full disk nothing could be compiled for them
    return solution


NUMBERS = {"numbers": list(range(1000))}
WRITERS = {
    "run.npz": lambda solution, path: solution.save(path),
    "run.csv": lambda solution, path: solution.to_csv(path, {"tip": solution.beams["arm"].end}),
    "run.pvd": lambda solution, path: solution.to_paraview(path),
    "curves.png": lambda solution, path: fb.plot.save(_figure(solution), path),
    "arm.gif": lambda solution, path: fb.plot.animate(solution, path, rows=[0, 9]),
    "study.json": lambda solution, path: write_json(path, NUMBERS),
    "study.csv": lambda solution, path: write_csv(path, [NUMBERS] * 100),
}


def _figure(solution):
    figure, axes = fb.plot.figure(1, 1)
    axes[0, 0].plot(solution.t, solution.q[:, -1])
    return figure


@pytest.mark.plot
@pytest.mark.filterwarnings("ignore:Exception ignored")  # of a ZipFile that cannot be closed
@pytest.mark.parametrize("name", WRITERS)
def test_a_full_disk_leaves_the_earlier_file_and_nothing_else(name, fall, tmp_path):
    file = tmp_path / name
    file.write_bytes(EARLIER)
    with full_disk(), pytest.raises(OSError, match="File too large"):
        WRITERS[name](fall, file)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert file.read_bytes() == EARLIER
    WRITERS[name](fall, file)
    assert file.read_bytes() != EARLIER
    assert {path.name for path in tmp_path.iterdir()} <= {name, file.stem}


def test_links_are_followed_and_permissions_kept(fall, tmp_path):
    file, link = tmp_path / "file.npz", tmp_path / "link.npz"
    file.write_bytes(EARLIER)
    file.chmod(0o640)
    link.symlink_to(file)
    fall.save(link)
    assert link.is_symlink() and stat.S_IMODE(file.stat().st_mode) == 0o640
    np.testing.assert_array_equal(fb.load(file).q, fall.q)
    # A new file has the permissions that files have here.
    fall.save(tmp_path / "new.npz")
    (tmp_path / "plain").touch()
    assert (tmp_path / "new.npz").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_an_interrupt_leaves_the_earlier_file(tmp_path):
    file = tmp_path / "run.txt"
    file.write_bytes(EARLIER)
    with pytest.raises(KeyboardInterrupt), replacing(file) as new:
        new.write_text("half")
        raise KeyboardInterrupt
    assert [path.read_bytes() for path in tmp_path.iterdir()] == [EARLIER]


@pytest.mark.filterwarnings("error::pytest.PytestUnraisableExceptionWarning")
def test_ctrl_c_in_save_is_no_other_error_and_leaves_the_earlier_file(tmp_path, monkeypatch):
    scene = fb.Scene()
    scene.add_body((0, 0), mass=1.0, inertia=1.0)
    solution = fb.simulate(scene, dt=0.1, t_end=0.2)
    (tmp_path / "run.npz").write_bytes(b"earlier")
    real = zipfile.ZipFile.open

    def interrupted(self, *arguments, **options):
        part = real(self, *arguments, **options)
        if arguments[0] == "q.npy":
            raise KeyboardInterrupt  # before the part is known outside
        return part

    with monkeypatch.context() as patched:
        patched.setattr(zipfile.ZipFile, "open", interrupted)
        with pytest.raises(KeyboardInterrupt):
            solution.save(tmp_path / "run.npz")
    gc.collect()  # what complains while it is collected fails the test
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"earlier"]


def rows(case):
    return {"text": "x" * 350}


def test_a_sweep_on_a_full_disk_hands_over_its_rows_and_goes_on(tmp_path):
    cases = [{"k": k} for k in range(5)]
    with full_disk(), pytest.raises(OSError, match="File too large") as stop:
        fb.sweep(rows, cases, executor=ThreadPoolExecutor(1), results=tmp_path / "rows")
    assert len(stop.value.rows) == 2
    table = fb.sweep(rows, cases, executor=ThreadPoolExecutor(1), results=tmp_path / "rows")
    assert len(table) == 5


# -- Damaged files ---------------------------------------------------------------------------------


def test_a_damaged_file_is_refused_by_its_name_or_holds_all_that_was_saved(fall, tmp_path):
    fall.save(tmp_path / "run.npz")
    whole, damaged = (tmp_path / "run.npz").read_bytes(), tmp_path / "damaged.npz"
    random = np.random.default_rng(1)
    refused = 0
    for k in range(400):
        place = int(random.integers(len(whole)))
        content = bytearray(whole)
        if k % 4:
            content[place] ^= 1 << int(random.integers(8))
        damaged.write_bytes(content if k % 4 else content[:place])
        try:
            computed = fb.load(damaged)
        except ValueError as error:
            assert str(error) == f"{damaged} is not a solution saved by fx_beam"
            refused += 1
        else:  # bits of zip that no one reads, such as dates
            for name in HISTORIES:
                np.testing.assert_array_equal(getattr(computed, name), getattr(fall, name))
    assert refused > 300


def test_the_heads_of_arrays_are_checked_as_well(fall, tmp_path):
    # NumPy would take spaces of a head for numbers, and stop before the sum of the file.
    fall.save(tmp_path / "run.npz")
    with zipfile.ZipFile(tmp_path / "run.npz") as saved:
        parts = {name: saved.read(name) for name in saved.namelist()}
    with zipfile.ZipFile(tmp_path / "stored.npz", "w") as stored:
        for name, content in parts.items():
            stored.writestr(name, content)
    whole, damaged = (tmp_path / "stored.npz").read_bytes(), tmp_path / "damaged.npz"
    assert fb.load(tmp_path / "stored.npz").t[-1] == fall.t[-1]
    length = whole.index(parts["v.npy"]) + 8
    for bit in range(8):
        content = bytearray(whole)
        content[length] ^= 1 << bit
        damaged.write_bytes(content)
        assert_refused("is not a solution saved by fx_beam", fb.load, damaged, error=ValueError)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("q", lambda q: q[:-1]),
        ("q", lambda q: np.full_like(q, np.nan)),
        ("X", lambda X: np.hstack([X, X])),
        ("v", lambda v: v[..., :2]),
        ("t", lambda t: t.astype(str)),
        ("energy_work", lambda work: work[:-1]),
        ("beams_nodes", lambda nodes: nodes + 1),
        ("beams_nodes", lambda nodes: nodes - 1),
        ("beams_nodes", lambda nodes: nodes[:-1]),
        ("resultants_M", lambda M: M.T),
        ("end_q", lambda q: q[:2]),
        ("meta", lambda text: np.array("[" * 100_000)),
    ],
)
def test_arrays_that_do_not_fit_together_are_refused(name, change, fall, tmp_path):
    fall.save(tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz") as file:
        arrays = dict(file)
    arrays[name] = change(arrays[name])
    np.savez(tmp_path / "other.npz", **arrays)
    with pytest.raises(ValueError, match="other.npz is not a solution saved by fx_beam"):
        fb.load(tmp_path / "other.npz")


def test_files_of_the_first_version_with_a_count_that_is_gone_are_read(fall, tmp_path):
    fall.save(tmp_path / "run.npz")
    with np.load(tmp_path / "run.npz") as file:
        arrays = dict(file)
    text = str(arrays["meta"])
    earlier = text.replace('"halvings"', '"krylov_iterations": 7, "halvings"', 1)
    assert earlier != text
    np.savez(tmp_path / "earlier.npz", **arrays | {"meta": np.array(earlier)})
    stats = fb.load(tmp_path / "earlier.npz").stats
    assert stats.halvings == fall.stats.halvings and not hasattr(stats, "krylov_iterations")


@pytest.mark.parametrize("path", [1, True, None, b"run.npz", ""])
def test_what_is_no_path_is_refused_before_it_is_opened(path):
    assert_refused("path = .* must be the name of a file", fb.load, path, error=ValueError)
    assert os.fstat(1)  # an open file's number would have been closed


def test_names_and_texts_in_tables_are_no_formulas(fall, tmp_path):
    names = [f"{sign}cmd|'/c calc'!A1" for sign in "=+-@\t\r"]
    fall.to_csv(tmp_path / "run.csv", dict.fromkeys(names, fall.beams["arm"].end))
    write_csv(tmp_path / "study.csv", [{names[0]: names[1], "limit": -np.inf, "x": "-1.5"}])
    cells = []
    for file in ("run.csv", "study.csv"):
        with open(tmp_path / file, newline="", encoding="utf-8") as opened:
            cells += [cell for row in csv.reader(opened) for cell in row]
    assert sum("cmd" in cell for cell in cells) > 2 * len(names)
    for cell in cells:
        if cell.startswith(tuple("=+-@\t\r")):
            float(cell)
    assert {"-inf", "-1.5", f"'{names[0]}", f"'{names[1]}"} <= {*cells}
