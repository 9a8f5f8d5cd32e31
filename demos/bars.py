r"""Bars in axial impact: one that hits a wall, and one that hits another bar end to end.

A bar that flies along its axis with the speed $v$ hits a rigid wall, or a bar of the same kind at
rest. Objective: the force while they touch and how long that lasts, against the exact solutions of
the wave equation (Saint-Venant 1867). With the wave speed $c = \sqrt{EA/\rho A}$:

- wall: $F = v \sqrt{EA\,\rho A}$ for the time $2 L/c$, then the bar flies back with $v$,
- two bars: $F = \frac{1}{2} v \sqrt{EA\,\rho A}$ for $2 L/c$, then they have exchanged their
  velocities.

In both cases a wave runs from the place of the impact to the free end and back. Behind it no
vibration is left.

The wall is an obstacle for the end of the bar. The two bars are members in contact: the end of one
touches the round end of the other. Contacts are springs, so stiff that they close in a small part
of the time of the wave. Elements disperse the steep front of the wave, which leaves a small
vibration; `EnergyDecaying` takes a part of it.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

LENGTH, RADIUS, SPEED = 1.0, 0.01, 1.0
SECTION = fb.Section(EA=1e4, GA=4e3, EI=1.0, rhoA=1.0, rhoI=1e-4)
STIFFNESS = 1e6
GAP = 1e-4
DT, T_END = 5e-5, 0.03
ELEMENTS = (25, 100, 400)

WAVE = np.sqrt(SECTION.EA / SECTION.rhoA)
IMPEDANCE = np.sqrt(SECTION.EA * SECTION.rhoA)
LASTS = 2 * LENGTH / WAVE
EXACT = {"wall": IMPEDANCE * SPEED, "two bars": IMPEDANCE * SPEED / 2}


def bar(scene, start, elements):
    """A bar along x that neither bends nor turns."""
    made = scene.add_beam([(start, 0), (start + LENGTH, 0)], SECTION, elements)
    for node in made.nodes:
        scene.fix(node, "y", "rotation")
    return made


def against_wall(elements):
    """A bar that flies to the left, and its contact."""
    scene = fb.Scene()
    flying = bar(scene, GAP, elements)
    wall = scene.add_contact(flying.start, fb.Line((0, 0), normal=(1, 0)), stiffness=STIFFNESS)
    scene.set_velocity(flying, (-SPEED, 0.0))
    return scene, wall


def end_to_end(elements):
    """A bar that flies to the right, one at rest, and their contact."""
    scene = fb.Scene()
    flying = bar(scene, 0.0, elements)
    other = bar(scene, LENGTH + 2 * RADIUS + GAP, elements)
    touch = scene.add_contact(flying.end, other, stiffness=STIFFNESS, radius=RADIUS)
    scene.set_velocity(flying, (SPEED, 0.0))
    return scene, touch


SCENES = {"wall": against_wall, "two bars": end_to_end}


def impact(name, elements):
    """The motion, the force of the contact, and the mean velocities of the bars."""
    scene, contact = SCENES[name](elements)
    motion = fb.simulate(scene, fb.EnergyDecaying(), dt=DT, t_end=T_END)
    force = abs(motion.contact(contact).force[:, 0, 0])
    shares = np.ones(elements + 1)
    shares[[0, -1]] = 0.5
    velocities = [
        motion.v[:, motion.nodes_of_beam[beam.name], 0] @ shares / elements for beam in scene.beams
    ]
    return motion, force, velocities


def compute():
    """The numbers, and what is drawn."""
    numbers, runs = {}, {}
    for name in SCENES:
        meshes = numbers[name] = {}
        for elements in ELEMENTS:
            log.info("%s, %d elements", name, elements)
            motion, force, velocities = runs[name, elements] = impact(name, elements)
            pushes = np.flatnonzero(force > 0.5 * EXACT[name])
            inside = (motion.t > 0.1 * LASTS) & (motion.t < 0.9 * LASTS)
            meshes[elements] = {
                "force": float(force[inside].mean()),
                "exact force": EXACT[name],
                "lasts": float(motion.t[pushes[-1]] - motion.t[pushes[0]] + DT),
                "exact": LASTS,
                "velocities": [float(v[-1]) for v in velocities],
                "energy balance": float(
                    abs(motion.energy.balance_error).max() / motion.energy.kinetic[0]
                ),
            }
    return numbers, (runs,)


def report(numbers):
    for name, meshes in numbers.items():
        for elements, run in meshes.items():
            velocities = ", ".join(f"{v:+.4f}" for v in run["velocities"])
            print(
                f"{name}, {elements} elements: force {run['force']:.3f} N (exact "
                f"{run['exact force']:g}), for {1e3 * run['lasts']:.2f} ms (exact "
                f"{1e3 * run['exact']:g}); velocities afterwards {velocities} m/s; energy "
                f"balance {run['energy balance']:.0e}"
            )


def draw(results, runs):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    shown = runs["two bars", ELEMENTS[0]][0]
    rows, path = range(0, len(shown.t), 12), results / "thumbnail.png"
    plot.animate(shown, results / "motion.gif", rows=rows, magnify=10.0, size=(700, 320))
    thumbnail.card(shown, rows, path, magnify=10.0)
    figure, axes = plot.figure(1, 2, height=3.4)
    force, speeds = axes.flat
    for n, name in enumerate(SCENES):
        motion, pushes, velocities = runs[name, ELEMENTS[1]]
        first = GAP / SPEED
        exact = EXACT[name] * ((motion.t > first) & (motion.t < first + LASTS))
        force.plot(1e3 * motion.t, pushes, color=f"C{n}", lw=1, label=name)
        force.plot(1e3 * motion.t, exact, "k--", lw=1)
        for velocity in velocities:
            speeds.plot(1e3 * motion.t, velocity, color=f"C{n}", lw=1)
    force.plot([], [], "k--", lw=1, label="exact")
    force.set(xlabel="time [ms]", ylabel="force of the contact [N]", ylim=(0, None))
    speeds.set(xlabel="time [ms]", ylabel="mean velocity of each bar [m/s]")
    plot.save(figure, results / "force_and_velocities.png")


if __name__ == "__main__":
    script.run()
