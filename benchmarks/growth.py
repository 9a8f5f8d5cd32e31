"""How cost grows with the number of things: set-up, a step, an equilibrium, modes, gradient, files.

    .venv/bin/python benchmarks/growth.py [--quick] [kind ...]

Each row is a scene with n things of one kind, in a process of its own, at sizes that differ by
factors of 4. Beside each row is the exponent p of cost ~ n^p from the row above. Processor times in
milliseconds; `--quick` counts memory only, at small sizes: the largest number of bytes in arrays of
NumPy, which does not depend on the clock. A cost that another one repeats is left out ("-").
"""

import argparse
import math
import subprocess
import sys
import tempfile
import tracemalloc
from contextlib import suppress
from pathlib import Path
from time import process_time

import numpy as np

import fx_beam as fb

SECTION = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
DT, STEPS = 1e-3, 10
#: Longest time of a cost [s], after which larger sizes are left out.
LONGEST = 30.0


# -- Scenes ----------------------------------------------------------------------------------------


def elements(n):
    """A beam of n elements on two supports."""
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), (1, 0)], SECTION, elements=n)
    scene.pin(beam.start)
    scene.fix(beam.end, "y")
    return scene, beam.node(0.5)


def chain(n):
    """n rigid links on hinges; the first hangs on the ground."""
    scene, last = fb.Scene(gravity=(0, -9.81)), None
    for k in range(n):
        link = scene.add_body((0, -k - 0.5), 1.0, 0.1, points={"top": (0, -k), "end": (0, -k - 1)})
        if last is None:
            scene.pin(link["top"])
        else:
            scene.add_joint(fb.Revolute(last["end"], link["top"]))
        last = link
    return scene, last.centre


def ladder(n):
    """n closed loops one after the other: two chains of links, with rungs on hinges."""
    scene, ends = fb.Scene(gravity=(0, -9.81)), []
    for x in (0.0, 1.0):
        for k in range(n):
            points = {"top": (x, -k), "end": (x, -k - 1)}
            link = scene.add_body((x, -k - 0.5), 1.0, 0.1, points=points)
            if k == 0:
                scene.pin(link["top"])
            else:
                scene.add_joint(fb.Revolute(ends[-1]["end"], link["top"]))
            ends.append(link)
    for left, right in zip(ends[:n], ends[n:], strict=True):
        y = left["end"].y
        rung = scene.add_body((0.5, y), 1.0, 0.1, points={"left": (0, y), "right": (1, y)})
        scene.add_joint(fb.Revolute(left["end"], rung["left"]))
        scene.add_joint(fb.Revolute(right["end"], rung["right"]))
    return scene, ends[-1].centre


def lattice(n):
    """A square of about n struts, which are rigidly joined."""
    side = max(2, round(math.sqrt(n / 2)))
    number = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    points = np.stack(np.meshgrid(np.arange(side + 1.0), np.arange(side + 1.0)), -1).reshape(-1, 2)
    pairs = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:])]
    cells = np.concatenate([np.stack([a.ravel(), b.ravel()], 1) for a, b in pairs])
    scene = fb.Scene(gravity=(0, -9.81))
    struts = scene.add_mesh(points, cells, SECTION)
    for corner in (0, side):
        scene.clamp(struts.nodes[corner])
    return scene, struts.nodes[-1]


def sliders(n):
    """n bodies that slide on a beam of 2 n elements."""
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), (n, 0)], SECTION, elements=2 * n)
    scene.clamp(beam.start)
    scene.clamp(beam.end)
    for k in range(n):
        body = scene.add_body((k + 0.25, 0), 0.1, 0.01).centre
        scene.fix(body, "rotation")
        scene.add_joint(fb.Slider(beam, body, spring=fb.Spring(100.0, rest=k + 0.25)))
    return scene, beam.node(0.5)


def contacts(n):
    """A beam of n elements that lies on the ground."""
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), (n, 0)], SECTION, elements=n)
    scene.fix(beam.start, "x")
    scene.add_contact(beam, fb.Line((0, 0), normal=(0, 1)), stiffness=1e5)
    return scene, beam.node(0.5)


def members(n):
    """A beam of n elements that lies on another one."""
    scene = fb.Scene(gravity=(0, -9.81))
    below = scene.add_beam([(0, 0), (n, 0)], SECTION, elements=n)
    above = scene.add_beam([(0, 0.1), (n, 0.1)], SECTION, elements=n)
    scene.clamp(below.start)
    scene.clamp(below.end)
    for end in (above.start, above.end):
        scene.pin(end)
    scene.add_contact(above, below, stiffness=1e5, radius=0.05)
    return scene, above.node(0.5)


def motors(n):
    """n bodies beside each other, each turned by a motor."""
    scene = fb.Scene()
    for k in range(n):
        body = scene.add_body((k, 0), 1.0, 0.1).centre
        scene.add_joint(fb.Revolute(fb.GROUND, body, motor=lambda t, k=k: 0.1 * t**2 * (1 + k)))
    return scene, body


def gears(n):
    """n wheels in a row, each of which drives the next one."""
    scene, shafts = fb.Scene(gravity=(0, -9.81)), []
    for k in range(n):
        points = {"weight": (k + 0.5, 0)} if k == 0 else {}
        wheel = scene.add_body((k, 0), 1.0, 0.1, points=points)
        shafts.append(scene.add_joint(fb.Revolute(fb.GROUND, wheel.centre)))
        if k == 0:
            node = wheel["weight"]
            scene.add_mass(node, 1.0)
        else:
            scene.add_joint(fb.Gear(shafts[-2], shafts[-1], ratio=-1.001))
    return scene, node


