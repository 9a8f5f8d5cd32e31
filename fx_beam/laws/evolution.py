"""Evolution of internal variables over a step, and the energy that it takes."""

from __future__ import annotations

from dataclasses import replace

import ufl

from fx_beam.scene.internal_variables import InternalVariables
from fx_beam.scene.law import Energy, Law, own_law


def evolved(variables: InternalVariables, old, e0, e1, dt, at_rest: bool):
    """Internal variables at the end of a step: updated to their level in it, then linear."""
    level = 1.0 if at_rest else variables.level
    strains = tuple((1 - level) * a + level * b for a, b in zip(e0, e1, strict=True))
    at_level = variables.updated(old, e0, strains, level * dt)
    return old + (at_level - old) / level


def law_of_step(energy: Energy, old, new) -> Law:
    """The law at the mean of the internal variables, with those of both ends."""

    def at(a) -> Energy:
        return lambda *strains: energy(*strains, a)

    law = own_law(at((old + new) / 2))
    start, end = (replace(law, energy=at(a)) for a in (old, new))
    return replace(law, ends=(start, end))


def evolution_loss(energy: Energy, old, new, e0, e1, at_rest: bool):
    """Energy that the evolution takes: per length, or of a spring.

    In motions what the work N.(E1 - E0) + M (K1 - K0) has more than the stored energy gains, in
    statics the work of the forces that drive it, at the end of the step.
    """
    if at_rest:
        a = ufl.variable(new)
        return -ufl.dot(ufl.diff(energy(*e1, a), a), new - old)
    mean = (old + new) / 2
    return energy(*e1, mean) - energy(*e1, new) + energy(*e0, old) - energy(*e0, mean)
