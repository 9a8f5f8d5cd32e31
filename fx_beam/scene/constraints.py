"""The joints and supports of a scene: by number, and as texts that tell later what it had."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from .joints import Joint


class JointKey(NamedTuple):
    """A joint that a scene had."""

    number: int
    kind: str
    a: int
    b: int
    #: Names of its coordinates with a motor.
    motors: tuple[str, ...]


def joints_by_number(scene: Any) -> dict[int, Joint]:
    """The joints of a scene by their numbers, some of which may be missing."""
    return {joint.number: joint for joint in scene.joints}


def slides_at_start(scene: Any) -> np.ndarray:
    """Slides (joint_count,) of the joints in the reference configuration [m]."""
    slides = np.zeros(scene.joint_count)
    for joint in scene.joints:
        slides[joint.number] = joint.start()[0]
    return slides


def constraints_of(scene: Any) -> np.ndarray:
    """Texts (m,), one of each joint and support, in order; equal if these couple the same way."""
    texts = [_text(joint) for joint in scene.joints]
    for name, keys in (("fixed", scene.fixed), ("driven", scene.prescribed)):
        texts += [f"{name} {node} {component}" for node, component in sorted(keys)]
    return np.array(texts, dtype=str)


def joints_in(texts: Sequence[str]) -> list[JointKey]:
    """The joints in texts of `constraints_of`."""
    found = []
    for text in texts:
        name, *words = text.split(" ")
        if name == "joint":
            number, kind, a, b, motors = words[:5]
            known = tuple(filter(None, motors.split(",")))
            found.append(JointKey(int(number), kind, int(a), int(b), known))
    return found


def key_of(joint: Joint) -> JointKey:
    """The same of a joint."""
    parts = (("slide", joint.slide), ("rotation", joint.rotation))
    driven = tuple(name for name, part in parts if part is not None and part.motor is not None)
    return JointKey(joint.number, joint.kind, joint.a.number, joint.b.number, driven)


def _text(joint: Joint) -> str:
    number, kind, a, b, driven = key_of(joint)
    place = [*joint.offset.tolist(), *([] if joint.axis is None else joint.axis.tolist())]
    on = getattr(joint, "beam", None)
    place += [] if joint.place is None else [*joint.place.apart, joint.place.turn]
    words = [",".join(driven), *map(repr, place), "" if on is None else on.name]
    return " ".join(["joint", str(number), kind, str(a), str(b), *words])
