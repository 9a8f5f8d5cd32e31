r"""A winch lifts a load by a block of pulleys, with four parts of its rope.

The rope comes from a drum, runs over two fixed sheaves and two that carry the load, and ends at the
frame. All parts between the sheaves are vertical, so that the load hangs on $n = 4$ parts at any
height. With the angle $\varphi(t)$ of the drum, its radius $R$, the stiffness $k$ of the rope and
the mass $m$ the load rises by $z$ from its rest:

$$
m \ddot z = n T - m g, \qquad T = \frac{m g}{n} + k (R \varphi - n z) .
$$

So it vibrates at $\omega = n \sqrt{k/m}$ about $R \varphi / n$. The motor turns the drum, of the
inertia $J$, by $M = R T + J \ddot\varphi$, and its work is that of the load, of the drum and of the
rope.

Reference: this equation, solved to round-off by scipy. Objective: a rope over circles that move,
and on a drum that turns many times; its exact work; nothing but the rope holds the load.

Units are metre, kilogram and second.
"""

import logging

import numpy as np
from scipy.integrate import solve_ivp

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

G, PARTS = 9.81, 4
SHEAVE, DRUM = 0.15, 0.1  # radii [m]
MASS, INERTIA, STIFFNESS = 200.0, 0.5, 1e5  # [kg], of the drum [kg m²], of the rope [N/m]
DEPTH, BELOW = 2.2, 2.6  # of the load and of the drum below the upper sheaves [m]
TURNS, TIME = 10.0, 3.0  # of the drum, in this time [1, s]
DT, T_END = 1e-3, 4.0  # [s]


def turned(t):
    """Angle of the drum, which starts and ends smoothly [rad]."""
    s = min(max(t / TIME, 0.0), 1.0)
    return 2 * np.pi * TURNS * (10 * s**3 - 15 * s**4 + 6 * s**5)


def scene():
    """The scene; its load, drum with motor, and rope."""
    hoist, r = fb.Scene(gravity=(0.0, -G)), SHEAVE
    upper = {"one": (0, 0), "two": (4 * r, 0), "end": (7 * r, 0)}
    frame = hoist.add_body((3 * r, 0.4), 0.0, points=upper, name="frame")
    hoist.clamp(frame.centre)
    lower = {"one": (2 * r, -DEPTH), "two": (6 * r, -DEPTH)}
    load = hoist.add_body((4 * r, -DEPTH - 0.4), MASS, 2.0, lower, name="load")
    drum = hoist.add_body((-r - DRUM, -BELOW), 1.0, INERTIA, name="drum").centre
    motor = hoist.add_joint(fb.Revolute(fb.GROUND, drum, motor=lambda t: -turned(t)))
    points = [
        fb.Pulley(drum, DRUM, side="left"),
        fb.Pulley(frame["one"], r, side="right"),
        fb.Pulley(load["one"], r, side="left"),
        fb.Pulley(frame["two"], r, side="right"),
        fb.Pulley(load["two"], r, side="left"),
        frame["end"],
    ]
    length = BELOW + PARTS * DEPTH + 4 * np.pi * r  # what is wound on the drum does not count
    at_rest = length - MASS * G / PARTS / STIFFNESS
    rope = hoist.add_rope(points, fb.Spring(STIFFNESS, rest=at_rest))
    return hoist, load, motor, rope


def exact(times):
    """Rise of the load (n,) [m] and tension (n,) [N] by the equation of one coordinate."""

    def rates(t, y):
        return y[1], PARTS * STIFFNESS * (DRUM * turned(t) - PARTS * y[0]) / MASS

    options = {"t_eval": times, "rtol": 1e-11, "atol": 1e-12, "method": "DOP853"}
    z = solve_ivp(rates, (0, times[-1]), (0.0, 0.0), **options).y[0]
    angles = np.array([turned(t) for t in times])
    return z, MASS * G / PARTS + STIFFNESS * (DRUM * angles - PARTS * z)


