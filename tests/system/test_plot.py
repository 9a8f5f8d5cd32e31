"""What pictures draw of a beam: its elements as they are, not lines between their nodes."""

import importlib.util

import numpy as np
import pytest
from scenes import FLYING

import fx_beam as fb
from fx_beam.plot.drawing import checked_drawing
from fx_beam.results.fields import along

plot = pytest.importorskip("fx_beam.plot")
Drawing = pytest.importorskip("fx_beam.plot.drawing").Drawing
Colouring = pytest.importorskip("fx_beam.plot.colouring").Colouring
Image = pytest.importorskip("PIL.Image")
pytestmark = pytest.mark.plot


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_what_is_drawn_goes_through_the_nodes_and_between_them_along_the_polynomial(degree):
    x = np.linspace(-1, 2, 3 * degree + 1)  # of three elements
    nodes = np.array([np.column_stack([x, factor * x**degree]) for factor in (1.0, -2.0)])
    drawn = plot.axis(nodes, degree)
    assert drawn[..., 1] == pytest.approx([[1], [-2]] * drawn[..., 0] ** degree, abs=1e-13)
    lines = (drawn.shape[1] - 1) // (3 * degree)
    assert lines * 3 * degree == drawn.shape[1] - 1
    np.testing.assert_array_equal(drawn[:, ::lines], nodes)
    assert (np.diff(drawn[..., 0]) > 0).all()
    np.testing.assert_array_equal(plot.axis(nodes[1], degree), drawn[1])


@pytest.mark.parametrize("degree", [2, 3])
def test_half_a_circle_of_three_elements_is_drawn_round(degree):
    def off_the_circle(points):
        """Largest distance of the lines between points from the circle of radius 1."""
        middles = (points[1:] + points[:-1]) / 2
        return max(abs(np.hypot(*part.T) - 1).max() for part in (points, middles))

    scene = fb.Scene()
    beam = scene.add_beam(fb.arc((1, 0), (0, 1), (-1, 0)), FLYING, elements=3, degree=degree)
    nodes = fb.simulate(scene, dt=0.1, t_end=0.1).shape(beam)[0]
    assert off_the_circle(nodes) > 0.01
    # As round as the elements are.
    assert off_the_circle(plot.axis(nodes, degree)) < {2: 5e-3, 3: 2e-3}[degree]


# -- Curves ----------------------------------------------------------------------------------------


# -- Shapes ----------------------------------------------------------------------------------------


