"""The compiled loop against the steps in Python, and what may be recorded."""

import logging
import math
import os
import platform
import subprocess
import sys

import ufl

import numpy as np
import pytest
from scenes import FLYING, demo, free_flight, pendulum, pinned_beam, relative_drift

import fx_beam as fb
from fx_beam import c_library
from fx_beam.algebra.lu_layout import COSTS
from fx_beam.compiled import build, handover
from fx_beam.mechanics.rates import MidPointRates

SCHEMES = [
    fb.EnergyMomentum(),
    fb.ModifiedMidPoint(),
    fb.MidPoint(),
    fb.Newmark(),
    fb.HHT(),
    fb.GeneralizedAlpha(0.8),
]


def demo_scene(name):
    made = demo(name).scene()
    return made if isinstance(made, fb.Scene) else made[0]


def frame_with_everything():
    """Loads of all kinds, a driven support, gravity, lumped masses, two materials and drag."""

    def stiffening(eps, gamma, kappa):
        return 5e3 * (eps**2 + gamma**2) + 50 * kappa**2 + 20 * kappa**4

    scene = fb.Scene(gravity=(0.3, -9.81))
    # As many elements as the arm, which has another law.
    post = scene.add_beam([(0, 0), (0, 1)], FLYING, elements=4)
    own = fb.Section(strain_energy=stiffening, rhoA=1.0, rhoI=0.1)
    arm = scene.add_beam([post.end, (0.7, 1.4), (1.5, 1)], own, elements=4)
    scene.prescribe(post.start, x=lambda t: 0.05 * np.sin(6 * t), rotation=lambda t: 0.2 * t**2)
    scene.fix(post.start, "y")
    scene.add_mass(arm.end, 0.5, inertia=0.1)
    scene.add_force(arm.end, lambda t: (3 * np.sin(t), 1.0))
    scene.add_moment(post.end, 2.0)
    scene.add_force(arm.end, lambda t: (0.0, 5 * t), follower=True)
    scene.add_force(post.end, (-1.0, 0.5), follower=True)
    scene.add_line_load(arm, lambda t: (0.0, -2 * t))
    scene.add_virtual_work(lambda step: -0.3 * ufl.dot(step.v, step.virtual_u))
    scene.add_virtual_work(lambda step: -step.t * step.psi * step.virtual_psi, arm)
    return scene


def linkage():
    """Revolute, prismatic and pin in slot, an offset and a motor."""
    scene = fb.Scene(gravity=(0, -9.81))
    crank = scene.add_beam([(0, 0), (0.5, 0)], FLYING, elements=2)
    rod = scene.add_beam([(0.6, 0), (1.6, 0.3)], FLYING, elements=3)
    tail = scene.add_beam([(1.6, 0.3), (2.4, 0.3)], FLYING, elements=2)
    scene.add_joint(fb.Revolute(fb.GROUND, crank.start, motor=lambda t: 1.5 * t**2))
    scene.add_joint(fb.Revolute(crank.end, rod.start, offset=(0.1, 0)))
    scene.add_joint(fb.Prismatic(rod.end, tail.start, axis=(1, 0.2)))
    scene.add_joint(fb.PinInSlot(fb.GROUND, tail.end, axis=(1, 0)))
    return scene


def sprung(viscosity=0.0):
    """Springs and dampers on angles and slides, between nodes and to the ground."""
    scene = fb.Scene(gravity=(0, -9.81))
    crank = scene.add_beam([(0, 0), (0.5, 0)], FLYING, elements=2)
    rod = scene.add_beam([(0.6, 0), (1.6, 0.3)], FLYING, elements=3)
    tail = scene.add_beam([(1.6, 0.3), (2.4, 0.3)], FLYING, elements=2)
    hinge, spring = fb.Spring(stiffness=300.0, rest=0.2), fb.Spring(stiffness=800.0)
    damper = fb.Damper(viscosity) if viscosity else None
    scene.add_joint(fb.Revolute(fb.GROUND, crank.start, spring=hinge, damper=damper))
    scene.add_joint(fb.Revolute(crank.end, rod.start, offset=(0.1, 0), spring=hinge))
    slide = fb.Prismatic(rod.end, tail.start, axis=(1, 0.2), spring=spring, damper=damper)
    scene.add_joint(slide)
    return scene


