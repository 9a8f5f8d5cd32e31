"""Branches of a path of equilibria, which start at its bifurcations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.errors import SceneError, StepError
from fx_beam.results.solution import Solution
from fx_beam.validation import is_number, is_whole, require

# Two points with load factors and displacements so near to each other are the same.
_SAME = 1e-5


@dataclass(frozen=True)
class Branch:
    """Where a branch starts: ``static(scene, start=point.branch(+1), continuation="arc-length")``.

    Parameters
    ----------
    point : CriticalPoint
        A bifurcation.
    direction : float
        1 along the mode, whose sign follows the rule of `Modes`, -1 against it.
    mode : int
        Number of the mode among those of the point.

    Raises
    ------
    SceneError
        If the point is no bifurcation, or has no such mode.

    Examples
    --------
    >>> import fx_beam as fb
    >>> scene = fb.Scene()
    >>> column = scene.add_beam([(0, 0), (0, 1)], fb.Section(EA=1e4, GA=1e4, EI=1.0), elements=8)
    >>> scene.pin(column.start)
    >>> scene.fix(column.end, "x")
    >>> load = scene.add_force(column.end, (0, -12.0))
    >>> point, = fb.static(scene, steps=4).critical_points
    >>> bent = fb.static(scene, start=point.branch(+1), continuation="arc-length")
    >>> bool(abs(bent.displacement(column.node(0.5))[-1, 0]) > 0.2), bool(bent.stable.all())
    (True, True)
    """

    point: Any
    direction: float = 1.0
    mode: int = 0

    def __post_init__(self):
        fits = is_number(self.direction) and self.direction != 0
        require(fits, "branch: direction", self.direction, "1 or -1")
        if self.point.kind != "bifurcation":
            raise SceneError(
                f"branch: no path branches off at a {self.point.kind}. "
                "Its path goes on by continuation='arc-length'"
            )
        count = len(self.point.modes)
        fits = is_whole(self.mode, 0, count - 1)
        require(fits, "branch: mode", self.mode, f"a number of the {count} modes, from 0")

    @property
    def shape(self) -> np.ndarray:
        """Displacements and rotations (n_node, 3) of the nodes along which it starts."""
        return np.sign(self.direction) * self.point.modes.shapes[self.mode].real


def grown(path: Solution, levels: int, follow: Callable[[Branch], Solution]) -> list[Solution]:
    """Branches of a path, which `follow` computes, each with its own branches, up to a level."""
    known: list[Any] = []
    path.branches = _of_path(path, levels, follow, known)
    return path.branches


def _of_path(
    path: Solution, levels: int, follow: Callable[[Branch], Solution], known: list[Any]
) -> list[Solution]:
    new = [
        point
        for point in path.critical_points
        if point.kind == "bifurcation" and not any(_same(point, other) for other in known)
    ]
    known += new
    branches = []
    for point in new:
        for mode in range(len(point.modes)):
            for direction in (1, -1):
                start = Branch(point, direction, mode)
                try:
                    branch = follow(start)
                except StepError as error:
                    if error.solution is None:
                        continue
                    branch = error.solution
                branch.origin = start
                branches.append(branch)
    if levels > 1:
        for branch in branches:
            branch.branches = _of_path(branch, levels - 1, follow, known)
    return branches


def _same(one: Any, other: Any) -> bool:
    """Whether two critical points are one."""
    size = float(np.ptp(one.solution.X, axis=0).max()) or 1.0
    gap = (one.solution.q[-1] - other.solution.q[-1]) / np.array([size, size, 1.0])
    return abs(one.load_factor - other.load_factor) <= _SAME and bool(abs(gap).max() <= _SAME)
