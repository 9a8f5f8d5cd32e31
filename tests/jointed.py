"""Scenes with joints that several tests share."""

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
    make, place, given = KINDS[kind]
    scene = fb.Scene(gravity=gravity)
    first = scene.add_beam([(-1, 0), (0, 0)], section, elements=elements, degree=degree)
    a = first.node(0.5) if inner else first.end
    start = np.array([a.x, a.y]) + place
    second = scene.add_beam([start, start + (0.8, -0.6)], section, elements=elements, degree=degree)
    joint = scene.add_joint(make(a, second.start, **given | options))
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
