"""Which joints close loops, so that the loops are short.

Loops of one tree are a basis of all loops: joint f of loop k may close it in the place of the joint
that does. Each other loop with f becomes its sum with loop k, without what both have. So rungs of a
ladder, whose loops go down to the ground, become loops of one cell each.
"""

from __future__ import annotations

from collections.abc import Sequence

from fx_beam.scene.joints import Joint

# Loops are changed only if they have fewer joints in all than this part of theirs.
_SHORTER = 0.7
_PASSES = 3


def order_for_short_loops(joints: Sequence[Joint], loops: Sequence[Sequence[Joint]]) -> list[Joint]:
    """Joints in the order in which trees grow: those that close loops, given as joints, are last.

    The last joint of a loop closes it. Only plain hinges are exchanged.
    """
    number = {id(joint): k for k, joint in enumerate(joints)}
    closing = [number[id(loop[-1])] for loop in loops]
    # One bit for each joint.
    basis = [sum(1 << number[id(joint)] for joint in loop) for loop in loops]
    hinges = sum(
        1 << k for k, joint in enumerate(joints) if joint.is_index and not joint.turns_together
    )
    before = sum(map(int.bit_count, basis))
    changed, passes = len(basis) > 1, 0
    while changed and passes < _PASSES:
        changed, passes = False, passes + 1
        for k in sorted(range(len(basis)), key=lambda k: basis[k].bit_count()):
            new = _better(k, basis, hinges)
            if new is not None and hinges >> closing[k] & 1:
                for g, loop in enumerate(basis):
                    if g != k and loop >> new & 1:
                        basis[g] = loop ^ basis[k]
                closing[k], changed = new, True
    if sum(map(int.bit_count, basis)) > _SHORTER * before:
        return list(joints)
    last = set(closing)
    return [joint for k, joint in enumerate(joints) if k not in last] + [
        joints[k] for k in sorted(last)
    ]


def _better(k: int, basis: list[int], hinges: int) -> int | None:
    """The hinge of a loop that shortens the others most if it closes this one; None if none."""
    loop, gains = basis[k], dict[int, int]()
    for g, other in enumerate(basis):
        common = other & loop & hinges
        if g == k or not common:
            continue
        gain = other.bit_count() - (other ^ loop).bit_count()
        while common:
            bit = common & -common
            gains[bit] = gains.get(bit, 0) + gain
            common ^= bit
    best = max(gains, key=lambda bit: gains[bit], default=0)
    return best.bit_length() - 1 if best and gains[best] > 0 else None
