"""One scene on several processes: what it gives is what one process gives, and all end."""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import process_cases
import pytest
from process_cases import CASES

import fx_beam as fb
from fx_beam.motions import surroundings

HERE = Path(__file__).parents[1]
# A deadlock is an error, a slow machine is none [s].
LIMIT = 600


#: Small scenes are divided among the processes only here.
DIVIDED = "from fx_beam.motions import surroundings; surroundings.SMALLEST = 0\n"


def started(folder, number, text):
    """A script on several processes, in a group of its own as by a terminal."""
    if not shutil.which("mpirun"):
        pytest.skip("no mpirun")
    (folder / "script.py").write_text(DIVIDED + text)
    # ./run lets a single process have less of Open MPI than several need.
    known = {name: value for name, value in os.environ.items() if not name.startswith("OMPI_")}
    known["PYTHONPATH"] = os.pathsep.join([str(HERE.parent), str(HERE)])
    own = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    own |= {"OMPI_MCA_mpi_yield_when_idle": "1", "OMP_NUM_THREADS": "1"}
    # By itself mpirun kills a second after its signal: too short to save while others compile.
    own |= {f"{of}_MCA_odls_base_sigkill_timeout": "3" for of in ("OMPI", "PRTE")}
    command = [*process_cases.mpirun(number), sys.executable]
    return subprocess.Popen(
        [*command, "-m", "fx_beam", "script.py"],
        cwd=folder,
        env=known | own,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        start_new_session=True,
    )


def said(process):
    """What it writes to its end, within the time limit."""
    try:
        return process.communicate(timeout=LIMIT)[0]
    finally:
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)


def finished(folder, number, text, code=0):
    """What a script on several processes has written, once it ended with a code."""
    process = started(folder, number, text)
    text = said(process)
    assert process.returncode == code, text
    return text


def test_a_small_scene_is_computed_by_the_first_process_alone(monkeypatch):
    others = SimpleNamespace(size=4)
    monkeypatch.setattr("fx_beam.parallel.process_group.ProcessGroup.leading", others)
    scene = process_cases.loaded(lambda t: (0.0, 1.0))
    assert surroundings.waiting_team(scene) is None
    monkeypatch.setattr(surroundings, "SMALLEST", 2)
    assert surroundings.waiting_team(scene) is others


# -- What three processes give ---------------------------------------------------------------

#: What a solution has over time beside its energies and resultants.
HISTORIES = ["t", "t_level", "q", "v", "a", "reactions", "joint_forces", "motor_forces"]
HISTORIES += ["contact_forces", "slides"]

THREE = """
import json, math
import numpy as np
import fx_beam as fb
import process_cases as cases

size = 3.0

def falling(n):
    return falling(n - 1) if n else 1.0

def root(x):
    return size * math.sqrt(x) * falling(3)

def made(power):
    def curvature(f, t, more=0.1):
        return t * (root(f) ** power + more + np.sum([1.0 for i in range(int(size))]))
    return curvature

fb.simulate(cases.curved(made(2)), dt=0.01, t_end=0.02).save("own functions.npz")
for name, case in cases.CASES.items():
    case().save(name + ".npz")
for name in cases.WRITTEN:
    cases.CASES[name](record=fb.Record(file=name + ".pvd"))
said = {}
for what, scene in cases.refused().items():
    try:
        fb.simulate(scene, dt=0.01, t_end=0.1)
    except fb.SceneError as error:
        said[what] = str(error)
with open("refused", "a") as file:
    print(json.dumps(said), file=file)
"""


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    """The folder in which three processes have run."""
    folder = tmp_path_factory.mktemp("three")
    finished(folder, 3, THREE)
    return folder


def scale(values):
    return abs(values).max() or 1.0


def differences(shared, alone):
    """Largest differences of all that two solutions have, relative to the second one."""

    def arrays(solution):
        yield from ((name, getattr(solution, name)) for name in HISTORIES)
        yield from vars(solution.energy).items()
        for name in alone.beams:
            yield from ((f"{n} of {name}", getattr(solution.resultants(name), n)) for n in "NQM")

    ours = dict(arrays(shared))
    pairs = ((name, ours[name], of) for name, of in arrays(alone) if np.size(of))
    return {name: abs(one - of).max() / scale(of) for name, one, of in pairs}


