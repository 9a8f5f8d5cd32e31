"""Each demo, run once in the process that tests it, with its pictures."""

import functools
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from unittest import mock

from matplotlib.figure import Figure
from scenes import demo

import fx_beam as fb
from shared import script

PICTURES = {
    "pinned_beam": ("scene.png", "shapes.png", "invariants.png", "tip.png", "motion.gif"),
    "pendulum": (
        "scene.png",
        "displacement.png",
        "acceleration.png",
        "energy_and_force.png",
        "steps.png",
        "motion.gif",
    ),
    "three_bar_swing": (
        "scene.png",
        "shapes.png",
        "displacement.png",
        "force_and_energy.png",
        "motion.gif",
    ),
    "multibody": (
        "scene.png",
        "shapes.png",
        "displacement.png",
        "energy_and_force.png",
        "motion.gif",
    ),
    "damping_scan": ("lost.png",),
    "slider_crank": ("scene.png", "shapes.png", "slider.png", "rod_motor_energy.png", "motion.gif"),
    "moving_mass": ("scene.png", "deflection_and_force.png", "motion.gif"),
    "monte_carlo": ("histogram.png",),
    "design_map": ("map.png",),
    "identification": ("identified.png",),
    "fast_arm": ("profiles.png", "shapes.png"),
    "whip_taper": ("taper.png",),
    "ring": ("scene.png", "modes.png", "shapes.png", "energy.png", "motion.gif"),
    "deployable_boom": ("scene.png", "shapes.png", "angles_and_energy.png", "motion.gif"),
    "roll_up": ("scene.png", "shapes.png", "convergence_and_energy.png", "motion.gif"),
    "bars": ("force_and_velocities.png",),
    "gripper": ("scene.png", "shapes.png", "rise_and_force.png", "motion.gif"),
    "driven_cycle": ("scene.png", "cycle.png"),
    "parametric_resonance": ("scene.png", "chart.png", "growth.png"),
    "clamped_beam": ("scene.png", "backbone.png"),
    "capstan": ("scene.png", "pull_and_tension.png"),
    "column_between_walls": ("scene.png", "shapes_and_wall.png"),
    "bow": ("scene.png", "shapes.png", "draw_and_energy.png", "motion.gif"),
    "pull_in": ("scene.png", "pull_in.png", "motion.gif"),
    "lee_frame": (
        "scene.png",
        "load_and_displacement.png",
        "shapes.png",
        "moments.png",
        "motion.gif",
    ),
    "shallow_arch": ("scene.png", "diagram.png", "mode.png"),
    "snapping_chain": ("scene.png", "force_and_displacement.png", "heights.png", "motion.gif"),
    "parallelogram": ("scene.png", "path_and_force.png", "motion.gif"),
    "relaxation": ("tests.png",),
    "plasticity": ("scene.png", "loops.png", "ring.png", "motion.gif"),
    "andrews": ("scene.png", "shapes.png", "angles.png", "motion.gif"),
    "whip_stop": ("scene.png", "shapes.png", "force_and_energy.png", "motion.gif"),
    "belt_drive": ("scene.png", "tensions_and_slip.png", "motion.gif"),
    "falling_ring": ("scene.png", "shapes.png", "height_and_energy.png", "motion.gif"),
    "lattice_impact": ("energy.png", "front.png"),
    "own_physics": ("scene.png", "energy.png", "motion.gif"),
    "pd_arm": ("scene.png", "control.png", "motion.gif"),
    "cart_pole": ("scene.png", "control.png", "motion.gif"),
}
# Fewer runs than in the gallery, in a thread: a process could not import what a test has loaded.
SMALL = {
    "monte_carlo": {"samples": 50, "executor": ThreadPoolExecutor(1)},
    "lattice_impact": {"cells": 30},
    "design_map": {"points": (4, 3), "executor": ThreadPoolExecutor(1)},
    "fast_arm": {"within": 0.1},
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

    def animate(solution, steps, path, fps=20, **options):
        few = steps[:: max(1, len(steps) // 10)]
        FILMS[name] = len(steps), len(few), fps
        whole(solution, few, path, fps, **options)

    whole = fb.plot.animate
    films = mock.patch.object(fb.plot, "animate", animate)
    with films, mock.patch.object(Figure, "savefig", _coarse):
        return script.main(demo(name), Path(RESULTS.name) / name, **SMALL.get(name, {}))
