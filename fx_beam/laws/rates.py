"""Nodal rules: velocities and accelerations from the increment over a step, also of users."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np

from fx_beam.errors import SceneError, as_float, between, check_fields, refuse_fields_in, require
from fx_beam.scene.parameters import refused
from fx_beam.symbolic import Expr, parts_of, ufl

# With less, the acceleration overflows.
_LEAST_BETA = 1e-9

Rule = Callable[[Expr, Expr, Expr, Expr, Expr], tuple[Expr, Expr, Expr]]


class UpdateRule(Protocol):
    """Nodal rule: velocities and accelerations from the increment over a step.

    Arrays contain all degrees of freedom, (size,); `turns` lists the rotations among them.
    """

    #: Whether the problem is static, without inertia.
    at_rest: ClassVar[bool] = False
    #: Whether rates at the end follow from their means over the step, as by the mid-point rule.
    mean_based: ClassVar[bool] = False
    #: Whether functions of a user give the rates of a node.
    user_defined: ClassVar[bool] = False
    #: Whether derivatives of whole motions follow its steps.
    has_derivatives: ClassVar[bool] = False

    #: Members of ``Scheme`` in c/tables.h: the rule of rates (0: mean, 1: Newmark's).
    constants: Any
    #: Level of the step at which forces are evaluated: 0 is its start, 1 its end.
    level: Any

    @property
    def turning(self) -> bool:
        """Whether forces do work on 2 tan(Dpsi/2) of rotations, and not on the increment itself."""
        return self.mean_based

    def work_increment(self, D: np.ndarray, turns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Increment with which forces do work in the step.

        Parameters
        ----------
        D : (..., size) float
            Increments of displacements [m] and rotations [rad].
        turns : int array
            Degrees of freedom that are rotations.

        Returns
        -------
        tuple of (..., size) float arrays
            The increments, entry by entry a function of `D`, and its derivative (eqs 32 and 33).
        """
        work, slope = D.copy(), np.ones(D.shape)
        if self.turning:
            tangent = np.tan(D[..., turns] / 2)
            work[..., turns], slope[..., turns] = 2 * tangent, 1 + tangent**2
        return work, slope

    def acceleration(self, path, v0, a0, dt: float) -> tuple[np.ndarray, float]:
        """Acceleration in the equation of motion.

        Parameters
        ----------
        path, v0, a0 : (size,) float
            Increment of `work_increment`, and rates and accelerations at the start of the step.
        dt : float
            Length of the step [s].

        Returns
        -------
        (size,) float array
            The acceleration.
        float
            Derivative of the acceleration by `path`, the same for each entry [1/s^2].
        """
        return np.zeros_like(path), 0.0

    def fields(self, Du, Dpsi, v0, a0, dt) -> tuple[Expr, Expr]:
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

    v1 = 2 Du/dt - v0 and omega1 = 4 tan(Dpsi/2)/dt - omega0 (eqs 27 and 28); the accelerations are
    (v1 - v0)/dt and (omega1 - omega0)/dt (eq. 30).

    Examples
    --------
    A moment does work on 2 tan(Dpsi/2), here of 0.2 rad.

    >>> import numpy as np, fx_beam as fb
    >>> work, slope = fb.MidPointRates().work_increment(np.array([0.2]), np.array([0]))
    >>> work.round(6), slope.round(6)
    (array([0.200669]), array([1.010067]))
    """

    mean_based: ClassVar[bool] = True
    has_derivatives: ClassVar[bool] = True

    constants = {"rule": 0}
    level = 0.5

    def acceleration(self, path, v0, a0, dt):
        """Means over the step (eqs 29 and 30)."""
        return 2 * (path / dt - v0) / dt, 2 / dt**2

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

    beta: float = between(_LEAST_BETA, math.inf)
    gamma: float = between(-math.inf, math.inf)
    alpha_m: float = between(-math.inf, 1, default=0.0)
    alpha_f: float = between(-math.inf, 1, default=0.0)

    @property
    def constants(self) -> dict[str, float]:
        """Newmark's parameters, and the weight of inertia."""
        return {"rule": 1, "beta": self.beta, "gamma": self.gamma, "alpha_m": self.alpha_m}

    def __post_init__(self):
        check_fields(self)

    @property
    def level(self) -> float:
        """Level of the forces, 1 - alpha_f."""
        return 1 - self.alpha_f

    def acceleration(self, path, v0, a0, dt):
        """At level 1 - alpha_m."""
        share = 1 - self.alpha_m
        return share * self._a1(path, v0, a0, dt) + self.alpha_m * a0, share / (self.beta * dt**2)

    def fields(self, Du, Dpsi, v0, a0, dt):
        """Velocity and spin at level 1 - alpha_f."""
        return tuple(
            self.level * self._end_rate(D, v, a, dt) + (1 - self.level) * v
            for D, v, a in zip((Du, Dpsi), v0, a0, strict=True)
        )

    def _a1(self, D, v0, a0, dt):
        return (D - dt * v0) / (self.beta * dt**2) - (1 / (2 * self.beta) - 1) * a0

    def _end_rate(self, D, v0, a0, dt):
        return v0 + dt * ((1 - self.gamma) * a0 + self.gamma * self._a1(D, v0, a0, dt))


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

    #: Constants of a rule whose increments do work as they are; there is no mass.
    constants = {"rule": 1, "beta": 1.0}
    level = 1.0

    def fields(self, Du, Dpsi, v0, a0, dt):
        """Rates of the start, which are zero."""
        return v0


