"""Stability on stiff and extreme cases: the energy by several time schemes.

    ./run report stability            some minutes
    ./run report stability --quick    a few cases of each kind
    ./run report stability --jobs 2   on two processes

The scenes are those of the demos, with other constants. A failing step is halved at most 12 times,
the default of `simulate`. The short form has four schemes and repeats no run.
"""

import argparse
import logging
from dataclasses import replace
from functools import partial
from pathlib import Path
from time import perf_counter

import numpy as np
from demo_scenes import ROOT, demo
from scipy.integrate import trapezoid

import fx_beam as fb
from fx_beam_studies import reporting, stability
from fx_beam_studies.reporting import section, table
from fx_beam_studies.stability.cases import grouped
from fx_beam_studies.stability.report import draw_map, draw_summary

Case = stability.Case
SCHEMES = {
    "EnergyMomentum": fb.EnergyMomentum(),
    "EnergyDecaying": fb.EnergyDecaying(),
    "ModifiedMidPoint": fb.ModifiedMidPoint(),
    "MidPoint": fb.MidPoint(),
    "Newmark (trapezoidal)": fb.Newmark(),
    "HHT, alpha = -0.1": fb.HHT(-0.1),
    "Generalized alpha, 0.9": fb.GeneralizedAlpha(0.9),
}
# Those of the short form.
FEW = "EnergyMomentum", "EnergyDecaying", "ModifiedMidPoint", "Newmark (trapezoidal)"
PENDULUM, PINNED, SWING, MULTIBODY = map(
    demo, ("pendulum", "pinned_beam", "three_bar_swing", "multibody")
)
SCAN, WHIP, RING = map(demo, ("damping_scan", "whip_stop", "falling_ring"))
STEPS = 500  # of most runs


# -- Scenes of the demos with other constants ------------------------------------------------------


def changed(name, **constants):
    """A separate copy of a demo's module, with other constants."""
    module = demo.__wrapped__(name)
    unknown = constants.keys() - vars(module).keys()
    assert not unknown, f"demos/{name}.py has no {unknown}"
    vars(module).update(constants)
    return module


def scene_of(name, **constants):
    """Scene of a demo with other constants; SECTION is a dictionary of changed values."""
    if isinstance(constants.get("SECTION"), dict):
        constants["SECTION"] = replace(demo(name).SECTION, **constants["SECTION"])
    return only(changed(name, **constants).scene())


def scene_in(module):
    """A function that makes the scene of a demo; it can be sent to a worker, a module cannot."""
    return partial(scene_of, module.__name__.removeprefix("demo_"))


def only(made):
    """A scene, without the beams or nodes that come with it."""
    return made if isinstance(made, fb.Scene) else made[0]


pendulum, pinned_beam, swing, multibody = (
    partial(scene_of, name) for name in ("pendulum", "pinned_beam", "three_bar_swing", "multibody")
)


def stiff(section, factor):
    """EA and GA times a factor."""
    return {"EA": section.EA * factor, "GA": section.GA * factor}


def soft(section, factor):
    return {"EI": section.EI * factor}


def powers(*exponents):
    """Labels and values of powers of ten."""
    return [(f"1e{k}", 10.0**k) for k in exponents]


def multiple(factor):
    """Label of a factor: 4, or 1/4."""
    return f"{factor:g}" if factor >= 1 else f"1/{1 / factor:g}"


# -- Cases -----------------------------------------------------------------------------------------


def on_pinned_beam(group, label, dt=PINNED.DT, scene=pinned_beam, steps=STEPS, **constants):
    return Case(group, label, partial(scene, **constants), dt, steps * dt)


def on_pendulum(group, label, dt, **constants):
    return Case(group, label, partial(pendulum, **constants), dt, STEPS * dt)


def on_swing(group, label, scene=swing, dt=SWING.DT, **constants):
    return Case(group, label, partial(scene, **constants), dt, SWING.T_END)


# Fraction of the multi-body system's moment for soft members, impacts and jumps: these cases are
# extreme already with it, and need up to some hundred parts of a step.
PART = 1 / 3


def on_multibody(group, label, scene=multibody, dt=MULTIBODY.DT, t_end=2.0, **constants):
    return Case(group, label, partial(scene, **constants), dt, t_end)


# Groups of cases at the demos' steps.
ON_PINNED, ON_SWING, ON_MULTIBODY = (
    f"{name}, dt = {module.DT:g} s: "
    for name, module in (
        ("Pinned beam", PINNED),
        ("Swing", SWING),
        ("Multi-body system", MULTIBODY),
    )
)


