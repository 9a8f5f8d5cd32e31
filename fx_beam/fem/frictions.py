"""Friction of forces at points that sticks: its springs, and where it acts."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from .compiled_points import CompiledPoints
from .member_contacts import SLOT_WIDTH, SLOTS, MemberPair
from .point_forces import PointForces


class Bristle(NamedTuple):
    """The spring of friction that sticks."""

    #: Place of its stretch among all internal variables of forces at points; then comes the slip,
    #: and in a joint, if it follows its force, this force.
    place: int
    mu: float
    follows: bool


def bristles_of(points: PointForces) -> list[Bristle]:
    """The springs of all friction that sticks."""
    bristles = [
        Bristle(first, float(numbers[-2]), force.load.joint >= 0)
        for force, _, _, numbers, _, _, first, *_ in points.placed
        if force.law.has_stick_state
    ]
    for pair, slots in _slots_of_members(points):
        for k, first in enumerate(slots.tolist()):
            bristles.append(Bristle(first + 1, float(pair.numbers[k // SLOTS, -2]), False))
    return bristles


def friction_of_members(points: PointForces, internal: np.ndarray) -> dict[int, np.ndarray]:
    """Stretch and slip (n, points, 2) of the first members, by the contact's number.

    From all internal variables (n, width). Of a node that touches two points: where its spring is
    stretched further.
    """
    frictions = {}
    for pair, slots in _slots_of_members(points):
        if pair.contact is not None:
            memory = internal[:, slots[:, None] + np.arange(SLOT_WIDTH)]
            memory = memory.reshape(len(internal), len(pair.points), SLOTS, SLOT_WIDTH)
            most = abs(memory[..., 1]).argmax(axis=-1)
            farthest = np.take_along_axis(memory, most[..., None, None], axis=2)
            frictions[pair.contact.number] = farthest[:, :, 0, 1:]
    return frictions


def _slots_of_members(points: PointForces) -> Iterator[tuple[MemberPair, np.ndarray]]:
    """Members that touch with friction, and where slots of all points are among all variables."""
    if (members := points.members) is None:
        return
    first_variable = points.width - members.width
    for pair, first in zip(members.pairs, members.first_slots[:-1].tolist(), strict=True):
        if pair.law.internal:
            yield pair, first_variable + SLOT_WIDTH * (first + np.arange(SLOTS * len(pair.points)))


def friction_sticks(compiled_points: CompiledPoints, q: np.ndarray, slides: np.ndarray) -> bool:
    """Whether friction acts that sticks: of a joint, or of a contact that is closed."""
    ends = np.cumsum(compiled_points.points.switch_counts, dtype=int)
    pairs = zip(
        compiled_points.points.laws,
        np.split(compiled_points.switches(q, slides) <= 0, ends),
        strict=False,
    )
    return any(
        law.has_stick_state and (not law.unilateral or closed.any()) for law, closed in pairs
    )
