r"""A mass that rolls over a simply supported beam, against the series solution.

A mass $M$ enters a beam at one support and rolls to the other at the speed $v$, as a vehicle over a
bridge. Its weight and its inertia bend the beam, most after it has passed the middle. Objective:
the deflection under the mass for three speeds, compared with the classical series; the energy,
which is conserved to round-off while the mass moves from element to element; and the force between
mass and beam.

The classical solution, for example in L. Fryba, Vibration of Solids and Structures under Moving
Loads (1999), is for small deflections and a constant speed. With the modes $\sin(n \pi x/L)$, the
frequencies $\omega_n = (n \pi/L)^2 \sqrt{EI/m}$ and the place $x = v t$ of the mass, the deflection
$w = \sum q_n(t) \sin(n \pi x/L)$, positive downwards, follows from

$$
\begin{aligned}
\frac{m L}{2} (\ddot q_n + \omega_n^2 q_n) &=
\sin(n \Omega t)\,M \left(g - \frac{D^2 w}{D t^2}\right), \qquad \Omega = \frac{\pi v}{L}, \\
\frac{D^2 w}{D t^2} &= \sum \left((\ddot q_n - n^2 \Omega^2 q_n) \sin(n \Omega t)
+ 2 n \Omega \dot q_n \cos(n \Omega t)\right).
\end{aligned}
$$

The equations are integrated by scipy with a tolerance of 1e-8. For the force $M g$ alone
$D^2 w/D t^2$ is left out, and the sum has a closed form with $a = \Omega/\omega_1$:

$$
q_n = \frac{2 M g L^3}{\pi^4 EI}\,
\frac{\sin(n \Omega t) - (n \Omega/\omega_n) \sin(\omega_n t)}{n^2 (n^2 - a^2)}.
$$

Here the mass rolls freely: it is the end of a short post, whose section does not turn, on a
`Slider`. The beam has shear stiffness so large that it is Euler's. Units are metre, kilogram and
second.
"""

import functools
import logging

import numpy as np
from scipy.integrate import solve_ivp

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

LENGTH, PER_LENGTH, EI = 10.0, 100.0, 1.0e7  # L [m], m [kg/m], [N m²]
BEAM = fb.Section(EA=1e10, GA=1e10, EI=EI, rhoA=PER_LENGTH)
POST = fb.Section(EA=1e8, GA=1e8, EI=1e8)  # without mass
MASS, GRAVITY = 250.0, 9.81  # M [kg], [m/s²]: a quarter of the beam's mass
FIRST = (np.pi / LENGTH) ** 2 * np.sqrt(EI / PER_LENGTH)  # w_1 [rad/s]
SPEEDS = {f"a = {a}": a * FIRST * LENGTH / np.pi for a in (0.1, 0.25, 0.5)}  # v [m/s]
STATIC = MASS * GRAVITY * LENGTH**3 / (48 * EI)  # deflection by the weight in the middle [m]
MODES, STEPS = 16, 400
MESHES = ((1, 10), (1, 20), (1, 40), (2, 10), (2, 20), (3, 10))  # degrees and elements
SHOWN = (2, 20)


def scene(speed, degree=SHOWN[0], elements=SHOWN[1], section=BEAM, height=0.5):
    """The beam and the mass at its left support, with the joint between them."""
    bridge = fb.Scene()
    beam = bridge.add_beam([(0, 0), (LENGTH, 0)], section, elements, degree, name="beam")
    bridge.pin(beam.start)
    bridge.fix(beam.end, "y")
    post = bridge.add_beam([(0, 0), (0, height)], POST, degree=degree, name="post", elements=1)
    bridge.fix(post.end, "rotation")
    bridge.add_mass(post.start, MASS)
    bridge.add_force(post.start, (0.0, -MASS * GRAVITY))
    bridge.set_velocity(post, (speed, 0.0))
    return bridge, bridge.add_joint(fb.Slider(beam, post.start))


def simulate(speed, degree=SHOWN[0], elements=SHOWN[1], steps=STEPS):
    """The solution up to 99 % of the way, and the joint."""
    bridge, joint = scene(speed, degree, elements)
    t_end = duration(speed)
    return fb.simulate(bridge, dt=t_end / steps, t_end=t_end), joint


def duration(speed):
    """Time for 99 % of the way [s]."""
    return 0.99 * LENGTH / speed


@functools.cache
def series(speed, steps=STEPS, mass=MASS):
    """Deflection under the mass in all steps; a mass of 0 stands for the force $M g$ alone."""
    t = np.linspace(0, duration(speed), steps + 1)
    n = np.arange(1, MODES + 1)
    frequency, wave = FIRST * n**2, n * np.pi / LENGTH
    modal = PER_LENGTH * LENGTH / 2

    def rates(t, state):
        q, rate = state.reshape(2, -1)
        sine, cosine = np.sin(wave * speed * t), np.cos(wave * speed * t)
        carried = 2 * speed * wave * cosine @ rate - (speed * wave) ** 2 * sine @ q
        free = -(frequency**2) * q
        # The force F on the beam: F = M g - M (sine . q'' + carried), q'' = free + sine F / modal.
        force = MASS * GRAVITY - mass * (sine @ free + carried)
        force /= 1 + mass * sine @ sine / modal
        return np.concatenate([rate, free + sine * force / modal])

    motion = solve_ivp(
        rates, (0, t[-1]), np.zeros(2 * MODES), "DOP853", t, rtol=1e-6, atol=1e-8 * STATIC
    )
    return np.sum(np.sin(np.outer(wave, speed * t)) * motion.y[:MODES], axis=0)