def lattice(cells=5):
    """A square lattice, whose unknowns no order puts in a narrow band."""
    scene = fb.Scene(gravity=(0, -9.81))
    nodes: dict = {}
    for i in range(cells + 1):
        for j in range(cells + 1):
            for end in ((i + 1, j), (i, j + 1)):
                if max(end) <= cells:
                    ends = [nodes.get(place, place) for place in ((i, j), end)]
                    bar = scene.add_beam(ends, FLYING, elements=2)
                    nodes[i, j], nodes[end] = bar.start, bar.end
    scene.pin(nodes[0, 0])
    scene.pin(nodes[cells, 0])
    return scene


def tapered_arch():
    """Curved elements of degree 2 with data of their own at every Gauss point."""
    scene = fb.Scene(gravity=(0.3, -9.81))
    section = fb.Section(
        EA=lambda s: 2e4 * (2 - s),
        GA=lambda s: 1e4 * (2 - s),
        EI=lambda s: 50 * (2 - s) ** 3,
        rhoA=lambda s: 2 - s,
        rhoI=0.01,
    )
    arch = scene.add_beam(fb.arc((0, 0), (1, 0.6), (2, 0)), section, elements=4, degree=2)
    scene.pin(arch.start)
    return scene


def rolled_up():
    """The rolled-up beam, and the static solution from which it is let go."""
    module = demo("roll_up")
    return module.scene()[0], module.rolled_up(1.0, steps=10)[0]


SCENES = {
    "pinned beam": (lambda: demo_scene("pinned_beam"), 0.01),
    "pendulum": (lambda: demo_scene("pendulum"), 0.01),
    "own physics": (lambda: demo_scene("own_physics"), 0.004),
    "three-bar swing": (lambda: demo_scene("three_bar_swing"), 5e-4),
    "multi-body system": (lambda: demo_scene("multibody"), 0.005),
    "slider crank": (lambda: demo_scene("slider_crank"), 5e-4),
    "ring": (demo("ring").thrown, 1e-3),
    "roll-up": (rolled_up, demo("roll_up").DT),
    "pinned beam of degree 2": (lambda: pinned_beam(4, degree=2)[0], 0.005),
    "flight of degree 3": (lambda: free_flight(4, degree=3)[0], 0.02),
    "frame with everything": (frame_with_everything, 0.005),
    "linkage": (linkage, 0.005),
    "springs": (sprung, 0.005),
    "springs and dampers": (lambda: sprung(viscosity=5.0), 0.005),
    "lattice": (lattice, 0.005),
    "tapered arch of degree 2": (tapered_arch, 0.005),
}
# By these costs no band is chosen.
SPARSE = COSTS._replace(narrow=0, band_entry=math.inf)
# Conserving schemes share their C, and so does the family of Newmark: one of each everywhere, the
# others with all kinds of loads and of joints.
RUNS = [
    (name, scheme)
    for scheme in SCHEMES
    for name in SCENES
    if scheme in (SCHEMES[0], SCHEMES[-1]) or name in ("frame with everything", "linkage")
]


