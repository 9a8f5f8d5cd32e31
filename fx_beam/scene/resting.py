"""A scene at rest: without what acts by rates alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from .coordinate import Coordinate, Coulomb
from .scene import Scene


def resting(scene: Scene) -> Scene:
    """The scene without dampers, friction of a constant size, drag, and losses of contact.

    Nodes, beams and all that has none of these are the same.
    """
    rest = object.__new__(Scene)
    rest.__dict__.update(vars(scene))
    rest.drags = []
    rest.contacts = [replace(of, restitution=1.0) if of.loss else of for of in scene.contacts]
    rest.joints = [_with_resting(joint, "slide", "rotation") for joint in scene.joints]
    rest.forces_between = [_with_resting(force, "on") for force in scene.forces_between]
    return rest


def _with_resting(part: Any, *names: str) -> Any:
    """A part whose coordinates with these names are at rest."""
    moved = {name: on for name in names if _acts_by_rates(on := getattr(part, name))}
    return replace(part, **{name: _resting(on) for name, on in moved.items()}) if moved else part


def _acts_by_rates(on: Coordinate | None) -> bool:
    return on is not None and bool(on.damper or on.friction or on.stop)


def _resting(on: Coordinate) -> Coordinate:
    friction = on.friction if isinstance(on.friction, Coulomb) else None
    stop = on.stop and replace(on.stop, restitution=1.0)
    return replace(on, damper=None, friction=friction, stop=stop)
