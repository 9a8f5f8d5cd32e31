"""Scenes with joints that several tests share."""

import ufl

import numpy as np

import fx_beam as fb

MEMBER = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)
OFFSET, AXIS = (0.2, 0.1), (0.6, 0.8)
W = np.array([[0.0, -1.0], [1.0, 0.0]])

#: Each kind of joint between a and b, with the place of b seen from a.
KINDS = {
    "rigid": (fb.Rigid, (0.0, 0.0), {}),
    "rigid with offset": (fb.Rigid, OFFSET, {"offset": OFFSET}),
    "revolute": (fb.Revolute, (0.0, 0.0), {}),
    "revolute with offset": (fb.Revolute, OFFSET, {"offset": OFFSET}),
    "prismatic": (fb.Prismatic, (0.06, 0.08), {"axis": AXIS}),
    "prismatic with offset": (fb.Prismatic, (0.5, 0.5), {"axis": AXIS, "offset": OFFSET}),
    "pin in slot": (fb.PinInSlot, (-0.06, -0.08), {"axis": AXIS}),
    "pin in slot with offset": (fb.PinInSlot, (0.5, 0.5), {"axis": AXIS, "offset": OFFSET}),
}
BENDING = [kind for kind in KINDS if kind not in ("rigid", "revolute")]
SLIDING = [kind for kind in KINDS if "prismatic" in kind or "slot" in kind]


def rotation(angle):
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def pair(kind, degree=1, gravity=None, inner=False, section=MEMBER, elements=2, **options):
    """Two beams of length 1 and a joint from the first's end, or its middle, to the second's start.

    Returns the scene, the beams and the joint.
    """
    make, place, data = KINDS[kind]
    scene = fb.Scene(gravity=gravity)
    first = scene.add_beam([(-1, 0), (0, 0)], section, elements=elements, degree=degree)
    a = first.node(0.5) if inner else first.end
    start = np.array([a.x, a.y]) + place
    second = scene.add_beam([start, start + (0.8, -0.6)], section, elements=elements, degree=degree)
    joint = scene.add_joint(make(a, second.start, **data | options))
    return scene, first, second, joint


def throw(scene, first, second, joint, velocity=(0.3, 0.5), spin=1.0, slide=2.0, hinge=-3.0):
    """Velocities that are rigid but for the joint's own slide and relative rotation."""
    along = slide * joint.axis if joint.axis is not None else np.zeros(2)
    turn = hinge if joint.rotation is not None else 0.0
    pin = np.array([joint.b.x, joint.b.y])

    def of_first(x, y):
        return velocity + spin * (W @ (x, y))

    def of_second(x, y):
        return of_first(x, y) + along + turn * (W @ (np.array([x, y]) - pin))

    scene.set_velocity(first, of_first, spin=spin)
    scene.set_velocity(second, of_second, spin=spin + turn)


def thrown(kind, degree=1, gravity=None, inner=False, **speeds):
    """A free pair, thrown."""
    scene, first, second, joint = pair(kind, degree, gravity, inner)
    throw(scene, first, second, joint, **speeds)
    return scene, joint


def drift(values, scale=None):
    """Largest deviation from the first value, relative to a scale, by default that value."""
    values = np.asarray(values)
    scale = abs(values[0]).max() if scale is None else scale
    return abs(values - values[0]).max() / scale


def momenta(rates, beam, section=MEMBER):
    """The mass matrix (eq. 21) of a straight beam times rates (rows, nodes, 3), at its nodes."""
    nodes = beam.nodes
    length = beam.length / (len(nodes) - 1)
    matrix = np.zeros((len(nodes),) * 2)
    for i in range(len(nodes) - 1):
        matrix[i : i + 2, i : i + 2] += length / 6 * np.array([[2, 1], [1, 2]])
    return (
        matrix
        @ rates[:, [node.number for node in nodes]]
        * (section.rhoA, section.rhoA, section.rhoI)
    )


def midpoint(D, v0, a0, before, dt):
    """The nodal rule of the default (eqs 27 to 30)."""
    path = ufl.as_vector((D[0], D[1], 2 * ufl.tan(D[2] / 2)))
    v1 = 2 * path / dt - v0
    a = (v1 - v0) / dt
    return a, v1, a


#: The default with its nodal rule written out. Such rates are not fitted to joints: forces are
#: those with which steps are in balance to round-off.
UNFITTED = fb.Scheme("Unfitted", fb.EnergyMomentum().resultants, fb.NodalRates(midpoint))


def chain(scene, corners, closed=False):
    """Bars between corners, hinged to each other."""
    bars = []
    for a, b in zip(corners[:-1], corners[1:], strict=True):
        middle, length = np.add(a, b) / 2, np.hypot(*np.subtract(b, a))
        bars.append(scene.add_body(middle, length, length**3 / 12, points={"a": a, "b": b}))
        if len(bars) > 1:
            scene.add_joint(fb.Revolute(bars[-2]["b"], bars[-1]["a"]))
    if closed:
        scene.add_joint(fb.Revolute(bars[-1]["b"], bars[0]["a"]))
    return bars


CORNERS = [(0, 0), (0.3, 0.9), (2.0, 1.3), (1.8, 0.0)]


def four_bar(**coordinate):
    """A four-bar linkage; springs, dampers and motors act at the hinge of its crank."""
    scene = fb.Scene(gravity=(0, -9.81))
    bars = chain(scene, CORNERS)
    crank = scene.add_joint(fb.Revolute(fb.GROUND, bars[0]["a"], **coordinate))
    scene.add_joint(fb.Revolute(bars[2]["b"], fb.GROUND))
    return scene, bars, crank


