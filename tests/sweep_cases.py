"""What the workers of the tests of sweeps compute: they import it from this file."""

import os
import signal
import time
from functools import partial

import scenes

import fx_beam as fb
from fx_beam.step.tangent_storage import thread_count


def fate(case):
    """The times of a case, or its fate."""
    began = time.monotonic()
    if case["fate"] == "killed":
        os.kill(os.getpid(), signal.SIGKILL)
    if case["fate"] == "broken":
        raise ZeroDivisionError("one over nothing")
    if case["fate"] == "no file":
        return open
    if case["fate"] == "slow":
        time.sleep(0.1)
    threads = os.environ["OMP_NUM_THREADS"]
    return {
        "began": began,
        "ended": time.monotonic(),
        "worker": os.getpid(),
        "threads": threads,
        "own_threads": thread_count(),
        "cpus": sorted(os.sched_getaffinity(0)),
    }


def arm(case):
    """The end of a pinned beam of some stiffness, with some initial speed."""
    scene = fb.Scene()
    section = fb.Section(EA=case["EA"], GA=1e7, EI=1.3e7, rhoA=0.05, rhoI=1 / 60)
    beam = scene.add_beam([(0, 0), (100, 0)], section, elements=3)
    scene.pin(beam.start)
    speed = case["speed"]
    scene.set_velocity(beam, lambda x, y: (0, speed * x), spin=lambda x, y: speed)
    solution = fb.simulate(scene, dt=0.01, t_end=0.1)
    x, y = solution.position(beam.end)[-1]
    return {"x": x, "y": y}


def pendulum(EA):
    """The scene of a pendulum of some stiffness."""
    return scenes.pendulum(EA)[0]


def swings():
    """Cases of a study of stability."""
    from fx_beam_studies import stability

    return [
        stability.Case("EA", f"{EA:g}", partial(pendulum, EA), dt=0.1, t_end=1.0)
        for EA in (1e4, 1e10)
    ]


def killer():
    """A scene that is the end of its worker."""
    os.kill(os.getpid(), signal.SIGKILL)


def short(case):
    """A number at once, or what its case is the fate of."""
    if case["number"] == 77:
        os.kill(os.getpid(), signal.SIGKILL)
    return (lambda: None) if case["number"] == 50 else 2 * case["number"]


def waits(case):
    """Leave a file, and wait until so many others have left theirs; at most 60 s."""
    until, seen = time.monotonic() + 60, 0
    while seen < case["others"] and time.monotonic() < until:
        time.sleep(0.05)
        seen = len(os.listdir(case["folder"]))
    with open(os.path.join(case["folder"], str(case["number"])), "w"):
        pass
    return {"seen": seen, "worker": os.getpid()}
