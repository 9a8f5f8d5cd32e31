"""Drawings of scenes before they run: nothing is left out, covered or cut off."""

import numpy as np
import pytest
from scenes import FLYING

import fx_beam as fb

plot = pytest.importorskip("fx_beam.plot")
Reference = pytest.importorskip("fx_beam.plot.scene_drawing").Reference
pytestmark = pytest.mark.plot


def crane():
    """A scene with one of each: supports, joints, springs, loads, motors and motions."""
    scene = fb.Scene(gravity=(0.0, -9.81))
    girder = scene.add_beam([(0, 0), (4, 0)], FLYING, 8, name="girder")
    strut = scene.add_beam([(1, 0), (1, 1.5)], FLYING, 4, name="strut")
    boom = scene.add_beam([(4, 0), (6, 1)], FLYING, 4, name="boom")
    finger = scene.add_beam([(6, 1), (6.1, 1)], FLYING, name="finger")
    roof = scene.add_beam([(4.5, 2), (7, 2)], FLYING, 4, name="roof")
    spring, damper = fb.Spring(1.0), fb.Damper(1.0)
    scene.pin(girder.start)
    scene.fix(girder.end, "y")
    scene.fix(roof.start, "x", "rotation")
    scene.clamp(roof.end)
    scene.prescribe(roof.start, y=lambda t: t)
    parts = {"spring": spring, "damper": damper, "friction": fb.Friction(1.0, 0.01)}
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
    """What is written in the drawing."""
    return {text.get_text() for text in figure.axes[0].texts} - {""}


def test_all_that_a_scene_has_is_written():
    scene, girder = crane()
    figure = plot.scene(scene, dimensions=True, marks={"A": girder.node(0.5)})
    assert {"girder", "strut", "boom", "finger", "roof", "A"} <= words(figure)
    assert {"F = 5 N, follower", "F(t)", "M = -30 N m", "q(s)", "q = 3 N/m"} <= words(figure)
    assert {"m = 2.5 kg, J = 0.1 kg m$^2$", "g = 9.81 m/s$^2$", "v(0)"} <= words(figure)
    assert {"drag", "y(t)", r"motor $\psi$(t)", "1", "3"} <= words(figure)


def test_units_that_are_not_the_scenes_are_not_written():
    assert {"F = 5, follower", "M = -30"} <= words(plot.scene(crane()[0], scene_unit="in"))


def test_labels_lie_in_the_frame_and_apart_from_each_other():
    figure = plot.scene(crane()[0], dimensions=True)
    ax, renderer = figure.axes[0], figure.canvas.get_renderer()
    boxes = [text.get_window_extent(renderer) for text in ax.texts if text.get_text()]
    frame = ax.bbox.get_points()
    for i, box in enumerate(boxes):
        assert (box.min > frame[0]).all() and (box.max < frame[1]).all()
        assert not any(box.overlaps(other) for other in boxes[:i])


def test_nothing_that_is_drawn_is_cut_off():
    ax = plot.scene(crane()[0], dimensions=True).axes[0]
    points = np.concatenate([line.get_xydata() for line in ax.lines])
    for (low, high), values in zip((ax.get_xlim(), ax.get_ylim()), points.T, strict=True):
        assert low < np.nanmin(values) and np.nanmax(values) < high


@pytest.mark.parametrize("degree", [1, 2, 3])
def test_the_reference_configuration_is_that_of_the_solution(degree):
    scene = fb.Scene()
    arch = scene.add_beam(fb.arc((1, 0), (0, 1), (-1, 0)), FLYING, elements=3, degree=degree)
    leg = scene.add_beam([arch.end, (-1, -1), (0, -2)], FLYING, elements=4, degree=degree)
    solution, reference = fb.simulate(scene, dt=0.1, t_end=0.1), Reference(scene)
    for beam in (arch, leg):
        places = reference.X[reference.nodes_of_beam[beam.name]]
        assert places == pytest.approx(solution.shape(beam)[0], abs=1e-14)


def test_a_drawing_is_written_and_what_cannot_be_drawn_is_refused(tmp_path):
    scene, _ = crane()
    plot.scene(scene, tmp_path / "scene.svg")
    assert (tmp_path / "scene.svg").stat().st_size > 10e3
    with pytest.raises(fb.SceneError, match="the scene has no beams; add one"):
        plot.scene(fb.Scene())
    with pytest.raises(fb.SceneError, match="needs an fx_beam.Scene, not 'scene'"):
        plot.scene("scene")
    with pytest.raises(ValueError, match="name must end with .*png"):
        plot.scene(scene, tmp_path / "scene.doc")
    with pytest.raises(fb.SceneError, match="mark 'A': Node.* is not a node of the scene"):
        plot.scene(scene, marks={"A": crane()[1].end})


def test_a_scene_of_many_members_is_drawn_without_names_and_says_once_what_is_equal():
    scene, section = fb.Scene(), fb.Section(EA=1.0, GA=1.0, EI=1.0)
    for k in range(600):
        beam = scene.add_beam([(0.0, 0.1 * k), (1.0, 0.1 * k)], section)
        if k % 20 == 0:
            scene.add_force(beam.end, (3.0, 0.0))
    texts = [text.get_text() for text in fb.plot.scene(scene).axes[0].texts]
    assert texts.count("F = 3 N") == 1
    assert not any("beam" in text for text in texts)
