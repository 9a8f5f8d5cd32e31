"""Kinematics of the planar Reissner beam in UFL: directors, strains, the fields of one step.

Notation of Ibrahimbegovic & Mamouri (1999): position phi = X + u, section rotation psi measured
from the reference configuration, ' = d/ds along the reference arc length, t0 = X'.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import ufl


def perp(a):
    """Quarter turn to the left, W a with W = [[0, -1], [1, 0]] (eq. 5)."""
    return ufl.as_vector((-a[1], a[0]))


def tan(x):
    """Tangent as sin/cos: of ufl.tan UFL derives one more cosine, which costs time in each step."""
    return ufl.sin(x) / ufl.cos(x)


def director(psi, t0):
    """Unit normal of the turned section, t = R(psi) t0 (eq. 3)."""
    return ufl.cos(psi) * t0 + ufl.sin(psi) * perp(t0)


def strains(dphi, psi, dpsi, t0):
    """Axial strain, shear strain and curvature (eqs 9, 10 and 12).

    Parameters
    ----------
    dphi : ufl vector (2,)
        Derivative phi' of the position.
    psi : ufl scalar
        Section rotation [rad].
    dpsi : ufl scalar
        Derivative psi' of the rotation [1/m].
    t0 : ufl vector (2,)
        Reference tangent.

    Returns
    -------
    tuple of ufl scalars
        eps = E.t, gamma = E.(W t) and kappa = psi': the components of the spatial strain
        E = phi' - t in the turned frame, which equal those of the material strain
        R^T phi' - t0 in the reference frame.
    """
    t = director(psi, t0)
    E = dphi - t
    return ufl.dot(E, t), ufl.dot(E, perp(t)), dpsi


@dataclass(frozen=True)
class Step:
    """The fields of one time step, as UFL expressions on the mesh.

    Parameters
    ----------
    u0, psi0 : ufl expression
        Displacement (2,) [m] and rotation [rad] at the start of the step.
    Du, Dpsi : ufl expression
        Their increments over the step, the unknowns.
    Dtheta : ufl expression
        Increment on which moments do the step's work; for the mid-point schemes the nodal values
        of 2 tan(Dpsi/2), interpolated (eq. 33).
    u, psi : ufl expression
        Displacement and rotation at the level at which the scheme takes the forces (the middle
        of the step for the mid-point schemes).
    v, omega : ufl expression
        Velocity (2,) [m/s] and spin [rad/s] at that level.
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
        Time at that level and length of the step [s]; in statics the time at which functions of
        time are taken, and zero.
    load_factor : ufl scalar
        Part of the loads that acts: 1, but in statics. A force of your own that is a load and not
        a spring is to be multiplied by it.
    """

    u0: Any
    psi0: Any
    Du: Any
    Dpsi: Any
    Dtheta: Any
    u: Any
    psi: Any
    v: Any
    omega: Any
    virtual_u: Any
    virtual_psi: Any
    X: Any
    t0: Any
    h: Any
    degree: int
    t: Any
    dt: Any
    load_factor: Any = 1.0

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
    def strains0(self):
        """Strains (eps, gamma, kappa) at the start of the step."""
        return self._strains(self.u0, self.psi0)

    @property
    def strains1(self):
        """Strains (eps, gamma, kappa) at the end of the step."""
        return self._strains(self.u0 + self.Du, self.psi0 + self.Dpsi)

    def _strains(self, u, psi):
        return strains(self.t0 + self.prime(u), psi, self.prime(psi), self.t0)

    @property
    def director(self):
        """Unit normal R(psi) t0 of the section at the scheme's level."""
        return director(self.psi, self.t0)


def arc_derivative(field, t0):
    """Derivative along the reference arc length, (grad f) t0."""
    return ufl.dot(ufl.grad(field), t0)


def virtual_work(step: Step, dphi, n, m):
    """Internal virtual work per length (eqs 15 to 17).

    Parameters
    ----------
    step : Step
        Fields of the step, of which the virtual ones are used.
    dphi : ufl vector (2,)
        The phi' with which the virtual strains are formed.
    n : ufl vector (2,)
        Spatial stress resultant [N].
    m : ufl scalar
        Couple [N m].

    Returns
    -------
    ufl scalar
        (virtual u' - virtual psi W phi').n + virtual psi' m.
    """
    strain = step.prime(step.virtual_u) - step.virtual_psi * perp(dphi)
    return ufl.dot(strain, n) + step.prime(step.virtual_psi) * m
