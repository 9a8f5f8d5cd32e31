"""Meshes from arrays: frames with rigid joints and trusses with pins, by statics and by beams."""

import copy

import numpy as np
import pytest
from pytest import approx

import fx_beam as fb

SECTION = fb.Section(EA=1e3, GA=1e3, EI=10.0, rhoA=1.0, rhoI=1e-3)
# Two panels of a truss: chords, posts and diagonals.
POINTS = np.array([(0, 0), (0, 1), (1, 0), (1, 1.2), (2.5, 0.4)])
CELLS = np.array([(0, 2), (1, 3), (2, 1), (2, 3), (3, 4), (2, 4)])


def shaken(points, cells, **options):
    """Positions (n, 2) of the points of a mesh that is held at two places and falls, at the end."""
    scene = fb.Scene(gravity=(1.0, -9.81))
    beams = scene.add_mesh(points, cells, SECTION, **options)
    for node in beams.nodes:
        if node.x == 0:
            scene.pin(node)
    solution = fb.simulate(scene, dt=0.01, t_end=0.2)
    return np.array([solution.position(node)[-1] for node in beams.nodes])


@pytest.mark.parametrize("joints", ["rigid", "pin"])
def test_a_moment_at_a_cross_is_carried_by_the_arms_that_are_fixed_to_its_node(joints):
    """Of a clamped arm M = EI (4 + f) / (L (1 + f)) for a unit turn, f = 12 EI / (GA L^2)."""
    scene, moment, L = fb.Scene(), 1e-4, 2.0
    section = fb.Section(EA=1e6, GA=400.0, EI=10.0)
    points = [(L, 0), (0, L), (0, 0), (-L, 0), (0, -L)]
    cells = [(0, 2), (2, 1), (2, 3), (4, 2)]
    beams = scene.add_mesh(points, cells, section, degree=3, joints=joints)
    for node in (beams.nodes[i] for i in (0, 1, 3, 4)):
        scene.clamp(node)
    scene.add_moment(beams.nodes[2], moment)
    f = 12 * 10.0 / (400.0 * L**2)
    arms = 4 if joints == "rigid" else 1
    turn = moment / (arms * 10.0 * (4 + f) / (L * (1 + f)))
    # With pins the other arms hold the node by their EA / L, not rigidly.
    assert fb.static(scene).rotation(beams.nodes[2])[-1] == approx(turn, rel=1e-4)


def test_bars_of_a_pinned_truss_have_the_forces_of_statics():
    """Joints in balance: the sum of N along the bars and of the load is zero at each free point."""
    scene = fb.Scene()
    beams = scene.add_mesh(POINTS, CELLS, fb.Section(EA=1e9, GA=1e9, EI=1e3), joints="pin")
    for node in beams.nodes[:2]:
        scene.pin(node)
    load = np.array([[0, 0], [3.0, 5.0], [20.0, -70.0]])
    for node, force in zip(beams.nodes[2:], load, strict=True):
        scene.add_force(node, force)
    ways = POINTS[CELLS[:, 1]] - POINTS[CELLS[:, 0]]
    along = ways / np.hypot(*ways.T)[:, None]
    balance = np.zeros((len(POINTS), 2, len(CELLS)))
    for k, (a, b) in enumerate(CELLS):
        balance[a, :, k], balance[b, :, k] = along[k], -along[k]
    expected = np.linalg.solve(balance[2:].reshape(6, 6), -load.ravel())
    truss = fb.static(scene)
    forces = [truss.resultants(beam).N[-1, 0] for beam in beams]
    assert forces == approx(expected, rel=1e-5)


@pytest.mark.parametrize("joints", ["rigid", "pin"])
def test_the_order_and_direction_of_cells_and_points_make_no_difference(joints):
    straight = shaken(POINTS, CELLS, elements=2, joints=joints)
    rng = np.random.default_rng(0)
    order, cells = rng.permutation(len(POINTS)), rng.permutation(CELLS)
    place = np.argsort(order)  # of each former point
    turned = [pair[::-1] if k % 2 else pair for k, pair in enumerate(place[cells])]
    assert shaken(POINTS[order], turned, elements=2, joints=joints) == approx(
        straight[order], abs=1e-9
    )
    assert abs(straight - POINTS).max() > 0.01


@pytest.mark.parametrize("joints", ["rigid", "pin"])
def test_a_mesh_moves_as_beams_that_are_added_one_by_one(joints):
    elements = [1, 2, 1, 3, 1, 2]
    scene, nodes, own = fb.Scene(gravity=(1.0, -9.81)), {}, joints == "pin"
    for pair, number in zip(CELLS.tolist(), elements, strict=True):
        ends = [tuple(POINTS[i]) if own else nodes.get(i, tuple(POINTS[i])) for i in pair]
        beam = scene.add_beam(ends, SECTION, number, 2)
        for i, node in zip(pair, (beam.start, beam.end), strict=True):
            if own and i in nodes:
                scene.add_joint(fb.Revolute(nodes[i], node))
            nodes.setdefault(i, node)
    for i in (0, 1):
        scene.pin(nodes[i])
    solution = fb.simulate(scene, dt=0.01, t_end=0.2)
    expected = np.array([solution.position(nodes[i])[-1] for i in range(len(POINTS))])
    computed = shaken(POINTS, CELLS, elements=elements, degree=2, joints=joints)
    assert computed == approx(expected, abs=1e-9)


def test_beams_are_those_of_the_cells_and_nodes_those_of_the_points():
    thin = fb.Section(EA=1e5, GA=1e5, EI=1.0)
    scene = fb.Scene()
    before = scene.add_beam([(5, 5), (6, 5)], SECTION, elements=1)
    tags = np.array(["thick", "thin", "thin", "thin", "thick", "thick"])
    sections = {"thick": SECTION, "thin": thin}
    beams = scene.add_mesh(POINTS, CELLS, sections, [1, 2, 3, 1, 2, 3], joints="pin", tags=tags)
    assert scene.beams == [before, *beams]
    assert repr(beams) == "<6 beams between 5 points>"
    assert [beam.elements for beam in beams] == [1, 2, 3, 1, 2, 3]
    assert [beam.section for beam in beams] == [sections[tag] for tag in tags]
    assert [(node.x, node.y) for node in beams.nodes] == [*map(tuple, POINTS)]
    for beam, (a, b) in zip(beams, CELLS, strict=True):
        ends = [(node.x, node.y) for node in (beam.start, beam.end)]
        assert ends == [tuple(POINTS[a]), tuple(POINTS[b])]
        assert beam.length == approx(np.hypot(*(POINTS[b] - POINTS[a])), rel=1e-15)
    assert beams[2].node(1 / 3).x == approx(2 / 3, abs=1e-15)
    assert copy.deepcopy(scene).nodes[beams.nodes[3].number] == beams.nodes[3]


def test_points_at_one_place_are_not_joined():
    scene = fb.Scene()
    beams = scene.add_mesh([(0, 0), (1, 0), (1, 0), (2, 0)], [(0, 1), (2, 3)], SECTION)
    assert beams.nodes[1] is beams[0].end
    assert beams.nodes[2] is beams[1].start is not beams[0].end
