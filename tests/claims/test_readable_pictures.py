"""Pictures are read without help: values where they are, words on no ink, colours apart."""

from itertools import pairwise

import numpy as np
import pytest
from pytest import approx
from scenes import FLYING, assert_refused, clamped_bar, pinned_bar

import fx_beam as fb

plot = pytest.importorskip("fx_beam.plot")
look = pytest.importorskip("fx_beam.plot.look")
FigureCanvasAgg = pytest.importorskip("matplotlib.backends.backend_agg").FigureCanvasAgg
pytestmark = pytest.mark.plot
STIFF = fb.Section(EA=1e9, GA=1e9, EI=1e7)
SPAN, LOAD = 4.0, 12e3


def continuous():
    """A beam on three supports under a line load: M = -q L^2/8, 9/128 q L^2, Q = 3/8, 5/8 q L."""
    scene, beam = pinned_bar([(0, 0), (SPAN, 0), (2 * SPAN, 0)], STIFF, elements=(4, 4), degree=2)
    for node in (beam.node(0.5), beam.end):
        scene.fix(node, "y")
    scene.add_line_load(beam, (0, -LOAD))
    return fb.static(scene, linear=True)


def numbers(figure, panel=0):
    """Numbers that are written in a panel."""
    texts = [text.get_text().replace("\u2212", "-") for text in figure.axes[panel].texts]
    return sorted(float(text) for text in texts if text.lstrip("-")[0].isdigit())


def test_each_part_between_supports_has_its_extreme_values_in_kilonewtons():
    figure = plot.diagrams(continuous(), quantities=["Q", "M"])
    force, moment = LOAD * SPAN / 1e3, LOAD * SPAN**2 / 1e3
    shear = [part * force for part in (-0.625, -0.375, 0.375, 0.625)]
    assert numbers(figure, 0) == approx(shear, rel=5e-3)
    # The moment over the support is written once, though both parts end there.
    bending = [-moment / 8, 9 * moment / 128, 9 * moment / 128]
    assert numbers(figure, 1) == approx(bending, rel=5e-3)
    words = " ".join(text.get_text() for text in figure.texts)
    assert "[kN]" in words and "[kN m]" in words


def test_of_many_members_the_extreme_values_of_the_frame_are_written():
    scene, fields = fb.Scene(), 14  # a clamped beam under a line load: M = -q L^2/12, q L^2/24
    places = np.linspace(0, SPAN, fields + 1)
    members = [scene.add_beam([(a, 0), (b, 0)], STIFF) for a, b in pairwise(places)]
    for left, right in pairwise(members):
        scene.add_joint(fb.Rigid(left.end, right.start))
    scene.clamp(members[0].start)
    scene.clamp(members[-1].end)
    for member in members:
        scene.add_line_load(member, (0, -LOAD))
    figure = plot.diagrams(fb.static(scene, linear=True), quantities=["M"])
    moment = LOAD * SPAN**2 / 1e3
    assert numbers(figure) == approx([-moment / 12, moment / 24], rel=5e-3)


def test_of_a_force_that_varies_little_the_largest_value_is_written():
    scene, beam = clamped_bar((3, 0), STIFF, elements=2)
    scene.add_line_load(beam, (1.0, 0.0))
    scene.add_force(beam.end, (100.0, 0.0))
    assert numbers(plot.diagrams(fb.static(scene, linear=True), quantities=["N"])) == [103.0]


def test_a_force_inside_an_element_is_a_step_of_the_shear_force():
    scene, beam = clamped_bar((3, 0), STIFF, elements=1)
    scene.add_force(beam.at(1.3), (0, -6.0))
    scene.add_force(beam.end, (0, -2.0))
    figure = plot.diagrams(fb.static(scene, linear=True), quantities=["Q"], deformed=False)
    (line,) = (line.get_xydata() for line in figure.axes[0].lines if line.get_zorder() == 2)
    before, after = line[abs(line[:, 0] - 1.3) < 1e-9][:, 1]
    start = line[1, 1]
    assert before == approx(start) and after / start == approx(2 / 8)


