"""The scenes that several tests share, built small and without pictures."""

import importlib.util
import sys
from pathlib import Path

import ufl

import numpy as np
import pytest

import fx_beam as fb

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"
DEMOS = {path.stem: path for path in (Path(__file__).parents[1] / "demos").glob("*.py")}

PINNED = fb.Section(EA=4e7, GA=1e7, EI=1.3e7, rhoA=0.05, rhoI=1 / 60)
FLYING = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=10.0)


def _module(name, path):
    spec = importlib.util.spec_from_file_location(name, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def demo(name):
    """A demo as a module; without dolfinx the tests of those that need it are skipped."""
    if "import fenicsx" in DEMOS[name].read_text():
        pytest.importorskip("fx_beam.fenicsx")
    return _module(f"demo_{name}", DEMOS[name])


def benchmark(name):
    """A script of benchmarks/ as a module; what they share is beside them."""
    sys.path.insert(0, str(BENCHMARKS))
    try:
        return _module(name, BENCHMARKS / f"{name}.py")
    finally:
        sys.path.pop(0)


def assert_refused(words, call, *arguments, error=fb.SceneError, **options):
    """Assert that a call ends in an error whose message has the words, a regular expression."""
    with pytest.raises(error, match=words):
        call(*arguments, **options)


def one_bar(axis, section, *size, gravity=None, load=None, **options):
    """A scene with a beam along an axis: points, a curve, or the end of a line from the origin.

    A load is a force at its end.
    """
    scene = fb.Scene(gravity=gravity)
    is_end = isinstance(axis, tuple | np.ndarray) and np.ndim(axis) == 1
    points = [(0, 0), axis] if is_end else axis
    bar = scene.add_beam(points, section, *size, **options)
    if load is not None:
        scene.add_force(bar.end, load)
    return scene, bar


def clamped_bar(axis, section, *size, **options):
    """A scene with a beam that is clamped at its start, and the beam."""
    scene, bar = one_bar(axis, section, *size, **options)
    scene.clamp(bar.start)
    return scene, bar


def pinned_bar(axis, section, *size, **options):
    """A scene with a beam on a pin."""
    scene, bar = one_bar(axis, section, *size, **options)
    scene.pin(bar.start)
    return scene, bar


def supported_bar(axis, section, *size, held="y", **options):
    """A scene with a beam on a pin, and a support of some components at the other end."""
    scene, bar = pinned_bar(axis, section, *size, **options)
    scene.fix(bar.end, *held)
    return scene, bar


def one_body(place, *mass, gravity=None, **options):
    """A scene with a body, and the body."""
    scene = fb.Scene(gravity=gravity)
    return scene, scene.add_body(place, *mass, **options)


def guided_body(place, mass, inertia, axis=(1, 0), gravity=None, **laws):
    """A scene with a body on a guide of the ground; its centre and the guide."""
    scene = fb.Scene(gravity=gravity)
    centre = scene.add_body(place, mass, inertia).centre
    return scene, centre, scene.add_joint(fb.Prismatic(fb.GROUND, centre, axis=axis, **laws))


def hinged_body(place, mass, inertia, points, gravity=None, **laws):
    """A scene with a body on a hinge of the ground at the first of its points; and the hinge."""
    scene = fb.Scene(gravity=gravity)
    body = scene.add_body(place, mass, inertia, points=points)
    return scene, body, scene.add_joint(fb.Revolute(fb.GROUND, body[next(iter(points))], **laws))


def held_body(place, mass, inertia, *fixed, gravity=None):
    """A scene with a body, some components of which may be fixed; and its centre."""
    scene = fb.Scene(gravity=gravity)
    centre = scene.add_body(place, mass, inertia).centre
    if fixed:
        scene.fix(centre, *fixed)
    return scene, centre


def pinned_beam(elements=8, degree=1, section=PINNED):
    """Beam of length 100, pinned at the origin, with a triangular transverse velocity."""
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (100, 0)], section, elements=elements, degree=degree)
    scene.pin(beam.start)
    scene.set_velocity(
        beam, lambda x, y: (0, 12 * min(x, 100 - x)), spin=lambda x, y: 12 * np.sign(50 - x)
    )
    return scene, beam


def pendulum(EA=1e10, EI=1e3):
    """Massless beam of length 0.5 hanging at rest, mass 1 at its end, an exact 45 degree swing."""
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), (0, -0.5)], fb.Section(EA=EA, GA=EA, EI=EI), elements=1)
    scene.pin(beam.start)
    scene.add_mass(beam.end, 1.0)
    scene.set_velocity(beam.end, (1.695, 0))
    return scene, beam