def stiffness(quick):
    """Powers of the axial stiffness, with the paper's steps and ten times larger and smaller ones.

    In the pendulum EA goes up to 1e16 / m^2 times EI.
    """
    exponents = (4, 10, 16) if quick else (4, 6, 8, 10, 12, 14, 16, 17, 18, 19)
    for dt in (0.1,) if quick else (1.0, 0.1, 0.01):
        group = f"Pendulum, dt = {dt:g} s: EA [N], EI = {PENDULUM.SECTION.EI:g} N m2"
        for label, EA in powers(*exponents):
            yield on_pendulum(group, label, dt, SECTION={"EA": EA, "GA": EA})
    for dt in (0.01,) if quick else (0.1, 0.01, 0.001):
        group = f"Pinned beam, dt = {dt:g} s: EA and GA over the example's"
        for label, factor in powers(*(0, 6) if quick else range(7)):
            yield on_pinned_beam(group, label, dt, SECTION=stiff(PINNED.SECTION, factor))


def highest_frequency(scene):
    """Highest natural frequency [rad/s] of a scene without massless unknowns at its start."""
    return float(abs(np.linalg.eigvals(fb.linearise(scene).A)).max())


def frequency(quick):
    """Smaller steps, and stiffer beams with the demo's step."""
    own = highest_frequency(pinned_beam())
    for label, product in powers(*(0, 5) if quick else range(-1, 7)):
        dt = min(product / own, PINNED.DT)
        factor = (product / (own * dt)) ** 2
        for _ in range(3):  # nearly proportional to the root of the stiffness
            section = stiff(PINNED.SECTION, factor)
            factor *= (product / dt / highest_frequency(pinned_beam(SECTION=section))) ** 2
        section = stiff(PINNED.SECTION, factor)
        yield on_pinned_beam("Pinned beam: dt times highest frequency", label, dt, SECTION=section)


def heavy_tip(factor):
    """The pinned beam with a mass at its end."""
    scene, beam = PINNED.scene()
    scene.add_mass(beam.end, factor * PINNED.SECTION.rhoA * PINNED.LENGTH)
    return scene


def shared_mass(ratio):
    """The swing with another ratio of the middle mass to the beam's, and the same total mass."""
    section, length = SWING.SECTION, SWING.C[0] - SWING.A[0]
    total = SWING.MASS + section.rhoA * length
    rhoA = total / (1 + ratio) / length
    own = {"rhoA": rhoA, "rhoI": section.rhoI * rhoA / section.rhoA}
    return swing(SECTION=own, MASS=total * ratio / (1 + ratio))


def lumped(every):
    """The pinned beam with its mass lumped at some of its nodes."""
    section = replace(PINNED.SECTION, rhoA=0.0, rhoI=0.0)
    scene, beam = changed("pinned_beam", SECTION=section).scene()
    nodes = beam.nodes[every::every]
    for node in nodes:
        scene.add_mass(node, PINNED.SECTION.rhoA * PINNED.LENGTH / len(nodes))
    return scene


def masses(quick):
    ratios = powers(*(-8, 8) if quick else (-8, -4, 0, 4, 8))
    group = ON_SWING + "mass in the middle over the beam's"
    yield from (on_swing(group, label, shared_mass, ratio=ratio) for label, ratio in ratios)
    group = ON_PINNED + "mass at its end over its own"
    for label, ratio in ratios:
        yield on_pinned_beam(group, label, scene=heavy_tip, factor=ratio)
    if not quick:
        group = ON_SWING + "no inertia of"
        yield on_swing(group, "rotation", SECTION={"rhoI": 0.0})
        yield on_swing(group, "beam", SECTION={"rhoA": 0.0, "rhoI": 0.0})
    group = ON_PINNED + "no rotary inertia, mass in"
    yield on_pinned_beam(group, "beam", SECTION={"rhoI": 0.0})
    if not quick:
        yield on_pinned_beam(group, "every node", scene=lumped, every=1)
    yield on_pinned_beam(group, "every 2nd node", scene=lumped, every=2)


def meshed(section=PINNED.SECTION, **mesh):
    return changed("pinned_beam", SECTION=section).scene(**mesh)[0]


def meshes(quick):
    own = PINNED.SECTION
    for dt in (0.001,) if quick else (0.01, 0.001):
        group = f"Pinned beam, dt = {dt:g} s: slenderness"
        for label, slenderness in powers(*(1, 6) if quick else range(1, 7)):
            radius = PINNED.LENGTH / slenderness  # of gyration; axial stiffness and mass stay
            section = {"EI": own.EA * radius**2, "rhoI": own.rhoA * radius**2}
            yield on_pinned_beam(group, label, dt, SECTION=section)
    for elements in (1, 64) if quick else (1, 2, 64, 2000):
        mesh = {"scene": meshed, "elements": elements, "steps": 200}
        yield on_pinned_beam(ON_PINNED + "elements", str(elements), **mesh)
    dt = 0.001 if quick else PINNED.DT
    for degree, elements in ((3, 3),) if quick else ((2, 4), (3, 3)):
        group = f"Pinned beam, degree {degree}, dt = {dt:g} s: EA and GA over the example's"
        for label, factor in powers(*(6,) if quick else (0, 2, 4, 6)):
            section = replace(own, **stiff(own, factor))
            mesh = {"section": section, "elements": elements, "degree": degree}
            count = 100 if quick else STEPS
            yield on_pinned_beam(group, label, dt, scene=meshed, steps=count, **mesh)
    for label, part in powers(*(-8,) if quick else (-2, -4, -6, -8)):
        mesh = {"elements": (3, 1, 4), "corners": (0, 0.375, 0.375 + part / 8, 1)}
        group = ON_PINNED + "shortest element over others"
        yield on_pinned_beam(group, label, scene=meshed, **mesh)


