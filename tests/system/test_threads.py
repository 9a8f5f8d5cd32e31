"""Threads of large scenes: they change no number, and a process has them where they help."""

import subprocess
import sys
import threading

import numpy as np
import pytest

import fx_beam as fb
from fx_beam.equilibria.path_equations import SmallMotions
from fx_beam.step import tangent_storage
from fx_beam.step.program import PROGRAMS
from fx_beam.step.tables import ProblemInC

SIDE = 24
# Run first with threads, then in a fork, which has none of them.
FORKED = """
import os, sys
import test_threads
from fx_beam.step import tangent_storage
tangent_storage.LARGE = 100
before = test_threads.moved().tobytes()
child = os.fork()
if not child:
    os._exit(test_threads.moved().tobytes() != before)
sys.exit(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]))
"""


def lattice(EI=10.0):
    """A square of struts with hinged ends at one side, which falls from a wall."""
    section = fb.Section(EA=1e4, GA=1e4, EI=EI, rhoA=1.0, rhoI=0.1)
    number = np.arange((SIDE + 1) ** 2).reshape(SIDE + 1, SIDE + 1)
    pairs = (number[:, :-1], number[:, 1:]), (number[:-1], number[1:])
    cells = np.concatenate([np.stack([a.ravel(), b.ravel()], 1) for a, b in pairs])
    scene = fb.Scene(gravity=(0, -9.81))
    struts = scene.add_mesh(np.argwhere(number >= 0), cells, section)
    for node in struts.nodes[: SIDE + 1]:
        scene.pin(node)
    return scene


def moved():
    """The last row of a motion, of which the energy is conserved."""
    motion = fb.simulate(lattice(), dt=5e-3, t_end=0.1)
    assert "kept over several steps" in motion.stats.solver
    assert abs(motion.energy.balance_error).max() <= 1e-12 * motion.energy.kinetic.max()
    return motion.q[-1]


def bent():
    return fb.static(lattice(), load_steps=3).q[-1]


@pytest.fixture
def large(monkeypatch):
    """Scenes of these tests are large ones, each of which is set up anew."""
    monkeypatch.setattr(PROGRAMS, "size", 0)
    PROGRAMS.clear()
    monkeypatch.setattr(tangent_storage, "LARGE", 100)
    monkeypatch.setenv("FX_BEAM_THREADS", "2")


@pytest.mark.parametrize("run", [moved, bent])
def test_any_number_of_threads_gives_the_same_digits(run, large, monkeypatch):
    ends = set()
    for number in ("1", "2", "4", "2"):
        monkeypatch.setenv("FX_BEAM_THREADS", number)
        ends.add(run().tobytes())
    assert len(ends) == 1


@pytest.mark.parametrize("run", [moved, bent])
def test_large_scenes_move_as_small_ones(run, large, monkeypatch):
    shared = run()
    monkeypatch.setattr(tangent_storage, "LARGE", 10**9)
    alone = run()
    assert abs(shared - alone).max() <= 1e-8 * abs(alone).max()


@pytest.fixture
def problems(monkeypatch):
    """The problems of C that are set up."""
    noted, begin = [], ProblemInC.__init__

    def begun(self, *arguments):
        begin(self, *arguments)
        noted.append(self)

    monkeypatch.setattr(ProblemInC, "__init__", begun)
    in_block = ProblemInC.in_block

    def begun_in_block(self, *arguments):
        noted.append(run := in_block(self, *arguments))
        return run

    monkeypatch.setattr(ProblemInC, "in_block", begun_in_block)
    return noted


def test_modes_are_counted_by_factors_that_serve_load_steps(large, problems, monkeypatch):
    monkeypatch.setattr(SmallMotions, "growing", None)  # others are not made
    stable = fb.static(lattice(), load_steps=4)
    assert not stable.unstable_modes.any()
    reused = problems[0].c.work.factors.reused
    assert reused.present
    assert reused.all == reused.steps == 0  # they are those of the last tangent


@pytest.mark.parametrize(("EI", "serves"), [(10.0, 1), (1e-7, 0)])
def test_a_narrow_copy_of_factors_serves_where_it_resolves_the_matrix(
    EI, serves, large, problems, monkeypatch
):
    """Where it does not, factors are kept as without a copy."""
    shared = fb.static(lattice(EI), load_steps=1).q[-1]
    monkeypatch.setattr(tangent_storage, "LARGE", 10**9)
    alone = fb.static(lattice(EI), load_steps=1).q[-1]
    narrow, wide = (problem.c.work.factors.reused for problem in problems)
    assert (narrow.narrow, wide.narrow) == (serves, 0)
    assert narrow.made <= 2 * wide.made
    assert abs(shared - alone).max() <= 1e-6 * abs(alone).max()


def test_several_threads_of_python_share_those_of_a_process(large):
    ends = []
    runs = [threading.Thread(target=lambda: ends.append(moved().tobytes())) for _ in range(3)]
    for run in runs:
        run.start()
    for run in runs:
        run.join()
    assert len(ends) == 3
    assert len(set(ends)) == 1


def test_a_fork_starts_threads_of_its_own(large):
    folder = str(__file__).rpartition("/")[0]
    code = f"import sys; sys.path.insert(0, {folder!r})\n{FORKED}"
    assert subprocess.run([sys.executable, "-c", code], timeout=300).returncode == 0


def test_pieces_of_a_colour_have_no_node_in_common():
    from fx_beam.step.tables import in_colours

    ends = np.random.default_rng(1).integers(0, 500, 400)
    nodes = np.stack([ends, ends + 1], axis=1)
    table, size = in_colours(nodes, 8), 8
    assert sorted(table["piece"]) == list(range(50))
    for begin, end in zip(table["colour_start"], table["colour_start"][1:], strict=False):
        pieces = [set(nodes[size * k : size * (k + 1)].ravel()) for k in table["piece"][begin:end]]
        assert len(set.union(*pieces)) == sum(map(len, pieces))


def test_processes_of_mpirun_have_one_thread_each(monkeypatch):
    monkeypatch.delenv("FX_BEAM_THREADS", raising=False)
    monkeypatch.setattr(tangent_storage, "under_mpirun", lambda: True)
    assert tangent_storage.thread_count() == 1


@pytest.mark.parametrize("count", ["0", "two", "-1", "100"])
def test_a_wrong_number_of_threads_is_refused(count, large, monkeypatch):
    monkeypatch.setenv("FX_BEAM_THREADS", count)
    with pytest.raises(fb.SceneError, match="must be a number of threads"):
        moved()
