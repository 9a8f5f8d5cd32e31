"""How the cost of each public call grows with the number of things in a scene.

    .venv/bin/python benchmarks/growth.py [--quick] [--only COST ...] [kind ...]

A table for each kind of thing, a line for each call, a column for each number n of things, in a
process of its own; numbers differ by factors of 4. Behind a cost is the exponent p of cost ~ n^p
from the one before. Processor times in milliseconds; `--quick` counts memory only, at small sizes:
the largest number of bytes in arrays of NumPy, which does not depend on the clock. What a scene
refuses is nan. Exponents above 1.2 have their reason on docs/limits.md.
"""

import argparse
import copy
import gc
import math
import pickle
import subprocess
import sys
import tempfile
import tracemalloc
from contextlib import suppress
from functools import partial
from pathlib import Path
from time import process_time

import numpy as np

import fx_beam as fb

SECTION = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
DT, STEPS = 1e-3, 10
#: What says that a scene cannot do something.
REFUSED = ValueError, RuntimeError, IndexError, MemoryError


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


def ladder(n, spring=None, gravity=-9.81):
    """n closed loops one after the other: two chains of links, with rungs on hinges."""
    scene, ends = fb.Scene(gravity=(0, gravity)), []

    def hinge(a, b):
        scene.add_joint(fb.Revolute(a, b, spring=spring))

    for x in (0.0, 1.0):
        for k in range(n):
            points = {"top": (x, -k), "end": (x, -k - 1)}
            link = scene.add_body((x, -k - 0.5), 1.0, 0.1, points=points)
            if k == 0 and spring is None:
                scene.pin(link["top"])
            else:
                hinge(ends[-1]["end"] if k else fb.GROUND, link["top"])
            ends.append(link)
    for left, right in zip(ends[:n], ends[n:], strict=True):
        y = left["end"].y
        rung = scene.add_body((0.5, y), 1.0, 0.1, points={"left": (0, y), "right": (1, y)})
        hinge(left["end"], rung["left"])
        hinge(right["end"], rung["right"])
    return scene, ends[-1].centre


def tower(n):
    """A ladder that stands on the ground, by springs of stiffness n^2 in all hinges."""
    return ladder(n, fb.Spring(float(n**2)), gravity=9.81)


def square(n):
    """Points, and pairs of their numbers, of a square of about n struts; and two corners."""
    side = max(2, round(math.sqrt(n / 2)))
    number = np.arange((side + 1) ** 2).reshape(side + 1, side + 1)
    points = np.stack(np.meshgrid(np.arange(side + 1.0), np.arange(side + 1.0)), -1).reshape(-1, 2)
    pairs = [(number[:, :-1], number[:, 1:]), (number[:-1], number[1:])]
    cells = np.concatenate([np.stack([a.ravel(), b.ravel()], 1) for a, b in pairs])
    return points, cells, (0, side)


def lattice(n, joints="rigid"):
    """A square of about n struts, which are rigidly joined."""
    points, cells, corners = square(n)
    scene = fb.Scene(gravity=(0, -9.81))
    struts = scene.add_mesh(points, cells, SECTION, joints=joints)
    for corner in corners:
        scene.clamp(struts.nodes[corner])
    return scene, struts.nodes[-1]


def bars(n):
    """A square of about n rigid bars on hinges with springs: closed loops on all sides."""
    points, cells, corners = square(n)
    scene, nodes = fb.Scene(gravity=(0, -9.81)), [[] for _ in points]
    for k in corners:
        nodes[k].append(fb.GROUND)
    # Crooked: bars in one line are a singular position.
    points = points + 0.05 * np.sin(np.outer(np.arange(len(points)), (1.3, 2.1)))
    for a, b in cells:
        ends = {"a": points[a], "b": points[b]}
        bar = scene.add_body((points[a] + points[b]) / 2, 1.0, 0.1, points=ends)
        nodes[a].append(bar["a"])
        nodes[b].append(bar["b"])
    for first, *others in nodes:
        for other in others:
            scene.add_joint(fb.Revolute(first, other, spring=fb.Spring(1e4)))
    return scene, bar.centre


def truss(n):
    """A square of about n struts on hinges, which springs hold."""
    scene, node = lattice(n, "pin")
    for point in scene.nodes:
        scene.add_spring(point, x=fb.Spring(1e3), y=fb.Spring(1e3), rotation=fb.Spring(1.0))
    return scene, node


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
    """A beam of n elements that lies on another one, which lies on a bed."""
    scene = fb.Scene(gravity=(0, -9.81))
    below = scene.add_beam([(0, 0), (n, 0)], SECTION, elements=n)
    above = scene.add_beam([(0, 0.1), (n, 0.1)], SECTION, elements=n)
    scene.add_bed(below, normal=1e4, tangential=1e4)
    for end in (above.start, above.end):
        scene.fix(end, "x")
    scene.add_contact(above, below, stiffness=1e5, radius=0.05)
    return scene, above.node(0.5)


def turned(k, t):
    """Angle of the motor with the number k."""
    return 0.1 * t**2 * (1 + k)