@pytest.mark.parametrize(
    ("name", "scheme"), RUNS, ids=[f"{name}-{scheme.name}" for name, scheme in RUNS]
)
def test_the_loop_computes_what_python_and_petsc_compute(name, scheme):
    build, dt = SCENES[name]
    made = build()
    scene, start = made if isinstance(made, tuple) else (made, None)
    # One iteration beyond the usual tolerance, lest the comparison be one of tolerances.
    newton = fb.NewtonOptions(tolerance=1e-12)
    compiled, reference = (
        fb.simulate(scene, scheme, newton=newton, solver=solver, dt=dt, t_end=50 * dt, start=start)
        for solver in ("compiled", "petsc")
    )
    assert compiled.stats.solver.startswith("compiled")
    assert reference.stats.solver == "petsc lu"
    assert len(compiled.t) == len(reference.t) == 51
    # No motion is lost, which would multiply every rounding.
    assert abs(reference.energy.balance_error).max() < 0.3 * reference.energy.kinetic.max() + 1e-9
    # On the rod with EA = 1e10 the rounding of the strain, 1e-16, is a force of 1e-6 N. Schemes
    # that weight the forces of both ends of a step take that of its start as given: it moves the
    # mass by 1e-6 dt^2/4 in a step, and by 2e-10 of the rod's length after fifty.
    weighted = scheme.name == "GeneralizedAlpha"
    # The discrete gradient of an energy that is not quadratic divides the rounding of the energy by
    # an increment of strain, which may be as small as 6e-6.
    rounded = name == "own physics" or (name == "pendulum" and weighted)
    close = 1e-9 if rounded else 1e-10
    size = np.ptp(compiled.X, axis=0).max()
    scales = {"q": size, "v": abs(reference.v).max()}
    scales["reactions"] = abs(reference.reactions).max()
    scales |= {"joint_forces": abs(reference.joint_forces).max(initial=0.0), "slides": size}
    for history, scale in scales.items():
        difference = getattr(compiled, history) - getattr(reference, history)
        # Forces are strains, known to 1e-16, times stiffnesses.
        bound = close if history in ("q", "slides") else 1e4 * close
        assert abs(difference).max(initial=0.0) <= bound * scale
    scale = abs(reference.energy.total).max() + abs(reference.energy.kinetic).max()
    for part in ("kinetic", "strain", "potential", "work"):
        difference = getattr(compiled.energy, part) - getattr(reference.energy, part)
        assert abs(difference).max() < 100 * close * scale
    # How long an iteration hovers at round-off is chance: sums in another order, one rounding less.
    if "round-off" not in compiled.stats.ended_by | reference.stats.ended_by:
        iterations = [s.stats.newton_iterations for s in (compiled, reference)]
        assert iterations[0] == pytest.approx(iterations[1], rel=0.05)


@pytest.mark.parametrize("dt", [0.02, 0.001])
def test_steps_in_python_keep_energy_and_momentum_as_well(dt):
    scene, _ = pinned_beam()
    solution = fb.simulate(scene, dt=dt, t_end=1.0, solver="petsc")
    assert relative_drift(solution.energy.total) < 1e-10
    assert relative_drift(solution.angular_momentum) < 1e-10


@pytest.mark.parametrize("record", [fb.Record(), fb.Record(every=3)])
def test_a_step_that_fails_is_halved_in_the_loop_as_in_python(record):
    def spinner():
        scene = fb.Scene()
        section = fb.Section(EA=1e6, GA=1e6, EI=1e4, rhoA=1.0, rhoI=0.1)
        beam = scene.add_beam([(-1, 0), (1, 0)], section, elements=2)
        scene.set_velocity(beam, lambda x, y: (-40 * y, 40 * x), spin=40)
        return scene

    compiled, reference = (
        fb.simulate(spinner(), dt=0.1, t_end=1.0, record=record, solver=solver)
        for solver in ("compiled", "petsc")
    )
    assert compiled.stats.solver.startswith("compiled")
    assert compiled.stats.halvings == reference.stats.halvings >= 1
    assert compiled.stats.substeps == reference.stats.substeps == 20
    assert abs(compiled.q - reference.q).max() < 1e-9
    assert (compiled.t == reference.t).all()
    N, expected = (s.resultants("beam 1").N for s in (compiled, reference))
    assert pytest.approx(expected, abs=1e-6 * abs(expected).max()) == N


def test_a_last_step_may_be_shorter():
    scene, _ = pinned_beam()
    compiled = fb.simulate(scene, dt=0.03, t_end=0.2)
    reference = fb.simulate(scene, dt=0.03, t_end=0.2, solver="petsc")
    assert compiled.t == pytest.approx([*(0.03 * np.arange(7)), 0.2])
    assert abs(compiled.q - reference.q).max() < 1e-9 * 100


def test_a_lattice_runs_in_the_loop_with_sparse_factors_and_a_chain_by_nodes():
    def solver(scene):
        return fb.simulate(scene, dt=0.01, t_end=0.01).stats.solver

    assert solver(lattice()).startswith("compiled, sparse, ")
    assert solver(pinned_beam(64)[0]) == "compiled, chain"


