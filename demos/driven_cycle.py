r"""The cycle of a driven four-bar linkage, found by Newton's method instead of by waiting.

A crank turns at a constant speed and moves a flexible coupler and a flexible rocker, which have
little damping. After a start the vibrations decay slowly, by the largest Floquet multiplier $\mu$
in a cycle: a simulation is within 1e-9 of the cycle after $\ln 10^{-9}/\ln|\mu|$ turns of the
crank. Objective: the cycle itself, $x(T) = x(0)$, by `fx_beam.periodic`, and the turns that it
saves.

The reference is the simulation: its distance from the cycle must fall like $|\mu|^n$ over $n$
turns. In the cycle the work of the motor is what the damping takes.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

SPEED = 20.0  # of the crank [rad/s]
PERIOD = 2 * np.pi / SPEED  # [s]
CRANK, COUPLER, GROUND = (0.2, 0.0), (0.9, 0.35), (0.8, 0.0)  # ends of the members [m]
SECTION = fb.Section(EA=2e5, GA=8e4, EI=5.0, rhoA=0.3, rhoI=1e-5, retardation=2e-5)  # [N, kg, m, s]
ELEMENTS, STEPS = 4, 201
TURNS = 40  # of the simulation


def scene():
    """The linkage, and the node between coupler and rocker."""
    made = fb.Scene()
    ends = {"O": (0, 0), "A": CRANK}
    crank = made.add_body((0.1, 0), mass=0.2, inertia=1e-3, points=ends, name="crank")
    coupler = made.add_beam([CRANK, COUPLER], SECTION, ELEMENTS, name="coupler")
    rocker = made.add_beam([COUPLER, GROUND], SECTION, ELEMENTS, name="rocker")
    made.add_joint(fb.Revolute(fb.GROUND, crank["O"], motor=lambda t: SPEED * t))
    made.add_joint(fb.Revolute(crank["A"], coupler.start))
    made.add_joint(fb.Revolute(coupler.end, rocker.start))
    made.pin(rocker.end)
    made.make_velocities_compatible()
    return made, coupler


def middle(solution, coupler):
    """Bending moment in the middle of the coupler [N m]."""
    moments = solution.resultants(coupler).M
    return moments[:, moments.shape[1] // 2]


def compute():
    """The numbers, and what is drawn."""
    made, coupler = scene()
    cycle = fb.periodic(made, period=PERIOD, steps=STEPS)
    log.info("%r in %d iterations", cycle, cycle.iterations)
    motion = fb.simulate(made, dt=PERIOD / STEPS, t_end=TURNS * PERIOD)
    here, then = middle(cycle.solution, coupler), middle(motion, coupler)
    apart = [
        float(abs(then[n * STEPS + 1 : (n + 1) * STEPS + 1] - here[1:]).max()) for n in range(TURNS)
    ]
    largest = float(abs(cycle.multipliers).max())
    energy = cycle.solution.energy
    late = slice(TURNS // 2, None)
    rate = float(np.exp(np.polyfit(np.arange(TURNS)[late], np.log(apart)[late], 1)[0]))
    numbers = {
        "iterations": cycle.iterations,
        "distance of the states after a cycle": cycle.error,
        "stable": cycle.stable,
        "largest multiplier": largest,
        "decay of the simulation in a turn": rate,
        "turns until 1e-9": float(np.log(1e-9) / np.log(largest)),
        "work of the motor over the loss, less 1": float(
            (energy.work[-1] - energy.work[0]) / energy.dissipated[-1] - 1
        ),
        "largest moment in the cycle": float(abs(here).max()),
        "largest difference in the first turn": apart[0],
    }
    return numbers, (cycle, motion, coupler, apart, largest)


def report(numbers):
    print(
        f"The cycle is found in {numbers['iterations']} iterations, to "
        f"{numbers['distance of the states after a cycle']:.0e}; a simulation needs "
        f"{numbers['turns until 1e-9']:.0f} turns until 1e-9.\n"
        f"Largest multiplier {numbers['largest multiplier']:.4f}; the simulation decays by "
        f"{numbers['decay of the simulation in a turn']:.4f} in a turn.\n"
        f"Work of the motor over the loss, less 1: "
        f"{numbers['work of the motor over the loss, less 1']:.0e}"
    )


def draw(results, cycle, motion, coupler, apart, largest):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene()[0], results / "scene.png")
    plot.animate(cycle.solution, results / "motion.gif", rows=range(0, STEPS, 2))
    thumbnail.card(cycle.solution, range(STEPS), results / "thumbnail.png")
    figure, (axes,) = plot.figure(1, 2, height=3.2)
    turn = np.arange(STEPS) / STEPS
    last = middle(motion, coupler)
    for n, color in ((0, "#D55E00"), (9, "#E69F00")):
        rows = last[n * STEPS + 1 : (n + 1) * STEPS + 1]
        axes[0].plot(turn, rows, color=color, lw=1, label=f"simulation, turn {n + 1}")
    axes[0].plot(turn, middle(cycle.solution, coupler)[1:], color="#0072B2", label="cycle")
    axes[0].set(xlabel="turn of the crank", ylabel="moment in the coupler [N m]")
    n = np.arange(TURNS)
    axes[1].semilogy(n + 1, apart, ".", color="#D55E00", label="distance of the simulation")
    fall = apart[TURNS // 2] * largest ** (n - TURNS // 2)
    axes[1].semilogy(n + 1, fall, "k--", lw=1, label=r"$|\mu|^n$")
    axes[1].set(xlabel="turns", ylabel="distance from the cycle [N m]")
    plot.save(figure, results / "cycle.png")


if __name__ == "__main__":
    script.run()
