"""The derivative of an implicit function, forwards and backwards."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

#: Gives solutions (n, free) of systems with right sides (n, free).
Solve = Callable[[np.ndarray], np.ndarray]


class ImplicitFunction(NamedTuple):
    """A state y(x) with r(y, x) = 0: dy/dx = -K^-1 r_x, with the Jacobian K = r_y.

    Each part may be left out if only one way is taken.
    """

    #: Solutions with K, and changes (m, free) of r with x.
    solve: Solve | None = None
    residual_changes: Callable[[], np.ndarray] | None = None
    #: Solutions with the transposed K, and derivatives (m,) by x of weights (free,) times r.
    solve_transposed: Solve | None = None
    residual_slopes: Callable[[np.ndarray], np.ndarray] | None = None

    def jvp(self) -> np.ndarray:
        """Changes (m, free) of y with x."""
        assert self.solve is not None and self.residual_changes is not None
        return -self.solve(self.residual_changes())

    def vjp(self, state_gradient: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives (m,) by x from a `state_gradient` (free,), and weights (free,) of r."""
        assert self.solve_transposed is not None and self.residual_slopes is not None
        weights = self.solve_transposed(state_gradient[None])[0]
        return -self.residual_slopes(weights), weights
