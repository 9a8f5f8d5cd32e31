"""Rounding errors of a stiffness matrix in soft directions, as in the bending of thin beams."""

from __future__ import annotations

import logging

import numpy as np
import scipy.sparse

_log = logging.getLogger("fx_beam")

# Bound of the rounding errors of x^T K x, relative to it, from which on a warning tells of them.
# In bending of thin beams a tenth of it is lost.
_FEW_DIGITS = 0.05


def warn_of_rounding(
    K: scipy.sparse.csr_matrix, vectors: np.ndarray, what: str, lost: bool = False
) -> None:
    """Warn if K has few digits in the directions of vectors x (n, m), or if they are `lost`."""
    size = abs(vectors)
    errors = np.finfo(float).eps * np.sum(size * (abs(K) @ size), axis=0)
    stiffness = abs(np.sum(vectors.conj() * (K @ vectors), axis=0))
    shares = np.divide(errors, stiffness, out=np.zeros(len(errors)), where=stiffness > 0)
    share = 1.0 if lost else shares.max(initial=0.0)
    if share > _FEW_DIGITS:
        _log.warning(
            "%s few correct digits, if any: rounding errors may be %.0e of the stiffness. Beams "
            "are so much stiffer in tension or shear than in bending (EA l^2 / EI, with the length "
            "l of elements, and their number). Take longer elements, or smaller EA and GA",
            *(what, min(share, 1.0)),
        )
