"""Meshes from arrays: frames with rigid joints and trusses with pins, by statics and by beams."""

import copy

import numpy as np
import pytest
from pytest import approx
from scenes import assert_refused

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
    other = shaken(POINTS[order], turned, elements=2, joints=joints)
    assert other == approx(straight[order], abs=1e-9)
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


# -- Drawings whose points are near each other, or near a line -------------------------------------

# A girder of which the middle carries a post by an end near it, and a brace with ends of its own.
DRAWN = np.array([(0, 0), (4, 0), (2, 1e-4), (2, 3), (-1e-4, 0), (2, 3.0001)])
LINES = np.array([(0, 1), (3, 2), (4, 5)])


def loaded(nodes, scene):
    """Displacement of the top of the post, clamped at the left and pushed at the right."""
    scene.clamp(nodes[0])
    scene.add_force(nodes[1], (3.0, -5.0))
    return fb.static(scene).displacement(nodes[3])[-1]


def test_lines_that_end_on_others_are_joined_as_by_common_nodes(caplog):
    scene = fb.Scene()
    beams = scene.add_mesh(DRAWN, LINES, SECTION, elements=4, join=1e-3)
    drawn = loaded(beams.nodes, scene)
    assert beams.cells == [0, 0, 1, 2] and [b.elements for b in beams] == [2, 2, 4, 4]
    assert beams.nodes[4] is beams.nodes[0] and beams.nodes[5] is beams.nodes[3]
    scene = fb.Scene()
    left = scene.add_beam([(0, 0), (2, 0)], SECTION, 2)
    right = scene.add_beam([left.end, (4, 0)], SECTION, 2)
    post = scene.add_beam([left.end, (2, 3)], SECTION, 4)
    scene.add_beam([left.start, post.end], SECTION, 4)
    exact = loaded([left.start, right.end, None, post.end], scene)
    assert drawn == approx(exact, rel=1e-3)
    assert "not joined" not in caplog.text


@pytest.mark.parametrize("joints", ["rigid", "pin"])
def test_a_mesh_without_such_points_is_the_same_with_join(joints):
    options = {"elements": [1, 2, 1, 3, 1, 2], "joints": joints}
    assert (shaken(POINTS, CELLS, join=0.1, **options) == shaken(POINTS, CELLS, **options)).all()


def test_parts_of_a_cell_have_its_section_and_at_least_one_element():
    thin, scene = fb.Section(EA=1e5, GA=1e5, EI=1.0), fb.Scene()
    points = [(0, 0), (10, 0), (1, 0), (1, 1), (5, 0), (5, 1)]
    cells, tags = [(0, 1), (2, 3), (4, 5)], ["a", "b", "b"]
    sections = {"a": SECTION, "b": thin}
    beams = scene.add_mesh(points, cells, sections, [5, 1, 1], tags=tags, join=1e-6)
    assert [beam.section for beam in beams] == [SECTION, SECTION, SECTION, thin, thin]
    assert [beam.elements for beam in beams] == [1, 2, 2, 1, 1]


def test_lines_shorter_than_the_tolerance_are_points():
    scene = fb.Scene()
    beams = scene.add_mesh(
        [(0, 0), (1, 0), (1, 1e-4), (1, 1)], [(0, 1), (1, 2), (2, 3)], SECTION, join=1e-3
    )
    assert beams.cells == [0, 2] and beams.nodes[1] is beams.nodes[2]


def test_derivatives_go_through_points_that_are_joined():
    def build(x):
        scene = fb.Scene()
        points = [(0, 0), (4, 0), (x[0], 0), (x[0], -1)]
        nodes = scene.add_mesh(points, [(0, 1), (2, 3)], SECTION, elements=2, join=1e-6).nodes
        scene.clamp(nodes[0])
        scene.clamp(nodes[3])
        scene.add_force(nodes[1], (0.0, -1e-3))
        return scene, {"tip": fb.Output("displacement", nodes[1], "y")}

    run = fb.StaticResponse(build)
    tips = run([2.0])[1]["tip"]
    (slope,) = run.vjp({"tip": np.eye(len(tips))[-1]})
    places = np.array([2.0 - 1e-4, 2.0 + 1e-4])
    low, high = (run([x])[1]["tip"][-1] for x in places)
    assert slope == approx((high - low) / 2e-4, rel=1e-5)


@pytest.mark.parametrize(
    ("points", "cells", "words"),
    [
        (
            [(0, 0), (1, 0), (0.5, 0), (2, 0)],
            [(0, 1), (2, 3)],
            r"cells \[0, 1\] lie on one another",
        ),
        ([(0, 0), (1, 0), (0, 1e-4), (1, 1e-4)], [(0, 1), (3, 2)], r"cells \[0, 1\] lie"),
        ([(0, 0), (1, 0), (2, 0), (2, 1e-4)], [(0, 1), (2, 3)], "cells at point 2 are shorter"),
        ([(i / 1e3, 0) for i in range(9)], [(i, i + 1) for i in range(8)], "one point of 0 and 3"),
    ],
)
def test_a_drawing_that_cannot_be_joined_is_refused(points, cells, words):
    assert_refused(words, fb.Scene().add_mesh, points, cells, SECTION, join=1e-3)
