"""Long work shows how far it is, and Ctrl-C keeps what there is."""

import os
import signal

import numpy as np
import pytest
from jointed import whirling
from scenes import FLYING

import fx_beam as fb
from fx_beam.compiled.loop import CompiledLoop
from fx_beam.stepping.arc_length import ArcLength
from fx_beam.stepping.load_steps import LoadStepper
from fx_beam.stepping.recorder import Recorder
from fx_beam.stepping.single_stepper import SingleStepper


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


# -- Going on ----------------------------------------------------------------------------------

# Without rounding, so that two runs may be equal to the last digit.
DT = 1 / 16


@pytest.mark.exact_times
@pytest.mark.parametrize("follower", [False, True], ids=["dead", "follower"])
@pytest.mark.parametrize("solver", ["compiled", "petsc"])
def test_an_interrupted_motion_goes_on_as_if_it_had_not_ended(solver, follower, tmp_path):
    options = {"dt": DT, "t_end": 1.0, "solver": solver}
    with pytest.raises(KeyboardInterrupt) as stop:
        fb.simulate(arm(0.4, signalled, follower)[0], **options)
    stop.value.solution.save(tmp_path / "kept.npz")
    kept = fb.load(tmp_path / "kept.npz")
    scene, _ = arm(9.0, raised, follower)
    whole, rest = fb.simulate(scene, **options), fb.simulate(scene, start=kept, **options)
    assert kept.t[-1] == rest.t[0] == 0.375
    for name in ("t", "q", "v", "a"):
        both = np.concatenate([getattr(kept, name), getattr(rest, name)[1:]])
        np.testing.assert_array_equal(both, getattr(whole, name))
    assert kept.stats.newton_iterations + rest.stats.newton_iterations == (
        whole.stats.newton_iterations
    )
    assert rest.energy.work[-1] == pytest.approx(whole.energy.work[-1], rel=1e-12)


@pytest.mark.parametrize("tolerance", [None, 1e-3], ids=["grid", "tolerance"])
@pytest.mark.parametrize(
    ("solver", "taker", "method"),
    [("compiled", CompiledLoop, "_run"), ("petsc", Recorder, "record")],
)
def test_steps_that_end_when_ctrl_c_comes_are_not_lost(
    solver, taker, method, tolerance, monkeypatch
):
    scene, _ = arm(9.0, raised)
    done = getattr(taker, method)

    def interrupted(self, *arguments):
        found = done(self, *arguments)
        recorder = self if isinstance(self, Recorder) else arguments[-1]
        if recorder.rows > 4:
            signalled()
        return found

    monkeypatch.setattr(taker, method, interrupted)
    options = {"solver": solver, "tolerance": tolerance, "t_end": 1.0}
    options |= {"dt": DT} if tolerance is None else {}
    with pytest.raises(KeyboardInterrupt) as stop:
        fb.simulate(scene, **options)
    monkeypatch.undo()
    kept = stop.value.solution
    assert kept.end.t == kept.t[-1] and len(kept.t) == kept.stats.steps + 1 >= 5
    if kept.t[-1] < 1.0:  # else C has taken all steps at once
        rest = fb.simulate(scene, start=kept, **options)
        assert (rest.q[0] == kept.q[-1]).all()
        assert rest.energy.balance_error[-1] == pytest.approx(0, abs=1e-12)


@pytest.mark.exact_times
@pytest.mark.parametrize("solver", ["compiled", "petsc"])
def test_an_interrupted_part_of_a_step_goes_on_after_it(solver):
    def interrupted(stop_at):
        scene = whirling(1)

        def force(t):
            if t > stop_at:
                raise KeyboardInterrupt
            return 0.0, 0.0

        scene.add_force(scene.beams[0].end, force)
        return scene

    options = {"dt": 1 / 4, "solver": solver}
    with pytest.raises(KeyboardInterrupt) as stop:
        fb.simulate(interrupted(1.2), t_end=2.0, **options)
    kept = stop.value.solution
    assert kept.stats.halvings and kept.t[-1] == 1.0 < kept.end.t < 1.25
    rest = fb.simulate(interrupted(9.0), t_end=2.0, start=kept, **options)
    assert rest.t[0] == kept.end.t
    assert rest.energy.total == pytest.approx(kept.energy.total[0], rel=1e-9)


@pytest.mark.exact_times
@pytest.mark.parametrize("solver", ["compiled", "petsc"])
def test_ctrl_c_stops_a_motion_between_two_steps(solver, monkeypatch):
    take = SingleStepper.take

    def interrupted(self, *arguments):
        take(self, *arguments)
        if self.number == 5:
            signalled()

    options = {"dt": DT, "solver": solver, "record": fb.Record()}
    whole = fb.Motion(arm(9.0, raised)[0], **options)
    whole.run(0.5)
    motion = fb.Motion(arm(9.0, raised)[0], **options)
    monkeypatch.setattr(SingleStepper, "take", interrupted)
    with pytest.raises(KeyboardInterrupt):
        motion.run(0.5)
    assert motion.t == 5 * DT
    motion.run(0.5)
    np.testing.assert_array_equal(motion.solution().q, whole.solution().q)


def test_an_interrupt_says_where_the_steps_are(tmp_path):
    with pytest.raises(KeyboardInterrupt) as stop:
        fb.simulate(arm(0.22, raised)[0], dt=0.05, t_end=0.5)
    (note,) = stop.value.__notes__
    assert "attribute `solution`" in note and "sys.last_value.solution" in note
    assert "start=solution" in note
    stop.value.solution.save(tmp_path / "run.npz")
    assert fb.load(tmp_path / "run.npz").stats.failure.kind == "interrupted"


@pytest.mark.parametrize(
    ("continuation", "taker", "method"),
    [(None, LoadStepper, "step"), ("arc-length", ArcLength, "step")],
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
