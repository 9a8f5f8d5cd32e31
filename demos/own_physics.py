r"""User-defined physics: a material, forces and a time scheme, each in a few lines of UFL.

A soft arm, pinned at one end, falls from the horizontal under its own weight. Objective: to define
a stored energy, forces and a time scheme that the package does not have, and to check the energy
balance with each of them.

1. Material. The stiffness grows with bending. The stored energy becomes infinite when the arm is
   compressed to zero length. With axial strain $\varepsilon$, shear strain $\gamma$ and curvature
   $\kappa$, the energy per length is

   $$
   W = \frac{EA}{4} ((1 + \varepsilon)^2 - 1 - 2 \ln(1 + \varepsilon))
   + \frac{GA}{2} \gamma^2 + \frac{EI}{2} \kappa^2 \left(1 + \frac{\kappa^2}{k^2}\right).
   $$

   Its initial stiffness is $EA$, $GA$ and $EI$. The energy-momentum scheme takes a discrete
   gradient of $W$ (Gonzalez 1996, doi 10.1007/BF02440162), so that the total energy is constant.

2. Forces. Each force is defined by its virtual work per length:

   - viscous oil below $y = 0$: $-c\,v \cdot \delta u$ for $y < 0$,
   - elastic foundation below $y = -d$: $-k\,(y + d)\,\delta y$ for $y < -d$,
   - jet on the last tenth, along the arm's axis: $q\,t \cdot \delta u$ with $t = R(\psi)\,t_0$.

   The energy is then not constant: its change is the work of these forces.

3. Time scheme. To the averaged stress resultants a part $\chi/2$ of their increments is added,

   $$ N = N_\mathrm{av} + \frac{\chi}{2} (N_1 - N_0), $$

   and likewise for $Q$ and $M$.

   This removes the energy $\frac{\chi}{2} \Delta E \cdot C\,\Delta E$ in every step and does not
   change the momenta. It damps the high frequencies (as in Armero & Romero 2001, doi
   10.1016/S0045-7825(01)00233-X, without their damping of the rates).

Units are metre, kilogram and second.
"""

import logging

import ufl

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

EA, GA, EI = 400.0, 150.0, 0.05  # [N], [N], [N m²]
K_BEND = 5.0  # curvature at which the bending stiffness has doubled, k [1/m]
LENGTH = 1.0  # [m]
GRAVITY = (0.0, -9.81)  # [m/s²]
VISCOSITY = 0.4  # c [N s/m²]
BED_STIFFNESS, BED_DEPTH = 80.0, 0.6  # k [N/m²], d [m]
JET = 2.0  # q [N/m]
DAMPING = 0.2  # chi [-]
DT, T_END = 0.004, 3.0  # [s]


# -- 1. A material -------------------------------------------------------------------------------


def stored_energy(eps, gamma, kappa):
    stretch = EA / 4 * ((1 + eps) ** 2 - 1 - 2 * ufl.ln(1 + eps))
    bending = EI / 2 * kappa**2 * (1 + (kappa / K_BEND) ** 2)
    return stretch + GA / 2 * gamma**2 + bending


def scene():
    """The arm; its last tenth is a separate beam, so that a force can act on that part only."""
    section = fb.Section(strain_energy=stored_energy, rhoA=0.1, rhoI=1e-5)
    arm_scene = fb.Scene(gravity=GRAVITY)
    arm = arm_scene.add_beam([(0, 0), (0.9 * LENGTH, 0)], section, elements=18, name="arm")
    nozzle = arm_scene.add_beam([arm.end, (LENGTH, 0)], section, elements=2, name="nozzle")
    arm_scene.pin(arm.start)
    return arm_scene, arm, nozzle


# -- 2. Forces -----------------------------------------------------------------------------------


def oil(step):
    below = ufl.lt(step.X[1] + step.u[1], 0)
    return ufl.conditional(below, -VISCOSITY * ufl.dot(step.v, step.virtual_u), 0)


def bed(step):
    depth = step.X[1] + step.u[1] + BED_DEPTH
    return -BED_STIFFNESS * ufl.min_value(depth, 0) * step.virtual_u[1]


def jet(step):
    return JET * ufl.dot(step.director, step.virtual_u)


# -- 3. A time scheme ------------------------------------------------------------------------------


def dissipating(chi):
    r"""Scheme that dissipates $\chi/2$ times the work of the increments of the resultants."""

    def resultants(step, law):
        r = fb.EnergyMomentum().resultants(step, law)
        before, after = law.resultants(*step.strains0), law.resultants(*step.strains1)
        N, Q, M = (
            mean + chi / 2 * (b - a)
            for mean, a, b in zip((r.N, r.Q, r.M), before, after, strict=True)
        )
        return r._replace(N=N, Q=Q, M=M, m=M)

    return fb.Scheme("Dissipating", resultants, fb.MidPointRates())


