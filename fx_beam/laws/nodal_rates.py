"""Nodal rules for the rates, as UFL expressions of one node."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import ufl
from ufl.corealg.traversal import unique_pre_traversal

from fx_beam.errors import SceneError
from fx_beam.scene.symbols import Symbol, not_numbers
from fx_beam.validation import as_float, require

from .rates import MidPointRates, NewmarkRates, UpdateRule

Rule = Callable[[Any, Any, Any, Any, Any], tuple[Any, Any, Any]]


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
        increment over the last step or sub-step (zero in the first), `dt` is the length [s]. A
        tuple has a rule for each sub-step of the scheme.
    level : {0.5, 1.0}
        Level of the step at which forces are evaluated. At 0.5 forces do work on 2 tan(D/2) of
        rotations, as by `MidPointRates`, at 1.0 on D. Forces that depend on rates take the mean
        rate of the step.

    Raises
    ------
    SceneError
        For rules that are no functions, that do not give three UFL vectors, or whose acceleration
        does not depend on the increment; or another level.

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
    of_user: ClassVar[bool] = True

    def __post_init__(self):
        fits = bool(self.rules) and all(map(callable, self.rules))
        require(fits, "NodalRates: rule", self.rule, "a function of D, v0, a0, before and dt")
        fits = as_float(self.level) in (0.5, 1.0)
        require(fits, "NodalRates: level", self.level, "0.5 or 1.0")
        object.__setattr__(self, "level", as_float(self.level))
        for rule in self.rules:
            self._check(rule)

    def _check(self, rule: Rule) -> None:
        """Refuse a rule whose acceleration does not depend on the increment."""
        D, v0, a0, before = (ufl.as_vector([Symbol() for _ in range(3)]) for _ in range(4))
        a, _, _ = self.values(rule, D, v0, a0, before, Symbol())
        if not set(D.ufl_operands) & set(unique_pre_traversal(a)):
            raise SceneError(
                "NodalRates: the acceleration that rule(D, v0, a0, before, dt) gives does not "
                "depend on the increment D: the mass then has no effect. By the mid-point rule it "
                "is 2 (D / dt - v0) / dt, for example"
            )

    @property
    def rules(self) -> tuple[Rule, ...]:
        """The rules of the sub-steps, or the one of all."""
        return self.rule if isinstance(self.rule, tuple) else (self.rule,)

    @property
    def constants(self) -> dict[str, float]:
        """The rule that has the same work increments."""
        return self.of_work.constants

    @property
    def of_work(self) -> MidPointRates | NewmarkRates:
        """The rule that has the same work increments."""
        return MidPointRates() if self.level == 0.5 else NewmarkRates(0.25, 0.5)

    def values(self, rule: Rule, D, v0, a0, before, dt) -> tuple[Any, Any, Any]:
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
        what = "NodalRates: rule(D, v0, a0, before, dt)"
        try:
            with not_numbers():
                parts = tuple(rule(D, v0, a0, before, dt))
            shapes = [value.ufl_shape for value in parts]
        except Exception as error:
            raise SceneError(
                f"{what} must give three UFL vectors. Use ufl.as_vector, and functions of ufl in "
                f"place of math or NumPy. It raised {error!r}"
            ) from error
        if shapes != [(3,)] * 3:
            raise SceneError(
                f"{what} must give three vectors of x, y and rotation: the acceleration, and rates "
                f"and accelerations at the end; it gave {len(parts)} of the shapes {shapes}"
            )
        return parts

    def work_increment(self, D, turns):
        """As by the mid-point rule, or the increment itself at level 1."""
        return self.of_work.work_increment(D, turns)

    def slope_derivative(self, Dpsi):
        """Second derivative of the work increment."""
        return self.of_work.slope_derivative(Dpsi)

    def fields(self, Du, Dpsi, v0, a0, dt):
        """Mean velocity and mean spin of the step."""
        if self.level == 0.5:
            return MidPointRates().fields(Du, Dpsi, v0, a0, dt)
        return Du / dt, Dpsi / dt