def motors(n):
    """n bodies beside each other, each turned by a motor."""
    scene = fb.Scene()
    for k in range(n):
        body = scene.add_body((k, 0), 1.0, 0.1).centre
        scene.add_joint(fb.Revolute(fb.GROUND, body, motor=partial(turned, k)))
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


KINDS = {f.__name__: f for f in (elements, chain, ladder, tower, bars, lattice, truss)}
KINDS |= {f.__name__: f for f in (sliders, contacts, members, motors, gears, springs)}
SIZES = {name: (64, 256, 1024, 4096) for name in KINDS}
SIZES |= {"sliders": (32, 128, 512, 2048), "elements": (256, 1024, 4096, 16384)}
SIZES |= {"bars": (32, 128, 512, 2048)}
QUICK = {name: (32, 128, 512) for name in KINDS} | {"sliders": (8, 32, 128)}


# -- Costs -----------------------------------------------------------------------------------------


def moved(scene, steps=STEPS):
    return fb.simulate(scene, dt=DT, t_end=steps * DT)


def gradient(make, n, numbers):
    """A derivative of the end of a motion by some numbers: parts of the force on a node."""

    def build(x):
        scene, node = make(n)
        for value in x:
            scene.add_force(node, (0.0, value))
        return scene, {"y": fb.Output("position", node)}

    response = fb.Response(build, dt=DT, t_end=STEPS * DT)
    t, y = response(np.full(numbers, 1.0 / numbers))
    weights = np.zeros_like(y["y"])
    weights[-1, 1] = 1.0
    response.vjp({"y": weights})


def loaded(make, n):
    """A scene with a force on each node, and these forces."""
    scene, _ = make(n)
    return scene, [scene.add_force(node, (0.0, -1.0)) for node in scene.nodes]


def without_forces(make, n):
    scene, forces = loaded(make, n)
    scene.remove(*forces)


def with_other_forces(make, n):
    scene, forces = loaded(make, n)
    for force in forces:
        scene.change(force, (0.0, -2.0))


def without_half(make, n):
    """Half of the beams and bodies go."""
    scene, _ = make(n)
    scene.remove(*scene.beams[::2], *scene.bodies[::2])


def locked(make, n):
    scene, _ = make(n)
    for joint in [*scene.joints]:
        with suppress(fb.SceneError):  # a motor drives it
            scene.unlock(scene.lock(joint))


def supported(make, n):
    scene, _ = make(n)
    free = [node for node in scene.nodes if (node.number, 0) not in scene.fixed]
    for node in free:
        scene.fix(node, "x")
    for node in free:
        scene.free(node, "x")


def shaken(make, n):
    scene, _ = make(n)
    scene.shake(x=([0.0, 1.0], [1.0, 2.0]))
    moved(scene, 1)


def stepwise(scene):
    motion = fb.Motion(scene, dt=DT)
    for _ in range(STEPS):
        motion.step()


def outputs_of(scene):
    outputs = {f"n{k}": fb.Output("position", node) for k, node in enumerate(scene.nodes)}
    beams = {
        f"b{k}": fb.Output("M", beam.at(0.5 * beam.length)) for k, beam in enumerate(scene.beams)
    }
    joints = {f"j{k}": fb.Output("force", joint) for k, joint in enumerate(scene.joints)}
    return outputs | beams | joints


def of_each_part(scene, solution):
    for node in scene.nodes:
        solution.position(node), solution.displacement(node), solution.velocity(node)
        solution.reaction(node)
    for part in [*scene.joints, *scene.forces_between, *scene.gears]:
        solution.joint(part)
    for contact in scene.contacts:
        solution.contact(contact)


def of_each_beam(scene, solution):
    for beam in scene.beams:
        solution.resultants(beam), solution.stress(beam), solution.shape(beam)


