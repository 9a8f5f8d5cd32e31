"""The compiled loop: its solvers and kept factors, and where it is built."""

import os
import platform
import subprocess
import sys

import numpy as np
import pytest
from plain_step import assert_balanced
from scenes import FLYING, assert_refused, grid, one_bar, pendulum, pinned_beam

import fx_beam as fb
from fx_beam import c_library

STRUT = fb.Section(EA=1e6, GA=1e6, EI=1e2, rhoA=1.0, rhoI=1e-2)


@pytest.mark.parametrize(
    ("elements", "held"), [(1, ""), (2, "clamp"), (3, "x"), (5, "ends"), (6, ""), (7, "pin")]
)
def test_chains_of_any_length_and_support_are_in_balance(elements, held):
    scene, beam = one_bar((1, 1), FLYING, elements=elements, gravity=(1.0, -9.81))
    more = scene.add_beam([(5, 0), (6, 0)], FLYING, elements=8 - elements)  # beside it
    scene.clamp(more.end)
    hold = {"clamp": scene.clamp, "x": lambda node: scene.fix(node, "x")}.get(held, scene.pin)
    for node in {"": (), "ends": (beam.start, beam.end)}.get(held, (beam.start,)):
        hold(node)
    assert fb.simulate(scene, dt=0.01, t_end=0.1).stats.solver == "compiled, chain"
    assert_balanced(scene, dt=0.01, t_end=0.1)


# -- Sparse factors --------------------------------------------------------------------------------


def frame(cells, high, turn=0.0):
    """A free lattice of single elements, which rotates as a whole [rad/s]."""
    scene, middle = fb.Scene(), np.array([cells, high]) / 2
    nodes = grid(scene, cells, high, STRUT)
    for node in scene.nodes:
        x, y = np.array([node.x, node.y]) - middle
        scene.set_velocity(node, (-turn * y, turn * x), spin=turn)
    return scene, nodes


@pytest.mark.parametrize(
    ("cells", "storage"),
    [((4, 1), "band"), ((20, 1), "band"), ((12, 12), "sparse"), ((36, 28), "sparse")],
)
def test_a_narrow_frame_has_a_band_and_a_wide_one_sparse_rows_which_are_kept(cells, storage):
    solver = fb.simulate(frame(*cells)[0], dt=0.01, t_end=0.01).stats.solver
    assert storage in solver
    assert solver.endswith("kept over several steps") == (storage == "sparse")


@pytest.mark.parametrize(("turn", "bead"), [(1.0, False), (20.0, False), (1.0, True)])
def test_factors_that_a_rotation_makes_poor_do_not_hide_an_error(turn, bead):
    # At 20 rad/s the stiff directions turn by 0.2 rad in each step.
    scene, nodes = frame(12, 12, turn)
    if bead:
        body = scene.add_body((0.5, 0.0), 0.5, 0.01)
        scene.set_velocity(body, (6.0 * turn, -5.5 * turn), turn)
        scene.add_joint(fb.Slider(scene.beams[0], body.centre))
    scene.add_force(nodes[12, 12], lambda t: (2e3 if t < 0.05 else 0.0, 0.0))
    motion = fb.simulate(scene, dt=0.01, t_end=0.2, max_halvings=0)
    assert motion.stats.solver.endswith("kept over several steps")
    assert abs(motion.energy.balance_error).max() < 1e-12 * motion.energy.kinetic.max()
    assert np.ptp(motion.angular_momentum[6:]) < 1e-12 * abs(motion.angular_momentum[-1])
    assert_balanced(scene, dt=0.01, t_end=0.2)
    assert (fb.simulate(scene, dt=0.01, t_end=0.2).q == motion.q).all()
    rest = fb.simulate(scene, dt=0.01, t_end=0.2, start=fb.simulate(scene, dt=0.01, t_end=0.1))
    assert abs(rest.q[-1] - motion.q[-1]).max() < 1e-10 * abs(motion.q).max()