def spins(quick):
    """Rotations per step up to the limit and above it."""
    dt = PENDULUM.SMALL
    group = f"Pendulum, dt = {dt:g} s: turn in a step [rad]"
    for turn in (1.9, 2.1) if quick else (0.5, 1.0, 1.5, 1.9, 1.99, 2.1, 3.0):
        # The mid-point rule turns by 2 arctan(v dt/(2 L)) in a step.
        speed = 2 * PENDULUM.LENGTH / dt * np.tan(turn / 2)
        yield on_pendulum(group, f"{turn:g}", dt, SPEED=speed)
    for name, factor in (("", 1), (" 1e4 times as stiff", 1e4))[: 1 if quick else 2]:
        section = stiff(PINNED.SECTION, factor) | soft(PINNED.SECTION, factor)
        group = f"Pinned beam{name}, dt = {PINNED.DT:g} s: initial velocity over the example's"
        for times in (4,) if quick else (2, 4, 8, 16, 32, 64):
            velocity = times * PINNED.VELOCITY
            yield on_pinned_beam(group, str(times), SECTION=section, VELOCITY=velocity)


def blow(dt, impulse):
    """A constant force over the first step, as times and values."""
    return (0.0, dt, dt, 2 * dt), (impulse / dt, impulse / dt, 0.0, 0.0)


def struck(impulse):
    """The pinned beam with an impact at its end during the first step."""
    scene, beam = PINNED.scene()
    scene.add_force(beam.end, lambda t: (0.0, np.interp(t, *blow(PINNED.DT, impulse))))
    return scene


def square(t, period=0.2, until=1.0):
    return 0.0 if t >= until else 1.0 if t % period < period / 2 else -1.0


def jumping_moment():
    system, _ = MULTIBODY.scene()
    node, peak = system.beams[0].start, min(MULTIBODY.PULSE[1])
    system.loads.clear()
    system.add_moment(node, lambda t: PART * peak / 2 * square(t))
    return system


def jumping_force():
    scene, beam = PINNED.scene()
    scene.add_force(beam.end, lambda t: (0.0, 1e4 * square(t)))
    return scene


def loads(quick):
    group = "Swing: pulse in one step, dt [ms]"
    for factor in (8,) if quick else (1, 8):
        dt = factor * SWING.DT
        pulse = blow(dt, trapezoid(SWING.PULSE[1], SWING.PULSE[0]))
        yield on_swing(group, f"{1e3 * dt:g}", dt=dt, PULSE=pulse)
    group = ON_PINNED + "blow in one step, momentum over its own"
    own = 75000 / PINNED.LENGTH  # gives the beam as much angular momentum as it has
    for part in (1.0,) if quick else (0.1, 1.0, 10.0):
        yield on_pinned_beam(group, f"{part:g}", scene=struck, impulse=part * own)
    group = ON_MULTIBODY + "part of the pulse, in one step"
    for part in () if quick else (PART / 10, PART):
        pulse = blow(MULTIBODY.DT, part * trapezoid(MULTIBODY.PULSE[1], MULTIBODY.PULSE[0]))
        yield on_multibody(group, f"{part:.1g}", PULSE=pulse)
    group = "Loads that jump every 0.1 s: on"
    yield on_pinned_beam(group, "pinned beam", scene=jumping_force)
    if not quick:
        yield on_multibody(group, "multi body", jumping_moment)


def steps(quick):
    factors = (1, 8) if quick else (1 / 8, 1 / 4, 1 / 2, 1, 2, 4, 8)
    for factor in factors:
        group = f"Swing: dt over {SWING.DT:g} s"
        yield on_swing(group, multiple(factor), dt=factor * SWING.DT)
    for factor in factors:
        group = f"Multi-body system: dt over {MULTIBODY.DT:g} s"
        times = {"dt": factor * MULTIBODY.DT, "t_end": MULTIBODY.T_END}
        yield on_multibody(group, multiple(factor), **times)


