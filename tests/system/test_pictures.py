"""Pictures: what they draw is what there is, where it is, whole and in its colours."""

import ctypes
import importlib.util
import re
from itertools import pairwise

import numpy as np
import pytest
from pytest import approx
from scenes import FLYING, assert_refused, clamped_bar, one_bar, pinned_bar, supported_bar

import fx_beam as fb
from fx_beam.plot.drawing import checked_drawing

plot = pytest.importorskip("fx_beam.plot")
labels = pytest.importorskip("fx_beam.plot.labels")
Figure = pytest.importorskip("matplotlib.figure").Figure
Quiver = pytest.importorskip("matplotlib.quiver").Quiver
Image = pytest.importorskip("PIL.Image")
pytestmark = pytest.mark.plot
SPAN, LOAD = 4.0, 1000.0


def cantilever(force=None, section=FLYING, elements=4):
    """A clamped beam under its weight, or a force at its end."""
    scene, beam = clamped_bar((1, 0), section, elements, gravity=None if force else (0, -9.81))
    if force:
        scene.add_force(beam.end, force)
    return scene, beam


@pytest.fixture(scope="module")
def swing():
    """A bar on a pin, a mass on a spring that slides along it, and a follower force; its motion."""
    scene, bar = pinned_bar((1, 0), FLYING, elements=4, name="bar", gravity=(0.0, -9.81))
    bead = scene.add_beam([(0.5, 0), (0.6, 0)], FLYING, name="bead", elements=1)
    spring = fb.Spring(50.0, rest=0.0)
    scene.add_joint(fb.Prismatic(bar.node(0.5), bead.start, axis=(1, 0), spring=spring))
    scene.add_force(bar.end, (0.0, 5.0), follower=True)
    scene.add_mass(bead.end, 0.1)
    return scene, bar, fb.simulate(scene, dt=0.01, t_end=0.1)


@pytest.fixture(scope="module")
def bent():
    """A cantilever under a force at its end: about M = -1 at the clamp, and 0 at the end."""
    section = fb.Section(EA=1e4, GA=1e4, EI=1.0)
    return fb.static(cantilever(force=(0, -1.0), section=section, elements=10)[0], load_steps=1)


@pytest.fixture(scope="module")
def girder():
    """A girder under a line load: M = q l^2/8 in its middle, Q = q l/2 at its ends."""
    scene, beam = supported_bar((SPAN, 0), FLYING, elements=16, degree=2, name="girder")
    scene.add_line_load(beam, (0, -LOAD * 1e-6))
    return fb.static(scene, load_steps=1)


def crane():
    """A scene with one of each: supports, joints, springs, loads, motors and motions."""
    scene, girder = supported_bar((4, 0), FLYING, 8, name="girder", gravity=(0.0, -9.81))
    strut = scene.add_beam([(1, 0), (1, 1.5)], FLYING, 4, name="strut")
    boom = scene.add_beam([(4, 0), (6, 1)], FLYING, 4, name="boom")
    finger = scene.add_beam([(6, 1), (6.1, 1)], FLYING, name="finger", elements=1)
    roof = scene.add_beam([(4.5, 2), (7, 2)], FLYING, 4, name="roof")
    scene.fix(roof.start, "x", "rotation")
    scene.clamp(roof.end)
    scene.prescribe(roof.start, y=lambda t: t)
    parts = {"spring": fb.Spring(1.0), "damper": fb.Damper(1.0)}
    parts["friction"] = fb.SmoothFriction(1.0, 0.01)
    scene.add_joint(fb.Revolute(girder.node(0.25), strut.start, **parts))
    scene.add_joint(fb.Revolute(girder.end, boom.start, motor=lambda t: t))
    scene.add_joint(fb.Prismatic(boom.end, finger.start, axis=(1, 0), **parts))
    scene.add_drag(roof, linear=0.5)
    scene.add_drag(finger.end, quadratic=0.5)
    scene.add_line_load(girder, lambda s: (0, -1 - s), of="arc length")
    scene.add_line_load(roof, (0, -3.0))
    scene.add_force(strut.end, (3.0, 4.0), follower=True)
    scene.add_force(finger.end, lambda t: (0.0, max(0.0, t - 1)))
    scene.add_moment(boom.node(0.5), -30.0)
    scene.add_mass(finger.end, 2.5, 0.1)
    scene.set_velocity(girder, lambda x, y: (0.0, x * (4 - x)))
    return scene, girder


def words(figure):
    """Texts of the drawing."""
    return {text.get_text() for text in figure.axes[0].texts} - {""}


def rings(ax):
    """Positions (n, 2) of the white rings of supports and hinges."""
    lines = [line for line in ax.lines if line.get_marker() == "o"]
    white = [line.get_xydata() for line in lines if line.get_markerfacecolor() == (1, 1, 1)]
    return np.concatenate([np.empty((0, 2)), *white])


def painted(figure):
    """The coloured members of a picture, one item for each row."""
    return [item for item in figure.axes[0].collections if item.get_array() is not None]


def holds(figure):
    """Whether all that is written lies inside the figure."""
    box, frame = figure.get_tightbbox(), figure.bbox_inches
    return (box.min >= frame.min - 0.01).all() and (box.max <= frame.max + 0.01).all()


# -- Members ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("degree", [1, 3])
def test_what_is_drawn_goes_through_the_nodes_and_between_them_along_the_polynomial(degree):
    x = np.linspace(-1, 2, 3 * degree + 1)  # of three elements
    nodes = np.array([np.column_stack([x, factor * x**degree]) for factor in (1.0, -2.0)])
    drawn = plot.axis(nodes, degree)
    assert drawn[..., 1] == approx([[1], [-2]] * drawn[..., 0] ** degree, abs=1e-13)
    lines = (drawn.shape[1] - 1) // (3 * degree)
    assert lines * 3 * degree == drawn.shape[1] - 1
    np.testing.assert_array_equal(drawn[:, ::lines], nodes)
    assert (np.diff(drawn[..., 0]) > 0).all()
    np.testing.assert_array_equal(plot.axis(nodes[1], degree), drawn[1])


