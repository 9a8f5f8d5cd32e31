"""Meshes of beams from arrays: trusses and frames as they are by hand, in any order of cells."""

import math
import random

import numpy as np
import pytest

import fx_beam as fb

SECTION = fb.Section(EA=1e9, GA=1e9, EI=1e6, rhoA=1.0, rhoI=0.1)
SOFT = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.1)
SQUARE = [(0, 0), (1, 0), (1, 1), (0, 1)]
CELLS = [(0, 1), (1, 2), (2, 3), (3, 0), (0, 2)]


def test_a_truss_has_the_forces_of_its_joints():
    """Equilibrium of the top: 2 N sin(a) = -P; of a foot: S = -N cos(a)."""
    height, load = 0.75, 10.0
    scene = fb.Scene()
    beams = scene.add_mesh(
        [(0, 0), (1, 0), (0.5, height)], [(0, 1), (1, 2), (2, 0)], SECTION, joints="pin"
    )
    scene.pin(beams.nodes[0])
    scene.fix(beams.nodes[1], "y")
    scene.add_force(beams.nodes[2], (0, -load))
    solution = fb.static(scene)
    a = math.atan2(height, 0.5)
    inclined = -load / (2 * math.sin(a))
    expected = -inclined * math.cos(a), inclined, inclined
    for beam, N in zip(beams, expected, strict=True):
        found = solution.resultants(beam)
        assert found.N[-1] == pytest.approx(N, rel=1e-6)
        assert abs(found.M[-1]).max() < 1e-6 * load


def test_rigid_joints_of_a_frame_keep_its_angles():
    """A clamped cross with a couple M in its middle: four arms of stiffness 4 EI / L share it."""
    scene, couple = fb.Scene(), 1e-3
    points = [(0, 0), (1, 0), (0, 1), (-1, 0), (0, -1)]
    beams = scene.add_mesh(points, [(0, i) for i in range(1, 5)], SOFT, elements=64)
    for i in range(1, 5):
        scene.clamp(beams.nodes[i])
    scene.add_moment(beams.nodes[0], couple)
    shear = 1 + 12 * 10.0 / 1e4  # Timoshenko: k = 4 EI/L (1 + phi/4) / (1 + phi)
    stiffness = 4 * 10.0 * (1 + (shear - 1) / 4) / shear
    turned = fb.static(scene).rotation(beams.nodes[0])[-1]
    assert turned == pytest.approx(couple / (4 * stiffness), rel=5e-4)


def moved(cells, joints="rigid", elements=1, tags=None, section=SOFT):
    scene = fb.Scene(gravity=(0, -9.81))
    beams = scene.add_mesh(SQUARE, cells, section, elements, joints=joints, tags=tags)
    scene.pin(beams.nodes[0])
    solution = fb.simulate(scene, dt=0.01, t_end=0.1)
    return np.array([solution.displacement(node)[-1] for node in beams.nodes])


@pytest.mark.parametrize("joints", ["rigid", "pin"])
def test_neither_the_order_of_cells_nor_their_direction_matters(joints):
    first = moved(CELLS, joints)
    assert abs(first).max() > 1e-3
    shuffled = [cell[::-1] if k % 2 else cell for k, cell in enumerate(CELLS)]
    random.Random(3).shuffle(shuffled)
    np.testing.assert_allclose(moved(shuffled, joints), first, rtol=0, atol=1e-11)


def test_a_mesh_is_the_beams_that_share_nodes():
    scene, nodes = fb.Scene(gravity=(0, -9.81)), {}
    for a, b in CELLS:
        beam = scene.add_beam([nodes.get(a, SQUARE[a]), nodes.get(b, SQUARE[b])], SOFT, 2)
        nodes[a], nodes[b] = beam.start, beam.end
    scene.pin(nodes[0])
    by_hand = fb.simulate(scene, dt=0.01, t_end=0.1)
    last = [by_hand.displacement(nodes[i])[-1] for i in range(4)]
    np.testing.assert_allclose(moved(CELLS, elements=2), last, rtol=0, atol=1e-13)


def test_tags_choose_sections():
    tags = np.array([7, 7, 7, 7, 2])
    stiff = moved(CELLS, tags=tags, section={7: SOFT, 2: SECTION})
    scene = fb.Scene()
    beams = scene.add_mesh(SQUARE, CELLS, {7: SOFT, 2: SECTION}, tags=tags)
    assert [beam.section for beam in beams] == [SOFT] * 4 + [SECTION]
    assert abs(stiff - moved(CELLS)).max() > 1e-4


def test_points_of_any_table_will_do():
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame(SQUARE, columns=["x", "y"])
    beams = fb.Scene().add_mesh(table, np.array(CELLS, dtype=np.int32), SOFT)
    assert [(node.x, node.y) for node in beams.nodes] == SQUARE
    assert [(beam.start, beam.end) for beam in beams] == [
        (beams.nodes[a], beams.nodes[b]) for a, b in CELLS
    ]


def test_a_mesh_may_be_joined_to_what_is_there():
    scene = fb.Scene()
    first = scene.add_mesh(SQUARE, CELLS, SOFT)
    second = scene.add_mesh([(1, 1), (2, 1)], [(0, 1)], SOFT)
    scene.add_joint(fb.Rigid(first.nodes[2], second.nodes[0]))
    scene.clamp(first.nodes[0])
    scene.add_force(second.nodes[1], (0, -1.0))
    assert fb.static(scene).displacement(second.nodes[1])[-1, 1] < -1e-3


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"points": [(0, 0), (1, math.nan)]}, "finite"),
        ({"points": [0, 1]}, "points = "),
        ({"cells": [(0, 1.5)]}, "cells = "),
        ({"cells": []}, "cells = "),
        ({"cells": [(0, 4), (1, 2), (2, 3)]}, "cell 0 lies between the points .0, 4."),
        ({"cells": [(0, 1), (1, 2), (2, 0)]}, r"point 3 at \(0, 1\) belongs to no cell"),
        ({"cells": [*CELLS, (1, 0)]}, "several cells lie between the points"),
        ({"points": [(0, 0), (1, 0), (1, 0), (0, 1)]}, "cell 1 has no length"),
        ({"section": 3}, "section = 3"),
        ({"tags": [1, 1, 1, 1, 2]}, "a dictionary of sections"),
        ({"section": {1: SOFT}, "tags": [1, 1]}, "one for each cell"),
        ({"section": {1: SOFT}, "tags": [1, 1, 1, 1, 2]}, "cell 4 has the tag 2"),
        ({"joints": "hinge"}, "joints = 'hinge'"),
        ({"degree": 4}, "degree = 4"),
        ({"elements": 0}, "elements"),
    ],
)
def test_what_is_no_mesh_is_refused_with_a_sentence(given, says):
    scene = fb.Scene()
    with pytest.raises(fb.SceneError, match=says):
        scene.add_mesh(**{"points": SQUARE, "cells": CELLS, "section": SOFT} | given)
    assert not scene.beams and not scene.nodes
