r"""Slider-crank mechanism with a flexible crank and rod, driven by a motor.

A motor turns the crank. It starts from rest, reaches a constant speed within the time of two turns,
and then runs for ten turns. The rod drives a slider on a straight guide. Crank and rod are so
slender that they bend under their own inertia. Objective: the difference between the motion of the
slider and that of a rigid mechanism, the moment of the motor, and the balance of the motor's work
with the energy of the mechanism.

This example is our own. With the motor's angle $\theta$, the crank's radius $r$, the rod's length
$l$ and its angle $\beta$, the rigid mechanism has

$$
\begin{aligned}
r \sin\theta + l \sin\beta &= 0, & \beta' &= -\frac{r \cos\theta}{l \cos\beta}, \\
x &= r \cos\theta + l \cos\beta, & x' &= -r \sin\theta - l \sin\beta\,\beta',
\end{aligned}
$$

where a prime is the derivative by $\theta$. Its kinetic energy is $\frac{1}{2} J \dot\theta^2$
with, for uniform crank and rod,

$$
\begin{aligned}
J &= \frac{1}{3} \rho A_c\,r^3 + \rho I_c\,r
+ \frac{1}{3} \rho A\,l\,(r^2 - r \sin\theta\,x' + x'^2) \\
&\quad + \rho I\,l\,\beta'^2 + m x'^2,
\end{aligned}
$$

and the motor's moment is $M = J \ddot\theta + \frac{1}{2} J' \dot\theta^2$.

The angle of the motor is prescribed: $\theta = W T g(t/T)$ up to $T$ and $W (t - T/2)$ after it,
with $g(s) = s^6 - 3 s^5 + \frac{5}{2} s^4$. Speed and acceleration are continuous. The work of the
motor in a step is $M \Delta\theta$ with $\Delta\theta = 2 \tan(\Delta\psi/2)$, where $M$ is the
moment that the joint reports. Units are metre, kilogram and second. The mechanism moves in a
horizontal plane: there is no weight.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

RADIUS, LENGTH = 0.15, 0.45  # r, l [m]
STEEL = {"width": 10e-3, "E": 210e9, "nu": 0.3, "rho": 7850.0}
CRANK = fb.Section.rectangle(height=8e-3, **STEEL)
ROD = fb.Section.rectangle(height=4e-3, **STEEL)
SLIDER = 0.1  # m [kg]
PERIOD = 0.1  # of a turn at constant speed [s]
SPEED = 2 * np.pi / PERIOD  # W [rad/s]
RAMP, TURNS = 2 * PERIOD, 10  # T [s]; turns at constant speed
T_END = RAMP + TURNS * PERIOD
ELEMENTS = {"crank": 4, "rod": 8}
DT = 5e-4  # [s]
STEPS = (2 * DT, DT, DT / 2)
STIFFENED = 1e4  # factor on the stiffness of a mechanism that is nearly rigid


def angle(t):
    """Motor's angle, speed and acceleration at times $t$."""
    s = np.clip(t / RAMP, 0, 1)
    theta = SPEED * (RAMP * (s**6 - 3 * s**5 + 2.5 * s**4) + np.maximum(t - RAMP, 0))
    rate = SPEED * (6 * s**5 - 15 * s**4 + 10 * s**3)
    return theta, rate, SPEED / RAMP * 30 * s**2 * (s - 1) ** 2


def rigid(t):
    """Position and velocity of the slider, and the motor's moment, of the rigid mechanism."""
    theta, rate, acceleration = angle(t)
    r, length, sin, cos = RADIUS, LENGTH, np.sin(theta), np.cos(theta)
    beta = -np.arcsin(r * sin / length)
    sin_b, cos_b = np.sin(beta), np.cos(beta)
    beta1 = -r * cos / (length * cos_b)
    beta2 = (r * sin + length * sin_b * beta1**2) / (length * cos_b)
    x = r * cos + length * cos_b
    x1 = -r * sin - length * sin_b * beta1
    x2 = -r * cos - length * cos_b * beta1**2 - length * sin_b * beta2

    rod = ROD.rhoA * length / 3
    J = CRANK.rhoA * r**3 / 3 + CRANK.rhoI * r + rod * (r**2 - r * sin * x1 + x1**2)
    J += ROD.rhoI * length * beta1**2 + SLIDER * x1**2
    J1 = rod * (-r * cos * x1 - r * sin * x2 + 2 * x1 * x2)
    J1 += 2 * ROD.rhoI * length * beta1 * beta2 + 2 * SLIDER * x1 * x2
    return x, x1 * rate, J * acceleration + J1 * rate**2 / 2