@pytest.mark.parametrize(
    ("nodes", "degree", "reason"),
    [
        (None, 2, "axis: nodes = None must be positions"),
        ("abc", 1, "axis: nodes = 'abc' must be positions"),
        (np.zeros((4, 2)), 2, "must be positions"),
        (np.zeros((3, 3)), 2, "must be positions"),
        (np.zeros((3, 2)), 7, "axis: degree = 7 must be 1, 2 or 3"),
    ],
)
def test_an_axis_of_other_positions_or_of_another_degree_is_refused(nodes, degree, reason):
    assert_refused(reason, plot.axis, nodes, degree)


@pytest.mark.parametrize("degree", [2, 3])
def test_a_curve_is_drawn_round_and_before_it_moves_where_its_motion_starts(degree):
    def off_the_circle(points):
        """Largest distance of the lines between points from the circle of radius 1."""
        middles = (points[1:] + points[:-1]) / 2
        return max(abs(np.hypot(*part.T) - 1).max() for part in (points, middles))

    scene, arch = one_bar(fb.arc((1, 0), (0, 1), (-1, 0)), FLYING, elements=3, degree=degree)
    leg = scene.add_beam([arch.end, (-1, -1), (0, -2)], FLYING, elements=4, degree=degree)
    solution = fb.simulate(scene, dt=0.1, t_end=0.1)
    nodes = solution.shape(arch)[0]
    assert off_the_circle(nodes) > 0.01
    # As round as the elements are.
    assert off_the_circle(plot.axis(nodes, degree)) < {2: 5e-3, 3: 2e-3}[degree]
    drawn = np.concatenate([line.get_xydata() for line in plot.scene(scene).axes[0].lines])
    for place in (*nodes, *solution.shape(leg)[0]):
        assert np.nanmin(np.hypot(*(drawn - place).T)) < 1e-14


def test_magnified_shapes_move_the_nodes_by_that_factor(swing):
    figures = [plot.shapes(swing[2], rows=[0, 10], colour="M", magnify=x) for x in (1.0, 5.0)]
    (start, plain), (_, large) = (
        [np.array(row.get_segments()) for row in painted(figure)] for figure in figures
    )
    np.testing.assert_allclose(large - start, 5 * (plain - start), atol=1e-12)
    assert ["x 5" in figure.axes[0].get_title() for figure in figures] == [False, True]


@pytest.mark.parametrize(("degree", "factor"), [(1, 3.0), (3, 1.0)])
def test_members_are_as_thick_as_their_sections_and_turn_with_them(degree, factor):
    depth = lambda f: 0.2 - 0.1 * f  # noqa: E731
    steel = fb.Section.rectangle(height=depth, width=0.1, E=210e9, rho=7850.0)
    scene, beam = pinned_bar((2, 0), steel, 4, degree, name="arm")
    scene.set_velocity(beam, lambda x, y: (0, x), spin=1.0)
    solution = fb.simulate(scene, dt=0.05, t_end=0.5)
    (bands,) = painted(plot.shapes(solution, rows=[10], colour="N", thickness=factor))
    corners = np.array([path.vertices[:4] for path in bands.get_paths()])
    across = corners[:, 0] - corners[:, 3]
    ends = np.arange(len(corners)) / len(corners)
    assert np.hypot(*across.T) == approx(factor * depth(ends), rel=1e-9)
    psi = np.interp(ends * 2, beam.s, solution.q[10][[node.number for node in beam.nodes], 2])
    assert np.arctan2(*across.T) == approx(-psi, abs=1e-4)
    middles = (corners[:, 0] + corners[:, 3]) / 2
    assert np.hypot(*middles.T) == approx(2 * ends, rel=1e-3)


def test_deep_members_and_paths_between_frames_are_in_the_frame(tmp_path):
    deep = fb.Section.rectangle(height=1.0, width=0.1, E=1e6, rho=10.0)
    scene, bar = pinned_bar((2, 0), deep, elements=1, gravity=(0, -9.81))
    solution, axes = fb.simulate(scene, dt=0.05, t_end=1.0), []
    (bands,) = painted(plot.shapes(solution, rows=[0], colour="N", thickness=1.0))
    heights = np.array([path.vertices[:, 1] for path in bands.get_paths()])
    assert abs(heights).max() == approx(0.5) and bands.axes.get_ylim()[1] > 0.5
    film = {"rows": [0, 20], "trace": bar.end, "scenery": lambda ax, k: axes.append(ax)}
    plot.animate(solution, tmp_path / "film.gif", **film)
    heights = solution.position(bar.end)[:, 1]
    assert heights[[0, 20]].min() > -1.2 and axes[0].get_ylim()[0] < heights.min() < -1.9


# -- Symbols ---------------------------------------------------------------------------------------


def test_supports_are_where_their_nodes_are_in_each_row():
    scene, arm = pinned_bar((0, 1), FLYING, 2)
    rod = scene.add_beam([(0, 1), (2.0, 0)], FLYING, 2)
    scene.add_joint(fb.Revolute(arm.end, rod.start))
    scene.fix(rod.end, "y")
    scene.prescribe(rod.end, x=lambda t: -0.5 * t * t)
    solution = fb.simulate(scene, dt=0.05, t_end=1.0)
    for k in (0, 10, 20):
        marks = rings(plot.shapes(solution, rows=[k]).axes[0])
        for node in (arm.start, arm.end, rod.end):
            assert np.hypot(*(marks - solution.position(node)[k]).T).min() < 1e-9
    assert solution.position(rod.end)[20, 0] == approx(1.5)