@pytest.mark.parametrize("held", ["clamp", "pin", "x", "both ends", "neither"])
@pytest.mark.parametrize("elements", range(1, 8))
def test_chains_of_any_length_and_support_move_as_on_petsc(held, elements):
    scene = fb.Scene(gravity=(1.0, -9.81))
    section = fb.Section(EA=1e5, GA=1e5, EI=1e2, rhoA=1.0, rhoI=0.1)
    beam = scene.add_beam([(0, 0), (1, 1)], section, elements=elements)
    hold = {"clamp": scene.clamp, "pin": scene.pin, "x": lambda node: scene.fix(node, "x")}
    for node in {"both ends": (beam.start, beam.end), "neither": ()}.get(held, (beam.start,)):
        hold.get(held, scene.pin)(node)
    compiled, reference = (
        fb.simulate(scene, dt=0.01, t_end=0.2, solver=name) for name in ("compiled", "petsc")
    )
    assert compiled.stats.solver == "compiled, chain"
    assert abs(compiled.q - reference.q).max() < 1e-10
    assert abs(compiled.reactions - reference.reactions).max() < 1e-7


@pytest.mark.parametrize(
    "name", ["lattice", "linkage", "springs", "frame with everything", "flight of degree 3"]
)
def test_sparse_rows_give_what_the_band_gives(name, monkeypatch):
    make, dt = SCENES[name]

    def run():
        return fb.simulate(make(), dt=dt, t_end=30 * dt, max_halvings=0)

    monkeypatch.setattr(handover, "COSTS", SPARSE)
    sparse = run()
    assert "sparse" in sparse.stats.solver
    monkeypatch.setattr(handover, "COSTS", COSTS._replace(narrow=math.inf))
    banded = run()
    assert "sparse" not in banded.stats.solver
    assert sparse.stats.newton_iterations == banded.stats.newton_iterations
    assert abs(sparse.q - banded.q).max() < 1e-10 * max(1, abs(banded.q).max())


# -- Which solver -------------------------------------------------------------------------------


def test_a_rule_of_ones_own_runs_in_python_and_says_so():
    class OwnRates(MidPointRates):
        pass

    ready = fb.EnergyMomentum()
    scheme = fb.Scheme("Own", ready.resultants, OwnRates())
    scene, beam = pinned_beam()
    own = fb.simulate(scene, scheme, dt=0.01, t_end=0.1)
    assert own.stats.solver == "Python, sparse lu (custom rates OwnRates)"
    usual = fb.simulate(scene, ready, dt=0.01, t_end=0.1)
    assert abs(own.q - usual.q).max() < 1e-9 * 100
    with pytest.raises(fb.SceneError, match="OwnRates"):
        fb.simulate(scene, scheme, dt=0.01, t_end=0.1, solver="compiled")


def test_an_unknown_solver_is_refused():
    scene, _ = pinned_beam()
    with pytest.raises(fb.SceneError, match="solver = 'mumps'"):
        fb.simulate(scene, dt=0.01, t_end=0.1, solver="mumps")


@pytest.mark.parametrize("built", ["nothing", "the loop"])
def test_without_a_compiler_python_takes_over_with_one_warning(
    built, monkeypatch, no_libraries, caplog
):
    def no_compiler(*_, **__):
        raise FileNotFoundError("cc")

    build._warn.cache_clear()
    monkeypatch.setattr(
        c_library, "_FLAGS", [*c_library._FLAGS, "-O0"]
    )  # compiled here, and never run
    if built == "the loop":
        build.load_library()
    monkeypatch.setattr(c_library.subprocess, "run", no_compiler)
    scene, _ = pendulum()
    with caplog.at_level(logging.WARNING, logger="fx_beam"):
        solutions = [fb.simulate(scene, dt=0.01, t_end=0.1) for _ in range(2)]
    assert all(s.stats.solver == "Python, sparse lu (it cannot be built)" for s in solutions)
    assert [r.levelname for r in caplog.records] == ["WARNING"]
    assert "cannot be built" in caplog.text


@pytest.mark.skipif(platform.machine() != "x86_64", reason="names of processors are those of x86")
def test_a_loop_is_built_for_the_processor_that_is_asked_for(monkeypatch, no_libraries):
    def built(source="double one(void) { return 1; }"):
        return c_library.load("a test", "", lambda: source, lambda path: path.name)

    names = []
    for target in ("", "x86-64", "x86-64-v2", "x86-64"):
        monkeypatch.setenv("FX_BEAM_MARCH", target)
        names.append(built())
    assert len(set(names)) == 3 and names[1] == names[3]
    # One that was built for a name serves all machines; a native one its own kind.
    monkeypatch.setattr(c_library, "_processor", lambda: "another")
    monkeypatch.setenv("FX_BEAM_MARCH", "x86-64")
    assert built("none") == names[1]
    monkeypatch.delenv("FX_BEAM_MARCH")
    assert built() not in names


