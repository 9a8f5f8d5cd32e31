"""Rates that fit the joints, and the impulses of joints and supports that make them fit.

The mid-point rule leaves in the rates a part that joints do not allow: v1 = 2 Du/dt - v0. It
alternates from step to step, and hardly enters the motion, but forces of a step contain its change.
The nearest rates in the norm of the mass are without it:

    v* = v + c    with    M c = G^T mu,    G v* = g

The joints exert the impulses mu. So their mean force over a step is that of the step, plus the
increment of mu, divided by the length of the step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.sparse
import scipy.sparse.linalg

from .rate_equations import RateEquations, summing
from .rigid_points import RigidPoints

# Numbers in the arrays of the configurations that are solved at once.
_AT_ONCE = 1 << 20
# Mass of what has none, relative to the least mass that there is. Repetitions remove its effect: at
# most so many, until corrections are below round-off.
_LITTLE, _REPETITIONS, _ROUND_OFF = 1e-6, 20, 1e-14


class Fit(NamedTuple):
    """Rates that fit, and what they take."""

    #: Rates v* (n, size), and their difference c from the given ones.
    rates: np.ndarray
    corrections: np.ndarray
    #: Impulses (n, joints, 3) of joints on their nodes b, and (n, columns) of motors and supports.
    joints: np.ndarray
    constraints: np.ndarray


class FittedRates:
    """Finds the nearest rates that fit joints, supports and driven motions.

    `mass` (size, size) is that of the scene, `unit` (size,) the size of a unit increment. Sparse
    matrices for each configuration serve all scenes; `compiled_rates` has what is faster.
    """

    def __init__(
        self, equations: RateEquations, points: RigidPoints, mass: scipy.sparse.csr_matrix, unit
    ):
        self.equations, self.points = equations, points
        #: Masses with the little ones (size,) of what has none.
        self.little = _little_mass(mass, unit)
        self.mass = (mass + scipy.sparse.diags(self.little)).tocsc()
        self._to_rows = summing(points.row, len(points.remaining))

    def fit(self, q: np.ndarray, v: np.ndarray, slides: np.ndarray, driven: np.ndarray) -> Fit:
        """Rates for v (n, size) at q (n, size) and slides (n, joints).

        `driven` (n, driven) are the rates of driven motions; those that are NaN are taken from v.
        """
        rows = max(1, _AT_ONCE // max(v.shape[1], len(self.equations.row)))
        parts = [
            self._fit(*(values[k : k + rows] for values in (q, v, slides, driven)))
            for k in range(0, len(q), rows)
        ]
        return parts[0] if len(parts) == 1 else Fit(*map(np.concatenate, zip(*parts, strict=True)))

    def _fit(self, q, v, slides, driven) -> Fit:
        equations, points = self.equations, self.points
        of, arms = equations.at(q, slides), points.arms(q)
        entries = points.condensed(of.entries, arms)
        lacking = equations.driven(of, driven)[:, points.remaining]
        lacking = np.nan_to_num(lacking - (entries * v[:, points.dof]) @ self._to_rows)
        c, of_remaining = np.zeros_like(v), lacking
        if len(points.remaining):
            c, of_remaining = self._solve(entries, lacking)
        multipliers = np.zeros((len(q), equations.count))
        multipliers[:, points.remaining] = of_remaining
        points.complete(of.entries, multipliers, arms)
        fitted = v + c
        points.move(fitted, arms)
        return Fit(fitted, fitted - v, *equations.forces(of, multipliers))

    def _solve(self, entries: np.ndarray, lacking: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Corrections (n, size) and multipliers (n, rows)."""
        n, size, little = len(lacking), len(self.little), self.little
        c, multipliers = np.zeros((n, size)), np.zeros(lacking.shape)
        for k in range(n):
            if k == 0 or (entries[k] != entries[k - 1]).any():
                factors = scipy.sparse.linalg.splu(self._saddle(entries[k]))
            for _ in range(_REPETITIONS):
                x = factors.solve(np.append(little * c[k], lacking[k]))
                before, c[k], multipliers[k] = c[k].copy(), x[:size], -x[size:]
                if not little.any() or (
                    abs(c[k] - before)[little > 0].max() <= _ROUND_OFF * abs(c[k]).max()
                ):
                    break
        return c, multipliers

    def _saddle(self, entries: np.ndarray) -> scipy.sparse.csc_matrix:
        """Matrix of the rates and of the negative multipliers."""
        at, shape = (
            (self.points.row, self.points.dof),
            (len(self.points.remaining), len(self.little)),
        )
        G = scipy.sparse.csr_matrix((entries, at), shape)
        G.eliminate_zeros()  # a node that slides has entries of the whole beam
        return scipy.sparse.bmat([[self.mass, G.T], [G, None]], format="csc")


def _little_mass(mass: scipy.sparse.csr_matrix, unit: np.ndarray) -> np.ndarray:
    """Small masses and inertias (size,) of the degrees of freedom that have none."""
    inertia = mass.diagonal() * unit**2
    least = inertia[inertia > 0].min() if inertia.any() else 1.0
    return np.where(inertia > 0, 0.0, _LITTLE * least / unit**2)
