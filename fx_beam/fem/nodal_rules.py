"""Nodal rules for the rates at all nodes of a mesh."""

from __future__ import annotations

import ufl

import numpy as np
import scipy.sparse

from fx_beam.laws.nodal_rates import NodalRates

from .compiled_laws import PointFunction, point_functions

#: Arguments of a rule, four vectors and dt, and its values: an acceleration, its derivatives by the
#: increment, rates and accelerations.
ARGUMENTS, VALUES = 13, 18


class NodalRules:
    """Rates at all nodes by the rules of `NodalRates`, and the tangent of the inertia forces."""

    def __init__(self, rates: NodalRates, dofs: np.ndarray, mass: scipy.sparse.csr_matrix):
        self.functions = [_compiled(rates, rule) for rule in rates.rules]
        self._dofs, self._mass = dofs, mass
        nodes, component = (np.empty(dofs.size, dtype=int) for _ in range(2))
        nodes[dofs], component[dofs] = np.arange(len(dofs))[:, None], np.arange(3)
        rows = np.repeat(np.arange(dofs.size), np.diff(mass.indptr))
        #: Nonzero entries (n,) of the mass, and (n, 3) of the tangent to which they contribute.
        self.heavy = np.flatnonzero(mass.data)
        at = mass.indices[self.heavy]
        self._node, self._component = nodes[at], component[at]
        #: Three times the node of their columns, plus the component there.
        self.columns = 3 * self._node + self._component
        number = mass.copy()
        number.data = np.arange(1, len(mass.data) + 1)
        entries = number[np.repeat(rows[self.heavy], 3), dofs[self._node].ravel()]
        self.value_at = np.asarray(entries).reshape(-1, 3) - 1

    def at(self, sub_step: int, D, v0, a0, before, dt: float) -> np.ndarray:
        """Values (nodes, VALUES) of the rule of a sub-step."""
        function = self.functions[sub_step % len(self.functions)]
        columns = [vector[self._dofs] for vector in (D, v0, a0, before)]
        rows = np.hstack([*columns, np.full((len(self._dofs), 1), dt)])
        return np.array([function(row) for row in rows])

    def to_vector(self, values: np.ndarray) -> np.ndarray:
        """Vector (size,) of values (nodes, 3)."""
        vector = np.empty(self._dofs.size)
        vector[self._dofs] = values
        return vector

    def add_tangent(self, values: np.ndarray, data: np.ndarray) -> None:
        """Add the mass times the derivatives of the accelerations to the tangent's values."""
        slopes = values[:, 3:12].reshape(-1, 3, 3)[self._node, self._component]
        np.add.at(data, self.value_at, self._mass.data[self.heavy, None] * slopes)


def _compiled(rates: NodalRates, rule) -> PointFunction:
    def values(numbers):
        D, v0, a0, before = (
            ufl.as_vector([numbers[3 * k + i] for i in range(3)]) for k in range(4)
        )
        D = ufl.variable(D)
        a, v1, a1 = rates.values(rule, D, v0, a0, before, numbers[12])
        slopes = [ufl.diff(a[i], D) for i in range(3)]
        slope = [slopes[i][j] for i in range(3) for j in range(3)]
        return ufl.as_vector(
            [*(a[i] for i in range(3)), *slope, *(x[i] for x in (v1, a1) for i in range(3))]
        )

    return point_functions({"rule for the rates": values}, ARGUMENTS)[0]
