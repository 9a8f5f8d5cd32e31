r"""Multi-body system of four flexible members with hinges and a slide.

Two hinged members connect the right support with a telescopic leg on the left support. A short
moment at the right support sets them in motion; after it no load acts. At 0.6 s they have swung to
the other side, where they are in line and the leg has its greatest length. This excites axial
vibrations. A time step that suits the motion does not resolve them. Objective: the motion with
exact joints, and the total energy by several schemes and time steps (the paper's figures 14 to 17).

Reference: A. Ibrahimbegovic, S. Mamouri, Nonlinear dynamics of flexible beams in planar motion:
formulation and time-stepping scheme for stiff problems, Computers & Structures 70 (1999) 1-22,
section 4.3, doi 10.1016/S0045-7949(98)00150-3.

From the paper: four flexible members, 20 two-node elements, revolute and prismatic joints, start at
rest, and a moment at the right support that rises linearly until 0.25 s and falls to 0 at 0.5 s.
All other data are in a figure that we do not have; OURS below lists our choice.

The peak of the moment is "5 N m" in the only text that we have, in which many digits are missing.
5, 15 and 25 N m are possible. With 5 N m and our geometry the axial vibration starts at 1.4 s, and
HHT never gains energy. With 15 N m everything happens that the paper describes: fast axial
vibration from about 0.5 s on, and the energy blows up with Newmark and with HHT. So we take 15 N m.

After about 1.2 s the motion depends on mesh and time step, and later on round-off. Some results do
not depend on them: EnergyMomentum conserves the energy, the published scheme nearly conserves it,
and Newmark's rule loses the motion with every time step. HHT with small $\alpha$ or large steps
also loses it, but later; see damping_scan.py.

```text
B o---2---o A        supports (0, 0) and (1, 0), A = (1, 1), B = (0, 1) m;
  3       |          member 1 from the right support to A, 2 from A to B,
  #       1          3 from B halfway down, 4 from the left support halfway up;
  4       |          the end of 4 carries a straight guide of unlimited length,
  o       o          along which the end of 3 slides
```

At a hinge both nodes have the same displacement unknowns. With the rotation $\psi_4$ of the guide,
its direction $a_0$ in the reference configuration, and the slide $d$, which is an additional
unknown, the prismatic joint is

$$ \varphi_3 = \varphi_4 + d\,R(\psi_4)\,a_0, \qquad \psi_3 = \psi_4. $$

There are no multipliers. The unknowns are 3 per node, minus those that supports and joints remove,
plus one slide. Units are metre, kilogram and second.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

RIGHT, LEFT = (1.0, 0.0), (0.0, 0.0)  # supports [m]
A, B, MIDDLE = (1.0, 1.0), (0.0, 1.0), (0.0, 0.5)  # joints [m]
SIZE = 1.0  # [m]
# Steel strip; EA/EI = 12/height^2 = 3e6 1/m².
SECTION = fb.Section.rectangle(height=2e-3, width=20e-3, E=210e9, nu=0.3, rho=7850.0)
ELEMENTS = 5  # of each member
PULSE = (0.0, 0.25, 0.5), (0.0, -15.0, 0.0)  # times [s] and moment at the right support [N m]
PULSE_END = PULSE[0][-1]
T_END, SHOWN = 4.0, 2.0  # end of the runs, and of the pictures [s]
LARGE, DT, SMALL = STEPS = (0.01, 0.005, 0.0025)  # [s]

# Data that are not in the paper, or illegible in our text of it.
OURS = {
    "places of supports and joints": "our own",
    "section": "our own, a steel strip of 2 mm x 20 mm",
    "peak of the moment": "read as 15 N m",
    "sense of the moment": "our own, clockwise",
    "length of the slide": "our own, unlimited",
    "time steps, end of the run": "our own",
    "alpha of HHT": "our own",
}

SCHEMES = {
    "EnergyMomentum": fb.EnergyMomentum(),
    "ModifiedMidPoint (as published)": fb.ModifiedMidPoint(),
    "Newmark (trapezoidal)": fb.Newmark(),
    "HHT, alpha = -0.05": fb.HHT(-0.05),
    "HHT, alpha = -0.1": fb.HHT(-0.1),
    "Generalized alpha, 0.9": fb.GeneralizedAlpha(0.9),
}
CONSERVING = "EnergyMomentum", "ModifiedMidPoint (as published)"
# The motion counts as lost when the energy exceeds this multiple of that at the end of the moment.
LOST = 1.5
# Where a scheme may lose the motion, a failing step is halved at most twice: more would only
# prolong a lost motion. Schemes that keep the energy have the default: a few of their steps fail.
MAX_HALVINGS = 2


def scene(elements=ELEMENTS, degree=1):
    """The scene and its joints by name."""
    system = fb.Scene()
    mesh = {"elements": elements, "degree": degree}
    members = [
        system.add_beam(ends, SECTION, **mesh, name=f"member {number}")
        for number, ends in enumerate([(RIGHT, A), (A, B), (B, MIDDLE), (LEFT, MIDDLE)], 1)
    ]
    first, second, third, fourth = members
    system.pin(first.start)
    system.pin(fourth.start)
    joints = {
        "A": system.add_joint(fb.Revolute(first.end, second.start)),
        "B": system.add_joint(fb.Revolute(second.end, third.start)),
        "slide": system.add_joint(fb.Prismatic(fourth.end, third.end, axis=(0, 1))),
    }
    system.add_moment(first.start, lambda t: np.interp(t, *PULSE))
    return system, joints


def keeps_energy(scheme):
    """Whether a scheme keeps the energy, exactly or nearly."""
    return scheme.name in ("EnergyMomentum", "ModifiedMidPoint")


def simulate(scheme, dt):
    """The solution, up to a step that fails, and its joints."""
    log.info("%s, dt = %g s", scheme.name, dt)
    system, joints = scene()
    limit = {} if keeps_energy(scheme) else {"max_halvings": MAX_HALVINGS}
    try:
        solution = fb.simulate(system, scheme, dt=dt, t_end=T_END, **limit)
    except fb.StepError as error:
        solution = error.solution
    return solution, joints


def displacement(solution, joint):
    """Vertical displacement of the hinge A or B."""
    member = {"A": "member 1", "B": "member 2"}[joint]
    return solution.displacement(solution.beams[member].end)[:, 1]


def axial_force(solution):
    """Axial force at the Gauss point to the left of A, in member 2."""
    return solution.resultants("member 2").N[:, 0]


def energy(solution):
    return solution.energy.total


def energy_ratio(solution):
    """Times after the moment has ended, and the energy relative to that at its end."""
    after = solution.t > PULSE_END - 1e-9
    return solution.t[after], solution.energy.total[after] / solution.energy.total[after][0]


def lost_at(solution):
    """Time [s] at which the energy exceeds LOST times its initial value, or a step failed."""
    t, ratio = energy_ratio(solution)
    above = t[~(ratio <= LOST)]
    if len(above):
        return above[0]
    return solution.t[-1] if solution.stats.failure else None


def largest_force(solution, start, end):
    """Largest axial force to the left of A between two times."""
    t = solution.t_level
    inside = (t > start) & (t <= end)
    return abs(axial_force(solution)[inside]).max(initial=0.0)


def audit(solution, joints):
    """Numbers by which a run is assessed."""
    after, ratio = energy_ratio(solution)
    slide = solution.joint(joints["slide"]).slide
    return {
        "steps": solution.stats.steps,
        "energy after the pulse": float(np.interp(after[0], solution.t, energy(solution))),
        "lowest energy ratio": ratio.min(),
        "highest energy ratio": ratio.max(),
        "energy drift": abs(ratio - 1).max(),
        "balance error": abs(solution.energy.balance_error).max(),
        "largest gap": max(solution.joint(joint).gap.max() for joint in joints.values()) / SIZE,
        "slide": [slide.min(), slide.max()],
        "largest axial force during the pulse": largest_force(solution, 0.0, PULSE_END),
        "largest axial force up to 0.7 s": largest_force(solution, PULSE_END, 0.7),
        "lost at": lost_at(solution),
        "Newton iterations": solution.stats.newton_iterations,
        "halvings": solution.stats.halvings,
        "failed at": solution.t[-1] if solution.stats.failure else None,
        "failure": solution.stats.failure and solution.stats.failure.reason,
    }


def count(solution, joints):
    """Number of unknowns, and the numbers from which it follows."""
    supports = len(solution.beams["member 1"].start.scene.fixed)
    revolutes = sum(2 for joint in joints.values() if joint.kind == "Revolute")
    slides = sum(1 for joint in joints.values() if joint.axis is not None)
    return {
        "nodes": len(solution.X),
        "constrained by supports": supports,
        "constrained by joints": revolutes + 3 * slides,
        "slides": slides,
        "unknowns": solution.stats.unknowns,
    }


def compute(steps=STEPS):
    """The numbers, and what is drawn."""
    runs = {(name, dt): simulate(SCHEMES[name], dt) for name in SCHEMES for dt in steps}
    solution, joints = runs["EnergyMomentum", DT]
    bent = [abs(solution.resultants(name).M).max() for name in solution.beams]
    numbers = {
        "not in the paper": OURS,
        "unknowns": count(solution, joints),
        "largest bending moments": bent,
        "schemes": {
            name: {f"dt {dt:g}": audit(*runs[name, dt]) for dt in steps} for name in SCHEMES
        },
    }
    return numbers, (runs,)


def report(numbers):
    unknowns = numbers["unknowns"]
    moments = ", ".join(f"{moment:.2f}" for moment in numbers["largest bending moments"])
    print("Not in the paper, or illegible in our text of it:")
    print(*(f"    {name}: {why}" for name, why in OURS.items()), sep="\n")
    print(
        "Unknowns: 3 x {nodes} - {constrained by supports} (supports) - {constrained by joints} "
        "(joints) + {slides} (slide) = {unknowns}".format(**unknowns)
        + f"\nEI = {SECTION.EI:.3g} N m^2, EA = {SECTION.EA:.3g} N, "
        f"{SECTION.rhoA:.3g} kg/m; largest bending moments {moments} N m"
        f"\n\n{T_END:g} s. By schemes that may lose the motion a failing step is halved at most "
        f"{MAX_HALVINGS} times.\nE0 is the energy at {PULSE_END} s. "
        f"A motion is lost when its energy exceeds {LOST} E0 or a step fails.\n"
        "Largest |N| left of A during the pulse, and from then to 0.7 s:"
    )
    row = "{:31} {:>6} {:>5} {:>7} {:>6} {:>7} {:>8} {:>7} {:>12} {:>6} {:>6} {:>7} {:>5} {:>6}"
    row = row.format
    names = "", "dt", "", "", "lowest", "highest", "largest", "largest", "slide", "|N|", "|N|"
    print(row(*names, "Newton", "halv-", "lost"))
    units = "[s]", "steps", "E0 [J]", "E/E0", "E/E0", "|E/E0-1|", "gap [m]", "[m]", "[N]", "[N]"
    print(row("scheme", *units, "it/step", "ings", "at [s]"))
    failures = []
    for name, runs in numbers["schemes"].items():
        for dt, run in runs.items():
            values = (
                dt.removeprefix("dt "),
                run["steps"],
                f"{run['energy after the pulse']:.5f}",
                f"{run['lowest energy ratio']:.3f}",
                f"{run['highest energy ratio']:.3f}",
                f"{run['energy drift']:.1e}",
                f"{run['largest gap']:.0e}",
                "{:.2f} to {:.2f}".format(*run["slide"]),
                f"{run['largest axial force during the pulse']:.3g}",
                f"{run['largest axial force up to 0.7 s']:.3g}",
                f"{run['Newton iterations'] / run['steps']:.1f}",
                run["halvings"],
                "never" if run["lost at"] is None else f"{run['lost at']:.3g}",
            )
            print(row(name, *values))
            failures += [run["failure"]] if run["failure"] else []
    print(*failures, sep="\n", end="\n" if failures else "")


def draw(results, runs):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    solution, joints = runs["EnergyMomentum", DT]
    marks = {"A": solution.beams["member 1"].end, "B": solution.beams["member 2"].end}
    plot.scene(marks["A"].scene, results / "scene.png", dimensions=True, marks=marks)
    rows = range(0, round(0.9 / DT) + 1, round(0.1 / DT))
    plot.shapes(solution, results / "shapes.png", rows=rows, marks=marks)
    frames, path = range(0, round(SHOWN / DT) + 1, 2), results / "motion.gif"
    plot.animate(solution, path, rows=frames, fps=25, trace=marks["B"], marks=marks)
    thumbnail.card(solution, frames, results / "thumbnail.png")

    figure, axes = plot.figure(3, 1)
    for ax in axes.flat:
        ax.set(xlim=(0, SHOWN), xlabel="time $t$ [s]")
    for dt, line in zip(STEPS, (":", "-", "--"), strict=True):
        run, joints = runs["EnergyMomentum", dt]
        look = {"linestyle": line, "label": f"dt = {dt:g} s"}
        for ax, joint in zip(axes[:2, 0], "AB", strict=True):
            ax.plot(run.t, displacement(run, joint), **look)
            ax.set(ylabel=f"displacement $u_y$ of {joint} [m]")
        axes[2, 0].plot(run.t, run.joint(joints["slide"]).slide, **look)
    axes[2, 0].set(ylabel="slide $d$ [m]")
    plot.save(figure, results / "displacement.png")

    figure, axes = plot.figure(3, len(STEPS))
    # Conserving schemes are drawn last, on top of those whose curves fill the panel.
    names = [*(name for name in SCHEMES if name not in CONSERVING), *CONSERVING]
    for (total, drift, force), dt in zip(axes.T, STEPS, strict=True):
        solutions = {name: runs[name, dt][0] for name in names}
        total.set(xlim=(0, SHOWN), ylim=(0, 100), title=f"$\\Delta t$ = {dt:g} s")
        plot.curves(total, solutions, energy)
        drift.set(xlim=(0, SHOWN), ylim=(1e-16, 1e3), yscale="log")
        plot.curves(
            drift,
            solutions,
            lambda solution: np.maximum.accumulate(abs(energy_ratio(solution)[1] - 1)),
            lambda solution: energy_ratio(solution)[0],
        )
        force.set(xlim=(0, SHOWN), ylim=(-300, 300))
        plot.curves(force, solutions, axial_force, lambda solution: solution.t_level)
    labels = "total energy $E$ [J]", "largest $|E/E_0 - 1|$ so far [-]", "axial force $N$ [N]"
    for row, label in zip(axes, labels, strict=True):
        row[0].set(ylabel=label)
    for ax in axes.flat:
        ax.set(xlabel="time $t$ [s]")
    plot.save(figure, results / "energy_and_force.png")


if __name__ == "__main__":
    script.run()
