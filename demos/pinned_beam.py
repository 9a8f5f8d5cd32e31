r"""Pinned flexible beam in free rotation.

A beam that is pinned at one end starts with a transverse velocity. It turns about the pin and
vibrates with large displacements. There are no loads, so its total energy and its angular momentum
about the pin are constant. The time step does not resolve its axial waves: the problem is stiff.
Objective: a motion of ten seconds with 8 elements and steps of 0.01 s, and the errors of the two
invariants by each time scheme.

Reference: A. Ibrahimbegovic, S. Mamouri, Nonlinear dynamics of flexible beams in planar motion:
formulation and time-stepping scheme for stiff problems, Computers & Structures 70 (1999) 1-22,
section 4.4, doi 10.1016/S0045-7949(98)00150-3; its figures 19 and 20.

With the axis $\varphi(s)$, the rotation $\psi(s)$ of the sections, the velocity $v$ and the spin
$\omega$, and the strains $E = R(\psi)^T \varphi' - t_0$ and $K = \psi'$, the energy $H$ and the
angular momentum $A$ are

$$
\begin{aligned}
H &= \frac{1}{2} \int (\rho A\,|v|^2 + \rho I\,\omega^2 + E \cdot C E + EI\,K^2)\,\mathrm{d}s, \\
A &= \int (\varphi \times \rho A\,v + \rho I\,\omega)\,\mathrm{d}s.
\end{aligned}
$$

Start: the straight beam $\varphi = (x, 0)$ with $v = (0, V (1 - |2 x/l - 1|))$. A node spins with
the mean slope of $v$ on its two sides: $\omega = 2 V/l$ left of the middle, 0 in it, $-2 V/l$ right
of it.

Units are the paper's: inch, pound and second, thus lb·s²/in for masses.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

# Data that are not in the paper, or have lost digits in our text of it.
OURS = {
    "EA, GA, EI": "4e7, 1e7 and 1.3e7 lb, lb, lb in2: the text has '4 0 7', '0 7' and '.3 0 7'",
    "rotary inertia": "1/60 lb s2, deduced: a square section 2 in wide; the text has none",
    "spin at the start": "the slope of the velocity, our own",
    "units": "inch, pound and second, from the velocity in in/s",
    "end of the run": "10 s, deduced: the text has 'T = 0 s'",
    "time steps": "0.01 s deduced: the text has '0.0'; the others are our own",
    "alpha of HHT": "our own",
}
LENGTH = 100.0  # l [in]
SECTION = fb.Section(
    EA=4e7,  # [lb]
    GA=1e7,  # [lb], deduced
    EI=1.3e7,  # [lb·in²]
    rhoA=0.05,  # [lb·s²/in²]
    rhoI=1 / 60,  # [lb·s²], deduced: a square section, 2 in wide
)
VELOCITY = 600.0  # V, in the middle of the beam [in/s]
ELEMENTS = 8
T_END = 10.0  # [s]
DT = 0.01  # [s]

SCHEMES = {
    "EnergyMomentum": fb.EnergyMomentum(),
    "ModifiedMidPoint (as published)": fb.ModifiedMidPoint(),
    "MidPoint": fb.MidPoint(),
    "Newmark (trapezoidal)": fb.Newmark(),
    "HHT, alpha = -0.1": fb.HHT(-0.1),
}
STEPS = (0.02, DT, 0.005)  # [s]
# A failing step is halved at most twice: more would only prolong a motion that is lost.
MAX_HALVINGS = 2

# Position of the free end [in] at these times [s], by number of elements and time step, from an
# independent program.
T_TIP = (0.1, 0.2, 0.5, 1.0, 1.4)
TIP = {
    (8, 0.01): ((89.71, 33.87), (40.44, 83.24), (-77.46, 58.79), (19.78, -91.60), (91.40, 24.28)),
    (8, 0.001): ((89.83, 34.35), (39.75, 83.30), (-77.06, 60.62), (19.40, -92.58), (92.43, 27.81)),
    (64, 0.0005): (
        (89.59, 33.22),
        (39.91, 83.21),
        (-77.93, 55.81),
        (21.18, -90.09),
        (89.85, 22.98),
    ),
}


def scene(elements=ELEMENTS, degree=1, corners=(0, 1)):
    """The scene and its beam; a sequence of elements gives the mesh of each piece."""
    pinned = fb.Scene()
    places = [(LENGTH * corner, 0) for corner in corners]
    beam = pinned.add_beam(places, SECTION, elements=elements, degree=degree, name="beam")
    pinned.pin(beam.start)
    middle = LENGTH / 2
    pinned.set_velocity(
        beam,
        lambda x, y: (0.0, VELOCITY * (1 - abs(x / middle - 1))),
        spin=lambda x, y: VELOCITY / middle * np.sign(middle - x),
    )
    return pinned, beam


def simulate(scheme, dt, t_end=T_END, elements=ELEMENTS):
    """The solution, up to a step that fails."""
    log.info("%s, dt = %g s, %d elements", scheme.name, dt, elements)
    pinned, _ = scene(elements)
    try:
        return fb.simulate(pinned, scheme, dt=dt, t_end=t_end, max_halvings=MAX_HALVINGS)
    except fb.StepError as error:
        return error.solution


def energy_ratio(solution):
    return solution.energy.total / solution.energy.total[0]


def momentum_ratio(solution):
    return solution.angular_momentum / solution.angular_momentum[0]


def tip(solution):
    return solution.position(solution.beams["beam"].end)


def audit(solution):
    """Numbers by which a run is assessed."""
    energy = energy_ratio(solution)
    return {
        "steps": solution.stats.steps,
        "lowest energy ratio": energy.min(),
        "highest energy ratio": energy.max(),
        "energy drift": abs(energy - 1).max(),
        "angular momentum drift": abs(momentum_ratio(solution) - 1).max(),
        "Newton iterations": solution.stats.newton_iterations,
        "halvings": solution.stats.halvings,
        "failed at": solution.t[-1] if solution.stats.failure else None,
        "failure": solution.stats.failure and solution.stats.failure.reason,
    }


def compare_tip(solution, dt, reference):
    """Positions of the free end and their largest distance from the reference."""
    tips = tip(solution)[[round(t / dt) for t in T_TIP]]
    distance = np.linalg.norm(tips - reference, axis=1).max()
    return {"position": tips.tolist(), "reference": reference, "largest difference": distance}


def compute(steps=STEPS):
    """The numbers, and what is drawn."""
    runs = {(name, dt): simulate(SCHEMES[name], dt) for name in SCHEMES for dt in steps}
    fine = {
        (elements, dt): simulate(fb.EnergyMomentum(), dt, max(T_TIP), elements)
        for elements, dt in TIP
    }
    start = fine[ELEMENTS, DT]
    numbers = {
        "not in the paper": OURS,
        "energy at the start": start.energy.total[0],
        "angular momentum at the start": start.angular_momentum[0],
        "schemes": {
            name: {f"dt {dt:g}": audit(runs[name, dt]) for dt in steps} for name in SCHEMES
        },
        "tip": {
            f"{elements} elements, dt {dt:g}": compare_tip(solution, dt, TIP[elements, dt])
            for (elements, dt), solution in fine.items()
        },
    }
    return numbers, ({name: runs[name, DT] for name in SCHEMES}, fine)


def report(numbers):
    print("Not in the paper, or illegible in our text of it:")
    print(*(f"    {name}: {why}" for name, why in OURS.items()), sep="\n")
    print(
        f"At the start: energy {numbers['energy at the start']:.6g} lb in, "
        f"angular momentum {numbers['angular momentum at the start']:.6g} lb in s\n"
        f"\n{T_END:g} s with {ELEMENTS} elements, "
        f"a failing step halved at most {MAX_HALVINGS} times:"
    )
    row = "{:31} {:>6} {:>5} {:>7} {:>8} {:>8} {:>8} {:>7} {:>5} {:>6}".format
    print(row("", "dt", "", "lowest", "highest", "largest", "largest", "Newton", "halv-", ""))
    units = "[s]", "steps", "E/E0", "E/E0", "|E/E0-1|", "|L/L0-1|", "it/step", "ings", "failed"
    print(row("scheme", *units))
    failures = []
    for name, runs in numbers["schemes"].items():
        for dt, run in runs.items():
            failed = run["failure"] is not None
            values = (
                dt.removeprefix("dt "),
                run["steps"],
                f"{run['lowest energy ratio']:.4f}",
                f"{run['highest energy ratio']:.4f}",
                f"{run['energy drift']:.1e}",
                f"{run['angular momentum drift']:.1e}",
                f"{run['Newton iterations'] / run['steps']:.1f}",
                run["halvings"],
                f"{run['failed at']:.2f} s" if failed else "never",
            )
            print(row(name, *values))
            failures += [run["failure"]] if failed else []
    print("", *failures, sep="\n")
    print("\nFree end [in] by EnergyMomentum, and as in the reference:")
    for name, run in numbers["tip"].items():
        print(f"{name}: at most {run['largest difference']:.3f} in from the reference")
        for t, computed, reference in zip(T_TIP, run["position"], run["reference"], strict=True):
            both = "{:7.2f} {:7.2f}    {:7.2f} {:7.2f}".format(*computed, *reference)
            print(f"    t = {t:.1f} s  {both}")


def draw(results, solutions, fine):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene()[0], results / "scene.png", scene_unit="in", dimensions=True)
    solution = solutions["EnergyMomentum"]
    until = max(T_TIP)
    first = range(round(until / DT) + 1)
    plot.shapes(solution, results / "shapes.png", rows=first[::3], scene_unit="in")
    node = solution.beams["beam"].end
    plot.animate(solution, results / "motion.gif", rows=first, trace=node, scene_unit="in")
    thumbnail.card(solution, first, results / "thumbnail.png")

    # Left: the first 1.4 s, where diverging curves can be distinguished. Right: the whole run.
    figure, axes = plot.figure(2, 2)
    rows = (energy_ratio, "E/E_0", "total energy"), (momentum_ratio, "L/L_0", "ang. momentum")
    for (ratio, symbol, name), (left, right) in zip(rows, axes, strict=True):
        left.set(xlim=(0, until), ylim=(0.7, 1.4), ylabel=f"{name} ${symbol}$ [-]")
        plot.curves(left, solutions, ratio)
        right.set(xlim=(DT, T_END), ylim=(1e-16, 1e4), xscale="log", yscale="log")
        right.set(ylabel=f"largest $|{symbol} - 1|$ so far [-]")

        def drift(solution, ratio=ratio):
            return np.maximum.accumulate(abs(ratio(solution) - 1))

        plot.curves(right, solutions, drift)
    for ax in axes.flat:
        ax.set(xlabel="time $t$ [s]")
    axes[0, 0].set_title(f"$\\Delta t$ = {DT:g} s")
    plot.save(figure, results / "invariants.png")

    figure, axes = plot.figure(2, 1)
    for i, ax in enumerate(axes.flat):
        ax.set(xlim=(0, until), xlabel="time $t$ [s]", ylabel=f"${'xy'[i]}$ of the free end [in]")
        for ((elements, dt), run), line in zip(fine.items(), ("-", "--", ":"), strict=True):
            name = f"{elements} elements, dt = {dt:g} s"
            (curve,) = ax.plot(run.t, tip(run)[:, i], line, label=name)
            reference = [position[i] for position in TIP[elements, dt]]
            rings = {"markerfacecolor": "none", "markersize": 8, "clip_on": False}
            ax.plot(T_TIP, reference, "o", color=curve.get_color(), **rings)
        ax.plot([], [], "o", color="0.4", markerfacecolor="none", label="reference")
    plot.save(figure, results / "tip.png")


if __name__ == "__main__":
    script.run()
