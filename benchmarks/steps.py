"""Time per step of several scenes, of this version alone, against another one or another compiler.

    .venv/bin/python benchmarks/steps.py [folder of the other version | CC=compiler] [runs]

Each version runs in a process of its own. Both take turns, run by run. The processor time of the
compiled loop is measured, which other programs affect less; its least value is the most reliable.
"""

import contextlib
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
    ("pinned_beam", (128,), 0.001, 300, False),
    ("pinned_beam", (2048,), 0.001, 60, False),
    ("pendulum", (), 0.01, 2000, False),
    ("three_bar_swing", (), 5e-4, 1000, True),
    ("multibody", (), 0.001, 1000, False),
    ("slider_crank", (), 0.005, 300, False),
)


@contextlib.contextmanager
def timed_steps():
    """A list to which the processor times of blocks of steps [s] are added."""
    from fx_beam.step.stepper import CompiledLoop

    seconds, take = [], CompiledLoop.take_steps

    def timed(*arguments):
        started = thread_time()
        result = take(*arguments)
        seconds.append(thread_time() - started)
        return result

    CompiledLoop.take_steps = timed
    yield seconds
    CompiledLoop.take_steps = take


def serve():
    """Run the cases whose numbers are read; write microseconds and iterations per step."""
    from demo_scenes import scene

    import fx_beam as fb

    for line in sys.stdin:
        name, arguments, dt, steps, recorded = CASES[int(line)]
        record = fb.Record() if recorded else fb.Record(every=steps)
        made = scene(name, *arguments)
        with timed_steps() as seconds:
            stats = fb.simulate(made, dt=dt, t_end=steps * dt, record=record).stats
        print(1e6 * sum(seconds) / steps, stats.newton_iterations / steps, flush=True)


def start(other):
    name, _, compiler = str(other).partition("=")
    folder, variables = (ROOT, {name: compiler}) if compiler else (other, {})
    path = os.pathsep.join([str(folder), str(Path(folder) / "benchmarks")])
    command = [sys.executable, __file__, "--serve"]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    return subprocess.Popen(command, env=os.environ | {"PYTHONPATH": path} | variables, **pipes)


def ask(process, case):
    process.stdin.write(f"{case}\n")
    process.stdin.flush()
    return tuple(map(float, process.stdout.readline().split()))


def main(other=ROOT, runs=15):
    processes = start(other), start(ROOT)
    print(f"{'scene, dt':>27}{'before':>10}{'now':>10}  us   least  median ratio  iterations")
    for number, (name, arguments, dt, *_) in enumerate(CASES):
        for process in processes:
            ask(process, number)  # compiles
        rows = [[ask(process, number) for process in processes] for _ in range(runs)]
        before, now = (min(row[k][0] for row in rows) for k in range(2))
        ratio = median(row[1][0] / row[0][0] for row in rows)
        iterations = ", ".join(f"{count:.2f}" for _, count in rows[0])
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
        main(*sys.argv[1:2], *map(int, sys.argv[2:]))
