"""Runs of one program: no run changes it, nor another run, in any order and in threads."""

import hashlib
import random
import sys
import threading
from collections.abc import Iterator

import numpy as np
import pytest
from derivatives import EXACT, outputs_of
from registry import ONES, SCENES

import fx_beam as fb
from fx_beam.step.program import PROGRAMS

# Other numbers, and places: x[5], x[7] and x[8] of the registry move nodes and joints.
OTHERS = 1.0 - 0.004 * np.arange(len(ONES))
STEPS = 6


def digest(solution) -> str:
    """All that a solution of a motion gives, also what is computed when it is read."""
    parts = [solution.recorded(name) for name in ("q", "v", "a", "slides", "joint_forces")]
    parts += [solution.reactions, *vars(solution.energy).values()]
    for name in solution.beams:
        resultants = solution.resultants(name)
        parts += [resultants.N, resultants.Q, resultants.M]
    end = vars(solution.end)
    parts += [end[name] for name in sorted(end) if isinstance(end[name], np.ndarray)]
    contents = (np.ascontiguousarray(part).tobytes() for part in parts)
    return hashlib.sha256(b"".join(contents)).hexdigest()


def arrays_in(thing: object, known: set[int], path: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """All arrays to which an object of the package refers, by where they are."""
    if id(thing) in known or isinstance(thing, fb.Scene):
        return
    known.add(id(thing))
    if isinstance(thing, np.ndarray):
        if thing.dtype != object:
            yield path, thing
        return
    if isinstance(thing, dict):
        parts = [(repr(key)[:30], value) for key, value in thing.items()]
    elif isinstance(thing, list | tuple):
        parts = [(str(i), value) for i, value in enumerate(thing)]
    elif type(thing).__module__.startswith(("fx_beam", "scipy.sparse")) and hasattr(
        thing, "__dict__"
    ):
        parts = [*vars(thing).items()]
    else:
        return
    for name, part in parts:
        if name not in ("_memories", "facts", "_last", "_columns"):  # caches
            yield from arrays_in(part, known, f"{path}.{name}")


def bytes_of(program) -> dict[str, str]:
    """Contents of the arrays of a program, and of the structs in C."""
    contents = {path: array.tobytes() for path, array in arrays_in(program, set())}
    for kind, (problem, _) in program._problems.items():
        contents[f"{kind} struct"] = bytes(problem.ffi.buffer(problem.c))
        for i, thing in enumerate(problem.structs._referenced):
            if not isinstance(thing, np.ndarray):
                contents[f"{kind} struct {i}"] = bytes(problem.ffi.buffer(thing))
    return {name: hashlib.sha256(content).hexdigest() for name, content in contents.items()}


@pytest.mark.parametrize("name", SCENES)
def test_no_run_changes_its_program_or_another_run(name):
    case = SCENES[name]

    def run(x, **options):
        how = {"dt": case.dt, "t_end": STEPS * case.dt} | options
        return fb.simulate(case.build(x), case.scheme(), **how)

    PROGRAMS.clear()
    first = digest(run(ONES))
    ((_, program),) = PROGRAMS._entries
    before = bytes_of(program)
    solutions = [run(x) for x in (OTHERS, ONES, OTHERS)]
    unread, read = [run(ONES)], []

    def reading(t, y):
        if t > 2 * case.dt and unread:  # between the steps of a run with other numbers
            read.append(digest(unread.pop()))
        return 1.0

    run(OTHERS, until=reading)
    others, again, last = (digest(solution) for solution in reversed(solutions))
    assert [first] * 2 == [again, *read]
    assert others == last != first
    after = bytes_of(program)
    assert [name for name in before if before[name] != after.get(name)] == []


@pytest.mark.parametrize("name", [name for name in SCENES if "newmark" not in name][::3])
def test_derivatives_are_the_same_whatever_other_responses_do(name):
    case = SCENES[name]
    if not case.scheme().rates.mean_based:
        pytest.skip("the Newmark family has no derivatives")

    def response():
        how = {"dt": case.dt, "t_end": STEPS * case.dt, "newton": EXACT}
        build = lambda x: ((scene := case.build(x)), outputs_of(scene))  # noqa: E731
        return fb.Response(build, case.scheme(), **how)

    expected = {}
    for k, x in enumerate((ONES, OTHERS)):
        run = response()
        run(x)
        expected[k] = run.jacobian()
    runs = response(), response()
    for run, x in zip(runs, (ONES, OTHERS), strict=True):
        run(x)
    for k, run in reversed([*enumerate(runs)]):
        for output, rows in run.jacobian().items():
            np.testing.assert_array_equal(rows, expected[k][output], err_msg=output)


def test_ten_threads_have_the_bits_of_one():
    """Runs and late readings, of several programs, with numbers that differ from run to run."""
    names = ["pinned beam", "closed loop", "slider on a beam", "stop of a joint", "planetary gear"]
    cases = [(name, tuple(1 - 1e-3 * k * np.arange(9))) for name in names for k in range(3)]

    def run(name, x):
        case = SCENES[name]
        scene = case.build(np.array(x))
        return fb.simulate(scene, case.scheme(), dt=case.dt, t_end=STEPS * case.dt)

    expected = {case: digest(run(*case)) for case in cases}
    wrong, errors = [], []

    def work(seed):
        order = random.Random(seed).sample(cases, len(cases))
        try:
            solutions = [(case, run(*case)) for case in order]
            wrong.extend(case for case, solution in solutions if digest(solution) != expected[case])
        except BaseException as error:  # noqa: BLE001
            errors.append(error)

    interval = sys.getswitchinterval()
    sys.setswitchinterval(1e-5)
    try:
        threads = [threading.Thread(target=work, args=(seed,)) for seed in range(10)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    finally:
        sys.setswitchinterval(interval)
    assert not errors
    assert not wrong
