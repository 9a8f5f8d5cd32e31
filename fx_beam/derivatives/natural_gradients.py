"""Natural strains at the ends of sub-steps: their derivatives by numbers of the scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np
import scipy.sparse

from fx_beam.step.model import Model
from fx_beam.step.tape import Tape

from .gradient import Block, of_row


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
        columns = self._strains.unit_loads
        # Of each value of the columns its strain and its column.
        self._rows, self._of = (
            columns.indices,
            np.repeat(np.arange(columns.shape[1]), np.diff(columns.indptr)),
        )

    def at(self, boundary: int) -> np.ndarray:
        """The strains (cells, degree, 3) before a sub-step."""
        return (self._strains.unit_loads @ self._factors[boundary]).reshape(self._strains.shape)

    def blocks(self, row: int, boundary: int, by: np.ndarray) -> Iterator[Block]:
        """Derivatives of a row by numbers, from those by the strains before a sub-step."""
        if boundary == 0:
            yield of_row("natural", row, by)
            return
        of_values, columns = by.ravel()[self._rows], self._strains.unit_loads
        yield of_row("natural columns", row, of_values * self._factors[boundary][self._of])
        of_columns = np.bincount(self._of, of_values * columns.data, columns.shape[1])
        yield of_row("naturals", row, of_columns, boundary - 1)

    def jvp(self, boundary: int, changes: Mapping[str, np.ndarray], j: int) -> np.ndarray:
        """The change of the strains before a sub-step in one direction."""
        if boundary == 0:
            return changes["natural"][j].reshape(self._strains.shape)
        columns, factors = self._strains.unit_loads, self._factors[boundary]
        parts = changes["natural columns"][j].ravel(), columns.indices, columns.indptr
        changed = scipy.sparse.csc_matrix(parts, columns.shape) @ factors
        more = changes["naturals"][j].reshape(-1, len(factors))[boundary - 1]
        return (changed + columns @ more).reshape(self._strains.shape)
