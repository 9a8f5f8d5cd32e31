"""How the reduced tangent is made of the full one."""

from __future__ import annotations

import itertools
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import scipy.sparse

from fx_beam.content_cache import cached_by_content
from fx_beam.fem.mesh import rotation_of
from fx_beam.fem.sparsity import Pattern, sparsity
from fx_beam.scene.joints import GROUND

from .graph import Auxiliaries, Couplings, Entries, joined

if TYPE_CHECKING:
    from .loops import Loops
    from .sliders import Sliders


class ReducedTangent(NamedTuple):
    """How the reduced tangent is made of the full one, by the names in c/tables.h."""

    #: Sparsity (indptr, indices) of the linear system, in compressed rows; nodes that slide on
    #: beams border it.
    pattern: Pattern
    #: Entries of K that are added as they are.
    direct: dict[str, np.ndarray]
    #: Products Tv K T. From the number `stiffened` on K is the stiffness of closures, then 1, for
    #: auxiliary unknowns and closures: both entries are behind the full tangent.
    coupled: dict[str, np.ndarray]
    #: Derivatives of Tv.
    geometric: dict[str, np.ndarray]
    #: Derivatives of the forces of springs and dampers on slides.
    restoring: dict[str, np.ndarray]
    stiffened: int
    #: Positions of entries of auxiliary unknowns that are 1.
    ones: np.ndarray


def reduced_tangent(
    couplings: Couplings,
    auxiliaries: Auxiliaries,
    sliders: Sliders | None,
    loops: Loops | None,
    sprung_columns: np.ndarray,
    matrix: scipy.sparse.csr_matrix,
    used: np.ndarray,
) -> ReducedTangent:
    """Positions of all products Tv[i, a] K[i, j] T[j, b] in the reduced tangent.

    `matrix` has the sparsity of K, of which some entries are `used`; `sprung_columns` are those of
    slides with forces.
    """
    free, arm_joints = couplings.free, couplings.arm_joints
    slide_columns = columns_of_slides(couplings)
    row_of, unknown_of = couplings.system
    geometric = []
    for m, joint in enumerate(arm_joints):
        turn = [] if joint.a is GROUND else couplings.entries(rotation_of(joint.a))
        turn = [e for e in turn if unknown_of[e[0]] >= 0]
        slide = [(slide_columns[m], 0, 1.0)] if 0 <= slide_columns[m] < free else []
        pairs_of_kinds = (turn, turn), (turn, slide), (slide, turn), (slide, slide)
        for kind, (maps, values) in enumerate(pairs_of_kinds[: 4 if joint.track.number else 3]):
            geometric += [(a, b, m, kind, s * o) for a, _, s in maps for b, _, o in values]
    terms = [term for gear in couplings.gears for term in gear.terms]
    for m, term in enumerate(terms, start=len(arm_joints)):
        ends = enumerate((term.joint.b, term.joint.a) if term.name == "rotation" else ())
        turns = [
            (column, end, sign)
            for end, node in ends
            if node is not GROUND
            for column, _, sign in couplings.entries(rotation_of(node))
            if unknown_of[column] >= 0
        ]
        geometric += [
            (a, b, m, end, (2 * e - 1) * s * o)
            for (a, e, s), (b, end, o) in itertools.product(turns, turns)
        ]
    #: Slides with forces that are unknowns, among all with forces.
    sprung = np.flatnonzero(unknown_of[sprung_columns] >= 0)
    restoring = [(c, c) for c in sprung_columns[sprung].tolist()]

    entries, moves = couplings.all_entries, unknown_of[couplings.all_entries.column] >= 0
    source, i, j = _products(entries.row, moves, used, matrix.indptr, matrix.indices)
    full_count = len(source)
    added, forces = [auxiliaries.system_entries], np.empty(0, dtype=int)
    if loops is not None:
        added = [loops.system_entries, *added]
        forces = couplings.unknown_count - len(loops) + loops.carried
        left, right = loops.stiffened()
        added_numbers = len(entries.row) + np.arange(len(left.row))
        i, j = (
            np.append(i, added_numbers),
            np.append(j, added_numbers + len(added_numbers)),
        )
        source = np.append(source, np.full(len(added_numbers), matrix.nnz + 1, np.int32))
        entries = Entries(*map(np.concatenate, zip(entries, left, right, strict=True)))
    extra = np.array([p[:2] for p in (*geometric, *restoring)], dtype=int).reshape(-1, 2).T
    rows = [row_of[entries.column][i], row_of[extra[0]], *(part.rows for part in added)]
    columns = [unknown_of[entries.column][j], unknown_of[extra[1]], *(p.columns for p in added)]
    row, column = np.concatenate(rows), np.concatenate(columns)
    del rows, columns  # of large scenes
    if sliders is None or not couplings.sliding:
        pattern, position = sparsity(row, column, couplings.unknown_count)
    else:
        position = sliders.set_tangent(row, column, forces)
        pattern = sliders.bordered.pattern
    factors = joined(*(part.factors for part in added))
    counts = len(source), len(geometric), len(restoring), len(factors["sign"])
    position, *small_parts = np.split(position, np.cumsum(counts))
    geometric_to, restoring_to, add_to, ones = map(np.copy, small_parts)  # the large one goes
    constant, sign = entries.value_at == 0, entries.sign
    direct = constant[i] & constant[j] & (sign[i] * sign[j] == 1) & (source < matrix.nnz)
    other_products = np.flatnonzero(~direct)
    i, j = i[other_products], j[other_products]
    names = "to", "from", "virtual", "value", "sign"
    coupled = (
        *(position[other_products], source[other_products]),
        *(entries.value_at[i], entries.value_at[j], sign[i] * sign[j]),
    )
    factors |= {"to": add_to, "from": np.full(len(add_to), matrix.nnz)}
    table = np.array([(m, kind, sign) for _, _, m, kind, sign in geometric]).reshape(-1, 3)
    joint_and_kind = dict(zip(("joint", "kind"), table[:, :2].T.astype(int), strict=True))
    return ReducedTangent(
        pattern,
        direct={"to": position[direct], "from": source[direct]},
        coupled=joined(dict(zip(names, coupled, strict=True)), factors),
        geometric={"to": geometric_to, **joint_and_kind, "sign": table[:, 2]},
        restoring={"to": restoring_to, "of": sprung},
        stiffened=np.count_nonzero(~direct[:full_count]),
        ones=ones,
    )


