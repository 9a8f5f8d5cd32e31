"""Sketches of joints and of what acts on them, for the page on joints.

    .venv/bin/python docs/pictures/joint_sketches.py

writes joints.png and joints_dark.png beside this file. Of two members a is blue and carries the
guide, b is green; orange arrows are what is free.
"""

from pathlib import Path

import numpy as np
from PIL import Image

import fx_beam as fb
from fx_beam.plot.drawing import Drawing, Picture
from fx_beam.plot.look import ACTS, THEMES, Pen
from fx_beam.plot.scene_drawing import Reference
from fx_beam.plot.symbols import draw_held, draw_members, draw_moving

HERE = Path(__file__).resolve().parent
COLUMNS, CELL, CAPTION = (
    4,
    (126.0, 84.0),
    28.0,
)  # size of a sketch, and height of its words [points]
THIN = fb.Section(EA=1e6, GA=1e6, EI=1.0)


def bars(first=((-40, 0), (0, 0)), second=((0, 0), (34, 24)), **joint):
    """A scene with two bars, in points."""
    scene = fb.Scene()
    return scene, *(scene.add_beam(ends, THIN, 1) for ends in (first, second))


def rigid():
    scene, a, b = bars()
    scene.add_joint(fb.Rigid(a.end, b.start))
    return scene


def revolute(**laws):
    scene, a, b = bars()
    scene.add_joint(fb.Revolute(a.end, b.start, **laws))
    return scene


def prismatic(**laws):
    scene, a, b = bars(second=((14, 0), (46, 0)))
    scene.add_joint(fb.Prismatic(a.end, b.start, axis=(1, 0), offset=(14, 0), **laws))
    return scene


def pin_in_slot():
    scene, a, b = bars(((-44, -6), (-22, -6)), ((4, -6), (24, 28)))
    scene.add_joint(fb.PinInSlot(a.end, b.start, axis=(1, 0), offset=(26, 0)))
    return scene


def on_a_beam(kind):
    scene = fb.Scene()
    curve = fb.arc((-44, -4), (0, 8), (44, -4))
    a = scene.add_beam(curve, THIN, elements=8, degree=2)
    b = scene.add_beam([(0, 8), (4, -26)], THIN, 1, degree=2)
    scene.clamp(a.start)
    scene.add_joint(kind(a, b.start))
    return scene


def ground():
    scene = fb.Scene()
    b = scene.add_beam([(0, 0), (38, 22)], THIN, 1)
    scene.add_joint(fb.Revolute(fb.GROUND, b.start))
    return scene


def gear():
    scene = fb.Scene()
    wheels = [scene.add_body((x, 0), mass=1.0, inertia=1.0).centre for x in (-20, 24)]
    shafts = [scene.add_joint(fb.Revolute(fb.GROUND, wheel)) for wheel in wheels]
    scene.add_joint(fb.Gear(*shafts, ratio=-17 / 27))
    return scene


def rack():
    scene = fb.Scene()
    wheel = scene.add_body((0, 10), mass=1.0, inertia=1.0).centre
    block = scene.add_body((0, -10), mass=1.0, inertia=1.0).centre
    turns = scene.add_joint(fb.Revolute(fb.GROUND, wheel))
    slides = scene.add_joint(fb.Prismatic(fb.GROUND, block, axis=(1, 0)))
    scene.add_joint(fb.Rack(turns, slides, radius=20.0))
    return scene


def pulley():
    scene = fb.Scene()
    ends = [
        scene.add_body((x, y), mass=1.0, inertia=1.0).centre for x, y in ((-16, -14), (16, -26))
    ]
    points = [ends[0], fb.Pulley((0, 8), 16.0, side="right"), ends[1]]
    scene.add_rope(points, spring=fb.Spring(1e3))
    return scene


def between(**laws):
    scene, a, b = bars(((-46, 0), (-30, 0)), ((30, 0), (46, 0)))
    scene.add_force_between(a.end, b.start, **laws)
    return scene


