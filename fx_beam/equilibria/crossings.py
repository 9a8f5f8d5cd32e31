"""Where modes become unstable, or stable again, in the steps of a path.

A step in which their number changes at no point that is found has left its path.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import suppress

import numpy as np

from fx_beam.results.state import State
from fx_beam.step.step_failures import StepFailed

from .arc_length import ArcLength
from .branches import is_equilibrium
from .load_steps import LoadStepper
from .path_piece import LIMIT_POINT, SAME, SMOOTH, PathInterval, Root, brackets_of, root_of

#: A point in a step, and how many modes become unstable there.
Crossing = tuple[Root, int]
# What equilibria, factors and eigenvalues raise.
FAILURES = StepFailed, RuntimeError, ValueError
# Work of the loads on a mode that is none, relative to its parts, and to the forces in members;
# rounding errors, relative to stiffness times the size of the scene. The part of the loads by which
# it is found.
_OF_PARTS, _OF_FORCES, _ROUNDING, _PART_OF_LOADS = 1e-7, 1e-9, 2e-16, 0.5
# Eigenvalue at the start of a step that vanishes, relative to that at its end.
_VANISHES = 1e-4
# Modes that one point has at most, as a rule.
_AT_ONE_POINT = 2


class Crossings:
    """Finds crossings in the steps of a path."""

    def __init__(self, stepper: LoadStepper):
        self.motions, self.arc = stepper.motions, ArcLength(stepper)
        #: Crossings in accepted steps, by the state at their end.
        self._seen: dict[int, tuple[State, State, list[Crossing]]] = {}

    def check_stability(self, old: State, new: State, limits: int) -> None:
        """StepFailed if the number of unstable modes changes in a step where no point is found.

        It may change by one at each of so many limit points.
        """
        if None in (old.unstable_modes, new.unstable_modes):
            if old.negative_pivots == new.negative_pivots is not None:
                return  # at flutter the path itself goes on as before
        count, next_count = (self.motions.count(state, old) for state in (old, new))
        if count is None or next_count is None or abs(next_count - count) in (0, limits):
            return
        stepper = self.arc.stepper
        if stepper.may_be_cut and not count and self._is_too_long(new, next_count):
            reason = f"{next_count} of its modes become unstable in it"
            raise StepFailed("off the path", reason, new.q - old.q)
        crossings, missing = self._in_step(old, new, count, next_count, whole=False)
        if missing:
            count, next_count = self.motions.count_again(old, new)
            if count == next_count:
                return
            reason = (
                f"of its modes {count} are unstable at its start and {next_count} at its end, "
                f"with no critical point between ({missing}): it has reached another path"
            )
            raise StepFailed("off the path", reason, new.q - old.q)
        self._seen[id(new)] = old, new, crossings

    def check_turn(self, old: State, new: State) -> None:
        """StepFailed if a step starts at a bifurcation, where round-off leads it off the path."""
        motions, is_turn = self.motions, False
        with suppress(*FAILURES):
            tangents = [motions.stiffness(state) for state in (old, new)]
            if all(map(motions.symmetric, tangents)):
                first, last = (abs(motions.lowest(K, 1)[0][0]) for K in tangents)
                is_turn = first < _VANISHES * last
        if is_turn:
            reason = "it starts at a bifurcation, where round-off leads it on"
            raise StepFailed("off the path", reason, new.q - old.q)

    def _is_too_long(self, end: State, count: int) -> bool:
        """Whether a step from a stable state passes more modes than one point, or two that bend."""
        if count == _AT_ONE_POINT:
            with suppress(*FAILURES):
                K = self.motions.stiffness(end)
                symmetric = self.motions.symmetric(K)
                return symmetric and self.bends(end, self.motions.lowest(K, count)[1])
        return count > _AT_ONE_POINT

    def between(
        self, old: State, new: State, count: int, next_count: int
    ) -> tuple[list[Crossing], str]:
        """Crossings in a step with numbers of unstable modes, and why others were not found."""
        cached = self._seen.get(id(new))
        if cached is not None and cached[0] is old:
            return cached[2], ""
        return self._in_step(old, new, count, next_count)

    def _in_step(
        self, old: State, new: State, *counts: int, whole: bool = True
    ) -> tuple[list[Crossing], str]:
        """Points in a step, and why another one was not found; empty if all were.

        If the `whole` is not wanted, those before the first that is not found.
        """
        try:
            piece = PathInterval(self.arc, self.motions, old, new)
            brackets = brackets_of(piece, *counts)
        except FAILURES as failure:
            return [], str(failure)
        crossings = list[Crossing]()
        missing, last = "" if brackets else "all modes stay as they are", -np.inf
        for bracket in brackets:
            if missing and not whole:
                break
            multiplicity = bracket.many - bracket.few
            try:
                root = root_of(piece, self.eigenvalue(piece, bracket.few), bracket)
                stays = self._is_on_path(root, multiplicity, max(counts))
            except FAILURES as failure:
                missing = str(failure)
                continue
            if not stays:
                missing = "the step reaches another path"
            elif root.place - last > SAME * piece.length:  # else it is the same one, divided
                crossings.append((root, multiplicity))
                last = root.place
        return crossings, missing

    def _is_on_path(self, root: Root, multiplicity: int, unstable: int) -> bool:
        """Whether a smooth point is an equilibrium, at which no rising load bends its modes."""
        if root.kind not in SMOOTH:
            return True
        if not is_equilibrium(self.arc, root.state):
            return False
        if root.kind == LIMIT_POINT or not self.motions.symmetric(root.stiffness):
            return True
        return not self.bends(
            root.state, self.motions.vanishing(root.stiffness, multiplicity, unstable)
        )

    def bends(self, state: State, vectors: np.ndarray) -> bool:
        """Whether the loads up to a state do work on its modes (unknowns, n)."""
        stepper, unit = self.arc.stepper, self.motions.unit
        K = self.motions.stiffness(state)
        stepper.path.set_start(state)
        apart = _PART_OF_LOADS * abs(state.t)
        loads = abs(state.t) * stepper.path.disturbance(apart)
        loads = loads[self.motions.model.reduction.independent]
        sizes = np.linalg.norm(vectors.T / unit, axis=1)
        least = _OF_PARTS * abs(loads) @ abs(vectors)
        least += _OF_FORCES * stepper.energies.largest_force(state) * sizes
        least += _ROUNDING / _PART_OF_LOADS * (abs(K) @ unit) @ abs(vectors)
        return bool((abs(loads @ vectors) > least).any())

    def eigenvalue(self, piece: PathInterval, k: int) -> Callable[[float], float]:
        """Eigenvalue k, numbered from the lowest one, as a function of the distance.

        Where forces follow the motion, the square of the lowest frequency.
        """
        motions = self.motions

        def eigenvalue(distance: float) -> float:
            K = piece.stiffness(distance)
            if motions.symmetric(K):
                return float(motions.lowest(K, k + 1)[0][k])
            return float(motions.squares(piece.point_at(distance))[0].real)

        return eigenvalue
