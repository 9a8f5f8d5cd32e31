"""Springs, dampers and stops to the ground, and beds, against closed forms."""

import tracemalloc

import numpy as np
import pytest
from scenes import pinned_bar

import fx_beam as fb

SECTION = fb.Section(EA=1e7, GA=1e11, EI=100.0, rhoA=2.0, rhoI=1e-3)


def held_body(axis=(1, 0), **laws):
    scene = fb.Scene()
    body = scene.add_body((1, 2), mass=2.0, inertia=0.5).centre
    return scene, body, scene.add_spring(body, axis=axis, **laws)


def test_a_body_on_three_springs_vibrates_with_the_root_of_stiffness_by_mass():
    springs = {"x": fb.Spring(50.0), "y": fb.Spring(200.0), "rotation": fb.Spring(8.0)}
    scene, *_ = held_body(axis=(3, 4), **springs)
    modes = fb.modes(scene)
    assert 2 * np.pi * modes.frequencies == pytest.approx([4.0, 5.0, 10.0], rel=1e-12)


def test_forces_in_statics_are_those_of_the_loads_along_the_axis():
    springs = {"x": fb.Spring(50.0), "y": fb.Spring(200.0, rest=0.1), "rotation": fb.Spring(8.0)}
    scene, body, held = held_body(axis=(3, 4), **springs)
    scene.add_force(body, (10.0, -5.0))
    scene.add_moment(body, 0.4)
    rest = fb.static(scene, load_steps=1)
    along, left = np.array([0.6, 0.8]), np.array([-0.8, 0.6])
    for spring, force in zip(held, (along @ (10, -5), left @ (10, -5), 0.4), strict=True):
        assert rest.joint(spring).force[-1] == pytest.approx(force)
    assert rest.joint(held.y).length[-1] == pytest.approx(left @ (10, -5) / 200 + 0.1)
    assert rest.rotation(body)[-1] == pytest.approx(0.05)


def test_a_damper_with_a_law_of_its_own_brakes_a_body():
    """m v' = -c v^2: v = v0 / (1 + c v0 t / m)."""
    scene, body, _ = held_body(x=fb.Damper(law=lambda rate: 3 * abs(rate) * rate))
    scene.set_velocity(body, (4.0, 0.0))
    braked = fb.simulate(scene, dt=1e-3, t_end=0.5)
    assert braked.velocity(body)[-1, 0] == pytest.approx(4.0 / (1 + 3 * 4 * 0.5 / 2), rel=1e-5)


def test_a_cantilever_in_a_rotational_spring():
    """Its end sinks by F l^3 / (3 EI) + F l^2 / k + F l / GA."""
    scene, beam = pinned_bar((2, 0), fb.Section(EA=1e4, GA=1e4, EI=100.0), elements=2, degree=3)
    scene.add_spring(beam.start, rotation=fb.Spring(40.0))
    scene.add_force(beam.end, (0, -1e-3))
    sunk = fb.static(scene, linear=True).displacement(beam.end)[-1, 1]
    assert sunk == pytest.approx(-1e-3 * (8 / 300 + 4 / 40 + 2 / 1e4), rel=1e-9)


def on_a_bed(elements, degree=2, **options):
    scene = fb.Scene()
    beam = scene.add_beam([(-5, 0), (5, 0)], SECTION, elements, degree=degree)
    return scene, beam, scene.add_bed(beam, normal=6400.0, **options)


@pytest.mark.parametrize(("degree", "order"), [(1, 2), (2, 4)])
def test_a_long_beam_on_a_bed_sinks_as_hetenyi_says(degree, order):
    """P b / (2 k) with b^4 = k / (4 EI), with the order of the elements."""
    errors = []
    for elements in (40, 80):
        scene, beam, bed = on_a_bed(elements, degree, tangential=1.0)
        scene.add_force(beam.node(0.5), (0, -1.0))
        rest = fb.static(scene, load_steps=1)
        errors.append(rest.displacement(beam.node(0.5))[-1, 1] * 2 * 6400 / 2 + 1)
        assert rest.joint(bed.normal).force[-1] == pytest.approx(-1.0)
    assert abs(errors[-1]) < 10.0 ** (-1 - degree)
    assert np.log2(errors[0] / errors[1]) == pytest.approx(order, abs=0.5)


