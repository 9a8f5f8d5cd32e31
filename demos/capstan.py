r"""A capstan: friction holds a rope that is wound around a fixed drum.

A thin rope lies on a fixed drum over an angle $\varphi$. A constant force $T_2$ tightens its left
end while the other one is held; then that end is pulled slowly, until the whole rope slides.
Objective: the force $T_1$ of the pull, which is $T_2 \exp(\mu\varphi)$ while the rope slides (Euler
1769, Eytelwein 1808), and the tension along the rope before it slides.

While $T_2$ is raised the rope creeps to the left everywhere, and the held end carries
$T_2 \exp(-\mu\varphi)$. Then a part of the rope at the pulled end slides to the right, where the
tension falls by $\exp(-\mu\theta)$ from $T_1$ on, over the angle $\theta$ from that end. The rest
still has the tension of the beginning. The part grows until it reaches the left end.

The rope is a beam with little bending stiffness that touches the drum at three Gauss points in each
element. Its friction is `fx_beam.Coulomb`, which sticks: at each point a stiff tangential spring
holds, up to $\mu$ times the normal force. A weak drag takes the vibration of the free ends; it and
the inertia of the rope change $T_1$ by parts in ten thousand, in proportion to the speed of the
pull.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

RADIUS, LEG = 1.0, 0.5  # of the drum; length of rope beside it
T2 = 1.0
SECTION = fb.Section(EA=1e4, GA=1e4, EI=1e-4, rhoA=0.01, rhoI=1e-6)
STIFFNESS = 1e6  # of the drum and of its friction, per length
GAP = 2e-6  # between rope and drum at the start
DRAG = 0.2
ELEMENTS, DEGREE, POINTS = 30, 2, 3  # for half a turn; Gauss points in an element
RAMP, SPEED = 0.5, 5e-4  # time in which T2 grows; speed of the pull afterwards
DT, T_END = 0.01, 5.0
# Coefficients of friction, and angles.
CASES = ((0.1, np.pi), (0.3, np.pi / 2), (0.3, np.pi), (0.6, np.pi))
SHOWN = (0.3, np.pi)
SLOW = 1 / 4  # a slower pull, relative to the speed


def scene(mu=SHOWN[0], phi=SHOWN[1], speed=SPEED):
    """The rope on the drum, and the node that is pulled."""
    made, around = fb.Scene(), RADIUS + GAP
    left, right = (around * np.array([np.cos(a), np.sin(a)]) for a in (phi, 0.0))
    away = np.array([-np.sin(phi), np.cos(phi)])  # along the rope, at its left end

    def on_drum(fraction):
        angle = phi * (1 - fraction)
        return around * np.cos(angle), around * np.sin(angle)

    count = round(ELEMENTS * phi / np.pi)
    rope = made.add_beam(fb.Curve(on_drum), SECTION, count, DEGREE, name="rope")
    held = made.add_beam([tuple(left + LEG * away), rope.start], SECTION, 4, DEGREE, "left")
    pulled = made.add_beam([rope.end, tuple(right - (0, LEG))], SECTION, 4, DEGREE, "right")
    made.add_force(held.start, lambda t: tuple(T2 * away * min(t / RAMP, 1.0)))
    made.fix(pulled.end, "x", "rotation")
    made.prescribe(pulled.end, y=lambda t: -speed * max(t - RAMP, 0.0))
    for part in (rope, held, pulled):
        made.add_drag(part, linear=DRAG, rotation=DRAG * 1e-3)
    made.add_contact(
        rope,
        fb.Circle((0, 0), RADIUS),
        stiffness=STIFFNESS,
        friction=fb.Coulomb(mu, STIFFNESS),
        along=POINTS,
    )
    return made, rope, pulled.end


def pull(mu, phi, speed=SPEED):
    """The motion, its rope, and the force of the pull over T2."""
    made, rope, end = scene(mu, phi, speed)
    t_end = RAMP + (T_END - RAMP) * SPEED / speed
    dt = DT * SPEED / speed
    motion = fb.simulate(made, dt=dt, t_end=t_end)
    return motion, rope, -motion.reaction(end)[:, 1] / T2


def tension(theta, ratio, mu, phi):
    """Tension over T2 by the angle from the left end, for a pull that is `ratio` times T2."""
    return np.maximum(np.exp(-mu * theta), ratio * np.exp(-mu * (phi - theta)))


def mean_end(values):
    """Mean over the last tenth of a motion, when the rope slides."""
    return float(values[-len(values) // 10 :].mean())


def along_rope(motion, rope, phi, rows):
    """Angles from the left end, and tensions over T2, at Gauss points in some rows."""
    resultants = motion.resultants(rope)
    return resultants.s / rope.length * phi, resultants.N[rows] / T2


def compute():
    """The numbers, and what is drawn."""
    numbers, runs = {"cases": {}}, {}
    for mu, phi in CASES:
        log.info("mu = %g, %g degrees", mu, np.degrees(phi))
        motion, rope, ratio = runs[mu, phi] = pull(mu, phi)
        exact = np.exp(mu * phi)
        held = int(np.searchsorted(motion.t, RAMP))
        numbers["cases"][f"mu = {mu:g}, {np.degrees(phi):g} degrees"] = {
            "T1 / T2": mean_end(ratio),
            "exp(mu phi)": exact,
            "difference": mean_end(ratio) / exact - 1,
            "held end / T2": float(ratio[held]),
            "energy balance": float(
                abs(motion.energy.balance_error).max() / motion.energy.dissipated[-1]
            ),
        }
    mu, phi = SHOWN
    motion, rope, ratio = runs[SHOWN]
    slow = mean_end(pull(mu, phi, SLOW * SPEED)[2]) / np.exp(mu * phi) - 1
    numbers["difference with a slower pull"] = slow
    rows = rows_shown(ratio)
    angle, pulls = along_rope(motion, rope, phi, rows)
    exact = np.array([tension(angle, ratio[row], mu, phi) for row in rows])
    numbers["largest difference of the tension along the rope, over T2"] = float(
        abs(pulls - exact).max()
    )
    return numbers, (runs,)


def rows_shown(ratio):
    """Rows of a motion before and while the rope slides."""
    end = np.exp(SHOWN[0] * SHOWN[1])
    return [int(np.argmax(ratio >= part)) for part in (0.5, 0.8, 1.4, 2.0)] + [
        int(np.argmax(ratio >= 0.999 * end))
    ]


def report(numbers):
    for name, case in numbers["cases"].items():
        print(
            f"{name}: T1/T2 = {case['T1 / T2']:.4f}, exp(mu phi) = {case['exp(mu phi)']:.4f} "
            f"({case['difference']:+.1e}); held end at first {case['held end / T2']:.3f}; "
            f"energy balance {case['energy balance']:.0e}"
        )
    slow = numbers["difference with a slower pull"]
    difference = numbers["largest difference of the tension along the rope, over T2"]
    print(
        f"With a quarter of the speed T1 differs by {slow:+.1e}\n"
        f"Tension along the rope: within {difference:.1e} T2 of the theory"
    )


def draw(results, runs):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene()[0], results / "scene.png")
    pulled = runs[SHOWN][0]
    plot.animate(pulled, results / "motion.gif")
    thumbnail.card(pulled, range(len(pulled.t)), results / "thumbnail.png")
    figure, axes = plot.figure(1, 2, height=3.4)
    force, tension_axes = axes.flat
    for n, ((mu, phi), (motion, _, ratio)) in enumerate(runs.items()):
        moved = 1e3 * SPEED * np.maximum(motion.t - RAMP, 0)
        label = rf"$\mu = {mu:g}$, {np.degrees(phi):g}°"
        force.plot(moved, ratio, color=f"C{n}", label=label)
        force.axhline(np.exp(mu * phi), color=f"C{n}", ls=":", lw=1)
    force.plot([], [], "k:", lw=1, label=r"$\exp(\mu\varphi)$")
    force.set(xlabel="pulled length [mm]", ylabel="$T_1/T_2$", ylim=(0, None))
    mu, phi = SHOWN
    motion, rope, ratio = runs[SHOWN]
    rows = rows_shown(ratio)
    angle, pulls = along_rope(motion, rope, phi, rows)
    fine = np.linspace(0, phi, 400)
    for row, values in zip(rows, pulls, strict=True):
        tension_axes.plot(np.degrees(angle), values, ".", color="#0072B2", markersize=4)
        tension_axes.plot(np.degrees(fine), tension(fine, ratio[row], mu, phi), "k-", lw=0.8)
    tension_axes.plot([], [], ".", color="#0072B2", label="computed")
    tension_axes.plot([], [], "k-", lw=0.8, label="theory")
    tension_axes.set(xlabel="angle from the left end [degrees]", ylabel="tension over $T_2$")
    plot.save(figure, results / "pull_and_tension.png")


if __name__ == "__main__":
    script.run()
