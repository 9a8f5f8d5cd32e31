r"""A folded boom that springs open on a free satellite, with a latch in each hinge.

Three panels are folded against each other, and joined to a satellite and to each other by hinges
with springs. They are let go. Each hinge latches as soon as its panel is in line with the one
before. Objective: the times of the latches, the energy that each latch takes from the motion, and
the invariants: nothing acts on the satellite, so its momenta and the balance of energy hold.

Each hinge has an `fx_beam.Latch`: where the angle reaches it, a step ends, the hinge is locked, and
the motion goes on with velocities that are projected by the mass matrix $M$; an impact takes the
energy $E$:

$$
M (v^+ - v^-) = G^T \mu, \quad G v^+ = 0, \quad
E = \frac{1}{2} (v^+ - v^-) \cdot M (v^+ - v^-).
$$

References, exact for rigid panels:

- One panel on a fixed hub latches after a quarter of the period, $t = \frac{\pi}{2} \sqrt{J/k}$,
  and the impact is all of the spring's energy $\frac{1}{2} k a^2$.
- Both momenta of the free satellite are zero, so that it rests once all hinges are locked: the
  impacts add up to the energy of all springs.

Flexible panels keep nearly all of this energy as a vibration of the boom, which the damping of the
material takes: a latch takes energy only from the nodes at its hinge. Units are metre, kilogram and
second.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

LENGTH = 1.0  # of a panel [m]
PANEL = fb.Section(  # [N], [N], [N m²], [kg/m], [kg m], [s]
    EA=1e6, GA=1e6, EI=400.0, rhoA=1.0, rhoI=1e-3, retardation=5e-3
)
HUB = {"mass": 20.0, "inertia": 2.0}  # [kg], [kg m²]
STIFFNESS = 2.0  # of the spring of a hinge [N m/rad]
# From the folded position to the latch [rad]: panels lie up, down, up; then all to the right.
ANGLES = -np.pi / 2, np.pi, -np.pi
ELEMENTS = 8
DT, T_END = 2e-3, 3.0  # [s]
STORED = sum(STIFFNESS * a**2 / 2 for a in ANGLES)  # energy of all springs [J]


def boom(flexible):
    """Satellite and folded panels; the scene and its hinges by name."""
    scene = fb.Scene()
    hub = scene.add_body((-0.3, 0), **HUB, points={"arm": (0, 0)}, name="satellite")
    root, hinges = hub["arm"], {}
    for i, angle in enumerate(ANGLES):
        ends = (0, 0), (0, LENGTH)
        if i % 2:
            ends = ends[::-1]
        name = f"panel {i + 1}"
        if flexible:
            panel = scene.add_beam(ends, PANEL, elements=ELEMENTS, name=name)
            start, end = panel.start, panel.end
        else:
            mass = PANEL.rhoA * LENGTH
            inertia = mass * LENGTH**2 / 12 + PANEL.rhoI * LENGTH
            points = {"start": ends[0], "end": ends[1]}
            panel = scene.add_body((0, LENGTH / 2), mass, inertia, points, name=name)
            start, end = panel["start"], panel["end"]
        spring = fb.Spring(STIFFNESS, rest=angle)
        hinges[f"hinge {i + 1}"] = scene.add_joint(fb.Revolute(root, start, spring=spring))
        root = end
    return scene, hinges


def deployed(scene, hinges, angles, t_end=T_END, dt=DT):
    """The whole motion, and for each latch its hinge, its time and the energy that it takes."""
    ends = zip(hinges.items(), angles, strict=True)
    latches = {name: fb.Latch(hinge, angle) for (name, hinge), angle in ends}
    whole = fb.simulate(scene, dt=dt, t_end=t_end, changes=latches)
    lost = np.diff(whole.energy.impact)  # by the row before
    times = whole.stats.changes.items()
    return whole, [(name, t, float(lost[np.searchsorted(whole.t, t)])) for name, t in times]


def single():
    """One rigid panel on a fixed hub: time of the latch and energy that it takes."""
    scene = fb.Scene()
    mass, inertia = 1.0, 1.0 / 12
    panel = scene.add_body((0, LENGTH / 2), mass, inertia, points={"root": (0, 0)})
    spring = fb.Spring(STIFFNESS, rest=ANGLES[0])
    hinge = scene.add_joint(fb.Revolute(fb.GROUND, panel["root"], spring=spring))
    whole, events = deployed(scene, {"hinge": hinge}, ANGLES[:1], t_end=2.0, dt=1e-3)
    quarter = np.pi / 2 * np.sqrt((mass * LENGTH**2 / 4 + inertia) / STIFFNESS)
    return {
        "time / exact": events[0][1] / quarter,
        "impact / exact": events[0][2] / (STIFFNESS * ANGLES[0] ** 2 / 2),
        "speed at the end": float(abs(whole.v[-1]).max()),
    }


def compute():
    """The numbers, and what is drawn."""
    numbers, motions = {"single": single()}, {}
    for name in ("rigid", "flexible"):
        log.info("%s panels", name)
        scene, hinges = boom(name == "flexible")
        whole, events = deployed(scene, hinges, ANGLES)
        motions[name] = scene, whole, hinges
        energy = whole.energy
        speed = max(abs(whole.v[..., :2]).max(), 1e-300)
        mass = HUB["mass"] + len(ANGLES) * PANEL.rhoA * LENGTH
        numbers[name] = {
            "latches": {hinge: [t, impact] for hinge, t, impact in events},
            "energy of the springs": float(STORED),
            "impacts / energy of the springs": float(energy.impact[-1] / STORED),
            "relative balance error": float(abs(energy.balance_error).max() / STORED),
            "linear momentum / (m v)": float(abs(whole.linear_momentum).max() / (mass * speed)),
            "angular momentum / (m v l)": float(
                abs(whole.angular_momentum).max() / (mass * speed * LENGTH)
            ),
            "speed at the end": float(abs(whole.v[-1]).max()),
            "largest speed": float(abs(whole.v).max()),
            "turn of the satellite": float(whole.rotation(scene.bodies[0].centre)[-1]),
        }
    return numbers, (motions,)


def report(numbers):
    alone = numbers["single"]
    print(
        f"One panel on a fixed hub: latch at {alone['time / exact']:.8f} of the exact time, impact "
        f"{alone['impact / exact']:.8f} of the energy, then {alone['speed at the end']:.0e} m/s"
    )
    for name in ("rigid", "flexible"):
        run = numbers[name]
        events = run["latches"].items()
        latches = ", ".join(f"{hinge} at {t:.4f} s ({lost:.4f} J)" for hinge, (t, lost) in events)
        print(
            f"{name} panels: {latches}; impacts {run['impacts / energy of the springs']:.9f} of "
            f"the {run['energy of the springs']:.2f} J of the springs; at the end "
            f"{run['speed at the end']:.1e} m/s and the satellite turned by "
            f"{np.degrees(run['turn of the satellite']):.2f} degrees; balance "
            f"{run['relative balance error']:.0e}, momenta "
            f"{run['linear momentum / (m v)']:.0e} and {run['angular momentum / (m v l)']:.0e}"
        )


def draw(results, motions):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    _, whole, hinges = motions["flexible"]
    plot.scene(boom(True)[0], results / "scene.png")
    latest = abs(whole.t - 2.0).argmin()
    rows = [int(row) for row in np.linspace(0, latest, 8)]
    plot.shapes(whole, results / "shapes.png", rows=rows)
    plot.animate(whole, results / "motion.gif", rows=range(0, len(whole.t), 15))
    thumbnail.card(whole, range(0, latest, 20), results / "thumbnail.png")

    figure, axes = plot.figure(1, 2, height=3.0)
    angles, energies = axes.flat
    for i, (hinge, latch) in enumerate(zip(hinges.values(), ANGLES, strict=True)):
        turned = np.degrees(whole.joint(hinge).angle)
        angles.plot(whole.t, turned, f"C{i}", label=f"hinge {i + 1}")
        angles.axhline(np.degrees(latch), color=f"C{i}", linestyle=":")
    angles.set(xlabel="time $t$ [s]", ylabel="angle [degrees]", xlim=(0, T_END))
    for name, line in (("rigid", "--"), ("flexible", "-")):
        run = motions[name][1]
        parts = {"springs": run.energy.springs, "kinetic": run.energy.kinetic}
        parts["lost in latches"] = run.energy.impact
        parts["damped"] = run.energy.dissipated
        for (part, values), colour in zip(parts.items(), ("C4", "C3", "k", "C2"), strict=True):
            label = part if name == "flexible" else None
            energies.plot(run.t, values, colour, linestyle=line, label=label)
    energies.plot([], [], "0.5", linestyle="--", label="rigid panels")
    energies.set(xlabel="time $t$ [s]", ylabel="energy [J]", xlim=(0, T_END))
    plot.save(figure, results / "angles_and_energy.png")


if __name__ == "__main__":
    script.run()
