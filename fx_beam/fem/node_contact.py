"""Contact of the nodes of a scene with lines and circles: force, tangent, energy and loss."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.mechanics.impact import friction_slope, push
from fx_beam.mechanics.rates import UpdateRule
from fx_beam.scene.beam import Beam
from fx_beam.scene.obstacles import Circle, Obstacle
from fx_beam.scene.scene import Scene

from .mesh import Mesh

# Lengths that belong to the nodes of an element, by its degree, relative to its own: the weights of
# the rule that integrates the nodes' polynomials.
_SHARES = {
    1: np.array([1, 1]) / 2,
    2: np.array([1, 4, 1]) / 6,
    3: np.array([1, 3, 3, 1]) / 8,
}


class _Found(NamedTuple):
    """Contact at an increment, for each of n nodes."""

    #: Elastic force, its slope by the gap at the end, and what the loss multiplies it by.
    elastic: np.ndarray
    slope: np.ndarray
    factor: np.ndarray
    #: Direction (n, 2) of the force, weighted distance from the centre, gradient (n, 2) of the gap.
    along: np.ndarray
    distance: np.ndarray
    normal: np.ndarray
    #: Increment of the depth in the step, and rate of the depth at the scheme's level.
    way: np.ndarray
    rate: np.ndarray


class NodeContact:
    """The contact of a scene's nodes in a step.

    A circle pushes from r0 to r1 along (r0 + r1) / (|r0| + |r1|): its product with Dr is the change
    of the gap, so that the work is exact, and the force has no moment about the centre.
    """

    def __init__(
        self, scene: Scene, mesh: Mesh, stiffness: scipy.sparse.csr_matrix, rates: UpdateRule
    ):
        self._level = rates.level
        numbers, obstacles = [], scene.obstacles
        factors: list[np.ndarray] = []
        for obstacle in obstacles:
            numbers.append(mesh.nodes_of(scene, obstacle.target))
            factors.append(obstacle.stiffness * _lengths(obstacle))
        nodes = np.concatenate(numbers)

        def each(values) -> np.ndarray:
            return np.repeat(np.array(values, dtype=float), list(map(len, numbers)), axis=0)

        #: Degrees of freedom (n, 2) and reference positions (n, 2) of the nodes.
        self.dofs, self.X = mesh.dofs[nodes, :2], mesh.X[nodes]
        #: Stiffness, dissipative share of the force (zero at rest) and its speed, each (n,).
        self.stiffness = np.concatenate(factors)
        self.share = each([0.0 if rates.at_rest else o.loss for o in obstacles])
        self.speed = each([o.speed or 1.0 for o in obstacles])
        #: Point of the line, or centre; normal of the line, zero for a circle; radius; 1 outside
        #: and -1 inside of a circle, 0 for a line.
        kinds = [
            (*s.centre, 0.0, 0.0, s.radius, -1.0 if s.inside else 1.0)
            if isinstance(s, Circle)
            else (*s.point, *s.normal, 0.0, 0.0)
            for s in (obstacle.shape for obstacle in obstacles)
        ]
        self.point, self.normal, sizes = np.moveaxis(each(kinds).reshape(-1, 3, 2), 1, 0)
        self.radius, self.side = sizes.T
        entry = stiffness.copy()
        entry.data = np.arange(len(entry.data)) + 1.0
        #: Entries (n, 4) of the stiffness that they change: xx, xy, yx and yy.
        self.places = np.array(
            [[int(entry[i, j]) - 1 for i in (x, y) for j in (x, y)] for x, y in self.dofs]
        )

    def set_step(self, dt: float, q: np.ndarray, v: np.ndarray) -> None:
        """Set the length of a step [s], and the configuration and rates at its start."""
        self._dt, self._r0 = dt, self._arms(q)
        self._last: list[tuple[float, float, float] | None] = [None] * len(self.share)
        self._rate0 = 0.0 * self.share
        if self._level != 0.5:
            self._rate0 = -np.sum(self._gradient(self._r0) * v[self.dofs], axis=1)

    def add_force(self, D: np.ndarray, out: np.ndarray) -> None:
        """Subtract the forces on the nodes (size,) for the increment D."""
        np.subtract.at(out, self.dofs, self.forces(D))

    def add_tangent(self, D: np.ndarray, values: np.ndarray) -> None:
        """Subtract their derivative by D from the entries of the stiffness."""
        found, level = self._found(D), self._level
        grows = found.slope * found.factor
        for i in np.flatnonzero(self.share):
            last = friction_slope(found.rate[i] / self.speed[i], self._last[i])
            steep = self.share[i] / self.speed[i] * last[2] * 2 * level / self._dt
            grows[i] -= found.elastic[i] * steep
            self._last[i] = last
        by_end = found.along[:, :, None] * found.normal[:, None]
        bend = (self.side * level * found.elastic * found.factor / found.distance)[:, None, None]
        entries = grows[:, None, None] * by_end + bend * (np.eye(2) - by_end)
        np.subtract.at(values, self.places, entries.reshape(-1, 4))

    def loss(self, D: np.ndarray) -> float:
        """Energy that is lost in the step, at the mean rate [J]."""
        if not self.share.any():
            return 0.0
        found = self._found(D)
        sense = np.tanh(found.way / self._dt / self.speed)
        return float(np.sum(self.share * found.elastic * sense * found.way))

    def forces(self, D: np.ndarray) -> np.ndarray:
        """Forces (n, 2) on the nodes [N]."""
        found = self._found(D)
        return (found.elastic * found.factor)[:, None] * found.along

    def table(self, place: np.ndarray) -> list[dict]:
        """Rows as ``Contact`` of c/problem.h; `place` are storage indices of the stiffness."""
        columns = {
            "dof": self.dofs,
            "place": place[self.places],
            "X": self.X,
            "point": self.point,
            "normal": self.normal,
            "radius": self.radius,
            "side": self.side,
            "k": self.stiffness,
            "loss": self.share,
            "speed": self.speed,
        }
        rows = zip(*(values.tolist() for values in columns.values()), strict=True)
        return [dict(zip(columns, row, strict=True)) for row in rows]

    def gaps(self, q: np.ndarray) -> np.ndarray:
        """Distances (n,) of the nodes in a configuration (size,) [m]; negative behind obstacles."""
        return self._gap(self._arms(q))

    def energy(self, q: np.ndarray) -> float:
        """Stored energy [J] of a configuration (size,)."""
        return float(self.stiffness @ np.minimum(self.gaps(q), 0.0) ** 2 / 2)

    def _found(self, D: np.ndarray) -> _Found:
        r0, level = self._r0, self._level
        r1 = r0 + D[self.dofs]
        g0, g1 = self._gap(r0), self._gap(r1)
        elastic, slope = push(self.stiffness, g0, g1, level)
        way = g0 - g1
        factor, rate = np.ones_like(way), self._rate0
        if self.share.any():
            rate = self._rate0 + 2 * level * (way / self._dt - self._rate0)
            factor = 1 + self.share * np.tanh(rate / self.speed)
        distance = (1 - level) * np.hypot(*r0.T) + level * np.hypot(*r1.T)
        distance = np.where(distance > 0, distance, 1.0)
        mean = (1 - level) * r0 + level * r1
        along = self.normal + (self.side / distance)[:, None] * mean
        return _Found(elastic, slope, factor, along, distance, self._gradient(r1), way, rate)

    def _arms(self, q: np.ndarray) -> np.ndarray:
        """Positions (n, 2) relative to the point of the line, or to the centre."""
        return self.X + q[self.dofs] - self.point

    def _gap(self, r: np.ndarray) -> np.ndarray:
        return np.sum(self.normal * r, axis=1) + self.side * (np.hypot(*r.T) - self.radius)

    def _gradient(self, r: np.ndarray) -> np.ndarray:
        size = np.hypot(*r.T)
        return self.normal + (self.side / np.where(size > 0, size, 1.0))[:, None] * r


def _lengths(obstacle: Obstacle) -> np.ndarray:
    """Length of beam that belongs to each node; 1 for a single node."""
    beam = obstacle.target
    if not isinstance(beam, Beam):
        return np.ones(1)
    lengths = np.zeros(beam.elements * beam.degree + 1)
    for element, length in enumerate(np.diff(beam.s)):
        first = element * beam.degree
        lengths[first : first + beam.degree + 1] += length * _SHARES[beam.degree]
    return lengths
