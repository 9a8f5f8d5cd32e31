"""Friction of forces at points: its springs, smooth signs, and what sticks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
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


class SmoothSign(NamedTuple):
    """Friction with the smooth sign of a rate: below the speed it is viscous."""

    speed: float
    #: The joint of its slide, or -1 and degrees of freedom, -1 for the ground.
    slide: int
    dofs: Sequence[int]
    #: From the first to the second node in the reference, if it is on their distance.
    arm: np.ndarray
    #: What of the scene it belongs to, as text.
    owner: str

    def coordinate(self, q: np.ndarray, slides: np.ndarray) -> np.ndarray:
        """The coordinate (n,) in configurations (n, ...): a slide, an angle or a distance."""
        if self.slide >= 0:
            return slides[:, self.slide]
        a, b = np.split(np.where(np.array(self.dofs) < 0, 0.0, q[:, self.dofs]), 2, axis=1)
        return np.hypot(*(b - a + self.arm).T) if len(self.dofs) > 2 else (b - a)[:, 0]


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


def smooth_signs_of(points: PointForces) -> list[SmoothSign]:
    """All friction with the smooth sign of a rate."""
    signs = list[SmoothSign]()
    for force, _, _, numbers, *_ in points.placed:
        if force.law.smooth:
            arm = numbers[:2] if len(force.dofs) == 4 else np.empty(0)  # numbers of a distance
            place = force.slide, force.dofs, arm, force.belongs_to
            signs.append(SmoothSign(float(numbers[len(arm)]), *place))
    return signs


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
