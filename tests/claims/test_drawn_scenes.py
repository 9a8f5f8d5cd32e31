"""Pictures of a motion are of the scene as it was when the motion ran."""

import base64
import io
import json

import numpy as np
import pytest
from pytest import approx
from scenes import FLYING, clamped_bar, pinned_bar

import fx_beam as fb

plot = pytest.importorskip("fx_beam.plot")
FigureCanvasAgg = pytest.importorskip("matplotlib.backends.backend_agg").FigureCanvasAgg
pytestmark = pytest.mark.plot
ROPE = fb.Spring(1e4)


def pendulum():
    """A bar on a pin, a ball on a rope above a floor, and a force."""
    scene, bar = pinned_bar((1, 0), FLYING, elements=4, gravity=(0, -9.81))
    ball = scene.add_body((2, 0), mass=1.0, inertia=0.1).centre
    rope = scene.add_rope([(1, 1), ball], spring=ROPE, length=np.sqrt(2))
    floor = scene.add_contact(ball, fb.Line((0, -1), (0, 1)), stiffness=1e4)
    load = scene.add_force(bar.end, (0, 5.0))
    return scene, bar, (rope, floor, load, scene.add_mass(bar.end, 0.01))


def change(scene, bar, parts):
    scene.remove(*parts)
    scene.free(bar.start)
    scene.clamp(bar.end)


def pixels(figure):
    file = io.BytesIO()
    figure.savefig(file, dpi=60, format="png")
    return file.getvalue()


def film(solution, path):
    plot.animate(solution, path, rows=[0, 5])
    return path.read_bytes()


PICTURES = {
    "shapes": lambda solution, path: pixels(plot.shapes(solution, rows=[0, 5], thickness=1.0)),
    "diagrams": lambda solution, path: pixels(plot.diagrams(solution)),
    "page": lambda solution, path: plot.interactive(solution).text,
    "film": film,
}


@pytest.mark.parametrize("kind", PICTURES)
@pytest.mark.parametrize("run", ["simulate", "static", "Motion"])
def test_a_picture_stays_as_it_is_when_the_scene_changes_later(run, kind, tmp_path):
    scene, bar, parts = pendulum()
    if run == "static":
        scene.remove(*parts[:2])
        scene.clamp(scene.bodies["body 1"].centre)
        scene.fix(bar.start, "rotation")
        solution = fb.static(scene, load_steps=5)
        parts = parts[2:]
    elif run == "simulate":
        solution = fb.simulate(scene, dt=0.01, t_end=0.05)
    else:
        motion = fb.Motion(scene, dt=0.01, record=fb.Record())
        for _ in range(5):
            motion.step()
        solution = motion.solution()
    before = PICTURES[kind](solution, tmp_path / "before.gif")
    change(scene, bar, parts)
    assert PICTURES[kind](solution, tmp_path / "after.gif") == before
    if run == "Motion":
        assert PICTURES[kind](motion.solution(), tmp_path / "late.gif") == before


@pytest.mark.parametrize("kind", ["modes", "buckling"])
def test_a_picture_of_modes_stays_as_it_is_when_the_scene_changes_later(kind):
    scene, bar = clamped_bar((1, 0), FLYING, elements=4, load=(-1e-3, 0))
    modes = fb.modes(scene, n=2) if kind == "modes" else fb.buckling(scene, n=2)
    before = pixels(plot.modes(modes))
    scene.free(bar.start)
    scene.pin(bar.end)
    assert pixels(plot.modes(modes)) == before


def page_of(solution):
    page = plot.interactive(solution).text
    return json.loads(page.split('id="data">', 1)[1].split("</script>", 1)[0])


def places(page, part):
    """Positions of a symbol in its rows."""
    (low, high), whole = map(np.array, page["window"]), base64.b64decode(part["points"])
    points = np.frombuffer(whole, "<u2").reshape(-1, 2) / page["finest"]
    return low + points * (high - low)


def caught(rebuilt):
    """A motion on a pin and a rope, then one without them: of the scene, or of one built anew."""
    scene, bar, parts = pendulum()
    swing = fb.simulate(scene, dt=0.01, t_end=0.1)
    if rebuilt:
        scene = fb.Scene(gravity=(0, -9.81))
        scene.add_body((2, 0), mass=1.0, inertia=0.1)
        bar = scene.add_beam([(0, 0), (1, 0)], FLYING, elements=4)
    else:
        scene.remove(*parts)
        scene.free(bar.start)
    scene.add_force(bar.start, (0, 1.0))
    return swing, swing.then(fb.simulate(scene, dt=0.01, t_end=0.2, start=swing))


