"""Nodal rules: velocities and accelerations from the increment over a step."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import ufl

import numpy as np

from fx_beam.validation import as_float, is_number, require

# With less, the acceleration overflows.
_LEAST_BETA = 1e-9


class UpdateRule(Protocol):
    """Nodal rule: velocities and accelerations from the increment over a step.

    Arrays contain all degrees of freedom, (size,); `turns` lists the rotations among them.
    """

    #: Whether the problem is static, without inertia.
    at_rest: ClassVar[bool] = False
    #: Whether rates at the end follow from their means over the step, as by the mid-point rule.
    by_mean: ClassVar[bool] = False
    #: Whether functions of a user give the rates of a node.
    of_user: ClassVar[bool] = False
    #: Whether derivatives of whole motions follow its steps.
    has_derivatives: ClassVar[bool] = False

    @property
    def constants(self) -> dict[str, float]:
        """Members of ``Problem`` in c/problem.h: the rule of rates (0: mean, 1: Newmark's)."""

    @property
    def level(self) -> float:
        """Level of the step at which forces are evaluated: 0 is its start, 1 its end."""

    def work_increment(self, D: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Increment with which forces do work in the step.

        Parameters
        ----------
        D : (size,) float
            Increment of displacements [m] and rotations [rad].
        turns : int array
            Degrees of freedom that are rotations.

        Returns
        -------
        tuple of (size,) float arrays
            The increment, entry by entry a function of `D`, and its derivative.
        """

    def slope_derivative(self, Dpsi: np.ndarray) -> np.ndarray:
        """Second derivative of the work increment of rotations, for the tangent of joints.

        Parameters
        ----------
        Dpsi : (n,) float
            Increments of rotations [rad].

        Returns
        -------
        (n,) float
            d2(work increment)/dDpsi2.
        """

    def acceleration(
        self, D: np.ndarray, v0: np.ndarray, a0: np.ndarray, dt: float, turns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Acceleration in the equation of motion.

        Parameters
        ----------
        D : (size,) float
            Increment of displacements [m] and rotations [rad].
        v0, a0 : (size,) float
            Rates and accelerations at the start of the step.
        dt : float
            Length of the step [s].
        turns : int array
            Degrees of freedom that are rotations.

        Returns
        -------
        tuple of (size,) float arrays
            The acceleration, entry by entry a function of `D`, and its derivative.
        """

    def end(
        self, D: np.ndarray, v0: np.ndarray, a0: np.ndarray, dt: float, turns: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Rates and accelerations at the end of the step.

        Parameters
        ----------
        D : (size,) float
            Increment of displacements [m] and rotations [rad].
        v0, a0 : (size,) float
            Rates and accelerations at the start of the step.
        dt : float
            Length of the step [s].
        turns : int array
            Degrees of freedom that are rotations.

        Returns
        -------
        tuple of (size,) float arrays
            Rates and accelerations.
        """

    def fields(self, Du, Dpsi, v0, a0, dt) -> tuple[Any, Any]:
        """Velocity and spin at the scheme's level, in UFL.

        Parameters
        ----------
        Du, Dpsi : ufl expression
            Increments of displacement (2,) and rotation.
        v0, a0 : pair of ufl expressions
            Rates and accelerations of displacement and rotation at the start of the step.
        dt : ufl scalar
            Length of the step [s].

        Returns
        -------
        tuple of ufl expressions
            Velocity (2,) [m/s] and spin [rad/s].
        """


@dataclass(frozen=True)
class MidPointRates(UpdateRule):
    """Mid-point rule for displacements and for the rotation matrix (eqs 27 to 30).

    Examples
    --------
    From rest, one degree of freedom moves by 0.2 m in 0.1 s.

    >>> import numpy as np, fx_beam as fb
    >>> zero, rotations = np.zeros(1), np.empty(0, dtype=int)
    >>> v, a = fb.MidPointRates().end(np.array([0.2]), zero, zero, 0.1, rotations)
    >>> v.round(6), a.round(6)
    (array([4.]), array([40.]))
    """

    by_mean: ClassVar[bool] = True
    has_derivatives: ClassVar[bool] = True

    @property
    def constants(self) -> dict[str, float]:
        """The mean rule has none."""
        return {"rule": 0}

    @property
    def level(self) -> float:
        """The middle of the step."""
        return 0.5

    def work_increment(self, D, turns):
        """Displacement increment and Dtheta = 2 tan(Dpsi/2) (eqs 32 and 33)."""
        work, slope = D.copy(), np.ones(len(D))
        tangent = np.tan(D[turns] / 2)
        work[turns] = 2 * tangent
        slope[turns] = 1 + tangent**2
        return work, slope

    def slope_derivative(self, Dpsi):
        """Second derivative of 2 tan(Dpsi/2): tan(Dpsi/2) (1 + tan^2(Dpsi/2))."""
        tangent = np.tan(Dpsi / 2)
        return tangent * (1 + tangent**2)

    def acceleration(self, D, v0, a0, dt, turns):
        """a = (v1 - v0)/dt, alpha = (omega1 - omega0)/dt (eq. 30)."""
        work, slope = self.work_increment(D, turns)
        return (2 / dt) * (work / dt - v0), (2 / dt**2) * slope

    def end(self, D, v0, a0, dt, turns):
        """v1 = 2 Du/dt - v0, omega1 = 4 tan(Dpsi/2)/dt - omega0 (eqs 27 and 28)."""
        v1 = (2 / dt) * self.work_increment(D, turns)[0] - v0
        return v1, (v1 - v0) / dt

    def fields(self, Du, Dpsi, v0, a0, dt):
        """Mean velocity Du/dt and mean spin 2 tan(Dpsi/2)/dt."""
        return Du / dt, 2 * ufl.tan(Dpsi / 2) / dt


@dataclass(frozen=True)
class NewmarkRates(UpdateRule):
    """Newmark's formulas with the weights of the generalized-alpha method.

    Inertia is evaluated at level 1 - alpha_m of the step, forces at level 1 - alpha_f.

    Parameters
    ----------
    beta, gamma : float
        Newmark's parameters.
    alpha_m, alpha_f : float
        Weights of the start of the step, for inertia and for forces.

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.NewmarkRates(beta=0.25, gamma=0.5, alpha_f=0.1).level
    0.9
    """

    beta: float
    gamma: float
    alpha_m: float = 0.0
    alpha_f: float = 0.0

    @property
    def constants(self) -> dict[str, float]:
        """Newmark's parameters, and the weight of inertia."""
        return {"rule": 1, "beta": self.beta, "gamma": self.gamma, "alpha_m": self.alpha_m}

    def __post_init__(self):
        for name, low, high in (
            ("beta", _LEAST_BETA, math.inf),
            ("gamma", -math.inf, math.inf),
            ("alpha_m", -math.inf, 1),
            ("alpha_f", -math.inf, 1),
        ):
            value = getattr(self, name)
            fits = is_number(value) and low < as_float(value) < high
            wanted = f"a number between {low} and {high}"
            require(fits, f"NewmarkRates: {name}", value, wanted)
            object.__setattr__(self, name, as_float(value))

    @property
    def level(self) -> float:
        """Level of the forces, 1 - alpha_f."""
        return 1 - self.alpha_f

    def work_increment(self, D, turns):
        """The increment itself."""
        return D, np.ones(len(D))

    def slope_derivative(self, Dpsi):
        """Zero: the work increment is linear."""
        return np.zeros_like(Dpsi)

    def acceleration(self, D, v0, a0, dt, turns):
        """Acceleration at level 1 - alpha_m."""
        a1 = self._end_acceleration(D, v0, a0, dt)
        slope = np.full_like(D, (1 - self.alpha_m) / (self.beta * dt**2))
        return (1 - self.alpha_m) * a1 + self.alpha_m * a0, slope

    def end(self, D, v0, a0, dt, turns):
        """Newmark's velocity and acceleration."""
        a1 = self._end_acceleration(D, v0, a0, dt)
        return v0 + dt * ((1 - self.gamma) * a0 + self.gamma * a1), a1

    def fields(self, Du, Dpsi, v0, a0, dt):
        """Velocity and spin at level 1 - alpha_f."""
        D = (Du, Dpsi)
        ends = [self.end(D[i], v0[i], a0[i], dt, None)[0] for i in (0, 1)]
        return tuple(self.level * v1 + (1 - self.level) * v for v1, v in zip(ends, v0, strict=True))

    def _end_acceleration(self, D, v0, a0, dt):
        return (D - dt * v0) / (self.beta * dt**2) - (1 / (2 * self.beta) - 1) * a0


@dataclass(frozen=True)
class AtRest(UpdateRule):
    """No rates and no inertia: the forces are in equilibrium at the end of each step.

    Examples
    --------
    >>> import fx_beam as fb
    >>> fb.AtRest().at_rest, fb.AtRest().level
    (True, 1.0)
    """

    at_rest: ClassVar[bool] = True
    has_derivatives: ClassVar[bool] = True

    @property
    def constants(self) -> dict[str, float]:
        """Those of a rule whose increments do work as they are; there is no mass."""
        return {"rule": 1, "beta": 1.0}

    @property
    def level(self) -> float:
        """The end of the step."""
        return 1.0

    def work_increment(self, D, turns):
        """The increment itself."""
        return D, np.ones(len(D))

    def slope_derivative(self, Dpsi):
        """Zero: the work increment is linear."""
        return np.zeros_like(Dpsi)

    def acceleration(self, D, v0, a0, dt, turns):
        """Zero."""
        return np.zeros_like(D), np.zeros_like(D)

    def end(self, D, v0, a0, dt, turns):
        """Rates and accelerations of the start, which are zero."""
        return v0, a0

    def fields(self, Du, Dpsi, v0, a0, dt):
        """Rates of the start, which are zero."""
        return v0