def springs(n):
    """n bodies in a row, with springs between them and to the ground."""
    scene, last = fb.Scene(gravity=(0, -9.81)), None
    for k in range(n):
        body = scene.add_body((k, 0), 1.0, 0.1).centre
        scene.add_force_between(body, (k, 1), spring=fb.Spring(1e3, rest=1.0))
        if last is not None:
            scene.add_force_between(last, body, spring=fb.Spring(1e3, rest=1.0))
        scene.fix(body, "rotation")
        last = body
    return scene, last


KINDS = {f.__name__: f for f in (elements, chain, ladder, lattice)}
KINDS |= {f.__name__: f for f in (sliders, contacts, members, motors, gears, springs)}
SIZES = {name: (64, 256, 1024, 4096) for name in KINDS}
SIZES |= {"sliders": (8, 32, 128, 512), "elements": (256, 1024, 4096, 16384)}
QUICK = {name: (32, 128, 512) for name in KINDS} | {"sliders": (8, 32, 128)}


# -- Costs -----------------------------------------------------------------------------------------


def moved(scene, steps=STEPS):
    return fb.simulate(scene, dt=DT, t_end=steps * DT)


def gradient(make, n):
    """A derivative by gravity of the end of a motion."""

    def build(x):
        scene, node = make(n)
        scene.add_force(node, (0.0, x[0]))
        return scene, {"y": fb.Output("position", node)}

    response = fb.Response(build, dt=DT, t_end=STEPS * DT)
    t, y = response([1.0])
    weights = np.zeros_like(y["y"])
    weights[-1, 1] = 1.0
    response.vjp({"y": weights})


def files(solution):
    with tempfile.TemporaryDirectory() as folder:
        solution.save(Path(folder) / "motion.npz")
        solution.to_paraview(Path(folder) / "motion.pvd")


def costs(make, n):
    """Functions by the names of the costs; each may be refused by a scene."""
    scene, _ = make(n)
    solutions, states = [], [None]
    yield "build", lambda: make(n)
    yield "set-up", lambda: solutions.append(moved(scene, 1))
    yield "10 steps", lambda: solutions.append(moved(scene))
    yield "static", lambda: states.append(fb.static(scene, load_steps=1))
    yield "modes", lambda: fb.modes(scene, states[-1], n=4)
    yield "gradient", lambda: gradient(make, n)
    yield "files", lambda: files(solutions[-1])
    yield "picture", lambda: fb.plot.shapes(solutions[-1], rows=[0, -1 % len(solutions[-1].t)])


NAMES = "build", "set-up", "10 steps", "static", "modes", "gradient", "files", "picture"


def seconds(run):
    begin = process_time()
    run()
    return process_time() - begin


def peak(run):
    """Largest number of bytes in arrays at a time."""
    tracemalloc.start()
    try:
        run()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def measure(kind, n, count):
    """Costs of a scene by their names; nan for what the scene refuses."""
    make, values = KINDS[kind], {}
    for _, run in costs(make, 4):  # loads and compiles
        with suppress(ValueError, RuntimeError):
            run()
    for name, run in costs(make, n):
        try:
            values[name] = count(run)
        except (ValueError, RuntimeError) as error:
            print(f"# {kind} {n} {name}: {str(error)[:150]}", file=sys.stderr)
            values[name] = math.nan
        if count is seconds and values[name] > LONGEST:
            break
    return values


def exponent(before, now, ratio):
    """p of cost ~ n^p."""
    return math.log(now / before) / math.log(ratio) if before > 0 and now > 0 else math.nan


def measured(kind, n, quick):
    """Measurement in a process of its own."""
    command = [sys.executable, __file__, "--one", kind, str(n)] + ["--quick"] * quick
    done = subprocess.run(command, capture_output=True, text=True)
    sys.stderr.write("".join(f"{x}\n" for x in done.stderr.splitlines() if x.startswith("#")))
    if done.returncode:
        raise RuntimeError(done.stderr)
    return {k: float(v) for k, v in (line.split("\t") for line in done.stdout.splitlines())}


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("kinds", nargs="*", default=[*KINDS])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.one:
        kind, n = chosen.kinds
        for name, value in measure(kind, int(n), peak if chosen.quick else seconds).items():
            print(name, value, sep="\t")
        return
    print(f"{'[kB]' if chosen.quick else '[ms]':18}" + "".join(f"{name:>17}" for name in NAMES))
    for kind in chosen.kinds:
        before, last = {}, 0
        for n in (QUICK if chosen.quick else SIZES)[kind]:
            values, words = measured(kind, n, chosen.quick), []
            for name in NAMES:
                value = values.get(name, math.nan)
                p = exponent(before.get(name, 0), value, n / last) if last else math.nan
                unit = 1e-3 if chosen.quick else 1e3
                words.append(f"{unit * value:11.4g}" + (f" n^{p:.1f}" if p == p else "     "))
            print(f"{kind:9}{n:9}" + "".join(f"{word:>17}" for word in words), flush=True)
            before, last = values, n
            if not chosen.quick and max(values.values()) > LONGEST:
                break


if __name__ == "__main__":
    main()
