"""Derivatives of contact of nodes with members: of stored energies, and what C needs for forces."""

from __future__ import annotations

import numpy as np

from fx_beam.laws.point_laws import StepRule

from .compiled_laws import derivative_of
from .member_contacts import MemberContacts


def energy_slopes(
    members: MemberContacts, q: np.ndarray, internal: np.ndarray
) -> dict[str, np.ndarray]:
    """Derivatives (k, ...) of stored energies: by "q", "spring internal", "members", "X".

    `internal` (k, n) has all variables at points.
    """
    numbers, ffi = sum(pair.numbers.size for pair in members.pairs), members.ffi
    sums = [np.zeros(q.shape), np.zeros(internal.shape), np.zeros((len(q), numbers))]
    addresses = [
        0 if law.law.energy is None else law.derivative("energy").address for law in members.laws
    ]
    functions = ffi.new("Law *[]", [ffi.cast("Law *", address) for address in addresses])

    def pointer(row: np.ndarray):
        return ffi.from_buffer("double[]", row)

    for state, *rows in zip(zip(q, internal, strict=True), *sums, strict=True):
        energy = ffi.new("Energy *", [functions, 0.0, *map(pointer, rows)])
        members.library.fx_stored_at_members(members.c, energy, *map(pointer, state))
    X = sums[0].reshape(len(q), -1, 3)[..., :2]
    return {**dict(zip(("q", "spring internal", "members"), sums, strict=True)), "X": X}


def followed(members: MemberContacts, rule: StepRule) -> dict[str, int]:
    """Hand over what derivatives of forces need besides.

    Returns the numbers of all points, and of arc lengths of nodes, by the names in c/problem.h.
    """
    members.slopes = [derivative_of(pair.followed, rule, "forces") for pair in members.pairs]
    for i, function in enumerate(members.slopes):
        members.c.of[i].slopes = members.ffi.cast("Law *", function.address)
    numbers, arcs = (sum(getattr(p, n).size for p in members.pairs) for n in ("numbers", "arc"))
    return {"member_numbers": numbers, "member_arcs": arcs}
