r"""Three-bar swing: a flexible beam between two rigid links.

A slender beam with a mass in its middle hangs on two nearly rigid links. A short force sets the
mass in motion to the right. At 0.64 s the left link and the left half of the beam are in line and
stop the mass. Its motion is reversed within a few milliseconds, by an axial force a thousand times
larger than before. The beam then vibrates along its axis. Objective: the motion before the
reversal, and the axial force of the beam and the total energy during and after it (the paper's
figures 9 to 12).

Reference: A. Ibrahimbegovic, S. Mamouri, Nonlinear dynamics of flexible beams in planar motion:
formulation and time-stepping scheme for stiff problems, Computers & Structures 70 (1999) 1-22,
section 4.2, doi 10.1016/S0045-7949(98)00150-3. Data that our text of the paper does not give are
taken from other published models of this swing; OURS below lists them.

At a hinge both nodes have the same displacement unknowns, and each has its own rotation. With the
masses $m_i$ and the force $F$ on the mass in the middle, the energy $H$ and its balance are

$$
\begin{aligned}
H &= \frac{1}{2} \sum m_i |v_i|^2
+ \frac{1}{2} \int (\rho A\,|v|^2 + \rho I\,\omega^2 + E \cdot C E + EI\,K^2)\,\mathrm{d}s, \\
\dot H &= F \cdot v,
\end{aligned}
$$

so the energy is constant from 0.256 s on, when the force has ended. After the reversal the motion
depends on mesh and time step, but the energy does not.

The links are ten times as stiff as the beam, with one element each. The paper gives no mass for
them. They are massless here; in one further run they have the beam's mass per length, to show its
effect. There is no gravity. Units are metre, kilogram and second.
"""

import logging
from dataclasses import replace

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

# Data that are not in the paper, or have lost digits in our text of it.
OURS = {
    "places of hinges": "from other published models; the paper has them in a figure",
    "section": "5 mm x 1 mm, the 1 mm in the plane, from other published models",
    "Poisson's ratio": "0.3, from other published models",
    "shear factor": "5/6, our own",
    "density": "2700 kg/m3, deduced: the text has '700'",
    "pulse": "0 to 2 N at 0.128 s, 0 at 0.256 s, partly deduced: the text has 't = 0.8 to'",
    "links": "ten times as stiff as the beam ('an order of magnitude'), without mass: our own",
    "time steps": "our own",
    "alpha of HHT": "our own",
}
LEFT, RIGHT = (0.0, 0.0), (1.08, 0.0)  # hinges on the ground, O1 and O2 [m]
A, C = (0.0, -0.36), (0.72, -0.36)  # ends of the beam [m]
SECTION = fb.Section.rectangle(height=1e-3, width=5e-3, E=73e9, nu=0.3, rho=2700.0)
LINK = fb.Section(EA=10 * SECTION.EA, GA=10 * SECTION.GA, EI=10 * SECTION.EI)
HEAVY_LINK = replace(LINK, rhoA=SECTION.rhoA, rhoI=SECTION.rhoI)
MASS = 0.5  # [kg]
PULSE = (0.0, 0.128, 0.256), (0.0, 2.0, 0.0)  # times [s] and force in x on the mass [N]
PULSE_END = PULSE[0][-1]
ELEMENTS = 4
T_END = 1.0  # [s]
DT = 5e-4  # [s]
STEPS = (2 * DT, DT, DT / 2)

SCHEMES = {
    "EnergyMomentum": fb.EnergyMomentum(),
    "EnergyDecaying": fb.EnergyDecaying(),
    "ModifiedMidPoint (as published)": fb.ModifiedMidPoint(),
    "Newmark (trapezoidal)": fb.Newmark(),
    "HHT, alpha = -0.1": fb.HHT(-0.1),
}
CONSERVING = "EnergyMomentum", "ModifiedMidPoint (as published)"
# A failing step is halved at most twice: more would only prolong a motion that is lost.
MAX_HALVINGS = 2

