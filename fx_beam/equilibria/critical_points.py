"""Stability along a path of equilibria, and its critical points."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.results.solution import Solution
from fx_beam.results.state import State
from fx_beam.results.vibrations import Modes, modes_of

from .branches import Branch, is_equilibrium
from .crossings import FAILURES, Crossings
from .load_steps import LoadStepper
from .path_piece import BIFURCATION, FLUTTER, LIMIT_POINT, SAME, SMOOTH, PathInterval, Root, end_of
from .small_motions import pairs_and_others

_log = logging.getLogger("fx_beam")
# How far ahead of the end of a path that has failed one is sought, in lengths of the last step.
_AHEAD = 2.0
# Slope of the load factor there, relative to its rise before, beyond which it has no limit point.
_STEEP = 0.5
NOT_LOCATED = "not located"


@dataclass(frozen=True)
class CriticalPoint:
    """A point of a path of equilibria at which modes become unstable, or stable again.

    Parameters
    ----------
    kind : {"limit point", "bifurcation", "flutter", "contact", "flow", "kink", "not located"}
        At a limit point the load factor has an extremum: the loads do work on the mode. At a
        bifurcation it rises or falls, and other paths start. Flutter is a vibration that begins to
        grow, under forces that follow the motion, or one that ends; its two modes may go on growing
        without vibrating. At the next three the stiffness jumps from one sign to the other, where a
        contact opens or closes, where members or springs begin to flow or to slip, or at a kink of
        a law of springs; the load factor may have an extremum there, with a corner of the path.
        "not located" stands for all that was not found between two rows.
    load_factor : float
        The load factor; nan if the point was not located.
    row : int
        The last row of the path before the point.
    modes : Modes, optional
        Its modes, the null vectors of the tangent; several if more modes become unstable at once.
        Where the stiffness jumps, those that are unstable on one side. Their signs follow the rule
        of `Modes`. None if the point was not located.
    solution : Solution, optional
        The point itself as a static solution of one row, for example to start a motion from. None
        if the point was not located.

    Examples
    --------
    Euler's column.

    >>> import math, fx_beam as fb
    >>> scene = fb.Scene()
    >>> section = fb.Section(EA=1e8, GA=1e8, EI=1.0)
    >>> column = scene.add_beam([(0, 0), (0, 1)], section, elements=8, degree=3)
    >>> scene.pin(column.start)
    >>> scene.fix(column.end, "x")
    >>> load = scene.add_force(column.end, (0, -12.0))
    >>> point, = fb.static(scene, load_steps=4).critical_points
    >>> point.kind, round(12 * point.load_factor / math.pi**2, 5)
    ('bifurcation', 1.0)
    """

    kind: str
    load_factor: float
    row: int
    modes: Modes | None = None
    solution: Solution | None = None

    def branch(self, direction: float = 1.0, mode: int = 0) -> Branch:
        """Where a branch starts, for ``static(scene, start=..., continuation="arc-length")``.

        Parameters
        ----------
        direction : float
            1 along the mode, whose sign follows the rule of `Modes`, -1 against it.
        mode : int
            Number of the mode among those of the point.

        Returns
        -------
        Branch
            The start.

        Raises
        ------
        SceneError
            If the point is no bifurcation.
        """
        return Branch(self, direction, mode)

    def __repr__(self):
        if self.modes is None:
            return f"<CriticalPoint: {self.kind}, between the rows {self.row} and {self.row + 1}>"
        modes_text = f", {len(self.modes)} modes" if len(self.modes) > 1 else ""
        return f"<CriticalPoint: {self.kind} at load factor {self.load_factor:.9g}{modes_text}>"


def first_critical_point(solution: Solution) -> CriticalPoint:
    """The first critical point of a static solution; SceneError if none was located."""
    if not solution.stats.static:
        raise SceneError("Response: a motion has no critical_load. Take fx_beam.StaticResponse")
    points = solution.critical_points
    if not points:
        raise SceneError(
            "critical_load: the path has no critical point up to load factor "
            f"{solution.t[-1]:.6g}. Give larger loads, and to find limit points "
            'continuation="arc-length"'
        )
    if points[0].kind == NOT_LOCATED:
        raise SceneError(
            f"critical_load: the first critical point, between the rows {points[0].row} and "
            f"{points[0].row + 1} of the path, was not located. Take more load steps"
        )
    return points[0]


class PathStability:
    """Stability of the states of a path; `solved` makes a solution of a single state.

    The first state may be a bifurcation at which the path `branches_off`.
    """

    def __init__(
        self,
        stepper: LoadStepper,
        crossings: Crossings,
        states: list[State],
        solved: Callable[[State], Solution],
        branches_off: bool = False,
    ):
        self._stepper, self._states, self._solved = stepper, states, solved
        # There an eigenvalue is zero: it counts as the state beside it.
        self._first = int(branches_off and len(states) > 1)
        self._last = int(stepper.stats.closed and len(states) > 1)
        self._motions, self._crossings = stepper.motions, crossings

    def unstable_modes(self) -> np.ndarray:
        """Numbers (n,) of modes that grow, by the factors of the steps, or by new ones."""
        states = self._states[self._first : len(self._states) - self._last]
        factors = [state.unstable_modes for state in states]
        steps = zip(states, states[1:], factors[1:], strict=False)
        flowed = self._motions.model.kinks.flowed
        if any(count is None and flowed(old, new) for old, new, count in steps):
            raise ValueError(
                "unstable_modes: where something slips or flows, they are known of symmetric "
                "tangents: not where friction slips or forces follow the motion, nor with closed "
                "loops, nodes that slide on beams, or contact of members"
            )
        counts: list[int] = []
        limits = self._stepper.stats.limit_points
        limit = None
        for count, state in zip(factors, states, strict=True):
            is_limit = bool(counts) and state.t in limits
            if is_limit:
                count = counts[-1]
            elif count is None:
                count = sum(self._motions.growing(state))
            if limit is not None:
                counts[-1] = self._at_limit(limit, counts[-1], count)
            counts.append(count)
            limit = state if is_limit else None
        ends = counts[:1] * self._first, counts[-1:] * self._last
        return np.array(ends[0] + counts + ends[1], dtype=int)

    def _at_limit(self, state: State, last: int, following: int) -> int:
        """Number of unstable modes at a limit point, from those of the `last` row before it.

        The eigenvalue that is zero counts as there; those that change beside it as they are here.
        """
        if abs(following - last) == 1 or self._motions.model.kinks.flows:
            return last
        K = self._motions.stiffness(state)
        if not self._motions.symmetric(K):
            return last
        values = self._motions.lowest(K, max(last, following) + 1)[0]
        rest = int((np.delete(values, abs(values).argmin()) < 0).sum())

        def change(count: int) -> tuple[int, int]:
            gap = abs(count - last)
            return gap + abs(following - (2 * rest + 1 - count)), gap

        return min((rest, rest + 1), key=change)

    def critical_points(self) -> list[CriticalPoint]:
        """The critical points between the states, and at their end; none if modes are unknown.

        A warning names points that were not located.
        """
        try:
            counts = self.unstable_modes()
        except ValueError as error:
            _log.warning("critical_points: none is known. %s", error)
            return []
        points: list[CriticalPoint] = []
        reasons: dict[int, str] = {}
        for row in np.flatnonzero(np.diff(counts)).tolist():
            points_in_step, reason = self._in_step(row, counts[row : row + 2].tolist())
            points += points_in_step
            if reason:
                points.append(CriticalPoint(NOT_LOCATED, np.nan, row))
                reasons[row] = reason
        if reasons:
            rows = ", ".join(f"{row} and {row + 1}" for row in reasons)
            _log.warning(
                "critical_points: points between the rows %s were not located, and are in the list "
                'as "%s": %s. Compute the path with more steps',
                *(rows, NOT_LOCATED, next(iter(reasons.values()))),
            )
        return points + self.at_end(counts)

    def at_end(self, counts: np.ndarray) -> list[CriticalPoint]:
        """The critical point at the end of the path, or ahead of it if it has failed."""
        failure = self._stepper.stats.failure
        failed = failure is not None and failure.kind != "too many steps"
        motions, row, count = self._motions, len(counts) - 2, int(counts[-1])
        if row < 0 or self._last or counts[row] != count or count == len(motions.unit):
            return []
        try:
            piece = PathInterval(self._crossings.arc, motions, *self._states[row:])
            ends = [piece.stiffness(end) for end in (piece.first, piece.length)]
            if piece.kinked or not all(motions.symmetric(K) for K in ends):
                return []
            eigenvalue, far = self._crossings.eigenvalue(piece, count), _AHEAD if failed else SAME
            if (root := end_of(piece, eigenvalue, far)) is None:
                return []
            modes = motions.vanishing(root.stiffness, 1, count + 1)
            if root.kind == BIFURCATION and self._crossings.bends(root.state, modes):
                if root.rise <= _STEEP:
                    root.kind = LIMIT_POINT
                elif not is_equilibrium(self._crossings.arc, root.state):
                    return []  # the path goes on along the mode
            return [self._point(root, row, 1, count + 1)]
        except FAILURES:
            return []

    def _in_step(self, row: int, counts: list[int]) -> tuple[list[CriticalPoint], str]:
        """Critical points in the step after a row, and why others were not located."""
        points: list[CriticalPoint] = []
        old, new = self._states[row : row + 2]
        crossings, reason = self._crossings.between(old, new, *counts)
        for root, multiplicity in crossings:
            try:
                points.append(self._point(root, row, multiplicity, max(counts)))
            except FAILURES as failure:
                reason = str(failure)
        return points, reason

    def _point(self, root: Root, row: int, multiplicity: int, unstable: int) -> CriticalPoint:
        motions, state, K, square = self._motions, root.state, root.stiffness, 0.0
        if root.kind == FLUTTER:
            square = float(pairs_and_others(motions.squares(state))[0][0].real)
            vectors = motions.shapes(state, square, multiplicity)
        elif not motions.symmetric(K):
            vectors = motions.shapes(state, float(motions.squares(state)[0].real), multiplicity)
        elif root.kind in SMOOTH:
            vectors = motions.vanishing(K, multiplicity, unstable)
        else:
            vectors = motions.lowest(K, unstable)[1][:, -multiplicity:]
        kind = "bifurcation" if multiplicity > 1 and root.kind in SMOOTH else root.kind
        motions.stiffness(state)  # the couplings are then those of this state
        omega = np.sign(square) * np.sqrt(abs(square))
        rate, ratio = (-omega, np.nan) if square < 0 else (1j * omega, 0.0)
        values = (np.full(vectors.shape[1], value) for value in (omega, False, ratio, rate))
        modes = modes_of(self._stepper.model, state.q, motions.coupling() @ vectors, *values)
        return CriticalPoint(kind, state.t, row, modes, self._solved(state))
