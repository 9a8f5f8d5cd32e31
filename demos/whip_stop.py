r"""An arm that swings against a stop and whips around a peg.

A steel strip turns about a hinge at 10 rad/s until the hinge meets its stop. The strip bends on by
its own inertia, strikes a fixed peg, and its outer half whips around it. Then it springs back, and
swings to a second stop. Objective: contacts return the energy that they have stored, to round-off,
for every stiffness and step; the same impacts with other schemes; contacts with a given loss; and
steps that a tolerance makes short at an impact.

The stop, at the angle $x$ of the hinge, and the peg, at the gap $g$ of each node of the strip,
store, with the limits $x_u$ and $x_l$ of the hinge and $\langle a \rangle = \max(a, 0)$,

$$
\frac{k}{2} \langle x - x_u \rangle^2 + \frac{k}{2} \langle x_l - x \rangle^2
\quad\text{and}\quad \frac{k}{2} \langle -g \rangle^2.
$$

Over a step from gap $g_0$ to $g_1$ the force is the change of this energy divided by that of the
gap (a discrete gradient: Gonzalez 1996, J. Nonlinear Sci. 6, 449-467, doi 10.1007/BF02440162), so
that its work is the change of the energy, for any step. With a restitution $e$ the force has a
further part, $r \tanh(w/w_0)$ times the elastic one with the rate $w$, the `speed` $w_0$ and
$r = (1 - e^2)/(1 + e^2)$, which dissipates energy. The example is our own; the invariants are its
reference.

Units are metre, kilogram and second.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

SECTION = fb.Section.rectangle(height=2e-3, width=0.02, E=210e9, nu=0.3, rho=7850.0)
LENGTH, ELEMENTS = 1.0, 16
SPIN = 10.0  # at the start [rad/s]
LIMITS, HINGE = (-0.5, 1.0), 1e4  # of the hinge [rad], and stiffness of its stops [N m/rad]
PEG, RADIUS = (0.0, 0.55), 0.05  # centre and radius of the peg [m]
STIFFNESS = 1e7  # of the contact with the peg, per length of the strip [N/m²]
SPEED = 0.05  # below which the loss of a restitution is viscous [m/s, rad/s]
DT, T_END = 5e-4, 0.6  # [s]
SCHEMES = {
    "EnergyMomentum": fb.EnergyMomentum(),
    "EnergyDecaying": fb.EnergyDecaying(),
    "Newmark (trapezoidal)": fb.Newmark(),
    "HHT, alpha = -0.1": fb.HHT(-0.1),
}


def scene(stiffness=STIFFNESS, restitution=1.0):
    """The strip with its stops, the hinge and the peg."""
    made = fb.Scene()
    arm = made.add_beam([(0, 0), (LENGTH, 0)], SECTION, elements=ELEMENTS, name="arm")
    speed = SPEED if restitution < 1 else None
    stop = fb.Stop(*LIMITS, HINGE, restitution, speed)
    hinge = made.add_joint(fb.Revolute(fb.GROUND, arm.start, stop=stop))
    peg = made.add_contact(arm, fb.Circle(PEG, RADIUS), stiffness, restitution, speed)
    made.set_velocity(arm, lambda x, y: (-SPIN * y, SPIN * x), spin=SPIN)
    return made, hinge, peg


def simulate(scheme=None, stiffness=STIFFNESS, restitution=1.0, **steps):
    """Solution, hinge and peg; the solution ends where a step fails."""
    made, hinge, peg = scene(stiffness, restitution)
    scheme = scheme or SCHEMES["EnergyMomentum"]
    log.info("%s, peg of %g N/m^2, e = %g, %s", scheme.name, stiffness, restitution, steps)
    try:
        return fb.simulate(made, scheme, t_end=T_END, **steps or {"dt": DT}), hinge, peg
    except fb.StepError as error:
        return error.solution, hinge, peg


def audit(solution, hinge, peg):
    """Numbers by which a run is assessed."""
    energy, contact = solution.energy, solution.contact(peg)
    start = energy.total[0]
    closed = contact.gap.min(axis=1) < 0
    steps = np.diff(solution.t)
    return {
        "energy at the start": start,
        "energy drift": abs(energy.balance_error).max() / start,
        "energy at the end / start": energy.total[-1] / start,
        "dissipated / start": energy.dissipated[-1] / start,
        "angle at the most": solution.joint(hinge).angle.max(),
        "bending moment at the most": abs(solution.resultants("arm").M).max(),
        "depth in the peg at the most": max(0.0, -contact.gap.min()),
        "times that the peg is met": int(np.count_nonzero(closed[1:] & ~closed[:-1])),
        "steps": solution.stats.steps,
        "shortest step": steps.min(),
        "longest step": steps.max(),
        "Newton iterations per step": solution.stats.newton_iterations / solution.stats.substeps,
        "halvings": solution.stats.halvings,
        "failed at": solution.t[-1] if solution.stats.failure else None,
    }


def compute():
    """The numbers, and what is drawn."""
    runs = {name: simulate(scheme) for name, scheme in SCHEMES.items()}
    numbers = {
        "schemes": {name: audit(*run) for name, run in runs.items()},
        "stiffness": {f"{k:g}": audit(*simulate(stiffness=k)) for k in (1e5, 1e9, 1e11)},
        "restitution": {f"{e:g}": audit(*simulate(restitution=e)) for e in (0.8, 0.5)},
        "tolerance": {
            f"{tolerance:g}": audit(*simulate(fb.EnergyDecaying(), tolerance=tolerance))
            for tolerance in (1e-2, 1e-3)
        },
    }
    return numbers, (runs,)


def report(numbers):
    first = numbers["schemes"]["EnergyMomentum"]
    print(
        f"{T_END:g} s from {first['energy at the start']:.4g} J. The hinge turns to "
        f"{first['angle at the most']:.4f} rad, with its stop at {LIMITS[1]:g} rad; the peg is met "
        f"{first['times that the peg is met']} times, to a depth of at most "
        f"{1e3 * first['depth in the peg at the most']:.3f} mm"
    )
    row = "{:36} {:>6} {:>9} {:>9} {:>9} {:>8} {:>8} {:>9} {:>5}"
    print(row.format("", "", "shortest", "longest", "balance", "E at", "lost", "Newton", "halv-"))
    units = "[s]", "[s]", "error / E0", "end / E0", "/ E0", "it/step", "ings"
    print("{:36} {:>6} {:>9} {:>9} {:>10} {:>7} {:>8} {:>9} {:>5}".format("run", "steps", *units))
    for kind, runs in numbers.items():
        for name, run in runs.items():
            values = (
                run["steps"],
                f"{run['shortest step']:.1e}",
                f"{run['longest step']:.1e}",
                f"{run['energy drift']:.1e}",
                f"{run['energy at the end / start']:.4f}",
                f"{run['dissipated / start']:.4f}",
                f"{run['Newton iterations per step']:.2f}",
                run["halvings"],
            )
            print(row.format(name if kind == "schemes" else f"{kind} {name}", *values))


def draw(results, runs):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    solution, hinge, peg = runs["EnergyMomentum"]
    arm = solution.beams["arm"]
    plot.scene(arm.start.scene, results / "scene.png")
    rows = [round(t / DT) for t in (0, 0.05, 0.1, 0.13, 0.16, 0.19, 0.22, 0.25)]
    plot.shapes(solution, results / "shapes.png", rows=rows)
    plot.animate(
        solution, results / "motion.gif", rows=range(0, len(solution.t), 20), trace=arm.end
    )
    thumbnail.card(solution, range(0, len(solution.t), 25), results / "thumbnail.png")

    figure, axes = plot.figure(2, 2)
    (angle, force), (energy, drift) = axes
    for ax in axes.flat:
        ax.set(xlim=(0, T_END), xlabel="time $t$ [s]")
    angle.plot(solution.t, solution.joint(hinge).angle)
    for limit in LIMITS:
        angle.axhline(limit, color="0.6", linewidth=0.8)
    angle.set(ylabel="angle of the hinge [rad]")
    pushes = np.hypot(*np.moveaxis(solution.contact(peg).force, -1, 0)).sum(axis=1)
    force.plot(solution.t_level, pushes, linewidth=0.8)
    force.set(ylabel="force of the peg [N]")
    for name in ("kinetic", "strain", "springs"):
        label = "stops and peg" if name == "springs" else name
        energy.plot(solution.t, getattr(solution.energy, name), label=label, linewidth=0.9)
    energy.set(ylabel="energy $E$ [J]")
    drift.set(ylim=(1e-16, 10), yscale="log", ylabel="balance error so far / $E_0$")
    plot.curves(
        drift,
        {name: run[0] for name, run in runs.items()},
        lambda s: np.maximum.accumulate(abs(s.energy.balance_error)) / s.energy.total[0],
    )
    plot.save(figure, results / "force_and_energy.png")


if __name__ == "__main__":
    script.run()