def test_a_beam_on_a_bed_moves_as_a_whole_with_the_root_of_stiffness_by_mass():
    scene, *_ = on_a_bed(8, tangential=2 * 25.0)
    assert 2 * np.pi * fb.modes(scene, n=1).frequencies[0] == pytest.approx(5.0)


def test_a_ring_on_a_bed_is_pressed_evenly():
    """The bed of a ring under the pressure p yields by p / (k + EA / r^2)."""
    scene = fb.Scene()
    half = [fb.arc((1, 0), (0, 1), (-1, 0)), fb.arc((-1, 0), (0, -1), (1, 0))]
    section = fb.Section(EA=100.0, GA=1e4, EI=1.0)
    first = scene.add_beam(half[0], section, elements=16, degree=2)
    second = scene.add_beam(half[1], section, elements=16, degree=2)
    scene.add_joint(fb.Rigid(first.end, second.start))
    scene.add_joint(fb.Rigid(second.end, first.start))
    for beam in (first, second):
        scene.add_bed(beam, normal=300.0, tangential=1.0)
        way = 1 if beam is first else -1
        pressure = lambda s, way=way: (1e-3 * way * np.cos(s), 1e-3 * way * np.sin(s))  # noqa: E731
        scene.add_line_load(beam, pressure, of="arc length")
    out = fb.static(scene, linear=True).displacement(first.node(0.5))[-1, 1]
    assert out == pytest.approx(1e-3 / 400, rel=1e-3)


def test_a_bed_that_only_pushes_lets_the_ends_lift():
    scene, beam, bed = on_a_bed(80, pushes_only=True)
    scene.fix(beam.start, "x")
    scene.add_force(beam.node(0.5), (0, -1.0))
    rest = fb.static(scene, load_steps=1)
    sunk = rest.joint(bed.normal).length[-1]
    assert sunk.max() > 0 > sunk.min()
    assert rest.joint(bed.normal).force[-1] == pytest.approx(-1.0)
    # The pressure is that of the part which is down.
    lengths = bed.normal.lengths
    assert 6400 * lengths @ np.minimum(sunk, 0) == pytest.approx(-1.0)


def test_a_bed_that_only_holds_along_the_beam_may_be_said_to_push_only():
    scene = fb.Scene()
    bed = scene.add_bed(
        scene.add_beam([(0, 0), (1, 0)], SECTION, elements=1), tangential=5.0, pushes_only=True
    )
    assert bed.normal is None and bed.tangential.on.spring.stiffness == 5.0


def test_springs_are_removed_alone_and_with_what_they_hold():
    scene, body, held = held_body(x=fb.Spring(50.0), y=fb.Spring(200.0), rotation=fb.Spring(8.0))
    scene.remove(held.x)
    assert fb.modes(scene).frequencies[0] == 0
    beam = scene.add_beam([(0, 0), (1, 0)], SECTION, elements=1)
    scene.add_bed(beam, normal=1.0)
    scene.remove(beam)
    assert len(scene.forces_between) == 2


def test_a_bed_takes_memory_in_proportion_to_the_elements():
    """A square of the rows of supports and springs would be 3.2 GB."""
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (100, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e3), elements=10_000)
    scene.fix(beam.start, "x")
    scene.add_bed(beam, normal=1e3)
    scene.add_line_load(beam, (0, -1.0))
    tracemalloc.start()
    solution = fb.static(scene, linear=True)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert most < 5e8
    assert solution.displacement(beam.node(0.5))[-1, 1] == pytest.approx(-1e-3, rel=1e-3)
