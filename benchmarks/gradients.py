"""Time of value with gradient, and with Jacobian, in motions, and of least squares.

    .venv/bin/python benchmarks/gradients.py [elements] [steps]
    .venv/bin/python benchmarks/gradients.py frame [cells]      (100: 20 200 struts, 1 minute)

An arm whose numbers are values of a load over time, or stiffnesses along it with masses; two arms
that carry a body, whose numbers are stiffnesses with masses along them, with the reaction as
output: its first row has accelerations; the arm with moments, energies or work as outputs. Medians
of processor times of calls that take turns, relative to a motion of another response. Then the same
for ten frequencies of the second arm, about the reference and about its static state, relative to
`modes`, for damped vibrations at 20 frequencies, relative to `frequency_response`, and for the load
under which it buckles, relative to its path with the critical point. Last, of its motion that
repeats itself under a harmonic load, of 50 steps, relative to `periodic`. A frame is a lattice of
struts whose stiffnesses are numbers, column by column: four frequencies, relative to `modes`.
"""

import sys
from time import thread_time

import numpy as np
from frames import struts
from scipy.optimize import least_squares

import fx_beam as fb

NUMBERS = 3, 5, 20, 100


def loaded(count, elements):
    """`build` for so many values of a load."""
    times = np.linspace(0, 1, count)

    def build(x):
        scene = fb.Scene(gravity=(0, -9.81))
        section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=1e-3)
        beam = scene.add_beam([(0, 0), (1, 0)], section, elements=elements)
        scene.clamp(beam.start)
        scene.add_force(beam.end, lambda t: (0.0, np.interp(t, times, x)))
        return scene, {"tip": fb.Output("position", beam.end)}

    return build


def tapered(count, elements, quantity="position"):
    """`build` for masses, and so many stiffnesses less three, with an output."""
    places = np.linspace(0, 1, count - 3)

    def build(x):
        scene = fb.Scene(gravity=(0, -9.81))
        stiffness = {"EI": lambda f: 10.0 * np.interp(f, places, x[3:])}
        section = fb.Section(EA=1e4 * x[0], GA=1e4 * x[0], rhoA=x[1], rhoI=1e-3, **stiffness)
        beam = scene.add_beam([(0, 0), (1, 0)], section, elements=elements)
        scene.clamp(beam.start)
        scene.add_mass(beam.end, 0.1 * x[2])
        target = beam.end if quantity == "position" else beam if quantity == "M" else scene
        return scene, {"tip": fb.Output(quantity, target)}

    return build


def moments(count, elements):
    """Scenes by `tapered` with the bending moments of all rows."""
    return tapered(count, elements, "M")


def energies(count, elements):
    """Scenes by `tapered` with the energies of all rows."""
    return tapered(count, elements, "total_energy")


def works(count, elements):
    """Scenes by `tapered` with the work up to all rows."""
    return tapered(count, elements, "work")


def carried(count, elements):
    """`build` for so many stiffnesses and masses of two arms with a body between them."""
    places = np.linspace(0, 1, count)

    def build(x):
        scene = fb.Scene(gravity=(0, -9.81))
        laws = {"EI": lambda f: 10.0 * np.interp(f, places, x)}
        laws["rhoA"] = lambda f: np.interp(f, places, x)
        section = fb.Section(EA=1e4, GA=1e4, rhoI=1e-3, **laws)
        first = scene.add_beam([(0, 0), (1, 0)], section, elements=elements)
        second = scene.add_beam([(1.2, 0), (2, 0)], section, elements=elements)
        points = {"left": (1, 0), "right": (1.2, 0)}
        body = scene.add_body((1.1, 0.1), 2.0 * x[0], 0.1, points=points)
        scene.pin(first.start)
        scene.add_joint(fb.Revolute(first.end, body["left"]))
        scene.add_joint(fb.Revolute(body["right"], second.start, spring=fb.Spring(5.0)))
        return scene, {"tip": fb.Output("reaction", first.start)}

    return build


def medians(turns, *functions, calls=5):
    """Median processor times [s] of functions that are called some times, in turns."""
    seconds = [[] for _ in functions]
    for _ in range(turns):
        for function, times in zip(functions, seconds, strict=True):
            for _ in range(calls):
                before = thread_time()
                function()
                times.append(thread_time() - before)
    return np.median(seconds, axis=1)


def measured(build, count, steps, turns=20):
    """Times of a motion [ms], and of value with gradient and with Jacobian in motions."""
    alone, run = (fb.Response(build, dt=1 / steps, t_end=1.0) for _ in range(2))
    x = 1 + 0.1 * np.sin(np.arange(1, count + 1))
    rng, tip = np.random.default_rng(0), alone(x)[1]["tip"]
    weights = {"tip": np.ones_like(tip)}

    def moved(call=run):
        call(x * (1 + 1e-3 * rng.random(count)))

    moved(alone), moved(), run.vjp(weights), run.jacobian()
    motion, gradient, jacobian = medians(
        turns,
        lambda: moved(alone),
        lambda: (moved(), run.vjp(weights)),
        lambda: (moved(), run.jacobian()),
    )
    return 1e3 * motion, gradient / motion, jacobian / motion