# Displacements of B, a quarter of the span from A, and of the middle, and positions of A and C [m]
# at some times [s], from an independent program with 16 elements.
REFERENCE = {
    0.128: ((0.01068, 0.0010), (0.01067, 0.0), (0.0107, -0.3598), (0.7305, -0.3702)),
    0.256: ((0.06402, 0.0066), (0.06383, -0.0008), (0.0640, -0.3543), (0.7801, -0.4114)),
    0.400: ((0.13629, 0.0163), (0.1350, -0.0048), (0.1366, -0.3331), (0.8443, -0.4512)),
    0.500: ((0.1879, 0.0257), (0.1843, -0.0101), (0.1902, -0.3057), (0.8894, -0.4721)),
    0.600: ((0.2440, 0.0433), (0.2337, -0.0169), (0.2554, -0.2537), (0.9360, -0.4883)),
}


def scene(elements=ELEMENTS, degree=1, link=None):
    """The swing; its beams are called beam, left and right."""
    swing = fb.Scene()
    beam = swing.add_beam([A, C], SECTION, elements=elements, degree=degree, name="beam")
    link = link or LINK
    left = swing.add_beam([LEFT, A], link, degree=degree, name="left", elements=1)
    right = swing.add_beam([RIGHT, C], link, degree=degree, name="right", elements=1)
    swing.pin(left.start)
    swing.pin(right.start)
    swing.add_joint(fb.Revolute(left.end, beam.start))
    swing.add_joint(fb.Revolute(right.end, beam.end))
    middle = beam.node(0.5)
    swing.add_mass(middle, MASS)
    swing.add_force(middle, lambda t: (np.interp(t, *PULSE), 0.0))
    return swing


def simulate(scheme, dt, elements=ELEMENTS, link=None):
    """The solution, up to a step that fails."""
    log.info("%s, dt = %g s, %d elements", scheme.name, dt, elements)
    swing = scene(elements, link=link)
    try:
        return fb.simulate(swing, scheme, dt=dt, t_end=T_END, max_halvings=MAX_HALVINGS)
    except fb.StepError as error:
        return error.solution


def displacement(solution):
    """Displacement of B, a quarter of the span from A."""
    return solution.displacement(solution.beams["beam"].node(0.25))


def axial_force(solution):
    """Axial force of the beam in its element next to A."""
    return solution.resultants("beam").N[:, 0]


def force_before(solution, t=PULSE[0][1]):
    """Axial forces in the beam and in the left link near a time, by default the pulse's peak."""
    row = abs(solution.t_level - t).argmin()
    forces = solution.resultants("beam").N[row]
    return {
        "beam": [forces.min(), forces.max()],
        "left link": solution.resultants("left").N[row, 0],
    }


def energy(solution):
    return solution.energy.total


def energy_ratio(solution):
    """Times after the pulse has ended, and the energy relative to that at its end."""
    after = solution.t > PULSE_END - 1e-9
    return solution.t[after], solution.energy.total[after] / solution.energy.total[after][0]


def reversal(solution):
    """Time [s] at which the right link turns back, interpolated from its angular velocity."""
    x, y = (solution.position(solution.beams["right"].end) - RIGHT).T
    rate = np.diff(np.unwrap(np.arctan2(y, x))) / np.diff(solution.t)
    t = (solution.t[1:] + solution.t[:-1]) / 2
    turns = (t[1:] > PULSE_END) & (rate[1:] * rate[:-1] <= 0)
    if not turns.any():
        return None
    k = turns.argmax()
    return float(t[k] - rate[k] * (t[k + 1] - t[k]) / (rate[k + 1] - rate[k]))


def audit(solution):
    """Numbers by which a run is assessed."""
    after, ratio = energy_ratio(solution)
    axial_forces = solution.resultants("beam").N
    force = axial_forces.max(axis=1)
    peak = force.argmax()
    return {
        "steps": solution.stats.steps,
        "energy after the pulse": float(np.interp(after[0], solution.t, energy(solution))),
        "lowest energy ratio": ratio.min(),
        "highest energy ratio": ratio.max(),
        "energy drift": abs(ratio - 1).max(),
        "balance error": abs(solution.energy.balance_error).max(),
        "largest axial force": force[peak],
        "largest axial force in the left link": solution.resultants("left").N.max(),
        "time of the largest axial force": solution.t_level[peak],
        "reversal": reversal(solution),
        "Newton iterations": solution.stats.newton_iterations,
        "halvings": solution.stats.halvings,
        "failed at": solution.t[-1] if solution.stats.failure else None,
        "failure": solution.stats.failure and solution.stats.failure.reason,
    }


