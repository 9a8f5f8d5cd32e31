"""A mast whose mass damper is tuned until the peaks of its vibration have the same height.

A tube of steel, clamped at its foot, is shaken by a harmonic force at its tip, where a body hangs
on a spring and a damper. Objective: how high the peaks of the amplitude are with the damper of the
textbook and with the damper that gradients find, first for a rigid mass on a spring, whose best
damper is known exactly, then for the mast.

Reference: for a mass on a spring, without damping, Den Hartog's rules make the two points equally
high through which the curves of all dampers pass. The least height of the highest peak, and its
damper, are known in closed form (Nishihara and Asami, J. Vib. Acoust. 124, 2002). For the mast the
rules are taken with the modal mass of the first mode, as practice does. Here SciPy makes the
highest peak least, with the heights of `HarmonicResponse.peaks` and their gradients. The mast has
damping of its own, for which there is no closed form. Units are metre, kilogram and second.
"""

import logging
from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

RATIO = 0.05  # mass of the damper over that of the mass, or of the first mode
LENGTH, DIAMETER, WALL = 30.0, 0.6, 0.01  # of the mast [m]
ELEMENTS, RETARDATION = 12, 0.012  # [s]: a damping ratio of 2.5 % in the first mode
FORCE = 1e3  # [N]
MASS, STIFFNESS = 1000.0, 4e4  # of the mass on a spring
BAND = np.linspace(0.75, 1.25, 51)  # frequencies, over that without a damper


def damped(scene, carrier, mass, x):
    """Hang a body on a node by a spring and a damper: their stiffness and viscosity."""
    body = scene.add_body((carrier.x, carrier.y), mass, 1e-3 * mass, name="damper")
    spring, damper = fb.Spring(x[0]), fb.Damper(x[1])
    scene.add_joint(fb.Prismatic(carrier, body.centre, (1, 0), spring=spring, damper=damper))
    return body


def oscillator(x):
    """The mass on a spring, the force on it, and where its motion is measured."""
    scene = fb.Scene()
    body = scene.add_body((0, 0), MASS, 1.0, name="mass")
    rail = fb.Prismatic(fb.GROUND, body.centre, (1, 0), spring=fb.Spring(STIFFNESS))
    scene.add_joint(rail)
    damped(scene, body.centre, RATIO * MASS, x)
    return scene, (body.centre, (FORCE, 0.0)), body.centre


def mast():
    """The tube alone."""
    E, nu, rho = fb.materials.steel
    inner = DIAMETER - 2 * WALL
    area, inertia = np.pi / 4 * (DIAMETER**2 - inner**2), np.pi / 64 * (DIAMETER**4 - inner**4)
    tube = replace(fb.Section.from_area(area, inertia, E, nu, rho, 0.5), retardation=RETARDATION)
    scene = fb.Scene()
    tube = scene.add_beam([(0, 0), (0, LENGTH)], tube, elements=ELEMENTS, degree=2, name="mast")
    scene.clamp(tube.start)
    return scene, tube


def mast_with_damper(mass):
    """Mast with a damper of this mass at its tip, in the form of `oscillator`."""

    def build(x):
        scene, tube = mast()
        damped(scene, tube.end, mass, x)
        return scene, (tube.end, (FORCE, 0.0)), tube.end

    return build


def den_hartog(mass, w):
    """Stiffness and viscosity of the damper for a mass with the angular frequency w."""
    own, tuned = RATIO * mass, w / (1 + RATIO)
    return np.array([own * tuned**2, 2 * own * tuned * np.sqrt(3 * RATIO / (8 * (1 + RATIO)))])


def exact(mass, w):
    """The best damper of a mass on a spring, and the height of its peaks over the static motion."""
    m, root = RATIO, np.sqrt(4 + 3 * RATIO)
    inner = 16 + 23 * m + 9 * m**2 + 2 * (2 + m) * root
    tuning = 2 / (1 + m) * np.sqrt(2 * inner / (3 * (64 + 80 * m + 27 * m**2)))
    share = np.sqrt((8 + 9 * m - 4 * root) / (1 + m)) / 4
    inner = ((8 + 9 * m) ** 2 * (16 + 9 * m) - 128 * root**3) / (3 * (32 + 27 * m))
    own, tuned = m * mass, w * tuning
    return np.array([own * tuned**2, 2 * own * tuned * share]), np.sqrt(inner) / (3 * m)


def heights(run, x):
    """Heights of both peaks, and their gradients."""
    run(x)
    highest = sorted(run.peaks("x"), key=lambda peak: -peak.amplitude)[:2]
    both = sorted((highest * 2)[:2], key=lambda peak: peak.frequency)  # one alone counts twice
    return np.array([peak.amplitude for peak in both]), np.array([peak.gradient for peak in both])


