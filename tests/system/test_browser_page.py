"""The page on which one plays a motion: what it holds, and what a browser makes of it."""

import base64
import json
import re

import browser
import numpy as np
import pytest
from scenes import clamped_bar, one_bar, one_body, pinned_bar

import fx_beam as fb
from fx_beam.plot.drawing import Drawing, line_between

pytestmark = pytest.mark.plot
ROPE = fb.Section(EA=1e4, GA=1e4, EI=1.0, rhoA=1.0, rhoI=1e-3)


def data(page):
    """Parts of the page."""
    return json.loads(
        re.search('<script type="application/json" id="data">(.*?)</script>', page.text)[1]
    )


def decoded(text, kind, *shape):
    return np.frombuffer(base64.b64decode(text), kind).reshape(shape).astype(float)


@pytest.fixture(scope="module", params=[1, 2])
def swing(request):
    """A rope with a body, and its motion."""
    scene, rope = pinned_bar(
        (1, 0), ROPE, 6, request.param, name="rope </script> & more", gravity=(0, -9.81)
    )
    disc = scene.add_body((1.1, 0.0), 0.5, 0.01, {"pin": (1.0, 0.0)}, name="disc")
    scene.add_joint(fb.Revolute(rope.end, disc.points["pin"]))
    scene.add_contact(rope, fb.Line((0, -3), (0, 1)), 1e4)
    return scene, rope, disc, fb.simulate(scene, dt=0.01, t_end=0.5)


def test_a_rope_whose_magnified_points_lie_in_a_pulley_is_drawn_straight():
    scene = fb.Scene()
    wheel = scene.add_body((0, 0), 5.0, 0.1).centre
    scene.fix(wheel, "x", "y")
    load = scene.add_body((1.0, 0.0), 1.0, 0.1).centre
    scene.set_velocity(load, (-1.0, 0.0))
    points = [(-2.0, 0.0), fb.Pulley(wheel, 0.3, side="left"), load]
    rope = scene.add_rope(points, spring=fb.Spring(1e-3, rest=10.0))
    solution = fb.simulate(scene, dt=0.02, t_end=0.2)
    start, end = line_between(Drawing(solution, [0, 10], 5.0), rope, [0, 10])  # 1 m to the left
    assert np.isfinite(start).all() and abs(start[:, 1]).max() > 0.29  # over the wheel
    np.testing.assert_allclose(end[[0, -1]], [(-2.0, 0.0), (0.0, 0.0)], atol=1e-3)
    assert abs(end[:, 1]).max() < 1e-3


def test_places_and_values_are_those_of_the_solution(swing):
    _, rope, disc, solution = swing
    steps = range(0, 51, 5)
    held = data(fb.plot.interactive(solution, rows=steps))
    low, high = map(np.array, held["window"])
    nodes = decoded(held["nodes"], "<i4", -1).astype(int)
    points = decoded(held["points"], "<u2", len(steps), len(nodes), 2)
    places = low + points / held["finest"] * (high - low)
    finest = (high - low).max() / held["finest"]
    for node in rope.nodes:
        own = places[:, nodes == node.number][:, 0]
        assert abs(own - solution.position(node)[list(steps)]).max() <= finest
    body = decoded(held["bodies"][0]["points"], "<u2", len(steps), 2, 2)
    own = (low + body / held["finest"] * (high - low))[:, 0]
    assert abs(own - solution.position(disc.centre)[list(steps)]).max() <= finest
    axial = held["quantities"][0]
    # Elements are drawn as pieces, with the force in the middle of each.
    pieces = held["beams"][0][1]
    middles = (np.arange(pieces) + 0.5) * rope.length / pieces
    largest = abs(solution.resultants(rope.name).at(middles).N[list(steps)]).max()
    assert axial["unit"] == "N"
    assert axial["largest"] == pytest.approx(largest, rel=1e-12)
    assert held["t"] == solution.t[list(steps)].tolist()
    assert held["series"][-1]["values"] == solution.energy.total[list(steps)].tolist()


def test_a_page_needs_no_network_and_no_text_ends_its_data(swing):
    page = fb.plot.interactive(swing[3])
    assert not re.search(r"https?://|src=|@import|url\(", page.text)
    assert page.text.count("</script>") == 2
    assert data(page)["beams"][0][0] == "rope </script> & more"
    assert "<iframe srcdoc=" in page._repr_html_()