@pytest.mark.parametrize(
    ("ends", "wall"), [([(1, 1)], (1, -1)), ([(0, 1), (1, 1.5)], (1, 0))], ids=["single", "braced"]
)
def test_a_clamp_is_across_a_single_member_and_along_an_axis_under_several(ends, wall):
    scene, start = fb.Scene(), (0, 0)
    for end in ends:
        start = scene.add_beam([start, end], FLYING, elements=1).start
    scene.clamp(start)
    (stroke,) = (line for line in plot.scene(scene).axes[0].lines if line.get_linewidth() == 1.5)
    one, other, _ = stroke.get_xydata()
    x, y = one - other
    assert x * wall[1] == approx(y * wall[0])


@pytest.mark.parametrize(
    ("law", "fixed"),
    [
        ({"spring": fb.Spring(5.0)}, False),
        ({"damper": fb.Damper(1.0)}, True),
        ({"friction": fb.SmoothFriction(1.0, 0.01)}, False),
        ({"force": lambda distance, rate, t: 1.0 + 0 * distance}, True),
    ],
    ids=["spring", "damper", "friction", "force"],
)
def test_a_force_between_points_is_drawn_between_them_before_and_in_the_motion(law, fixed):
    scene = fb.Scene()
    left, right = (scene.add_beam([(x, 0), (x, 1)], FLYING, elements=1) for x in (0.0, 2.0))
    for beam in (left, right):
        scene.pin(beam.end)
    other = (1.0, -1.0) if fixed else right.start
    scene.add_force_between(left.start, other, **law)
    solution = fb.simulate(scene, dt=0.05, t_end=0.5)
    for figure, k in (plot.scene(scene), 0), (plot.shapes(solution, rows=[0, 10]), 10):
        a = solution.position(left.start)[k]
        b = np.array(other) if fixed else solution.position(right.start)[k]
        lines = [line.get_xydata() for line in figure.axes[0].lines]
        nearest = [max(np.nanmin(np.hypot(*(p - q).T)) for p in (a, b)) for q in lines if len(q)]
        assert min(nearest) < 1e-9, "a line has both ends"
        low, high = np.transpose([figure.axes[0].get_xlim(), figure.axes[0].get_ylim()])
        assert (b > low).all() and (b < high).all()


def test_shapes_that_nodes_carry_move_and_turn_with_them():
    scene = fb.Scene()
    wheel, ball = (scene.add_body((x, 1.0), mass=1.0, inertia=0.1).centre for x in (0, 3))
    scene.add_contact(ball, fb.Circle(wheel, 0.5), stiffness=1e3)
    scene.add_contact(ball, fb.Line(wheel, (1, 0)), stiffness=1e3)
    scene.set_velocity(wheel, (1.0, 0.0), spin=np.pi / 2)
    solution = fb.simulate(scene, dt=0.01, t_end=1.0)

    def carried(k):
        """The disc, and the line of the ground without its strokes."""
        ax = plot.shapes(solution, rows=[k]).axes[0]
        areas = [path.vertices for item in ax.collections for path in item.get_paths()]
        circle = max(areas, key=len)
        (line,) = (one.get_xydata() for one in ax.lines if one.get_zorder() == 1.2)
        return ax, circle, line[~np.isnan(line[:, 0])]

    ax, circle, line = carried(100)
    assert circle[:-1].mean(axis=0) == approx([1.0, 1.0], abs=0.01)
    assert np.hypot(*(circle - (1.0, 1.0)).T) == approx(0.5, abs=1e-4)
    assert line[:, 1] == approx(1.0, abs=1e-4)
    assert np.ptp(carried(0)[2][:, 0]) == approx(0, abs=1e-12)
    assert ax.get_xlim()[1] >= circle[:, 0].max() and ax.get_ylim()[1] >= circle[:, 1].max()


def arrows(figure):
    """Tails and tips (n, 2) of all arrows of forces."""
    ax = figure.axes[0]
    lines = [line.get_xydata() for line in ax.lines if line.get_zorder() == 7]
    ends = [np.flatnonzero(np.isnan(line[:, 0])) for line in lines]
    starts = [np.concatenate([[0], end[:-1] + 1]) for end in ends]
    tails = [line[start] for line, start in zip(lines, starts, strict=True)]
    filled = [c for c in ax.collections if c.get_zorder() == 7]
    heads = [path.vertices[0] for c in filled for path in c.get_paths()]
    return np.concatenate(tails), np.array(heads)


def test_a_force_is_drawn_in_the_window_and_with_the_section_that_it_follows(swing):
    _, bar, solution = swing
    psi, (tail, tip) = solution.rotation(bar.end)[10], arrows(plot.shapes(solution, rows=[10]))
    (direction,) = tip - tail
    assert direction / np.hypot(*direction) == approx([-np.sin(psi), np.cos(psi)])
    scene, _ = cantilever(force=(-5.0, 0))
    figure = plot.shapes(fb.static(scene, load_steps=1), rows=[1])
    tail, _ = arrows(figure)
    assert 1.1 < tail[0, 0] < figure.axes[0].get_xlim()[1]


def test_modes_have_supports_at_rest_equal_panels_and_the_numbers_of_modes():
    scene, column = clamped_bar((0, 3), FLYING, 4)
    beam = scene.add_beam([column.end, (4, 3)], FLYING, 4)
    other = scene.add_beam([(4, 3), (4, 0)], FLYING, 4)
    scene.add_joint(fb.Revolute(beam.end, other.start))
    scene.pin(other.end)
    modes = fb.modes(scene, n=7)
    figure = plot.modes(modes)
    figure.canvas.draw()
    assert len(figure.axes) == 7 and len(plot.modes(modes, count=3).axes) == 3
    for mode, ax in enumerate(figure.axes):
        assert ax.get_title().startswith(f"mode {mode + 1}: ")
        assert abs(rings(ax) - (4, 0)).max(axis=1).min() == 0  # the pin
        moved = modes.shape(other, mode, 0.15 * 4)[0]
        assert abs(rings(ax) - moved).max(axis=1).min() < 1e-12  # the hinge
    sizes = [ax.get_window_extent().size for ax in figure.axes]
    assert np.ptp(sizes, axis=0) == approx([0, 0], abs=1)
    assert holds(figure)


