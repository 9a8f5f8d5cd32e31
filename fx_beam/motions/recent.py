"""What a thread has set up last, which serves other scenes of the same structure."""

from __future__ import annotations

import threading
from typing import Any

from fx_beam.laws.schemes import Scheme
from fx_beam.scene.scene import Scene
from fx_beam.scene.structure import OtherStructureError
from fx_beam.step.model import Model

#: Degrees of freedom of a scene whose model is kept for another.
SMALL = 3000
# How much a thread keeps.
_MOST = 8


class _Recent(threading.local):
    """What a thread has set up last, with what it was for."""

    def __init__(self):
        self.known: list[tuple[Any, Any]] = []


_RECENT = _Recent()


def take_recent(scene: Scene, kind: Any) -> tuple[Any, Any]:
    """What was set up for a scene of a kind and nothing needs, or None; and a key for `keep`.

    It is taken out until it is kept again.
    """
    key = kind, len(scene.nodes), len(scene.beams), len(scene.joints), len(scene.bodies)
    free = (entry for entry in _RECENT.known if entry[0] == key and entry[1].is_free)
    entry = next(free, (key, None))
    _RECENT.known = [other for other in _RECENT.known if other is not entry]
    return entry[1], key


def keep(what: Any, key: Any) -> None:
    """Keep it for the next scenes, and forget what was kept long before."""
    _RECENT.known = [*_RECENT.known, (key, what)][-_MOST:]


def recent_model(scene: Scene, scheme: Scheme, **kind: bool) -> Model:
    """The model of a scene, which others take as soon as nothing needs it."""
    model, key = take_recent(scene, (type(scheme), *kind))
    try:
        if model is not None:
            model.refill(scene)
    except OtherStructureError:
        model = None
    model = model or Model(scene, scheme, **kind)
    if model.size <= SMALL:
        keep(model, key)
    return model
