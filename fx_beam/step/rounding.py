"""Rounding errors of a stiffness matrix in soft directions, as in the bending of thin beams."""

from __future__ import annotations

import logging

import numpy as np
import scipy.sparse

_log = logging.getLogger("fx_beam")

# A warning tells of rounding errors whose bound is above this part of x^T K x. In bending of thin
# beams the errors are about a tenth of the bound.
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
            "are far stiffer in tension or shear than in bending, or have very many elements. Take "
            "fewer elements, or smaller EA and GA",
            *(what, min(share, 1.0)),
        )
