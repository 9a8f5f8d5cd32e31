"""Kinematics of the planar Reissner beam in UFL: directors, strains, the fields of one step.

Notation of Ibrahimbegovic & Mamouri (1999): position phi = X + u, section rotation psi from the
reference configuration, ' = d/ds along the reference arc length, t0 = X'.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from fx_beam.symbolic import Expr, ufl

# Length of an instant, relative to the step in it.
_INSTANT = 2.0**-40


def perp(a):
    """W a with W = [[0, -1], [1, 0]]: a rotated by 90 degrees anticlockwise (eq. 5)."""
    return ufl.as_vector((-a[1], a[0]))


def tan(x):
    """Tangent as sin/cos; UFL's derivative of ufl.tan has one more cosine, which costs time."""
    return ufl.sin(x) / ufl.cos(x)


def director(psi, t0):
    """Unit normal of the rotated section, t = R(psi) t0 (eq. 3)."""
    return ufl.cos(psi) * t0 + ufl.sin(psi) * perp(t0)


def turn_of(t, angle):
    """R(angle) t - t, exact for small angles, too; schemes need functions of angle/2 anyway."""
    s, c = ufl.sin(angle / 2), ufl.cos(angle / 2)
    return 2 * s * (c * perp(t) - s * t)


def strains(du, t, turn, dpsi):
    """Axial strain E.t, shear strain E.(W t) and curvature psi', with E = phi' - t (eqs 9, 10, 12).

    They equal the components of the material strain R^T phi' - t0 in the reference frame. With
    u' and the `turn` t - t0 of the director, strains far below 1 have all their digits.
    """
    E = du - turn
    return ufl.dot(E, t), ufl.dot(E, perp(t)), dpsi


def elastic(strains, natural):
    """Strains less the natural ones (3,), None for none."""
    if natural is None:
        return strains
    return tuple(strain - natural[i] for i, strain in enumerate(strains))


def differences(a, b):
    """The differences b - a of several strains."""
    return [end - start for start, end in zip(a, b, strict=True)]


@dataclass(frozen=True)
class StepFields:
    """The fields from which all else of a `Step` follows, in its order."""

    u0: Expr
    psi0: Expr
    Du: Expr
    Dpsi: Expr
    u: Expr
    psi: Expr
    v: Expr
    omega: Expr
    virtual_u: Expr
    virtual_psi: Expr
    X: Expr
    t0: Expr
    h: Expr
    degree: int
    t: Expr
    dt: Expr
    load_factor: Expr = 1.0
    nodes: Any = None
    u_before: Expr = None
    psi_before: Expr = None
    memory: Expr = None
    natural0: Expr = None
    natural1: Expr = None
    own_strains: Any = None