@pytest.mark.parametrize("name", sorted(set(CASES) - {"flung with a tolerance"}))
def test_three_processes_give_what_one_gives(three, name):
    shared, alone = fb.load(three / f"{name}.npz"), CASES[name]()
    kind = "MUMPS" if shared.stats.static else "Schwarz"
    assert shared.stats.solver == f"PETSc on 3 processes, {kind}"
    assert shared.stats.krylov_iterations >= shared.stats.newton_iterations
    if name not in ("bent", "yielding"):  # where round-off decides what yields in an iteration
        assert shared.stats.newton_iterations == alone.stats.newton_iterations
    found = differences(shared, alone)
    assert found.pop("q") < 1e-10
    assert max(found.values()) < 1e-7, found
    gain = shared.energy.balance_error - alone.energy.balance_error
    assert abs(gain).max() < 1e-10 * scale(alone.energy.total)


def test_steps_that_a_tolerance_chooses_are_the_same(three):
    name = "flung with a tolerance"
    shared, alone = fb.load(three / f"{name}.npz"), CASES[name]()
    assert abs(shared.q[-1] - alone.q[-1]).max() < 1e-4
    assert abs(len(shared.t) - len(alone.t)) < 3


def test_functions_of_a_script_arrive_with_what_they_refer_to(three):
    shared = fb.load(three / "own functions.npz")
    scene = process_cases.curved(lambda f, t: t * (9 * f + 3.1))
    alone = fb.simulate(scene, dt=0.01, t_end=0.02)
    assert abs(shared.q[-1] - alone.q[-1]).max() < 1e-10 * abs(alone.q[-1]).max()


@pytest.mark.plot
@pytest.mark.parametrize("name", process_cases.WRITTEN)
def test_each_process_writes_its_members_and_together_they_are_the_whole(three, name, tmp_path):
    check_pieces(three / f"{name}.pvd", CASES[name](), 3, tmp_path)


def test_what_several_processes_cannot_do_is_refused_and_one_can(three):
    (line,) = (three / "refused").read_text().splitlines()
    refused = json.loads(line)
    assert [*refused] == [*process_cases.refused()]
    for what, sentence in refused.items():
        assert what in sentence and "without mpirun" in sentence


def test_a_motion_goes_on_from_several_processes_to_one(three):
    first = fb.load(three / "jointed.npz")
    scene = process_cases.jointed()
    again = fb.simulate(scene, dt=0.01, t_end=first.t[-1] + 0.05, start=first)
    whole = fb.simulate(scene, dt=0.01, t_end=first.t[-1] + 0.05)
    assert abs(again.q[-1] - whole.q[-1]).max() < 1e-10
    assert again.stats.newton_iterations + first.stats.newton_iterations == (
        whole.stats.newton_iterations
    )


def check_pieces(file, alone, number, folder):
    """Check that the grids of processes have each element once, and the fields of one process."""
    pv = pytest.importorskip("pyvista")
    alone.to_paraview(folder / "alone.pvd")
    shared, whole = (pv.get_reader(str(path)) for path in (file, folder / "alone.pvd"))
    np.testing.assert_allclose(shared.time_values, whole.time_values, rtol=1e-12)
    pieces = [pv.read(file.with_suffix("") / f"{file.stem}_00001_{i}.vtu") for i in range(number)]
    assert min(piece.n_cells for piece in pieces) > 0
    assert sum(piece.n_cells for piece in pieces) == sum(b.elements for b in alone.beams.values())
    for t in shared.time_values:
        grids = []
        for reader in (shared, whole):
            reader.set_active_time_value(t)
            grid = reader.read().combine()
            middles = grid.points.reshape(grid.n_cells, -1, 3).mean(axis=1)
            order = np.lexsort((*middles.T.round(9), grid.cell_data["beam"]))
            order = np.arange(grid.n_points).reshape(grid.n_cells, -1)[order].ravel()
            grids.append((grid, order))
        assert {*grids[0][0].point_data.keys()} == {*grids[1][0].point_data.keys()}
        for name in grids[1][0].point_data:
            one, other = (grid[name][order] for grid, order in grids)
            assert abs(one - other).max() < 1e-7 * scale(other), name
        one, other = (grid.points[order] for grid, order in grids)
        # Under mpirun sums in curves lie elsewhere in memory: their last digits differ.
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-14 * scale(other))


