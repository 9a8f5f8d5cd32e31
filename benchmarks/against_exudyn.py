"""Error and run time of a flexible pendulum, by fx_beam and by Exudyn.

    python3 -m venv somewhere && somewhere/bin/pip install exudyn
    .venv/bin/python benchmarks/against_exudyn.py somewhere/bin/python    ten minutes

The pendulum is that of Exudyn's example pendulumGeomExactBeam2D.py: 0.5 m of a soft strip, let go
from the horizontal; here it moves for one second. The error
is the largest distance of the tip from the reference at 50 times, over the length. The run time is
that from an empty scene or system to the end of the motion, in a process that has imported its
package; fx_beam has also compiled its elements, which it does once on a machine. Each code runs
many meshes and steps: Exudyn with its cable and with its geometrically exact beams of two and three
nodes, full and modified Newton, dense and sparse matrices; fx_beam with degrees 1 to 3 and schemes
of order 2 and 4. For each bound of the error the cheapest runs of each code are repeated in turn,
and the best median counts. The reference is by fx_beam, with a finer mesh and finer steps; the
least error of Exudyn shows that both codes compute the same motion. The time of a process that only
imports its package, and that of fx_beam's first run on a machine, are given as well.
"""

import itertools
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass, field
from statistics import median
from time import perf_counter

import numpy as np
from demo_scenes import ROOT

import fx_beam as fb
from fx_beam_studies import reporting

LENGTH, HEIGHT, WIDTH = 0.5, 2e-3, 10e-3  # [m]
SECTION = fb.Section.rectangle(height=HEIGHT, width=WIDTH, E=1e8, nu=0.3, rho=1000.0)
GRAVITY = 9.81  # [m/s^2]
T_END, ROWS = 1.0, 50  # [s]
BOUNDS = 1e-2, 1e-3, 1e-4  # of the error
STEPS = 50, 100, 150, 200, 300, 400, 600, 800, 1200, 1600, 3200
SCHEMES = {"order 2": fb.EnergyMomentum(), "order 4": fb.EnergyMomentum(order=4)}
OURS = {1: (8, 16, 32, 64, 128), 2: (4, 8, 16, 32), 3: (2, 4, 8, 16)}  # elements by degree
THEIRS = {
    "cable": (4, 8, 16, 32),
    "beam, 2 nodes": (8, 16, 32, 64, 128),
    "beam, 3 nodes": (4, 8, 16, 32),
}
REPEATED, ROUNDS = 4, 15
EXUDYN = "Exudyn"


@dataclass
class Run:
    """A way to compute the motion: its name, what runs it, and what was measured."""

    code: str
    name: str
    compute: callable
    error: float = np.inf
    seconds: list = field(default_factory=list)

    def measure(self, reference):
        seconds, tip = self.compute()
        self.seconds.append(seconds)
        if tip is not None:
            self.error = float(np.hypot(*(np.array(tip) - reference).T).max() / LENGTH)


