r"""A flexible arm on the carrier of a planetary gear, which a rotor drives at the sun.

The ring is the ground. The planet runs between sun and ring, on the carrier, and turns the carrier
and the arm. Sun, planet and ring have the radii $r_s$, $r_p$ and $r_r = r_s + 2 r_p$. With the
angles $\psi$, Willis' equation holds for the motion that the carrier sees:

$$
\psi_s - \psi_c = -\frac{r_p}{r_s} (\psi_p - \psi_c), \qquad
\psi_p - \psi_c = -\frac{r_r}{r_p} \psi_c .
$$

So $\psi_s = i \psi_c$ with $i = 1 + r_r / r_s$, and with the inertias $J$ of the wheels and the
mass $m$ of the planet the arm has at its root the inertia

$$
J = J_c + i^2 J_s + m (r_s + r_p)^2 + \left( 1 - \frac{r_r}{r_p} \right)^2 J_p .
$$

A moment $M$ on the sun turns a rigid arm, of the inertia $J_a$ about the axis, by $i M = (J + J_a)
\ddot\psi_c$. An elastic arm of the length $L$ has the frequencies $\omega = \beta^2
\sqrt{EI / \rho A} / L^2$ with

$$
\frac{J \beta^3}{\rho A L^3} (1 + \cos \beta \cosh \beta) =
\cos \beta \sinh \beta - \sin \beta \cosh \beta .
$$

Reference: these closed forms. Objective: two gears on a carrier that moves, without unknowns or
multipliers; their energy balance; a rotor behind a ratio as the arm feels it.

Units are metre, kilogram and second.
"""

import logging

import numpy as np
from scipy.optimize import brentq

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

R_SUN, R_PLANET = 0.06, 0.045  # radii of the wheels [m]
R_RING, PLACE = R_SUN + 2 * R_PLANET, R_SUN + R_PLANET
SPEED, OF_PLANET = 1 + R_RING / R_SUN, 1 - R_RING / R_PLANET  # relative to the carrier
J_SUN, J_CARRIER, J_PLANET, M_PLANET = 2e-3, 4e-3, 2e-4, 0.3  # [kg m²], [kg]
LENGTH, ELEMENTS = 0.5, 16  # of the arm [m]
BAR = fb.Section.rectangle(height=3e-3, width=30e-3, E=70e9, rho=2700.0)  # aluminium
HUB = J_CARRIER + SPEED**2 * J_SUN + M_PLANET * PLACE**2 + OF_PLANET**2 * J_PLANET
ARM = BAR.rhoA * LENGTH**3 / 3
ANGLE, TIME = np.pi / 2, 0.6  # the arm is to turn by, in this time [rad, s]
MOMENT = 4 * ANGLE * (HUB + ARM) / (SPEED * TIME**2)  # first forwards, then backwards [N m]
DT, T_END = 2e-3, 1.2  # [s]


def scene(stiffer=1.0):
    """The scene; its carrier, sun, planet, arm and the gear between sun and planet."""
    machine = fb.Scene()
    pin = (-PLACE, 0.0)
    carrier = machine.add_body((0, 0), 1.0, J_CARRIER, {"axis": (0, 0), "pin": pin}, name="carrier")
    sun = machine.add_body((0, 0), 1.0, J_SUN, name="sun")
    planet = machine.add_body(pin, M_PLANET, J_PLANET, name="planet")
    shaft = machine.add_joint(fb.Revolute(fb.GROUND, carrier.centre))
    sun_joint = machine.add_joint(fb.Revolute(carrier["axis"], sun.centre))
    planet_joint = machine.add_joint(fb.Revolute(carrier["pin"], planet.centre))
    teeth = machine.add_joint(fb.Gear(sun_joint, planet_joint, -R_SUN / R_PLANET))
    machine.add_joint(fb.Gear(shaft, planet_joint, -R_RING / R_PLANET))  # the ring is the ground
    bar = BAR if stiffer == 1 else fb.Section.rectangle(3e-3, 30e-3, 70e9 * stiffer, rho=2700.0)
    arm = machine.add_beam([(0, 0), (LENGTH, 0)], bar, ELEMENTS, degree=2, name="arm")
    machine.add_joint(fb.Rigid(carrier.centre, arm.start))
    return machine, carrier.centre, sun.centre, planet.centre, arm, teeth


def push(t):
    """The moment on the sun: forwards, then backwards."""
    return 0.0 if t >= TIME else MOMENT * np.sign(TIME / 2 - t)


