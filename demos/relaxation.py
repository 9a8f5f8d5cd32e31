r"""Relaxation and creep of a cantilever of a Zener material, the standard linear solid.

A spring of bending stiffness $EI$ lies beside one of stiffness $EI_1$ in series with a dashpot. The
curvature $a$ of the dashpot is an internal variable, and relaxes in the time $\tau$:

$$ M = EI \kappa + EI_1 (\kappa - a), \qquad \dot a = \frac{\kappa - a}{\tau}. $$

The cantilever has no mass and is bent uniformly: by a turn of its end in proportion to the time
(relaxation), or by a moment there in proportion to the time (creep). Objective: an internal
variable with its update in UFL, and the order in which the schemes converge to the closed
solutions, for $\kappa = c t$ and for $M = c t$:

$$
\begin{aligned}
M &= c \left(EI\,t + EI_1 \tau (1 - e^{-t/\tau})\right), \\
\kappa &= c \left(\frac{t}{EI} - \frac{EI_1}{EI^2} \tau (1 - e^{-t/T})\right), \qquad
T = \frac{EI + EI_1}{EI} \tau.
\end{aligned}
$$

Units are metre, kilogram and second.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

EI, EI_1, TAU = 4.0, 2.0, 0.5  # [N m²], [N m²], [s]
RATE = 1.0  # c [1/(m s)] or [N m/s]
LENGTH, T_END = 1.0, 2.0  # [m], [s]
STEPS = 0.2, 0.1, 0.05, 0.025  # [s]
SCHEMES = {"EnergyMomentum": fb.EnergyMomentum(), "Newmark": fb.Newmark()}


def energy(eps, gamma, kappa, a):
    springs = EI / 2 * kappa**2 + EI_1 / 2 * (kappa - a[0]) ** 2
    return 1e4 * eps**2 + 4e3 * gamma**2 + springs


def relax(old, strains0, strains, dt):
    return [(old[0] + dt / TAU * strains[2]) / (1 + dt / TAU)]


def scene(test, elements=2):
    variables = fb.InternalVariables(("curvature of the dashpot",), relax)
    cantilever = fb.Scene()
    section = fb.Section(strain_energy=energy, internal=variables)
    arm = cantilever.add_beam([(0, 0), (LENGTH, 0)], section, elements, name="arm")
    cantilever.clamp(arm.start)
    if test == "relaxation":
        cantilever.prescribe(arm.end, rotation=lambda t: RATE * LENGTH * t)
    else:
        cantilever.add_moment(arm.end, lambda t: RATE * t)
    return cantilever, arm


def moment(t):
    """Bending moment [N m] at the curvature $c t$."""
    return RATE * (EI * t + EI_1 * TAU * (1 - np.exp(-t / TAU)))


def curvature(t):
    """Curvature [1/m] under the moment $c t$."""
    slow = TAU * (EI + EI_1) / EI
    return RATE * (t / EI - EI_1 / EI**2 * TAU * (1 - np.exp(-t / slow)))


EXACT = {"relaxation": moment, "creep": curvature}


def run(test, scheme, dt):
    """Times, and the bending moment or the curvature at these times."""
    cantilever, arm = scene(test)
    solution = fb.simulate(cantilever, scheme, dt=dt, t_end=T_END)
    if test == "creep":
        return solution.t[1:], solution.rotation(arm.end)[1:] / LENGTH
    return solution.t_level[1:], solution.resultants(arm).M[1:, 0]


def compute():
    """The numbers, and what is drawn."""
    numbers = {}
    for test, exact in EXACT.items():
        for name, scheme in SCHEMES.items():
            log.info("%s, %s", test, name)
            errors = []
            for dt in STEPS:
                t, values = run(test, scheme, dt)
                errors.append(abs(values - exact(t)).max() / exact(T_END))
            orders = np.log2(np.divide(errors[:-1], errors[1:]))
            numbers[f"{test}, {name}"] = {"errors": errors, "orders": orders.tolist()}
    return numbers, ()


def report(numbers):
    line = "{:28}" + "{:>14}" * len(STEPS) + "{:>10}"
    print(line.format("Largest error / last value", *(f"dt = {dt:g} s" for dt in STEPS), "order"))
    for name, run in numbers.items():
        errors = (f"{error:.1e}" for error in run["errors"])
        print(line.format(name, *errors, f"{run['orders'][-1]:.2f}"))


def draw(results):
    # Imported here: the numbers need no matplotlib.
    from fx_beam import plot
    from shared import thumbnail

    creeping = fb.simulate(scene("creep", elements=20)[0], dt=STEPS[-1], t_end=4 * T_END)
    plot.animate(creeping, results / "motion.gif")
    thumbnail.card(creeping, range(0, len(creeping.t), 8), results / "thumbnail.png")
    figure, axes = plot.figure(1, 2, height=3.0)
    labels = r"bending moment $M$ [N m]", r"curvature $\kappa$ [1/m]"
    for ax, (test, exact), label in zip(axes.flat, EXACT.items(), labels, strict=True):
        t = np.linspace(0, T_END, 201)
        ax.plot(t, exact(t), label="closed solution")
        ax.plot(t, exact(1e-9) / 1e-9 * t, "0.6", linestyle=":", label="as elastic as at the start")
        ax.plot(*run(test, SCHEMES["EnergyMomentum"], STEPS[0]), ".", label=f"dt = {STEPS[0]} s")
        ax.set(xlabel="time $t$ [s]", ylabel=label, title=test)
    plot.save(figure, results / "tests.png")


if __name__ == "__main__":
    script.run()