def ours(degree, elements, scheme, steps):
    """Seconds and rows of the tip by fx_beam."""
    clock = perf_counter()
    scene = fb.Scene(gravity=(0.0, -GRAVITY))
    strip = scene.add_beam([(0, 0), (LENGTH, 0)], SECTION, elements=elements, degree=degree)
    scene.pin(strip.start)
    try:
        solution = fb.simulate(scene, scheme, dt=T_END / steps, t_end=T_END)
    except fb.StepError:
        return perf_counter() - clock, None
    return perf_counter() - clock, solution.position(strip.end)[:: steps // ROWS]


class Exudyn:
    """A process with Exudyn."""

    def __init__(self, python):
        script = ROOT / "benchmarks" / "exudyn_pendulum.py"
        self.process = subprocess.Popen(
            [python, str(script)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.version = self.answer()["version"]

    def answer(self):
        for line in self.process.stdout:
            if line.startswith("= "):
                return json.loads(line[2:])
        raise SystemExit("Exudyn ended without an answer")

    def run(self, **case):
        self.process.stdin.write(json.dumps(case) + "\n")
        self.process.stdin.flush()
        answer = self.answer()
        return answer["seconds"], answer["tip"]


def runs(exudyn):
    for degree, meshes in OURS.items():
        for elements, (order, scheme), steps in itertools.product(meshes, SCHEMES.items(), STEPS):
            name = f"{elements} elements of degree {degree}, {steps} steps of {order}"
            choice = degree, elements, scheme, steps
            yield Run("fx_beam", name, lambda choice=choice: ours(*choice))
    fixed = {
        "length": LENGTH,
        "section": {name: getattr(SECTION, name) for name in ("EA", "GA", "EI", "rhoA", "rhoI")},
        "gravity": GRAVITY,
        "t_end": T_END,
        "rows": ROWS,
        "spectral radius": 0.9,
    }
    for kind, meshes in THEIRS.items():
        for elements, steps, modified, matrix in itertools.product(
            meshes, STEPS, (True, False), ("EXUdense", "EigenSparse")
        ):
            if matrix == "EXUdense" and elements > 32:
                continue  # slower in all cases that were tried
            case = fixed | {
                "kind": kind.partition(",")[0],
                "degree": 2 if "3" in kind else 1,
                "elements": elements,
                "steps": steps,
                "modified Newton": modified,
                "matrix": matrix,
            }
            newton = "modified" if modified else "full"
            name = f"{kind}, {elements} elements, {steps} steps, {newton} Newton, {matrix}"
            yield Run(EXUDYN, name, lambda case=case: exudyn.run(**case))


def starts(python):
    """Seconds of processes that import a package, and of fx_beam's first run, which compiles."""
    first = "import sys; sys.path.insert(0, sys.argv[1]); import against_exudyn as a; "
    first += "a.ours(2, 8, a.SCHEMES['order 2'], 400)"
    commands = {
        "import fx_beam": [sys.executable, "-c", "import fx_beam"],
        "import exudyn": [python, "-c", "import exudyn"],
        "import and run fx_beam": [sys.executable, "-c", first, str(ROOT / "benchmarks")],
    }
    times = {name: [] for name in [*commands, "the same, nothing compiled"]}

    def run(name, command, **environment):
        clock = perf_counter()
        subprocess.run(command, check=True, capture_output=True, env=os.environ | environment)
        times[name].append(perf_counter() - clock)

    for _ in range(5):
        for name, command in commands.items():
            run(name, command)
        with tempfile.TemporaryDirectory() as empty:
            *_, command = commands.values()
            run("the same, nothing compiled", command, XDG_CACHE_HOME=empty)
    return {name: round(median(seconds), 2) for name, seconds in times.items()}


def best(all_runs, code, bound, count):
    """The cheapest runs of a code whose error is below a bound."""
    good = [run for run in all_runs if run.code == code and run.error < bound]
    return sorted(good, key=lambda run: median(run.seconds))[:count]


def main(python):
    exudyn, codes = Exudyn(python), ("fx_beam", EXUDYN)
    reference = ours(3, 64, SCHEMES["order 4"], 8000)[1]
    coarser = ours(3, 32, SCHEMES["order 4"], 4000)[1]
    all_runs = list(runs(exudyn))
    for degree, scheme in itertools.product(OURS, SCHEMES.values()):
        ours(degree, 2, scheme, ROWS)  # compiles
    for run in all_runs:
        run.measure(reference)
    closest = {code: min(run.error for run in all_runs if run.code == code) for code in codes}
    repeated = [
        run for bound in BOUNDS for code in codes for run in best(all_runs, code, bound, REPEATED)
    ]
    for run in repeated:
        run.seconds.clear()
    for _, run in itertools.product(range(ROUNDS), repeated):
        run.measure(reference)

    again = set(map(id, repeated))
    all_runs = [run for run in all_runs if id(run) in again]
    rows = []
    for bound in BOUNDS:
        fastest = [best(all_runs, code, bound, 1) for code in codes]
        times = [1e3 * median(run.seconds) for chosen in fastest for run in chosen]
        rows += [
            {
                "error below": f"{bound:g}",
                "code": run.code,
                "cheapest run": run.name,
                "error": f"{run.error:.1e}",
                "ms": f"{time:.1f}",
                "over fx_beam": f"{time / times[0]:.1f}",
            }
            for (run,), time in zip(fastest, times, strict=True)
        ]
    summary = {
        "machine": reporting.machine(),
        "exudyn": exudyn.version,
        "difference of the reference from half its mesh and steps": float(
            abs(reference - coarser).max() / LENGTH
        ),
        "least error": closest,
        "starts [s]": starts(python),
        "rows": rows,
    }
    folder = ROOT / "results" / "against_exudyn"
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "against_exudyn.json").write_text(json.dumps(summary, indent=2) + "\n")
    print(json.dumps(summary, indent=2))


if __name__ == "__main__":
    if len(sys.argv) != 2:
        raise SystemExit(__doc__)
    main(sys.argv[1])
