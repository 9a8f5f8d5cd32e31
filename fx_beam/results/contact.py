"""Gaps and forces at an obstacle over time."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.scene.beam import Beam
from fx_beam.scene.obstacles import Obstacle, moved


@dataclass(frozen=True, repr=False)
class Contact:
    """Gaps and forces at an obstacle over time; created by `Solution.contact`.

    Parameters
    ----------
    solution : Solution
        The solution.
    obstacle : Obstacle
        One of its obstacles.

    Examples
    --------
    A load presses the tip of a cantilever against a stop, 1 mm below it.

    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> beam = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e3), elements=8)
    >>> scene.clamp(beam.start)
    >>> load = scene.add_force(beam.end, (0.0, -10.0))
    >>> stop = scene.add_obstacle(beam.end, fb.Line((0, -1e-3), normal=(0, 1)), stiffness=1e9)
    >>> contact = fb.static(scene).contact(stop)
    >>> float(contact.force[-1, 0, 1].round(1)), bool(contact.gap.min() > -1e-8)
    (7.0, True)
    """

    solution: Any
    obstacle: Obstacle

    def __repr__(self):
        return f"<{self.obstacle} over {len(self.solution.t)} rows>"

    @property
    def nodes(self) -> np.ndarray:
        """Numbers (m,) of the nodes, along the beam; rows of `Solution.X`."""
        return self._nodes_of(self.obstacle)

    @property
    def points(self) -> np.ndarray:
        """Positions (n, m, 2) of the points that touch [m]: nodes, or points along elements."""
        nodes = self.nodes
        places = self.solution.X[nodes] + self.solution.recorded("q")[:, nodes, :2]
        return self.obstacle.points.of(places)

    @property
    def gap(self) -> np.ndarray:
        """Distance (n, m) of the points from the obstacle [m]; negative behind it."""
        shape, radius, points = self.obstacle.shape, self.obstacle.radius, self.points
        if shape.carrier is None:
            return shape.gap(points) - radius
        rows = self.solution.recorded("q")[:, shape.carrier.number]
        gaps = [moved(shape, q).gap(row) for q, row in zip(rows, points, strict=True)]
        return np.array(gaps) - radius

    @property
    def force(self) -> np.ndarray:
        """Forces (n, m, 2) on the points at `Solution.t_level` [N]."""
        first = 0
        for other in self.solution.obstacles:
            if other is self.obstacle:
                break
            first += len(other.points.lengths)
        count = len(self.obstacle.points.lengths)
        return self.solution.recorded("contact_forces")[:, first : first + count]

    def _nodes_of(self, obstacle: Obstacle) -> np.ndarray:
        target = obstacle.target
        if isinstance(target, Beam):
            return self.solution.nodes_of_beam[target.name]
        return np.array([target.number])
