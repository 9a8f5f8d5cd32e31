"""Two schemes of the literature with nodal rules in UFL, beside those of the package.

    .venv/bin/python benchmarks/own_rates.py

Armero & Romero (2001, doi 10.1016/S0045-7825(01)00233-X) also damp the velocities: with the mean
velocity v_m of a node,

    Du/dt = v_m (1 + chi (|v1| - |v0|) / (|v1| + |v0|)).

This couples the components at a node. Bathe & Baig (2005, doi 10.1016/j.compstruc.2005.08.001)
divide a step into two halves, the trapezoidal rule and the backward difference of second order.

Printed are the energy that one oscillator loses in a step, by the angular frequency w times the
step, and for the pinned beam the energy that is left after 10 s, the largest gain of energy and
drift of the angular momentum, and the time of a step.
"""

import ufl

import numpy as np
from oscillator import vibration

import fx_beam as fb
from fx_beam.laws.resultants import averaged, with_exact_work

W_DT = 0.1, 1.0, 10.0, 100.0, 1000.0
STEPS = 20
SMALL = 1e-30  # [m^2/s^2], for nodes at rest


def armero_romero(chi_stress=0.1, chi_velocity=0.1):
    """Decaying resultants of first order, and the same for the velocities of nodes."""

    def rule(D, v0, a0, before, dt):
        path = ufl.as_vector((D[0], D[1]))
        old = ufl.as_vector((v0[0], v0[1]))
        n0 = ufl.sqrt(ufl.dot(old, old) + SMALL)
        # v_m = s Du/dt. Newton's method for s: s (1 + chi (n1 - n0) / (n1 + n0)) = 1.
        s = ufl.as_ufl(1.0)
        for _ in range(3):
            x = ufl.variable(s)
            new = 2 * x / dt * path - old
            n1 = ufl.sqrt(ufl.dot(new, new) + SMALL)
            missing = x * (1 + chi_velocity * (n1 - n0) / (n1 + n0)) - 1
            s = x - missing / ufl.diff(missing, x)
        new = 2 * s / dt * path - old
        v1 = ufl.as_vector((new[0], new[1], 4 * ufl.tan(D[2] / 2) / dt - v0[2]))
        a = (v1 - v0) / dt
        return a, v1, a

    def resultants(step, law):
        mean = averaged(step, law)
        N, Q, M = law.linear([chi_stress / 2 * dE for dE in step.strain_increments])
        total = mean._replace(N=mean.N + N, Q=mean.Q + Q, M=mean.M + M)
        return with_exact_work(step, total)

    return fb.Scheme("Armero & Romero", resultants, fb.NodalRates(rule))


def midpoint():
    """`EnergyMomentum` with its own rule for the rates written out, to see what this costs."""

    def rule(D, v0, a0, before, dt):
        path = ufl.as_vector((D[0], D[1], 2 * ufl.tan(D[2] / 2)))
        v1 = 2 / dt * path - v0
        a = (v1 - v0) / dt
        return a, v1, a

    return fb.Scheme("written out", fb.EnergyMomentum().resultants, fb.NodalRates(rule))


def bathe():
    """Trapezoidal rule in the first half of a step, backward difference in the second."""

    def trapezoidal(D, v0, a0, before, dt):
        a1 = 4 / dt**2 * (D - dt * v0) - a0
        return a1, v0 + dt / 2 * (a0 + a1), a1

    def backward(D, v0, a0, before, dt):
        earlier = 2 / dt * before - v0  # the velocity at the start of the first half
        v1 = (3 * D - before) / (2 * dt)
        a1 = (3 * v1 - 4 * v0 + earlier) / (2 * dt)
        return a1, v1, a1

    rates = fb.NodalRates((trapezoidal, backward), level=1.0)
    return fb.Scheme("Bathe", fb.Newmark().resultants, rates, fractions=(0.5, 0.5))


SCHEMES = {
    "EnergyMomentum": fb.EnergyMomentum(),
    "EnergyMomentum, written out": midpoint(),
    "EnergyDecaying, 0.1": fb.EnergyDecaying(),
    "EnergyDecaying, 0.1, order 1": fb.EnergyDecaying(order=1),
    **{
        f"Armero & Romero, {chi}": armero_romero(*chi)
        for chi in ((0.1, 0.0), (0.0, 0.1), (0.1, 0.1), (0.1, 0.5))
    },
    "Bathe": bathe(),
    "HHT, -0.1": fb.HHT(-0.1),
}


def oscillator_loss(scheme, w):
    """Relative loss of energy in a step of 1 s of a unit mass on a rod of stiffness w^2."""
    solution, _ = vibration(scheme, w, STEPS)
    total = solution.energy.total
    return 1 - (total[-1] / total[0]) ** (1 / STEPS)


def pinned_beam(scheme, dt=0.01, t_end=10.0):
    """Energy left, relative drift of the angular momentum, and time of a step [us]."""
    scene = fb.Scene()
    section = fb.Section(EA=1e4, GA=1e4, EI=10.0, rhoA=1.0, rhoI=0.01)
    beam = scene.add_beam([(0, 0), (1, 0)], section, elements=8)
    scene.pin(beam.start)
    scene.set_velocity(beam, lambda x, y: (0.0, 10 * x + 5 * x * x), spin=lambda x, y: 10 + 10 * x)
    try:
        solution = fb.simulate(scene, scheme, dt=dt, t_end=t_end)
    except fb.StepError as error:
        return f"fails at {error.time:.2f} s"
    momentum, stats = solution.angular_momentum, solution.stats
    total = solution.energy.total / solution.energy.total[0]
    drift = abs(momentum / momentum[0] - 1).max()
    time = 1e6 * stats.seconds / stats.steps
    return f"{total[-1]:11.4f} {total.max() - 1:9.1e} {drift:9.1e} {time:8.1f}"


def main():
    print(f"{'loss in a step for w dt =':30}", *(f"{w:9g}" for w in W_DT), end="   ")
    print("energy left      gain     drift  us/step")
    for name, scheme in SCHEMES.items():
        losses = [oscillator_loss(scheme, w) for w in W_DT]
        print(f"{name:30}", *(f"{loss:9.1e}" for loss in np.abs(losses)), "  ", pinned_beam(scheme))


if __name__ == "__main__":
    main()
