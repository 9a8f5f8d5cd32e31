"""Couplings as lists of numbers, for the compiled loop."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from fx_beam.content_cache import cached_by_content


class AuxiliaryTables(NamedTuple):
    """Auxiliaries for the compiled loop, by the names in problem.h."""

    values: dict[str, Any]
    #: Entries of the reduced tangent, -1 for none; those that are 1.
    entries: dict[str, np.ndarray]
    ones: np.ndarray


class Tables(NamedTuple):
    """Couplings for the compiled loop: dictionaries of arrays of equal length."""

    #: Entries of T and Tv: row, column, value (0 is the constant 1) and sign.
    entries: dict
    #: Joints that depend on the motion, by the names in problem.h.
    joints: dict
    #: Degrees of freedom that follow through joint j: through is 2 j for x and 2 j + 1 for y.
    followers: dict
    #: Entries of the full tangent that are added to reduced ones as they are: to and source.
    direct: dict
    #: Entries that are multiplied by entries of Tv (virtual) and T (value): also with a sign.
    coupled: dict
    #: Geometric stiffness, the derivatives of Tv: to, joint, kind and sign.
    geometric: dict
    #: Derivatives of the forces of springs and dampers: to, of, side and sign.
    restoring: dict
    auxiliaries: AuxiliaryTables | None


class LoopTables(NamedTuple):
    """Closed loops for the compiled loop, by the names in problem.h."""

    values: dict[str, Any]
    #: Entries of the reduced tangent.
    entries: dict[str, np.ndarray]


@cached_by_content
def sparsity(rows: np.ndarray, columns: np.ndarray, n: int):
    """Compressed rows of the given pairs, and the position of each pair in them."""
    keys, position = np.unique(rows * n + columns, return_inverse=True)
    counts = np.bincount(keys // n, minlength=n)
    indptr = np.concatenate(([0], np.cumsum(counts)))
    return (indptr.astype(np.int32), (keys % n).astype(np.int32)), position