def softness(quick):
    factors = powers(*(-8,) if quick else (-2, -4, -6, -8))
    for label, factor in factors:
        section = soft(PINNED.SECTION, factor)
        yield on_pinned_beam(ON_PINNED + "EI over the example's", label, SECTION=section)
    for label, factor in factors:
        yield on_swing(
            ON_SWING + "EI over the example's", label, SECTION=soft(SWING.SECTION, factor)
        )
    times, moments = MULTIBODY.PULSE
    pulse = times, tuple(PART * moment for moment in moments)
    for label, factor in () if quick else factors:
        section = soft(MULTIBODY.SECTION, factor)
        group = ON_MULTIBODY + "a third of the moment, EI over the example's"
        yield on_multibody(group, label, SECTION=section, PULSE=pulse)
    for dt in (0.001,) if quick else (0.01, 0.001):
        group = f"String, EI times 1e-8, dt = {dt:g} s: EA over the example's"
        for label, factor in powers(*(6,) if quick else (0, 2, 4, 6)):
            section = soft(PINNED.SECTION, 1e-8) | stiff(PINNED.SECTION, factor)
            yield on_pinned_beam(group, label, dt, SECTION=section)


def long_runs(quick):
    for label, scene, many in (("pendulum", pendulum, 10**6), ("pinned beam", pinned_beam, 10**5)):
        many //= 100 if quick else 1
        label = f"1e{len(str(many)) - 1} {label}"
        yield Case("Many steps, dt = 0.01 s", label, scene, 0.01, 0.01 * many, drifts=True)


# A free beam of so many elements, on which a bead slides; element and step [m, s].
BEAD_ELEMENTS, BEAD_LENGTH, BEAD_DT = 12, 0.5, 0.01


def bead(factor=1.0, mass=1.0, passed=0.1):
    """A bead on a free beam that rotates: it passes so many elements in a step at the start.

    EA and GA of the beam are multiplied by a factor; the mass is that over the beam's.
    """
    section = fb.Section(EA=1e4 * factor, GA=1e4 * factor, EI=50.0, rhoA=1.0, rhoI=0.01)
    scene, length = fb.Scene(), BEAD_ELEMENTS * BEAD_LENGTH
    rod = scene.add_beam([(0, 0), (length, 0)], section, BEAD_ELEMENTS)
    start = rod.nodes[1]
    post = scene.add_beam([(start.x, 0), (start.x, 0.3)], section, elements=1)
    scene.add_mass(post.start, mass * length, inertia=0.01 * mass * length)
    scene.add_joint(fb.Slider(rod, post.start))
    scene.set_velocity(rod, lambda x, y: (-0.3 * y, 0.3 * (x - length / 2)), spin=0.3)
    speed = passed * BEAD_LENGTH / BEAD_DT
    scene.set_velocity(post, lambda x, y: (speed - 0.3 * y, 0.3 * (x - length / 2)), spin=0.3)
    return scene


def on_bead(group, label, passed=0.1, **constants):
    t_end = 8 / passed * BEAD_DT  # over eight elements, if it stays as fast
    return Case(group, label, partial(bead, passed=passed, **constants), BEAD_DT, t_end)


def sliders(quick):
    """Nodes that slide on a beam: stiffer beams, light and heavy beads, slow and fast ones."""
    name = f"Bead on a free beam, dt = {BEAD_DT:g} s: "
    for label, factor in powers(*(2,) if quick else (0, 2, 4, 6)):
        yield on_bead(name + "EA and GA over the example's", label, factor=factor)
    for label, mass in () if quick else powers(-4, -2, 0, 2, 4):
        yield on_bead(name + "mass over the beam's", label, mass=mass)
    for passed in () if quick else (0.05, 0.5, 1.0, 4.0):
        yield on_bead(name + "elements passed in a step", f"{passed:g}", passed=passed)


def whip(**contact):
    return WHIP.scene(**contact)[0]


def ring(**contact):
    return RING.scene(**contact)[0]


def on_whip(group, label, dt=WHIP.DT, **contact):
    return Case(group, label, partial(whip, **contact), dt, WHIP.T_END)


def stops(quick):
    """Contacts that are stiff, steps far longer than they, and a loss."""
    group = f"Whip, dt = {WHIP.DT:g} s: stiffness of the peg [N/m2]"
    for label, stiffness in powers(*(7,) if quick else (4, 6, 8, 10, 12)):
        yield on_whip(group, label, stiffness=stiffness)
    for factor in () if quick else (1 / 4, 1, 4):
        yield on_whip(f"Whip: dt over {WHIP.DT:g} s", multiple(factor), dt=factor * WHIP.DT)
    for restitution in () if quick else (0.0, 0.5, 0.9):
        group = f"Whip, dt = {WHIP.DT:g} s: restitution"
        yield on_whip(group, f"{restitution:g}", restitution=restitution)
    for restitution in () if quick else (1.0, 0.5):
        group = f"Falling ring, dt = {RING.DT:g} s: restitution"
        scene = partial(ring, restitution=restitution)
        yield Case(group, f"{restitution:g}", scene, RING.DT, 2.0)


