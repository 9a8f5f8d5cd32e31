"""What acts on a scene, as plain data: dead loads, initial velocities, added virtual works."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from .beam import Beam, Node
from .values import TimeFunction


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
    """

    kind: str
    target: Node | Beam
    value: TimeFunction
    follower: bool = False

    def __str__(self):
        return f"{'follower ' if self.follower else ''}{self.kind} on {label(self.target)}"


@dataclass(frozen=True)
class Velocity:
    """Initial velocity (2,) [m/s] and spin [rad/s] of a node or of all nodes of a beam."""

    target: Node | Beam
    value: Callable[[float, float], np.ndarray]
    spin: Callable[[float, float], np.ndarray]


@dataclass(frozen=True)
class VirtualWork:
    """Virtual work per length of a user's own force, on one beam or on all."""

    term: Callable[[Any], Any]
    beam: Beam | None


def label(target: Node | Beam) -> str:
    """Name of a node or beam in messages."""
    return f"beam {target.name!r}" if isinstance(target, Beam) else str(target)
