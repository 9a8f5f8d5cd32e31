"""Friction that sticks: Coulomb's, as plain data."""

from __future__ import annotations

from dataclasses import dataclass

from fx_beam.validation import as_float, is_number, require


@dataclass(frozen=True)
class Coulomb:
    """Coulomb friction that sticks: at most mu times the normal force, and elastic below.

    Along the surface a spring of the stiffness kt is stretched by z until its force is mu N; then
    the contact slips. In a step in which the material slips by s under the normal force N,
    z1 = clip(z0 + s, -mu N / kt, mu N / kt), and the force kt z1 is against the slip. The spring
    stores kt z^2 / 2. The rest of the work, kt z1 s - kt (z1^2 - z0^2) / 2, is lost; it is never
    negative. When the contact opens the energy of the spring is lost as well.

    On a joint N is the force of the joint in the same step: of a slide the part across its axis, or
    across the beam, and of a pin all of it, which has the moment mu R N on the radius R of the pin.

    A contact that sticks does not creep. While it sticks it is damped by the step, as a spring with
    a viscosity of kt dt / 2.

    Parameters
    ----------
    mu : float
        Coefficient of friction.
    stiffness : float
        Stiffness kt of a node along the surface [N/m], of a beam per length [N/m^2]; of a slide
        [N/m] and of a pin [N m/rad]. Try that of the contact.
    radius : float, optional
        Radius R of a pin [m], for the rotation of a joint.

    Raises
    ------
    SceneError
        For a negative coefficient, or a stiffness that is not positive.

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
        object.__setattr__(self, "mu", mu)
        object.__setattr__(self, "stiffness", stiffness)