# -- How two processes end -------------------------------------------------------------------

TWO = """
import os, signal, sys
import fx_beam as fb
import process_cases as cases
from mpi4py import MPI

def stiffness(fraction):
    return 1e5 if MPI.COMM_WORLD.rank == 0 else 1 / 0

def fail():
    raise ValueError("no such load")

def interrupt():
    os.kill(os.getpid(), signal.SIGINT)

def told(scene, **options):
    try:
        fb.simulate(scene, dt=0.01, t_end=0.1, **options)
    except fb.StepError as error:
        print("failed after", round(error.solution.t[-1], 9), error.failure.kind, flush=True)
    except fb.SceneError as error:
        print("refused:", error, *error.__notes__, flush=True)

told(cases.loaded(cases.Stops(0.055, fail)))
told(cases.frame(section=fb.Section(EA=stiffness, GA=1e5, EI=50.0, rhoA=1.0, rhoI=1e-3))[0])
told(cases.flung(spin=300.0), max_halvings=0)
scene = cases.loaded(cases.Stops(0.055, interrupt))
try:
    fb.simulate(scene, dt=0.01, t_end=0.1)
except KeyboardInterrupt as stop:
    first = stop.solution
    print("interrupted after", round(first.t[-1], 9), flush=True)
fb.simulate(scene, dt=0.01, t_end=0.1, start=first).save("continued.npz")
second = fb.simulate(scene, dt=0.01, t_end=0.1, start=fb.load("half.npz"))
second.save("second.npz")
fb.simulate(scene, dt=0.01, t_end=0.1, start=first, record=fb.Record(file="rest.pvd"))
sys.exit("the end")
"""


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    """The folder in which two processes have run, and what they said."""
    folder = tmp_path_factory.mktemp("two")
    scene = process_cases.loaded(lambda t: (0.0, 1.0))
    fb.simulate(scene, dt=0.01, t_end=0.05).save(folder / "half.npz")
    return folder, finished(folder, 2, TWO, code=1)


@pytest.mark.parametrize(
    "words",
    [
        "failed after 0.05 function",  # a load, on one of them
        "EA at the fraction",  # on another, said on the first
        "division by zero') fx_beam: on process 1 of 2",
        "failed after 0.0 large rotation",
    ],
)
def test_a_failure_on_any_ends_all_is_said_and_keeps_the_steps(two, words):
    assert words in two[1]


def test_ctrl_c_keeps_the_steps_and_another_run_goes_on(two):
    folder, text = two
    assert "interrupted after 0.05" in text
    whole = fb.simulate(process_cases.loaded(lambda t: (0.0, 1.0)), dt=0.01, t_end=0.1)
    for name in ("continued", "second"):
        solution = fb.load(folder / f"{name}.npz")
        assert abs(solution.q[-1] - whole.q[-1]).max() < 1e-10


def test_the_script_runs_once_and_its_exit_ends_all(two):
    assert two[1].count("the end") == 1


# -- The end from outside --------------------------------------------------------------------

LONG = """
import fx_beam as fb
import process_cases as cases
from fx_beam.motions import run

load = cases.Stops(0.02, lambda: print("running", flush=True))
run._BLOCK = 1000  # rows go to files after six steps
record = fb.Record(file="rows.pvd") if {files} else None
try:
    fb.simulate(cases.loaded(load), dt=1e-3, t_end=1e3, record=record)
except KeyboardInterrupt as stop:
    stop.solution.save("kept.npz")
"""


