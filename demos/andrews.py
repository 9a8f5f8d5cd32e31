r"""Andrews' squeezing mechanism: seven rigid bodies in closed loops, driven by a moment.

Seven bodies, hinged to each other and at three points to the ground, and a spring. A moment
accelerates the smallest body, $K_1$, from rest: it turns by sixteen radians in 0.03 s, and the
others move back and forth. This is a standard test for solvers of constrained motion. Objective:
the published angles and speeds at the end, the closing of the loops, and the balance of energy.

The mechanism and its data are from W. Schiehlen (ed.), "Multibody systems handbook", Springer
(1990), as E. Hairer and G. Wanner give them, "Solving ordinary differential equations II", Springer
(1996), section VII.7. The values at 0.03 s are those of F. Mazzia and C. Magherini, "Test set for
initial value problem solvers, release 2.4", University of Bari (2008). Its angles are, by bodies,

$$
\beta = K_1, \quad \Theta = K_2 - K_1, \quad \gamma = K_3, \quad \Phi = K_4 - K_5, \quad
\delta = K_5, \quad \Omega = K_6 - K_7, \quad \varepsilon = K_7.
$$

There are nine unknowns: seven rotations, and the rotation and length of the spring. The four loops
have eight equations, so that one degree of freedom is left. The spring lies on a body without mass
that turns about the point $C$; a pin of $K_3$ slides along it. Units are metre, kilogram and
second.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

MASS = {1: 0.04325, 2: 0.00365, 3: 0.02373, 4: 0.00706, 5: 0.07050, 6: 0.00706, 7: 0.05498}  # [kg]
INERTIA = dict(  # [kg m²]
    enumerate((2.194e-6, 4.410e-7, 5.255e-6, 5.667e-7, 1.169e-5, 5.667e-7, 1.912e-5), start=1)
)
# Fixed points [m].
ORIGIN, A, B, C = (0.0, 0.0), (-0.06934, -0.00227), (-0.03635, 0.03273), (0.014, 0.072)
SPRING, LENGTH = 4530.0, 0.07785  # stiffness [N/m], length without force [m]
MOMENT, T_END = 0.033, 0.03  # [N m], [s]
NAMES = "beta", "Theta", "gamma", "Phi", "delta", "Omega", "epsilon"
START = (  # [rad]
    *(-0.0617138900142764496, 0.0, 0.455279819163070380, 0.222668390165885885),
    *(0.487364979543842550, -0.222668390165885885, 1.230547444549821192),
)
# At 0.03 s [rad], [rad/s].
ANGLES = (
    *(15.81077119629904, -15.75637105984298, 0.04082224013073101, -0.5347301163226948),
    *(0.5244099658805304, 0.5347301163226948, 1.048080741042263),
)
SPEEDS = (
    *(1139.920302151208, -1424.379294994111, 11.03291221937134, 19.29337464421385),
    *(0.5735699284790808, -19.29337464421385, 0.3231791658026955),
)
RUNS = {2: (300, 1000, 3000, 10_000), 4: (100, 200, 400, 800, 1600)}  # steps by order


def scene():
    """The mechanism, and its bodies by number."""
    beta, theta, gamma, phi, delta, omega, epsilon = START
    turns = dict(
        enumerate(
            (beta, beta + theta, gamma, delta + phi, delta, epsilon + omega, epsilon), start=1
        )
    )

    def place(origin, number, x, y):
        """A point of a body, given in its frame about an origin."""
        c, s = np.cos(turns[number]), np.sin(turns[number])
        return origin[0] + c * x - s * y, origin[1] + s * x + c * y

    # Hinges between bodies; D is that of K2, K3, K4 and K6.
    E, D = place(ORIGIN, 1, 0.007, 0), place(B, 3, 0, -0.035)
    F, G, H = place(A, 5, 0.04, 0), place(A, 7, 0, -0.04), place(B, 3, 0.02, -0.018)
    centres = {
        1: place(ORIGIN, 1, 0.00092, 0),
        2: place(E, 2, -0.0115, 0),
        3: place(B, 3, 0.01043, -0.01874),
        4: place(F, 4, 0, 0.01421 - 0.02),
        5: place(A, 5, 0.02308, 0.00916),
        6: place(G, 6, 0.02 - 0.01421, 0),
        7: place(A, 7, -0.01228, -0.00449),
    }
    points = {
        1: {"O": ORIGIN, "E": E},
        2: {"E": E, "D": D},
        3: {"B": B, "D": D, "H": H},
        4: {"F": F, "D": D},
        5: {"A": A, "F": F},
        6: {"G": G, "D": D},
        7: {"A": A, "G": G},
    }
    mechanism = fb.Scene()
    bodies = {
        i: mechanism.add_body(centres[i], MASS[i], INERTIA[i], points[i], f"K{i}") for i in MASS
    }
    for body, point in ((1, "O"), (3, "B"), (5, "A"), (7, "A")):
        mechanism.add_joint(fb.Revolute(fb.GROUND, bodies[body][point]))
    for a, b, point in (
        (1, 2, "E"),
        (5, 4, "F"),
        (7, 6, "G"),
        (2, 3, "D"),
        (2, 4, "D"),
        (2, 6, "D"),
    ):
        mechanism.add_joint(fb.Revolute(bodies[a][point], bodies[b][point]))
    guide = mechanism.add_body(C, 0.0, name="spring").centre
    mechanism.add_joint(fb.Revolute(fb.GROUND, guide))
    axis, spring = np.subtract(H, C), fb.Spring(SPRING, rest=LENGTH)
    mechanism.add_joint(fb.PinInSlot(guide, bodies[3]["H"], axis=axis, spring=spring))
    mechanism.add_moment(bodies[1].centre, MOMENT)
    return mechanism, bodies


def simulate(steps, order=2):
    """The solution and the bodies."""
    log.info("order %d, %d steps", order, steps)
    mechanism, bodies = scene()
    scheme = fb.EnergyMomentum(order=order)
    return fb.simulate(mechanism, scheme, dt=T_END / steps, t_end=T_END), bodies


def relative(K):
    """The seven angles or speeds (7, n) from those of the bodies by number."""
    return np.array([K[1], K[2] - K[1], K[3], K[4] - K[5], K[5], K[6] - K[7], K[7]])


def angles(solution, bodies):
    """The seven angles (7, n) over time [rad]."""
    turned = relative({i: solution.rotation(body.centre) for i, body in bodies.items()})
    return np.array(START)[:, None] + turned


def speeds(solution, bodies):
    """Their rates (7, n) [rad/s]."""
    return relative({i: solution.spin(body.centre) for i, body in bodies.items()})


def audit(solution, bodies):
    """Numbers by which a run is assessed."""
    computed = angles(solution, bodies)[:, -1]
    energy = solution.energy
    return {
        "unknowns": solution.stats.unknowns,
        "angles": dict(zip(NAMES, computed.tolist(), strict=True)),
        "error of each angle": dict(zip(NAMES, abs(computed - ANGLES).tolist(), strict=True)),
        "largest relative error of an angle": abs(computed / ANGLES - 1).max(),
        "largest error of a speed": abs(speeds(solution, bodies)[:, -1] - SPEEDS).max(),
        "relative balance error": abs(energy.balance_error).max() / energy.work.max(),
        "largest gap": max(
            solution.joint(joint).gap.max() for joint in bodies[1].centre.scene.joints
        ),
        "seconds": solution.stats.seconds,
    }


def compute(runs=None):
    """The numbers, and what is drawn."""
    numbers = {
        f"order {order}": {str(n): audit(*simulate(n, order)) for n in steps}
        for order, steps in (runs or RUNS).items()
    }
    return numbers, (numbers,)


def report(numbers):
    row = "{:>7} {:>7} {:>12} {:>12} {:>9} {:>9} {:>9}".format
    print(row("order", "steps", "angles, rel.", "speeds", "balance", "largest", "time"))
    print(row("", "", "error", "err. [rad/s]", "error", "gap [m]", "[s]"))
    for order, runs in numbers.items():
        for steps, run in runs.items():
            values = (
                f"{run['largest relative error of an angle']:.1e}",
                f"{run['largest error of a speed']:.1e}",
                f"{run['relative balance error']:.0e}",
                f"{run['largest gap']:.0e}",
                f"{run['seconds']:.3f}",
            )
            print(row(order.removeprefix("order "), steps, *values))
    best = list(list(numbers.values())[-1].values())[-1]
    print("\nAngles at 0.03 s [rad], and their differences from the published values:")
    for name, value in best["angles"].items():
        print(f"{name:>8} {value:18.13f} {best['error of each angle'][name]:9.0e}")


def draw(results, numbers):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    solution, bodies = simulate(3000)
    drawn, _ = scene()
    plot.scene(drawn, results / "scene.png")
    plot.shapes(solution, results / "shapes.png", rows=range(1000, 1801, 100))
    crossing = bodies[3]["D"]
    plot.animate(solution, results / "motion.gif", rows=range(0, 3001, 30), trace=crossing)

    thumbnail.card(solution, range(1000, 1801, 20), results / "thumbnail.png")

    computed = angles(solution, bodies)
    figure, axes = plot.figure(2, 1)
    motion, error = axes.flat
    for name, values in zip(NAMES, computed, strict=True):
        wrapped = (values + np.pi) % (2 * np.pi) - np.pi
        wrapped[1:][abs(np.diff(wrapped)) > np.pi] = np.nan
        motion.plot(1e3 * solution.t, wrapped, linewidth=1.1, label=name)
    motion.set(xlabel="time $t$ [ms]", ylabel="angles mod $2\\pi$ [rad]")
    for order, runs in numbers.items():
        errors = [run["largest relative error of an angle"] for run in runs.values()]
        error.loglog(list(map(int, runs)), errors, "o-", label=f"EnergyMomentum, {order}")
    error.set(xlabel="steps", ylabel="rel. error of angles")
    plot.save(figure, results / "angles.png")


if __name__ == "__main__":
    script.run()
