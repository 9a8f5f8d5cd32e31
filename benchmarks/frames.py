"""Large frames: set-up, steps, statics, modes and pictures of square lattices of struts.

    .venv/bin/python benchmarks/frames.py [cells ...]   (200: 80 400 struts, 2 minutes)
    .venv/bin/python benchmarks/frames.py turning       steps with kept factors and with new ones

Each strut is one element; the struts are rigidly joined. The lattice is clamped at one side and
loaded at the other, or free and turning. Times are those of the processor in seconds, of a step the
mean of the first twenty; the memory is the largest of the process so far.
"""

import resource
import sys
import tempfile
from pathlib import Path
from time import process_time

import fx_beam as fb
from fx_beam.compiled import loop, lu_layout


def struts(cells):
    """A free square lattice with `cells` on each side, and its nodes by their places."""
    scene, nodes = fb.Scene(), {}
    section = fb.Section(EA=1e6, GA=1e6, EI=1e2, rhoA=1.0, rhoI=1e-2)

    def strut(a, b):
        beam = scene.add_beam([nodes.get(a, a), nodes.get(b, b)], section)
        nodes[a], nodes[b] = beam.start, beam.end

    for i in range(cells + 1):
        for j in range(cells + 1):
            if i < cells:
                strut((i, j), (i + 1, j))
            if j < cells:
                strut((i, j), (i, j + 1))
    return scene, nodes


def lattice(cells):
    """The lattice with supports and loads."""
    scene, nodes = struts(cells)
    for j in range(cells + 1):
        scene.clamp(nodes[0, j])
        scene.add_force(nodes[cells, j], (0.0, 20.0))
    return scene


def turning(cells, spin):
    """The free lattice, which turns about its middle."""
    scene, _ = struts(cells)
    middle = cells / 2
    for beam in scene.beams:
        scene.set_velocity(beam, lambda x, y: (spin * (middle - y), spin * (x - middle)), spin)
    return scene


def timed(march, seconds):
    """A function that takes steps, and adds its time to a list."""

    def marched(*arguments):
        clock = process_time()
        state = march(*arguments)
        seconds.append(process_time() - clock)
        return state

    return marched


def draw(scene, motion):
    """Draw the scene and its last shape, plain and coloured; print the times."""
    pictures = {
        "scene": lambda path: fb.plot.scene(scene, path),
        "shape": lambda path: fb.plot.shapes(motion, [1], path),
        "in colour": lambda path: fb.plot.shapes(motion, [1], path, colour="strain energy"),
    }
    with tempfile.TemporaryDirectory() as folder:
        fb.plot.scene(lattice(1), Path(folder) / "first.png")  # imports
        for name, picture in pictures.items():
            clock = process_time()
            picture(Path(folder) / "picture.png")
            print(f"  picture, {name} {process_time() - clock:.1f}", flush=True)


def measure(sizes):
    marching: list[float] = []
    loop.CompiledLoop.march = timed(loop.CompiledLoop.march, marching)
    for cells in sizes:
        clock = process_time()
        scene = lattice(cells)
        made = process_time() - clock
        clock = process_time()
        marching.clear()
        motion = fb.simulate(scene, dt=0.01, t_end=0.2, record=fb.Record(every=20))
        stats, whole, steps = motion.stats, process_time() - clock, sum(marching)
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
        error = abs(motion.energy.balance_error).max() / motion.energy.kinetic.max()
        print(f"{len(scene.beams)} struts, {stats.unknowns} unknowns: {stats.solver}")
        print(f"  scene {made:.2f}, set-up {whole - steps:.1f}, {memory:.1f} GB")
        iterations = stats.newton_iterations / stats.steps
        print(f"  a step {steps / stats.steps:.3f} ({iterations:.1f} iterations)")
        print(f"  relative error of the energy balance {error:.1e}")
        draw(scene, motion)
        clock = process_time()
        state = fb.static(scene, steps=10)
        print(f"  ten load steps {process_time() - clock:.1f}")
        clock = process_time()
        fb.modes(scene, state, n=10)
        print(f"  ten modes {process_time() - clock:.1f}", flush=True)


def compare_turning(cells=60, dt=0.01, steps=15):
    """Steps of a free lattice with kept factors, and with new ones in each iteration."""
    kept = lu_layout._LEAST_WORTH
    for turn in (0.001, 0.05, 0.2):
        found = []
        for least in (kept, sys.maxsize):
            lu_layout._LEAST_WORTH = least
            scene = turning(cells, turn / dt)
            record = fb.Record(every=steps)
            stats = fb.simulate(scene, dt=dt, t_end=steps * dt, record=record).stats
            found.append(f"{1e3 * stats.seconds / stats.steps:.1f}")
        print(f"{turn:g} rad a step: {found[0]} ms kept, {found[1]} ms new", flush=True)
    lu_layout._LEAST_WORTH = kept


if __name__ == "__main__":
    if sys.argv[1:] == ["turning"]:
        compare_turning()
    else:
        measure([int(cells) for cells in sys.argv[1:]] or [60, 120, 200])
