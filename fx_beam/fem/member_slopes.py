"""Derivatives of contact of nodes with members: of stored energies, and what C needs for forces."""

from __future__ import annotations

import numpy as np

from fx_beam.laws.point_laws import StepRule

from .compiled_laws import slopes_of
from .member_contacts import MemberContacts


def energy_by(
    members: MemberContacts, q: np.ndarray, internal: np.ndarray, of_points: dict[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Derivatives (k, ...) of stored energies: by "q", "spring internal", "members", "X".

    With those `of_points` by the first two. `internal` has all variables at points.
    """
    of_q, of_internal = np.zeros(q.shape), of_points["spring internal"].copy()
    numbers = sum(pair.numbers.size for pair in members.pairs)
    sums, ffi = (of_q, of_internal, np.zeros((len(q), numbers))), members.ffi
    addresses = [
        0 if law.law.energy is None else law.derivatives("energy").address for law in members.laws
    ]
    functions = ffi.new("Law *[]", [ffi.cast("Law *", address) for address in addresses])

    def in_c(row: np.ndarray):
        return ffi.from_buffer("double[]", row)

    for state, *rows in zip(zip(q, internal, strict=True), *sums, strict=True):
        energy = ffi.new("Energy *", [functions, 0.0, *map(in_c, rows)])
        members.library.fx_stored_at_members(members.c, energy, *map(in_c, state))
    X = of_q.reshape(len(q), -1, 3)[..., :2]
    of_both = {"q": of_q + of_points["q"], "spring internal": of_internal}
    return of_both | {"members": sums[2], "X": X}


def followed(members: MemberContacts, rule: StepRule) -> dict[str, int]:
    """Hand over what derivatives of forces need besides.

    Returns the numbers of all points, and of arc lengths of nodes, by the names in c/problem.h.
    """
    members.slopes = [slopes_of(pair.followed, rule) for pair in members.pairs]
    for i, function in enumerate(members.slopes):
        members.c.of[i].slopes = members.ffi.cast("Law *", function.address)
    numbers, arcs = (sum(getattr(p, n).size for p in members.pairs) for n in ("numbers", "arc"))
    return {"member_numbers": numbers, "member_arcs": arcs}
