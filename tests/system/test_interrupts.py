"""An interrupt may come anywhere: a step is taken or it is not, and what was computed is kept."""

import itertools
import signal
import threading

import numpy as np
import pytest
from interrupting import call_stopped_at, lines_of
from scenes import clamped_bar, one_bar

import fx_beam as fb
from fx_beam.content_cache import cached_property
from fx_beam.step import full_turns, step_inputs
from fx_beam.step.program import PROGRAMS
from fx_beam_studies import stability

DT = 1 / 64
SECTION = fb.Section(EA=1e4, GA=1e4, EI=5.0, rhoA=1.0, rhoI=1e-2)


def whirling():
    """Two arms that turn fast: a motor between them; loads that are held, of time, and follow."""
    scene, arm = one_bar((1, 0), SECTION, elements=2, gravity=(0.0, -9.81))
    tip = scene.add_beam([(1, 0), (1.5, 0.2)], SECTION, elements=1)
    hinge = scene.add_joint(fb.Revolute(fb.GROUND, arm.start))
    scene.add_joint(fb.Revolute(arm.end, tip.start, motor=fb.Input("place")))
    scene.set_velocity(arm, lambda x, y: (-20 * y, 20 * x), spin=20)
    scene.set_velocity(tip, lambda x, y: (-20 * y, 20 * x), spin=20)
    scene.add_force(tip.end, fb.Input("push"))
    scene.add_force(arm.end, lambda t: (np.cos(9 * t), 2 * np.sin(5 * t)))
    scene.add_force(arm.end, (0.3, 0.0), follower=True)
    return scene, {"tip": fb.Output("position", tip.end), "force": fb.Output("force", hinge)}


def agree(motion, twin):
    """Assert that two motions are in the same state."""
    assert motion.t == twin.t
    for name, value in twin.inputs.items():
        np.testing.assert_array_equal(motion.inputs[name], value)
    for computed, value in (
        (motion.v, twin.v),
        *zip(motion.outputs.values(), twin.outputs.values(), strict=True),
    ):
        np.testing.assert_allclose(computed, value, rtol=0, atol=1e-7 * (1 + abs(value).max()))


@pytest.mark.parametrize(
    ("opcodes", "every", "bumps", "scheme"),
    [
        (True, 61, False, fb.EnergyMomentum()),
        (False, 17, False, fb.EnergyMomentum(order=4)),
        (False, 29, True, fb.EnergyMomentum()),
    ],
    ids=["compiled", "sub-steps", "parts"],
)
def test_a_step_is_taken_or_not_wherever_it_is_interrupted(
    opcodes, every, bumps, scheme, monkeypatch
):
    monkeypatch.setattr(full_turns, "STEPS", 3)
    monkeypatch.setattr(step_inputs, "_BLOCK", 2)
    motion, twin = (
        fb.Motion(scene, scheme, dt=DT, outputs=outputs, record=fb.Record(every=2))
        for scene, outputs in (whirling(), whirling())
    )
    steps = broken = unbroken = 0
    for place in itertools.count(step=every):
        push = 3e3 if bumps and steps % 4 == 2 else 0.1
        inputs = {"place": np.sin(0.1 * steps), "push": (push, 0.2)}
        reached = call_stopped_at(place, lambda inputs=inputs: motion.step(inputs), opcodes)
        broken += reached
        if motion.t > twin.t:
            twin.step(inputs)
            steps += 1
        agree(motion, twin)
        unbroken = 0 if reached else unbroken + 1
        if unbroken == 6:  # no step is as long
            break
    assert broken > 50 and steps > 5
    assert bool(twin.stats.halvings) is bumps
    computed, expected = motion.solution(), twin.solution()
    np.testing.assert_array_equal(computed.t, expected.t)
    np.testing.assert_allclose(computed.q, expected.q, rtol=0, atol=1e-7 * abs(expected.q).max())
    assert abs(computed.energy.balance_error).max() < 1e-9 * abs(computed.energy.total).max()