def free_flight(elements=5, degree=1, section=FLYING, turn=0.0, shift=(0.0, 0.0)):
    """Planar flying spaghetti, pushed and turned at one end for 2.5 s, in a turned frame."""
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    scene = fb.Scene()
    ends = [R @ point + shift for point in ((6, 0), (0, 8))]
    beam = scene.add_beam(ends, section, elements=elements, degree=degree)
    scene.add_force(beam.start, lambda t: R @ (8.0 * (t < 2.5), 0.0))
    scene.add_moment(beam.start, lambda t: -80.0 * (t < 2.5))
    return scene, beam


def relative_drift(values):
    """Largest deviation from the first value, relative to it."""
    return abs(values - values[0]).max() / abs(values[0])


def grid(scene, cells, high, section, **kind):
    """A square lattice of struts of length 1 in a scene; its nodes by their places."""
    number = np.arange((cells + 1) * (high + 1)).reshape(cells + 1, high + 1)
    along, across = (number[:-1], number[1:]), (number[:, :-1], number[:, 1:])
    ends = [np.stack(pair, axis=-1).reshape(-1, 2) for pair in (along, across)]
    beams = scene.add_mesh(np.argwhere(number >= 0), np.concatenate(ends), section, **kind)
    return np.reshape(beams.nodes, number.shape)


def lattice(cells=5):
    """A square lattice, whose unknowns no order puts in a narrow band."""
    scene = fb.Scene(gravity=(0, -9.81))
    nodes = grid(scene, cells, cells, FLYING, elements=2)
    scene.pin(nodes[0, 0])
    scene.pin(nodes[cells, 0])
    return scene


# -- Materials with internal variables -------------------------------------------------------------

EA, GA, EI, HARDENING, YIELD = 2e4, 8e3, 6.0, 1.5, 0.3
STIFF, SOFT, TAU = 4.0, 2.0, 0.5


def zener_energy(eps, gamma, kappa, a):
    """A spring beside a spring with a dashpot, in bending; a[0] is the dashpot's curvature."""
    stretch = EA / 2 * eps**2 + GA / 2 * gamma**2
    return stretch + STIFF / 2 * kappa**2 + SOFT / 2 * (kappa - a[0]) ** 2


def zener_flow(old, strains0, strains, dt):
    """With the relaxation time TAU."""
    return [(old[0] + dt / TAU * strains[2]) / (1 + dt / TAU)]


def plastic_energy(eps, gamma, kappa, a):
    """Kinematic hardening: a[0] is the plastic curvature."""
    elastic = EA / 2 * eps**2 + GA / 2 * gamma**2 + EI / 2 * (kappa - a[0]) ** 2
    return elastic + HARDENING / 2 * a[0] ** 2


def plastic_flow(old, strains0, strains, dt):
    """Return to the yield surface."""
    trial = EI * (strains[2] - old[0]) - HARDENING * old[0]
    excess = ufl.max_value(abs(trial) - YIELD, 0)
    return [old[0] + ufl.sign(trial) * excess / (EI + HARDENING)]


def forces_of_flow(strains, stiffness, hardening, limit, kinematic=True):
    """Forces along a path of strains, from the corners of the yield surface."""
    force, centre, before, forces = 0.0, 0.0, 0.0, []
    for x in strains:
        trial = force + stiffness * (x - before)
        excess = max(abs(trial - centre) - limit, 0.0) / (stiffness + hardening)
        direction = np.sign(trial - centre)
        force = trial - stiffness * direction * excess
        if kinematic:
            centre += hardening * direction * excess
        else:
            limit += hardening * excess
        before = x
        forces.append(force)
    return np.array(forces)


def with_variables(energy, update, names=("a",), **data):
    """A section with internal variables."""
    return fb.Section(strain_energy=energy, internal=fb.InternalVariables(names, update), **data)


INERTIA = {"rhoA": 1.0, "rhoI": 0.01}
ZENER = with_variables(zener_energy, zener_flow, ("dashpot",), **INERTIA)
PLASTIC = with_variables(plastic_energy, plastic_flow, ("plastic curvature",), **INERTIA)


def spinner(spin):
    """A free stout beam that spins about its middle."""
    scene = fb.Scene()
    section = fb.Section(EA=1e6, GA=1e6, EI=1e4, rhoA=1.0, rhoI=0.1)
    beam = scene.add_beam([(-1, 0), (1, 0)], section, elements=2)
    scene.set_velocity(beam, lambda x, y: (-spin * y, spin * x), spin=spin)
    return scene, beam
