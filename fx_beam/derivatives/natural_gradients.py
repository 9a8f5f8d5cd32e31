"""Natural strains at the ends of sub-steps: their derivatives by numbers of the scene."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse

from fx_beam.step.model import Model
from fx_beam.step.tape import Tape

from .gradient import Gradient


class NaturalRows:
    """The natural strains of a run before some sub-steps, or at its end."""

    def __init__(self, model: Model, tape: Tape):
        self._strains = model.natural
        times = np.append(tape.starts, tape.starts[-1] + tape.lengths[-1])
        if model.scheme.rates.at_rest:  # in proportion to the load
            times, factors = times[-1:], np.append(0.0, tape.memories)
            self._factors = factors[:, None] * self._strains.series(times)
        else:
            self._factors = self._strains.series(times)
        columns = self._strains.columns
        # Of each value of the columns its strain and its column.
        self._rows, self._of = (
            columns.indices,
            np.repeat(np.arange(columns.shape[1]), np.diff(columns.indptr)),
        )

    def at(self, boundary: int) -> np.ndarray:
        """The strains (cells, degree, 3) before a sub-step."""
        return (self._strains.columns @ self._factors[boundary]).reshape(self._strains.shape)

    def pull(self, boundary: int, by: np.ndarray, to: Gradient) -> None:
        """Add the derivatives by numbers, from those by the strains before a sub-step."""
        if boundary == 0:
            to.add_numbers("natural", by.ravel())
            return
        of_values, factors = by.ravel()[self._rows], self._factors[boundary]
        to.add_numbers("natural columns", of_values * factors[self._of])
        columns = self._strains.columns
        of_columns = np.bincount(self._of, of_values * columns.data, columns.shape[1])
        for i, value in enumerate(of_columns.tolist(), start=(boundary - 1) * len(factors)):
            to.add_number("naturals", i, value)

    def push(self, boundary: int, changes: Mapping[str, np.ndarray], j: int) -> np.ndarray:
        """The change of the strains before a sub-step in one direction."""
        if boundary == 0:
            return changes["natural"][j].reshape(self._strains.shape)
        columns, factors = self._strains.columns, self._factors[boundary]
        parts = changes["natural columns"][j].ravel(), columns.indices, columns.indptr
        changed = scipy.sparse.csc_matrix(parts, columns.shape) @ factors
        more = changes["naturals"][j].reshape(-1, len(factors))[boundary - 1]
        return (changed + columns @ more).reshape(self._strains.shape)
