"""Each demo, run once in the process that tests it; its pictures where a test looks at them."""

import functools
import re
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

from matplotlib.figure import Figure
from scenes import DEMOS, demo

import fx_beam as fb
from shared import script

#: Of each demo: the files that it names, which it draws.
PICTURES = {
    name: sorted(set(re.findall(r"\w+\.(?:png|gif)", path.read_text())))
    for name, path in DEMOS.items()
}
# Fewer runs than in the gallery, in a thread: a process could not import what a test has loaded.
SMALL = {
    "monte_carlo": {"samples": 50, "executor": ThreadPoolExecutor(1)},
    "lattice_impact": {"cells": 30},
    "design_map": {"points": (4, 3), "executor": ThreadPoolExecutor(1)},
    "fast_arm": {"within": 0.1},
    "gears": {"dt": 4e-4},
    "heated_strip": {"t_end": 3.5},
    "parametric_resonance": {"pulses": (0.1, 0.4)},
}
_SAVE = Figure.savefig
RESULTS = tempfile.TemporaryDirectory(prefix="fx_beam_demos_")  # goes with the process


#: Of each film: the frames that it has, how many of them are drawn here, and how many a second.
FILMS = {}


def _coarse(figure, path, **look):
    """A picture with fewer dots, which are written in less time."""
    _SAVE(figure, path, **look | {"dpi": 150})


#: What demos have returned to draw.
_DRAWN = {}


@functools.cache
def numbers(name):
    """Numbers that a demo returns, once."""
    numbers, _DRAWN[name] = demo(name).compute(**SMALL.get(name, {}))
    return numbers


@functools.cache
def drawn(name):
    """The folder of what a demo writes, its pictures too, drawn once; films with few frames."""

    def animate(solution, path, rows=None, fps=20, **options):
        count = len(solution.t)
        rows = range(0, count, max(1, count // 100)) if rows is None else rows
        few = rows[:: max(1, len(rows) // 7)]
        FILMS[name] = len(rows), len(few), fps
        whole(solution, path, few, fps=fps, **options)

    whole, folder = fb.plot.animate, Path(RESULTS.name) / name
    results = numbers(name), _DRAWN.pop(name)
    parts = SimpleNamespace(compute=lambda: results, report=demo(name).report, draw=demo(name).draw)
    films = mock.patch.object(fb.plot, "animate", animate)
    with films, mock.patch.object(Figure, "savefig", _coarse):
        script.main(parts, folder)
    return folder