@pytest.fixture
def ctrl_c():
    """Ctrl-C, which a shell lets processes in the background ignore."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield lambda: signal.raise_signal(signal.SIGINT)
    signal.signal(signal.SIGINT, before)


def test_what_a_controller_remembers_agrees_with_the_steps_after_ctrl_c(ctrl_c):
    motion, twin = (
        fb.Motion(scene, dt=DT, outputs=outputs) for scene, outputs in (whirling(), whirling())
    )

    def controller(memory, stops=False):
        def push(t, outputs):
            memory.append(t)
            if stops and len(memory) % 3 == 0:
                ctrl_c()
            return {"push": (0.0, 1e-2 * len(memory))}

        return push

    seen, whole = [], []
    stopping = controller(seen, stops=True)
    while motion.t < 0.5:
        try:
            motion.run(0.5, stopping)
        except KeyboardInterrupt:
            assert len(seen) == round(motion.t / DT)
    twin.run(0.5, controller(whole))
    assert seen == whole
    agree(motion, twin)


def test_a_second_ctrl_c_stops_a_controller_that_does_not_end(ctrl_c):
    def endless(t, outputs):
        for _ in range(1000):
            ctrl_c()
        raise AssertionError

    motion = fb.Motion(whirling()[0], dt=DT)
    with pytest.raises(KeyboardInterrupt):
        motion.run(0.5, endless)
    assert motion.t == 0.0


def test_a_motion_returns_to_a_snapshot_also_if_it_is_interrupted():
    motion, twin = (
        fb.Motion(scene, dt=DT, outputs=outputs, record=fb.Record())
        for scene, outputs in (whirling(), whirling())
    )
    twin.run(0.3)
    start = twin.snapshot()
    now = motion.snapshot()
    for place in itertools.count(step=7):
        motion.restore(now)
        motion.step()
        if not call_stopped_at(place, lambda: motion.restore(start)):
            break
        if motion.t == start.t:
            agree(motion, twin)
        else:
            assert motion.t == DT
    assert place > 50


# -- Whole runs --------------------------------------------------------------------------------


def motion_by(**options):
    scene, _ = whirling()
    return lambda: fb.simulate(scene, **{"t_end": 0.125} | options)


def bent(**options):
    scene, arm = clamped_bar((1, 0), SECTION, elements=2, load=(0.0, 5.0))
    return lambda: fb.static(scene, load_steps=3, **options)


RUNS = {
    "grid": lambda: motion_by(dt=DT),
    "turns": lambda: motion_by(dt=DT, t_end=0.4, scheme=fb.EnergyMomentum(order=4)),
    "tolerance": lambda: motion_by(tolerance=1e-2),
    "static": bent,
    "arc length": lambda: bent(continuation="arc-length"),
}


class Alarm(BaseException):
    """An error that another handler of signals may raise."""


def alarm():
    raise Alarm


@pytest.mark.parametrize("kind", [KeyboardInterrupt, Alarm])
@pytest.mark.parametrize("name", RUNS)
def test_interrupts_leave_the_steps_before_or_say_there_are_none(name, kind, ctrl_c, monkeypatch):
    run = RUNS[name]()
    # Each run sets up a model of its own, so that it has as many lines as the others.
    monkeypatch.setattr(PROGRAMS, "size", 0)
    PROGRAMS.clear()
    if name == "turns":
        monkeypatch.setattr(full_turns, "STEPS", 3)
    whole = run()
    steps, end = lines_of(run)
    # Not at the beginning of the steps: from run to run it is some lines earlier or later.
    before, after = np.linspace(2, steps, 8, endpoint=False), np.linspace(steps, end, 17)[1:-1]
    places = *before, *after
    interrupted, handler = 0, signal.getsignal(signal.SIGINT)
    for place in map(int, places):
        try:
            call_stopped_at(place, run, how=alarm if kind is Alarm else ctrl_c)
        except kind as error:
            if kind is Alarm and signal.getsignal(signal.SIGINT) is not handler:
                # It came before the line that sets the handler back; the next Ctrl-C does so.
                with pytest.raises(KeyboardInterrupt):
                    ctrl_c()
            assert signal.getsignal(signal.SIGINT) is handler
            if error.solution is None:
                notes = getattr(error, "__notes__", [""])
                is_told = "before its first step" in notes[0]
                assert interrupted == 0 and is_told is (kind is not Alarm)
                continue
            assert kind is Alarm or error.__notes__
            computed, interrupted = error.solution, interrupted + 1
            rows = len(computed.t)
            np.testing.assert_array_equal(computed.t, whole.t[:rows])
            np.testing.assert_allclose(computed.q, whole.q[:rows], rtol=0, atol=1e-9)
            np.testing.assert_allclose(computed.end.q, computed.q[-1], rtol=0, atol=1e-12)
            assert computed.stats.steps == rows - 1 and computed.stats.failure.kind == "interrupted"
    assert interrupted > 5


@pytest.mark.parametrize("raised", [MemoryError, TimeoutError, SystemExit, KeyboardInterrupt])
def test_what_a_function_of_time_raises_once_ends_the_run_with_the_steps_before(raised):
    scene, late = fb.Scene(), []
    bar = scene.add_beam([(0, 0), (1, 0)], SECTION, elements=1)

    def push(t):
        if t > 6 * DT and not late:  # at the start of the seventh step
            late.append(t)
            raise raised
        return (1.0, 0.0)

    scene.add_force(bar.start, push)
    with pytest.raises((fb.StepError, raised)) as caught:
        fb.simulate(scene, dt=DT, t_end=10 * DT)
    assert raised in (type(caught.value), type(caught.value.__cause__))
    np.testing.assert_array_equal(caught.value.solution.t, DT * np.arange(7))


def cantilever(elements, degree):
    scene = fb.Scene(gravity=(0.0, -9.81))
    scene.clamp(scene.add_beam([(0, 0), (1, 0)], SECTION, elements, degree).start)
    return scene


def test_runs_that_ended_are_kept_whatever_ends_converge_and_studies():
    calls = []

    def scene_of(elements, degree):
        calls.append(elements)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return cantilever(elements, degree)

    with pytest.raises(KeyboardInterrupt) as interrupted:
        fb.converge(scene_of, lambda solution: solution.q[-1, -1], 1e-9, t_end=0.05, elements=1)
    assert list(interrupted.value.values) == [(1, 1e-2), (2, 1e-2)]

    class Quits(fb.Scene):
        def __init__(self):
            raise SystemExit

    cases = [
        stability.Case("arm", name, made, dt=DT, t_end=2 * DT)
        for name, made in (("1", lambda: cantilever(1, 1)), ("2", Quits))
    ]
    with pytest.raises(SystemExit) as left:
        stability.study([fb.EnergyMomentum()], cases, repeats=0)
    assert [cell.case.label for cell in left.value.cells] == ["1"]


def test_an_interrupted_property_does_not_stop_other_threads():
    class Holder:
        @cached_property
        def value(self):
            return 1.0

    for place in itertools.count():
        if not call_stopped_at(place, lambda: Holder().value, opcodes=True):
            break
    values = []
    thread = threading.Thread(target=lambda: values.append(Holder().value), daemon=True)
    thread.start()
    thread.join(10)
    assert place > 10 and values == [1.0]
