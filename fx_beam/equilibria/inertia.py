"""Sylvester's inertia of the tangent of an equilibrium, from the factors of its step.

They belong to the last iteration of Newton's method, whose error is below its tolerance.
"""

from __future__ import annotations

import functools
from typing import Protocol

import numpy as np

from fx_beam.step.model import Model
from fx_beam.step.symmetry import Symmetry


class Factors(Protocol):
    """Factors of the last tangent."""

    @property
    def values(self) -> np.ndarray | None:
        """Values of the tangent; None if it is nowhere as a whole."""

    def negative_eigenvalues(self) -> int | None:
        """Their number; None if the factors do not tell."""


class Inertia:
    """Counts negative eigenvalues of symmetric tangents of a model."""

    def __init__(self, model: Model):
        self._model, reduction = model, model.reduction
        # Auxiliary unknowns, loops, sliders and contact of members make it another matrix than the
        # tangent.
        rows = len(reduction.factored[0]) - 1
        plain = rows == reduction.free == len(reduction.independent)
        self._known = plain and not model.couplings.sliding and model.points.members is None

    @functools.cached_property
    def _symmetry(self) -> Symmetry | None:
        """None where all forces have a potential."""
        model = self._model
        own = any(force.force for force in model.scene.forces_between)
        if not (model.forms.has_added or model.flows or own):
            return None
        return Symmetry(model.reduction.factored, model.unit_of_unknowns)

    def of(self, factors: Factors) -> int | None:
        """The number of negative eigenvalues; None if the factors do not tell."""
        if not self._known:
            return None
        if (symmetry := self._symmetry) is not None:
            if factors.values is None or not symmetry.holds(factors.values):
                return None
        return factors.negative_eigenvalues()
