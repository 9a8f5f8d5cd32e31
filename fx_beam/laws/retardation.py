"""Viscous stress resultants of members: Kelvin and Voigt's material."""

from __future__ import annotations

import ufl

from fx_beam.scene.law import Law

from .kinematics import Step, director, perp
from .resultants import ExactResultants, Resultants, at_averages, with_exact_work, work_of


def viscous(step: Step, law: Law, tau, level: float) -> Resultants | ExactResultants:
    """C (tau Edot), with the stiffness C of the undeformed section and three retardation times.

    At mid-step the strain rate is dE/dt, so that the loss is exact. Other schemes take the rate at
    their level.
    """
    if level == 0.5:
        return with_exact_work(step, at_averages(step, *_mean_forces(step, law, tau)))
    dphi, t = step.t0 + step.prime(step.u), director(step.psi, step.t0)
    rate = step.prime(step.v)
    rates = (
        ufl.dot(rate, t) + step.omega * ufl.dot(dphi, perp(t)),
        ufl.dot(rate, perp(t)) - step.omega * ufl.dot(dphi, t),
        step.prime(step.omega),
    )
    natural = step.natural_increments
    N, Q, M = law.linear([tau[i] * (rates[i] - natural[i] / step.dt) for i in range(3)])
    return Resultants(dphi, t, N, Q, M, m=M)


def viscous_loss(step: Step, law: Law, tau):
    """Energy per length that they take in a step, dE . C (tau dE) / dt; never negative."""
    return work_of(_mean_forces(step, law, tau), step.strain_increments)


def _mean_forces(step: Step, law: Law, tau):
    """C (tau dE / dt)."""
    return law.linear([tau[i] * dE / step.dt for i, dE in enumerate(step.strain_increments)])