@pytest.mark.parametrize("load", ["line load", "natural strain"])
def test_what_is_along_a_curved_member_follows_its_axis(load):
    radius, scene = 1.0, fb.Scene()
    curve = fb.arc((-radius, 0), (0, radius), (radius, 0))
    arch = scene.add_beam(curve, FLYING, elements=2, degree=2)
    if load == "line load":
        scene.add_line_load(arch, lambda s: (0.0, -1e-3 - s), of="arc length")
    else:
        scene.add_natural_strain(arch, curvature=0.1)
    ax = plot.scene(scene).axes[0]
    if load == "line load":
        heads = [c for c in ax.collections if c.get_zorder() == 4]
        tips = np.array([path.vertices[0] for c in heads for path in c.get_paths()])
        gap = tips[:, 1].max() - radius  # above the axis
        distances = np.hypot(*(tips - (0, gap)).T)
    else:
        (dashed,) = (line for line in ax.lines if line.is_dashed())
        distances = np.hypot(*dashed.get_xydata()[:-1].T)
    assert len(distances) > 5 and np.ptp(distances) < 0.02 * radius


def test_a_body_alone_is_drawn_with_its_weight():
    scene = fb.Scene(gravity=(0.0, -9.81))
    scene.add_body((0, 0), mass=1.0, inertia=1.0, name="ball")
    assert {"ball", "g = 9.81 m/s$^2$"} <= words(plot.scene(scene))


def test_a_single_frequency_is_a_point():
    scene, beam = cantilever()
    response = fb.frequency_response(scene, (beam.end, (0, 1.0)), beam.end, [1.0])
    curves = plot.frequency_response(response, components=["y"]).axes[0].lines
    assert [line.get_marker() for line in curves] == ["."]
    nothing = fb.frequency_response(scene, (beam.end, (0, 1.0)), beam.start, [1.0])
    with pytest.raises(fb.SceneError, match=r"\['x', 'y', 'rotation'\], of which none move"):
        plot.frequency_response(nothing)


def test_each_of_many_curves_has_a_look_of_its_own():
    scene, beam = cantilever()
    times, t = range(1, 15), np.linspace(0, 1, 9)
    response = fb.frequency_response(scene, (beam.end, (0, 1.0)), beam.end, [1.0, 2.0])
    spectra = plot.frequency_response({str(k): response for k in times}, components=["y"])
    histories, axes = plot.figure(1, 1)
    plot.quantities(axes[0, 0], {str(k): k * t for k in times}, t)
    for figure in (spectra, histories):
        lines = figure.axes[0].lines
        looks = [(line.get_color(), line.get_linestyle(), line.get_marker()) for line in lines]
        assert len(set(looks)) == len(looks) == len(times)
        assert looks[5][2] in ("", "None") and looks[6][2] == "o"


def test_arrows_of_equilibria_are_the_forces_that_act():
    """With those that fade from the state at the start, and as the scene was in the run."""
    scene, beam = cantilever()
    middle, end = beam.node(0.5), beam.end
    first = scene.add_force(end, lambda t: (0, -4.0 * t))
    bent = fb.static(scene, load_steps=2, t=2.0)
    second = scene.add_force(middle, (0, 2.0))
    both = fb.static(scene, load_steps=2, t=2.0, start=bent)
    scene.remove(first)
    one = fb.static(scene, load_steps=2, start=both)
    scene.remove(second)
    for path, acting in (
        (bent, [(1, end, -4), (2, end, -8)]),
        (both, [(0, end, -8), (1, middle, 1), (1, end, -8), (2, middle, 2), (2, end, -8)]),
        (one, [(0, middle, 2), (0, end, -8), (1, middle, 2), (1, end, -4), (2, middle, 2)]),
    ):
        tails, heads = arrows(plot.shapes(path, rows=[0, 1, 2]))
        vectors = (heads - tails) / np.hypot(*(heads - tails).T).max()
        order = np.lexsort((heads[:, 0], [k for k, *_ in acting]))  # of a row along the beam
        assert heads[order] == approx(np.array([path.position(node)[k] for k, node, _ in acting]))
        assert vectors[order] == approx(np.array([(0, force / 8) for *_, force in acting]))


# -- Words -----------------------------------------------------------------------------------------


def test_all_that_a_scene_has_is_written_in_its_units():
    scene, girder = crane()
    texts = words(plot.scene(scene, dimensions=True, marks={"A": girder.node(0.5)}))
    assert {"girder", "strut", "boom", "finger", "roof", "A"} <= texts
    assert {"F = 5 N, follower", "F(t)", "M = -30 N m", "q(s)", "q = 3 N/m"} <= texts
    assert {"m = 2.5 kg, J = 0.1 kg m$^2$", "g = 9.81 m/s$^2$", "v(0)"} <= texts
    assert {"drag", "y(t)", r"motor $\psi$(t)", "1", "3"} <= texts
    assert {"F = 5, follower", "M = -30"} <= words(plot.scene(scene, scene_unit="in"))