def test_a_processor_that_the_compiler_does_not_know_is_refused(monkeypatch, no_libraries):
    monkeypatch.setenv("FX_BEAM_MARCH", "abacus")
    scene, _ = pendulum()
    with pytest.raises(fb.SceneError, match="FX_BEAM_MARCH = 'abacus' is not known to"):
        fb.simulate(scene, dt=0.01, t_end=0.1)


@pytest.mark.skipif(
    "fma4" in c_library._processor().split(), reason="the processor has all of these"
)
@pytest.mark.skipif(platform.machine() != "x86_64", reason="names of processors are those of x86")
def test_a_processor_that_this_one_is_not_is_refused_before_a_step(monkeypatch, no_libraries):
    monkeypatch.setattr(c_library, "_FLAGS", [*c_library._FLAGS, "-O0"])
    monkeypatch.setenv("FX_BEAM_MARCH", "bdver4")
    scene, _ = pendulum()
    with pytest.raises(fb.SceneError, match="'bdver4' is for processors with FMA4, which this"):
        fb.simulate(scene, dt=0.01, t_end=0.1)


def test_the_log_names_what_is_compiled_and_nothing_the_second_time(tmp_path):
    script = """
import logging, sys
logging.basicConfig(level="INFO", stream=sys.stdout, format="%(message)s")
import fx_beam as fb
scene = fb.Scene()
beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1.0, GA=1.0, EI=1.0, rhoA=1.0))
fb.simulate(scene, dt=0.1, t_end=0.2)
"""
    # Of several options -O the last one counts.
    quick = tmp_path / "cc"
    quick.write_text('#!/bin/sh\nexec cc "$@" -O0\n')
    quick.chmod(0o755)

    def run():
        environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path), "CC": str(quick)}
        command = [sys.executable, "-c", script]
        return subprocess.run(command, env=environment, capture_output=True, text=True).stdout

    first = run()
    for what in ("internal forces", "tangent", "strain energy", "mass"):
        assert f"compiled the form '{what}'" in first
    for what in ("the loop over time steps", "'tangent' for several elements"):
        assert f"compiling {what}" in first
    assert "compil" not in run()


# -- What is recorded ---------------------------------------------------------------------------


@pytest.mark.parametrize("solver", ["compiled", "petsc"])
@pytest.mark.parametrize("every", [7, 1000])
def test_every_so_many_steps_are_rows_of_the_full_record(solver, every):
    scene, beam = pinned_beam()
    full = fb.simulate(scene, dt=0.01, t_end=1.0, solver=solver)
    thin = fb.simulate(scene, dt=0.01, t_end=1.0, solver=solver, record=fb.Record(every=every))
    rows = np.union1d(np.arange(0, 101, every), [100])
    assert (thin.t == full.t[rows]).all()
    for history in ("t_level", "q", "v", "a", "reactions", "linear_momentum", "angular_momentum"):
        assert (getattr(thin, history) == getattr(full, history)[rows]).all()
    assert (thin.energy.total == full.energy.total[rows]).all()
    assert thin.stats.steps == 100
    # Stress resultants are those of the step that ended there, not of the time since the last row.
    assert thin.resultants(beam).N == pytest.approx(full.resultants(beam).N[rows], rel=1e-9)


def test_what_is_not_recorded_is_said_so():
    scene, beam = pinned_beam()
    audit = fb.Record(motion=False, rates=False, forces=False)
    solution = fb.simulate(scene, dt=0.01, t_end=0.5, record=audit)
    assert len(solution.energy.total) == len(solution.t) == 51
    assert solution.angular_momentum[-1] == pytest.approx(75_000)
    for get in (
        solution.position,
        solution.rotation,
        solution.velocity,
        solution.spin,
        solution.acceleration,
        solution.reaction,
    ):
        with pytest.raises(ValueError, match="not recorded"):
            get(beam.end)
    for get in (solution.shape, solution.resultants):
        with pytest.raises(ValueError, match="not recorded"):
            get(beam)


@pytest.mark.parametrize("every", [0, -1, 2.5])
def test_a_record_needs_a_positive_number(every):
    with pytest.raises(fb.SceneError, match="every"):
        fb.Record(every=every)
