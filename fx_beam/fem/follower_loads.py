"""Values over time of the forces that turn with the section of their node."""

from __future__ import annotations

import numpy as np

from fx_beam.laws.interval import Interval, just_inside
from fx_beam.scene.scene import Scene
from fx_beam.validation import Constant, series


class Followers:
    """The follower forces of a scene in the frame of the section, at the level of a step."""

    def __init__(self, scene: Scene, level: float):
        self._loads = [load for load in scene.loads if load.follower]
        self._level = level

    def __len__(self):
        return len(self._loads)

    @property
    def constant(self) -> bool:
        """Whether all forces are constant in time."""
        return all(isinstance(load.value, Constant) for load in self._loads)

    def at(self, interval: Interval) -> np.ndarray:
        """Forces (n, 2) [N] in a step."""
        return self.series(np.array([interval.start]), np.array([interval.end]))[0]

    def series(self, t0: np.ndarray, t1: np.ndarray) -> np.ndarray:
        """Forces (steps, n, 2) [N] in each step."""
        start, end = (
            np.stack([series(load.value, times, str(load)) for load in self._loads], axis=1)
            for times in just_inside(t0, t1)
        )
        return (1 - self._level) * start + self._level * end
