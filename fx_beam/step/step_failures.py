"""Why a step fails: what is checked of it, and what is said."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from fx_beam.errors import Failure, StepError
from fx_beam.results.records import Stats
from fx_beam.results.state import State
from fx_beam.scene.beam import COMPONENTS
from fx_beam.scene.sliders import corner_advice

from .model import Model
from .newton import LONGEST_TURN, NewtonOptions

_MOVED = "points move further in contact with members than half an element"
_PASSED = (
    "a node passes through the middle of a member. Raise the stiffness of the contact, "
    "or the radius of the members"
)
_SINGULAR = "the tangent is singular or a value is not finite"
OPEN = "a loop of joints cannot be closed"
_UNMET = "the friction of joints and the force that it follows do not meet"
_AMPLIFIED = "damping adds energy to the motion, as a sub-step goes back in time"


class StepFailed(Exception):
    """A failed step: kind and reason as in `Failure`, last increment, sizes of corrections."""

    def __init__(self, kind: str, reason: str, D: np.ndarray, corrections: Sequence[float] = ()):
        super().__init__(reason)
        self.kind, self.reason = kind, reason
        self.D = D
        self.corrections = corrections


class StepFailures:
    """Limits that steps of a model must not pass."""

    def __init__(self, model: Model, options: NewtonOptions, stats: Stats):
        self.model, self.options, self._stats = model, options, stats

    def shortening(self, correction: np.ndarray) -> float:
        """Factor that limits the rotations of a correction (size,)."""
        turn = abs(correction[self.model.mesh.turns]).max()
        return LONGEST_TURN / turn if LONGEST_TURN < turn < np.inf else 1.0

    def check_finite(self, size: float, corrections: list[float]) -> None:
        """Reject a correction whose size is not finite."""
        if not np.isfinite(size):
            raise StepFailed("singular", _SINGULAR, np.full(self.model.size, np.nan), corrections)

    def check_turn(self, D: np.ndarray, corrections: list[float]) -> None:
        """Reject an increment (size,) with a rotation above the bound."""
        turn = abs(D[self.model.mesh.turns]).max()
        if not np.isfinite(turn):
            raise StepFailed("no convergence", OPEN, D, corrections)
        if turn > self.options.max_turn:
            raise StepFailed("large rotation", self._turned(turn), D, corrections)

    def _turned(self, turn: float) -> str:
        most = self.options.max_turn
        return f"a node turns by {turn:.3g} rad in one step, more than max_turn = {most:g}"

    def check_places(self, D: np.ndarray, corrections: list[float]) -> None:
        """Reject a step in which a node leaves the beam on which it slides.

        Or a point passes a member, or comes near more than were found.
        """
        if (fault := self.model.reduction.fault()) is not None:
            raise StepFailed(*fault, D, corrections)
        if (members := self.model.points.members) is None:
            return
        from fx_beam.fem.member_contacts import Found

        reasons: dict[int, str] = {Found.MOVED: _MOVED, Found.SLID: _MOVED}
        reasons[Found.PASSED] = _PASSED
        if (reason := reasons.get(members.check_search(D))) is not None:
            raise StepFailed("members", reason, D, corrections)

    def unconverged(self, D: np.ndarray, corrections: list[float]) -> StepFailed:
        """After the largest number of iterations."""
        reason = f"no convergence in {self.options.max_iterations} iterations"
        return StepFailed("no convergence", reason, D, corrections)

    def in_c(self, problem: Any, state: State) -> StepFailed:
        """Of the last step in C, from a state."""
        p, C, reduction = problem.c, problem.library, self.model.reduction
        D = next(problem.results(D=self.model.size)).copy()
        last = range(max(0, p.work.newton.tried - C.CORRECTIONS), p.work.newton.tried)
        corrections = [p.work.newton.corrections[i % C.CORRECTIONS] for i in last]
        reduction.set_start(state.q, state.slides)  # which says whether it is singular
        if p.work.run.failure == C.SLID_TOO_FAR:
            arcs = [(s.s0, s.s1) for s in (p.work.slider[i] for i in range(p.tables.sliders.count))]
            return StepFailed(*(reduction.fault(arcs) or ("", "")), D, corrections)
        if p.work.run.failure == C.OUT_OF_LINE:
            return StepFailed("singular", reduction.singularity, 0 * D)
        turn, nowhere = abs(D[self.model.mesh.turns]).max(), np.full(len(D), np.nan)
        reasons = {
            C.TURNED_TOO_FAR: ("large rotation", self._turned(turn), D),
            C.SINGULAR: ("singular", _SINGULAR, nowhere),
            C.OPEN_LOOP: ("no convergence", OPEN, nowhere),
            C.PASSED_THROUGH: ("members", _PASSED, D),
            C.MOVED_TOO_FAR: ("members", _MOVED, D),
            C.UNMET_FRICTION: ("no convergence", _UNMET, D),
            C.AMPLIFIED: ("damping", _AMPLIFIED, D),
        }
        if p.work.run.failure in reasons:
            return StepFailed(*reasons[p.work.run.failure], corrections)
        return self.unconverged(D, corrections)

    def error(
        self, message: str, tries: int, start: State, failed: StepFailed, advice: str
    ) -> StepError:
        """StepError for a step that failed after some cuts: what, why, the worst node, advice."""
        model = self.model
        D = abs(failed.D / model.units.nodes).reshape(-1, 3)
        node, component = np.unravel_index(np.argmax(np.nan_to_num(D, nan=np.inf)), D.shape)
        history = ", ".join(f"{r:.1e}" for r in failed.corrections[-8:])
        named = model.mesh.named(int(node), model.scene)
        place = (
            f"Largest increment: {COMPONENTS[component]} of {named}. Last corrections, in sizes of "
            f"the scene or rad: {history or 'none'}"
        )
        solver, cuts = ("static", "cuts") if self._stats.static else (model.scheme.name, "halvings")
        tries_text = f" after {tries} {cuts}" if tries else ""
        reason = f"{solver}: {message}{tries_text}: {failed.reason}"
        advice = corner_advice(model.scene.joints, start.slides) or advice
        return StepError(Failure(failed.kind, reason, start.t, place, advice))