def stiffened(section, factor):
    stiffness = {name: factor * getattr(section, name) for name in ("EA", "GA", "EI")}
    return fb.Section(**stiffness, rhoA=section.rhoA, rhoI=section.rhoI)


def scene(factor=1.0):
    """The scene, with its stiffness multiplied by a factor, and its joints by name."""
    mechanism = fb.Scene()
    ends = {"crank": [(0, 0), (RADIUS, 0)], "rod": [(RADIUS, 0), (RADIUS + LENGTH, 0)]}
    crank, rod = (
        mechanism.add_beam(ends[name], stiffened(section, factor), ELEMENTS[name], name=name)
        for name, section in (("crank", CRANK), ("rod", ROD))
    )
    joints = {
        "motor": fb.Revolute(fb.GROUND, crank.start, motor=lambda t: angle(t)[0]),
        "pin": fb.Revolute(crank.end, rod.start),
        "guide": fb.PinInSlot(fb.GROUND, rod.end, axis=(1, 0)),
    }
    joints = {name: mechanism.add_joint(joint) for name, joint in joints.items()}
    mechanism.add_mass(rod.end, SLIDER)
    return mechanism, joints


def simulate(dt, factor=1.0, t_end=T_END):
    """The solution and its joints by name."""
    log.info("computing %g s of the motion in steps of %g s", t_end, dt)
    mechanism, joints = scene(factor)
    return fb.simulate(mechanism, dt=dt, t_end=t_end), joints


def slider(solution):
    """Position and velocity of the slider along the guide."""
    node = solution.beams["rod"].end
    return solution.position(node)[:, 0], solution.velocity(node)[:, 0]


def deflection(solution):
    """Distance of the rod's middle from the line between its ends."""
    rod = solution.beams["rod"]
    start, middle, end = (solution.position(n) for n in (rod.start, rod.node(0.5), rod.end))
    (x, y), (x1, y1) = (middle - start).T, (end - start).T
    return (x1 * y - y1 * x) / np.hypot(x1, y1)


def motor_moment(solution, joints):
    return solution.joint(joints["motor"]).force[:, 2]


def motor_work(solution, joints):
    """Work of the moment that the motor's joint reports; for runs without halved steps."""
    turned = 2 * np.tan(np.diff(solution.rotation(solution.beams["crank"].start)) / 2)
    return np.append(0, np.cumsum(motor_moment(solution, joints)[1:] * turned))


def audit(solution, joints):
    """Numbers by which a run is assessed."""
    energy = solution.energy
    x, _ = slider(solution)
    scale = energy.total.max()
    return {
        "steps": solution.stats.steps,
        "largest energy": scale,
        "energy at the end": energy.total[-1],
        "work at the end": energy.work[-1],
        "relative balance error": abs(energy.balance_error).max() / scale,
        "relative error of motor work": abs(
            motor_work(solution, joints) - energy.total + energy.total[0]
        ).max()
        / scale,
        "largest gap": max(solution.joint(joint).gap.max() for joint in joints.values()),
        "slider off the rigid mechanism": abs(x - rigid(solution.t)[0]).max(),
        "largest deflection of the rod": abs(deflection(solution)).max(),
        "largest bending moment in the rod": abs(solution.resultants("rod").M).max(),
        "largest motor moment": abs(motor_moment(solution, joints)).max(),
        "Newton iterations": solution.stats.newton_iterations,
        "halvings": solution.stats.halvings,
    }


