r"""A flexible arm turned by PD control of its joint, which also damps the vibration of the tip.

An arm of aluminium with a load at its tip turns about a hub in a horizontal plane, by one radian. A
motor with given angle brings the hub exactly to its goal, but the tip vibrates without decay. A
motor with a torque, set by proportional and derivative feedback of the hub's angle alone, brings
both to rest. Objective: gains that damp the slowest modes most, from the linearised scene, and the
decay of the tip vibration compared with these modes.

Reference: R. H. Cannon, E. Schmitz, Initial experiments on the end-point control of a flexible
one-link robot, International Journal of Robotics Research 3(3) (1984) 62-75,
doi 10.1177/027836498400300303, who name this control of the joint as the state of the art before
theirs. The arm is our own.

With the hub's angle $\theta$ and its goal $\theta_d(t)$, a smooth step of the time $T$, the torque
is

$$ u = k_p (\theta_d - \theta) - k_d \dot\theta, $$

constant in each step of the motion. About the arm at rest the scene is $\dot x = A x + B u$, with
$\theta = C x$; with feedback its roots are the eigenvalues of $A - B (k_p C + k_d C A)$. From a
grid of gains those are chosen whose slowest root decays fastest, for a turning arm with two
vibrations. Units are metre, kilogram and second; there is no weight and no damping.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

LENGTH, WIDTH, HEIGHT = 1.0, 20e-3, 3e-3  # of the arm [m]
ALUMINIUM = {"E": 70e9, "nu": 0.33, "rho": 2700.0}
HUB, LOAD = 0.01, 0.05  # inertia of the hub [kg m²], mass at the tip [kg]
ELEMENTS = 8
ANGLE, RISE = 1.0, 0.8  # goal [rad] and the time T in which it is reached [s]
T_END, DT = 6.0, 1e-3  # [s]
STATES = 6  # of the design: the turning arm and two vibrations
PROPORTIONAL = np.geomspace(0.5, 20, 41)  # k_p [N m/rad]
DERIVATIVE = np.geomspace(0.1, 4, 41)  # k_d [N m s/rad]


def goal(t):
    r"""Angle $\theta_d$: its speed and acceleration are continuous."""
    s = np.clip(t / RISE, 0, 1)
    return ANGLE * s**3 * (10 - 15 * s + 6 * s**2)


def scene(motor=None):
    """The scene, its arm and its joint: with a torque as input, or a motor of given angle."""
    system = fb.Scene()
    section = fb.Section.rectangle(height=HEIGHT, width=WIDTH, **ALUMINIUM)
    arm = system.add_beam([(0, 0), (LENGTH, 0)], section, elements=ELEMENTS, name="arm")
    hub = system.add_joint(fb.Revolute(fb.GROUND, arm.start, motor=motor))
    system.add_mass(arm.start, 0.0, inertia=HUB)
    system.add_mass(arm.end, LOAD)
    if motor is None:
        system.add_moment(arm.start, fb.Input("torque"))
    return system, arm, hub


def outputs(arm, hub):
    return {
        "angle": fb.Output("angle", hub),
        "spin": fb.Output("spin", hub),
        "tip": fb.Output("position", arm.end),
    }


def best_gains():
    """Gains whose slowest root decays fastest, and the roots."""
    system, arm, hub = scene()
    seen = {"angle": fb.Output("angle", hub), "spin": fb.Output("spin", hub)}
    linear = fb.linearise(system, outputs=seen).slowest(STATES)
    A, B, C = linear.A, linear.B, linear.C

    def roots(kp, kd):
        return np.linalg.eigvals(A - B @ (kp * C[:1] + kd * C[1:]))

    decay = {(kp, kd): -roots(kp, kd).real.max() for kp in PROPORTIONAL for kd in DERIVATIVE}
    kp, kd = max(decay, key=decay.get)
    return float(kp), float(kd), roots(kp, kd)


def controlled(kp, kd):
    """The motion with PD control, and rows (t, torque)."""
    system, arm, hub = scene()
    seen = outputs(arm, hub)
    motion = fb.Motion(system, dt=DT, outputs=seen, record=fb.Record())
    rows = []

    def controller(t, y):
        torque = kp * (goal(t) - y["angle"]) - kd * y["spin"]
        rows.append((t, torque))
        return {"torque": torque}

    motion.run(T_END, controller)
    return motion.solution(), np.array(rows)


def driven():
    """The motion with a motor of given angle."""
    system, _, _ = scene(fb.Input("angle"))
    motion = fb.Motion(system, dt=DT, record=fb.Record())
    motion.run(T_END, lambda t, y: {"angle": goal(t + DT)})
    return motion.solution()


def off(solution):
    """Distance of the tip from its goal."""
    arm = solution.beams["arm"]
    place = LENGTH * np.array([np.cos(ANGLE), np.sin(ANGLE)])
    return np.hypot(*(solution.position(arm.end) - place).T)


def decay_of(solution):
    """Rate [1/s] at which the largest distance of the tip falls, between two windows."""
    t, distance = solution.t, off(solution)
    first, second = 1.5, 2.5
    sizes = [distance[(t >= begin) & (t < begin + 0.5)].max() for begin in (first, second)]
    return float(np.log(sizes[0] / sizes[1]) / (second - first))


def compute():
    """The numbers, and what is drawn."""
    kp, kd, roots = best_gains()
    log.info("k_p = %.3g N m/rad, k_d = %.3g N m s/rad", kp, kd)
    solution, rows = controlled(kp, kd)
    prescribed = driven()
    late = solution.t > T_END - 1
    numbers = {
        "k_p": kp,
        "k_d": kd,
        "slowest root by linearise": float(-roots.real.max()),
        "decay of the tip": decay_of(solution),
        "tip off its goal in the last second": float(off(solution)[late].max()),
        "the same with a given angle": float(off(prescribed)[late].max()),
        "largest torque": float(abs(rows[:, 1]).max()),
        "work of the torque": float(solution.energy.work[-1]),
        "largest energy": float(solution.energy.total.max()),
        "largest energy error": float(
            max(abs(run.energy.balance_error).max() for run in (solution, prescribed))
        ),
    }
    return numbers, (solution, prescribed, rows)


def report(numbers):
    print(
        f"k_p = {numbers['k_p']:.3g} N m/rad, k_d = {numbers['k_d']:.3g} N m s/rad: the slowest "
        f"root decays with {numbers['slowest root by linearise']:.2f} /s,\nthe tip with "
        f"{numbers['decay of the tip']:.2f} /s. In the last second it is "
        f"{numbers['tip off its goal in the last second']:.0e} m off its goal;\nwith a "
        f"given angle {1e3 * numbers['the same with a given angle']:.1f} mm. Largest energy error "
        f"{numbers['largest energy error']:.0e} J of {numbers['largest energy']:.2f} J."
    )


def draw(results, solution, prescribed, rows):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene()[0], results / "scene.png")
    tip = solution.beams["arm"].end
    plot.animate(solution, results / "motion.gif", rows=range(0, 3000, 30), trace=tip)
    thumbnail.card(solution, range(0, 3000, 30), results / "thumbnail.png")
    figure, axes = plot.figure(3, 1)
    angle, distance, torque = axes.flat
    blue, orange = {"color": "#0072B2"}, {"color": "#D55E00", "linewidth": 1}
    t = solution.t
    for run, look, label in (
        (prescribed, orange, "given angle"),
        (solution, blue, "PD control of the joint"),
    ):
        arm = run.beams["arm"]
        x, y = run.position(arm.end).T
        angle.plot(t, run.rotation(arm.start), **look, label=f"hub, {label}")
        distance.plot(t, 1e3 * (np.arctan2(y, x) - ANGLE) * LENGTH, **look, label=label)
    angle.plot(t, goal(t), "--", color="0.5", label="goal")
    angle.set(ylabel="angle [rad]")
    distance.set(ylabel="tip off its goal [mm]", ylim=(-300, 300))
    torque.plot(*rows.T, **blue)
    torque.set(ylabel="torque [N m]")
    for ax in axes.flat:
        ax.set(xlabel="time $t$ [s]", xlim=(0, T_END))
    angle.set_title(f"$\\Delta t$ = {DT:g} s")
    plot.save(figure, results / "control.png")


if __name__ == "__main__":
    script.run()