# -- The three runs --------------------------------------------------------------------------------


def compute():
    """The numbers, and what is drawn."""
    alone, _, _ = scene()
    log.info("a stored energy of one's own")
    free = fb.simulate(alone, dt=DT, t_end=T_END)

    loaded, _, nozzle = scene()
    loaded.add_virtual_work(oil)
    loaded.add_virtual_work(bed)
    loaded.add_virtual_work(jet, nozzle)
    log.info("forces of one's own")
    forced = fb.simulate(loaded, dt=DT, t_end=T_END)

    log.info("a scheme of one's own")
    damped = fb.simulate(alone, dissipating(DAMPING), dt=DT, t_end=T_END)

    # The arm falls from rest: energies are compared with the largest kinetic energy.
    scale = free.energy.kinetic.max()
    numbers = {
        "largest kinetic energy": scale,
        "material": {
            "largest strain energy": free.energy.strain.max(),
            "relative energy error": abs(free.energy.balance_error).max() / scale,
        },
        "forces": {
            "work": forced.energy.work[-1],
            "energy gained": forced.energy.total[-1] - forced.energy.total[0],
            "relative balance error": abs(forced.energy.balance_error).max() / scale,
        },
        "scheme": {
            "energy lost": damped.energy.total[0] - damped.energy.total[-1],
            "largest energy gain in a step": np.diff(damped.energy.total).max() / scale,
        },
    }
    return numbers, (free, forced, damped)


def report(numbers):
    material, forces, scheme = numbers["material"], numbers["forces"], numbers["scheme"]
    print(
        f"Largest kinetic energy of the falling arm: {numbers['largest kinetic energy']:.4g} J\n"
        f"Own material: up to {material['largest strain energy']:.3g} J stored; total energy kept "
        f"to {material['relative energy error']:.1e}\n"
        f"Own forces: their work {forces['work']:.6f} J, energy gained "
        f"{forces['energy gained']:.6f} J; balance closes to "
        f"{forces['relative balance error']:.1e}\n"
        f"Own scheme: {scheme['energy lost']:.3g} J dissipated, largest gain in a step "
        f"{scheme['largest energy gain in a step']:.1e}"
    )


def draw(results, free, forced, damped):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(scene()[0], results / "scene.png", dimensions=True)
    thumbnail.card(forced, range(len(forced.t)), results / "thumbnail.png")
    figure, axes = plot.figure(2, 1, height=2.8)
    energy, force = axes.flat
    energy.plot(free.t, free.energy.total, "C0", label="own material")
    energy.plot(forced.t, forced.energy.total, "C1", label="own material and forces")
    expected = forced.energy.total[0] + forced.energy.work
    energy.plot(forced.t[::30], expected[::30], "C1o", fillstyle="none", label="work of the forces")
    energy.plot(damped.t, damped.energy.total, "C2--", label="own material and scheme")
    energy.set(xlabel="time $t$ [s]", ylabel="total energy $E$ [J]", xlim=(0, T_END))
    for solution, line in ((free, "C0"), (damped, "C2--")):
        force.plot(solution.t[1:] - DT / 2, solution.resultants("arm").N[1:, 0], line)
    force.set(xlabel="time $t$ [s]", ylabel="axial force at the pin $N$ [N]", xlim=(0, T_END))
    plot.save(figure, results / "energy.png")

    def around(ax, k):
        return scenery(ax, forced.shape("nozzle")[k])

    plot.animate(forced, results / "motion.gif", rows=range(0, len(forced.t), 6), scenery=around)


def scenery(ax, nozzle):
    """Draw the oil, the foundation and the jet, which are not part of the scene."""
    left, right = ax.get_xlim()
    low, _ = ax.get_ylim()
    oil = ax.axhspan(low, 0, color="#E69F00", alpha=0.15, linewidth=0, zorder=0)
    x = np.linspace(left, right, 121)
    springs = -BED_DEPTH - 0.02 * (1 + np.arange(len(x)) % 2)
    tip, direction = nozzle[-1], nozzle[-1] - nozzle[0]
    look = {"arrowstyle": "-|>", "color": "#D55E00", "linewidth": 2, "shrinkA": 0, "shrinkB": 0}
    jet = ax.annotate("", tip + 1.2 * direction, tip, arrowprops=look, annotation_clip=False)
    return [oil, *ax.plot(x, springs, color="0.6", linewidth=0.8, zorder=0), jet]


if __name__ == "__main__":
    script.run()
