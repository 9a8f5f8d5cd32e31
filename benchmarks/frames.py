"""Large frames: set-up, steps, statics and modes of square lattices of rigidly joined struts.

    .venv/bin/python benchmarks/frames.py [cells ...]   (200: 80 400 struts, 2 minutes)

Each strut is one element. The lattice is clamped at one side and loaded at the other. Times are
those of the processor in seconds, of a step the mean of the first twenty; the memory is the largest
of the process so far.
"""

import resource
import sys
from time import process_time

import fx_beam as fb
from fx_beam.compiled import loop


def lattice(cells):
    """A square lattice with `cells` on each side, and its loaded nodes."""
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
    for j in range(cells + 1):
        scene.clamp(nodes[0, j])
        scene.add_force(nodes[cells, j], (0.0, 20.0))
    return scene


def timed(march, seconds):
    """A function that takes steps, and adds its time to a list."""

    def marched(*arguments):
        clock = process_time()
        state = march(*arguments)
        seconds.append(process_time() - clock)
        return state

    return marched


def main(sizes):
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
        print(f"  scene {made:.1f}, set-up {whole - steps:.1f}, {memory:.1f} GB")
        iterations = stats.newton_iterations / stats.steps
        print(f"  a step {steps / stats.steps:.3f} ({iterations:.1f} iterations)")
        print(f"  relative error of the energy balance {error:.1e}")
        clock = process_time()
        state = fb.static(scene, steps=10)
        print(f"  ten load steps {process_time() - clock:.1f}")
        clock = process_time()
        fb.modes(scene, state, n=10)
        print(f"  ten modes {process_time() - clock:.1f}", flush=True)


if __name__ == "__main__":
    main([int(cells) for cells in sys.argv[1:]] or [60, 120, 200])
