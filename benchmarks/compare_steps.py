"""Time per step of this version against another one.

    .venv/bin/python benchmarks/compare_steps.py <folder of the other version> [runs]

Each version runs in a process of its own. Both take turns, run by run. The processor time of the
compiled loop is measured, which other programs affect less; its least value is the most reliable.
"""

import os
import subprocess
import sys
from pathlib import Path
from statistics import median
from time import thread_time

ROOT = Path(__file__).resolve().parents[1]
# Scene of a demo, its arguments, step, number of steps, and whether everything is recorded.
CASES = (
    ("pinned_beam", (8,), 0.01, 1000, False),
    ("pinned_beam", (8,), 0.001, 2000, True),
    ("pinned_beam", (2048,), 0.001, 60, False),
    ("pendulum", (), 0.01, 2000, False),
    ("multibody", (), 0.001, 1000, False),
    ("slider_crank", (), 0.005, 300, False),
)


def serve():
    """Run the cases whose numbers are read; write microseconds and iterations per step."""
    from demo_scenes import scene

    import fx_beam as fb
    from fx_beam.step.loop import CompiledLoop
    from fx_beam.step.stepper import Stepper

    # Which of them takes the steps depends on the version.
    taker = CompiledLoop if hasattr(CompiledLoop, "march") else Stepper
    name = "advance" if hasattr(taker, "advance") else "march"
    advance, seconds = getattr(taker, name), []

    def timed(*arguments):
        started = thread_time()
        state = advance(*arguments)
        seconds.append(thread_time() - started)
        return state

    setattr(taker, name, timed)
    for line in sys.stdin:
        name, arguments, dt, steps, recorded = CASES[int(line)]
        seconds.clear()
        record = fb.Record() if recorded else fb.Record(every=steps)
        made = scene(name, *arguments)
        stats = fb.simulate(made, dt=dt, t_end=steps * dt, record=record).stats
        print(1e6 * sum(seconds) / steps, stats.newton_iterations / steps, flush=True)


def start(folder):
    path = os.pathsep.join([str(folder), str(Path(folder) / "benchmarks")])
    command = [sys.executable, __file__, "--serve"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, env=os.environ | {"PYTHONPATH": path}, **pipes)


def ask(process, case):
    process.stdin.write(f"{case}\n")
    process.stdin.flush()
    return tuple(map(float, process.stdout.readline().split()))


def main(other, runs=15):
    processes = start(other), start(ROOT)
    print(f"{'scene, dt':>27}{'before':>10}{'now':>10}  us   least  median ratio  iterations")
    for number, (name, arguments, dt, *_) in enumerate(CASES):
        for process in processes:
            ask(process, number)  # compiles
        rows = [[ask(process, number) for process in processes] for _ in range(runs)]
        before, now = (min(row[k][0] for row in rows) for k in range(2))
        ratio = median(row[1][0] / row[0][0] for row in rows)
        iterations = ", ".join(f"{of:.2f}" for _, of in rows[0])
        what = " ".join(map(str, (name, *arguments)))
        print(f"{what:>20}, {dt:5}{before:10.2f}{now:10.2f}", end="")
        print(f"{now / before:10.3f}{ratio:9.3f}         {iterations}")
    for process in processes:
        process.stdin.close()
        process.wait()


if __name__ == "__main__":
    if sys.argv[1:] == ["--serve"]:
        serve()
    else:
        main(sys.argv[1], *map(int, sys.argv[2:]))
