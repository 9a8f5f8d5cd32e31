r"""An inverted flexible pendulum on a cart, kept upright and moved by feedback of its state.

A cart on a straight rail carries a slender pole on a hinge, with a mass at its tip. The only
control is a horizontal force on the cart. Objective: compute gains from the linearised scene, and
keep the pole upright in a gust at its tip and while the cart moves by a metre. A second set of
gains, for a rigid pole, does not damp the bending of the pole.

Reference: R. E. Kalman, Contributions to the theory of optimal control, Boletin de la Sociedad
Matematica Mexicana 5 (1960) 102-119. The example is our own.

About the upright equilibrium the motion is $\dot x = A x + B u$, with the push $u$ on the cart and
the states $x$ of the slowest modes. The gains $K$ minimise the integral of

$$ q_c c^2 + q_d d^2 + q_b b^2 + r u^2, \qquad u = -K (x - x_\mathrm{goal}), $$

with the positions $c$ of the cart and $d$ of the tip, and the bending $b = d - c + L \varphi$ of
the pole, whose lower end turns by $\varphi$: $K = B^T P/r$, where $P$ solves the Riccati equation

$$ A^T P + P A - \frac{1}{r} P B B^T P + Q = 0. $$

In each step of the nonlinear motion the force is constant; it follows from the state at the start
of the step. The goal is an equilibrium as well: the same state, at another position of the cart.
All states are assumed to be known; an observer would need $A$, $B$ and $C$. Units are metre,
kilogram and second.
"""

import logging

import numpy as np
import scipy.linalg

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

LENGTH, WIDTH, HEIGHT = 1.0, 15e-3, 2.5e-3  # of the pole [m]
E, RHO, RETARDATION = 70e9, 2700.0, 2e-5  # aluminium, with a little damping [Pa, kg/m³, s]
TIP, CART_HALF = 0.1, 0.15  # mass at the tip [kg]; half of the cart's length [m]
ELEMENTS = 8
RIGID = 1e3  # factor on the bending stiffness of a pole that is nearly rigid
STATES = 8  # of the controller; 4 for a rigid pole
WEIGHTS = (20.0, 40.0, 2e4, 0.05)  # q_c, q_d, q_b [1/m²], r [1/N²]
DT, T_END = 2e-3, 9.0  # [s]
GUST, GUST_TIME = 0.4, (0.5, 0.7)  # force at the tip [N], from and to [s]
GOAL, GOAL_TIME = 1.0, 4.0  # new place of the cart [m], from this time on [s]


def scene(bending=1.0, held=False):
    """The scene, its pole, rail and hinge; held by springs, to find the upright equilibrium."""
    system = fb.Scene(gravity=(0.0, -9.81))
    area, inertia = WIDTH * HEIGHT, WIDTH * HEIGHT**3 / 12
    bent = bending * E * inertia
    pole = fb.Section(
        EA=E * area, GA=E * area / 3, EI=bent, rhoA=RHO * area, rhoI=RHO * inertia,
        retardation=RETARDATION,
    )  # fmt: skip
    block = fb.Section.rectangle(height=0.04, width=0.04, E=E, nu=0.33, rho=RHO)
    cart = system.add_beam([(-CART_HALF, 0), (CART_HALF, 0)], block, elements=2, name="cart")
    pole = system.add_beam([(0, 0), (0, LENGTH)], pole, elements=ELEMENTS, name="pole")
    middle, spring = cart.node(0.5), fb.Spring(100.0) if held else None
    rail = system.add_joint(fb.Prismatic(fb.GROUND, middle, axis=(1, 0), spring=spring))
    hinge = system.add_joint(fb.Revolute(middle, pole.start, spring=spring))
    system.add_mass(pole.end, TIP)
    system.add_force(middle, fb.Input("push", factor=(1, 0)))
    system.add_force(pole.end, fb.Input("gust", factor=(1, 0)))
    return system, pole, rail, hinge


def outputs(pole, rail, hinge):
    return {
        "cart": fb.Output("slide", rail),
        "tip": fb.Output("position", pole.end, "x"),
        "angle": fb.Output("angle", hinge),
    }


def upright(bending=1.0):
    """The equilibrium that is to be held."""
    return fb.static(scene(bending, held=True)[0], load_steps=2)


def design(bending=1.0, states=STATES):
    """The linear system of the slowest modes, its gains, and the states of a unit of the goal."""
    whole, *parts = scene(bending)
    system = fb.linearise(whole, upright(bending), ["push"], outputs(*parts)).slowest(states)
    A, B, C = system.A, system.B, system.C
    cart, tip, bending, push = WEIGHTS
    rows = np.vstack([C[:2], C[1] - C[0] + LENGTH * C[2]])
    Q = rows.T @ np.diag([cart, tip, bending if states > 4 else 0.0]) @ rows
    P = scipy.linalg.solve_continuous_are(A, B, Q, np.array([[push]]))
    # At rest with the cart one metre further on: 0 = A x + B u, 1 = C x.
    at_rest = np.block([[A, B], [C[:1], system.D[:1]]])
    goal = np.linalg.solve(at_rest, np.append(np.zeros(len(A)), 1.0))[:-1]
    return system, B.T @ P / push, goal


