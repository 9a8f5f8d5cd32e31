r"""A straight beam rolled up to one and two full circles, and released.

A cantilever is bent by a moment at its end. Objective: the exact circle from the straight beam, in
few load steps; the order of convergence with the number of elements; and a motion that starts from
the rolled-up state.

This is the classical test of finite rotations in beams since Simo & Vu-Quoc (1986), Comput. Methods
Appl. Mech. Eng. 58, 79-116, doi 10.1016/0045-7825(86)90079-4. Under an end moment $M$ alone the
axial and the shear force are zero and the curvature is $M/EI$ everywhere. The beam is a circular
arc for any $EA$ and $GA$. With the angle $a = M L/EI$ its tip is at

$$ x = L\,\frac{\sin a}{a}, \qquad y = L\,\frac{1 - \cos a}{a}, $$

and $M = 2 \pi EI/L$ closes the circle. The work of the moment, $M a/2 = EI a^2/(2 L)$, is the
strain energy. In the static analysis $M$ is multiplied by a load factor, which grows in equal load
steps.

When the beam is released, $M = 0$ for $t > 0$, it springs open. `fx_beam.simulate(..., start=...)`
starts from the rolled-up state, and the total energy remains the work of the moment.

Units are metre, newton and second.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

LENGTH = 10.0  # L [m]
SECTION = fb.Section(EA=1e4, GA=1e4, EI=500.0, rhoA=1.0, rhoI=0.05)  # [N], [N], [N m²], ...
CIRCLE = 2 * np.pi * SECTION.EI / LENGTH  # M that closes the circle [N m]
ELEMENTS, DEGREE = 16, 2
MESHES = {1: (4, 8, 16, 32), 2: (2, 4, 8, 16), 3: (2, 4, 8)}  # elements by degree
RUNS = {"once": (1, 10), "twice": (2, 20)}  # turns, load steps
DT, T_END = 0.01, 4.0  # of the motion after release [s]


def scene(turns=1.0, elements=ELEMENTS, degree=DEGREE):
    """The beam with the moment that gives a number of turns, removed for $t > 0$."""
    rolled = fb.Scene()
    beam = rolled.add_beam([(0, 0), (LENGTH, 0)], SECTION, elements, degree, name="beam")
    rolled.clamp(beam.start)
    rolled.add_moment(beam.end, lambda t: turns * CIRCLE if t <= 0 else 0.0)
    return rolled, beam


def rolled_up(turns, steps, elements=ELEMENTS, degree=DEGREE):
    """Solution, beam, and distance (n,) of its tip from the exact position over the length."""
    log.info("%g turns, %d elements of degree %d", turns, elements, degree)
    rolled, beam = scene(turns, elements, degree)
    solution = fb.static(rolled, load_steps=steps)
    angle = np.maximum(solution.load_factor * turns * 2 * np.pi, 1e-300)
    exact = LENGTH / angle[:, None] * np.column_stack([np.sin(angle), 1 - np.cos(angle)])
    return solution, beam, np.hypot(*(solution.position(beam.end) - exact).T) / LENGTH


def summary(solution, beam, error, turns):
    energy = solution.energy
    return {
        "load steps": solution.stats.steps,
        "cuts": solution.stats.halvings,
        "Newton iterations": solution.stats.newton_iterations,
        "turns of the tip": solution.rotation(beam.end)[-1] / (2 * np.pi),
        "tip off at the end / L": error[-1],
        "tip off on the way / L": error.max(),
        "strain energy / exact": energy.strain[-1] / (turns**2 * np.pi * CIRCLE),
        "relative balance error": abs(energy.balance_error).max() / energy.strain[-1],
    }


def compute():
    """The numbers, and what is drawn."""
    runs = {name: rolled_up(*arguments) for name, arguments in RUNS.items()}
    # At 0.4 turns, because at the full circle the tip is exact on any mesh, by symmetry.
    errors = {
        degree: [float(rolled_up(0.4, 4, n, degree)[2][-1]) for n in meshes]
        for degree, meshes in MESHES.items()
    }
    motion = fb.simulate(scene()[0], dt=DT, t_end=T_END, start=runs["once"][0])
    energy = motion.energy

    numbers = {name: summary(*run, RUNS[name][0]) for name, run in runs.items()}
    numbers["tip off at 0.4 of a turn / L"] = {
        f"degree {degree}": dict(zip(map(str, MESHES[degree]), error, strict=True))
        for degree, error in errors.items()
    }
    numbers["orders"] = {
        f"degree {degree}": float(np.log2(error[-2] / error[-1]))
        for degree, error in errors.items()
    }
    numbers["let go"] = {
        "energy at the start": energy.total[0],
        "largest kinetic energy": energy.kinetic.max(),
        "relative energy error": abs(energy.balance_error).max() / energy.total[0],
    }
    return numbers, (runs, errors, motion)


def report(numbers):
    for name in RUNS:
        run = numbers[name]
        print(
            f"Rolled up {name}: {run['load steps']} load steps, {run['cuts']} cuts, "
            f"{run['Newton iterations']} iterations; error of the tip "
            f"{run['tip off at the end / L']:.1e} L at the end and up to "
            f"{run['tip off on the way / L']:.1e} L on the way; strain energy "
            f"{run['strain energy / exact']:.12f} of the exact one"
        )
    for degree in MESHES:
        errors = numbers["tip off at 0.4 of a turn / L"][f"degree {degree}"]
        order = numbers["orders"][f"degree {degree}"]
        listed = ", ".join(f"{error:.1e} with {n}" for n, error in errors.items())
        print(f"Degree {degree}: tip error at 0.4 turns: {listed} elements; order {order:.2f}")
    free = numbers["let go"]
    print(
        f"Released: energy {free['energy at the start']:.4f} J, constant within "
        f"{free['relative energy error']:.0e}; kinetic energy up to "
        f"{free['largest kinetic energy']:.1f} J"
    )


def draw(results, runs, errors, motion):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene()[0], results / "scene.png", dimensions=True)
    solution, beam, _ = runs["once"]
    plot.shapes(solution, results / "shapes.png", rows=range(len(solution.t)))
    plot.animate(motion, results / "motion.gif", rows=range(0, len(motion.t), 4), trace=beam.end)
    thumbnail.card(motion, range(0, len(motion.t), 4), results / "thumbnail.png")

    figure, axes = plot.figure(1, 2, height=3.0)
    convergence, energy = axes.flat
    looks = ("C0", "o"), ("C1", "s"), ("C2", "^")
    for (degree, error), (colour, marker) in zip(errors.items(), looks, strict=True):
        n = np.array(MESHES[degree])
        convergence.loglog(n, error, color=colour, marker=marker, label=f"degree {degree}")
        convergence.loglog(n, error[-1] * (n[-1] / n) ** (2.0 * degree), ":", color="0.5")
    convergence.set(xlabel="elements", ylabel="error of the tip at 0.4 turns / $L$")
    convergence.set_xticks((2, 4, 8, 16, 32), ("2", "4", "8", "16", "32"))
    convergence.minorticks_off()
    convergence.plot([], [], ":", color="0.5", label="order twice the degree")
    for name, values in (("kinetic", "C3"), ("strain", "C4"), ("total", "k")):
        label = f"{name} energy, released"
        energy.plot(motion.t, getattr(motion.energy, name), values, label=label)
    energy.set(xlabel="time $t$ [s]", ylabel="energy [J]", xlim=(0, T_END))
    plot.save(figure, results / "convergence_and_energy.png")


if __name__ == "__main__":
    script.run()
