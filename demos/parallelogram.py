r"""Parallelogram of stiff bars: which schemes pass through its line-up?

Two cranks of equal length and a coupler make a parallelogram, which swings in gravity. Twice in
each swing all bars are in line. There a rigid mechanism may go on as a parallelogram, as its
inertia demands, or turn into an antiparallelogram. Elastic bars pass the position with a small
error, unless they carry axial vibrations: these may push the joints to the other side. A step of
practical length does not resolve such vibrations. In a scheme that conserves energy they do not
decay; a decaying scheme removes them. Objective: the error of the path for many mechanisms, by
scheme, and the axial force of the coupler.

This example is our own. The rigid parallelogram has one coordinate, the angle $\theta$ of the
cranks. With the crank's length $a$, the coupler's length $b$, mass per length $m$, inertia of the
section per length $i$, and a mass $M$ at the joint of the left crank,

$$
J \ddot\theta = -g a \cos\theta\,(m a + m b + M), \qquad
J = \frac{2}{3} m a^3 + 2 i a + (m b + M)\,a^2.
$$

It is integrated by scipy with a tolerance of 1e-11. The error is the distance between the joint of
the left crank and its position in the rigid mechanism, divided by $a$. With an error above 0.1 the
mechanism has taken a wrong turn. Units are metre, kilogram and second.
"""

import functools
import logging

import numpy as np
from scipy.integrate import solve_ivp

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

CRANK, COUPLER = 1.0, 2.0  # a, b [m]
MASS, INERTIA = 1.0, 1e-3  # m [kg/m], i [kg m]
GRAVITY = 9.81  # [m/s²]
# Angle at the start [rad] and mass M [kg] of the mechanisms, and stiffnesses EA [N] of their bars.
STARTS = (np.pi / 3, 0.0), (0.3, 1.0), (0.8, 5.0), (1.2, 10.0)
STIFFNESSES = tuple(10.0 ** np.arange(6, 12.1, 0.5))
SHOWN = 0.8, 5.0  # angle and mass of the mechanism in the pictures
SHOWN_EA = 1e6
WRONG, GOOD = 0.1, 1e-2  # bounds of the error
DT, T_END = 0.01, 6.0  # [s]
SCHEMES = {
    "EnergyDecaying": fb.EnergyDecaying(),
    "EnergyDecaying, damping = 0.5": fb.EnergyDecaying(0.5),
    "EnergyMomentum": fb.EnergyMomentum(),
    "HHT, alpha = -0.1": fb.HHT(-0.1),
    "HHT, alpha = -0.3": fb.HHT(-0.3),
    "generalized alpha, 0.5": fb.GeneralizedAlpha(0.5),
}


def scene(EA=SHOWN_EA, angle=SHOWN[0], mass=SHOWN[1]):
    """The parallelogram at rest; its bars are called left, right and coupler."""
    section = fb.Section(EA=EA, GA=EA / 3, EI=EA / 100, rhoA=MASS, rhoI=INERTIA)
    parallelogram = fb.Scene(gravity=(0, -GRAVITY))
    up = CRANK * np.array([np.cos(angle), np.sin(angle)])
    ends = {"left": [(0, 0), up], "right": [(COUPLER, 0), up + (COUPLER, 0)]}
    left, right = (parallelogram.add_beam(e, section, elements=1, name=n) for n, e in ends.items())
    coupler = parallelogram.add_beam([up, up + (COUPLER, 0)], section, elements=1, name="coupler")
    for crank, end in ((left, coupler.start), (right, coupler.end)):
        parallelogram.pin(crank.start)
        parallelogram.add_joint(fb.Revolute(crank.end, end))
    if mass:
        parallelogram.add_mass(coupler.start, mass)
    return parallelogram