def test_two_thousand_members_with_two_hundred_rows_are_less_than_20_mb():
    scene = fb.Scene(gravity=(0, -9.81))
    for i in range(40):
        bar = scene.add_beam([(i, 0), (i, 1)], ROPE, elements=1)
        scene.clamp(bar.start)
    page = fb.plot.interactive(fb.simulate(scene, dt=0.001, t_end=0.05))
    empty = fb.plot.interactive(fb.simulate(scene, dt=0.001, t_end=0.001))
    each = (len(page.text) - len(empty.text)) / (40 * 49)
    assert 2000 * 200 * each < 20e6


def test_symbols_move_with_their_nodes_and_points():
    scene, bar = one_bar((1, 0), ROPE, 4)
    scene.fix(bar.start, "y")
    scene.prescribe(bar.start, x=lambda t: -t)
    scene.add_mass(bar.end, 1.0)
    scene.add_force(bar.end, (0.0, 3.0))
    scene.add_force_between(bar.end, (2.0, 1.0), spring=fb.Spring(1.0))
    scene.set_velocity(bar, lambda x, y: (-1.0, 0.0))
    solution = fb.simulate(scene, dt=0.1, t_end=1.0)
    held = data(fb.plot.interactive(solution))
    low, high = map(np.array, held["window"])

    def places(one, count):
        points = decoded(one["points"], "<u2", len(held["t"]), count, 2)
        return low + points / held["finest"] * (high - low)

    near = {"abs": 1e-4}
    (here,) = held["stretches"]
    (support,), (spring,), (force,) = here["supports"], here["between"], here["forces"]
    (mass,) = (one for one in here["markers"] if one["count"])
    start, end = solution.position(bar.start), solution.position(bar.end)
    assert places(support, 1)[:, 0] == pytest.approx(start, **near)
    assert start[-1][0] == pytest.approx(-1) and support["kind"] == "roller"
    assert mass["marker"] == "mass" and places(mass, 1)[:, 0] == pytest.approx(end, **near)
    assert spring["spring"] and places(spring, 2)[:, 0] == pytest.approx(end, **near)
    assert abs(places(spring, 2)[:, 1] - (2.0, 1.0)).max() < 1e-4
    assert places(force, 2)[:, 1] == pytest.approx(end, **near)
    assert (places(force, 2)[:, 0] < places(force, 2)[:, 1] + 1e-4).all()


def test_equilibria_and_scenes_of_bodies_have_pages_too():
    scene, beam = clamped_bar((1, 0), ROPE, elements=4, load=(0, -1.0))
    assert data(fb.plot.interactive(fb.static(scene, load_steps=3)))["static"]
    scene, body = one_body((0, 0), 1.0, 0.1, {"edge": (0.1, 0)}, name="stone", gravity=(0, -9.81))
    page = fb.plot.interactive(fb.simulate(scene, dt=0.1, t_end=0.5), trace=body.centre)
    assert data(page)["quantities"] == [] and len(data(page)["traces"]) == 1


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"path": "motion.txt"}, "must end with .html"),
        ({"rows": [99]}, "rows of the solution"),
        ({"series": {"tip": [1.0, 2.0]}}, "one for each row"),
        ({"series": 3}, "a dict of values by name"),
        ({"magnify": 0}, "a positive number"),
        ({"scene_unit": 3}, "a text"),
    ],
)
def test_what_cannot_be_shown_is_refused(swing, options, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=re.escape(words)):
        fb.plot.interactive(swing[3], **options)
    assert not list(tmp_path.iterdir())