@dataclass(frozen=True)
class NodalRates(UpdateRule):
    """Nodal rule of your own in UFL; it may couple all components.

    All arguments but `dt` are UFL vectors of one node: x, y and rotation.

    Parameters
    ----------
    rule : callable, or tuple of callables
        ``rule(D, v0, a0, before, dt)`` gives the acceleration in the equation of motion, and the
        rates and accelerations at the end of the step, a UFL vector (3,) each. `D` is the increment
        over the step, `v0` and `a0` are rates and accelerations at its start, `before` is the
        increment over the step or sub-step before (zero in the first), `dt` is the length of this
        one [s]. A tuple has a rule for each sub-step of the scheme.
    level : float
        Level l in (0, 1] of the step at which forces are evaluated: 1 is the end of the step. At l
        = 0.5 moments do work on 2 tan(D/2) of rotations, as with `MidPointRates`, at other levels
        on D. Forces that depend on rates use the mean rate at l = 0.5, otherwise v0 + 2 l (D/dt -
        v0), with an error of dt^2.

    Raises
    ------
    SceneError
        For rules that are no functions, that do not give three UFL vectors, that contain nan, inf
        or symbols of your own, or whose acceleration does not depend on the increment; for a level
        outside (0, 1].

    Examples
    --------
    The mid-point rule of the package, written out.

    >>> import ufl, fx_beam as fb
    >>> def midpoint(D, v0, a0, before, dt):
    ...     path = ufl.as_vector((D[0], D[1], 2 * ufl.tan(D[2] / 2)))
    ...     v1 = 2 * path / dt - v0
    ...     a = (v1 - v0) / dt
    ...     return a, v1, a
    >>> scheme = fb.Scheme("own", fb.EnergyMomentum().resultants, fb.NodalRates(midpoint))
    >>> scene = fb.Scene(gravity=(0, -9.81))
    >>> bar = scene.add_beam([(0, 0), (1, 0)], fb.Section(EA=1e6, GA=1e6, EI=1e4, rhoA=1.0))
    >>> scene.pin(bar.start)
    >>> fb.simulate(scene, scheme, dt=0.01, t_end=0.1).stats.solver[:8]
    'compiled'
    """

    rule: Rule | tuple[Rule, ...]
    level: float = 0.5
    user_defined: ClassVar[bool] = True

    def __post_init__(self):
        ok = bool(self.rules) and all(map(callable, self.rules))
        require(ok, "NodalRates: rule", self.rule, "a function of D, v0, a0, before and dt")
        ok = 0 < as_float(self.level) <= 1
        require(ok, "NodalRates: level", self.level, "a number above 0, at most 1")
        object.__setattr__(self, "level", as_float(self.level))
        for rule in self.rules:
            self._check(rule)

    def _check(self, rule: Rule) -> None:
        """Refuse a rule whose acceleration does not depend on the increment, and nan and inf."""
        from fx_beam.scene.ufl_symbols import Symbol

        symbols = [Symbol() for _ in range(13)]
        arguments = [*(ufl.as_vector(symbols[k : k + 3]) for k in range(0, 12, 3)), symbols[-1]]
        values = self.values(rule, *arguments)
        for value in values:
            refuse_fields_in(value, "NodalRates: rule(D, v0, a0, before, dt)", symbols)
        if not set(symbols[:3]) & set(parts_of(values[0])):
            raise SceneError(
                "NodalRates: the acceleration that rule(D, v0, a0, before, dt) gives does not "
                "depend on the increment D: the mass then has no effect. By the mid-point rule it "
                "is 2 (D / dt - v0) / dt, for example"
            )

    @property
    def rules(self) -> tuple[Rule, ...]:
        """The rules of the sub-steps; a single rule holds for all."""
        return self.rule if isinstance(self.rule, tuple) else (self.rule,)

    @property
    def turning(self) -> bool:
        """Whether forces do work on 2 tan(Dpsi/2) of rotations: at level 0.5."""
        return self.level == 0.5

    @property
    def constants(self) -> dict[str, float]:
        """Constants of a rule that has the same work increments."""
        equal_rule = MidPointRates() if self.turning else NewmarkRates(0.25, 0.5)
        return equal_rule.constants

    def values(self, rule: Rule, D, v0, a0, before, dt) -> tuple[Expr, Expr, Expr]:
        """Values of a rule; SceneError if they are not three UFL vectors (3,).

        Parameters
        ----------
        rule : callable
            One of the `rules`.
        D, v0, a0, before : ufl vector (3,)
            Its arguments at one node.
        dt : ufl scalar
            Length of the step [s].

        Returns
        -------
        tuple of ufl vectors (3,)
            Acceleration in the equation of motion, rates and accelerations at the end.
        """
        name = "NodalRates: rule(D, v0, a0, before, dt)"
        with refused(
            f"{name} must give three UFL vectors. Use ufl.as_vector, and functions of ufl in place "
            "of math or NumPy"
        ):
            parts = tuple(rule(D, v0, a0, before, dt))
            shapes = [value.ufl_shape for value in parts]
        if shapes != [(3,)] * 3:
            raise SceneError(
                f"{name} must give three vectors of x, y and rotation: the acceleration, and rates "
                f"and accelerations at the end; it gave {len(parts)} of the shapes {shapes}"
            )
        return parts

    def fields(self, Du, Dpsi, v0, a0, dt):
        """Mean velocity and spin of the step, or at levels other than 0.5 those of the level."""
        if self.turning:
            return MidPointRates().fields(Du, Dpsi, v0, a0, dt)
        pairs = zip((Du, Dpsi), v0, strict=True)
        return tuple(v + 2 * self.level * (D / dt - v) for D, v in pairs)
