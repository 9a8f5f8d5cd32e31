r"""An elastic ring that falls on a plane and bounces on.

A ring with a velocity along the plane falls on it, flattens to an oval, bounces, and flies on
vibrating. Without friction the plane exerts no force along itself. Objective: energy and momentum
along the plane to round-off over all bounces; the part of the energy that becomes vibration, so
that even an elastic ring on an elastic plane does not reach its initial height again; and the
effect of a restitution of the contact, which holds for each node, not for the ring.

The nodes of the ring, at the gap $g$ from the plane, store $\frac{1}{2} k \langle -g \rangle^2$ per
length, $\langle a \rangle = \max(a, 0)$. The force in a step is the change of this energy divided
by that of the gap: its work is exact. With the height $h$ of the centre of mass, its velocity $v$,
the mass $m$, the kinetic energy $T$, the strain energy $U$ and the energy $C$ of the contact,

$$ T + U + C + m g h = \mathrm{const}, \qquad m v_x = \mathrm{const}, $$

and the energy of the vibration is $T - \frac{1}{2} m |v|^2 + U + C$.

The impulse of the plane is the change of $m v_y$ plus $m g t$. The example is our own; its
reference are these balances.

Units are metre, kilogram and second.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

RADIUS, HEIGHT = 0.5, 0.5  # of the ring, and below it [m]
SECTION = fb.Section(EA=1e5, GA=4e4, EI=2.0, rhoA=1.0, rhoI=2e-5)
ELEMENTS, DEGREE = 16, 2  # of each half
STIFFNESS = 1e5  # of the contact, per length of the ring [N/m²]
SPEED = 0.02  # below which the loss of a restitution is viscous [m/s]
VELOCITY, GRAVITY = 0.5, 9.81  # along the plane [m/s], [m/s²]
MASS = 2 * np.pi * RADIUS * SECTION.rhoA
DT, T_END = 1e-3, 4.0  # [s]
RESTITUTIONS = 1.0, 0.7, 0.0


def scene(restitution=1.0):
    """The ring above the plane, and the obstacles of its lower and upper half."""
    made, c = fb.Scene(gravity=(0, -GRAVITY)), HEIGHT + RADIUS
    ends = (-RADIUS, c), (RADIUS, c)
    lower = made.add_beam(
        fb.arc(ends[0], (0, c - RADIUS), ends[1]), SECTION, ELEMENTS, DEGREE, name="lower"
    )
    upper = made.add_beam(
        fb.arc(lower.end, (0, c + RADIUS), lower.start), SECTION, ELEMENTS, DEGREE, name="upper"
    )
    speed = SPEED if restitution < 1 else None
    plane = fb.Line((0, 0), normal=(0, 1))
    half = lower, upper
    floors = [made.add_contact(part, plane, STIFFNESS, restitution, speed) for part in half]
    for part in half:
        made.set_velocity(part, (VELOCITY, 0))
    return made, floors


def simulate(restitution=1.0):
    log.info("restitution %g", restitution)
    made, floors = scene(restitution)
    return fb.simulate(made, dt=DT, t_end=T_END), floors


def pushed(solution, floors):
    """Force (n,) of the plane [N]."""
    return sum(solution.contact(floor).force[..., 1].sum(axis=1) for floor in floors)


def height(solution):
    """Height of the centre of mass (n,) [m], from the potential energy of the weight."""
    return HEIGHT + RADIUS + solution.energy.potential / (MASS * GRAVITY)


def vibration(solution):
    """Kinetic energy relative to the centre of mass, strain and contact energy (n,) [J]."""
    whole = np.sum(solution.linear_momentum**2, axis=1) / (2 * MASS)
    return solution.energy.kinetic - whole + solution.energy.stored


def bounces(solution, floors):
    """Rows at which the plane is left for at least a tenth of a second."""
    free = min_gap(solution, floors) > 0
    rows = np.flatnonzero(free[1:] & ~free[:-1]) + 1
    return [int(k) for k in rows if free[k : k + round(0.1 / DT)].all()]


def min_gap(solution, floors):
    return np.min([solution.contact(floor).gap.min(axis=1) for floor in floors], axis=0)


def audit(solution, floors):
    """Numbers by which a run is assessed."""
    energy, fall = solution.energy, MASS * GRAVITY * HEIGHT
    left = bounces(solution, floors)
    tops = [height(solution)[a:b].max() for a, b in zip(left[:-1], left[1:], strict=True)]
    momentum = solution.linear_momentum[:, 0]
    mass = momentum[0] / VELOCITY  # of the mesh
    impulse = pushed(solution, floors).sum() * DT - mass * GRAVITY * T_END
    return {
        "energy drift": abs(energy.balance_error).max() / fall,
        "momentum along the plane": np.ptp(momentum) / momentum[0],
        "impulse minus momentum": impulse - solution.linear_momentum[-1, 1],
        "bounces": len(left),
        "heights of the first bounces / fall": [(top - RADIUS) / HEIGHT for top in tops[:2]],
        "vibration after the first bounce / fall": vibration(solution)[left[0]] / fall,
        "dissipated / fall": energy.dissipated[-1] / fall,
        "depth in the plane at the most": -min_gap(solution, floors).min(),
        "Newton iterations per step": solution.stats.newton_iterations / solution.stats.substeps,
        "halvings": solution.stats.halvings,
    }


def compute():
    """The numbers, and what is drawn."""
    runs = {e: simulate(e) for e in RESTITUTIONS}
    numbers = {f"e = {e:g}": audit(*run) for e, run in runs.items()}
    return numbers, (runs,)


def report(numbers):
    row = "{:9} {:>8} {:>9} {:>9} {:>8} {:>20} {:>10} {:>8} {:>8} {:>8}"
    print(f"{T_END:g} s in steps of {DT:g} s; energies relative to the fall, m g times {HEIGHT} m")
    words = "balance", "momentum", "impulse", "bounces", "heights of the", "vibration", "lost"
    print(row.format("", *words, "depth", "Newton"))
    units = "error", "drift", "- m v", "", "first bounces", "after one", "", "[mm]", "it/step"
    print(row.format("", *units))
    for name, run in numbers.items():
        values = (
            f"{run['energy drift']:.1e}",
            f"{run['momentum along the plane']:.1e}",
            f"{run['impulse minus momentum']:.1e}",
            run["bounces"],
            " ".join(f"{top:.3f}" for top in run["heights of the first bounces / fall"]),
            f"{run['vibration after the first bounce / fall']:.3f}",
            f"{run['dissipated / fall']:.3f}",
            f"{1e3 * run['depth in the plane at the most']:.2f}",
            f"{run['Newton iterations per step']:.2f}",
        )
        print(row.format(name, *values))


def draw(results, runs):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    solution, floors = runs[1.0]
    plot.scene(floors[0].target.start.scene, results / "scene.png")
    rows = [round(t / DT) for t in (0.0, 0.3, 0.4, 0.5, 0.65, 0.9)]
    plot.shapes(solution, results / "shapes.png", rows=rows)
    film = range(0, round(2.4 / DT), round(0.04 / DT))
    plot.animate(solution, results / "motion.gif", rows=film)
    thumbnail.card(solution, film, results / "thumbnail.png")

    figure, axes = plot.figure(2, 2)
    (heights, force), (parts, drift) = axes
    for ax in axes.flat:
        ax.set(xlim=(0, T_END), xlabel="time $t$ [s]")
    for e, (run, _) in runs.items():
        heights.plot(run.t, height(run), label=f"e = {e:g}")
    heights.set(ylim=(0, None), ylabel="height of the centre [m]")
    force.plot(solution.t_level, pushed(solution, floors), linewidth=0.7)
    force.set(ylabel="force of the plane [N]")
    fall = MASS * GRAVITY * HEIGHT
    for e, (run, _) in runs.items():
        parts.plot(run.t, vibration(run) / fall, linewidth=0.8, label=f"e = {e:g}")
        error = abs(run.energy.balance_error) / fall
        drift.plot(run.t, np.maximum.accumulate(error), label=f"e = {e:g}")
    parts.set(ylabel="vibration / energy of the fall")
    drift.set(yscale="log", ylim=(1e-16, 1e-8), ylabel="balance error so far / fall")
    plot.save(figure, results / "height_and_energy.png")


if __name__ == "__main__":
    script.run()