def compute(dt=DT):
    """The numbers, and what is drawn."""
    numbers, runs = {"errors": {}}, []
    for step in (2 * dt, dt):
        hoist, load, motor, rope = scene()
        runs.append((fb.simulate(hoist, dt=step, t_end=T_END), hoist, load, motor, rope))
        motion = runs[-1][0]
        rise = motion.position(load.centre)[:, 1] + DEPTH + 0.4
        numbers["errors"][f"{step:g}"] = abs(rise - exact(motion.t)[0]).max()
    motion, hoist, load, motor, rope = runs[-1]
    energy, rope_values = motion.energy, motion.joint(rope)
    still = motion.position(load.centre)[:, 0] - 4 * SHEAVE
    numbers |= {
        "rise": rise[-1],
        "turns of the drum times R / n": DRUM * turned(T_END) / PARTS,
        "largest error of the tension": abs(rope_values.force[1:] - _at_level(motion)).max(),
        "weight by parts": MASS * G / PARTS,
        "sideways": abs(still).max(),
        "turned": abs(motion.rotation(load.centre)).max(),
        "arcs": rope_values.wrap[-1, 1:-1].tolist(),
        "frequency": _frequency(rope_values, motion),
        "exact frequency": PARTS * np.sqrt(STIFFNESS / MASS) / (2 * np.pi),
        "work of the motor": energy.work[-1],
        "work of the load": MASS * G * rise[-1],
        "energy balance": abs(energy.balance_error).max() / energy.work.max(),
        "Newton iterations per step": motion.stats.newton_iterations / motion.stats.steps,
    }
    return numbers, (motion, hoist, load, motor, rope)


def _at_level(motion):
    """The exact tension, as its mean over each step."""
    tension = exact(motion.t)[1]
    return (tension[1:] + tension[:-1]) / 2


def _frequency(rope_values, motion):
    """Frequency of the vibration that is left when the drum stands still [Hz]."""
    late = motion.t_level > TIME + 0.05
    t, apart = motion.t_level[late], rope_values.force[late] - MASS * G / PARTS
    up = np.flatnonzero((apart[:-1] < 0) & (apart[1:] >= 0))
    crossings = t[up] - apart[up] * (t[up + 1] - t[up]) / (apart[up + 1] - apart[up])
    return (len(crossings) - 1) / (crossings[-1] - crossings[0])


def report(numbers):
    for step, error in numbers["errors"].items():
        print(f"dt = {step} s: largest error of the height {1e6 * error:.2f} um")
    heights = numbers["rise"], numbers["turns of the drum times R / n"]
    print("The load rises by {:.6f} m, the rope by {:.6f} m a part".format(*heights))
    words = "Tension {:.2f} N at rest, within {:.2f} N of the exact one in the motion"
    print(words.format(numbers["weight by parts"], numbers["largest error of the tension"]))
    print(
        "Frequency {:.4f} Hz, exact {:.4f}".format(numbers["frequency"], numbers["exact frequency"])
    )
    print(f"Sideways {numbers['sideways']:.0e} m, turned {numbers['turned']:.0e} rad", end=", ")
    print(f"energy balance {numbers['energy balance']:.0e}", end=", ")
    print(f"{numbers['Newton iterations per step']:.2f} Newton iterations per step")


def draw(results, motion, hoist, load, motor, rope):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(hoist, results / "scene.png")
    rows = range(0, round(TIME / DT), 60)
    plot.animate(motion, results / "motion.gif")
    thumbnail.card(motion, rows, results / "thumbnail.png")
    figure, ((height, pull),) = plot.figure(1, 2)
    z, _ = exact(motion.t)
    height.plot(
        motion.t, motion.position(load.centre)[:, 1] + DEPTH + 0.4, label="rope over circles"
    )
    height.plot(motion.t, z, "k--", linewidth=0.8, label="exact")
    height.set(xlabel="time $t$ [s]", ylabel="rise of the load [m]")
    pull.plot(motion.t_level[1:], motion.joint(rope).force[1:])
    pull.plot(motion.t_level[1:], _at_level(motion), "k--", linewidth=0.8)
    pull.set(xlabel="time $t$ [s]", ylabel="tension [N]")
    plot.save(figure, results / "lift.png")


if __name__ == "__main__":
    script.run()