@pytest.mark.parametrize("rebuilt", [False, True], ids=["one scene", "built anew"])
def test_joined_motions_have_in_each_row_the_parts_of_its_own_scene(rebuilt):
    swing, whole = caught(rebuilt)
    page = page_of(whole)
    first, second = page["stretches"]
    assert (first["first"], second["first"]) == (0, len(swing.t))
    counts = {name: (len(first[name]), len(second[name])) for name in ("supports", "between")}
    assert counts == {"supports": (1, 0), "between": (1, 0)}
    assert [len(part["obstacles"]) for part in (first, second)] == [1, 0]
    (support,), (rope,) = first["supports"], first["between"]
    assert places(page, support) == approx(np.zeros((len(swing.t), 2)), abs=1e-3)
    ball = whole.position(whole.bodies["body 1"].centre)[: len(swing.t)]
    assert places(page, rope)[1::2] == approx(ball, abs=1e-3)
    (pulled,), (pushed,) = first["forces"], second["forces"]
    bar = whole.shape("beam 1")
    assert places(page, pulled)[1::2] == approx(bar[: len(swing.t), -1], abs=1e-3)
    assert places(page, pushed)[1::2] == approx(bar[len(swing.t) :, 0], abs=1e-3)


def test_shapes_of_joined_motions_have_supports_that_are_gone():
    swing, whole = caught(False)
    rows = range(0, len(whole.t), 2)
    plain, drawn = plot.shapes(swing, rows=rows[:6]), plot.shapes(whole, rows=rows)

    def dark_below(ax):
        """Whether there is ink a little below the pin, where no member is."""
        canvas = FigureCanvasAgg(ax.figure)
        canvas.draw()
        x, y = ax.transData.transform((0.0, 0.0)).astype(int)
        ink = np.asarray(canvas.buffer_rgba())[::-1, :, :3].min(axis=2)
        return (ink[y - 12 : y - 4, x - 4 : x + 4] < 128).any()

    for figure in (plain, drawn):
        assert dark_below(figure.axes[0])


# -- Sizes -----------------------------------------------------------------------------------------


def rolling():
    """A ball of radius 0.2 that rolls on a floor, and its motion: from x = 0 at 1 m/s."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    ball = scene.add_body((0, 0.2), mass=2.0, inertia=0.1)
    friction = {"friction": fb.Coulomb(0.5, 1e6), "radius": 0.2}
    scene.add_contact(ball.centre, fb.Line((0, 0), normal=(0, 1)), stiffness=1e6, **friction)
    scene.set_velocity(ball, (1.0, 0.0), spin=-5.0)
    return scene, ball, fb.simulate(scene, dt=0.002, t_end=0.5)


@pytest.mark.parametrize("kind", ["scene", "shapes", "page"])
def test_a_ball_has_its_radius_and_a_spoke_that_turns_with_it(kind):
    scene, ball, solution = rolling()
    last = len(solution.t) - 1
    if kind == "page":
        page = page_of(solution)
        (circle,) = page["stretches"][0]["circles"]
        drawn = places(page, circle).reshape(-1, circle["count"], 2)[-1]
    elif kind == "scene":
        drawn, last = wheel_in(plot.scene(scene).axes[0]), 0
    else:
        drawn = wheel_in(plot.shapes(solution, rows=[last]).axes[0])
    centre, *rim = drawn
    assert centre == approx(solution.position(ball.centre)[last], abs=1e-4)
    assert np.hypot(*(rim - centre).T) == approx(0.2, abs=1e-4)
    psi = solution.rotation(ball.centre)[last]
    assert (rim[0] - centre) / 0.2 == approx([-np.sin(psi), np.cos(psi)], abs=1e-3)
    assert last == 0 or psi == approx(-2.5, abs=0.05)


def wheel_in(ax):
    """Points of the largest disc: from the centre to the end of its spoke, and round the rim."""
    areas = [path.vertices for item in ax.collections for path in item.get_paths()]
    rim = max(areas, key=len)
    centre = (rim.min(axis=0) + rim.max(axis=0)) / 2
    spokes = [line.get_xydata() for line in ax.lines if line.get_zorder() == 2.3]
    assert any(spoke[:2] == approx(np.array([centre, rim[0]])) for spoke in spokes)
    return [centre, *rim]


def test_balls_of_members_and_at_ends_of_beams_have_their_radius_in_the_window():
    scene, bar = pinned_bar((1, 0), FLYING, elements=2)
    rail = scene.add_beam([(-1, -0.6), (3, -0.6)], FLYING, elements=2)
    scene.clamp(rail.start)
    scene.add_contact(bar.end, rail, stiffness=1e3, radius=(0.5, 0.1))
    ax = plot.scene(scene).axes[0]
    centre, *rim = wheel_in(ax)
    assert centre == approx([1, 0]) and np.hypot(*(rim - centre).T) == approx(0.5)
    assert ax.get_ylim()[1] > 0.5