def test_ropes_have_their_force_and_slack_ones_are_dashed():
    scene, beam = clamped_bar((2, 0), STIFF, elements=2)
    scene.free(beam.start, "rotation")
    taut = scene.add_rope([beam.end, (2, 1)], spring=fb.Spring(1e9), length=1.0)
    scene.add_rope([beam.end, (2, -1)], spring=fb.Spring(1e6), length=1.0)
    scene.add_force(beam.end, (0.0, -80.0))
    solution = fb.static(scene)
    assert solution.joint(taut).force[-1] == approx(80.0)
    figure = plot.diagrams(solution, quantities=["N", "M"])
    (axial, bending) = figure.axes
    assert {"rope 80", "slack"} <= {text.get_text() for text in axial.texts}
    assert "slack" not in {text.get_text() for text in bending.texts}
    dashed = [line.get_xydata()[0] for line in axial.lines if line.is_dashed()]
    assert dashed[0] == approx(solution.position(beam.end)[-1])


def portal():
    scene, left = pinned_bar((0, 3), STIFF, elements=2, name="left")
    girder = scene.add_beam([left.end, (5, 3), (5, 0)], STIFF, elements=(4, 2), name="girder")
    scene.pin(girder.end)
    scene.add_line_load(girder, (0, -3e3), between=(0, 5))
    scene.add_force(left.end, (4e3, 0))
    scene.add_mass(girder.node(0.3125), 40.0)
    return scene


@pytest.mark.parametrize("theme", ["light", "dark"])
@pytest.mark.parametrize("kind", ["scene", "diagrams", "shapes"])
def test_words_lie_on_no_ink_and_apart(kind, theme):
    scene = portal()
    subject = scene if kind == "scene" else fb.static(scene, linear=True)
    marks = {"marks": {"corner": scene.beams["left"].end}} if kind == "shapes" else {}
    figure = getattr(plot, kind)(subject, theme=theme, **marks)
    figure.set_dpi(100)
    canvas = FigureCanvasAgg(figure)
    texts = [text for ax in figure.axes for text in ax.texts]
    boxes = [text.get_window_extent(canvas.get_renderer()) for text in texts]
    for text in texts:
        text.set_visible(False)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[::-1, :, :3].astype(int)
    assert len(boxes) >= {"scene": 5, "diagrams": 8, "shapes": 1}[kind]
    for i, box in enumerate(boxes):
        (x0, y0), (x1, y1) = box.min.astype(int), box.max.astype(int)
        part = pixels[y0:y1, x0:x1]
        assert (abs(part - pixels[2, 2]).max(axis=-1) > 40).mean() < 0.06, texts[i]
        assert not any(box.overlaps(other) for other in boxes[:i])


def test_the_last_shape_is_strong_and_earlier_ones_fade_towards_it():
    scene, beam = pinned_bar((1, 0), FLYING, elements=4, gravity=(0, -9.81))
    solution = fb.simulate(scene, dt=0.01, t_end=0.3)
    lines = plot.shapes(solution, rows=[0, 10, 20, 30]).axes[0].lines
    strengths = {}
    for line in lines:
        end = line.get_xydata()[-2] if len(line.get_xydata()) > 1 else None
        for k in (0, 10, 20, 30):
            if end is not None and np.hypot(*(end - solution.position(beam.end)[k])) < 1e-9:
                blue, paper = np.array(look.mixed(look.MEMBERS[0], "#ffffff", 0)), np.ones(3)
                share = np.mean((paper - line.get_color()) / (paper - blue))
                strengths[k] = max(strengths.get(k, 0.0), share)
    assert strengths[0] < strengths[10] < strengths[20] < 0.6 < strengths[30]


@pytest.mark.parametrize("theme", look.THEMES)
def test_colours_can_be_seen_on_the_paper(theme):
    def luminance(colour):
        parts = np.array(look.mixed(colour, colour, 0))
        return (
            (parts / 12.92) * (parts <= 0.04) + ((parts + 0.055) / 1.055) ** 2.4 * (parts > 0.04)
        ) @ (0.2126, 0.7152, 0.0722)

    paper = luminance(look.THEMES[theme].paper)
    for colour in (*look.MEMBERS, look.ACTS, look.ROPE):
        low, high = sorted((luminance(colour), paper))
        assert (high + 0.05) / (low + 0.05) > 3
    # Of a scale of colours the weakest one can be told from the paper.
    for colour in plot.symbols.SEQUENTIAL[theme]((0.0, 1.0)):
        low, high = sorted((luminance(tuple(colour[:3])), paper))
        assert (high + 0.05) / (low + 0.05) > 1.35


