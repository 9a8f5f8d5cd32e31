r"""A bow that is strung, drawn and released, and the arrow that it shoots.

The limbs of a bow are straight without the string, which is shorter than they are and bends them:
this is its prestress. Here the bow is built in the bent shape, as arcs of a circle and a straight
string, and the limbs have the natural curvature that would make them straight. `static` finds the
strung bow, then the drawn one: the arrow pulls the string back, and a stop that only pushes holds
the arrow on the string. Then the arrow is let go, and leaves the string by itself.

Objective: the draw curve, compared with the theory of the elastica; the work of the draw, which is
the area under this curve; and the energy that the arrow takes. For arrows of 10, 20 and 40 g the
limbs keep a part of this work, and a heavier arrow takes more. If limbs and string weigh a
hundredth, the arrow takes all of the work: $\frac{1}{2} m v^2$ is the work of the draw.

The elastica of a limb, clamped at $s = 0$, straight without load, of bending stiffness $EI(s)$,
with the force $F$ of the string at its tip, has the inclination $\theta$ and the moment $M$ of

$$
\theta' = \frac{M}{EI}, \quad M' = F_x \sin\theta - F_y \cos\theta, \quad
x' = \cos\theta, \quad y' = \sin\theta,
$$

with $M = 0$ at its tip. There $F$ points along half the string, whose length is
$l\,(1 + T/EA_\mathrm{string})$, to the nock. $M(0)$ and $F$ follow by shooting. The bow's limbs are
Reissner's beams with large $EA$ and $GA$. Units are metre, kilogram and second.
"""

import logging

import numpy as np
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

LIMB, RADIUS = 0.85, 1.6  # length of a limb, radius of the arc as which it is built [m]
EI_GRIP, TAPER = 120.0, 0.6  # bending stiffness at the grip [N m²], its relative loss to the tip
PER_LENGTH = 0.3  # of a limb at the grip [kg/m]; it falls by half to the tip
STRING_EA, STRING_PER_LENGTH = 5e4, 4e-3  # [N], [kg/m]
HALF_STRING = RADIUS * np.sin(LIMB / RADIUS)
DRAW = 0.45  # of the arrow, from the strung bow on [m]
ARROWS = (0.01, 0.02, 0.04)  # [kg]
SHOWN = 0.02
LIGHT = 0.01  # mass of limbs and string, relative to those above, in the last case
AHEAD, PUSH = 0.35, 1e6  # from the nock to the arrow's centre [m]; stiffness of its contact [N/m]
STEP, T_END = 2e-5, 0.03


def stiffness(f):
    """Bending stiffness [N m²] at a fraction of a limb."""
    return EI_GRIP * (1 - TAPER * f)


def scene(mass=SHOWN, weight=1.0, limb_elements=10, string_elements=8):
    """The bow and an arrow of some mass [kg]; the weights of limbs and string are multiplied."""
    bow, tip = fb.Scene(), RADIUS * (np.cos(LIMB / RADIUS) - 1)
    section = fb.Section(
        EA=1e7,
        GA=1e7,
        EI=stiffness,
        rhoA=lambda f: weight * PER_LENGTH * (1 - f / 2),
        rhoI=weight * 1e-5,
    )
    thread = fb.Section(
        EA=STRING_EA,
        GA=STRING_EA,
        EI=1e-4,
        rhoA=weight * STRING_PER_LENGTH,
        rhoI=weight * 1e-9,
    )
    nock = None
    for side, name in ((1, "upper"), (-1, "lower")):

        def arc(f, side=side):
            turn = f * LIMB / RADIUS
            return RADIUS * (np.cos(turn) - 1), side * RADIUS * np.sin(turn)

        limb = bow.add_beam(arc, section, limb_elements, degree=2, name=f"{name} limb")
        bow.clamp(limb.start)
        bow.add_natural_strain(limb, curvature=-side / RADIUS)
        ends = [nock or (tip, 0.0), (tip, side * HALF_STRING)]
        string = bow.add_beam(ends, thread, string_elements, degree=2, name=f"{name} string")
        bow.add_joint(fb.Revolute(limb.end, string.end))
        nock = string.start
    arrow = bow.add_body((tip + AHEAD, 0.0), mass=mass, name="arrow").centre
    bow.fix(arrow, "y", "rotation")
    bow.prescribe(arrow, x=fb.Input("draw"))
    bow.add_force_between(nock, arrow, stop=fb.Stop(AHEAD, None, PUSH))
    return bow, nock, arrow


