"""Long work shows how far it is, and Ctrl-C keeps what there is."""

import os
import signal

import numpy as np
import pytest
from scenes import FLYING

import fx_beam as fb
from fx_beam.stepping.arc_length import ArcLength
from fx_beam.stepping.load_steps import LoadStepper


def arm(stop_at, how, follower=False):
    """A clamped arm whose load brings an interrupt when it is evaluated at some time."""
    calls = []

    def force(t):
        calls.append(t)
        if t > stop_at:
            how()
        return 0.0, 10.0 * t

    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], FLYING, elements=3)
    scene.clamp(beam.start)
    scene.add_force(beam.end, force, follower=follower)
    return scene, beam


@pytest.fixture(autouse=True)
def interruptible():
    """A shell starts a process in the background so that it ignores Ctrl-C: not these tests."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def raised():
    raise KeyboardInterrupt


def signalled():
    # What Ctrl-C does in a terminal.
    os.kill(os.getpid(), signal.SIGINT)


@pytest.mark.parametrize("follower", [False, True], ids=["dead", "follower"])
@pytest.mark.parametrize("how", [raised, signalled])
@pytest.mark.parametrize("solver", ["compiled", "petsc"])
def test_an_interrupted_motion_hands_over_its_steps(solver, how, follower):
    scene, beam = arm(0.22, how, follower)
    with pytest.raises(KeyboardInterrupt) as stop:
        fb.simulate(scene, dt=0.05, t_end=0.5, solver=solver)
    kept = stop.value.solution
    whole = fb.simulate(arm(9.0, raised, follower)[0], dt=0.05, t_end=0.5, solver=solver)
    rows = len(kept.t)
    assert 0.14 < kept.t[-1] < 0.21
    np.testing.assert_array_equal(kept.t, whole.t[:rows])
    np.testing.assert_array_equal(kept.displacement(beam.end), whole.displacement(beam.end)[:rows])
    assert kept.stats.failure.kind == "interrupted"
    assert kept.stats.steps == rows - 1
    assert kept.resultants(beam).M.shape == (rows, 3)


def test_an_interrupt_says_where_the_steps_are(tmp_path):
    with pytest.raises(KeyboardInterrupt) as stop:
        fb.simulate(arm(0.22, raised)[0], dt=0.05, t_end=0.5)
    (note,) = stop.value.__notes__
    assert "attribute `solution`" in note and "sys.last_value.solution" in note
    stop.value.solution.save(tmp_path / "run.npz")
    assert fb.load(tmp_path / "run.npz").stats.failure.kind == "interrupted"


@pytest.mark.parametrize(
    ("continuation", "taker", "method"),
    [(None, LoadStepper, "step"), ("arc-length", ArcLength, "_step")],
)
def test_an_interrupted_path_hands_over_its_equilibria(continuation, taker, method, monkeypatch):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], FLYING, elements=3)
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0.0, 50.0))
    whole = fb.static(scene, steps=5, continuation=continuation)
    step = getattr(taker, method)

    def stopped(self, state, *arguments):
        if state.t > 0.5:
            raise KeyboardInterrupt
        return step(self, state, *arguments)

    monkeypatch.setattr(taker, method, stopped)
    with pytest.raises(KeyboardInterrupt) as stop:
        fb.static(scene, steps=5, continuation=continuation)
    kept = stop.value.solution
    rows = len(kept.t)
    assert 1 < rows < len(whole.t)
    np.testing.assert_array_equal(kept.q, whole.q[:rows])
    assert kept.stats.failure.kind == "interrupted" and stop.value.__notes__


def test_an_interrupt_before_the_first_equilibrium_has_no_solution(monkeypatch):
    scene, _ = arm(9.0, raised)

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(LoadStepper, "first_state", interrupted)
    with pytest.raises(KeyboardInterrupt) as stop:
        fb.static(scene)
    assert stop.value.solution is None and not hasattr(stop.value, "__notes__")


# -- Bars --------------------------------------------------------------------------------------


@pytest.mark.parametrize("continuation", [None, "arc-length"])
def test_a_path_shows_its_load_factor_to_those_who_ask(continuation, capfd):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], FLYING, elements=3)
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0.0, 5.0))
    fb.static(scene, steps=2, continuation=continuation, progress=True)
    out, err = capfd.readouterr()
    assert out == "" and "load factor" in err
    fb.static(scene, steps=2, continuation=continuation)
    assert capfd.readouterr() == ("", "")


def test_what_is_no_answer_to_whether_a_bar_is_shown_is_refused():
    with pytest.raises(fb.SceneError, match="static: progress = 1 must be True, False or None"):
        fb.static(arm(9.0, raised)[0], progress=1)