def swinging():
    """A bar on a pin, a mass on a spring that slides along it, and a follower force."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    bar = scene.add_beam([(0, 0), (1, 0)], FLYING, elements=4, name="bar")
    bead = scene.add_beam([(0.5, 0), (0.6, 0)], FLYING, name="bead")
    scene.pin(bar.start)
    spring = fb.Spring(50.0, rest=0.0)
    scene.add_joint(fb.Prismatic(bar.node(0.5), bead.start, axis=(1, 0), spring=spring))
    scene.add_force(bar.end, (0.0, 5.0), follower=True)
    scene.add_mass(bead.end, 0.1)
    return scene, bar


def test_magnified_shapes_move_the_nodes_by_that_factor():
    scene, bar = swinging()
    solution = fb.simulate(scene, dt=0.01, t_end=0.1)
    plain, large = (Drawing(solution, [10], factor) for factor in (1.0, 5.0))
    moved = plain.axis("bar", 10) - solution.shape(bar)[0]
    np.testing.assert_allclose(large.axis("bar", 10), solution.shape(bar)[0] + 5 * moved)
    assert "x 5" in large.title() and "x" not in plain.title()


def test_pictures_of_shapes_modes_and_motion_are_written(tmp_path):
    scene, bar = swinging()
    solution = fb.simulate(scene, dt=0.01, t_end=0.1)
    marks = {"tip": bar.end}
    plot.shapes(solution, range(0, 11, 5), tmp_path / "shapes.png", magnify=0.5, marks=marks)
    drawn = []

    def scenery(axes, k):
        drawn.append(k)
        return axes.plot([0, 1], [-1, -1])

    plot.animate(solution, [0, 5, 10], tmp_path / "motion.gif", marks=marks, scenery=scenery)
    assert drawn == [0, 5, 10]
    found = fb.modes(scene, n=4)
    plot.modes(found, tmp_path / "modes.png", count=3)
    # Without a path the figures are what is returned, for notebooks and for changes.
    assert len(plot.modes(found, count=3).axes) == 3
    with pytest.warns(DeprecationWarning, match="found is now modes"):
        assert len(plot.modes(found=found, count=2).axes) == 2
    assert plot.shapes(solution, [0, 5]).axes[0].get_xlabel() == "$x$ [m]"
    with pytest.warns(DeprecationWarning, match="length_unit is now scene_unit"):
        assert plot.shapes(solution, [0], length_unit="mm").axes[0].get_xlabel() == "$x$ [mm]"
    for name, least in (("shapes.png", 20e3), ("motion.gif", 5e3), ("modes.png", 10e3)):
        assert (tmp_path / name).stat().st_size > least


def test_a_force_is_drawn_with_the_section_that_it_follows():
    scene, bar = swinging()
    solution = fb.simulate(scene, dt=0.01, t_end=0.1)
    drawing = Drawing(solution, [0, 10])
    ((load, node),) = drawing.forces
    psi = solution.rotation(bar.end)[10]
    wanted = 5 * np.array([-np.sin(psi), np.cos(psi)])
    assert drawing.force(load, node, 10) == pytest.approx(wanted)
    assert drawing.largest_force == pytest.approx(5)


def test_a_file_that_cannot_be_written_is_refused_before_anything_is_drawn(tmp_path):
    solution = fb.simulate(swinging()[0], dt=0.01, t_end=0.1)
    with pytest.raises(ValueError, match=r"motion.avi: its name must end with .gif, .mp4"):
        plot.animate(solution, [0], tmp_path / "motion.avi")
    with pytest.raises(ValueError, match="make the folder .*nowhere first"):
        plot.shapes(solution, [0], tmp_path / "nowhere" / "shapes.png")
    with pytest.raises(ValueError, match="make the folder .*nowhere first"):
        plot.save(plot.figure(1, 1)[0], tmp_path / "nowhere" / "curves.png")
    with pytest.raises(ValueError, match="magnify = 0 must be a positive number"):
        plot.shapes(solution, [0], tmp_path / "a.png", magnify=0)


# -- Colours and films -----------------------------------------------------------------------------


@pytest.mark.parametrize("quantity", ["N", "Q", "M", "strain energy", "speed"])
def test_members_are_coloured_by_what_is_in_them(quantity):
    scene, bar = swinging()
    solution = fb.simulate(scene, dt=0.01, t_end=0.1)
    colouring = Colouring(Drawing(solution, [5, 10]), quantity, "m")
    lines = colouring.paint(colouring.lines(2.0), 10)
    middles = np.array(lines.get_segments()).mean(axis=1)
    values = along(solution, "bar", quantity, [10], (np.arange(12) + 0.5) / 12).ravel()
    np.testing.assert_array_equal(lines.get_array()[: len(values)], values)
    # In the same order as the pieces: from the pin along the bar.
    assert (np.diff(np.hypot(*middles[: len(values)].T)) > 0).all()
    low, high = colouring.scale.get_clim()
    assert high > 0 and low == (-high if quantity in "NQM" else 0)
    assert high >= lines.get_array().max() and low <= lines.get_array().min()


@pytest.mark.parametrize("file", ["shapes.png", "motion.gif"])
def test_coloured_pictures_are_written_and_differ_from_plain_ones(file, tmp_path):
    solution = fb.simulate(swinging()[0], dt=0.01, t_end=0.1)
    draw = plot.shapes if file == "shapes.png" else plot.animate
    for colour in (None, "speed"):
        draw(solution, [0, 5, 10], tmp_path / f"{colour} {file}", colour=colour)
    plain, coloured = (tmp_path.joinpath(f"{c} {file}").read_bytes() for c in (None, "speed"))
    assert plain != coloured and len(coloured) > 5e3
    with pytest.raises(ValueError, match="colour = 'T' must be one of 'N', 'Q', 'M', 'strain en"):
        draw(solution, [0], tmp_path / file, colour="T")


def test_an_animation_is_white_where_nothing_is_drawn(tmp_path):
    solution = fb.simulate(swinging()[0], dt=0.01, t_end=0.1)
    plot.animate(solution, [0, 5, 10], tmp_path / "motion.gif", colour="M")
    with Image.open(tmp_path / "motion.gif") as film:
        assert film.convert("RGB").getpixel((2, 2)) == (255, 255, 255)


def test_a_film_has_all_rows_and_is_played_at_its_speed(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    solution = fb.simulate(swinging()[0], dt=0.01, t_end=0.1)
    plot.animate(solution, range(11), tmp_path / "motion.mp4", fps=5)
    frames, seconds = ffmpeg.count_frames_and_secs(str(tmp_path / "motion.mp4"))
    assert frames == 11 and seconds == pytest.approx(11 / 5)
    assert (tmp_path / "motion.mp4").stat().st_size > 5e3


def test_a_film_without_what_writes_it_is_refused_before_anything_is_drawn(tmp_path, monkeypatch):
    solution = fb.simulate(swinging()[0], dt=0.01, t_end=0.1)
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    with pytest.raises(RuntimeError, match="MP4 needs imageio-ffmpeg: pip install imageio-ffmpeg"):
        plot.animate(solution, "all", tmp_path / "motion.mp4")


def test_shapes_that_nodes_carry_move_and_turn_with_them(tmp_path):
    scene = fb.Scene()
    wheel, ball = (scene.add_body((x, 1.0), mass=1.0, inertia=0.1).centre for x in (0, 3))
    scene.add_contact(ball, fb.Circle(wheel, 0.5), stiffness=1e3)
    scene.add_contact(ball, fb.Line(wheel, (1, 0)), stiffness=1e3)
    scene.set_velocity(wheel, (1.0, 0.0), spin=np.pi / 2)
    solution = fb.simulate(scene, dt=0.01, t_end=1.0)
    drawing = checked_drawing(solution, [0, 100], 1.0)
    circle, line = drawing.carried(100)
    assert circle.line.mean(axis=0) == pytest.approx([1.0, 1.0], abs=0.01)
    assert np.hypot(*(circle.line - (1.0, 1.0)).T) == pytest.approx(0.5)
    assert line.line[:, 1] == pytest.approx([1.0, 1.0], abs=1e-4)
    assert np.ptp(drawing.carried(0)[1].line[:, 0]) == pytest.approx(0, abs=1e-12)
    assert (drawing.window[1] >= circle.line.max(axis=0)).all()
    figure = fb.plot.shapes(solution, [0, 100])
    assert len(figure.axes[0].lines) >= 4
