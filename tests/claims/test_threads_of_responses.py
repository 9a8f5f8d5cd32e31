"""Responses that threads call at once: each thread has the values and derivatives of one."""

import copy
import os
import pickle
import signal
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scenes import assert_refused, pinned_bar

import fx_beam as fb

#: Parameters of 160 scenes: a stiffness, and a mass per length.
X = 1.0 + np.random.default_rng(0).random((160, 2))
MOTION = {"dt": 0.01, "t_end": 0.2}


@pytest.fixture(autouse=True)
def turns(monkeypatch):
    """Threads take turns far more often than they do by themselves."""
    before = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    yield
    sys.setswitchinterval(before)


def scene_of(x):
    section = fb.Section(EA=1e4 * x[0], GA=1e4, EI=100.0, rhoA=x[1], rhoI=0.1)
    return pinned_bar((1, 0), section, elements=2, gravity=(0, -9.81))


def swinging(x):
    scene, beam = scene_of(x)
    scene.add_moment(beam.end, lambda t: 60.0 * t * (0.1 - t))
    outputs = {"end": fb.Output("position", beam.end), "energy": fb.Output("total_energy", scene)}
    return scene, outputs


def bent(x):
    scene, beam = scene_of(x)
    scene.fix(beam.end, "y")
    return scene, {"moment": fb.Output("M", beam)}


def vibrating(x):
    return bent(x)[0]


def shaken(x):
    scene, beam = scene_of(x)
    scene.fix(beam.end, "y")
    return scene, (beam.node(0.5), (0.0, 1.0)), beam.node(0.5)


def hardening(x):
    scene = fb.Scene()
    body = scene.add_body((0, 0), mass=x[1], inertia=1.0)
    spring = fb.Spring(stiffness=x[0], strain_energy=lambda s: s**4 / 4)
    scene.add_joint(fb.Prismatic(fb.GROUND, body.centre, axis=(1, 0), spring=spring))
    return scene, {"period": fb.Output("period", scene)}


def harmonic(scene):
    return fb.periodic(scene, mode=0, amplitude=1.0)


RESPONSES = {
    "motions": (fb.Response(swinging, **MOTION), 160),
    "equilibria": (fb.StaticResponse(bent, load_steps=2), 160),
    "modes": (fb.ModalResponse(vibrating, n=2), 160),
    "vibrations": (fb.HarmonicResponse(shaken, [1.0, 20.0]), 160),
    "periodic motions": (fb.PeriodicResponse(hardening, harmonic), 16),
}


def arrays_of(result):
    """All arrays of what a response gives, in order."""
    if isinstance(result, dict):
        result = tuple(result.values())
    return sum(map(arrays_of, result), []) if isinstance(result, tuple) else [np.asarray(result)]


def same(results, others):
    pairs = zip(arrays_of(results), arrays_of(others), strict=True)
    return all(np.array_equal(one, other) for one, other in pairs)


@pytest.mark.parametrize("kind", RESPONSES)
def test_calls_of_eight_threads_have_the_values_and_derivatives_of_one(kind):
    run, number = RESPONSES[kind]

    def call(x):
        return run(x), run.jacobian()

    # Modes keep the places of the call before, which is another one in each thread; these are
    # apart, and have the same places in any order.
    expected = [call(x) for x in X[:number]]
    stats = run.stats
    with ThreadPoolExecutor(8) as executor:
        results = list(executor.map(call, X[:number]))
    assert all(map(same, results, expected))
    assert same(run.jacobian(), expected[-1][1]) and run.stats is stats


def test_objectives_and_misfits_of_eight_threads_are_those_of_one():
    run = fb.Response(swinging, **MOTION)
    measured = run(X[0])[1]["end"]
    misfit = run.misfit({"end": measured}, 1e-3)

    def cost(t, y):
        gap = y["end"] - measured
        return (gap**2).sum(), {"end": 2 * gap}

    objective = run.objective(cost)

    def call(x):
        return objective(x), misfit(x), misfit.jacobian(x)

    expected = [call(x) for x in X[:40]]
    with ThreadPoolExecutor(8) as executor:
        assert all(map(same, executor.map(call, X[:40]), expected))


def test_a_jacobian_of_a_misfit_repeats_no_motion_in_its_thread():
    numbers = []

    def build(x):
        numbers.append(threading.get_ident())
        return swinging(x)

    run = fb.Response(build, **MOTION)
    misfit = run.misfit({"end": np.zeros((21, 2))})
    with ThreadPoolExecutor(1) as executor:
        J = misfit.jacobian(X[0])
        assert executor.submit(misfit.jacobian, X[0]).result() == pytest.approx(J, rel=1e-9)
        executor.submit(misfit, X[1]).result()
        misfit(X[2])
        before = len(numbers)
        J = executor.submit(misfit.jacobian, X[1]).result()
        assert len(numbers) == before  # the scene was built with slopes, and runs once
    misfit(X[1])
    assert misfit.jacobian(X[1]) == pytest.approx(J, rel=1e-9)