def drawn(mass=SHOWN, weight=1.0, steps=9):
    """The bow when it is strung, and when it is drawn."""
    bow, nock, arrow = scene(mass, weight)
    strung = fb.static(bow, load_steps=4)
    string = strung.displacement(nock)[-1, 0]
    pulled = fb.static(bow, load_steps=steps, start=strung, inputs={"draw": string - DRAW})
    return bow, nock, arrow, strung, pulled


def shoot(mass=SHOWN, weight=1.0, dt=STEP):
    """The motion after the release, what it starts from, and the nodes of nock and arrow."""
    bow, nock, arrow, strung, pulled = drawn(mass, weight)
    bow.free(arrow, "x")
    motion = fb.simulate(bow, dt=dt, t_end=T_END, start=pulled)
    return motion, strung, pulled, nock, arrow


def elastica(places):
    """Forces of the draw [N] and tensions [N] where the nock is at some places x [m]."""
    roots, guess = [], np.array([-60.0, -60.0, -350.0])

    def limb(unknown):
        moment, *force = unknown

        def slopes(s, state):
            turn, moment, _, _ = state
            c, sine = np.cos(turn), np.sin(turn)
            return (
                moment / stiffness(s / LIMB),
                force[0] * sine - force[1] * c,
                c,
                sine,
            )

        start = np.pi / 2, moment, 0.0, 0.0
        end = solve_ivp(slopes, (0, LIMB), start, "DOP853", rtol=1e-10, atol=1e-12).y[:, -1]
        return end[1], end[2:]

    for place in places:

        def missing(unknown, place=place):
            moment, tip = limb(unknown)
            force, string = unknown[1:], np.array([place, 0.0]) - tip
            length = HALF_STRING * (1 + np.hypot(*force) / STRING_EA)
            across = string[0] * force[1] - string[1] * force[0]
            return moment / 100, across / 100, np.hypot(*string) - length

        guess = fsolve(missing, guess, xtol=1e-12)
        roots.append((-2 * guess[1], np.hypot(*guess[1:])))
    return np.array(roots).T


def audit(motion, strung, pulled, nock, arrow, mass):
    """Numbers of a shot."""
    energy, speed = motion.energy, motion.velocity(arrow)[:, 0]
    work = pulled.energy.strain[-1] - strung.energy.strain[-1]
    gap = motion.position(arrow)[:, 0] - motion.position(nock)[:, 0] - AHEAD
    left = int(np.flatnonzero(gap < 0)[-1]) + 1
    return {
        "speed [m/s]": speed[-1],
        "efficiency": mass * speed[-1] ** 2 / 2 / work,
        "it leaves at [ms]": 1e3 * motion.t[left],
        "nock beyond the strung bow [m]": float(
            motion.position(nock)[left, 0] - strung.position(nock)[-1, 0]
        ),
        "balance error": abs(energy.balance_error).max() / energy.total.max(),
    }