def whirling(degree=1):
    """Two links thrown so fast that steps of 1/4 s fail every now and then.

    Springs on their hinges count turns, so that none are taken off the rotations on the way.
    """
    scene = fb.Scene(gravity=(0, -9.81))
    first = scene.add_beam([(0, 0), (1, 0)], MEMBER, elements=2, degree=degree)
    second = scene.add_beam([(1, 0), (1.8, 0.3)], MEMBER, elements=2, degree=degree)
    for a, b in ((fb.GROUND, first.start), (first.end, second.start)):
        scene.add_joint(fb.Revolute(a, b, spring=fb.Spring(1.0)))
    scene.make_velocities_compatible()
    scene.set_velocity(second, lambda x, y: (-60 * y, 60 * (x - 1)), spin=60)
    return scene


# -- Scenes with many kinds of numbers -----------------------------------------------------------


def frame():
    """Curved and tapered beams without joints that turn, with loads and drag of all kinds."""
    scene = fb.Scene(gravity=(0.3, -9.81))
    tapered = fb.Section(
        EA=lambda s: 2e4 * (1 - s / 3),
        GA=8e3,
        EI=lambda s: 30 * (1 - s / 2),
        rhoA=lambda s: 1.2 - s / 4,
        rhoI=2e-3,
    )
    plain = fb.Section(EA=1e4, GA=7e3, EI=20.0, rhoA=0.8, rhoI=1e-3)
    post = scene.add_beam([(0, 0), (0.1, 1)], plain, elements=2, degree=2)
    bow = scene.add_beam(fb.arc((0.1, 1), (0.6, 1.3), (1.2, 1.1)), tapered, elements=3, degree=2)
    scene.add_joint(fb.Revolute(post.end, bow.start, spring=fb.Spring(3.0, rest=0.1)))
    scene.clamp(post.start)
    scene.add_mass(bow.end, 0.3, 0.02)
    scene.add_force(bow.end, lambda t: (1 + t, 2.0))
    scene.add_force(bow.end, (0.2, 0.3), follower=True)
    scene.add_moment(bow.end, lambda t: 0.4 * t)
    scene.add_line_load(post, (0.3, 0.1))
    scene.add_line_load(bow, lambda s: (0.1 + s, 0.2), of="arc length")
    scene.add_drag(bow, linear=(0.1, 0.2), quadratic=0.05, rotation=0.01)
    scene.add_drag(post, linear=0.1)
    scene.add_drag(post.end, linear=0.2, quadratic=0.3, rotation=0.05)
    scene.add_contact(bow, fb.Line((1.203, 1.1), normal=(-1, 0.2)), stiffness=1e3)
    scene.add_contact(bow.end, fb.Circle((1.3, 0.5), 0.6), 1e3, restitution=0.5, speed=0.1)
    laws = {"spring": fb.Spring(20.0, rest=0.4), "damper": fb.Damper(0.3)}
    scene.add_force_between(bow.end, (1.5, 1.6), **laws)
    scene.set_velocity(bow, lambda x, y: (y - 1, 0.1 - x), spin=-0.2)
    scene.set_velocity(post, (0.0, 0.0))
    scene.make_velocities_compatible()
    return scene


def linkage():
    """Bodies, offsets, slides with springs, friction, stops and motors, a prescribed motion."""
    scene = fb.Scene(gravity=(0, -9.81))
    times = {"retardation": (1e-3, 2e-3, 3e-3)}
    section = fb.Section(EA=1e4, GA=7e3, EI=20.0, rhoA=0.8, rhoI=1e-3, **times)
    rod = scene.add_beam([(0.5, 0.1), (1.5, 0.2)], section, elements=2)
    body = scene.add_body((0.2, 0.1), 2.0, 0.1, points={"pin": (0, 0), "end": (0.5, 0.1)})
    scene.add_joint(
        fb.Revolute(
            fb.GROUND,
            body["pin"],
            damper=fb.Damper(0.2),
            friction=fb.SmoothFriction(0.3, speed=0.1),
        )
    )
    scene.add_joint(fb.Revolute(body["end"], rod.start, stop=fb.Stop(-0.5, 1e-4, 50.0)))
    block = scene.add_body((1.6, 0.3), mass=1.0, inertia=0.05)
    scene.add_joint(
        fb.Prismatic(
            rod.end,
            block.centre,
            axis=(1, 0.2),
            offset=(0.1 - 0.05, 0.1 - 0.01),
            spring=fb.Spring(40.0, rest=0.1),
            damper=fb.Damper(0.5),
            friction=fb.SmoothFriction(0.2, speed=0.05),
            stop=(-0.4, 0.055, 1e3),
        )
    )
    wheel = scene.add_body((2.0, 0.6), mass=0.5, inertia=0.02)
    scene.add_joint(fb.Revolute(fb.GROUND, wheel.centre, motor=lambda t: 3 * t**2))
    driven = scene.add_body((0.0, 1.0), mass=0.5, inertia=0.02)
    scene.prescribe(driven.centre, x=lambda t: 0.1 * t**2)
    scene.fix(driven.centre, "y")
    scene.add_force_between(driven.centre, body["end"], spring=fb.Spring(30.0, rest=0.8))
    scene.set_velocity(block.centre, (4.0, 0.3), spin=0.1)
    scene.make_velocities_compatible()
    return scene


def pendulum_with_friction(mu):
    """A body of 2 kg and 0.05 kg m^2 that hangs by a pin with friction, at first level with it."""
    scene = fb.Scene(gravity=(0, -9.81))
    body = scene.add_body((0.5, 0), mass=2.0, inertia=0.05, points={"pin": (0, 0)})
    friction = fb.Coulomb(mu, 1e4, radius=0.05)
    pin = scene.add_joint(fb.Revolute(fb.GROUND, body["pin"], friction=friction))
    return scene, body.centre, pin