def test_a_thread_without_a_call_has_the_derivatives_of_the_first_one_and_waits_for_it():
    begun, goes_on = threading.Event(), threading.Event()

    def build(x):
        begun.set()
        assert goes_on.wait(60)
        return swinging(x)

    run = fb.Response(build, **MOTION)
    assert_refused("no motion yet", run.jacobian)
    goes_on.set()
    with ThreadPoolExecutor(1) as first, ThreadPoolExecutor(1) as second:
        first.submit(run, X[0]).result()
        rows = run.jacobian("end")["end"]
        assert run.stats is first.submit(lambda: run.stats).result()
        goes_on.clear(), begun.clear()
        going = first.submit(run, X[1])
        assert begun.wait(60)
        waiting = second.submit(run.jacobian, "end")
        goes_on.set()
        assert not np.array_equal(waiting.result()["end"], rows)
        going.result()
        assert np.array_equal(run.jacobian("end")["end"], waiting.result()["end"])
        second.submit(run, X[0]).result()
        assert second.submit(run.jacobian, "end").result()["end"] == pytest.approx(rows)
        assert np.array_equal(run.jacobian("end")["end"], waiting.result()["end"])


def test_a_failed_call_leaves_no_derivatives_in_its_thread_alone():
    run = fb.Response(swinging, **MOTION)
    run(X[0])
    rows = run.jacobian()

    def fail():
        assert_refused("rhoA = -1", run, [1.0, -1.0])
        assert_refused("no motion yet", run.jacobian)

    with ThreadPoolExecutor(1) as executor:
        executor.submit(fail).result()
    assert same(run.jacobian(), rows)


def test_states_of_threads_end_with_them_and_copies_know_of_no_call():
    run = fb.Response(swinging, **MOTION)
    run(X[0])
    alive = []

    def build(x):
        scene, outputs = swinging(x)
        alive.append(threading.current_thread())
        return scene, outputs

    for twin in copy.copy(run), pickle.loads(pickle.dumps(run)), copy.deepcopy(run):
        assert_refused("no motion yet", twin.jacobian)
        assert same(twin(X[0]), run(X[0]))
    other = fb.Response(build, **MOTION)
    for x in X[:4]:
        thread = threading.Thread(target=other, args=(x,))
        thread.start(), thread.join()
    assert len(set(alive)) == 4
    assert same(other.jacobian(), (run(X[0]), run.jacobian())[1])  # of the first thread


# -- Tables of parameters --------------------------------------------------------------------------


def with_functions(x):
    scene, outputs = swinging(x)
    return scene, outputs | {"forces": lambda solution: solution.resultants("beam 1").M}


@pytest.mark.parametrize("threads", [None, 1, 3])
@pytest.mark.parametrize("build", [swinging, with_functions])
def test_a_table_of_parameters_has_the_values_of_calls_in_its_order(build, threads):
    run, alone = (fb.Response(build, **MOTION) for _ in range(2))
    results = run.map(X[:20], threads=threads)
    expected = [alone(x) for x in X[:20]]
    assert all(map(same, results, expected))
    assert_refused("no motion yet", run.jacobian)
    run(X[0])
    rows, stats = run.jacobian("end"), run.stats
    assert all(map(same, run.map(X[:20].tolist(), threads), expected))
    assert same(run.jacobian("end"), rows) and run.stats is stats


def test_functions_that_round_otherwise_for_arrays_give_the_same_in_any_number_of_threads():
    def build(x):
        scene, outputs = swinging(x)
        scene.add_moment(scene.beams[0].end, lambda t: 30.0 * np.sin(8.0 * t) ** 3)
        return scene, outputs

    first, *others = (fb.Response(build, **MOTION).map(X[:40], k) for k in (None, 1, 2, 8))
    assert all(all(map(same, results, first)) for results in others)


@pytest.mark.parametrize("threads", [None, 2])
@pytest.mark.parametrize("kind", ["equilibria", "periodic motions"])
def test_equilibria_and_periodic_motions_have_tables(kind, threads):
    run, _ = RESPONSES[kind]
    assert all(map(same, run.map(X[:4], threads), [run(x) for x in X[:4]]))


@pytest.mark.parametrize("threads", [None, 1, 3])
def test_an_error_in_one_case_is_that_of_the_case_alone(threads):
    def build(x):
        if x[0] < 0:
            raise ZeroDivisionError("one over nothing")
        return swinging(x)

    table = X[:12].copy()
    table[0, 1], table[4, 0], table[7, 1], table[11, 1] = -1.0, -1.0, np.nan, 1e-300
    run = fb.Response(build, max_halvings=0, **MOTION)
    results = run.map(table, threads)
    kinds = {i: type(result) for i, result in enumerate(results) if isinstance(result, Exception)}
    kinds.pop(11, None)  # it may run or not
    assert kinds == {0: fb.SceneError, 4: ZeroDivisionError, 7: fb.SceneError}
    assert "finite" in str(results[7])
    for i in {*range(11)} - kinds.keys():
        assert same(results[i], run(table[i]))


def test_ctrl_c_ends_a_table_after_the_cases_that_run():
    called = []

    def build(x):
        called.append(x)
        if len(called) == 5:
            os.kill(os.getpid(), signal.SIGINT)
        return swinging(x)

    run = fb.Response(build, **MOTION)
    with pytest.raises(KeyboardInterrupt):
        run.map(np.ones((10_000, 2)), threads=2)
    number = len(called)
    assert 5 <= number < 10_000
    assert [thread.name for thread in threading.enumerate() if "Pool" in thread.name] == []
    assert len(run.map(X[:3], threads=2)) == 3 and len(called) == number + 3


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (([1.0, 2.0],), "must be a table"),
        (("abc",), "an array of numbers"),
        (([[1.0], [1.0, 2.0]],), "an array of numbers"),
        ((X, 0), "threads = 0 must be a whole number from 1"),
        ((X, True), "threads = True must be"),
        ((X, 1.5), "threads = 1.5 must be"),
    ],
)
def test_what_is_no_table_or_number_of_threads_is_refused(arguments, reason):
    assert_refused(reason, fb.Response(swinging, **MOTION).map, *arguments)