@functools.cache
def rigid(angle, mass):
    """Angle [rad] of the rigid parallelogram and its rate, as a function of times."""
    a, b, m = CRANK, COUPLER, MASS
    J = 2 / 3 * m * a**3 + 2 * INERTIA * a + (m * b + mass) * a**2
    pull = GRAVITY * a * (m * a + m * b + mass) / J
    motion = solve_ivp(
        lambda _, y: (y[1], -pull * np.cos(y[0])),
        (0, T_END),
        (angle, 0.0),
        method="DOP853",
        dense_output=True,
        rtol=1e-11,
        atol=1e-11,
    )
    return motion.sol


def simulate(EA, scheme, angle=SHOWN[0], mass=SHOWN[1], dt=DT, t_end=T_END):
    """The solution, up to a step that fails."""
    try:
        return fb.simulate(scene(EA, angle, mass), scheme, dt=dt, t_end=t_end)
    except fb.StepError as failed:
        return failed.solution


def path_error(solution, angle=SHOWN[0], mass=SHOWN[1]):
    """Distance (n,) of the left joint from its place in the rigid mechanism, over the crank."""
    theta, _ = rigid(angle, mass)(solution.t)
    places = CRANK * np.column_stack([np.cos(theta), np.sin(theta)])
    return np.hypot(*(solution.position(solution.beams["left"].end) - places).T) / CRANK


def scan(scheme):
    """Largest error of the path of each mechanism."""
    return [
        path_error(simulate(EA, scheme, *start), *start).max()
        for EA in STIFFNESSES
        for start in STARTS
    ]


def compute():
    """The numbers, and what is drawn."""
    numbers = {"mechanisms": len(STIFFNESSES) * len(STARTS), "schemes": {}}
    for name, scheme in SCHEMES.items():
        log.info("%s, %d mechanisms", name, numbers["mechanisms"])
        errors = np.array(scan(scheme))
        numbers["schemes"][name] = {
            "wrong turns": int((errors > WRONG).sum()),
            "errors below 1e-2": int((errors < GOOD).sum()),
            "median error": float(np.median(errors)),
        }
    return numbers, ()


def report(numbers):
    print(f"{numbers['mechanisms']} mechanisms, {T_END:g} s, dt = {DT:g} s")
    row = "{:>30} {:>12} {:>18} {:>13}".format
    print(row("", "wrong turns", "errors below 1e-2", "median error"))
    for name, run in numbers["schemes"].items():
        *counts, middle = run.values()
        print(row(name, *counts, f"{middle:.1e}"))


def draw(results):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene(), results / "scene.png", dimensions=True)
    shown = {
        "EnergyDecaying": "#0072B2",
        "EnergyMomentum": "#D55E00",
        "HHT, alpha = -0.1": "#009E73",
    }
    figure, axes = plot.figure(3, 1)
    path, off, force = axes.flat
    for name, colour in shown.items():
        solution = simulate(SHOWN_EA, SCHEMES[name])
        line = {"color": colour, "linewidth": 1.0}
        joint = solution.beams["left"].end
        path.plot(solution.t, solution.position(joint)[:, 0], **line, label=name)
        off.semilogy(solution.t[1:], np.maximum(path_error(solution)[1:], 1e-6), **line)
        N = solution.resultants("coupler").N[1:, 0]
        force.plot(solution.t_level[1:], N, **line)
        if name == "EnergyDecaying":
            plot.animate(
                solution, results / "motion.gif", rows=range(0, len(solution.t), 6), trace=joint
            )
            thumbnail.card(solution, range(0, len(solution.t), 6), results / "thumbnail.png")
    theta, _ = rigid(*SHOWN)(solution.t)
    path.plot(solution.t, CRANK * np.cos(theta), "k:", linewidth=1.0, label="rigid")
    path.set(ylabel="joint $x$ [m]")
    off.set(ylabel="error of the path $/a$", ylim=(1e-6, 5))
    force.set(ylabel="coupler $N$ [N]")
    for ax in axes.flat:
        ax.set(xlabel="time $t$ [s]", xlim=(0, T_END))
    path.set_title(f"$EA$ = {SHOWN_EA:g} N, $\\Delta t$ = {DT:g} s")
    plot.save(figure, results / "path_and_force.png")


if __name__ == "__main__":
    script.run("ERROR")  # lost motions turn sections inside out