def compare(solution, dt):
    """Displacements of B and of the middle, positions of A and C, against the reference."""
    beam = solution.beams["beam"]
    angles = np.stack(
        [
            displacement(solution),
            solution.displacement(beam.node(0.5)),
            solution.position(beam.start),
            solution.position(beam.end),
        ],
        axis=1,
    )[[round(t / dt) for t in REFERENCE]]
    difference = abs(angles - np.array(list(REFERENCE.values())))
    return {"found": angles.tolist(), "largest difference": difference.max()}


def compute(steps=STEPS):
    """The numbers, and what is drawn."""
    runs = {(name, dt): simulate(SCHEMES[name], dt) for name in SCHEMES for dt in steps}
    meshes = {ELEMENTS: runs["EnergyMomentum", DT], 16: simulate(fb.EnergyMomentum(), DT, 16)}
    heavy = simulate(fb.EnergyMomentum(), DT, link=HEAVY_LINK)
    numbers = {
        "not in the paper": OURS,
        "links with the beam's mass per length": audit(heavy),
        "axial force at the peak of the pulse": force_before(runs["EnergyMomentum", DT]),
        "reference": {f"{elements} elements": compare(s, DT) for elements, s in meshes.items()},
        "reversal": {f"{elements} elements": reversal(s) for elements, s in meshes.items()},
        "schemes": {
            name: {f"dt {dt:g}": audit(runs[name, dt]) for dt in steps} for name in SCHEMES
        },
    }
    return numbers, (runs, meshes, heavy)


def report(numbers):
    print("Not in the paper, or illegible in our text of it:")
    print(*(f"    {name}: {why}" for name, why in OURS.items()), sep="\n")
    forces = numbers["axial force at the peak of the pulse"]
    print(
        "Axial force at the peak of the pulse [N]: {:.3f} to {:.3f} along the beam, ".format(
            *forces["beam"]
        )
        + f"{forces['left link']:.3f} in the left link"
    )
    massive = numbers["links with the beam's mass per length"]
    print(
        "Links with the beam's mass per length: the right one turns back at "
        f"{massive['reversal']:.4f} s, largest axial force {massive['largest axial force']:.0f} N"
    )
    print("Displacements of B and of the middle, positions of A and C [m] by EnergyMomentum:")
    for (name, run), reversal_time in zip(
        numbers["reference"].items(), numbers["reversal"].values(), strict=True
    ):
        print(
            f"{name}: at most {run['largest difference']:.1e} m from the reference; the right "
            f"link turns back at {reversal_time:.4f} s"
        )
        for t, places in zip(REFERENCE, run["found"], strict=True):
            print(f"    t = {t:.3f} s ", *("{:9.5f} {:8.5f} ".format(*place) for place in places))

    print(
        f"\n{T_END:g} s with {ELEMENTS} elements, a failing step halved at most {MAX_HALVINGS} "
        f"times. E0 is the energy at {PULSE_END} s:"
    )
    row = "{:31} {:>6} {:>5} {:>8} {:>7} {:>7} {:>8} {:>6} {:>7} {:>7} {:>5} {:>6}".format
    print(row("", "dt", "", "", "lowest", "highest", "largest", "max", "at", "Newton", "halv-", ""))
    units = "[s]", "steps", "E0 [J]", "E/E0", "E/E0", "|E/E0-1|", "N [N]", "[s]", "it/step"
    print(row("scheme", *units, "ings", "failed"))
    failures = []
    for name, runs in numbers["schemes"].items():
        for dt, run in runs.items():
            failed = run["failure"] is not None
            values = (
                dt.removeprefix("dt "),
                run["steps"],
                f"{run['energy after the pulse']:.6f}",
                f"{run['lowest energy ratio']:.4f}",
                f"{run['highest energy ratio']:.4f}",
                f"{run['energy drift']:.1e}",
                f"{run['largest axial force']:.1f}",
                f"{run['time of the largest axial force']:.4f}",
                f"{run['Newton iterations'] / run['steps']:.1f}",
                run["halvings"],
                f"{run['failed at']:.2f} s" if failed else "never",
            )
            print(row(name, *values))
            failures += [run["failure"]] if failed else []
    print(*failures, sep="\n", end="")


