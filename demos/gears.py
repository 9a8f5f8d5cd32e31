r"""Two gears that touch with the flanks of their teeth.

A pinion with 18 teeth drives a wheel with 27 against a brake. The outlines of both are closed beams
whose nodes are fixed to bodies, so that the pair has one unknown besides the motor's angle.
Objective: how closely contact of two outlines, and nothing else, keeps the ratio of a pair of gears
with involute teeth, and what happens when the direction changes.

Reference: the law of gearing. Flanks that are involutes of the base circles touch on a line that is
common to both circles, and transmit the speed with the constant ratio $z_1/z_2$, at any distance of
the axes. With a distance that is larger by $d$ than the sum of the pitch circles, the play between
the flanks, at the pressure angle $\alpha$, is $2 d \tan\alpha$ along the pitch circle, less the
skins of both outlines: when the motor turns back, the wheel stands still until the play is passed.
The outline has points on the involutes, with lines between the points, and round corners: its
errors fall with the number of points. Units are metre, kilogram and second.
"""

import logging

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

MODULE, ALPHA = 4e-3, np.radians(20.0)  # m [m], pressure angle
TEETH = 18, 27
APART, SKIN = 3e-4, 2e-5  # d, and half thicknesses of the outlines [m]
STIFFNESS = 1e9  # of the contact [N/m²]
RIGID = fb.Section(EA=1e6, GA=1e6, EI=1e2)  # no unknown depends on it
BRAKE = 0.05  # on the wheel [N m s]
SPEED, RAMP, BACK = 8.0, 0.1, 0.5  # of the motor [rad/s], its start [s], where it turns back [s]
DT, T_END = 2e-4, 1.0  # [s]
POINTS = 4, 8, 16  # on each flank
PLAY = 2 * APART * np.tan(ALPHA)


def outline(z, points):
    """Points (n, 2) around a gear with z teeth, the first tooth on the x axis; closed."""
    pitch = MODULE * z / 2
    base, tip, root = pitch * np.cos(ALPHA), pitch + MODULE, pitch - 1.25 * MODULE
    radii = np.linspace(max(base, root), tip, points)

    def involute(angle):
        return np.tan(angle) - angle

    # Half of the angle of a tooth at each radius.
    half = np.pi / (2 * z) + involute(ALPHA) - involute(np.arccos(np.minimum(base / radii, 1)))
    foot = half[0] + 0.02
    r = np.concatenate([[root], radii, radii[::-1], [root]])
    angles = np.concatenate([[-foot], -half, half[::-1], [foot]])
    every = angles + 2 * np.pi * np.arange(z)[:, None] / z
    rim = np.stack([r * np.cos(every), r * np.sin(every)], axis=-1).reshape(-1, 2)
    return np.concatenate([rim, rim[:1]])


def gear(scene, name, x, turn, z, points, inertia):
    """A body that can turn about (x, 0), and the outline that it carries."""
    c, s = np.cos(turn), np.sin(turn)
    xy = outline(z, points) @ np.array([[c, s], [-s, c]]) + (x, 0)
    body = scene.add_body((x, 0.0), mass=1.0, inertia=inertia, name=name)
    rim = scene.add_beam([*map(tuple, xy)], RIGID, elements=len(xy) - 1, name=f"rim of the {name}")
    for node in rim.nodes:
        scene.add_joint(fb.Rigid(body.centre, node, offset=(node.x - x, node.y)))
    return body, rim


def motor(t):
    """Angle of the pinion: it starts smoothly, and turns back."""

    def path(t):
        s = min(t / RAMP, 1.0)
        return SPEED * (RAMP * (s**3 - s**4 / 2) + max(t - RAMP, 0.0))

    return path(t) - 2 * path(max(t - BACK, 0.0))


def scene(points=POINTS[1]):
    """The pair, and its bodies."""
    pair, (z1, z2) = fb.Scene(), TEETH
    pinion, first = gear(pair, "pinion", 0.0, 0.0, z1, points, 1e-4)
    distance = MODULE * (z1 + z2) / 2 + APART
    wheel, second = gear(pair, "wheel", distance, np.pi + np.pi / z2, z2, points, 5e-4)
    pair.add_joint(fb.Revolute(fb.GROUND, pinion.centre, motor=motor))
    pair.add_joint(fb.Revolute(fb.GROUND, wheel.centre, damper=fb.Damper(BRAKE)))
    pair.add_contact(first, second, stiffness=STIFFNESS, radius=SKIN)
    return pair, pinion, wheel


def lag(motion, pinion, wheel):
    """How far the wheel is from the angle by the ratio of the teeth [rad]."""
    pinion_angle, wheel_angle = (motion.rotation(body.centre) for body in (pinion, wheel))
    return wheel_angle + pinion_angle * TEETH[0] / TEETH[1]


def compute(dt=DT):
    """The numbers, and what is drawn."""
    numbers, runs = {}, {}
    for points in POINTS:
        log.info("%d points on a flank", points)
        pair, *bodies = scene(points)
        motion = fb.simulate(pair, dt=dt, t_end=T_END)
        apart = lag(motion, *bodies)
        runs[points] = motion, apart, bodies
        driving = [(motion.t > a) & (motion.t < b) for a, b in ((0.2, BACK), (0.75, T_END))]
        forth, back = (apart[rows] for rows in driving)
        pitch = MODULE * TEETH[1] / 2
        numbers[str(points)] = {
            "unknowns": motion.stats.unknowns,
            "nodes": len(motion.X),
            "wheel from the ratio": float(max(np.ptp(forth), np.ptp(back))) * pitch,
            "play": float(forth.mean() - back.mean()) * pitch,
            "energy balance": float(
                abs(motion.energy.balance_error).max() / motion.energy.dissipated[-1]
            ),
            "seconds": motion.stats.seconds,
        }
    numbers["play by theory"] = PLAY - 4 * SKIN / np.cos(ALPHA)
    return numbers, (runs,)


def report(numbers):
    exact = numbers["play by theory"]
    for points in map(str, POINTS):
        own = numbers[points]
        print(
            f"{points:>2} points on a flank, {own['nodes']} nodes, {own['unknowns']} unknown: the "
            f"wheel stays within {1e6 * own['wheel from the ratio']:.1f} um of the ratio, at its "
            f"pitch circle; play {1e6 * own['play']:.1f} um (theory {1e6 * exact:.1f}); energy "
            f"balance {own['energy balance']:.0e}; {own['seconds']:.1f} s"
        )


def draw(results, runs):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    motion, _, _ = runs[POINTS[-1]]
    plot.scene(scene(POINTS[-1])[0], results / "scene.png")
    turning = range(*np.searchsorted(motion.t, (0.2, 0.2872)))  # two teeth
    plot.animate(motion, results / "motion.gif", rows=turning[::4])
    thumbnail.card(motion, turning, results / "thumbnail.png", scale=0.6)
    figure, axes = plot.figure(1, 1, height=3.2)
    (ax,) = axes.flat
    for points, (motion, apart, _) in runs.items():
        ax.plot(motion.t, 1e6 * apart * MODULE * TEETH[1] / 2, lw=1, label=f"{points} points")
    ax.set(xlabel="time $t$ [s]", ylabel="wheel from the ratio, at its pitch circle [um]")
    plot.save(figure, results / "ratio.png")


if __name__ == "__main__":
    script.run()