def beside(run, count, plain=None, weights_of=None, turns=5, calls=5):
    """Time of an analysis [ms], by `plain` if it is another, and with gradient and Jacobian."""
    rng, x = np.random.default_rng(0), 1 + 0.1 * np.sin(np.arange(1, count + 1))

    def at():
        return x * (1 + 1e-3 * rng.random(count))

    values = run(at())
    weights = {"load": 1.0} if isinstance(values, tuple) else np.ones(np.shape(values))
    weights = weights_of(values) if weights_of else weights
    run.jacobian(), (plain or run)(at())
    alone, gradient, jacobian = medians(
        turns,
        lambda: (plain or run)(at()),
        lambda: (run(at()), run.vjp(weights)),
        lambda: (run(at()), run.jacobian()),
        calls=calls,
    )
    return 1e3 * alone, gradient / alone, jacobian / alone


def of_modes(count, elements, state):
    """Of ten modes."""
    build = tapered(count, elements)

    def modes(x):
        scene = build(x)[0]
        return fb.modes(scene, None if state is None else state(scene), n=10)

    return beside(fb.ModalResponse(lambda x: build(x)[0], n=10, state=state), count, modes)


def of_vibrations(count, elements):
    """Of vibrations at 20 frequencies."""
    tapered_arm, frequencies = tapered(count, elements), np.linspace(0.1, 10, 20)

    def build(x):
        scene, _ = tapered_arm(x)
        end = scene.beams[0].end
        scene.add_drag(end, linear=0.1)
        return scene, (end, (0.0, 1.0)), end

    def response(x):
        scene, load, node = build(x)
        return fb.frequency_response(scene, load, node, frequencies)

    return beside(fb.HarmonicResponse(build, frequencies), count, response)


def of_buckling(count, elements):
    """Of a path with its critical point."""
    tapered_arm = tapered(count, elements)

    def build(x):
        scene, _ = tapered_arm(x)
        scene.add_force(scene.beams[0].end, (-40.0, 0.0))
        scene.gravity = None
        return scene, {"load": fb.Output("critical_load", scene)}

    return beside(fb.StaticResponse(build, load_steps=4), count)


def of_cycles(count, elements):
    """Of a motion that repeats itself."""
    tapered_arm = tapered(count, elements)

    def build(x):
        scene, outputs = tapered_arm(x)
        end = scene.beams[0].end
        scene.add_drag(end, linear=0.5)
        scene.add_force(end, lambda t: (0.0, 2.0 * np.cos(4 * np.pi * t)))
        return scene, outputs

    def found(scene):
        return fb.periodic(scene, period=0.5, steps=51)

    run = fb.PeriodicResponse(build, found)
    return beside(run, count, lambda x: found(build(x)[0]), lambda y: {"tip": 0 * y[1]["tip"] + 1})


def of_frame(count, cells):
    """Of four modes of a lattice that is clamped at one side."""

    def build(x):
        sections = [fb.Section(EA=1e6 * k, GA=1e6 * k, EI=1e2, rhoA=1.0, rhoI=1e-2) for k in x]
        column_sections = [sections[column * count // (cells + 1)] for column in range(cells + 1)]
        scene, nodes = struts(cells, section=column_sections.__getitem__)
        for j in range(cells + 1):
            scene.clamp(nodes[0, j])
        return scene

    run = fb.ModalResponse(build, n=4)
    return beside(run, count, lambda x: fb.modes(build(x), n=4), turns=1, calls=1)


def fitted(build, count, steps):
    """Times of a fit with the Jacobian and with SciPy's differences [s]."""
    run, x = fb.Response(build, dt=1 / steps, t_end=1.0), np.ones(count)
    misfit = run.misfit({"tip": run(1.02 * x)[1]["tip"]})
    misfit.jacobian(x)
    fits = (
        lambda jacobian=jacobian: least_squares(misfit, x, jac=jacobian, bounds=(0.1, 10))
        for jacobian in (misfit.jacobian, "2-point")
    )
    return medians(3, *fits, calls=1)


def frame(cells=100):
    row = "{:>8} {:>8} {:>12} {:>10} {:>10}".format
    print(row("struts", "numbers", "modes [ms]", "gradient", "Jacobian"))
    for count in NUMBERS[1:3]:
        values = [f"{value:.3g}" for value in of_frame(count, cells)]
        print(row(2 * cells * (cells + 1), count, *values), flush=True)


def main(elements=8, steps=200):
    row = "{:>8} {:>8} {:>12} {:>10} {:>10} {:>14} {:>14}".format
    print(row("", "numbers", "motion [ms]", "gradient", "Jacobian", "fit, jac [s]", "without [s]"))
    for kind in (loaded, tapered, carried, moments, energies, works):
        for count in NUMBERS[kind is not loaded :]:
            values = measured(kind(count, elements), count, steps)
            fits = []
            if count < 100 and kind in (loaded, tapered):
                fits = fitted(kind(count, elements), count, steps)
            texts = [f"{value:.3g}" for value in (*values, *fits)] + [""] * (2 - len(fits))
            print(row(kind.__name__, count, *texts), flush=True)
    for name, state in ("modes", None), ("loaded", fb.static):
        for count in NUMBERS[1:3]:
            texts = [f"{value:.3g}" for value in of_modes(count, elements, state)]
            print(row(name, count, *texts, "", ""), flush=True)
    analyses = {"vibration": of_vibrations, "buckling": of_buckling}
    if elements <= 128:  # derivatives by all variables of a state
        analyses["cycle"] = of_cycles
    for name, analysis in analyses.items():
        for count in NUMBERS[1:]:
            texts = [f"{value:.3g}" for value in analysis(count, elements)]
            print(row(name, count, *texts, "", ""), flush=True)


if __name__ == "__main__":
    if sys.argv[1:2] == ["frame"]:
        frame(*map(int, sys.argv[2:]))
    else:
        main(*map(int, sys.argv[1:]))