# Half the width of a box, stiffness of contact of a node [N/m], step [m, N/m, s].
BOX, BOX_STIFFNESS, BOX_DT = 1.0, 1e6, 0.002


def box(stiffness=BOX_STIFFNESS, mu=0.0, restitution=1.0):
    """A flexible bar and a disc fly in a box, and hit its walls and each other."""
    scene, elements = fb.Scene(), 8
    section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=1e-3)
    bar = scene.add_beam([(-0.7, -0.5), (0.3, -0.5)], section, elements)
    disc = scene.add_body((0.3, 0.4), mass=1.0, inertia=0.02).centre
    scene.set_velocity(bar, (1.0, 2.0))
    scene.set_velocity(disc, (-3.0, -2.0), spin=5.0)

    def touch(what, shape, k, **more):
        friction = fb.Coulomb(mu, k) if mu else None
        loss = {"restitution": restitution, "speed": 0.01} if restitution < 1 else {}
        scene.add_contact(what, shape, stiffness=k, friction=friction, **loss, **more)

    for x, y in ((BOX, 0), (-BOX, 0), (0, BOX), (0, -BOX)):
        wall = fb.Line((x, y), normal=(-x, -y))
        touch(bar, wall, stiffness * elements, radius=0.02)
        touch(disc, wall, stiffness, radius=0.2)
    touch(bar, fb.Circle(disc, 0.2), stiffness * elements, radius=0.02, along=3)
    return scene


def in_box(group, label, dt=BOX_DT, scene=box, **contact):
    return Case(group, label, partial(scene, **contact), dt, 2.0)


# Middles, directions and velocities of three bars; half their thickness [m, rad, m/s].
BARS = (
    ((-0.1, -0.3), 0.0, (0.5, 2.0)),
    ((0.0, 0.25), 0.1, (0.0, -2.0)),
    ((-0.4, 0.65), 0.5, (2.0, -2.0)),
)
HALF = 0.1


def colliding(stiffness=BOX_STIFFNESS, mu=0.0, bristle=BOX_STIFFNESS):
    """Three flexible bars fly in a circle, and hit it and each other."""
    scene, elements, made = fb.Scene(), 8, []
    section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=1e-3)
    friction = fb.Coulomb(mu, bristle * elements) if mu else None
    touch = {"stiffness": stiffness * elements, "radius": HALF, "friction": friction}
    for middle, angle, velocity in BARS:
        arm = 0.4 * np.array([np.cos(angle), np.sin(angle)])
        bar = scene.add_beam([tuple(middle - arm), tuple(middle + arm)], section, elements)
        scene.set_velocity(bar, velocity)
        for other in made:
            scene.add_contact(bar, other, **touch)
        scene.add_contact(bar, fb.Circle((0, 0), 1.2, inside=True), **touch)
        made.append(bar)
    return scene


def rubbing(mu, bristle=BOX_STIFFNESS):
    """A crank and a flexible rod push a body along a rail, with friction in all four joints."""
    scene, pin = fb.Scene(gravity=(0, -9.81)), fb.Coulomb(mu, bristle, radius=0.02)
    section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=1e-3)
    crank = scene.add_body((0, 0.15), 1.0, 0.01, points={"pin": (0, 0), "end": (0, 0.3)})
    rod = scene.add_beam([(0, 0.3), (0.8, 0)], section, elements=8)
    block = scene.add_body((0.8, 0), mass=1.0, inertia=0.01).centre
    for a, b in ((fb.GROUND, crank["pin"]), (crank["end"], rod.start), (rod.end, block)):
        scene.add_joint(fb.Revolute(a, b, friction=pin))
    slide = fb.Coulomb(mu, bristle)
    scene.add_joint(fb.Prismatic(fb.GROUND, block, axis=(1, 0), friction=slide))
    scene.set_velocity(crank, lambda x, y: (-10 * y, 10 * x), spin=10.0)
    scene.make_velocities_compatible()
    return scene


def rubbing_members(mu):
    """A plank slides along a bed under its weight, both flexible members."""
    scene, half = fb.Scene(gravity=(0, -9.81)), 0.02
    section = fb.Section(EA=1e5, GA=1e5, EI=10.0, rhoA=1.0, rhoI=1e-3)
    bed = scene.add_beam([(0, 0), (2, 0)], section, elements=16)
    scene.clamp(bed.start)
    scene.clamp(bed.end)
    plank = scene.add_beam([(0.2, 2 * half), (0.7, 2 * half)], section, elements=4)
    scene.set_velocity(plank, (3.0, 0.0))
    friction = fb.Coulomb(mu, BOX_STIFFNESS) if mu else None
    scene.add_contact(plank, bed, stiffness=BOX_STIFFNESS, radius=half, friction=friction)
    return scene