def nearly_rigid():
    """Differences between a mechanism of high stiffness and a rigid one."""
    solution, joints = simulate(DT, STIFFENED, RAMP + 2 * PERIOD)
    x, _, _ = rigid(solution.t)
    moment = rigid(solution.t_level)[2]
    computed = motor_moment(solution, joints)
    return {
        "slider": abs(slider(solution)[0] - x).max(),
        "motor moment": (abs(computed - moment)[1:].max() / abs(moment).max()),
    }


def compute(steps=STEPS):
    """The numbers, and what is drawn."""
    runs = {dt: simulate(dt) for dt in steps}
    numbers = {
        "largest motor moment of the rigid mechanism": abs(rigid(np.arange(0, T_END, DT))[2]).max(),
        "steps": {f"dt {dt:g}": audit(*run) for dt, run in runs.items()},
        "nearly rigid": nearly_rigid(),
    }
    return numbers, (*runs[DT],)


def report(numbers):
    run = numbers["steps"][f"dt {DT:g}"]
    error = run["relative balance error"] * run["largest energy"]
    print(
        f"The rod bends by up to {1e3 * run['largest deflection of the rod']:.2f} mm. This moves "
        f"the slider by up to {1e3 * run['slider off the rigid mechanism']:.2f} mm from its place "
        f"in the rigid mechanism.\nThe motor's work is {run['work at the end']:.4f} J. The energy "
        f"of the mechanism is the same to {error:.0e} J: the time scheme loses and gains none."
    )


def draw(results, solution, joints):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene()[0], results / "scene.png", dimensions=True)
    t = solution.t
    turn = round(PERIOD / DT)
    last = range(len(t) - 1 - turn, len(t) - 1, turn // 8)
    plot.shapes(solution, results / "shapes.png", rows=last)
    middle = solution.beams["rod"].node(0.5)
    two = range(len(t) - 1 - 2 * turn, len(t))
    plot.animate(solution, results / "motion.gif", rows=two[::4], trace=middle, colour="M")
    thumbnail.card(solution, two[::4], results / "thumbnail.png")

    x, velocity, moment = rigid(t)
    grey = {"color": "0.6", "linewidth": 2.4, "label": "rigid mechanism, exact"}
    blue = {"color": "#0072B2", "linewidth": 1.2}
    window = (T_END - 3 * PERIOD, T_END)
    motion = slider(solution)

    figure, axes = plot.figure(3, 1)
    position, speed, off = axes.flat
    for ax, exact, value in ((position, x, motion[0]), (speed, velocity, motion[1])):
        ax.plot(t, exact, **grey)
        ax.plot(t, value, **blue, label="flexible mechanism")
        ax.set(xlim=window)
    position.set(ylabel="slider $x$ [m]")
    speed.set(ylabel="slider $\\dot x$ [m/s]")
    off.plot(t, 1e3 * (motion[0] - x), **blue)
    off.set(xlim=(0, T_END), ylabel="$x - x_{rigid}$ [mm]")
    for ax in axes.flat:
        ax.set(xlabel="time $t$ [s]")
    position.set_title(f"$\\Delta t$ = {DT:g} s")
    plot.save(figure, results / "slider.png")

    figure, axes = plot.figure(3, 1)
    bending, motor, energy = axes.flat
    bending.plot(t, 1e3 * deflection(solution), **blue)
    bending.set(xlim=(0, T_END), ylabel="deflection of the rod $w$ [mm]")
    motor.plot(t, moment, **grey)
    motor.plot(
        solution.t_level[1:],
        motor_moment(solution, joints)[1:],
        **blue,
        label="flexible mechanism",
    )
    motor.set(xlim=window, ylabel="motor moment $M$ [N m]")
    energy.plot(t, solution.energy.total, **blue)
    rings = {"markerfacecolor": "none", "markersize": 4}
    work = motor_work(solution, joints)
    energy.plot(t[::12], work[::12], "o", color="#D55E00", label="work of the motor", **rings)
    energy.set(xlim=(0, T_END), ylabel="total energy $E$ [J]")
    for ax in axes.flat:
        ax.set(xlabel="time $t$ [s]")
    bending.set_title(f"$\\Delta t$ = {DT:g} s")
    plot.save(figure, results / "rod_motor_energy.png")


if __name__ == "__main__":
    script.run()
