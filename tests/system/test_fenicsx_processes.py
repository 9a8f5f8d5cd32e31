"""A problem of dolfinx on the processes of mpirun gives the numbers of one process."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from mpirun import mpirun

pytest.importorskip("dolfinx")

HERE = Path(__file__).parents[1]
SCRIPT = """
import numpy as np, fx_beam as fb
from mpi4py import MPI
from fx_beam import fenicsx
from registry import ONES, SCENES

comm, worst = MPI.COMM_WORLD, 0.0
for name in ("pinned beam", "prismatic with laws", "closed loop", "curved tapered beam"):
    case = SCENES[name]
    problem = fenicsx.Problem(case.build(ONES), dt=case.dt, comm=comm)
    here = problem.run(5 * case.dt)
    engine = fb.simulate(case.build(ONES), dt=case.dt, t_end=5 * case.dt)
    moved = abs(engine.q - engine.q[0]).max()
    worst = max(worst, abs(here.q - engine.q).max() / moved)
    energy = problem.energies()["strain"] - engine.energy.strain[-1]
    worst = max(worst, abs(energy) / engine.energy.kinetic.max())
    forces = engine.resultants(engine.beams[next(iter(engine.beams))])
    N = problem.at_points(problem.resultants)[..., 0].ravel()[: len(forces.N[-1])]
    worst = max(worst, abs(N - forces.N[-1]).max() / 1e4)
cells = comm.allreduce(problem.mesh.topology.index_map(1).size_local)
assert cells == 2, cells
scene = fb.Scene(gravity=(0, -9.81))
arm = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0), 6)
scene.clamp(arm.start)
at_rest = fenicsx.Equilibrium(scene, comm=comm)
state = fb.static(scene, load_steps=4)
worst = max(worst, abs(at_rest.run(load_steps=4).q - state.q).max())
print(f"process {comm.rank} of {comm.size}: {comm.allreduce(worst, MPI.MAX):.1e}")
assert worst < 1e-10
"""


@pytest.mark.slow
def test_steps_on_three_processes_are_those_of_one(tmp_path):
    """Some of which have no part of a small scene."""
    number = 3
    if not shutil.which("mpirun"):
        pytest.skip("no mpirun")
    (tmp_path / "script.py").write_text(SCRIPT)
    # ./run lets a single process have less of Open MPI than several need.
    known = {name: value for name, value in os.environ.items() if not name.startswith("OMPI_")}
    known["PYTHONPATH"] = os.pathsep.join(map(str, (HERE.parent, HERE, HERE / "core")))
    own = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    own |= {"OMPI_MCA_mpi_yield_when_idle": "1", "OMP_NUM_THREADS": "1"}
    command = [*mpirun(number), sys.executable, "script.py"]
    done = subprocess.run(
        command, cwd=tmp_path, env=known | own, capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stdout.count(f"of {number}: ") == number
