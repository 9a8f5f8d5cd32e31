"""Stress resultants that take energy from the motion and keep both momenta."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from fx_beam.scene.law import Law

from .kinematics import Step, differences
from .resultants import ExactResultants, Resultants, averaged, with_exact_work, work_of


@dataclass(frozen=True)
class DecayingResultants:
    """Resultants of a step, and the energies of its scheme."""

    #: Resultants whose work is that of the stored energy, plus what the scheme takes.
    exact: ExactResultants
    #: Those of the stored energy alone.
    mean: Resultants
    #: Energy per length that the scheme takes in the step, and that it holds for the next one;
    #: None if it holds none.
    loss: Any
    held: Any
    #: What it held at the start, with the stiffness of this step; None likewise.
    held_before: Any = None

    @property
    def N(self):
        """Axial force [N]."""
        return self.exact.N

    @property
    def Q(self):
        """Shear force [N]."""
        return self.exact.Q

    @property
    def M(self):
        """Bending moment [N m]."""
        return self.exact.M

    def virtual_work(self, step: Step):
        """Internal virtual work per length of the resultants."""
        return self.exact.virtual_work(step)


@dataclass(frozen=True)
class Decaying:
    """The averaged resultants plus damping/2 C (dE - r dE_before).

    dE are the increments of the strains in this step, dE_before in the last one, C the stiffness,
    and r the ratio of the steps' lengths, at most 1. With order 1, r is 0.
    """

    damping: Any
    order: int

    def __call__(self, step: Step, law: Law) -> DecayingResultants:
        """The resultants of a step."""
        # Of the motion alone: what natural strains do is no vibration.
        now = differences(step.total_strains0, step.total_strains1)
        rest, held, held_before, lost_before = now, None, None, 0.0
        if self.order == 2:
            before = differences(step.strains_before, step.total_strains0)
            rest = [a - step.memory * b for a, b in zip(now, before, strict=True)]
            # The work of the added resultants is the loss plus what the held energy gains:
            # 2 dE.C rest = dE.C dE - r^2 dE_before.C dE_before + rest.C rest
            held = self.damping / 4 * work_of(law.linear(now), now)
            of_before = work_of(law.linear(before), before)
            held_before = self.damping / 4 * of_before
            lost_before = (1 - step.memory**2) * of_before
        taken = law.linear(rest)
        N, Q, M = (self.damping / 2 * force for force in taken)
        share = 2 if self.order == 1 else 1
        loss = self.damping / 4 * (share * work_of(taken, rest) + lost_before)
        mean = averaged(step, law)
        total = mean._replace(N=mean.N + N, Q=mean.Q + Q, M=mean.M + M)
        return DecayingResultants(with_exact_work(step, total), mean, loss, held, held_before)
