"""The first picture: the paper's multi-body system in motion, and its energy by two schemes.

    .venv/bin/python docs/pictures/first_picture.py

writes first.gif and first_dark.gif beside this file, and says what the captions say.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

import fx_beam as fb
from fx_beam.plot.drawing import Drawing, Picture
from fx_beam.plot.look import ACTS, MEMBERS, THEMES, Pen, mixed
from fx_beam.plot.symbols import draw_held, draw_members, draw_moving

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE.parents[1] / "demos"))
import multibody  # noqa: E402

DT, T_END, SHOWN = 5e-3, 1.9, 0.02
DASHES = (3, 1.5)


def run(scheme, **options):
    """The motion, as far as the scheme gets."""
    system, _ = multibody.scene(elements=8)
    try:
        return fb.simulate(system, scheme, dt=DT, t_end=T_END, **options)
    except fb.StepError as error:
        return error.solution


def relative(solution):
    """Energy by that at 0.5 s, when the moment ends."""
    total = solution.energy.total
    return total / np.interp(0.5, solution.t, total)


def shades(theme):
    """Colours (n, 3) of the GIF: each that is drawn, on its way to the paper and to the ink."""
    bases = [*MEMBERS, ACTS, theme.ink, theme.soft]
    colours = [theme.paper, theme.ground, theme.plus, *(mixed(c, "#ffffff", 0.42) for c in MEMBERS)]
    colours += [mixed(c, theme.paper, part) for c in bases for part in np.linspace(0, 0.92, 13)]
    colours += [mixed(c, theme.ink, part) for c in bases for part in (0.2, 0.35, 0.55, 0.75)]
    return (255 * np.array([mixed(c, c, 0.0) for c in colours])).round().astype(int)


def draw_motion(ax, theme, drawing, lost, k):
    """Members with earlier rows, the path of a hinge, and Newmark's motion dashed."""
    for age, fade in ((24, 0.86), (16, 0.78), (8, 0.68)):
        if k >= age:
            pen = Pen(ax, theme, fade=fade)
            draw_members(pen, drawing, k - age, ghost=True)
            pen.finish()
    now, t, last = drawing.solution.t[k], lost.solution.t, len(lost.solution.t) - 1
    pen = Pen(ax, theme)
    hinge = next(iter(drawing.solution.beams.values())).end.number
    pen.line(drawing.positions(hinge, slice(max(0, k - 60), k + 1)), theme.soft, 1.2, 1.8)
    gone = min(1.0, max(0.0, now - t[last]) / 0.3)
    if gone < 1:
        for name in lost.solution.beams:
            line = lost.axis(name, min(k, last))
            pen.line(line, mixed(ACTS, theme.paper, gone), 2.2, 2.2, DASHES)
    draw_members(pen, drawing, k)
    draw_moving(pen, drawing, k)
    draw_held(pen, drawing, drawing.parts(k), k)
    pen.finish()


def draw_energy(ax, theme, motions, k):
    """The energy of both schemes up to row k, over time."""
    good, bad = motions
    now, (energy, wrong) = good.t[k], map(relative, motions)
    ax.set(xlim=(0, T_END), ylim=(0, 2.3), yticks=(0, 1, 2))
    ax.spines[["top", "right"]].set_visible(False)
    theme.dress(ax)
    ax.axvspan(0, 0.5, color=theme.plus, alpha=0.35, lw=0)
    ax.plot(bad.t[bad.t <= now], wrong[bad.t <= now], color=ACTS, lw=2.2, ls=(0, DASHES))
    ax.plot(good.t[: k + 1], energy[: k + 1], color=MEMBERS[0], lw=2.8)
    ax.plot([now], [energy[k]], "o", color=MEMBERS[0], ms=6)
    look = {"fontsize": 8.5, "va": "center"}
    ax.text(0.25, 2.05, "moment acts", color=theme.text(ACTS), ha="center", **look)
    ax.set_ylabel("energy, relative", color=theme.ink, fontsize=9)
    ax.text(1.012, 0.0, "t [s]", color=theme.soft, transform=ax.transAxes, **look)
    if now > bad.t[-1]:
        words = "Newmark: energy from nothing, then no step converges"
        ax.text(bad.t[-1] + 0.02, 2.02, words, color=theme.text(ACTS), **look)
    if now > 1.3:
        drift = 10 ** np.ceil(np.log10(abs(energy[good.t >= 0.5] - 1).max()))
        words = f"EnergyMomentum: constant to {drift:.0e}"
        ax.text(1.02, 0.62, words, color=theme.text(MEMBERS[0]), **look)


def frames(theme, good, bad):
    """Pictures of rows at equal intervals."""
    rows = [round(t / DT) for t in np.arange(0, T_END + 1e-9, SHOWN)]
    drawing, lost = Drawing(good, rows), Drawing(bad, [0])
    low, high = drawing.corners + np.array([[-0.15, -0.15], [0.15, 0.45]])
    figure = Picture((8.0, 5.6), facecolor=theme.paper, dpi=100)
    canvas = FigureCanvasAgg(figure)
    top, strip = figure.add_axes((0, 0.3, 1, 0.7)), figure.add_axes((0.085, 0.075, 0.8, 0.185))
    scale = max((high - low) / (8.0, 0.7 * 5.6)) / 2
    (left, bottom), (right, above) = (
        (low + high) / 2 + side * scale * np.array([8.0, 0.7 * 5.6]) for side in (-1, 1)
    )
    for k in rows:
        for ax in (top, strip):
            ax.clear()
        top.set(xlim=(left, right), ylim=(bottom, above))
        top.set_axis_off()
        draw_motion(top, theme, drawing, lost, k)
        draw_energy(strip, theme, (good, bad), k)
        look = {"transform": top.transAxes, "va": "top"}
        words = "Four flexible members, hinges, a slide"
        top.text(0.02, 0.97, words, color=theme.ink, fontsize=12, weight="bold", **look)
        words = "solid: EnergyMomentum, dashed: Newmark; same mesh, same step of 5 ms"
        top.text(0.02, 0.91, words, color=theme.soft, fontsize=9, **look)
        clock = {"family": "monospace", "ha": "right", "fontsize": 11} | look
        top.text(0.98, 0.97, f"t = {good.t[k]:.2f} s", color=theme.ink, **clock)
        canvas.draw()
        yield Image.fromarray(np.asarray(canvas.buffer_rgba())[..., :3].copy())


def main():
    good, bad = run(fb.EnergyMomentum()), run(fb.Newmark(), max_halvings=2)
    for theme, name in (("light", "first.gif"), ("dark", "first_dark.gif")):
        palette = Image.new("P", (1, 1))
        palette.putpalette(np.resize(shades(THEMES[theme]), (256, 3)).ravel().tolist())
        images = [
            frame.quantize(palette=palette, dither=Image.Dither.NONE)
            for frame in frames(THEMES[theme], good, bad)
        ]
        times = [60] * (len(images) - 1) + [2200]
        look = {"save_all": True, "duration": times, "loop": 0, "optimize": True}
        images[0].save(HERE / name, append_images=images[1:], **look)
        print(f"{name}: {(HERE / name).stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
