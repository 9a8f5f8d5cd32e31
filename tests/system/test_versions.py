"""What differs between versions of FEniCSx, or may be missing, and would go wrong silently."""

import os
import shutil
import subprocess
import sys

import ufl

import numpy as np
import pytest
from plain_step import assert_balanced
from scenes import pinned_beam

import fx_beam as fb
from fx_beam import c_library
from fx_beam.fem import elements, ffcx_api
from fx_beam.fem.assembly import Field, Term
from fx_beam.fem.form_library import form_module
from fx_beam.fem.mesh import Mesh
from fx_beam.laws.interval import StepBatch
from fx_beam.motions import set_ups
from fx_beam.scene.beam import gauss_rule
from fx_beam.step import build
from fx_beam.symbolic import Written

# -- Quadrature ----------------------------------------------------------------------------------


ON = elements.domain(1)
X = ufl.SpatialCoordinate(ON)[0]
STILL = StepBatch.at_rest(np.zeros(0))


def row(cells, length=1.0):
    """Cells of a length one behind the other."""
    ends = np.arange(cells)[:, None] + np.arange(2)
    places = np.column_stack([length * np.arange(cells + 1.0), np.zeros(cells + 1)])
    return Mesh(places, ends, [np.arange(cells)], curved=False)


def compiled(form, names):
    (functional,) = form_module(None, lambda: Written({"a functional": form}, names)).forms.values()
    return functional


def integral(form, mesh, data=None):
    names = {symbol: f"field {k}" for k, symbol in enumerate(data or {})}
    fields = {names[symbol]: field for symbol, field in (data or {}).items()}
    return Term(compiled(form, names), mesh, fields).total(STILL)


@pytest.mark.parametrize("points", range(1, 6))
def test_the_rule_of_a_form_is_that_of_gauss(points):
    dx = elements.measure(ON, points)
    computed = [integral(X**power * dx, row(1)) for power in range(2 * points + 1)]
    exact = 1 / (1 + np.arange(2 * points + 1))
    assert computed[:-1] == pytest.approx(exact[:-1], rel=1e-14)
    # n points leave of x^2n, on the unit interval, the square of the monic Legendre polynomial.
    left = 1.0
    for n in range(1, points + 1):
        left *= n / (2 * (2 * n - 1))
    assert exact[-1] - computed[-1] == pytest.approx(left**2 / (2 * points + 1), rel=1e-6)


@pytest.mark.parametrize("points", range(1, 6))
def test_values_at_gauss_points_are_those_that_the_rule_of_a_form_takes(points):
    mesh, symbol, dx = row(1, 3.0), elements.Symbols(ON).data(points), elements.measure(ON, points)
    field = Field(mesh.space(points))
    values = field.array[:] = np.exp(np.arange(points))
    squares = integral(symbol**2 * dx, mesh, {symbol: field})
    weights = np.polynomial.legendre.leggauss(points)[1] * 3.0 / 2
    assert squares == pytest.approx(weights @ values**2, rel=1e-13)
    moment = integral(symbol * X * dx, mesh, {symbol: field})
    places = 3.0 * gauss_rule(points)[0]
    assert moment == pytest.approx(weights @ (values * places), rel=1e-12)


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
    monkeypatch.setattr(set_ups.RECENT, "_waiting", [])
    solution = fb.simulate(pinned_beam()[0], **run)
    assert len(commands) == 4
    assert solution.q == pytest.approx(expected, abs=1e-9 * abs(expected).max())


def test_the_options_of_ffcx_are_its_own_defaults_and_complete():
    try:
        from ffcx.parameters import FFCX_DEFAULT_PARAMETERS as defaults
    except ImportError:
        from ffcx.options import FFCX_DEFAULT_OPTIONS as defaults
    values = {
        name: next(v for v in row if not isinstance(v, type)) for name, row in defaults.items()
    }
    assert {name: ffcx_api._OPTIONS[name] for name in defaults} == values


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


def test_coefficients_of_a_subdomain_are_those_of_its_cells():
    mesh, tags, cell_form = row(3), np.array([2, 0, 1]), elements.Symbols(ON).data(1)
    field, dx = Field(mesh.space(1)), elements.measure(ON, 1)
    field.array[:] = 10.0 + np.arange(3)
    all_tags = sum((tag + 1) * cell_form * dx(tag) for tag in range(3)) + cell_form**2 * dx
    form = Term(compiled(all_tags, {cell_form: "f"}), mesh, {"f": field}, tags=tags)
    assert form.compiled.tags == [-1, 0, 1, 2]
    values = (form.coefficients(cells, STILL)[0] for cells in form.cells)
    packed = dict(zip(form.compiled.tags, values, strict=True))
    assert packed[-1][:, 0] == pytest.approx([10.0, 11.0, 12.0])
    assert [packed[tag][:, 0] for tag in range(3)] == [[11.0], [12.0], [10.0]]
    expected = sum((tags[k] + 1) * (10 + k) + (10 + k) ** 2 for k in range(3))
    assert form.total(STILL) == pytest.approx(expected)


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