def closed_series(speed, t):
    """Deflections under the force $M g$ alone, by the closed form."""
    n = np.arange(1, MODES + 1)[:, None]
    W = np.pi * speed / LENGTH
    a = W / FIRST
    amplitude = 2 * MASS * GRAVITY * LENGTH**3 / (np.pi**4 * EI) / (n**2 * (n**2 - a**2))
    q = amplitude * (np.sin(n * W * t) - a / n * np.sin(FIRST * n**2 * t))
    return np.sum(q * np.sin(n * W * t), axis=0)


def audit(solution, joint, speed):
    """Numbers by which a run is assessed."""
    energy, sag = solution.energy, deflection(solution, joint)
    exact = series(speed)
    return {
        "error of the deflection": abs(sag - exact).max() / exact.max(),
        "deflection / static": sag.max() / STATIC,
        "of the force alone": closed_series(speed, solution.t).max() / STATIC,
        "largest force / weight": solution.joint(joint).force[:, 1].max() / (MASS * GRAVITY),
        "balance error": abs(energy.balance_error).max() / energy.total.max(),
        "largest gap": solution.joint(joint).gap.max(),
        "iterations per step": solution.stats.newton_iterations / solution.stats.steps,
    }


def deflection(solution, joint):
    """Deflection (n,) under the mass, positive downwards [m]."""
    return -solution.displacement(joint.b)[:, 1]


def compute():
    """The numbers, and what is drawn."""
    runs = {}
    for name, speed in SPEEDS.items():
        log.info("%s, %.3g m/s", name, speed)
        runs[name] = simulate(speed)
    middle = SPEEDS["a = 0.25"]
    numbers = {
        "speeds": {name: audit(*run, SPEEDS[name]) for name, run in runs.items()},
        "meshes": {
            f"degree {degree}, {elements} elements": audit(
                *simulate(middle, degree, elements), middle
            )["error of the deflection"]
            for degree, elements in MESHES
        },
    }
    return numbers, (runs,)


def report(numbers):
    row = "{:>9} {:>11} {:>11} {:>11} {:>9} {:>10} {:>10}".format
    print(row("v/v_1", "deflection", "of force", "error by", "force", "energy", "gap"))
    print(row("", "/static", "alone", "series", "/weight", "balance", "[m]"))
    for name, run in numbers["speeds"].items():
        values = (
            name.removeprefix("a = "),
            f"{run['deflection / static']:.4f}",
            f"{run['of the force alone']:.4f}",
            f"{run['error of the deflection']:.1e}",
            f"{run['largest force / weight']:.3f}",
            f"{run['balance error']:.0e}",
            f"{run['largest gap']:.0e}",
        )
        print(row(*values))
    print("\nErrors for v/v_1 = 0.25:")
    for name, error in numbers["meshes"].items():
        print(f"{name:>22} {error:.1e}")


def draw(results, runs):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene(SPEEDS["a = 0.25"])[0], results / "scene.png")
    figure, axes = plot.figure(2, 1)
    sag, force = axes.flat
    colours = "#0072B2", "#D55E00", "#009E73"
    for (name, (solution, joint)), colour in zip(runs.items(), colours, strict=True):
        place = solution.joint(joint).slide / LENGTH
        exact = series(SPEEDS[name]) / STATIC
        sag.plot(place, exact, color=colour, linewidth=2.8, alpha=0.35)
        sag.plot(
            place, deflection(solution, joint) / STATIC, color=colour, linewidth=1.0, label=name
        )
        weight = solution.joint(joint).force[1:, 1] / (MASS * GRAVITY)
        force.plot(place[1:], weight, color=colour, linewidth=1.0)
    sag.set(ylabel="deflection under the mass / static")
    sag.invert_yaxis()
    force.set(ylabel="force on the mass / weight")
    for ax in axes.flat:
        ax.set(xlabel="place of the mass $s/L$", xlim=(0, 1))
    sag.set_title("$a = v/v_1$; broad lines: series")
    plot.save(figure, results / "deflection_and_force.png")
    # The motion of a beam that is 200 times as soft, so that its deflection is seen.
    soft = fb.Section(EA=BEAM.EA, GA=BEAM.GA, EI=EI / 200, rhoA=PER_LENGTH)
    bridge, joint = scene(SPEEDS["a = 0.5"] / 200**0.5, section=soft, height=2.0)
    t_end = duration(SPEEDS["a = 0.5"]) * 200**0.5
    solution = fb.simulate(bridge, dt=t_end / STEPS, t_end=0.9 * t_end)
    plot.animate(solution, results / "motion.gif", rows=range(0, len(solution.t), 6), trace=joint.b)
    thumbnail.card(solution, range(0, len(solution.t), 6), results / "thumbnail.png")


if __name__ == "__main__":
    script.run()