def test_notebooks_show_pictures_and_films_without_a_path():
    scene, _ = pinned_bar((1, 0), FLYING, elements=2, gravity=(0, -9.81))
    solution = fb.simulate(scene, dt=0.01, t_end=0.05)
    for figure in (plot.scene(scene), plot.shapes(solution), plot.diagrams(solution)):
        assert figure._repr_png_().startswith(b"\x89PNG")
    film = plot.animate(solution, count=3, theme="dark")
    assert film.startswith(b"GIF89a") and "data:image/gif;base64," in film._repr_html_()
    assert str(film) == "<Film: 0.0 MB>"
    assert_refused("theme = 'grey' must be 'light' or 'dark'", plot.scene, scene, theme="grey")
    assert_refused("title = 3 must be a text", plot.shapes, solution, title=3)


def colours_at(figure, places):
    """Colours (n, 3) from 0 to 1 at places of the drawing."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    pixels = np.asarray(canvas.buffer_rgba())[::-1, :, :3] / 255
    columns, rows = figure.axes[0].transData.transform(places).astype(int).T
    return pixels[rows, columns]


def still_bar():
    """A thick bar of three elements that does not move, and the middles of these."""
    scene, bar = clamped_bar((3, 0), fb.Section.rectangle(0.3, 0.1, **fb.materials.steel), 3)
    return fb.simulate(scene, dt=0.1, t_end=0.2), [(0.5, 0), (1.5, 0), (2.5, 0)]


@pytest.mark.parametrize("theme", look.THEMES)
def test_a_field_of_ones_own_and_times_have_the_colours_of_their_bar(theme):
    solution, middles = still_bar()
    field = np.array([[2.0], [5.0], [3.0]])
    every = np.array([0 * field, field, -field])
    for values, choice in ((field, {"rows": [-1]}), (every, {"rows": [1]})):
        figure = plot.shapes(solution, colour={"damage": values}, theme=theme, **choice)
        bar = figure.axes[1]
        assert "damage" in (bar.get_xlabel(), bar.get_ylabel())
        ramp = np.asarray(plot.symbols.SEQUENTIAL[theme](field.ravel() / 5.0))[:, :3]
        assert abs(colours_at(figure, middles) - ramp).max() < 0.02
    last = plot.shapes(solution, colour="time", theme=theme)
    assert abs(colours_at(last, middles) - plot.symbols.SEQUENTIAL[theme](1.0)[:3]).max() < 0.02


def test_a_field_has_a_value_for_each_element_in_each_row():
    solution, _ = still_bar()
    expected = "must be finite values .elements, m. of 3 elements in the one row that is shown"
    for values, rows in (
        (np.ones((2, 1)), [-1]),
        (np.ones((3, 1)), [0, 1]),
        (np.ones((2, 3, 1)), [0]),
        (np.full((3, 1), np.nan), [-1]),
        (np.ones((3, 0)), [-1]),
    ):
        assert_refused(expected, plot.shapes, solution, rows=rows, colour={"f": values})
    assert_refused("must be values by one label", plot.shapes, solution, colour={})
    assert_refused("must be values by one label", plot.animate, solution, colour={2: [[1.0]]})


def test_dimensions_are_of_the_pairs_that_are_named():
    scene = portal()
    left, girder = scene.beams["left"], scene.beams["girder"]
    figure = plot.scene(scene, dimensions=[(left.start, left.end), (left.start, girder.end)])
    texts = {text.get_text() for text in figure.axes[0].texts}
    assert {"3", "5"} <= texts and not figure.axes[0].axison


def test_members_have_their_depth_where_their_section_has_sizes():
    widths = []
    for section in fb.Section.rectangle(0.2, 0.1, **fb.materials.steel), STIFF:
        scene, _ = clamped_bar((2, 0), section, elements=2)
        ax = plot.scene(scene).axes[0]
        point = np.ptp(ax.get_xlim()) / (ax.get_window_extent().width * 72 / ax.figure.dpi)
        edge = max(line.get_linewidth() for line in ax.lines if line.get_zorder() == 3)
        widths.append((edge - 1.5) * point)
    assert widths[0] == approx(0.2, rel=1e-6)
    assert widths[1] == approx(3.4 * point)  # sqrt(12 EI/EA) would be 0.35