def sticking(name, scene, mus, exponents):
    """Friction that sticks over its coefficient, and over the stiffness of its springs."""
    for mu in mus:
        yield in_box(name + "friction mu", f"{mu:g}", scene=scene, mu=mu)
    for label, bristle in powers(*exponents):
        group = name + "stiffness of friction, mu = 0.5"
        yield in_box(group, label, scene=scene, mu=0.5, bristle=bristle)


def contacts(quick):
    """Contact between bodies and members: stiffness, friction that sticks, restitution, steps."""
    box_name, three, crank, plank = (
        f"{name}, dt = {BOX_DT:g} s: "
        for name in (
            "Bar and disc in a box",
            "Three bars that collide",
            "Crank with friction",
            "Plank that slides along a bed",
        )
    )
    if quick:
        yield in_box(crank + "friction mu", "0.3", scene=rubbing, mu=0.3)
        yield in_box(plank + "friction mu", "0.5", scene=rubbing_members, mu=0.5)
        return
    mus, exponents = (0.1, 0.3, 0.5, 1.0, 2.0), (3, 5, 7, 9)
    for name, scene in ((box_name, box), (three, colliding)):
        for label, stiffness in powers(3, 6, 9, 12):
            group = name + "stiffness of contact [N/m]"
            yield in_box(group, label, scene=scene, stiffness=stiffness)
    for mu in mus:
        yield in_box(box_name + "friction mu", f"{mu:g}", mu=mu)
    yield from sticking(crank, rubbing, mus, exponents)
    yield from sticking(three, colliding, mus, exponents)
    for mu in (0.0, 0.3, 0.5, 1.0, 2.0):
        yield in_box(plank + "friction mu", f"{mu:g}", scene=rubbing_members, mu=mu)
    for label, stiffness in powers(3, 9, 12):
        group = box_name + "stiffness of contact [N/m], mu = 1"
        yield in_box(group, label, stiffness=stiffness, mu=1.0)
    for restitution in (0.0, 0.5):
        group = box_name + "restitution, mu = 0.3"
        yield in_box(group, f"{restitution:g}", mu=0.3, restitution=restitution)
    for factor in (1 / 4, 4, 16):
        group = f"Bar and disc in a box, mu = 0.3: dt over {BOX_DT:g} s"
        yield in_box(group, multiple(factor), dt=factor * BOX_DT, mu=0.3)


def bars(corners, gravity=None):
    """Rigid bars of 1 kg/m between corners, hinged to each other and at the first to the ground."""
    scene, made = fb.Scene(gravity=gravity), []
    for a, b in zip(corners[:-1], corners[1:], strict=True):
        length = np.hypot(*np.subtract(b, a))
        points = {"a": a, "b": b}
        made.append(scene.add_body(np.add(a, b) / 2, length, length**3 / 12, points=points))
        if len(made) > 1:
            scene.add_joint(fb.Revolute(made[-2]["b"], made[-1]["a"]))
    scene.add_joint(fb.Revolute(fb.GROUND, made[0]["a"]))
    return scene, made


def crank_rocker():
    """A crank of 0.3 m that turns at 10 rad/s at the start, and rocks a bar; without weight."""
    scene, made = bars([(0, 0), (0, 0.3), (1.0, 0.9), (1.2, 0.0)])
    scene.add_joint(fb.Revolute(made[-1]["b"], fb.GROUND))
    scene.set_velocity(made[0], lambda x, y: (-10 * y, 10 * x), spin=10.0)
    scene.make_velocities_compatible()
    return scene


def swinging_four_bar():
    """A four-bar linkage that swings under its weight."""
    scene, made = bars([(0, 0), (0.3, 0.9), (2.0, 1.3), (1.8, 0.0)], (0, -9.81))
    scene.add_joint(fb.Revolute(made[-1]["b"], fb.GROUND))
    return scene


def swinging_slider_crank():
    """A crank and a rod, whose end slides on the ground, under their weight."""
    scene, made = bars([(0, 0), (0.2, 0.2), (1.0, 0.0)], (0, -9.81))
    scene.fix(made[-1]["b"], "y")
    return scene


# Scenes of rigid bars, and the time for each.
LOOPS = {
    "Slider crank": (swinging_slider_crank, 12.0),
    "Four-bar linkage": (swinging_four_bar, 12.0),
    "Crank and rocker": (crank_rocker, 25.0),
}
LOOP_STEPS = (0.01, 0.005, 0.0025)


def rigid_loops(quick, steps=LOOP_STEPS):
    """Closed loops of rigid bars in smooth motion."""
    for name, (scene, t_end) in [*LOOPS.items()][: 1 if quick else None]:
        for dt in steps[:: 2 if quick else 1]:
            yield Case(f"{name} of rigid bars: dt [s]", f"{dt:g}", scene, dt, t_end)


GROUPS = (
    stiffness,
    frequency,
    masses,
    meshes,
    spins,
    loads,
    steps,
    softness,
    sliders,
    long_runs,
    stops,
    contacts,
    rigid_loops,
)