def compute():
    """The numbers, and what is drawn."""
    shots = {}
    for mass in ARROWS:
        log.info("arrow of %g g", 1e3 * mass)
        shots[f"{1e3 * mass:g} g"] = shoot(mass)
    light = shoot(SHOWN, LIGHT)
    shown = shots[f"{1e3 * SHOWN:g} g"]
    _, strung, pulled, nock, arrow = shown
    places = pulled.position(nock)[:, 0]
    force = -pulled.reaction(arrow)[:, 0]
    tension = pulled.resultants("upper string").N[:, 0]
    exact = elastica(places)
    hold = elastica([strung.position(nock)[-1, 0]])[1].item()
    travel = places[0] - places
    stored = pulled.energy.strain[-1] - strung.energy.strain[-1]
    # The area under the draw curve, by Simpson's rule over more points of the elastica.
    fine = np.linspace(places[0], places[-1], 41)
    curve = elastica(fine)[0]
    area = np.sum((curve[:-2:2] + 4 * curve[1:-1:2] + curve[2::2]) / 3) * (fine[0] - fine[1])
    numbers = {
        "brace height [m]": float(-strung.position(nock)[-1, 0]),
        "tension, strung [N]": float(strung.resultants("upper string").N[-1, 0]),
        "of the elastica [N]": hold,
        "draw force [N]": float(force[-1]),
        "largest error of the draw curve": float(abs(force - exact[0]).max() / exact[0].max()),
        "largest error of the tension": float(abs(tension / exact[1] - 1).max()),
        "work of the draw [J]": float(stored),
        "area under the draw curve / work": float(area / stored),
        "shots": {name: audit(*shot, float(name[:-2]) / 1e3) for name, shot in shots.items()},
        "light limbs": audit(*light, SHOWN),
    }
    return numbers, (shown, travel, force, (fine[0] - fine, curve))


def report(numbers):
    n = numbers
    print(
        f"Strung: brace height {n['brace height [m]']:.4f} m, string "
        f"{n['tension, strung [N]']:.2f} N (elastica {n['of the elastica [N]']:.2f} N)"
    )
    print(
        f"Drawn by {DRAW} m: {n['draw force [N]']:.1f} N; the draw curve is off the elastica's by "
        f"{n['largest error of the draw curve']:.0e}, the tension by "
        f"{n['largest error of the tension']:.0e}"
    )
    print(
        f"Work of the draw {n['work of the draw [J]']:.2f} J; the area under the curve is "
        f"{n['area under the draw curve / work']:.6f} of it\n"
    )
    row = "{:>12} {:>12} {:>12} {:>14} {:>16}".format
    print(row("arrow", "speed [m/s]", "efficiency", "leaves [ms]", "energy balance"))
    for name, shot in [*n["shots"].items(), ("light limbs", n["light limbs"])]:
        values = (
            f"{shot['speed [m/s]']:.2f}",
            f"{shot['efficiency']:.4f}",
            f"{shot['it leaves at [ms]']:.2f}",
            f"{shot['balance error']:.0e}",
        )
        print(row(name, *values))


def draw(results, shown, travel, force, curve):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    motion, _, pulled, nock, arrow = shown
    plot.scene(scene()[0], results / "scene.png")
    plot.shapes(
        pulled, results / "shapes.png", rows=[0, 3, 6, len(pulled.t) - 1], marks={"nock": nock}
    )
    thumbnail.card(motion, range(len(motion.t)), results / "thumbnail.png")
    figure, axes = plot.figure(1, 2, height=3.0)
    pull, energy = axes.flat
    pull.plot(*curve, color="#0072B2", linewidth=2.8, alpha=0.35, label="elastica")
    pull.plot(travel, force, "o", color="#0072B2", markersize=3.5, label="bow")
    pull.set(xlabel="draw [m]", ylabel="force [N]", xlim=(0, DRAW), ylim=(0, None))
    t = 1e3 * motion.t
    arrow_energy = SHOWN * motion.velocity(arrow)[:, 0] ** 2 / 2
    for label, values, colour in (
        ("arrow", arrow_energy, "#D55E00"),
        ("limbs and string", motion.energy.kinetic - arrow_energy, "#009E73"),
        ("strain energy", motion.energy.strain, "#0072B2"),
        ("total", motion.energy.total, "black"),
    ):
        energy.plot(t, values, color=colour, linewidth=1.0, label=label)
    energy.set(xlabel="time $t$ [ms]", ylabel="energy [J]", xlim=(0, t[-1]), ylim=(0, None))
    plot.save(figure, results / "draw_and_energy.png")
    plot.animate(motion, results / "motion.gif", rows=range(0, 1200, 15), trace=arrow)


if __name__ == "__main__":
    script.run()
