r"""A soft gripper: two fingers bend, hold a disc by friction and lift it.

Two strips hang from a palm. Their natural curvature grows, as that of a pneumatic finger or of a
bimetal does, and presses them against a disc between them. Then the palm moves up. Objective: the
least coefficient of friction with which the disc is lifted.

The disc has the weight $m g$ and the acceleration $a$. Each of the two fingers presses it with the
same normal force $N$, at the angle $b$ above the horizontal, and the same tangential force $T$:

$$ 2 (N \sin b + T \cos b) = m (g + a) $$

A finger holds while $T < \mu N$. So the largest $T/N$ in a lift with much friction is the least
$\mu$ with which the disc should be lifted. It is compared with the least $\mu$ that is found by
trying.

For small rotations a strip with the natural curvature $K$, clamped at a distance $L$ from the disc
that keeps it $d$ away from where it would touch without curvature, presses with

$$ N = \frac{3 EI}{L^3} \left(\frac{K L^2}{2} - d\right) $$

The fingers touch at two Gauss points in each element, with half their thickness; their friction,
`fx_beam.Coulomb`, sticks. A drag damps the vibration of the fingers.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

HEIGHT, WIDTH = 4e-3, 20e-3  # of a finger
SECTION = fb.Section.rectangle(height=HEIGHT, width=WIDTH, E=1e9, rho=1200.0)
LENGTH, REACH = 0.3, 0.225  # of a finger; from the palm to the middle of the disc
RADIUS, MASS = 0.05, 0.05  # of the disc
APART = 0.002  # between finger and disc at the start
STIFFNESS = 4e5  # of contact and of its friction, per length
ELEMENTS, DEGREE = 12, 2
CURVATURE, GRAVITY = 1.0, 9.81
BEND, LIFT, T_END = 0.5, (1.0, 2.0), 3.0  # end of bending; start and end of the lift
RISE = 0.1
DRAG = (0.0, 5.0)  # along and across a finger
DT = 2e-3
FRICTION = 0.8
TRIED = (0.2, 0.5)  # one that is too small and one that is large enough
TRIALS = 7


def rise(t):
    """Height of the palm, with an acceleration that does not jump."""
    start, end = LIFT
    part = min(max((t - start) / (end - start), 0.0), 1.0)
    return RISE * (part - np.sin(2 * np.pi * part) / (2 * np.pi))


def scene(mu=FRICTION):
    """The gripper, the middle of the disc and the contacts of the fingers."""
    made = fb.Scene(gravity=(0, -GRAVITY))
    half = RADIUS + HEIGHT / 2 + APART
    roots = {"left": (-half, 0), "right": (half, 0)}
    palm = made.add_body((0, 0), mass=0.1, inertia=1e-3, points=roots, name="palm")
    made.prescribe(palm.centre, x=0.0, y=rise, rotation=0.0)
    inertia = MASS * RADIUS**2 / 2
    disc = made.add_body((0, -REACH), mass=MASS, inertia=inertia, name="disc").centre
    friction, grips = fb.Coulomb(mu, STIFFNESS), []
    for side, (name, (x, _)) in zip((1, -1), roots.items(), strict=True):
        line = [(x, 0), (x, -LENGTH)]
        finger = made.add_beam(line, SECTION, ELEMENTS, DEGREE, name=name)
        made.add_joint(fb.Rigid(palm[name], finger.start))
        made.add_natural_strain(
            finger, curvature=lambda t, side=side: side * CURVATURE * min(t / BEND, 1.0)
        )
        made.add_drag(finger, linear=DRAG)
        grips.append(
            made.add_contact(
                finger,
                fb.Circle(disc, RADIUS),
                stiffness=STIFFNESS,
                friction=friction,
                radius=HEIGHT / 2,
                along=2,
            )
        )
    table = fb.Line((0, -REACH - RADIUS), normal=(0, 1))
    made.add_contact(disc, table, stiffness=2e4, radius=RADIUS)
    return made, disc, grips


def lifted(mu=FRICTION):
    """The motion with a coefficient of friction, the disc and the contacts."""
    made, disc, grips = scene(mu)
    return fb.simulate(made, dt=DT, t_end=T_END), disc, grips


def slips(mu):
    """Whether the disc is left behind."""
    motion, disc, _ = lifted(mu)
    return bool(motion.displacement(disc)[-1, 1] < RISE / 2)


def least_friction():
    """The least friction that lifts the disc, by bisection: the mean of the last two trials."""
    low, high = TRIED
    assert slips(low) and not slips(high)
    for _ in range(TRIALS):
        middle = (low + high) / 2
        low, high = (middle, high) if slips(middle) else (low, middle)
    return (low + high) / 2, high - low


def needed(motion, grips):
    """Tangential over normal force of both fingers, over time; zero on the table."""
    parts = [motion.contact(grip) for grip in grips]
    normal = sum(part.normal.sum(axis=1) for part in parts)
    rubbing = sum(abs(part.tangential.sum(axis=1)) for part in parts)
    ratio = np.divide(rubbing, normal, where=normal > 0, out=np.zeros_like(normal))
    return np.where(motion.t >= LIFT[0], ratio, 0.0), normal / 2


def compute():
    """The numbers, and what is drawn."""
    motion, disc, grips = lifted()
    ratio, normal = needed(motion, grips)
    rest = motion.t > LIFT[1] + 0.8 * (T_END - LIFT[1])
    disc_force = -sum(motion.contact(grip).force.sum(axis=1) for grip in grips)
    log.info("trials with less friction")
    least, width = least_friction()
    numbers = {
        "normal force of a finger": float(normal[rest].mean()),
        "the same for small rotations": 3
        * SECTION.EI
        * (CURVATURE * REACH**2 / 2 - APART)
        / REACH**3,
        "weight": MASS * GRAVITY,
        "force of the fingers at rest": float(disc_force[rest, 1].mean()),
        "rise of the disc": float(motion.displacement(disc)[-1, 1]),
        "least friction, by the forces": float(ratio.max()),
        "least friction, by trials": least,
        "between two trials": width,
        "energy balance": float(abs(motion.energy.balance_error).max() / motion.energy.work[-1]),
    }
    return numbers, (motion, disc, grips, lifted(0.9 * least)[0])


def report(numbers):
    print(
        f"Normal force of a finger: {numbers['normal force of a finger']:.3f} N; "
        f"{numbers['the same for small rotations']:.3f} N for small rotations\n"
        f"The disc is lifted by {1e3 * numbers['rise of the disc']:.2f} mm; at rest the fingers "
        f"carry {numbers['force of the fingers at rest']:.4f} N, its weight is "
        f"{numbers['weight']:.4f} N\n"
        f"Least friction: {numbers['least friction, by the forces']:.4f} by the forces, "
        f"{numbers['least friction, by trials']:.4f} by trials that are "
        f"{numbers['between two trials']:.4f} apart\n"
        f"Energy balance: {numbers['energy balance']:.0e} of the work"
    )


def draw(results, motion, disc, grips, left_behind):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene()[0], results / "scene.png")
    rows = [int(t / DT) for t in (0.0, LIFT[0], T_END)]
    plot.shapes(motion, results / "shapes.png", rows=rows)
    plot.animate(motion, results / "motion.gif", rows=range(0, len(motion.t), 15))
    thumbnail.card(motion, range(0, len(motion.t), 30), results / "thumbnail.png")
    figure, axes = plot.figure(1, 2, height=3.0)
    heights, ratio = axes.flat
    shown = ((motion, f"$\\mu = {FRICTION:g}$"), (left_behind, "friction too low"))
    for run, label in shown:
        heights.plot(run.t, 1e3 * run.displacement(disc)[:, 1], label=label)
    heights.plot(motion.t, [1e3 * rise(t) for t in motion.t], "k:", lw=1, label="palm")
    heights.set(xlabel="time $t$ [s]", ylabel="rise of the disc [mm]")
    needs, normal = needed(motion, grips)
    ratio.plot(motion.t, needs, color="C2", label="tangential over normal force")
    ratio.plot(motion.t, normal, color="C3", label="normal force of a finger [N]")
    ratio.set(xlabel="time $t$ [s]")
    plot.save(figure, results / "rise_and_force.png")


if __name__ == "__main__":
    script.run()