def run(system=None, gains=None, goal=None, t_end=T_END):
    """A motion and its rows (t, push, cart, tip, angle, bending); without a system uncontrolled."""
    whole, *parts = scene()
    record = fb.Record(every=10)
    motion = fb.Motion(whole, dt=DT, outputs=outputs(*parts), start=upright(), record=record)
    rows = []
    values, push = motion.outputs, 0.0
    while motion.t < t_end - DT / 2 and abs(values["angle"]) < 1:
        t = motion.t
        if system is not None:
            x = system.deviation(motion) - (GOAL * goal if t >= GOAL_TIME else 0.0)
            push = -float((gains @ x)[0])
        gust = GUST if GUST_TIME[0] <= t < GUST_TIME[1] else 0.0
        values = motion.step({"push": push, "gust": gust})
        bent = values["tip"] - values["cart"] + LENGTH * np.sin(values["angle"])
        rows.append([motion.t, push, *values.values(), bent])
    return motion, np.array(rows)


def numbers_of(motion, rows, system, gains):
    """Numbers by which a run is assessed."""
    t, push, cart, tip, angle, bent = rows.T
    energy = motion.solution().energy
    numbers = {
        "kept upright": bool(t[-1] > T_END - DT),
        "time": float(t[-1]),
        "largest push": float(abs(push).max()),
        "largest angle": float(abs(angle).max()),
        "largest energy error": float(abs(energy.balance_error).max()),
        "work of the push and the gust": float(energy.work[-1]),
    }
    if system is not None:
        closed = np.linalg.eigvals(system.A - system.B @ gains)
        numbers["slowest decay of the design"] = float(-closed.real.max())
    if numbers["kept upright"]:
        numbers["cart off the goal at the end"] = float(abs(cart[-1] - GOAL))
        numbers["tip off the cart at the end"] = float(abs(tip[-1] - cart[-1]))
        numbers["bending in the last second"] = float(abs(bent)[t > T_END - 1].max())
        numbers["largest bending"] = float(abs(bent).max())
    return numbers


def compute():
    """The numbers, and what is drawn."""
    designs = {
        "flexible pole": design(),
        "rigid pole": design(RIGID, 4),
        "none": (None, None, None),
    }
    runs, numbers = {}, {}
    for name, (system, gains, goal) in designs.items():
        log.info("gains: %s", name)
        runs[name] = run(system, gains, goal)
        numbers[name] = numbers_of(*runs[name], system, gains)
    roots = np.linalg.eigvals(designs["flexible pole"][0].A)
    numbers["upright without control"] = {
        "growth rate": float(roots.real.max()),
        "first bending, angular frequency": float(np.sort(roots.imag[roots.imag > 1])[0]),
    }
    return numbers, (runs,)


def report(numbers):
    free = numbers["upright without control"]
    print(
        f"Without control the pole falls as exp({free['growth rate']:.2f} t); its first bending "
        f"has {free['first bending, angular frequency']:.1f} rad/s."
    )
    for name in ("flexible pole", "rigid pole", "none"):
        case = numbers[name]
        end = "kept upright" if case["kept upright"] else f"fallen at {case['time']:.2f} s"
        print(
            f"Gains for {name}: {end}; largest push {case['largest push']:.2f} N, angle "
            f"{case['largest angle']:.3f} rad; energy error {case['largest energy error']:.0e} J"
        )
    pole = numbers["flexible pole"]
    print(
        f"Bending in the last second: {1e3 * pole['bending in the last second']:.3f} mm; with "
        "gains for a rigid pole "
        f"{1e3 * numbers['rigid pole']['bending in the last second']:.1f} mm.\n"
        f"At the end the cart is {pole['cart off the goal at the end']:.1e} m off its goal, the "
        f"tip {pole['tip off the cart at the end']:.1e} m off the cart."
    )


def draw(results, runs):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene()[0], results / "scene.png")
    motion, rows = runs["flexible pole"]
    solution = motion.solution()
    frames = range(0, len(solution.t), 3)
    plot.animate(solution, results / "motion.gif", rows=frames, trace=solution.beams["pole"].end)
    thumbnail.card(solution, range(0, len(solution.t), 6), results / "thumbnail.png")
    t, push, cart, tip, angle, bent = rows.T
    figure, axes = plot.figure(4, 1)
    place, lean, bow, force = axes.flat
    place.plot(t, cart, color="#009E73", label="cart")
    place.plot(t, tip, color="black", linewidth=1, label="tip")
    place.set(ylabel="place [m]")
    for ax, values in ((lean, angle), (bow, 1e3 * bent), (force, push)):
        ax.plot(t, values, color="#0072B2", label="gains for the flexible pole", zorder=3)
    others = (("rigid pole", "#D55E00", "gains for a rigid pole"), ("none", "0.5", "no control"))
    for name, colour, label in others:
        other = runs[name][1].T
        lean.plot(other[0], other[4], color=colour, linewidth=1, label=label)
        if name != "none":
            bow.plot(other[0], 1e3 * other[5], color=colour, linewidth=1, label=label)
            force.plot(other[0], other[1], color=colour, linewidth=1, label=label)
    lean.set(ylabel="angle of the hinge [rad]", ylim=(-0.6, 0.6))
    bow.set(ylabel="bending at the tip [mm]")
    force.set(ylabel="push [N]")
    for ax in axes.flat:
        ax.axvspan(*GUST_TIME, color="0.9")
        ax.axvline(GOAL_TIME, color="0.7", linewidth=0.8)
        ax.set(xlabel="time $t$ [s]", xlim=(0, T_END))
    place.set_title("A gust at the tip (grey), and a metre to go from 4 s on")
    plot.save(figure, results / "control.png")


if __name__ == "__main__":
    script.run()
