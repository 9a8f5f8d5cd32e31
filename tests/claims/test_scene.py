"""Geometry and joints of a scene: where nodes lie, what they share, and that it moves so."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scenes import one_bar

import fx_beam as fb

SECTION = fb.Section(EA=1e4, GA=1e4, EI=100.0, rhoA=1.0, rhoI=0.1)


def position(node):
    return node.x, node.y


def turned(angle, vectors):
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(vectors) @ [[c, s], [-s, c]]


# -- Polylines -------------------------------------------------------------------------------


def test_ends_and_nodes_of_a_straight_beam_lie_where_they_were_given():
    beam = fb.Scene().add_beam([(1, 2), (4, 6)], SECTION, elements=5)
    assert position(beam.start) == (1, 2)
    assert position(beam.end) == (4, 6)
    assert beam.elements == 5
    assert beam.length == pytest.approx(5, rel=1e-15)
    assert beam.s == pytest.approx(np.arange(6.0), rel=1e-14)
    assert [position(node) for node in beam.nodes] == [
        pytest.approx((1 + 0.6 * k, 2 + 0.8 * k), rel=1e-15) for k in range(6)
    ]


@pytest.mark.parametrize("labels", [["x", "y"], [1, 0], [3, 4]])
def test_rows_of_a_table_are_points_whatever_its_columns_are_called(labels):
    pandas = pytest.importorskip("pandas")
    table = pandas.DataFrame([[0.0, 5.0], [1.0, 7.0]], columns=labels)
    beam = fb.Scene().add_beam([row for _, row in table.iterrows()], SECTION, elements=2)
    assert [(node.x, node.y) for node in beam.nodes] == [(0, 5), (0.5, 6), (1, 7)]


def test_elements_given_for_each_piece_are_taken_as_given():
    beam = fb.Scene().add_beam([(0, 0), (4, 0), (4, 3)], SECTION, elements=[1, 3])
    assert [position(node) for node in beam.nodes] == [(0, 0), (4, 0), (4, 1), (4, 2), (4, 3)]
    assert beam.length == 7


def test_a_fraction_of_the_arc_length_finds_the_node_there():
    beam = fb.Scene().add_beam([(0, 0), (3, 0), (3, 1)], SECTION, elements=[3, 2])
    assert [beam.node(f) for f in (0, 0.25, 0.5, 0.75, 0.875, 1)] == list(beam.nodes)
    assert beam.node(0) is beam.start
    assert beam.node(1) is beam.end
    rounded = fb.Scene().add_beam([(0, 0), (0.7, 0)], SECTION, elements=10)
    assert [rounded.node(0.1 * k) for k in range(11)] == list(rounded.nodes)


@given(
    lengths=st.lists(st.floats(0.01, 100), min_size=1, max_size=6),
    turns=st.lists(st.floats(-3, 3), min_size=6, max_size=6),
    extra=st.integers(0, 30),
)
def test_elements_are_spread_so_that_the_longest_is_as_short_as_possible(lengths, turns, extra):
    angles = np.cumsum(turns)[: len(lengths)]
    steps = np.array(lengths)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    corners = np.vstack([[0.0, 0.0], np.cumsum(steps, axis=0)])
    total = len(lengths) + extra
    beam = fb.Scene().add_beam(corners, SECTION, elements=total)

    assert beam.elements == total
    places = [position(node) for node in beam.nodes]
    at_corner = [places.index(tuple(corner)) for corner in corners]
    counts = np.diff(at_corner)
    assert (counts >= 1).all()
    # Whatever piece gave up an element, one would become no shorter than the longest is now.
    longest = (np.array(lengths) / counts).max()
    shared = counts > 1
    assert (np.array(lengths)[shared] / (counts[shared] - 1) >= longest * (1 - 1e-9)).all()
    # Elements of a piece are equally long, and together as long as the pieces.
    element = np.diff(beam.s)
    assert element == pytest.approx(np.repeat(lengths / counts, counts), rel=1e-9)
    assert beam.length == pytest.approx(sum(lengths), rel=1e-12)


# -- Shared and separate nodes ---------------------------------------------------------------


def test_beams_share_the_nodes_that_they_are_given_and_no_others():
    scene, left = one_bar((0, 3), SECTION, elements=3, name="beam 2")
    top = scene.add_beam([left.end, (4, 3)], SECTION, elements=4)
    closing = scene.add_beam([top.end, left.start], SECTION, elements=3, name="beam 5")
    assert left.end is top.start and closing.end is left.start
    assert len(scene.nodes) == 10
    assert [node.number for node in scene.nodes] == list(range(10))
    apart = scene.add_beam([(4, 3), (5, 3)], SECTION, elements=1)  # at the place of a node
    assert position(apart.start) == position(top.end) and apart.start != top.end
    names = [beam.name for beam in scene.beams]
    assert len(set(names)) == 4 and all(name.startswith("beam ") for name in names)


def test_a_beam_joins_another_at_a_node_between_its_ends():
    scene, bar = one_bar((4, 0), SECTION, elements=4)
    stem = scene.add_beam([(1, -2), bar.node(0.25), (1, 2)], SECTION, elements=2)
    assert stem.nodes[1] is bar.nodes[1]
    assert len(scene.nodes) == 5 + 2


# -- The mesh --------------------------------------------------------------------------------


def tangle(degree):
    """Beams that cross, branch, coincide and stand apart: the joined groups, and their points."""
    scene = fb.Scene()
    points_of = {}

    def add(corners, pieces, shared=()):
        nodes = [dict(shared).get(k, corner) for k, corner in enumerate(corners)]
        beam = scene.add_beam(nodes, SECTION, elements=pieces, degree=degree)
        points = [np.atleast_2d(corners[0])]
        for a, b, elements in zip(corners[:-1], corners[1:], pieces, strict=True):
            points.append(np.linspace(a, b, elements * degree + 1)[1:])
        points_of[beam.name] = np.concatenate(points)
        return beam

    far = add([(9, 9), (11, 9)], [2])
    bar = add([(4, 0), (0, 0)], [4])
    crossing = add([(1, -1), (1.7, 2.3)], [3])
    stem = add([(1, 0), (1, -2), (-1, -2)], [2, 1], {0: bar.node(0.75)})
    twin = add([(0, 0), (4, 0)], [4])
    back = add([(-1, -2), (0, 0)], [2], {0: stem.end, 1: bar.end})
    hook = add([(11, 9), (12, 10), (9, 9)], [1, 2], {0: far.end, 2: far.start})
    return scene, [(far, hook), (bar, stem, back), (crossing,), (twin,)], points_of


@pytest.mark.parametrize("degree", [1, 3])
def test_every_beam_lies_at_its_points_and_moves_there_as_a_whole(degree):
    # Each group turns rigidly about its own point at its own rate: a node at a wrong place in any
    # table would tear it apart.
    scene, groups, points_of = tangle(degree)
    spins = (1.0, -0.5, 0.7, -0.9)
    centres = np.array([(10, 8), (1, 1), (-2, 3), (2, 0)])
    for group, w, c in zip(groups, spins, centres, strict=True):
        for beam in group:
            turning = lambda x, y, w=w, c=c: (w * (c[1] - y), w * (x - c[0]))  # noqa: E731
            scene.set_velocity(beam, turning, spin=w)
    dt = 1e-4
    solution = fb.simulate(scene, dt=dt, t_end=dt)
    for group, w, c in zip(groups, spins, centres, strict=True):
        for beam in group:
            points, shape = points_of[beam.name], solution.shape(beam)
            assert shape[0] == pytest.approx(points, abs=1e-14)
            assert shape[1] == pytest.approx(turned(w * dt, points - c) + c, abs=1e-7)
            assert abs(shape[1] - shape[0]).max() > 1e-5
            for node, point in zip(beam.nodes, points[::degree], strict=True):
                assert position(node) == pytest.approx(tuple(point), abs=1e-14)
                assert solution.X[node.number] == pytest.approx(point, abs=1e-14)
                assert solution.rotation(node)[1] == pytest.approx(w * dt, rel=1e-4)


# -- Lumped masses ---------------------------------------------------------------------------


def test_masses_and_inertias_at_inner_nodes_count_where_they_are():
    scene, beam = one_bar([(1, 0), (5, 0)], SECTION, elements=4)
    # Another beam shares the node of the masses: they belong to both, once.
    scene.add_beam([beam.node(0.25), (2, 1)], fb.Section(EA=1e4, GA=1e4, EI=100.0), elements=1)
    scene.add_mass(beam.node(0.25), 2.0)
    scene.add_mass(beam.node(0.25), 1.0, inertia=0.3)
    scene.add_mass(beam.node(0.75), 0.0, inertia=0.5)
    w = 0.8
    scene.set_velocity(beam, lambda x, y: (-w * y, w * x), spin=w)
    solution = fb.simulate(scene, dt=0.01, t_end=0.01)
    mass, lever = 4 * 1.0 + 3.0, (4 * 1.0 * 3 + 3.0 * 2) / 7
    inertia = (5**3 - 1**3) / 3 + 4 * 0.1 + 3.0 * 2**2 + 0.3 + 0.5
    assert solution.linear_momentum[0] == pytest.approx([0, mass * w * lever], abs=1e-12)
    assert solution.angular_momentum[0] == pytest.approx(inertia * w, rel=1e-13)
    assert solution.energy.kinetic[0] == pytest.approx(inertia * w**2 / 2, rel=1e-13)


# -- Rigid corners ---------------------------------------------------------------------------


@pytest.mark.parametrize("as_one", [True, False], ids=["polyline", "two beams"])
def test_a_corner_keeps_its_angle(as_one):
    """Massless angle, clamped, with a couple at its end: each leg is an arc, the corner is square.

    A two-node element of a beam in pure bending is the chord of the arc on the mean direction,
    so that both legs are known in closed form for the mesh itself.
    """
    EI, moment, elements = 100.0, 30.0, 6
    scene = fb.Scene()
    section = fb.Section(EA=1e4, GA=1e4, EI=EI)
    if as_one:
        beam = scene.add_beam([(0, 0), (2, 0), (2, 3)], section, elements=[elements] * 2)
        start, bend, end = beam.start, beam.nodes[elements], beam.end
    else:
        arm = scene.add_beam([(0, 0), (2, 0)], section, elements=elements)
        leg = scene.add_beam([arm.end, (2, 3)], section, elements=elements)
        start, bend, end = arm.start, arm.end, leg.end
    scene.clamp(start)
    scene.add_moment(end, moment)
    solution = fb.static(scene, load_steps=1)

    def chords(length, start):
        turn = moment * length / EI / elements
        angles = start + turn * (np.arange(elements) + 0.5)
        return length / elements * np.array([np.cos(angles).sum(), np.sin(angles).sum()])

    at_corner = moment * 2 / EI
    corner = chords(2, 0)
    assert solution.rotation(bend)[1] == pytest.approx(at_corner, rel=1e-11)
    assert solution.rotation(end)[1] == pytest.approx(moment * 5 / EI, rel=1e-11)
    assert solution.position(bend)[1] == pytest.approx(corner, rel=1e-11)
    tip = corner + chords(3, math.pi / 2 + at_corner)
    assert solution.position(end)[1] == pytest.approx(tip, rel=1e-11)
