"""Beams that look joined in a picture, and are not: a warning names them."""

import itertools

import numpy as np
import pytest

import fx_beam as fb

STRIP = fb.Section(EA=1e6, GA=1e6, EI=1e3)
NUMBERS = itertools.count()


def post_and_arm(at, turn=0.0, size=1.0, joined=None):
    """A post, and an arm that begins at a part of its height; names that no other scene has."""
    scene, k = fb.Scene(), next(NUMBERS)
    c, s = np.cos(turn), np.sin(turn)
    place = lambda x, y: (size * (c * x - s * y), size * (s * x + c * y))  # noqa: E731
    post = scene.add_beam([place(0, 0), place(0, 1)], STRIP, elements=7, name=f"post {k}")
    start = post.node(at) if joined == "node" else place(0, at)
    arm = scene.add_beam([start, place(1, at)], STRIP, elements=3, name=f"arm {k}")
    scene.clamp(post.start)
    scene.clamp(arm.end)
    if joined == "joint":
        scene.add_joint(fb.Revolute(post.end, arm.start))
    elif joined == "line":
        scene.add_force_between(post.start, arm.start, spring=fb.Spring(10.0))
    elif joined == "support":
        scene.pin(arm.start)
    elif joined == "slider":
        scene.add_joint(fb.Slider(post, arm.start))
    return scene, post, arm


@pytest.mark.parametrize("turn", [0.0, 0.7])
@pytest.mark.parametrize("size", [1.0, 1e-3, 1e3])
@pytest.mark.parametrize("at", [0.37, 3 / 7, 1.0])
def test_an_end_that_lies_on_another_beam_is_named(caplog, at, turn, size):
    scene, post, arm = post_and_arm(at, turn=turn, size=size)
    fb.static(scene, load_steps=1)
    assert f"beam {arm.name!r} ends at" in caplog.text or f"beam {post.name!r} ends" in caplog.text
    assert post.name in caplog.text and "not joined" in caplog.text
    caplog.clear()
    fb.static(scene, load_steps=1)
    assert "not joined" not in caplog.text  # not in each of many calls


@pytest.mark.parametrize(
    ("at", "joined"),
    [(3 / 7, "node"), (1.0, "joint"), (0.37, "line"), (0.37, "support"), (0.37, "slider")],
)
def test_what_is_joined_or_apart_on_purpose_is_not_named(caplog, at, joined):
    scene, _, _ = post_and_arm(at, joined=joined)
    fb.static(scene, load_steps=1)
    assert "not joined" not in caplog.text


def test_a_cell_of_a_mesh_that_ends_inside_another_is_named(caplog):
    scene = fb.Scene()
    points = [(0, 0), (2.0625, 0), (0.75, 0), (0.75, 1)]
    mesh = scene.add_mesh(points, [(0, 1), (2, 3)], STRIP, elements=2)
    scene.clamp(mesh.nodes[0])
    scene.clamp(mesh.nodes[3])
    fb.static(scene, load_steps=1)
    assert "beam 'beam 2' ends at (0.75, 0) on beam 'beam 1'" in caplog.text


def test_all_beams_of_a_lattice_with_pins_are_joined(caplog):
    scene, n = fb.Scene(), 6
    points = [(i, j) for i in range(n) for j in range(n)]
    cells = [(n * i + j, n * i + j + 1) for i in range(n) for j in range(n - 1)]
    cells += [(n * i + j, n * i + j + n) for i in range(n - 1) for j in range(n)]
    mesh = scene.add_mesh(points, cells, STRIP, elements=2, joints="rigid")
    scene.clamp(mesh.nodes[0])
    fb.static(scene, load_steps=1)
    assert "not joined" not in caplog.text


def test_an_end_that_is_moved_onto_another_beam_is_named(caplog):
    """The structure of the scene stays the same."""
    for apart in (0.1, 0.0):
        scene = fb.Scene()
        scene.clamp(scene.add_beam([(0, 0), (0, 1.171875)], STRIP, elements=7).start)
        scene.clamp(scene.add_beam([(apart, 0.5), (1, 0.5)], STRIP, elements=3).end)
        assert "not joined" not in caplog.text
        fb.static(scene, load_steps=1)
    assert "beam 'beam 2' ends at (0, 0.5) on beam 'beam 1'" in caplog.text


@pytest.mark.parametrize("kind", ["arc", "offset", "slanted"])
@pytest.mark.parametrize("degree", [1, 2, 3])
def test_ends_on_curves_on_lines_of_offset_beams_and_at_rounded_places_are_named(
    caplog, kind, degree
):
    scene, k = fb.Scene(), next(NUMBERS)
    options = {"elements": 5, "degree": degree, "name": f"held {k}"}
    if kind == "arc":
        held = scene.add_beam(fb.arc((5, 0), (3, 4), (0, 5)), STRIP, **options)
        place = 5 * np.cos(0.7), 5 * np.sin(0.7)
    elif kind == "offset":
        held = scene.add_beam([(0, 0), (0, 5)], STRIP, offset=0.5, **options)
        place = 0, 1.8
    else:
        held = scene.add_beam([(0, 0), (97.3, 41.7)], STRIP, **options)
        place = 30.941, 13.261  # 0.318 of it, to three decimals
    end = np.add(place, (2.0, -1.0))
    arm = scene.add_beam([place, end], STRIP, 2, degree, name=f"arm {k}")
    scene.clamp(held.start)
    scene.clamp(arm.end)
    fb.static(scene, linear=True)
    assert f"beam 'arm {k}' ends at ({place[0]:g}, {place[1]:g}) on beam 'held {k}'" in caplog.text


def test_a_mechanism_by_ends_that_are_not_joined_says_so():
    scene, post, arm = post_and_arm(1.0)
    scene.fixed.clear()
    scene.clamp(post.start)
    scene.add_force(arm.end, (1.0, 0.0))
    with pytest.raises(fb.SceneError, match=rf"not joined: beam '{arm.name}' ends at \(0, 1\)"):
        fb.static(scene)
