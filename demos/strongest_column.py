r"""The shape of the strongest column of a given volume, between two pins.

The areas of a column are chosen for the highest buckling load. Bending stiffness grows with the
square of the area, as that of a cross-section that grows in both directions. Objective: how closely
gradients of critical loads find the best shape, and what the column carries once it has buckled.

Reference: Keller, "The shape of the strongest column" (Arch. Rat. Mech. Anal. 5, 1960): the best
shape carries 4/3 of the load of the uniform column. With the angle $\theta$ from 0 to $\pi$ along
the column, $s = (\theta - \frac{1}{2} \sin 2\theta)/\pi$ and $A = \frac{4}{3} \sin^2\theta$. Areas
are numbers at equal distances, with lines between them. Units: length, volume and the uniform
column's $EI$ are 1.
"""

import logging

import numpy as np
from scipy.optimize import minimize

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

ELEMENTS = 40
AREAS = 5, 11, 21  # numbers of areas
LEAST = 0.02  # area
EULER = np.pi**2


def column(places):
    """A function of the areas at some places that gives the scene, and its critical load."""

    def build(areas):
        section = fb.Section(EA=1e6, GA=1e6, EI=lambda s: np.interp(s, places, areas) ** 2)
        scene = fb.Scene()
        beam = scene.add_beam([(0, 0), (0, 1)], section, elements=ELEMENTS, degree=2, name="column")
        scene.pin(beam.start)
        scene.fix(beam.end, "x")
        scene.add_force(beam.end, (0.0, -1.6 * EULER))
        return scene, {"load": fb.Output("critical_load", scene)}

    return build


def strongest(count):
    """Places, the best areas there, its load over that of the uniform column, and evaluations."""
    places = np.linspace(0, 1, count)
    weights = np.full(count, 1 / (count - 1)) * np.r_[0.5, np.ones(count - 2), 0.5]
    run = fb.StaticResponse(column(places), load_steps=4)

    def weakness(x):
        load = float(run(x)[1]["load"])
        return -load, -run.vjp({"load": 1.0})

    volume = {"type": "eq", "fun": lambda x: weights @ x - 1, "jac": lambda x: weights}
    start, bounds = np.ones(count), [(LEAST, 3.0)] * count
    best = minimize(weakness, start, jac=True, bounds=bounds, constraints=volume, method="SLSQP")
    return places, best.x, float(-best.fun / run(start)[1]["load"]), best.nfev


def keller(s):
    """Area of the exact shape at places $s$."""
    theta = np.linspace(0, np.pi, 2001)
    return np.interp(s, (theta - np.sin(2 * theta) / 2) / np.pi, 4 / 3 * np.sin(theta) ** 2)


def compute():
    """The numbers, and what is drawn."""
    numbers, shapes = {}, {}
    for count in AREAS:
        log.info("%d areas", count)
        places, areas, gain, tries = strongest(count)
        shapes[count] = places, areas
        middle = slice(1, -1)
        numbers[str(count)] = {
            "load over uniform": gain,
            "largest error of areas": float(abs(areas - keller(places))[middle].max()),
            "evaluations": tries,
        }
    return numbers, (shapes,)


def report(numbers):
    for count in map(str, AREAS):
        own = numbers[count]
        print(
            f"{count:>2} areas: {own['load over uniform']:.4f} of the uniform column's load (4/3 = "
            f"1.3333), areas within {own['largest error of areas']:.3f} of Keller's but at the "
            f"pins, after {own['evaluations']} loads"
        )


def draw(results, shapes):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from matplotlib.patches import Polygon

    from fx_beam import plot
    from shared import thumbnail

    places, areas = shapes[AREAS[-1]]
    figure, axes = plot.figure(1, 1, height=3.2)
    (ax,) = axes.flat
    s = np.linspace(0, 1, 401)
    ax.plot(s, keller(s), color="0.6", lw=3, label="Keller")
    for count, (centres, sizes) in shapes.items():
        ax.plot(centres, sizes, marker="o", ms=3, lw=1, label=f"{count} areas")
    ax.set(xlabel="place along the column", ylabel="area")
    plot.save(figure, results / "areas.png")

    scene, _ = column(places)(areas)
    plot.scene(scene, results / "scene.png")
    scene.add_moment(scene.beams[0].start, 1e-2)  # it bends to one side
    path = fb.static(scene, load_steps=60)
    rows = range(44, len(path.t))

    def outline(k):
        line = path.shape(scene.beams[0])[k]
        tangent = np.gradient(line, axis=0)
        normal = np.stack([-tangent[:, 1], tangent[:, 0]], axis=1)
        normal *= 0.05 / np.hypot(*normal.T)[:, None]
        half = np.sqrt(np.interp(np.linspace(0, 1, len(line)), places, areas))[:, None] * normal
        return [Polygon(np.concatenate([line + half, (line - half)[::-1]]), color="#0072B2")]

    thumbnail.card(path, rows, results / "thumbnail.png", also=outline, scale=0.6)


if __name__ == "__main__":
    script.run()
