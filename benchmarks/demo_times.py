"""Time and iterations of the analyses of all demos, of this version against another one.

    .venv/bin/python benchmarks/demo_times.py <folder of the other version> [demo ...]

Each version computes its own demos, in processes that take turns. What a demo asks of `simulate`,
`static` and other functions is done three times; the least processor time counts. A row is a demo:
the times of both versions [s], their ratio, corrections by Newton's method, and the largest ratio
of a call. Demos that ask for other analyses in the other version cannot be compared, nor those
whose scene allows an analysis only once.
"""

import importlib
import json
import os
import subprocess
import sys
from pathlib import Path
from time import thread_time

ROOT = Path(__file__).resolve().parents[1]
TIMED = ("simulate", "static", "modes", "periodic", "frequency_response", "backbone")
REPEATS = 3


def timed(name, function, calls):
    """The function, which adds its name, least time [s] and corrections to calls."""

    def repeated(*arguments, **options):
        seconds = []
        for _ in range(REPEATS):
            started = thread_time()
            result = function(*arguments, **options)
            seconds.append(thread_time() - started)
        corrections = getattr(getattr(result, "stats", None), "newton_iterations", 0)
        calls.append((name, min(seconds), corrections))
        return result

    return repeated


def serve(name):
    """Compute a demo; write what its calls took, as far as it goes."""
    import fx_beam as fb

    calls = []
    for function in TIMED:
        setattr(fb, function, timed(function, getattr(fb, function), calls))
    try:
        importlib.import_module(name).compute()
    finally:
        print(json.dumps(calls))


def asked(folder, name):
    """The calls of a demo of a version; none if it cannot be computed there."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join([str(folder), f"{folder}/demos"])}
    command = [sys.executable, __file__, "--serve", name]
    run = subprocess.run(command, capture_output=True, text=True, env=environment, check=False)
    return json.loads(run.stdout.splitlines()[-1]) if run.stdout else []


def main(other, *names):
    names = names or sorted(path.stem for path in (ROOT / "demos").glob("*.py"))
    print(f"{'':24}{'other':>9}{'this':>9}{'ratio':>8}{'corrections':>18}{'largest ratio':>15}")
    for name in names:
        before, after = asked(Path(other).resolve(), name), asked(ROOT, name)
        pairs = list(zip(before, after, strict=False))
        if not pairs or [call[0] for call in before] != [call[0] for call in after]:
            print(f"{name:24}{len(before):9}{len(after):9}  calls, which cannot be compared")
            continue
        old, new = (sum(call[1] for call in calls) for calls in (before, after))
        counts = "/".join(str(sum(call[2] for call in calls)) for calls in (before, after))
        largest = max(b[1] / a[1] for a, b in pairs)
        row = f"{name:24}{old:9.3f}{new:9.3f}{new / old:8.2f}{counts:>18}{largest:15.2f}"
        print(row, flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["--serve"]:
        serve(sys.argv[2])
    else:
        main(*sys.argv[1:])