def costs(make, n):
    """Functions by the names of the costs; each may be refused by a scene."""
    (scene, node), folder = make(n), tempfile.TemporaryDirectory()
    place, plot, solutions, states = Path(folder.name), fb.plot, [], [None]
    yield "build", lambda: make(n)
    yield "copy, pickle", lambda: pickle.loads(pickle.dumps(copy.deepcopy(scene)))
    yield "repr", lambda: repr(scene)
    yield "add and remove forces", lambda: without_forces(make, n)
    yield "change forces", lambda: with_other_forces(make, n)
    yield "remove half", lambda: without_half(make, n)
    yield "lock, unlock", lambda: locked(make, n)
    yield "fix, free", lambda: supported(make, n)
    yield "set-up", lambda: solutions.append(moved(scene, 1))
    yield "10 steps", lambda: solutions.append(moved(scene))
    yield "10 steps of a Motion", lambda: stepwise(scene)
    yield "shake", lambda: shaken(make, n)
    yield "static", lambda: states.append(fb.static(scene, load_steps=1))
    yield "static, linear", lambda: fb.static(scene, linear=True)
    yield "buckling", lambda: fb.buckling(scene, n=2)
    yield "modes", lambda: fb.modes(scene, states[-1], n=4)
    if len(scene.nodes) < 300:  # its matrices are full
        yield "linearise", lambda: fb.linearise(scene, outputs={"y": fb.Output("position", node)})
    yield (
        "frequency response",
        lambda: fb.frequency_response(scene, (node, (0, 1, 0)), node, [1.0, 2.0], states[-1]),
    )
    for numbers in (1, 10, 100):
        yield f"gradient, {numbers}", lambda numbers=numbers: gradient(make, n, numbers)
    yield "each part", lambda: of_each_part(scene, solutions[-1])
    yield "each beam", lambda: of_each_beam(scene, solutions[-1])
    yield "outputs", lambda: [solutions[-1].value(output) for output in outputs_of(scene).values()]
    yield "table", lambda: fb.Solution.to_pandas(solutions[-1])
    yield (
        "table of outputs",
        lambda: solutions[-1].to_csv(place / "m.csv", outputs=outputs_of(scene)),
    )
    yield "envelope", lambda: fb.envelope([solutions[-1]], fb.Output("M", scene.beams[0].at(0.0)))
    yield "save", lambda: solutions[-1].save(place / "motion.npz")
    yield "load", lambda: fb.load(place / "motion.npz")
    yield "to_paraview", lambda: solutions[-1].to_paraview(place / "motion.pvd")
    yield "scene drawn", lambda: plot.scene(scene)
    yield "shapes", lambda: plot.shapes(solutions[-1], rows=[0, -1 % len(solutions[-1].t)])
    yield "shapes, coloured", lambda: plot.shapes(solutions[-1], rows=[0], colour="M")
    yield "diagrams", lambda: plot.diagrams(solutions[-1])
    yield "interactive", lambda: plot.interactive(solutions[-1], place / "page.html")
    yield "picture written", lambda: plot.shapes(solutions[-1], place / "a.png", rows=[0])


def seconds(run):
    gc.collect()
    begin = process_time()
    run()
    return process_time() - begin


def calls(run):
    """Number of calls of functions, also of those in C."""
    events = 0

    def count(*_):
        nonlocal events
        events += 1

    sys.setprofile(count)
    try:
        run()
        return events
    finally:
        sys.setprofile(None)


def peak(run):
    """Largest number of bytes in arrays at a time."""
    tracemalloc.start()
    try:
        run()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def warm(kind, only):
    """Load and compile, with a small scene."""
    for name, run in costs(KINDS[kind], 8):
        if wanted(name, only):
            with suppress(*REFUSED):
                run()


def measure(kind, n, count, only):
    """Costs of a scene by their names; nan for what the scene refuses."""
    values = {}
    for name, run in costs(KINDS[kind], n):
        if not wanted(name, only):
            continue
        try:
            values[name] = count(run)
        except REFUSED as error:
            print(f"# {kind} {n} {name}: {str(error)[:150]}", file=sys.stderr)
            values[name] = math.nan
    return values


def wanted(name, only):
    """Whether a cost is measured: solutions are read by most others."""
    return not only or name in only or name in ("10 steps", "save")


def exponent(before, now, ratio):
    """p of cost ~ n^p."""
    return math.log(now / before) / math.log(ratio) if before > 0 and now > 0 else math.nan


def measured(kind, n, quick, only):
    """Measurement in a process of its own."""
    command = [sys.executable, __file__, "--one", *["--quick"] * quick, kind, str(n)]
    command += ["--only", *only] if only else []
    done = subprocess.run(command, capture_output=True, text=True)
    sys.stderr.write("".join(f"{x}\n" for x in done.stderr.splitlines() if x.startswith("#")))
    if done.returncode:
        raise RuntimeError(done.stderr)
    return {k: float(v) for k, v in (line.split("\t") for line in done.stdout.splitlines())}


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("kinds", nargs="*", default=[*KINDS])
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--only", nargs="+", default=[], metavar="COST")
    parser.add_argument("--one", action="store_true", help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.one:
        kind, n = chosen.kinds
        count = peak if chosen.quick else seconds
        warm(kind, chosen.only)
        for name, value in measure(kind, int(n), count, chosen.only).items():
            print(name, value, sep="\t")
        return
    unit = 1e-3 if chosen.quick else 1e3
    for kind in chosen.kinds:
        sizes = (QUICK if chosen.quick else SIZES)[kind]
        values = [measured(kind, n, chosen.quick, chosen.only) for n in sizes]
        head = f"{kind} [{'kB' if chosen.quick else 'ms'}]"
        print(f"{head:26}" + "".join(f"{n:>17}" for n in sizes))
        for name in values[0]:
            costs_of_name = [value.get(name, math.nan) for value in values]
            line = f"{unit * costs_of_name[0]:11.4g}      "
            for k in range(1, len(sizes)):
                p = exponent(*costs_of_name[k - 1 : k + 1], sizes[k] / sizes[k - 1])
                line += f"{unit * costs_of_name[k]:11.4g} n^{p:.1f}"[:17].rjust(17)
            print(f"  {name:24}{line}", flush=True)


if __name__ == "__main__":
    main()