def columns_of_slides(couplings: Couplings) -> np.ndarray:
    """Column of the slide of each joint that moves; -1 for none."""
    numbers = (couplings.slides.get(joint.number, -1) for joint in couplings.arm_joints)
    return np.array([*numbers], dtype=int)


@cached_by_content
def _products(
    row: np.ndarray, moves: np.ndarray, used: np.ndarray, indptr: np.ndarray, indices: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Entries of K, and entries of Tv and T by which they are multiplied, of all products Tv K T.

    `row` and `moves`: rows of the entries of Tv, and whether they have an unknown. `used`, `indptr`
    and `indices`: used entries of K, and its compressed rows.
    """
    moving, size = np.flatnonzero(moves).astype(np.int32), len(indptr) - 1
    count = np.bincount(row[moving], minlength=size).astype(np.int32)
    first = np.cumsum(count, dtype=np.int32) - count
    rows = np.repeat(np.arange(size, dtype=np.int32), np.diff(indptr))
    products = count[rows] * count[indices] * used
    source = np.repeat(np.arange(len(indices), dtype=np.int32), products)
    begin = np.cumsum(products, dtype=np.int32) - products
    number = np.arange(len(source), dtype=np.int32) - np.repeat(begin, products)
    i, j = rows[source], indices[source]
    left, right = first[i] + number // count[j], first[j] + number % count[j]
    return source, moving[left], moving[right]