def test_load_steps_of_a_large_frame_keep_quadratic_convergence_and_balance():
    scene, nodes = frame(32, 32)
    for j in range(33):
        scene.clamp(nodes[0, j])
        scene.add_force(nodes[32, j], (0.0, 2e4))
    solution = fb.static(scene, load_steps=4)
    assert abs(solution.q[-1, :, 2]).max() > 0.1
    assert solution.stats.newton_iterations <= 6 * 4
    held = sum(solution.reaction(nodes[0, j])[-1, :2] for j in range(33))
    assert held == pytest.approx([0, -33 * 2e4], abs=1e-7 * 33 * 2e4)


# -- Which solver -------------------------------------------------------------------------------


def test_without_a_compiler_nothing_runs_and_says_so(monkeypatch, no_libraries):
    monkeypatch.setenv("CC", "no-such-compiler")
    with pytest.raises(RuntimeError, match="cannot be built.*no-such-compiler.* variable CC"):
        fb.simulate(pendulum()[0], dt=0.01, t_end=0.1)


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
    origin = c_library._origin()._replace(processor="another")
    monkeypatch.setattr(c_library, "_origin", lambda: origin)
    monkeypatch.setenv("FX_BEAM_MARCH", "x86-64")
    assert built("none") == names[1]
    monkeypatch.delenv("FX_BEAM_MARCH")
    assert built() not in names


@pytest.mark.skipif(
    "fma4" in c_library._origin().processor.split(), reason="the processor has all of these"
)
@pytest.mark.skipif(platform.machine() != "x86_64", reason="names of processors are those of x86")
@pytest.mark.parametrize(
    ("target", "message"),
    [
        ("abacus", "FX_BEAM_MARCH = 'abacus' is not known to"),
        ("bdver4", "'bdver4' is for processors with FMA4, which this"),
    ],
)
def test_a_processor_that_is_unknown_or_not_this_one_is_refused_before_a_step(
    target, message, monkeypatch, no_libraries
):
    monkeypatch.setattr(c_library, "_FLAGS", [*c_library._FLAGS, "-O0"])
    monkeypatch.setenv("FX_BEAM_MARCH", target)
    scene, _ = pendulum()
    assert_refused(message, fb.simulate, scene, dt=0.01, t_end=0.1)


def test_the_log_names_what_is_compiled_and_nothing_the_second_time(tmp_path):
    # What is compiled leaves no handler behind: `basicConfig` works after it as well.
    script = """
import logging, sys
import fx_beam as fb
scene = fb.Scene()
beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1.0, GA=1.0, EI=1.0, rhoA=1.0))
log = logging.getLogger("fx_beam")
log.setLevel("INFO")
log.addHandler(logging.StreamHandler(sys.stdout))
fb.simulate(scene, dt=0.1, t_end=0.2)
assert not logging.getLogger().handlers
"""
    # Of several options -O the last one counts.
    quick = tmp_path / "cc"
    quick.write_text('#!/bin/sh\nexec cc "$@" -O0\n')
    quick.chmod(0o755)

    def run():
        environment = os.environ | {"XDG_CACHE_HOME": str(tmp_path), "CC": str(quick)}
        command = [sys.executable, "-c", script]
        options = {"env": environment, "check": True, "stdout": subprocess.PIPE, "text": True}
        done = subprocess.run(command, **options)
        return done.stdout

    first = run()
    for what in ("internal forces", "tangent", "strain energy"):
        assert f"compiled the form '{what}'" in first
    for what in ("the loop over time steps", "'tangent' for several elements"):
        assert f"compiling {what}" in first
    assert "compil" not in run()


def test_every_so_many_steps_are_rows_of_the_full_record():
    scene, beam = pinned_beam()
    options = {"dt": 0.01, "t_end": 0.3}
    full = fb.simulate(scene, **options)
    thin = fb.simulate(scene, **options, record=fb.Record(every=7))
    rows = [0, 7, 14, 21, 28, 30]
    assert (thin.t == full.t[rows]).all()
    for history in ("t_level", "q", "v", "a", "reactions", "linear_momentum", "angular_momentum"):
        assert (getattr(thin, history) == getattr(full, history)[rows]).all()
    assert (thin.energy.total == full.energy.total[rows]).all()
    assert thin.stats.steps == 30
    # Stress resultants are those of the step that ended there, not of the time since the last row.
    assert thin.resultants(beam).N == pytest.approx(full.resultants(beam).N[rows], rel=1e-9)