# Played to row 20 by the slider, with colours, and the pointer at the end of the rope.
SCRIPT = """
find("quantity").value = "2"; find("quantity").dispatchEvent(new Event("change"));
find("row").value = "20"; find("row").dispatchEvent(new Event("input"));
const box = find("shapes").getBoundingClientRect(), last = 2 * (row * perRow + perRow - 1);
find("shapes").dispatchEvent(new PointerEvent("pointermove", {
  clientX: box.left + toX(points[last]), clientY: box.top + toY(points[last + 1]) }));
const pixels = id => { const c = find(id);
  return c.getContext("2d").getImageData(0, 0, c.width, c.height).data; };
const coloured = id => { let n = 0; const p = pixels(id);
  for (let i = 0; i < p.length; i += 4) {
    const rgb = [p[i], p[i + 1], p[i + 2]];
    if (p[i + 3] && Math.max(...rgb) - Math.min(...rgb) > 40) n++;
  }
  return n; };
const shades = () => { const one = data.quantities[quantity], start = row * first.length;
  return first.map((_, piece) => shade(one, one.values[start + piece])); };
const scaled = (most, log) => {
  find("most").value = most; find("log").checked = log;
  find("most").dispatchEvent(new Event("change"));
  return shades(); };
const scales = { all: shades(), tight: scaled(1e-9, false), log: scaled("", true),
  back: scaled("", false) };
const seen = { scales, row, time: find("time").textContent, tip: find("tip").textContent,
  shapes: coloured("shapes"), curves: coloured("curves") };
const at_last = type => find("shapes").dispatchEvent(new PointerEvent(type, {
  clientX: box.left + toX(points[last]), clientY: box.top + toY(points[last + 1]) }));
find("shapes").setPointerCapture = () => {};  // there is no real pointer
const click = () => { at_last("pointerdown"); at_last("pointerup"); return clicked.size; };
const traced = [click(), click()];
const under = [toX(points[last]), toY(points[last + 1])];
find("shapes").dispatchEvent(new WheelEvent("wheel", { deltaY: -500,
  clientX: box.left + under[0], clientY: box.top + under[1] }));
const zoomed = [view.scale, toX(points[last]) - under[0], toY(points[last + 1]) - under[1]];
find("shapes").dispatchEvent(new MouseEvent("dblclick"));
const curves = find("curves").getBoundingClientRect();
find("curves").dispatchEvent(new PointerEvent("pointerdown", {
  clientX: curves.left + EDGE.left + 0.3 * (curves.width - EDGE.left - EDGE.right) }));
const used = { traced, zoomed, reset: view.scale, picked: row };
show(20);
let next = null;
window.requestAnimationFrame = one => { next = one; return 1; };
play();
next(0); next(600);
document.title = JSON.stringify({ ...seen, ...used, played: row });
"""


@pytest.mark.slow
@browser.needed
def test_a_browser_plays_it_and_tells_what_is_under_the_pointer(swing, tmp_path):
    _, rope, _, solution = swing
    file = tmp_path / "motion.html"
    page = fb.plot.interactive(solution, file, trace=rope.end)
    assert file.read_text("utf-8") == page.text
    file.write_text(page.text.replace("</body>", f"<script>{SCRIPT}</script></body>"), "utf-8")
    title = re.search("<title>(.*?)</title>", browser.dom(file, tmp_path / "profile"))[1]
    seen = json.loads(title)
    assert seen["row"] == 20 and seen["time"] == "t = 0.2 s"
    x, y = solution.position(rope.end)[20]
    assert f"node {rope.end.number}, s = 1" in seen["tip"]
    tip = re.search(r"x = (\S+), y = (\S+) m", seen["tip"])
    assert [float(tip[1]), float(tip[2])] == pytest.approx([x, y], abs=1e-3)
    assert "bending moment M = " in seen["tip"]
    assert seen["shapes"] > 500 and seen["curves"] > 500
    # The whole motion in 6 s: 0.6 s later it is a tenth further on.
    assert abs(seen["played"] - 25) <= 1
    # A click draws the path of a point, another one removes it; the wheel zooms about the pointer,
    # whose position a browser gives in whole pixels.
    assert seen["traced"] == [1, 0] and seen["reset"] == 1
    assert seen["zoomed"][0] == pytest.approx(np.exp(1))
    assert seen["zoomed"][1:] == pytest.approx([0, 0], abs=4)
    # A click on the curves shows the row of that time.
    assert abs(seen["picked"] - 15) <= 1
    # Beyond a tight limit all have the colours of the ends; on a log scale weak values are seen.
    scales = {name: np.array(shades) for name, shades in seen["scales"].items()}
    assert set(scales["tight"]) <= {0, 63} | {31, 32}
    strong = {name: abs(shades - 31.5) for name, shades in scales.items()}
    assert (strong["log"] >= strong["all"] - 1).all() and strong["log"].min() > strong["all"].min()
    assert (scales["back"] == scales["all"]).all()
