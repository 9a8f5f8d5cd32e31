"""Symbols in pictures: how many there are and where, and that nothing is cut off."""

import re

import numpy as np
import pytest
from scenes import FLYING

import fx_beam as fb

plot = pytest.importorskip("fx_beam.plot")
Figure = pytest.importorskip("matplotlib.figure").Figure
Image = pytest.importorskip("PIL.Image")
drawing = pytest.importorskip("fx_beam.plot.drawing")
digits = pytest.importorskip("fx_beam.plot.digits")
plane = pytest.importorskip("fx_beam.plot.plane")
Colouring = pytest.importorskip("fx_beam.plot.colouring").Colouring
Supports = pytest.importorskip("fx_beam.plot.supports").Supports
pytestmark = pytest.mark.plot


def crank(length=1.0):
    """A crank on a pin, a rod on a hinge, and its end on a roller, which is driven."""
    scene = fb.Scene()
    arm = scene.add_beam([(0, 0), (0, length)], FLYING, 2, name="crank")
    rod = scene.add_beam([(0, length), (2.0, 0)], FLYING, 2, name="rod")
    scene.pin(arm.start)
    scene.add_joint(fb.Revolute(arm.end, rod.start))
    scene.fix(rod.end, "y")
    scene.prescribe(rod.end, x=lambda t: -0.5 * t * t)
    return scene, arm, rod


def markers(ax, marker):
    """Positions (n, 2) of the white markers of a kind."""
    lines = [line for line in ax.lines if line.get_marker() == marker]
    white = [line.get_xydata() for line in lines if line.get_markerfacecolor() == "white"]
    return np.concatenate([np.empty((0, 2)), *white])


def holds(figure):
    """Whether all that is written lies inside the figure."""
    box, frame = figure.get_tightbbox(), figure.bbox_inches
    return (box.min >= frame.min - 0.01).all() and (box.max <= frame.max + 0.01).all()


# -- Supports and joints ---------------------------------------------------------------------------


def test_supports_are_where_their_nodes_are_in_each_row():
    scene, arm, rod = crank()
    solution = fb.simulate(scene, dt=0.05, t_end=1.0)
    supports = Supports(drawing.Drawing(solution, [0, 10, 20]))
    for k in (0, 10, 20):
        ax = Figure().add_subplot()
        supports.draw(ax, k)
        nodes = [solution.position(node)[k] for node in (arm.start, rod.end)]
        assert markers(ax, "o") == pytest.approx(np.array(nodes))
    assert nodes[1][0] == pytest.approx(1.5)


def test_a_clamp_is_across_a_single_member_and_along_an_axis_under_several():
    def wall(*ends):
        scene = fb.Scene()
        start = (0, 0)
        for end in ends:
            beam = scene.add_beam([start, end], FLYING)
            start = beam.start
        scene.clamp(start)
        of_scene = fb.simulate(scene, dt=0.1, t_end=0.1)
        (strokes,) = Supports(drawing.Drawing(of_scene, [0])).symbols.values()
        return np.diff(strokes.thick[0], axis=0)[0]

    assert wall((1, 1)) @ (1, 1) == pytest.approx(0)
    assert wall((0, 1), (1, 1.5))[1] == pytest.approx(0)  # a column with a brace


@pytest.mark.parametrize("law", ["spring", "damper", "friction", "force"])
@pytest.mark.parametrize("fixed", [False, True], ids=["nodes", "point"])
def test_a_force_between_points_is_drawn_between_them_before_and_in_the_motion(law, fixed):
    laws = {
        "spring": fb.Spring(5.0),
        "damper": fb.Damper(1.0),
        "friction": fb.Friction(1.0, 0.01),
        "force": lambda distance, rate, t: 1.0 + 0 * distance,
    }
    scene = fb.Scene()
    left, right = (scene.add_beam([(x, 0), (x, 1)], FLYING) for x in (0.0, 2.0))
    for beam in (left, right):
        scene.pin(beam.end)
    other = (1.0, -1.0) if fixed else right.start
    scene.add_force_between(left.start, other, **{law: laws[law]})
    solution = fb.simulate(scene, dt=0.05, t_end=0.5)
    for figure, k in (plot.scene(scene), 0), (plot.shapes(solution, [0, 10]), 10):
        a = solution.position(left.start)[k]
        b = np.array(other) if fixed else solution.position(right.start)[k]
        lines = [line.get_xydata() for line in figure.axes[0].lines]
        near = [max(np.nanmin(np.hypot(*(p - q).T)) for p in (a, b)) for q in lines if len(q)]
        assert min(near) < 1e-9, "a line has both ends"
        low, high = np.transpose([figure.axes[0].get_xlim(), figure.axes[0].get_ylim()])
        assert (b > low).all() and (b < high).all()


