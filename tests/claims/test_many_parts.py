"""Calls of functions, of Python and of C, grow in proportion to the parts of a scene."""

import sys

import pytest
from growth import lattice

import fx_beam as fb


def with_line_loads(scene):
    for beam in scene.beams:
        scene.add_line_load(beam, (0.0, -1.0))
    fb.static(scene, linear=True)


def with_drag_and_velocities(scene):
    for beam in scene.beams:
        scene.add_drag(beam, 0.1)
        scene.set_velocity(beam, (0.0, 0.0))
    fb.simulate(scene, dt=1e-3, t_end=1e-3)


def with_loads_and_strains_inside(scene):
    for beam in scene.beams:
        scene.add_force(beam.at(0.3), (0.0, -1.0))
        scene.add_natural_strain(beam, axial=1e-4)
    fb.static(scene, linear=True)


def with_half_of_the_beams(scene):
    scene.remove(*scene.beams[::2])


def with_outputs_inside(scene):
    solution = fb.simulate(scene, dt=1e-3, t_end=1e-3)
    for beam in scene.beams:
        solution.value(fb.Output("M", beam.at(0.5)))


def calls(analysis, scene):
    """Number of calls of functions."""
    count = 0

    def profile(frame, event, argument):
        nonlocal count
        count += event in ("call", "c_call")

    sys.setprofile(profile)
    try:
        analysis(scene)
    finally:
        sys.setprofile(None)
    return count


@pytest.mark.parametrize(
    "analysis",
    [
        with_line_loads,
        with_drag_and_velocities,
        with_loads_and_strains_inside,
        with_half_of_the_beams,
        with_outputs_inside,
    ],
)
def test_calls_grow_in_proportion_to_the_beams(analysis):
    analysis(lattice(60)[0])  # compiles, and keeps what is kept
    sizes, counts = [], []
    for n in (250, 1000):
        scene, _ = lattice(n)
        sizes.append(len(scene.beams))
        counts.append(calls(analysis, scene))
    assert counts[1] / counts[0] < 1.2 * sizes[1] / sizes[0]


def test_joints_are_locked_by_few_calls_each():
    scene, _ = lattice(1000, "pin")
    joints = scene.joints[::20]

    def lock(scene):
        for joint in joints:
            scene.unlock(scene.lock(joint))

    assert calls(lock, scene) < 1000 * len(joints)
