"""Time of a step with internal variables, against that of the elastic beam.

    .venv/bin/python benchmarks/materials.py [runs]

A cantilever of 8 and of 256 elements swings under a force. The sections take turns, run by run; the
least processor time of the compiled loop counts.
"""

import sys
from time import thread_time

import ufl

import fx_beam as fb
from fx_beam.step import stepper

INERTIA = {"rhoA": 1.0, "rhoI": 0.01}
EI, SOFT, TAU, MOMENT, HARDENING = 6.0, 2.0, 0.5, 0.3, 1.5


def relaxing(eps, gamma, kappa, a):
    return 1e4 * eps**2 + 4e3 * gamma**2 + 2 * kappa**2 + SOFT / 2 * (kappa - a[0]) ** 2


def relax(old, strains0, strains, dt):
    return [(old[0] + dt / TAU * strains[2]) / (1 + dt / TAU)]


def yielding(eps, gamma, kappa, a):
    elastic = 1e4 * eps**2 + 4e3 * gamma**2 + EI / 2 * (kappa - a[0]) ** 2
    return elastic + HARDENING / 2 * a[0] ** 2


def flow(old, strains0, strains, dt):
    trial = EI * (strains[2] - old[0]) - HARDENING * old[0]
    excess = ufl.max_value(abs(trial) - MOMENT, 0)
    return [old[0] + ufl.sign(trial) * excess / (EI + HARDENING)]


def with_memory(energy, update):
    return fb.Section(
        strain_energy=energy, internal=fb.InternalVariables(("a",), update), **INERTIA
    )


SECTIONS = {
    "elastic": fb.Section(EA=2e4, GA=8e3, EI=EI, **INERTIA),
    "Kelvin-Voigt": fb.Section(EA=2e4, GA=8e3, EI=EI, retardation=1e-3, **INERTIA),
    "Zener": with_memory(relaxing, relax),
    "plastic": with_memory(yielding, flow),
}


def step(section, elements, steps):
    """Microseconds and Newton iterations of a step."""
    scene = fb.Scene()
    arm = scene.add_beam([(0, 0), (1, 0)], section, elements=elements)
    scene.clamp(arm.start)
    scene.add_force(arm.end, (0.0, 2.0))
    march, taken = stepper.Stepper.advance, []

    def timed(*arguments):
        clock = thread_time()
        march(*arguments)
        taken.append(thread_time() - clock)

    stepper.Stepper.advance = timed
    try:
        record = fb.Record(every=steps)
        stats = fb.simulate(scene, dt=0.002, t_end=0.002 * steps, record=record).stats
    finally:
        stepper.Stepper.advance = march
    return 1e6 * sum(taken) / steps, stats.newton_iterations / steps


def main(runs=15):
    for elements, steps in ((8, 1000), (256, 50)):
        step_times = {name: [] for name in SECTIONS}
        for _ in range(runs):
            for name, section in SECTIONS.items():
                step_times[name].append(step(section, elements, steps))
        print(f"{elements} elements {'us a step':>14} {'ratio':>7} {'iterations':>11}")
        elastic = min(step_times["elastic"])[0]
        for name, times in step_times.items():
            time, iterations = min(times)
            print(f"{name:16} {time:10.2f} {time / elastic:7.2f} {iterations:11.2f}")


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))