def tolerances(quick):
    """Cases on the effect of Newton's tolerance, from the paper's examples."""
    examples = (
        ("Pendulum", PENDULUM, 0.1),
        ("Pendulum", PENDULUM, 0.01),
        ("Swing", SWING, SWING.DT),
        ("Multi-body system", MULTIBODY, 0.01),
        ("Pinned beam", PINNED, PINNED.DT),
    )
    for name, module, dt in examples[:: 4 if quick else 1]:
        group = f"{name}, dt = {dt:g} s: Newton's tolerance"
        for label, tolerance in powers(*(-4, -10) if quick else (-2, -4, -6, -8, -10, -12)):
            newton = fb.NewtonOptions(tolerance)
            yield Case(group, label, scene_in(module), dt, module.T_END, newton)


def tolerances_page(cells):
    """Largest tolerance from which on verdicts do not change, and largest errors by tolerance."""
    rows = []
    for scheme, own in grouped(cells, "scheme").items():
        groups_by_label = grouped(own, "case.label")
        kinds = [[cell.verdict.kind for cell in some] for some in groups_by_label.values()]
        final = [
            label
            for k, label in enumerate(groups_by_label)
            if all(kind == kinds[-1] for kind in kinds[k:])
        ]
        errors = {
            f"largest error, {t}": max(c.verdict.worst for c in groups_by_label[t])
            for t in groups_by_label
        }
        rows.append({"scheme": scheme, "no verdict changes below": final[0]} | errors)
    return section("Verdicts and errors by tolerance", rows)


# -- Numerical damping ---------------------------------------------------------------------------


def dampings(quick):
    """The paper's examples at several steps, for schemes whose damping is scanned."""
    for name, (module, _, t_end, steps) in SCAN.EXAMPLES.items():
        for dt in steps[1:2] if quick else steps:
            yield Case(f"{name}: dt [s]", f"{dt:g}", scene_in(module), dt, t_end)


# -- Free parameters -----------------------------------------------------------------------------


def family(quick):
    """Newmark's family over its free parameters, by labels."""
    betas, gammas = (0.25, 0.26, 0.3, 0.5, 1.0), (0.505, 0.51, 0.55, 0.6)
    alphas, radii = (-0.01, -0.05, -0.1, -0.2, -1 / 3), (1.0, 0.99, 0.9, 0.8, 0.5, 0.0)
    if quick:
        betas, gammas, alphas, radii = betas[:2], gammas[:1], alphas[:2], radii[:1]
    return (
        {f"Newmark, beta = {beta:g}": fb.Newmark(beta, 0.5) for beta in betas}
        | {f"Newmark, gamma = {g:g}": fb.Newmark((g + 0.5) ** 2 / 4, g) for g in gammas}
        | {f"HHT, alpha = {alpha:.2g}": fb.HHT(alpha) for alpha in alphas}
        | {f"Generalized alpha, {rho:g}": fb.GeneralizedAlpha(rho) for rho in radii}
    )


# -- Units -----------------------------------------------------------------------------------------

# Powers of length and time in the units of the demos' constants; their masses stay in kilograms.
SECTION = {"EA": (1, -2), "GA": (1, -2), "EI": (3, -2), "rhoA": (-1, 0), "rhoI": (1, 0)}
POWERS = {
    "pendulum": {"LENGTH": (1, 0), "GRAVITY": (1, -2), "SPEED": (1, -1)},
    "pinned_beam": {"LENGTH": (1, 0), "VELOCITY": (1, -1)},
    "three_bar_swing": dict.fromkeys(("LEFT", "RIGHT", "A", "C"), (1, 0)) | {"PULSE": (1, -2)},
    "multibody": dict.fromkeys(("LEFT", "RIGHT", "A", "B", "MIDDLE"), (1, 0)) | {"PULSE": (2, -2)},
}
# New units in an old one: length, time.
UNITS = {
    "micrometres": (1e6, 1.0),
    "hours": (1.0, 1 / 3600),
    "micrometres and hours": (1e6, 1 / 3600),
}
# End of the comparison [s]: later a change in the last digit leads to a different motion.
COMPARED = {"pendulum": 5.0, "pinned_beam": 1.0, "three_bar_swing": 0.6, "multibody": 0.5}


def in_units(name, length, time):
    """A demo's module with its constants in other units."""
    module = demo.__wrapped__(name)
    for constant, (a, b) in POWERS[name].items():
        factor = length**a * time**b
        value = getattr(module, constant)
        if constant == "PULSE":
            value = tuple(np.multiply(value, ((time,), (factor,))))
        else:
            value = tuple(np.multiply(value, factor)) if np.ndim(value) else value * factor
        setattr(module, constant, value)
    for constant in {"SECTION", "LINK"} & vars(module).keys():
        section = getattr(module, constant)
        own = {key: getattr(section, key) * length**a * time**b for key, (a, b) in SECTION.items()}
        setattr(module, constant, replace(section, **own))
    return module


