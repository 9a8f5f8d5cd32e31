"""Each demo, run once in the process that tests it, with its pictures."""

import functools
import re
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
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


@functools.cache
def numbers(name):
    """What a demo returns, which draws its pictures as well, once; films with few frames."""

    def animate(solution, path, rows, fps=20, **options):
        few = rows[:: max(1, len(rows) // 10)]
        FILMS[name] = len(rows), len(few), fps
        whole(solution, path, few, fps=fps, **options)

    whole = fb.plot.animate
    films = mock.patch.object(fb.plot, "animate", animate)
    with films, mock.patch.object(Figure, "savefig", _coarse):
        return script.main(demo(name), Path(RESULTS.name) / name, **SMALL.get(name, {}))
