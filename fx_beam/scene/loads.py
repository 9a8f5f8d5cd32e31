"""What acts on a scene, as plain data: dead loads, initial velocities, added virtual works."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.validation import (
    Constant,
    TimeFunction,
    check_takes_time,
    checked_function,
    time_function,
)

from .beam import Beam, Node


@dataclass(frozen=True)
class Load:
    """A load on a node or along a beam.

    Parameters
    ----------
    kind : str
        "force", "moment" or "line load".
    target : Node or Beam
        What it acts on.
    value : callable
        ``value(t)``: [fx, fy] in N, [moment] in N m, or [qx, qy] in N per metre of
        reference length.
    follower : bool
        Whether a force turns with the section of its node.
    along : callable, optional
        ``along(s)``, a line load [qx, qy] at the arc length s, of which ``value(t)`` is then the
        factor.
    """

    kind: str
    target: Node | Beam
    value: TimeFunction
    follower: bool = False
    along: Callable[[float], np.ndarray] | None = None

    def __str__(self):
        return f"{'follower ' if self.follower else ''}{self.kind} on {label(self.target)}"


def line_load(beam: Beam, load, of: str) -> Load:
    """Line load on a beam from a constant, or a function of the time or of the arc length."""
    what = f"line load on {label(beam)}"
    if of == "time":
        check_takes_time(load, what)
        return Load("line load", beam, time_function(load, 2, what))
    if of == "arc length":
        along = checked_function(load, 2, what, 0.0)
        return Load("line load", beam, Constant(np.ones(1)), along=along)
    raise SceneError(f"{what}: of = {of!r} must be 'time' or 'arc length'")


@dataclass(frozen=True)
class Velocity:
    """Initial velocity (2,) [m/s] and spin [rad/s] of a node or of all nodes of a beam."""

    target: Node | Beam
    value: Callable[[float, float], np.ndarray]
    spin: Callable[[float, float], np.ndarray]


def initial_velocity(target: Node | Beam, velocity, spin) -> Velocity:
    """Initial velocity and spin from constants or functions of the reference position."""
    node = target.start if isinstance(target, Beam) else target
    what = f"of {label(target)}"
    return Velocity(
        target,
        checked_function(velocity, 2, f"velocity {what}", node.x, node.y),
        checked_function(spin, 1, f"spin {what}", node.x, node.y),
    )


@dataclass(frozen=True)
class VirtualWork:
    """Virtual work per length of a user's own force, on one beam or on all."""

    term: Callable[[Any], Any]
    beam: Beam | None


def label(target: Node | Beam) -> str:
    """Name of a node or beam in messages."""
    return f"beam {target.name!r}" if isinstance(target, Beam) else str(target)