def compare_units():
    """Largest difference of motion and energy between units, by demo and units."""
    cases = {}
    for name, t_end in COMPARED.items():
        dt = demo(name).DT if name != "pendulum" else PENDULUM.SMALL

        def motion(length, time, name=name, dt=dt, t_end=t_end):
            scene = only(in_units(name, length, time).scene())
            solution = fb.simulate(scene, dt=dt * time, t_end=t_end * time)
            size = np.hypot(*np.ptp(solution.X, axis=0))
            places = solution.q / (size, size, 1.0)
            return places, solution.energy.total * (time / length) ** 2

        places, energy = motion(1.0, 1.0)
        for units, factors in UNITS.items():
            others, other_energy = motion(*factors)
            cases[f"{name}, {units}"] = {
                "until [s]": t_end,
                "largest difference of motion": abs(others - places).max(),
                "largest difference of energy": abs(other_energy - energy).max()
                / abs(energy).max(),
            }
    return cases


def units_page(cases):
    rows = [{"demo, units": case} | row for case, row in cases.items()]
    note = (
        "Largest difference from the motion in the demo's units, by EnergyMomentum: displacements "
        "over the size of the scene, rotations, and energy over the largest.\n\n"
    )
    return section("Other units", rows, note)


def studied(path, schemes, cases, title, how, remarks=lambda cells: ""):
    """Cells of a study, written to files; after Ctrl-C those that are finished."""
    try:
        cells = stability.study(schemes, cases, **how)
    except KeyboardInterrupt as stop:
        if stop.cells:
            stability.write(path, stop.cells, f"{title} (interrupted)")
        raise
    stability.write(path, cells, title, remarks(cells))
    tally = [{"scheme": scheme} | row for scheme, row in stability.counts(cells).items()]
    print(table(tally), f"{len(cells)} cells: {path}.md", sep="\n")
    return cells


def listed(cells):
    """Verdicts by scheme as a list, in the place of a picture that is too wide for a phone."""
    kinds = "kept", "damped", "lost", "gained", "blew up", "failed"
    lines = []
    for scheme, row in stability.counts(cells).items():
        total = sum(row[kind] for kind in kinds)
        parts = [f"{kind} {row[kind]}" for kind in kinds if row[kind]]
        lines.append(f"- {scheme}, {total} cases: {', '.join(parts)}\n")
    return "".join(lines)


def main(quick=False, results=ROOT / "results" / "stability", jobs=1):
    """Cells of the cases and of Newton's tolerance, units, cells of damping and of parameters.

    They are also written to files in a directory. With more jobs, so many processes compute them.
    """
    clock = perf_counter()
    how = {"repeats": 0 if quick else 4, "executor": jobs if jobs > 1 else None}
    schemes = {label: SCHEMES[label] for label in FEW} if quick else SCHEMES
    units = compare_units()
    reporting.write_json(results / "units.json", units)
    title = "effect of Newton's tolerance"
    tolerance_studies = studied(
        results / "tolerances", schemes, tolerances(quick), title, how, tolerances_page
    )
    few = {"alphas": (0.0, -0.05, -0.1), "radii": (0.9,)} if quick else {}
    title = "effect of numerical damping"
    damping_studies = studied(results / "damping", SCAN.schemes(**few), dampings(quick), title, how)
    title = "rigid loops over the free parameters of Newmark's family"
    loops = [*rigid_loops(quick, LOOP_STEPS[::2])][: 1 if quick else None]
    parameter_studies = studied(results / "parameters", family(quick), loops, title, how)
    questions = {group.__name__: list(group(quick)) for group in GROUPS}
    cases = [case for own in questions.values() for case in own]
    title = "stiff and extreme cases"
    cells = studied(results / "cases", schemes, cases, title, how, lambda _: units_page(units))
    asked = {case.name: name for name, cases in questions.items() for case in cases}
    answers: dict[str, list] = {name: [] for name in questions}
    for cell in cells:
        answers[asked[cell.case.name]].append(cell)
    words = {name.replace("_", " "): answer for name, answer in answers.items()}
    draw_summary(results / "cases_by_question.png", words)
    for name in [*questions][: 1 if quick else None]:
        draw_map(results / f"cases_{name}.png", answers[name], slots=16)
        (results / f"cases_{name}.txt").write_text(listed(answers[name]))
    print(f"{perf_counter() - clock:.0f} s")
    return cells, tolerance_studies, units, damping_studies, parameter_studies


if __name__ == "__main__":
    # The tables have the number of halved steps, so their warnings are not needed.
    logging.getLogger("fx_beam").setLevel(logging.ERROR)
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a short form, about a minute")
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes that compute")
    parser.add_argument("results", nargs="?", type=Path, help="directory to write to")
    arguments = parser.parse_args()
    main(arguments.quick, arguments.results or ROOT / "results" / "stability", arguments.jobs)
