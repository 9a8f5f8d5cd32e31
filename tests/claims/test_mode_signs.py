"""Signs of modes follow a rule, also in imperfect scenes, whose beams keep their fractions."""

import dataclasses

import numpy as np
import pytest
from scenes import clamped_bar, hinged_body, supported_bar

import fx_beam as fb

SECTION = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=1e-4)


def column():
    scene, beam = supported_bar((0, 1), SECTION, 8, 2, held="x", load=(0, -50.0))
    return scene


def first_largest(shape):
    """The first displacement along x or y that is as large as the largest one."""
    moved = shape[:, :2].real.ravel()
    return moved[np.flatnonzero(abs(moved) >= 0.999 * abs(moved).max())[0]]


def test_the_first_of_the_largest_displacements_of_a_mode_is_positive():
    scene = column()
    path = fb.static(scene, load_steps=5)
    damped, beam = clamped_bar((1, 0), SECTION, 4, 2)
    damped.add_joint(fb.Revolute(fb.GROUND, beam.end, damper=fb.Damper(0.1)))
    points = [point.modes for point in path.critical_points]
    for modes in (fb.modes(scene), fb.modes(damped), *points):
        assert all(first_largest(shape) > 0 for shape in modes.shapes)
    shapes = [modes.shapes[0] for modes in points]
    assert len(shapes) == 2 and path.critical_points[0].branch().shape == pytest.approx(shapes[0])


def test_the_sign_of_a_mode_is_not_that_of_its_vector_nor_of_rounding_errors():
    """The second mode of a column has two displacements that are equal but for their sign."""
    modes = fb.modes(column(), n=2)
    for sign in (1, -1):
        for error in (1e-6, -1e-6):
            signed = sign * modes.shapes.copy()
            signed[1, :4, 0] *= 1 + error  # the other half of the column
            other = dataclasses.replace(modes, shapes=signed)
            assert other.shapes == pytest.approx(modes.shapes, rel=1e-5)


def test_modes_that_only_turn_have_a_sign():
    scene, body, _ = hinged_body((0, 0), 1.0, 1.0, {"hinge": (0, 0)}, spring=fb.Spring(3.0))
    assert fb.modes(scene, n=1).shapes[0, 0, 2] == pytest.approx(1.0)


def test_an_imperfect_beam_keeps_its_fractions(tmp_path):
    scene = column()
    second = fb.static(scene, load_steps=5).critical_points[1]
    shape = second.modes.shapes[0] / abs(second.modes.shapes[0, :, 0]).max()
    scene.beams[0].node(0.25)
    crooked = fb.imperfect(scene, second.modes, 0.05)
    again = fb.imperfect(crooked, fb.modes(crooked, n=1), 0.05)
    solution = fb.static(crooked, load_steps=2)
    solution.save(tmp_path / "crooked.npz")
    saved = fb.load(tmp_path / "crooked.npz").beams["beam 1"]
    for beam in (crooked.beams[0], again.beams[0], saved):
        numbers = [beam.node(k / 8).number for k in range(9)]
        assert numbers == [node.number for node in scene.beams[0].nodes]
    node = crooked.beams[0].node(0.25)
    assert node.x == pytest.approx(0.05 * shape[node.number, 0])


def test_a_missing_fraction_is_answered_by_those_that_are_near_in_full():
    beam = fb.Scene().add_beam([(0, 0), (1, 0)], SECTION, elements=48)
    with pytest.raises(
        fb.SceneError, match=r"elements that are near end at \[([^\]]*)\]"
    ) as caught:
        beam.node(0.34)
    near = [float(text) for text in str(caught.value).split("[")[1].split("]")[0].split(",")]
    assert len(near) == 6 and [beam.node(value).number for value in near] == [*range(14, 20)]
