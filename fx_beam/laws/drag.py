"""Drag: forces and moments against the velocity of a beam."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import ufl

from .kinematics import Step, director, perp
from .resultants import turning_work

#: Added to the square of a speed, whose root then has a derivative at rest; below all rounding.
_AT_REST = 1e-300


def drag_work(step: Step, of: Mapping[str, Any]):
    """Virtual work per length against the drag, at the scheme's level in the step.

    `of` has the coefficients: "linear" and "quadratic" in all directions, those "along and across",
    and "rotation".
    """
    work = ufl.dot(_force(step, of, step.v), step.virtual_u)
    if "rotation" in of and step.nodes is not None:
        # The virtual rotation that is 2 tan(Dpsi/2) on the step's own increment.
        return work - turning_work(step, of["rotation"] * step.omega, 0)
    return work + of.get("rotation", 0) * step.omega * step.virtual_psi


def drag_loss(step: Step, of: Mapping[str, Any]):
    """Energy per length that the drag at the mean velocity takes in a step; never negative."""
    turn = step.Dpsi if step.nodes is None else 2 * ufl.tan(step.Dpsi / 2)
    lost = ufl.dot(_force(step, of, step.Du / step.dt), step.Du)
    return lost + of.get("rotation", 0) * turn**2 / step.dt


def _force(step: Step, of: Mapping[str, Any], v):
    """Resisting force per length at the velocity v."""
    force = of.get("linear", 0) * v
    if "quadratic" in of:
        force += of["quadratic"] * ufl.sqrt(ufl.dot(v, v) + _AT_REST) * v
    if {"linear along and across", "quadratic along and across"} & of.keys():
        t = director(step.psi, step.t0)
        for i, direction in enumerate((t, perp(t))):
            speed, factor = ufl.dot(v, direction), 0
            if "linear along and across" in of:
                factor += of["linear along and across"][i]
            if "quadratic along and across" in of:
                factor += of["quadratic along and across"][i] * abs(speed)
            force += factor * speed * direction
    return force
