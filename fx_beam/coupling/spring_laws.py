"""Laws of springs with a stored energy, compiled: force over a step, and internal variables."""

from __future__ import annotations

from typing import Any

import ufl

import numpy as np

from fx_beam.errors import SceneError
from fx_beam.fem import dolfinx_api
from fx_beam.fem.point_functions import PointFunction
from fx_beam.mechanics.evolution import evolution_loss, evolved
from fx_beam.mechanics.rates import UpdateRule
from fx_beam.scene.internal_variables import InternalVariables
from fx_beam.scene.law import Energy, is_quadratic, switches

# Shortest path, relative to the coordinates, over which the force is the quotient of energy and
# path. On a shorter one round-off of the energy exceeds the error of the force in its middle.
_SHORT = 6e-6


class SpringLaw:
    """A spring's force over a step as a C function, for the steps in Python and in C.

    Given are the coordinates at the start and the end, the length of the step, and the internal
    variables at the start; found are force, slope, loss, energy at the start, and new variables.
    """

    def __init__(self, energy: Energy, internal: InternalVariables | None, rates: UpdateRule):
        #: Number of internal variables.
        self.variables = len(internal.names) if internal else 0
        self._energy, self._internal, self._rates = energy, internal, rates
        self._function = PointFunction(self._expressions, 3 + self.variables, "law of a spring")
        #: Address of the function.
        self.address = self._function.address
        #: Number of conditions in the energy, and address of the function with their values.
        self.conditions, self.switch_address = 0, 0
        if not self.variables:
            at = ufl.Constant(dolfinx_api.domain(1), shape=(1,))
            self.conditions = len(switches(energy(at[0])))
        if self.conditions:
            self._switch = PointFunction(
                lambda given: ufl.as_vector(switches(energy(given[0]))), 1, "switches of a spring"
            )
            self.switch_address = self._switch.address
        found = self(np.zeros(3 + self.variables))
        if not np.isfinite(found).all():
            raise SceneError(
                f"Spring: at its rest the force is {found[0]:g}, its derivative {found[1]:g} and "
                f"the internal variables {found[4:].tolist()}; they must be finite. Write "
                "ufl.sqrt(x**2 + 1e-12) for abs(x), for example"
            )

    def _expressions(self, given):
        energy, internal, rates = self._energy, self._internal, self._rates
        x0, x1 = given[0], ufl.variable(given[1])
        old = new = ufl.as_vector([given[3 + i] for i in range(self.variables)] or [0.0])
        loss: Any = 0.0
        if internal:
            new = evolved(internal, old, (x0,), (x1,), given[2], rates.at_rest)
            loss = evolution_loss(energy, old, new, (x0,), (x1,), rates.at_rest)
        if rates.level == 0.5:
            force = self._discrete_gradient(x0, x1, (old + new) / 2)
        else:
            ends = self._force(x0, old), self._force(x1, new)
            force = (1 - rates.level) * ends[0] + rates.level * ends[1]
        parts = force, ufl.diff(force, x1), loss, self._stored(x0, old)
        return ufl.as_vector((*parts, *(new[i] for i in range(self.variables))))

    def _stored(self, x, a):
        return self._energy(x, a) if self.variables else self._energy(x)

    def _force(self, x, a):
        x = ufl.variable(x)
        return ufl.diff(self._stored(x, a), x)

    def _discrete_gradient(self, x0, x1, a):
        """Force whose work over the step is the increment of the energy at the mean variables."""
        middle = self._force((x0 + x1) / 2, a)
        if is_quadratic(lambda x: self._stored(x, a)):
            return middle
        path = x1 - x0
        long_enough = ufl.gt(abs(path), _SHORT * (abs(x0) + abs(x1)))
        gained = self._stored(x1, a) - self._stored(x0, a)
        quotient = gained / ufl.conditional(long_enough, path, 1)
        return ufl.conditional(long_enough, quotient, middle)

    def switches(self, x: float) -> list[float]:
        """Values (conditions,) of the conditions in the energy at a coordinate since its rest."""
        return self._switch(np.array([x])).tolist() if self.conditions else []

    def __call__(self, given: np.ndarray) -> np.ndarray:
        """What is found (4 + variables,), from what is given (3 + variables,)."""
        return self._function(given)