def test_numbers_have_three_digits_or_all_before_the_point_and_large_ones_a_prefix():
    values = {0.0598561: "0.0599", 9.80665: "9.81", 1234.0: "1234", 999.9: "1000"}
    for value, text in (values | {45678.9: "45.7 k", 2.1e11: "210 G"}).items():
        scene, beam = cantilever()
        scene.add_moment(beam.end, -value)
        text = text if " " in text else f"{text} "
        assert f"M = -{text}N m" in words(plot.scene(scene))


def test_labels_lie_in_the_frame_and_apart_from_each_other_and_nothing_is_cut_off():
    figure = plot.scene(crane()[0], dimensions=True)
    ax, renderer = figure.axes[0], figure.canvas.get_renderer()
    boxes = [text.get_window_extent(renderer) for text in ax.texts if text.get_text()]
    for i, box in enumerate(boxes):
        assert (box.min > ax.bbox.min).all() and (box.max < ax.bbox.max).all()
        assert not any(box.overlaps(other) for other in boxes[:i])
    points = np.concatenate([line.get_xydata() for line in ax.lines])
    for (low, high), values in zip((ax.get_xlim(), ax.get_ylim()), points.T, strict=True):
        assert low < np.nanmin(values) and np.nanmax(values) < high


def test_a_scene_of_many_members_is_drawn_without_names_and_says_once_what_is_equal():
    scene = fb.Scene()
    for k in range(600):
        beam = scene.add_beam([(0.0, 0.1 * k), (1.0, 0.1 * k)], FLYING, elements=1)
        if k % 20 == 0:
            scene.add_force(beam.end, (3.0, 0.0))
    texts = [text.get_text() for text in plot.scene(scene).axes[0].texts]
    assert texts.count("F = 3 N") == 1
    assert not any("beam" in text for text in texts)


