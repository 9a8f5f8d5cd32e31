"""What differs between versions of FEniCSx, or may be missing, and would go wrong silently."""

import os
import shutil
import subprocess
import sys

import ufl

import pytest
from plain_step import assert_balanced
from scenes import pinned_beam

import fx_beam as fb
from fx_beam import c_library
from fx_beam.fem import ffcx_api
from fx_beam.step import build, program

# -- What the compiled loop takes ------------------------------------------------------------------


def softening(stiffness):
    def energy(eps, gamma, kappa):
        stretch = stiffness * (ufl.sqrt(1 + eps**2) - 1)
        return stretch + 0.5 * (4e3 * gamma**2 + 20.0 * kappa**2)

    return energy


def beams_of_many_laws(laws=4):
    """A chain of beams with stored energies of their own, in a wind that follows the motion."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    first = end = scene.add_beam(
        [(0, 0), (1, 0)], fb.Section(EA=5e3, GA=5e3, EI=20.0, rhoA=1.0), elements=1
    )
    for number in range(1, laws):
        section = fb.Section(strain_energy=softening(3e3 * number), rhoA=0.5 * number, rhoI=0.01)
        # Not in the order of their cells, and of several sizes.
        points = [end.end, (1 + number, 0.1 * number)]
        end = scene.add_beam(points, section, elements=1 + number % 3)
    scene.pin(first.start)
    wind = ufl.as_vector((3.0, 1.0))
    scene.add_virtual_work(
        lambda step: (1 + step.u[0]) * ufl.dot(wind, step.virtual_u) + step.t * step.virtual_psi
    )
    return scene


@pytest.mark.parametrize("laws", [2, 4])
def test_each_law_has_its_own_coefficients_in_the_loop(laws):
    run = {"dt": 0.005, "t_end": 0.2}
    scenes = beams_of_many_laws(laws), beams_of_many_laws(laws)
    compiled = fb.simulate(scenes[0], **run)
    assert abs(compiled.q).max() > 0.1
    assert_balanced(scenes[1], **run, least=1e-7)  # the beams are stiff
    assert abs(compiled.energy.balance_error).max() < 1e-7 * compiled.energy.kinetic.max()


def test_the_loop_runs_here():
    solution = fb.simulate(pinned_beam()[0], dt=0.01, t_end=0.1)
    assert solution.stats.solver == "compiled, chain"


def test_the_compiler_is_that_of_the_environment(monkeypatch, tmp_path, no_libraries):
    said = tmp_path / "said"
    compiler = tmp_path / "other-cc"
    compiler.write_text(f'#!/bin/sh\necho "$1" >>{said}\nshift\nexec cc "$@" -O0\n')
    compiler.chmod(0o755)
    monkeypatch.setenv("CC", f"{compiler} first")
    build.load_library()
    assert said.read_text() == "first\n"


@pytest.mark.skipif(not shutil.which("aarch64-linux-gnu-gcc"), reason="no compiler for aarch64")
def test_all_c_compiles_for_aarch64_as_well(monkeypatch, tmp_path, no_libraries):
    commands, run = [], subprocess.run

    def noted(command, **options):
        commands.append((command, options["input"]))
        return run([*command, "-O0"], **options)

    monkeypatch.setattr(c_library.subprocess, "run", noted)
    assert fb.simulate(pinned_beam()[0], dt=0.01, t_end=0.1).stats.solver == "compiled, chain"
    # The loop; forces with tangents, energies and eq. 4 of several elements.
    assert len(commands) == 4
    for command, source in commands:
        # Options that name a processor are those of this one; the package names one there as well.
        # The lowest level of optimisation warns of all that the others do, in a fourth of the time.
        general = [option for option in command[1:] if not option.startswith("-m")]
        general += ["-mcpu=neoverse-n1", "-O1"]
        general[general.index("-o") + 1] = str(tmp_path / "other.so")
        run(["aarch64-linux-gnu-gcc", "-Werror", *general], check=True, input=source, text=True)


@pytest.mark.skipif(not shutil.which("clang"), reason="no clang")
def test_all_c_compiles_with_clang_as_well(monkeypatch, no_libraries):
    """Without a warning; the steps are those of the other compiler."""
    run = {"dt": 0.01, "t_end": 0.1}
    expected = fb.simulate(pinned_beam()[0], **run).q
    commands, start = [], subprocess.run

    def noted(command, **options):
        commands.append(command)
        return start([*command, "-Werror", "-O1"], **options)

    monkeypatch.setattr(c_library.subprocess, "run", noted)
    monkeypatch.setenv("CC", "clang")
    monkeypatch.setattr(c_library, "_things", {})
    program.PROGRAMS.clear()
    solution = fb.simulate(pinned_beam()[0], **run)
    assert len(commands) == 4
    assert solution.q == pytest.approx(expected, abs=1e-9 * abs(expected).max())


def test_the_options_of_ffcx_are_its_own_defaults_and_complete():
    try:
        from ffcx.parameters import FFCX_DEFAULT_PARAMETERS as defaults
    except ImportError:
        from ffcx.options import FFCX_DEFAULT_OPTIONS as defaults
    values = {n: next(v for v in row if not isinstance(v, type)) for n, row in defaults.items()}
    assert {name: ffcx_api.OPTIONS[name] for name in defaults} == values


# -- Without MPI -----------------------------------------------------------------------------------

ALONE = """
import contextlib, importlib.machinery, io, sys
apart = "dolfinx", "mpi4py", "petsc4py", "slepc4py"
real = importlib.machinery.PathFinder.find_spec
class Finder(importlib.machinery.PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        if name.split(".")[0] in apart:
            return None
        return real(name, path, target)
sys.meta_path[sys.meta_path.index(importlib.machinery.PathFinder)] = Finder

import fx_beam as fb
from scenes import demo, pinned_beam
from shared import script

with contextlib.redirect_stdout(io.StringIO()):
    for name in ("roll_up", "ring"):  # load steps, motions, modes
        script.main(demo(name))
scene = fb.Scene()
beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0), elements=4)
scene.clamp(beam.start)
scene.add_force(beam.end, fb.Input("force", factor=(0, 1)))
path = fb.static(scene, load_steps=2, continuation="arc-length", inputs={"force": 1.0})
fb.frequency_response(scene, (beam.end, (0.0, 1.0)), beam.end, [0.1], path)
fb.linearise(scene, path)
one = fb.NewtonOptions(max_iterations=1)
try:
    fb.simulate(pinned_beam()[0], dt=0.01, t_end=0.1, newton=one, max_halvings=1)
except RuntimeError as error:
    print(error)
assert not [name for name in sys.modules if name.split(".")[0] in apart]
"""


def test_one_process_needs_no_dolfinx_mpi_or_petsc():
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.path[:0] = {sys.path!r}\n{ALONE}"],
        capture_output=True,
        text=True,
        check=False,
        env=os.environ | {"PMI_RANK": "0"},  # as a job of SLURM has it
    )
    assert not done.returncode, done.stderr
    assert "the step from t = 0 to" in done.stdout and "Last corrections" in done.stdout
