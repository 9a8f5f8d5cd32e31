"""Friction that sticks: Coulomb's, as plain data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from fx_beam.validation import as_float, is_number, require


@dataclass(frozen=True)
class Coulomb:
    """Coulomb friction that sticks: at most mu times the normal force, and elastic below.

    Along the surface a spring of the stiffness kt is stretched by z, with a damping of its own, the
    time tau. Its force is kt (z + tau dz/dt) while it sticks, as in the LuGre model. If this is
    above mu N the contact slips, with the force mu N, from which dz/dt follows. The spring stores
    kt z^2 / 2. The rest of the work is lost; it is never negative. When the contact opens the
    energy of the spring is lost as well.

    On a joint N is the force of the joint in the same step: of a slide the part across its axis, or
    across the beam, and of a pin all of it, which has the moment mu R N on the radius R of the pin.

    A contact that sticks does not creep. In steps that are longer than 2 tau it is damped by the
    step, as a spring with a viscosity of kt dt / 2.

    Parameters
    ----------
    mu : float
        Coefficient of friction.
    stiffness : float
        Stiffness kt of a node along the surface [N/m], of a beam per length [N/m^2]; of a slide
        [N/m] and of a pin [N m/rad]. Try that of the contact.
    radius : float, optional
        Radius R of a pin [m], for the rotation of a joint.
    damping : float, optional
        Time tau [s]. By default that of critical damping, 2 sqrt(m / kt), with the mass m that the
        spring holds: of the node (the lighter of both) with what joints fix to it, of a slide, or
        the inertia of a rotation; `Stats.friction_damping` has it. With 0 the steps alone damp.

    Raises
    ------
    SceneError
        For a negative coefficient or damping, or a stiffness that is not positive.

    References
    ----------
    Canudas de Wit, Olsson, Astrom, Lischinsky, A new model for control of systems with friction,
    IEEE Trans. Automatic Control 40 (1995) 419-425, doi 10.1109/9.376053

    Examples
    --------
    A block of 2 kg that slides over a floor stops after v^2 / (2 mu g) = 0.1 m.

    >>> import fx_beam as fb
    >>> scene = fb.Scene(gravity=(0, -10))
    >>> block = scene.add_body((0, 0), mass=2.0, inertia=0.1).centre
    >>> scene.fix(block, "rotation")
    >>> floor = fb.Line((0, 0), normal=(0, 1))
    >>> friction = fb.Coulomb(0.5, 1e6)
    >>> contact = scene.add_contact(block, floor, stiffness=1e6, friction=friction)
    >>> scene.set_velocity(block, (1.0, 0.0))
    >>> solution = fb.simulate(scene, dt=1e-3, t_end=0.5)
    >>> round(float(solution.displacement(block)[-1, 0]), 3)
    0.1
    """

    mu: float
    stiffness: float
    radius: float | None = None
    damping: float | None = None

    def __post_init__(self):
        mu, stiffness = as_float(self.mu), as_float(self.stiffness)
        fits = is_number(self.mu) and mu >= 0
        require(fits, "Coulomb: mu", self.mu, "finite and not negative")
        fits = is_number(self.stiffness) and stiffness > 0
        require(fits, "Coulomb: stiffness", self.stiffness, "finite and positive")
        if self.radius is not None:
            fits = is_number(self.radius) and as_float(self.radius) > 0
            require(fits, "Coulomb: radius", self.radius, "finite and positive, or None")
            object.__setattr__(self, "radius", as_float(self.radius))
        if self.damping is not None:
            fits = is_number(self.damping) and as_float(self.damping) >= 0
            require(fits, "Coulomb: damping", self.damping, "finite and not negative, or None")
            object.__setattr__(self, "damping", as_float(self.damping))
        object.__setattr__(self, "mu", mu)
        object.__setattr__(self, "stiffness", stiffness)


def bristle(friction: Coulomb, share: Any, mobility: Any) -> list[Any]:
    """Numbers tau, mu, kt of the law with a share of the stiffness; damping is critical by default.

    The `mobility` is 1 / m, zero for what cannot move; an array for several points.
    """
    mobility, stiffness = np.asarray(mobility, float), friction.stiffness * share
    damping = friction.damping
    if damping is None:
        damping = 2 / np.sqrt(np.where(mobility > 0, stiffness * mobility, np.inf))
    return [damping + 0 * mobility, friction.mu + 0 * mobility, stiffness + 0 * mobility]