def test_bodies_in_a_crowd_have_no_names_and_labels_have_a_largest_number(monkeypatch):
    scene = fb.Scene()
    for k in range(600):
        body = scene.add_body((k % 30, k // 30), 1.0 + k, 0.1)
        if k < 50:
            scene.add_force(body.centre, (1.0 + k, 0.0))
    monkeypatch.setattr(labels, "_MOST", 30)
    texts = [text.get_text() for text in plot.scene(scene).axes[0].texts]
    assert sum("F = " in text for text in texts) == 30
    assert not any("body" in text for text in texts)


# -- Diagrams --------------------------------------------------------------------------------------


def rows_of_colours(solution, folder, name):
    """Mean rows of red and of blue pixels below the axis of the girder; None without any."""
    plot.diagrams(solution, folder / "girder.png", 1, [name], deformed=False)
    pixels = np.asarray(Image.open(folder / "girder.png").convert("RGB")).astype(int)
    red = pixels[..., 0] - pixels[..., 2] > 25
    blue = pixels[..., 2] - pixels[..., 0] > 25
    # The axis is a line three times as thick as the frame of the panel.
    black = (pixels.max(axis=2) < 60).sum(axis=1) > pixels.shape[1] / 3
    axis = np.convolve(black, np.ones(6), mode="same").argmax()
    return [np.nonzero(one)[0].mean() - axis if one.sum() > 500 else None for one in (red, blue)]


def test_diagrams_have_a_panel_and_the_extreme_values_of_each_quantity(girder, tmp_path):
    plot.diagrams(girder, tmp_path / "girder.svg")
    # Texts of a picture in SVG are beside their outlines.
    texts = re.findall("<!-- (.*?) -->", (tmp_path / "girder.svg").read_text("utf-8"))
    for name in ("axial force", "shear force", "bending moment"):
        assert any(name in text for text in texts)
    for exact in (LOAD * 1e-6 * SPAN**2 / 8, LOAD * 1e-6 * SPAN / 2):
        assert f"{exact:g}" in {text.lstrip("-\u2212") for text in texts}


@pytest.mark.parametrize("degree", [1, 2, 3])
@pytest.mark.parametrize("elements", [1, 4, 16])
def test_the_extreme_moment_of_a_cantilever_is_that_of_statics_at_its_clamp(elements, degree):
    section = fb.Section(EA=1e8, GA=1e8, EI=1e6)
    scene, beam = clamped_bar((2, 0), section, elements=elements, degree=degree, load=(0.0, -10.0))
    scene.add_line_load(beam, (0.0, -1.0))
    figure = plot.diagrams(fb.static(scene, load_steps=1), None, quantities=["M"])
    (extreme,) = (text.get_text() for text in figure.axes[0].texts)
    assert extreme.lstrip("-\u2212") == f"{10.0 * 2 + 1.0 * 2**2 / 2:g}"


@pytest.mark.parametrize("elements", [1, 3])
def test_the_extreme_moment_is_found_under_loads_and_where_a_parabola_has_its_vertex(elements):
    scene, section = fb.Scene(), fb.Section(EA=1e8, GA=1e8, EI=1e6)
    beams = [scene.add_beam([(0, y), (8, y)], section, elements) for y in (0, 1)]
    for beam in beams:
        scene.pin(beam.start)
        scene.fix(beam.end, "y")
    scene.add_force(beams[0].at(3.5), (0, -1.0))
    scene.add_line_load(beams[1], (0, -1.0))
    scene.add_moment(beams[1].end, 6.0)
    solution = fb.static(scene, linear=True)
    figure = plot.diagrams(solution, None, quantities=["M"], deformed=False)
    texts = [text.get_text() for text in figure.axes[0].texts]
    # The couple at the end of the second beam is above 15 % of the largest moment.
    assert texts == [f"{3.5 * 4.5 / 8:.3g}", f"{(4 + 6 / 8) ** 2 / 2:.3g}", "6"]


def test_diagrams_of_several_cases_have_their_envelope_and_who_gives_it():
    """A beam on two supports under a force up or down: F a b / L on both sides."""
    cases = []
    for force, place in ((-2.0, 3.0), (4.0, 4.0)):
        scene = fb.Scene()
        beam = scene.add_beam([(0, 0), (8, 0)], fb.Section(EA=1e8, GA=1e8, EI=1e6), 4)
        scene.pin(beam.start)
        scene.fix(beam.end, "y")
        scene.add_force(beam.at(place), (0, force))
        cases.append(fb.static(scene, linear=True))
    figure = plot.diagrams(cases, None, quantities=["M"])
    texts = [text.get_text() for text in figure.axes[0].texts]
    assert texts == ["3.75 (0)", "\N{MINUS SIGN}8 (1)"]
    assert "envelope of 2 solutions" in figure.get_suptitle()
    assert_refused("an envelope is over all rows", plot.diagrams, cases, None, 1)
    assert_refused("an envelope is over all rows", plot.diagrams, [], None)
    assert_refused("a Solution", plot.diagrams, [cases[0], scene], None)
    other = fb.Scene()
    other.clamp(other.add_beam([(0, 0), (1, 0)], fb.Section(EA=1.0, GA=1.0, EI=1.0), 3).start)
    assert_refused("equal members", plot.diagrams, [cases[0], fb.static(other)], None)


def test_a_moment_is_drawn_on_the_side_in_tension_and_a_shear_force_changes_its_side(
    girder, tmp_path
):
    red, blue = rows_of_colours(girder, tmp_path, "M")
    assert blue is None and red > 0
    red, blue = rows_of_colours(girder, tmp_path, "Q")
    assert red < 0 < blue


# -- Colours ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("quantity", ["N", "Q", "M", "strain energy", "speed"])
def test_members_are_coloured_by_what_is_in_them(swing, quantity):
    _, bar, solution = swing
    _, row = painted(plot.shapes(solution, rows=[5, 10], colour=quantity))
    pieces = len(row.get_array()) * 4 // 5  # those of the bar come before those of the bead
    values = np.asarray(row.get_array())[:pieces]
    middles = np.array(row.get_segments()).mean(axis=1)[:pieces]
    # From the pin along the bar.
    assert (np.diff(np.hypot(*middles.T)) > 0).all()
    if quantity in "NQM":
        places = (np.arange(pieces) + 0.5) / pieces * bar.length
        exact = getattr(solution.resultants(bar).at(places), quantity)[10]
        assert values == approx(exact, abs=1e-12 * abs(exact).max())
    elif quantity == "speed":
        speeds = np.hypot(*np.array([solution.velocity(node)[10] for node in bar.nodes]).T)
        assert values[0] < 0.05 * speeds[-1] and values[-1] == approx(speeds[-1], rel=0.05)
    else:
        assert 0 < values.min() and values.mean() < solution.energy.strain[10]
    low, high = row.get_clim()
    assert high > 0 and low == (-high if quantity in "NQM" else 0)
    assert high >= row.get_array().max() and low <= row.get_array().min()


@pytest.mark.parametrize(
    ("options", "ends", "extend"),
    [
        ({"colour": "M", "colour_limits": (-0.5, 2.0)}, (-0.5, 2.0), "min"),
        ({"colour": "M", "colour_limits": (-0.5, 0.5)}, (-0.5, 0.5), "min"),
        ({"colour": "strain energy", "colour_limits": (0.01, 0.2)}, (0.01, 0.2), "both"),
        ({"colour": "M", "colour_scale": "log", "colour_limits": (0.1, 10)}, (-10, 10), "neither"),
    ],
)
def test_limits_are_the_ends_of_the_colours_and_arrows_show_what_is_beyond(
    bent, options, ends, extend
):
    figure = plot.shapes(bent, rows=[1], **options)
    (row,), bar = painted(figure), figure.axes[1]
    assert row.get_clim() == ends
    # The axis of a logarithmic scale goes there and back through the logarithm.
    shown = bar.get_ylim() if bar.get_ylabel() else bar.get_xlim()
    assert shown == approx(ends, rel=1e-12)
    assert len(bar.patches) == {"neither": 0, "min": 1, "both": 2}[extend]


# -- Files and films -------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["scene", "shapes", "diagrams", "modes"])
def test_pictures_are_returned_and_written_into_files_of_the_same_kinds(name, swing, tmp_path):
    scene, bar, solution = swing
    subject = {"scene": scene, "modes": fb.modes(scene, n=2)}.get(name, solution)
    draw = getattr(plot, name)
    assert isinstance(draw(subject), Figure)
    for ending in ("png", "svg", "pdf", "webp") if name == "scene" else ("png", "svg"):
        assert isinstance(draw(subject, tmp_path / f"picture.{ending}"), Figure)
        assert (tmp_path / f"picture.{ending}").stat().st_size > 1000
    with pytest.raises(ValueError, match="its name must end with .*png.*svg"):
        draw(subject, tmp_path / "picture.doc")


def test_a_film_has_marks_scenery_and_colours_and_is_white_elsewhere(swing, tmp_path):
    _, bar, solution = swing
    drawn, counts = [], []

    def scenery(axes, k):
        drawn.append(k)
        counts.append(len(axes.lines))
        lines = axes.plot([0, 1], [-1, -1])
        return lines if len(drawn) < 3 else None  # what is new is found

    more = {"marks": {"tip": bar.end}, "scenery": scenery}
    for colour in (None, "speed"):
        plot.animate(solution, tmp_path / f"{colour}.gif", rows=[0, 5, 10], colour=colour, **more)
    assert drawn == [0, 5, 10] * 2
    assert len(set(counts[:3])) == len(set(counts[3:])) == 1
    plain, coloured = ((tmp_path / f"{colour}.gif").read_bytes() for colour in (None, "speed"))
    assert plain != coloured and min(len(plain), len(coloured)) > 5e3
    with Image.open(tmp_path / "speed.gif") as film:
        assert film.convert("RGB").getpixel((2, 2)) == (255, 255, 255)


def test_films_have_all_rows_their_speed_and_the_size_that_is_asked_for(swing, tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    plot.animate(swing[2], tmp_path / "film.mp4", rows=range(11), fps=5, size=(301, 407))
    frames, seconds = ffmpeg.count_frames_and_secs(str(tmp_path / "film.mp4"))
    assert frames == 11 and seconds == approx(11 / 5)
    reader = ffmpeg.read_frames(str(tmp_path / "film.mp4"))
    assert next(reader)["size"] == (300, 406)  # even
    reader.close()
    for size in ((1920, 1080), (301, 407)):
        plot.animate(swing[2], tmp_path / "film.gif", rows=[0, 1, 2], size=size)
        with Image.open(tmp_path / "film.gif") as film:
            assert film.size == size and film.n_frames == 3


@pytest.mark.parametrize("fps", [7, 24, 30, 50])
def test_a_gif_takes_as_long_as_its_frames_a_second_say(fps, swing, tmp_path):
    plot.animate(swing[2], tmp_path / "film.gif", rows=range(11), fps=fps)
    with Image.open(tmp_path / "film.gif") as film:
        seconds = 0.0
        for frame in range(film.n_frames):
            film.seek(frame)
            seconds += film.info["duration"] / 1000
    assert seconds == approx(11 / fps, abs=0.005 + 1e-9)  # a GIF counts hundredths


@pytest.mark.parametrize("rows", [[7], [0, 3, 10], [1, 2]])
def test_a_frame_says_its_time(rows, swing, tmp_path):
    written = []

    def scenery(axes, k):
        words = next(text.get_text() for text in axes.texts if text.get_text().startswith("t = "))
        written.append(float(words.split()[2]) * (1e-3 if words.endswith("ms") else 1.0))

    plot.animate(swing[2], tmp_path / "swing.gif", rows=rows, scenery=scenery)
    np.testing.assert_allclose(written, swing[2].t[rows], rtol=1e-12)


def test_a_single_shape_has_its_time_in_the_title_and_no_scale_of_times(swing):
    solution = swing[2]
    figure = plot.shapes(solution, rows=[7])
    assert len(figure.axes) == 1
    assert figure.axes[0].get_title().endswith(f"t = {solution.t[7]:g} s")


def test_the_power_of_ten_of_the_ticks_is_not_where_a_film_has_its_time(tmp_path):
    section = fb.Section.rectangle(height=1e-7, width=1e-7, E=1e9, rho=1e3)
    scene, beam = clamped_bar([(0, 0), (1e-6, 0), (1e-6, 1e-6)], section, elements=2)
    solution = fb.simulate(scene, dt=1e-10, t_end=1e-9)
    boxes = []

    def scenery(axes, k):
        words = axes.yaxis.get_offset_text(), *axes.texts
        boxes.extend(text.get_window_extent() for text in words)

    plot.animate(solution, tmp_path / "film.gif", rows=[10], scenery=scenery)
    power, time = boxes
    assert power.width > 0 and power.x1 <= time.x0 + 1e-6


# -- What is refused -------------------------------------------------------------------------------


def test_rows_are_those_next_to_times_or_evenly_spaced(swing):
    t, shown = swing[2].t, lambda **options: checked_drawing(swing[2], 1.0, "m", 8, **options).rows
    assert shown(times=[t[3] + 1e-6, t[9]]) == [3, 9] and shown(count=3) == [
        0,
        (len(t) - 1) // 2,
        len(t) - 1,
    ]
    assert len(shown()) == 8


@pytest.fixture(scope="module")
def snapping():
    """A path of an arch under a force, which ends behind its limit point; and the arch."""
    section = fb.Section(EA=1e4, GA=1e4, EI=1.0)
    scene, arch = supported_bar(
        fb.arc((0, 0), (1, 0.15), (2, 0)), section, elements=8, degree=2, held="xy"
    )
    scene.add_force(arch.node(0.5), (0.0, -60.0))
    return fb.static(scene, continuation="arc-length", max_steps=12)


def test_load_factors_above_the_last_one_of_a_path_can_be_drawn(snapping):
    factors = snapping.load_factor
    top = int(factors.argmax())
    assert factors[-1] < 0.5 * factors[top]
    assert checked_drawing(snapping, 1.0, "m", times=[factors[top]]).rows == [top]


def test_numbers_of_load_factors_beside_each_other_do_not_overlap(snapping):
    figure = plot.shapes(snapping, count=12, colour="time")
    figure.draw_without_rendering()
    labels = [*figure.axes[1].get_xticklabels(), *figure.axes[1].get_yticklabels()]
    boxes = [label.get_window_extent() for label in labels if label.get_text()]
    assert len(boxes) > 3 and not any(a.overlaps(b) for a, b in pairwise(boxes))


def overlapping(texts):
    """Texts beside each other of which one begins before the other ends."""
    boxes = [(text.get_text(), text.get_window_extent()) for text in texts if text.get_text()]
    return [(a[0], b[0]) for a, b in pairwise(boxes) if a[1].x0 < b[1].x0 < a[1].x1]


def test_titles_of_damped_modes_do_not_overlap():
    section = fb.Section(1e5, 1e5, 1.0, rhoA=1.0, retardation=1.234e-3)
    scene, mast = clamped_bar([(0, 0), (0, 3), (2, 4)], section, elements=(4, 4))
    figure = plot.modes(fb.modes(scene, n=8))
    figure.draw_without_rendering()
    assert not overlapping([ax.title for ax in figure.axes])
    assert figure.axes[2].get_title().count("ratio") == 1


def test_rows_count_from_the_end_as_in_python(swing, tmp_path):
    *_, solution = swing
    files = {row: tmp_path / f"{row}.png" for row in (-1, len(solution.t) - 1, 0)}
    for row, file in files.items():
        plot.shapes(solution, file, rows=[row])
    end, same, start = (file.read_bytes() for file in files.values())
    assert end == same != start


def test_numbers_of_the_axes_of_diagrams_do_not_overlap_in_micrometres():
    section = fb.Section.rectangle(1e-6, 10e-6, *fb.materials.glass)
    scene, beam = clamped_bar((1e-4, 0), section, elements=4, load=(0.0, -1e-7))
    figure = plot.diagrams(fb.static(scene, load_steps=1), None, 1, ["M", "N"])
    figure.draw_without_rendering()
    for ax in figure.axes:
        assert not overlapping(ax.get_xticklabels())


def test_a_motion_too_small_to_be_seen_is_said_with_a_factor(caplog):
    section = fb.Section(EA=1e9, GA=1e9, EI=1e6)
    scene, beam = clamped_bar((1, 0), section, elements=1, load=(0.0, 1.0))
    plot.shapes(fb.static(scene, load_steps=1))
    assert "magnify=100000 would show it" in caplog.text


@pytest.mark.parametrize(
    ("draw", "options", "words"),
    [
        ("animate", {"path": "motion.avi"}, "motion.avi: its name must end with .gif, .mp4"),
        ("shapes", {"path": "nowhere/shapes.png"}, "make the folder nowhere first"),
        ("shapes", {"magnify": 0}, "magnify = 0 must be a positive number"),
        ("shapes", {"thickness": -1}, "thickness = -1 must be a positive factor"),
        (
            "shapes",
            {"colour": "T"},
            "colour = 'T' must be one of 'N', 'Q', 'M', 'stress', 'strain en",
        ),
        ("shapes", {"colour_limits": (1, 1)}, "colour_limits = (1, 1) must be two finite numbers"),
        ("shapes", {"colour_limits": 3}, "colour_limits = 3 must be two finite numbers"),
        ("shapes", {"colour_limits": (0, 1), "colour_scale": "log"}, "both positive, on a log"),
        ("shapes", {"colour_scale": "cubic"}, "colour_scale = 'cubic' must be 'linear' or 'log'"),
        ("shapes", {"colour": None, "colour_limits": (0, 1)}, "must be given with a colour"),
        ("animate", {"colour": None, "colour_scale": "log", "path": "a.gif"}, "with a colour"),
        ("animate", {"scenery": lambda axes: [], "path": "a.gif"}, "it must take (axes, k)"),
        ("animate", {"fps": 60, "path": "a.gif"}, "fps = 60 must be a whole number from 1 to 50"),
        ("diagrams", {"row": 99}, "rows of the solution"),
        ("shapes", {"times": [-1.0]}, "times of the solution, from 0 to"),
        ("shapes", {"count": 0}, "count = 0 must be a whole number, at least 1"),
        ("shapes", {"count": 3, "rows": [0]}, "rows, times or a count of rows: give one"),
        ("diagrams", {"quantities": ["N", "speed"]}, "must be some of N, Q, M"),
        ("diagrams", {"quantities": []}, "must be some of N, Q, M"),
        ("diagrams", {"deformed": "yes"}, "True or False"),
    ],
)
def test_what_cannot_be_drawn_is_refused_before_a_file_is_begun(
    swing, draw, options, words, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    options = {"path": "a.png"} | options
    if "colour_limits" in options or "colour_scale" in options:
        options = {"colour": "M"} | options
    with pytest.raises(ValueError, match=re.escape(words)):
        getattr(plot, draw)(swing[2], **options)
    assert not list(tmp_path.iterdir())


def test_scenes_that_cannot_be_drawn_are_refused():
    scene, _ = crane()
    assert_refused("the scene has no beams; add one", lambda: plot.scene(fb.Scene()))
    emptied, beam = cantilever()
    emptied.remove(beam)
    assert_refused("the scene has no beams; add one", plot.scene, emptied)
    assert_refused("needs an fx_beam.Scene, not 'scene'", plot.scene, "scene")
    assert_refused("at least one", plot.frequency_response, {})
    with pytest.raises(fb.SceneError, match="mark 'A': Node.* is not a node of the scene"):
        plot.scene(scene, marks={"A": crane()[1].end})
    energy = lambda eps, gamma, kappa: eps**2 + gamma**2 + kappa**2  # noqa: E731
    scene = fb.Scene()
    scene.clamp(
        scene.add_beam([(0, 0), (2, 0)], fb.Section(strain_energy=energy, rhoA=1), elements=1).start
    )
    solution = fb.simulate(scene, dt=0.05, t_end=0.05)
    with pytest.raises(ValueError, match="needs EA and EI, or rhoA and rhoI, in the section of 'b"):
        plot.shapes(solution, rows=[0], thickness=1.0)


def test_without_egl_shapes_are_refused_before_vtk_ends_the_process(swing, tmp_path, monkeypatch):
    def load(name, *more):
        raise OSError(f"{name}: cannot open shared object file")

    monkeypatch.setenv("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
    monkeypatch.setattr(ctypes, "CDLL", load)
    with pytest.raises(RuntimeError, match="apt-get install libegl1 libgl1-mesa-dri"):
        plot.shapes(swing[2], tmp_path / "shapes.png", colour="time")
    plot.shapes(swing[2], tmp_path / "shapes.png")


def test_a_film_without_what_writes_it_and_curves_without_a_folder_are_refused(
    swing, tmp_path, monkeypatch
):
    with pytest.raises(ValueError, match="make the folder .*nowhere first"):
        plot.save(plot.figure(1, 1)[0], tmp_path / "nowhere" / "curves.png")
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(RuntimeError, match="MP4 needs imageio-ffmpeg: pip install imageio-ffmpeg"):
        plot.animate(swing[2], tmp_path / "motion.mp4", rows="all")
