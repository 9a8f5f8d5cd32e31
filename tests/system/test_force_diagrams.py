"""Diagrams of N, Q and M: their extreme values, their sides and their colours."""

import re

import numpy as np
import pytest
from PIL import Image

import fx_beam as fb

pytestmark = pytest.mark.plot
SPAN, LOAD = 4.0, 1000.0
STEEL = fb.Section.rectangle(height=0.2, width=0.1, E=210e9, nu=0.3, rho=7850.0)


@pytest.fixture(scope="module")
def girder():
    """A girder under a line load: M = q l^2/8 in its middle, Q = q l/2 at its ends."""
    scene = fb.Scene()
    beam = scene.add_beam([(0, 0), (SPAN, 0)], STEEL, elements=16, degree=3, name="girder")
    scene.pin(beam.start)
    scene.fix(beam.end, "y")
    scene.add_line_load(beam, (0, -LOAD))
    return fb.static(scene, steps=1)


def texts(file):
    """Texts of a picture in SVG, which writes them beside their outlines."""
    return re.findall("<!-- (.*?) -->", file.read_text("utf-8"))


def rows_of_colours(solution, folder, name):
    """Mean rows of red and of blue pixels below the axis of the girder; None without any."""
    fb.plot.diagrams(solution, 1, folder / "girder.png", [name], deformed=False)
    pixels = np.asarray(Image.open(folder / "girder.png").convert("RGB")).astype(int)
    red = pixels[..., 0] - pixels[..., 2] > 25
    blue = pixels[..., 2] - pixels[..., 0] > 25
    # The axis is a line three times as thick as the frame of the panel.
    black = (pixels.max(axis=2) < 30).sum(axis=1) > pixels.shape[1] / 3
    thick = np.convolve(black, np.ones(6), mode="same")
    axis = thick.argmax()
    means = [np.nonzero(one)[0].mean() - axis if one.sum() > 500 else None for one in (red, blue)]
    return means


@pytest.mark.parametrize(("name", "exact"), [("M", LOAD * SPAN**2 / 8), ("Q", LOAD * SPAN / 2)])
def test_extreme_values_are_written(girder, name, exact, tmp_path):
    fb.plot.diagrams(girder, 1, tmp_path / "girder.svg", name)
    found = texts(tmp_path / "girder.svg")
    assert any(one.lstrip("-\u2212") == f"{exact:g}" for one in found), found


def test_a_moment_is_drawn_on_the_side_in_tension(girder, tmp_path):
    red, blue = rows_of_colours(girder, tmp_path, "M")
    assert blue is None and red > 0


def test_a_shear_force_changes_its_sign_and_side(girder, tmp_path):
    red, blue = rows_of_colours(girder, tmp_path, "Q")
    assert red < 0 < blue


def test_there_is_a_panel_for_each_quantity(girder, tmp_path):
    fb.plot.diagrams(girder, 1, tmp_path / "girder.svg")
    found = " ".join(texts(tmp_path / "girder.svg"))
    assert all(words in found for words in ("axial force", "shear force", "bending moment"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"row": 9}, "rows of the solution"),
        ({"quantities": ["N", "speed"]}, "must be some of N, Q, M"),
        ({"quantities": []}, "must be some of N, Q, M"),
        ({"deformed": "yes"}, "True or False"),
        ({"path": "girder.txt"}, "must end with"),
    ],
)
def test_what_cannot_be_drawn_is_refused(girder, options, words, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match=words):
        fb.plot.diagrams(girder, **{"row": 1, "path": "girder.png"} | options)
    assert not list(tmp_path.iterdir())