def draw(results, runs, meshes, heavy):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    solutions = {name: runs[name, DT] for name in SCHEMES}
    solution = solutions["EnergyMomentum"]
    tenth = round(0.1 / DT)
    beam = solution.beams["beam"]
    marks = {"A": beam.start, "B": beam.node(0.25), "C": beam.end}
    plot.scene(beam.start.scene, results / "scene.png", dimensions=True, marks=marks)
    rows = range(0, len(solution.t), tenth)
    plot.shapes(solution, results / "shapes.png", rows=rows, marks=marks)
    frames = range(0, len(solution.t), tenth // 10)
    plot.animate(solution, results / "motion.gif", rows=frames, trace=marks["B"], marks=marks)
    thumbnail.card(solution, frames, results / "thumbnail.png")

    figure, axes = plot.figure(2, 1)
    for i, ax in enumerate(axes.flat):
        ax.set(xlim=(0, T_END), xlabel="time $t$ [s]", ylabel=f"displacement $u_{'xy'[i]}$ [m]")
        for (elements, run), line in zip(meshes.items(), ("-", "--"), strict=True):
            ax.plot(run.t, displacement(run)[:, i], line, label=f"B, {elements} elements")
        known = [places[0][i] for places in REFERENCE.values()]
        ax.plot(list(REFERENCE), known, "ko", markerfacecolor="none", label="reference")
    plot.save(figure, results / "displacement.png")

    figure, axes = plot.figure(3, 2)
    (smooth, peak), (whole, links), (total, drift) = axes
    for ax in axes.flat:
        ax.set(xlim=(0, T_END), xlabel="time $t$ [s]")
    smooth.set_title(f"$\\Delta t$ = {DT:g} s")
    # Before the reversal, during it, and the whole run; smaller forces on top.
    upper = *CONSERVING, "EnergyDecaying"
    shown = [name for name in SCHEMES if name not in upper] + [*upper]
    solutions = {name: solutions[name] for name in shown}
    windows = (smooth, (0, 0.62), (-0.1, 0.4)), (peak, (0.635, 0.65), (-80, 160))
    for ax, xlim, ylim in (*windows, (whole, (0, T_END), (-80, 160))):
        ax.set(xlim=xlim, ylim=ylim, ylabel="axial force $N$ [N]")
        plot.curves(ax, solutions, axial_force, lambda solution: solution.t_level)
    links.set(xlim=(0.635, 0.66), ylim=(-80, 160), ylabel="axial force $N$ [N]")
    plot.curves(links, {"EnergyMomentum": solution}, axial_force, lambda s: s.t_level)
    look = {"color": "#CC79A7", "linewidth": 1.2, "label": "EnergyMomentum, links with mass"}
    links.plot(heavy.t_level, axial_force(heavy), **look)
    total.set(ylim=(0, 0.08), ylabel="total energy $E$ [J]")
    plot.curves(total, solutions, energy)
    drift.set(xlim=(PULSE_END, T_END), ylim=(1e-15, 1), yscale="log")
    drift.set(ylabel="largest $|E/E_0 - 1|$ so far [-]")
    plot.curves(
        drift,
        solutions,
        lambda solution: np.maximum.accumulate(abs(energy_ratio(solution)[1] - 1)),
        lambda solution: energy_ratio(solution)[0],
    )
    plot.save(figure, results / "force_and_energy.png")


if __name__ == "__main__":
    script.run()