UP, SLIDE, ALONG = (-12.0, 72.0), ((-2, 17), (40, 17)), ((-42, 12), (-16, 22))
#: Captions, scenes, and what is free: angles of an arc about the joint, or ends of a line.
SKETCHES = [
    ("fb.Rigid(a, b)", "nothing is free", rigid, None),
    ("fb.Revolute(a, b)", "free: rotation", revolute, UP),
    ("fb.Prismatic(a, b, axis)", "free: slide", prismatic, SLIDE),
    ("fb.PinInSlot(a, b, axis)", "free: slide, rotation", pin_in_slot, ((-18, -23), (26, -23))),
    ("fb.Slider(beam, b)", "free: slide, rotation", lambda: on_a_beam(fb.Slider), ALONG),
    ("fb.Sleeve(beam, b)", "free: slide", lambda: on_a_beam(fb.Sleeve), ALONG),
    ("fb.Revolute(fb.GROUND, b)", "free: rotation", ground, UP),
    ("fb.Gear(j1, j2, ratio)", "two angles, one freedom", gear, None),
    ("fb.Rack(j1, j2, radius)", "angle and slide, one freedom", rack, None),
    ("fb.Pulley(node, radius)", "in a rope", pulley, None),
    ("spring=fb.Spring(k)", "on a distance or slide", lambda: between(spring=fb.Spring(1.0)), None),
    ("damper=fb.Damper(c)", "on a distance or slide", lambda: between(damper=fb.Damper(1.0)), None),
    ("spring=fb.Spring(k)", "on an angle", lambda: revolute(spring=fb.Spring(1.0)), None),
    ("damper=fb.Damper(c)", "on an angle", lambda: revolute(damper=fb.Damper(1.0)), None),
    ("friction=...", "on a slide", lambda: prismatic(friction=fb.SmoothFriction(1.0, 0.1)), SLIDE),
    ("stop=fb.Stop(-a, b, k)", "on a slide", lambda: prismatic(stop=fb.Stop(-6, 34, 1e3)), SLIDE),
]  # fmt: skip


def draw(ax, theme, scene, free):
    """One sketch, about the origin."""
    drawing, pen = Drawing(Reference(scene), [0]), Pen(ax, theme)
    draw_members(pen, drawing, 0, width=7.0)
    draw_moving(pen, drawing, 0)
    draw_held(pen, drawing, drawing.parts(0), 0)
    if isinstance(free, tuple) and np.ndim(free) == 1:
        angles = np.radians(np.linspace(*free, 30))
        pen.arrow(28.0 * np.column_stack([np.cos(angles), np.sin(angles)]), ACTS, both=True)
    elif free is not None:
        pen.arrow(free, ACTS, both=True)
    pen.finish()


def sheet(theme, path):
    """All sketches with their captions."""
    rows = -(-len(SKETCHES) // COLUMNS)
    size = np.array([COLUMNS * CELL[0], rows * (CELL[1] + CAPTION)])
    figure = Picture(tuple(size / 72), facecolor=theme.paper)
    for number, (code, words, build, free) in enumerate(SKETCHES):
        row, column = divmod(number, COLUMNS)
        corner = column * CELL[0], size[1] - (row + 1) * (CELL[1] + CAPTION) + CAPTION
        ax = figure.add_axes((*(corner / size), *(CELL / size)))
        ax.set_axis_off()
        half = np.array(CELL) / 2
        ax.set(xlim=(-half[0], half[0]), ylim=(-half[1], half[1]))
        draw(ax, theme, build(), free)
        look = {"ha": "center", "va": "center", "fontsize": 7.6}
        x, y = (corner + np.array([half[0], 0.0])) / size
        figure.text(x, y - 6 / size[1], code, family="monospace", color=theme.ink, **look)
        colour = theme.text(ACTS) if words.startswith("free") else theme.soft
        figure.text(x, y - 18 / size[1], words, color=colour, **look)
    figure.savefig(path, dpi=200)
    with Image.open(path) as picture:
        few = picture.convert("RGB").quantize(112, dither=Image.Dither.NONE)
    few.save(path, optimize=True)


if __name__ == "__main__":
    sheet(THEMES["light"], HERE / "joints.png")
    sheet(THEMES["dark"], HERE / "joints_dark.png")
