"""Long work shows how far it is, and Ctrl-C keeps what there is."""

import os
import signal
import subprocess
import sys

import numpy as np
import pytest
from jointed import whirling
from scenes import FLYING, clamped_bar

import fx_beam as fb
from fx_beam.motions import progress

# Without rounding, so that two runs may be equal to the last digit.
DT = 1 / 16


def arm(stop_at=9.0, how=None, follower=False):
    """A clamped arm whose load brings an interrupt when it is evaluated at some time."""
    calls = []

    def force(t):
        calls.append(t)
        if t > stop_at:
            how()
        return 0.0, 10.0 * t

    scene, beam = clamped_bar((1, 0), FLYING, elements=3)
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


@pytest.mark.exact_times
@pytest.mark.parametrize(("how", "follower"), [(raised, False), (signalled, True)])
def test_an_interrupted_motion_hands_over_its_steps_and_goes_on_as_if_it_had_not_ended(
    how, follower, tmp_path
):
    options = {"dt": DT, "t_end": 1.0}
    with pytest.raises(KeyboardInterrupt) as stop:
        fb.simulate(arm(0.4, how, follower)[0], **options)
    (note,) = stop.value.__notes__
    assert "attribute `solution`" in note and "sys.last_value.solution" in note
    assert "start=solution" in note
    first = stop.value.solution
    assert first.stats.failure.kind == "interrupted"
    assert first.stats.steps == len(first.t) - 1
    first.save(tmp_path / "run.npz")
    first = fb.load(tmp_path / "run.npz")
    assert first.stats.failure.kind == "interrupted"
    scene, beam = arm(follower=follower)
    assert first.resultants(beam).M.shape == (len(first.t), 3)
    whole, rest = fb.simulate(scene, **options), fb.simulate(scene, start=first, **options)
    assert first.t[-1] == rest.t[0] == 0.375
    for name in ("t", "q", "v", "a"):
        both = np.concatenate([getattr(first, name), getattr(rest, name)[1:]])
        np.testing.assert_array_equal(both, getattr(whole, name))
    iterations = [solution.stats.newton_iterations for solution in (first, rest, whole)]
    assert iterations[0] + iterations[1] == iterations[2]
    assert rest.energy.work[-1] == pytest.approx(whole.energy.work[-1], rel=1e-12)


@pytest.mark.exact_times
def test_an_interrupted_part_of_a_step_goes_on_after_it():
    def interrupted(stop_at):
        scene = whirling(1)

        def force(t):
            if t > stop_at:
                raise KeyboardInterrupt
            return 0.0, 0.0

        scene.add_force(scene.beams[0].end, force)
        return scene

    options = {"dt": 1 / 4}
    with pytest.raises(KeyboardInterrupt) as stop:
        fb.simulate(interrupted(1.2), t_end=2.0, **options)
    first = stop.value.solution
    assert first.stats.halvings and first.t[-1] == 1.0 < first.end.t < 1.25
    rest = fb.simulate(interrupted(9.0), t_end=2.0, start=first, **options)
    assert rest.t[0] == first.end.t
    assert rest.energy.total == pytest.approx(first.energy.total[0], rel=1e-9)


def loaded():
    scene, beam = clamped_bar((1, 0), FLYING, elements=3, load=(0.0, 50.0))
    return scene


# -- Bars --------------------------------------------------------------------------------------


@pytest.mark.parametrize("continuation", [None, "arc-length"])
def test_a_path_shows_its_load_factor_to_those_who_ask(continuation, capfd):
    fb.static(loaded(), load_steps=2, continuation=continuation, progress=True)
    out, err = capfd.readouterr()
    assert out == "" and "load factor" in err
    fb.static(loaded(), load_steps=2, continuation=continuation)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("continuation", [None, "arc-length"])
def test_a_bar_of_a_path_follows_the_load_factor_of_each_state(continuation, monkeypatch):
    shown, update = [], progress.tqdm.update

    def noted(bar, more):
        update(bar, more)
        shown.append(bar.n)

    monkeypatch.setattr(progress.tqdm, "update", noted)
    path = fb.static(loaded(), load_steps=5, continuation=continuation, progress=True)
    assert len(shown) > 4
    assert shown == pytest.approx(path.load_factor, abs=1e-12)


def test_a_process_without_output_computes_what_others_do(tmp_path):
    script = """
import sys
{}
try:
    import fx_beam as fb
    from fx_beam.symbolic import package
    package("ufl")  # which asks for a terminal; from the cache it is not needed
    scene = fb.Scene(gravity=(0, -9.81))
    scene.pin(scene.add_beam([(0, 0), (1, 0)], fb.Section(1e4, 1e4, 1.0, 1.0, 0.1)).start)
    tip = float(fb.simulate(scene, dt=0.1, t_end=0.3, progress=True).q[-1, -1, 1])
    fb.static(scene, load_steps=2, progress=True)
except Exception as error:
    tip = repr(error)
open({!r}, "a").write(f"{{tip}}\\n")
"""
    said = tmp_path / "said"
    missing = "", "sys.stdout.close(); sys.stderr.close()", "sys.stdout = sys.stderr = None"
    for how in missing:
        command = [sys.executable, "-c", script.format(how, str(said))]
        subprocess.run(command, capture_output=True)
    first, *others = said.read_text().splitlines()
    assert float(first) and others == [first] * 2
    with open("/dev/full", "w") as full:
        info = subprocess.run([sys.executable, "-m", "fx_beam", "info"], stdout=full)
    assert info.returncode == 1