@dataclass(frozen=True)
class Step(StepFields):
    """The fields of one time step, as UFL expressions on the mesh.

    Parameters
    ----------
    u0, psi0 : ufl expression
        Displacement (2,) [m] and rotation [rad] at the start of the step.
    Du, Dpsi : ufl expression
        Increments of displacement [m] and rotation [rad] over the step, the unknowns.
    u, psi : ufl expression
        Displacement and rotation at the scheme's level in the step, where the forces are evaluated
        (the middle of the step for the mid-point schemes).
    v, omega : ufl expression
        Velocity (2,) [m/s] and spin [rad/s] at the level of the scheme.
    virtual_u, virtual_psi : ufl expression
        Virtual displacement (2,) and virtual rotation.
    X : ufl vector (2,)
        Reference position [m].
    t0 : ufl vector (2,)
        Reference tangent.
    h : ufl scalar
        Element length [m].
    degree : int
        Polynomial degree of the element.
    t, dt : ufl scalar
        Time at the level of the scheme, and length of the step [s]. In statics `t` is the time at
        which functions of time are evaluated, and `dt` has no meaning.
    load_factor : ufl scalar
        Load factor in statics, 1 in dynamics. Multiply a force of your own by it if the force is a
        load, not a spring.
    nodes : Nodes, optional
        Rotations at the nodes of the element, with degree 2 and 3, for schemes that conserve
        energy.
    u_before, psi_before : ufl expression
        Displacement (2,) [m] and rotation [rad] at the start of the step before.
    memory : ufl scalar
        Length of the step divided by that of the step before, at most 1; 0 in the first step.
    natural0, natural1 : ufl vector (3,), optional
        Natural strains (axial, shear, curvature) at the start and at the end of the step; None if
        the scene has no natural strains.
    own_strains : callable, optional
        The ``strains`` of the `Scheme`, if given there.

    Examples
    --------
    A user's force and a user's resultants are functions of the step. An elastic foundation of
    100 N/m per metre, and a wind load that oscillates in time:

    >>> import ufl, fx_beam as fb
    >>> def foundation(step):
    ...     return -100.0 * ufl.dot(step.u, step.virtual_u)
    >>> def wind(step):
    ...     return step.load_factor * ufl.sin(3.0 * step.t) * step.virtual_u[0]
    >>> scene = fb.Scene()
    >>> work = scene.add_virtual_work(foundation)
    >>> work = scene.add_virtual_work(wind)
    """

    def prime(self, field):
        """Derivative of a field along the reference arc length.

        Parameters
        ----------
        field : ufl expression
            Scalar or vector.

        Returns
        -------
        ufl expression
            Its derivative, of the same shape [1/m].
        """
        return arc_derivative(field, self.t0)

    @property
    def at_its_end(self) -> Step:
        """A step from where this one ends, at its rates v and omega, which are zero in statics."""
        ends = {"u0": self.u, "psi0": self.psi, "u_before": self.u, "psi_before": self.psi}
        moved = {"Du": self.dt * self.v, "Dpsi": self.dt * self.omega, "natural0": self.natural1}
        return replace(self, **ends, **moved)

    @property
    def in_an_instant(self) -> Step:
        """A step from the level of this one, at the same rates, in which next to nothing moves."""
        short = {name: _INSTANT * getattr(self, name) for name in ("Du", "Dpsi", "dt")}
        return replace(self.at_its_end, natural0=self.natural0, **short)

    @property
    def strains0(self):
        """Strains (eps, gamma, kappa) at the start of the step, less the natural strains."""
        return elastic(self.total_strains0, self.natural0)

    @property
    def strains1(self):
        """Strains (eps, gamma, kappa) at the end of the step, less the natural strains."""
        return elastic(self.total_strains1, self.natural1)

    @property
    def strain_increments(self):
        """Increments of `strains0` over the step."""
        return differences(self.strains0, self.strains1)

    @property
    def total_strains0(self):
        """Strains (eps, gamma, kappa) at the start of the step, natural strains included."""
        return self._strains(self.u0, self.psi0, self._turn0)

    @property
    def total_strains1(self):
        """Strains (eps, gamma, kappa) at the end of the step, natural strains included."""
        return self._strains(self.u0 + self.Du, self.psi0 + self.Dpsi, self._turn1)

    @property
    def natural_increments(self):
        """Increments of the natural strains over the step; zero without natural strains."""
        if self.natural0 is None:
            return [0.0, 0.0, 0.0]
        return [self.natural1[i] - self.natural0[i] for i in range(3)]

    @property
    def strains_before(self):
        """Strains (eps, gamma, kappa) at the start of the step before, natural strains included."""
        turn = turn_of(self.t0, self.psi_before)
        return self._strains(self.u_before, self.psi_before, turn)

    def _strains(self, u, psi, turn):
        if self.own_strains is not None:
            return self.own_strains(self, u, psi)
        return strains(self.prime(u), self.t0 + turn, turn, self.prime(psi))

    @property
    def _turn0(self):
        """Turn R(psi0) t0 - t0 of the director from the reference to the start of the step."""
        return turn_of(self.t0, self.psi0)

    @property
    def _turn1(self):
        """Turn R(psi1) t0 - t0 of the director from the reference to the end of the step."""
        return self._turn0 + turn_of(self.director0, self.Dpsi)

    @property
    def director0(self):
        """Unit normal of the section at the start of the step."""
        return self.t0 + self._turn0

    @property
    def director1(self):
        """Unit normal of the section at the end of the step."""
        return self.t0 + self._turn1

    @property
    def director(self):
        """Unit normal R(psi) t0 of the section at the scheme's level."""
        return director(self.psi, self.t0)


def arc_derivative(field, t0):
    """Derivative along the reference arc length, (grad f) t0."""
    return ufl.dot(ufl.grad(field), t0)


def virtual_work(step: Step, dphi, n, m):
    """Internal virtual work per length, (virtual u' - virtual psi W phi').n + virtual psi' m.

    Eqs 15 to 17, with the spatial stress resultant n [N] and the couple m [N m].
    """
    turning = step.prime(step.virtual_psi) * m - step.virtual_psi * ufl.dot(perp(dphi), n)
    return ufl.dot(step.prime(step.virtual_u), n) + turning