def tuned(build, frequencies, start):
    """The stiffness and viscosity with the least highest peak, and how many scenes were computed.

    The height h is a third number: it is made least where both peaks are below it.
    """
    run = fb.HarmonicResponse(build, frequencies)
    unit = heights(run, start)[0].max()

    def below(y):
        return y[2] - heights(run, start * y[:2])[0] / unit

    def slopes(y):
        return np.column_stack([-heights(run, start * y[:2])[1] * start / unit, np.ones(2)])

    constraint = {"type": "ineq", "fun": below, "jac": slopes}
    best = minimize(
        lambda y: y[2],
        np.ones(3),
        jac=lambda y: np.array([0.0, 0.0, 1.0]),
        bounds=[(0.5, 2.0), (0.3, 3.0), (0.1, 2.0)],
        constraints=constraint,
        method="SLSQP",
        options={"ftol": 1e-8},
    )
    return start * best.x[:2], best.nfev


def compute():
    """The numbers, and what is drawn."""
    w = np.sqrt(STIFFNESS / MASS)
    log.info("the mass on a spring")
    known, height = exact(MASS, w)
    damper, tries = tuned(oscillator, BAND * w / (2 * np.pi), den_hartog(MASS, w))
    run = fb.HarmonicResponse(oscillator, BAND * w / (2 * np.pi))
    static = FORCE / STIFFNESS
    numbers = {
        "stiffness over exact": damper[0] / known[0],
        "viscosity over exact": damper[1] / known[1],
        "peaks over static": (heights(run, damper)[0] / static).tolist(),
        "peaks by Den Hartog": (heights(run, den_hartog(MASS, w))[0] / static).tolist(),
        "peaks, exact": height,
        "tries": tries,
    }
    log.info("the mast")
    alone, tube = mast()
    first = fb.modes(alone, n=1, damping=False)
    w = float(first.angular_frequencies[0])
    modal_mass = 1 / float(first.shapes[0, tube.end.number, 0]) ** 2
    build, rule = mast_with_damper(RATIO * modal_mass), den_hartog(modal_mass, w)
    frequencies = BAND * w / (2 * np.pi)
    best, tries = tuned(build, frequencies, rule)
    run = fb.HarmonicResponse(build, frequencies)
    numbers["mast"] = {
        "frequency": w / (2 * np.pi),
        "modal mass": modal_mass,
        "peaks by Den Hartog": (1e3 * heights(run, rule)[0]).tolist(),
        "peaks": (1e3 * heights(run, best)[0]).tolist(),
        "stiffness over rule": best[0] / rule[0],
        "viscosity over rule": best[1] / rule[1],
        "tries": tries,
    }
    fine = np.linspace(0.7, 1.3, 241) * w / (2 * np.pi)
    curves = {"Den Hartog's rules": rule, "tuned": best, "20 % too stiff": rule * (1.2, 1.0)}
    runs = {name: fb.HarmonicResponse(build, fine) for name in curves}
    for name, x in curves.items():
        runs[name](x)
    return numbers, ({name: case.response for name, case in runs.items()}, build, best, w)


def report(numbers):
    rule, both = numbers["peaks by Den Hartog"], numbers["peaks over static"]
    print(
        f"mass on a spring, damper of {RATIO:.0%}: peaks of {both[0]:.4f} and {both[1]:.4f} times "
        f"the static motion (exact {numbers['peaks, exact']:.4f}; Den Hartog's rules {rule[0]:.4f} "
        f"and {rule[1]:.4f}); stiffness {numbers['stiffness over exact']:.5f} and viscosity "
        f"{numbers['viscosity over exact']:.5f} of the exact ones, after {numbers['tries']} steps"
    )
    own = numbers["mast"]
    rule, both = own["peaks by Den Hartog"], own["peaks"]
    print(
        f"mast of {LENGTH:g} m, {own['frequency']:.3f} Hz, modal mass {own['modal mass']:.0f} kg: "
        f"peaks of {rule[0]:.2f} and {rule[1]:.2f} mm by the rules, {both[0]:.2f} and "
        f"{both[1]:.2f} mm tuned, with {own['stiffness over rule']:.4f} of the stiffness and "
        f"{own['viscosity over rule']:.4f} of the viscosity, after {own['tries']} steps"
    )


def draw(results, responses, build, best, w):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.frequency_response(responses, results / "response.png", components=["x"])
    scene, (tip, _), _ = build(best)
    plot.scene(scene, results / "scene.png")
    shaking = 10 * FORCE  # to be seen
    scene.add_force(tip, lambda t: (shaking * np.sin(w * t), 0.0))
    period = 2 * np.pi / w
    motion = fb.simulate(scene, dt=period / 48, t_end=20 * period)
    plot.animate(motion, results / "motion.gif", rows=range(19 * 48, 20 * 48))
    thumbnail.card(motion, range(19 * 48, 20 * 48), results / "thumbnail.png")


if __name__ == "__main__":
    script.run()