# -- Nothing is cut off ----------------------------------------------------------------------------


ENDS = (1, 0), (0, 1), (1, 1), (20, 1), (1, 20), (0.001, 0.002), (1e4, -9e3)


@pytest.mark.parametrize("colour", [None, "M"])
@pytest.mark.parametrize("end", ENDS, ids=str)
def test_labels_lie_in_figures_that_fit_a_page(end, colour):
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), end], FLYING, 4)
    scene.clamp(beam.start)
    solution = fb.simulate(scene, dt=0.001, t_end=0.002)
    figure = plot.shapes(solution, [0, 2], colour=colour)
    assert holds(figure) and holds(plot.scene(scene, dimensions=True))
    assert (figure.get_size_inches() <= np.add(plane.LARGEST, 1e-9)).all()


@pytest.mark.parametrize("end", ENDS, ids=str)
def test_titles_of_frames_do_not_cover_each_other(end, tmp_path, monkeypatch):
    from fx_beam.plot import animations

    kept = []
    monkeypatch.setattr(
        animations, "Plane", lambda *given: kept.append(plane.Plane(*given)) or kept[0]
    )
    scene = fb.Scene(gravity=(0, -9.81))
    beam = scene.add_beam([(0, 0), end], FLYING, 4)
    scene.clamp(beam.start)
    plot.animate(fb.simulate(scene, dt=0.001, t_end=0.002), [0, 1, 2], tmp_path / "film.gif")
    figure = kept[0].figure
    first, second = (text.get_window_extent() for text in kept[0].ax.texts[:2])
    assert holds(figure) and not first.overlaps(second)
    for box in (first, second):
        assert (box.min > 0).all() and (box.max < figure.bbox.max).all()


def test_arrows_of_forces_are_in_the_window():
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], FLYING, 4)
    scene.clamp(beam.start)
    scene.add_force(beam.end, (-5.0, 0))
    (arrow,) = (
        of
        for of in plot.shapes(fb.static(scene, steps=1), [1]).axes[0].collections
        if hasattr(of, "U")
    )
    tail, right = arrow.X[0], arrow.axes.get_xlim()[1]
    assert 1.1 < tail < right


@pytest.mark.parametrize("name", ["scene", "shapes", "diagrams", "modes"])
def test_pictures_are_returned_and_written_into_files_of_the_same_kinds(name, tmp_path):
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], FLYING, 2)
    scene.clamp(beam.start)
    solution = fb.simulate(scene, dt=0.01, t_end=0.02)
    given = {"scene": (scene,), "shapes": (solution, [0, 2]), "diagrams": (solution, 2)}
    draw, given = getattr(plot, name), given.get(name) or (fb.modes(scene, n=2),)
    assert isinstance(draw(*given), Figure)
    for ending in ("png", "svg", "pdf", "webp"):
        assert isinstance(draw(*given, tmp_path / f"picture.{ending}"), Figure)
        assert (tmp_path / f"picture.{ending}").stat().st_size > 1000
    with pytest.raises(ValueError, match="its name must end with .*png.*svg"):
        draw(*given, tmp_path / "picture.doc")


# -- Modes -----------------------------------------------------------------------------------------