def running(folder, files=False):
    """Two processes that take steps."""
    process = started(folder, 2, LONG.format(files=files))
    for line in process.stdout:
        if "running" in line:
            return process
    raise AssertionError("no step was taken")


def gives_time(killed=False):
    """Whether mpirun sends a signal before it kills: Open MPI 6.0 does not.

    Nor does MPICH once a process was killed.
    """
    version = subprocess.run(["mpirun", "--version"], capture_output=True, text=True).stdout
    return "(Open MPI) 6." not in version and ("Open MPI" in version or not killed)


def kept(folder):
    """What the first process saves, which mpirun does not wait for."""
    end = time.monotonic() + LIMIT
    while not (folder / "kept.npz").exists() and time.monotonic() < end:
        time.sleep(0.1)
    return fb.load(folder / "kept.npz")


def test_ctrl_c_at_mpirun_ends_all_and_keeps_the_steps(tmp_path):
    process = running(tmp_path)
    process.send_signal(signal.SIGINT)
    said(process)
    if gives_time():
        assert kept(tmp_path).t[-1] > 0.019


def ranks(process):
    """The processes of Python below mpirun; MPICH has another process in between."""
    tasks = Path(f"/proc/{process}/task").glob("*/children")
    for child in [int(child) for task in tasks for child in task.read_text().split()]:
        name = Path(f"/proc/{child}/comm").read_text().strip()
        yield from [child] if name == Path(sys.executable).name[:15] else ranks(child)


@pytest.mark.parametrize("rank", [0, 1])
def test_a_process_that_is_killed_ends_all_and_the_first_keeps_the_steps(tmp_path, rank):
    process = running(tmp_path, files=rank == 0)
    os.kill(sorted(ranks(process.pid))[rank], signal.SIGKILL)
    assert "signal 9" in " ".join(said(process).split())
    assert process.returncode != 0
    if rank == 0:
        end, rows = fb.load(tmp_path / "rows" / "end.npz"), (tmp_path / "rows.pvd").read_text()
        assert rows.count("DataSet") > 12 and end.t[-1] > 0.0
    elif gives_time(killed=True):
        assert kept(tmp_path).t[-1] > 0.019


ALONE = """
import fx_beam as fb
import process_cases as cases
from fx_beam.parallel import process_group

def fails(rank):
    from mpi4py import MPI
    from fx_beam.parallel.linear_system import LinearSystem
    def solve(*arguments):
        raise MemoryError(f"no memory on {{rank}}")
    if MPI.COMM_WORLD.rank == rank:
        LinearSystem.solve = solve

process_group._ALONE = 1.0
crews = []

def now():
    crews.append(process_group.ProcessGroup.leading.make(fails, [({rank},)] * 2))

try:
    fb.simulate(cases.loaded(cases.Stops(0.055, now)), dt=0.01, t_end=0.1)
except MemoryError as error:
    print(error, "after", round(error.solution.t[-1], 9), flush=True)
    error.solution.save("kept.npz")
    raise
"""


@pytest.mark.parametrize("rank", [0, 1])
def test_an_error_of_one_process_while_others_wait_for_it_ends_all(tmp_path, rank):
    process = started(tmp_path, 2, ALONE.format(rank=rank))
    text = said(process)
    assert f"no memory on {rank} after 0.05" in text
    assert process.returncode != 0
    assert fb.load(tmp_path / "kept.npz").t[-1] == pytest.approx(0.05)


# -- Options of PETSc ------------------------------------------------------------------------


def test_petsc_options_choose_another_solver(tmp_path, monkeypatch):
    monkeypatch.setenv("PETSC_OPTIONS", "-fx_beam_pc_type redundant")
    script = 'from process_cases import CASES; CASES["equilibrium"]().save("equilibrium.npz")'
    finished(tmp_path, 2, script)
    shared, alone = fb.load(tmp_path / "equilibrium.npz"), CASES["equilibrium"]()
    assert shared.stats.solver == "PETSc on 2 processes, redundant"
    assert shared.stats.newton_iterations == alone.stats.newton_iterations
    assert differences(shared, alone)["q"] < 1e-10
