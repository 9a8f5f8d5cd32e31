"""Scenes that `test_processes.py` computes on several processes and on one."""

import functools
import itertools
import subprocess

import ufl

import numpy as np
from scenes import grid

import fx_beam as fb

SECTION = fb.Section(EA=1e5, GA=1e5, EI=50.0, rhoA=1.0, rhoI=1e-3)
DAMPED = fb.Section(EA=1e5, GA=1e5, EI=50.0, rhoA=1.0, rhoI=1e-3, retardation=1e-3)


@functools.cache
def mpirun(number):
    """The command that starts so many processes, which Open MPI wants to be told are too many."""
    version = subprocess.run(["mpirun", "--version"], capture_output=True, text=True).stdout
    return ["mpirun", "-n", str(number), *["--oversubscribe"] * ("Open MPI" in version)]


def frame(cells=4, high=3, section=SECTION, **kind):
    """A lattice of struts, with its nodes by their places."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    return scene, grid(scene, cells, high, section, **kind)


def shaken():
    """A frame on a base that is driven, with loads over time, drag and damping."""
    scene, nodes = frame(section=DAMPED)
    for i in range(5):
        scene.prescribe(nodes[i, 0], x=lambda t: 0.1 * t**2, y=lambda t: 0.0)
        scene.fix(nodes[i, 0], "rotation")
    scene.add_force(nodes[4, 3], lambda t: (10 * np.sin(20 * t), 0.0))
    scene.add_force(nodes[0, 3], (0.0, 5.0), follower=True)
    for beam in scene.beams[::3]:
        scene.add_drag(beam, linear=(0.1, 0.5))
    scene.add_drag(nodes[2, 3], quadratic=2.0)
    scene.add_line_load(scene.beams[-1], (0.0, -3.0))
    return scene


def jointed():
    """A frame with bodies, springs, a damper, a motor, a slide, a pendulum and an obstacle."""
    scene, nodes = frame(3, 2)
    body = scene.add_body((3.5, 2.5), 3.0, 0.5, points={"a": (3, 2), "b": (4, 3)})
    spring, damper = fb.Spring(stiffness=30.0), fb.Damper(viscosity=0.5)
    scene.add_joint(fb.Revolute(nodes[3, 2], body["a"], spring=spring, damper=damper))
    other = scene.add_body((5.0, 3.0), 1.0, 0.1, points={"b": (4, 3)})
    scene.add_joint(fb.Revolute(body["b"], other["b"], motor=lambda t: 0.5 * t**2))
    arm = scene.add_beam([(3, 0), (6, -1)], SECTION, elements=6)
    scene.add_joint(fb.Revolute(nodes[3, 0], arm.start))
    block = scene.add_body((0.0, 2.0), 2.0, 0.3)
    spring = fb.Spring(stiffness=200.0)
    scene.add_joint(fb.Prismatic(nodes[0, 2], block.centre, axis=(0, 1), spring=spring))
    scene.add_force_between(nodes[0, 0], arm.end, spring=fb.Spring(stiffness=40.0))
    scene.clamp(nodes[0, 0])
    scene.pin(nodes[1, 0])
    scene.add_contact(arm, fb.Line((0.0, -1.3), (0.0, 1.0)), stiffness=1e4)
    return scene


def yielding():
    """A section that yields in bending, by functions within a function."""

    def energy(eps, gamma, kappa, a):
        return 1e5 / 2 * (eps**2 + gamma**2) + 25 * (kappa - a[0]) ** 2 + 5 * a[0] ** 2

    def flow(old, strains0, strains, dt):
        trial = 50 * (strains[2] - old[0]) - 10 * old[0]
        return [old[0] + ufl.sign(trial) * ufl.max_value(abs(trial) - 2.0, 0) / 60]

    own = fb.InternalVariables(("plastic curvature",), flow)
    return fb.Section(strain_energy=energy, internal=own, rhoA=1.0, rhoI=1e-3)


def held(section=SECTION):
    """A frame under its weight, with a support that is moved."""
    scene, nodes = frame(3, 3, section, elements=2)
    for i in range(4):
        scene.clamp(nodes[i, 0])
    scene.prescribe(nodes[3, 3], x=lambda t: 0.2 * t)
    scene.add_force(nodes[0, 3], (3.0, 0.0))
    return scene


def bent():
    """The same, which yields."""
    return held(yielding())


def curved(curvature):
    """The same with a member whose natural curvature is a function of place and time."""
    scene = held()
    scene.add_natural_strain(scene.beams[1], curvature=curvature)
    return scene


def warmed():
    """The frame with members that grow and bend over time and place."""
    scene = curved(lambda f, t: f * t)
    for beam in scene.beams[::2]:
        scene.add_natural_strain(beam, axial=lambda t: 0.02 * np.sin(5 * t), curvature=0.1)
    return scene


def flung(spin=3.0):
    """A free bow of degree 2, which is cut within, and turns."""
    scene = fb.Scene()
    curve = fb.arc((1, 0), (0, 1), (-1, 0))
    bow = scene.add_beam(curve, SECTION, elements=12, degree=2)
    scene.set_velocity(bow, lambda x, y: (-spin * y, spin * x), spin)
    scene.add_force(bow.end, lambda t: (0.0, 5 * t))
    return scene


def run(make, scheme=None, **options):
    """The motion of a scene."""
    return fb.simulate(make(), scheme, **{"dt": 0.01, "t_end": 0.1} | options)


def softened():
    """A frame whose stored energy has numbers that change in time, with a damper that has one."""
    soft = fb.Parameter("softness", lambda t: 1.0 + 5.0 * t)
    bend, slow = fb.Parameter("bending", 50.0), fb.Parameter("slow", 0.2)

    def energy(eps, gamma, kappa):
        return 1e5 / (2 * soft) * (eps**2 + gamma**2) + bend / 2 * kappa**2

    scene = held(fb.Section(strain_energy=energy, rhoA=1.0, rhoI=1e-3))
    body = scene.add_body((3.5, 3.0), 1.0, 0.1, points={"a": (scene.nodes[3].x, scene.nodes[3].y)})
    spring, damper = fb.Spring(stiffness=30.0), fb.Damper(law=lambda rate: slow * rate)
    scene.add_joint(fb.Revolute(scene.nodes[3], body["a"], spring=spring, damper=damper))
    return scene


def still():
    """Bodies on a frame, held by a spring, in equilibrium."""
    scene, nodes = frame(3, 2)
    for i in range(4):
        scene.clamp(nodes[i, 0])
    body = scene.add_body((3.5, 2.5), 3.0, points={"a": (3, 2), "b": (4, 3)})
    spring = fb.Spring(stiffness=300.0)
    scene.add_joint(fb.Revolute(nodes[3, 2], body["a"], spring=spring))
    scene.add_force(body["b"], (0.0, -2.0))
    return scene


#: Solutions by name.
CASES = {
    "shaken": lambda **o: run(shaken, **o),
    "jointed": lambda **o: run(jointed, **o),
    "flung": lambda **o: run(flung, fb.EnergyMomentum(order=4), **o),
    "flung with a tolerance": lambda **o: run(flung, tolerance=1e-4, **o),
    "decaying": lambda **o: run(jointed, fb.EnergyDecaying(), **o),
    "averaged": lambda **o: run(held, fb.GeneralizedAlpha(), **o),
    "yielding": lambda **o: run(bent, **o),
    "warmed": lambda **o: run(warmed, **o),
    "softened": lambda **o: run(softened, **o),
    "equilibrium": lambda: fb.static(held(), load_steps=3, t=1.0),
    "equilibrium of bodies": lambda: fb.static(still(), load_steps=3),
    "bent": lambda: fb.static(bent(), load_steps=3, t=1.0),
}

#: Those that are also written to files, row by row.
WRITTEN = ["jointed", "flung", "yielding"]


def refused():
    """Scenes that one process computes, by what several refuse."""
    sliding = fb.Scene()
    rail = sliding.add_beam([(0, 0), (4, 0)], SECTION, elements=4)
    sliding.clamp(rail.start)
    rider = sliding.add_body((1, 0), 1.0, 0.1)
    sliding.add_joint(fb.Slider(rail, rider.centre))
    closed = fb.Scene()
    corners = [(0, 0), (1, 1), (3, 1), (4, 0)]
    bars = [
        closed.add_body(np.mean(pair, axis=0), 1.0, 0.1, points=dict(zip("ab", pair, strict=True)))
        for pair in itertools.pairwise(corners)
    ]
    closed.add_joint(fb.Revolute(fb.GROUND, bars[0]["a"]))
    for one, other in itertools.pairwise(bars):
        closed.add_joint(fb.Revolute(one["b"], other["a"]))
    closed.add_joint(fb.Revolute(fb.GROUND, bars[2]["b"]))
    small = fb.Scene()
    small.add_body((0, 0), 1.0, 0.1)
    return {
        "slides on a beam": sliding,
        "closed loop": closed,
        "too few members": small,
    }


class Stops:
    """A load that fails, or ends the script as by Ctrl-C, once after a time."""

    def __init__(self, time, stop):
        self.time, self.stop = time, stop

    def __call__(self, t):
        if t > self.time and self.stop is not None:
            stop, self.stop = self.stop, None
            stop()
        return 0.0, 1.0


def loaded(load):
    """The held frame with a load over time, and the node that it pulls."""
    scene = held()
    scene.add_force(scene.beams[0].end, load)
    return scene