def test_modes_have_supports_at_rest_equal_panels_and_the_numbers_of_modes():
    scene = fb.Scene()
    column = scene.add_beam([(0, 0), (0, 3)], FLYING, 4)
    beam = scene.add_beam([column.end, (4, 3)], FLYING, 4)
    other = scene.add_beam([(4, 3), (4, 0)], FLYING, 4)
    scene.add_joint(fb.Revolute(beam.end, other.start))
    scene.clamp(column.start)
    scene.pin(other.end)
    found = fb.modes(scene, n=7)
    figure = plot.modes(found)
    figure.canvas.draw()
    assert len(figure.axes) == 7
    for mode, ax in enumerate(figure.axes):
        assert ax.get_title().startswith(f"mode {mode}: ")
        rings = markers(ax, "o")
        assert abs(rings - (4, 0)).max(axis=1).min() == 0  # the pin
        moved = found.shape(other, mode, 0.15 * 4)[0]
        assert abs(rings - moved).max(axis=1).min() < 1e-12  # the hinge
    sizes = [ax.get_window_extent().size for ax in figure.axes]
    assert np.ptp(sizes, axis=0) == pytest.approx([0, 0], abs=1)
    assert holds(figure)


# -- Numbers ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0598561, "0.0599"),
        (9.80665, "9.81"),
        (-2.5, "-2.5"),
        (1234.0, "1234"),
        (999.9, "1000"),
        (45678.9, "45679"),
        (2.1e11, "2.1e+11"),
        (0.0, "0"),
    ],
)
def test_numbers_have_three_digits_or_all_before_the_point(value, text):
    assert digits.three_digits(value) == text


# -- Thickness, colour scales and frames -----------------------------------------------------------


def bands(figure):
    """Corners (pieces, 4, 2) of the members of a picture."""
    (bands,) = (of for of in figure.axes[0].collections if len(of.get_paths()) > 1)
    return np.array([path.vertices[:4] for path in bands.get_paths()])


@pytest.mark.parametrize("factor", [1.0, 3.0])
@pytest.mark.parametrize("degree", [1, 3])
def test_members_are_as_thick_as_their_sections_and_turn_with_them(degree, factor):
    scene = fb.Scene()
    depth = lambda f: 0.2 - 0.1 * f  # noqa: E731
    steel = fb.Section.rectangle(height=depth, width=0.1, E=210e9, rho=7850.0)
    beam = scene.add_beam([(0, 0), (2, 0)], steel, 4, degree, name="arm")
    scene.pin(beam.start)
    scene.set_velocity(beam, lambda x, y: (0, x), spin=1.0)
    solution = fb.simulate(scene, dt=0.05, t_end=0.5)
    corners = bands(plot.shapes(solution, [10], colour="N", thickness=factor))
    across = corners[:, 0] - corners[:, 3]
    ends = np.arange(len(corners)) / len(corners)
    assert np.hypot(*across.T) == pytest.approx(factor * depth(ends), rel=1e-9)
    psi = np.interp(ends * 2, beam.s, solution.q[10][[node.number for node in beam.nodes], 2])
    assert np.arctan2(*across.T) == pytest.approx(-psi, abs=1e-4)
    middles = (corners[:, 0] + corners[:, 3]) / 2
    assert np.hypot(*middles.T) == pytest.approx(2 * ends, rel=1e-3)


def test_thickness_that_is_not_known_is_refused(tmp_path):
    scene = fb.Scene()
    energy = fb.Section(
        strain_energy=lambda eps, gamma, kappa: eps**2 + gamma**2 + kappa**2, rhoA=1
    )
    beam = scene.add_beam([(0, 0), (2, 0)], energy, name="arm")
    scene.clamp(beam.start)
    solution = fb.simulate(scene, dt=0.05, t_end=0.05)
    with pytest.raises(ValueError, match="needs EA and EI, or rhoA and rhoI, in the section of 'a"):
        plot.shapes(solution, [0], thickness=1.0)
    with pytest.raises(ValueError, match="thickness = -1 must be a positive factor"):
        plot.shapes(solution, [0], thickness=-1)


def bent():
    """A cantilever under a force at its end: about M = -1 at the clamp, and 0 at the end."""
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e4, GA=1e4, EI=1.0), 10)
    scene.clamp(beam.start)
    scene.add_force(beam.end, (0, -1.0))
    return fb.static(scene, steps=1)


