"""The forces of a scene in one step, and their tangent."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse

from fx_beam.laws.interval import StepBatch

if TYPE_CHECKING:
    from .forms import Forms


class StepForces:
    """Forces of `Forms` in a step that has begun, and at the last increment."""

    def __init__(self, forms: Forms, step: StepBatch):
        self._forms, self._step = forms, step

    def internal(self, D: np.ndarray) -> np.ndarray:
        """Internal forces (size,) [N, N m] for an increment D, with others against the motion."""
        force = self.of_beams(D)
        self._forms.compiled_points.add_force(D, force)
        return force

    def of_beams(self, D: np.ndarray) -> np.ndarray:
        """Forces (size,) of beams alone, with added virtual works [N, N m]."""
        force, self._step = np.zeros(len(D)), self._step._replace(D=D[None])
        if self._forms.beams is not None:
            self._forms.beams.add_force(self._step, force)
        return force

    def tangent(self) -> scipy.sparse.csr_matrix:
        """Derivatives of the last internal forces, with contact of members in its sparsity."""
        forms = self._forms
        K, members = forms.stiffness.astype(float), forms.points.members
        if forms.beams is not None:
            forms.beams.add_tangent(self._step, K.data, forms.cell_entries)
        forms.compiled_points.add_tangent(K.data)
        return K if members is None else K + members.tangent()

    def added(self) -> np.ndarray:
        """Forces (size,) of added virtual works and followers [N, N m]."""
        force = np.zeros(self._forms.size)
        if self._forms.beams is not None:
            self._forms.beams.add_external(self._step, force)
        self._forms.compiled_points.add_external(force)
        return force