def frequencies(count=3):
    """Angular frequencies of the arm on its hub, by the closed form."""

    def closed(beta):
        ratio = HUB * beta**3 / (BAR.rhoA * LENGTH**3)
        # Divided by cosh, which grows.
        still = 1 / np.cosh(beta) + np.cos(beta)
        return ratio * still + np.sin(beta) - np.cos(beta) * np.tanh(beta)

    grid = np.linspace(0.3, 12, 400)
    values = closed(grid)
    changes = np.flatnonzero(values[1:] * values[:-1] < 0)[:count]
    betas = np.array([brentq(closed, grid[i], grid[i + 1], xtol=1e-13) for i in changes])
    return betas**2 * np.sqrt(BAR.EI / BAR.rhoA) / LENGTH**2


def compute(dt=DT):
    """The numbers, and what is drawn."""
    machine, carrier, sun, planet, arm, teeth = scene()
    omega = fb.modes(machine, n=4).angular_frequencies[1:]  # the first is the free rotation
    machine.add_moment(sun, push)
    motion = fb.simulate(machine, dt=dt, t_end=T_END)
    stiff, its_carrier, its_sun, *_ = scene(stiffer=1e4)
    stiff.add_moment(its_sun, push)
    rigid = fb.simulate(stiff, dt=dt, t_end=TIME)
    half = np.argmin(abs(rigid.t - TIME / 2))
    turned = motion.rotation(carrier)
    numbers = {
        "speed of the sun": motion.rotation(sun)[-1] / turned[-1],
        "of the planet": motion.rotation(planet)[-1] / turned[-1],
        "by Willis": [SPEED, OF_PLANET],
        "rate of a rigid arm": rigid.spin(its_carrier)[half],
        "exact rate": SPEED * MOMENT * TIME / 2 / (HUB + ARM),
        "frequencies": (omega / (2 * np.pi)).tolist(),
        "exact frequencies": (frequencies() / (2 * np.pi)).tolist(),
        "energy balance": abs(motion.energy.balance_error).max() / motion.energy.kinetic.max(),
        "largest angle of a step": abs(np.diff(motion.rotation(sun))).max(),
        "Newton iterations per step": motion.stats.newton_iterations / motion.stats.steps,
    }
    return numbers, (motion, rigid, carrier, its_carrier, sun, planet, arm, teeth)


def report(numbers):
    speeds = numbers["speed of the sun"], numbers["of the planet"], *numbers["by Willis"]
    print(
        "Sun and planet turn {:.9f} and {:.9f} times as far; Willis: {:g}, {:.6g}".format(*speeds)
    )
    rates = numbers["rate of a rigid arm"], numbers["exact rate"]
    print("Rate of a rigid arm half way: {:.5f} rad/s, exact {:.5f}".format(*rates))
    pairs = zip(numbers["frequencies"], numbers["exact frequencies"], strict=True)
    print(
        "Frequencies [Hz]: "
        + ", ".join(f"{computed:.3f} (exact {other:.3f})" for computed, other in pairs)
    )
    print(f"Energy balance {numbers['energy balance']:.0e}", end=", ")
    print(f"steps of up to {numbers['largest angle of a step']:.2f} rad of the sun", end=", ")
    print(f"{numbers['Newton iterations per step']:.2f} Newton iterations per step")


def draw(results, motion, rigid, carrier, its_carrier, sun, planet, arm, teeth):
    # Imported here: the numbers need neither matplotlib nor pyvista.

    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene()[0], results / "scene.png")

    rows = range(0, len(motion.t), 8)
    plot.animate(motion, results / "motion.gif")
    thumbnail.card(motion, rows, results / "thumbnail.png")
    figure, ((turn, tip, tooth),) = plot.figure(1, 3)
    exact = np.where(
        motion.t < TIME / 2,
        2 * ANGLE * (motion.t / TIME) ** 2,
        ANGLE * (1 - 2 * np.clip(1 - motion.t / TIME, 0, None) ** 2),
    )
    turn.plot(motion.t, motion.rotation(carrier), label="carrier")
    turn.plot(motion.t, exact, "k--", linewidth=0.8, label="rigid, exact")
    turn.set(xlabel="time $t$ [s]", ylabel="angle [rad]")
    c, s = np.cos(motion.rotation(carrier)), np.sin(motion.rotation(carrier))
    x, y = motion.position(arm.end).T
    tip.plot(motion.t, 1e3 * (c * y - s * x))
    tip.set(xlabel="time $t$ [s]", ylabel="tip beside the carrier [mm]")
    tooth.plot(motion.t_level, motion.joint(teeth).force / R_PLANET)
    tooth.set(xlabel="time $t$ [s]", ylabel="force of a tooth [N]")
    plot.save(figure, results / "motion.png")


if __name__ == "__main__":
    script.run()