@pytest.mark.parametrize(
    ("options", "ends", "extend"),
    [
        ({"colour": "M", "colour_limits": (-0.5, 2.0)}, (-0.5, 2.0), "min"),
        ({"colour": "M", "colour_limits": (-0.5, 0.5)}, (-0.5, 0.5), "min"),
        ({"colour": "strain energy", "colour_limits": (0.01, 0.2)}, (0.01, 0.2), "both"),
        ({"colour": "M", "colour_scale": "log", "colour_limits": (0.1, 10)}, (-10, 10), "neither"),
    ],
)
def test_limits_are_the_ends_of_the_colours_and_arrows_show_what_is_beyond(options, ends, extend):
    solution = bent()
    limits, scale = options["colour_limits"], options.get("colour_scale", "linear")
    of_rows = drawing.Drawing(solution, [1])
    colouring = Colouring(of_rows, options["colour"], "m", limits, scale)
    assert colouring.scale.get_clim() == ends
    assert colouring.bar["extend"] == extend
    bar = plot.shapes(solution, [1], **options).axes[1]
    # The axis of a logarithmic scale goes there and back through the logarithm.
    shown = bar.get_ylim() if bar.get_ylabel() else bar.get_xlim()
    assert shown == pytest.approx(ends, rel=1e-12)


def test_a_log_scale_tells_weak_values_apart():
    of_rows = drawing.Drawing(bent(), [0, 1])
    parts = {}
    for scale in ("linear", "log"):
        colouring = Colouring(of_rows, "strain energy", "m", None, scale)
        lines = colouring.paint(colouring.lines(1.0), 1)
        parts[scale] = lines.norm(lines.get_array())
        at_rest = colouring.paint(lines, 0).norm(lines.get_array())
        assert not np.ma.is_masked(at_rest) and not at_rest.any(), "zero has the lowest colour"
    weak = parts["linear"] < 0.1
    assert np.ptp(parts["linear"][weak]) < 0.1 < 0.3 < np.ptp(parts["log"][weak])


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"colour_limits": (1, 1)}, "colour_limits = (1, 1) must be two finite numbers"),
        ({"colour_limits": 3}, "colour_limits = 3 must be two finite numbers"),
        ({"colour_limits": (0, 1), "colour_scale": "log"}, "both positive, on a log scale"),
        ({"colour_scale": "cubic"}, "colour_scale = 'cubic' must be 'linear' or 'log'"),
    ],
)
def test_scales_that_cannot_be_are_refused(options, words):
    scene, _, _ = crank()
    solution = fb.simulate(scene, dt=0.05, t_end=0.1)
    with pytest.raises(ValueError, match=re.escape(words)):
        plot.shapes(solution, [0], colour="M", **options)


@pytest.mark.parametrize("size", [(1920, 1080), (301, 407)])
@pytest.mark.parametrize("ending", ["gif", "mp4"])
def test_frames_have_the_size_that_is_asked_for(size, ending, tmp_path):
    scene, _, _ = crank()
    solution = fb.simulate(scene, dt=0.05, t_end=0.1)
    path = tmp_path / f"film.{ending}"
    if ending == "mp4":
        ffmpeg = pytest.importorskip("imageio_ffmpeg")
    plot.animate(solution, [0, 1, 2], path, size=size)
    if ending == "mp4":
        reader = ffmpeg.read_frames(str(path))
        even = tuple(n // 2 * 2 for n in size)
        assert next(reader)["size"] == even
        reader.close()
    else:
        with Image.open(path) as film:
            assert film.size == size and film.n_frames == 3


def test_lines_are_thinner_where_members_are_dense():
    def width(count):
        scene, nodes = fb.Scene(), {}
        for i in range(count + 1):
            for j in range(count + 1):
                for end in ((i + 1, j), (i, j + 1)):
                    if max(end) <= count:
                        bar = scene.add_beam([nodes.get(at, at) for at in ((i, j), end)], FLYING)
                        nodes[i, j], nodes[end] = bar.start, bar.end
        figure = plot.scene(scene)
        widest = max(line.get_linewidth() for line in figure.axes[0].lines)
        cell = figure.axes[0].bbox.width * 72 / figure.dpi / (1.2 * count)
        return widest, cell

    assert width(2)[0] == pytest.approx(2.5)
    dense, cell = width(24)
    assert dense < 0.15 * cell
