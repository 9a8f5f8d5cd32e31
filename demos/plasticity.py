r"""Plasticity: a bar bent to and fro, a portal frame pushed to its limit, a dropped ring.

Members that yield in bending: the plastic curvature is an internal variable at each Gauss point.
With the elastic bending moment $M = EI (\kappa - a)$, they yield where

- $|M - H a| = M_p$ (kinematic hardening), or
- $|M| = M_p + H b$ (isotropic hardening),

where $b$ is the length of the path of $a$. Objective: internal variables with an explicit return
map, compared with exact solutions and with a limit load computed by hand.

1. A bar is bent uniformly to and fro. The loops of bending moment and curvature are compared with
   the exact ones.

2. A portal frame carries a vertical force $V$ in the middle of its beam, and is then pushed
   sideways and released. All members yield at the same moment $M_p$. By the kinematic theorem (Neal
   1977, The plastic methods of structural analysis), the frame collapses in the mechanism with
   hinges at the foot of the left column (turn $\theta$), in the middle of the beam ($2 \theta$), at
   the right corner ($2 \theta$) and at the right foot ($\theta$), when

   $$ F h + \frac{1}{2} V l = 6 M_p. $$

   Members yield at the moment in the middle of an element: with $n$ elements in a column, the frame
   carries about $1/n$ more. The small hardening adds less than 1 %.

   The same frame is also made of elastic members on plastic hinges: joints at the feet, at the
   corners and in the middle of the beam whose springs yield at $M_p$. Then no mesh error is left.
   The force is 0.3 % below the limit, as the frame leans and its beam sags. If all is ten times as
   stiff, it is 0.03 % below.

3. A ring of soft metal falls on a stiff ground and stays bent.

Units are metre, kilogram and second.
"""

import logging

import ufl

import numpy as np

import fx_beam as fb
from shared import script

log = logging.getLogger("fx_beam.demo")

# 1. The bar
BAR = {"EA": 2e4, "GA": 8e3, "EI": 6.0}  # [N], [N], [N m²]
BAR_YIELD, BAR_HARDENING = 0.3, 1.5  # M_p [N m], H [N m²]
CURVATURES = 0.0, 0.2, -0.2, 0.3, -0.3, 0.0  # corners of the path [1/m]

# 2. The frame
FRAME = {"EA": 6e9, "GA": 2e9, "EI": 2e8}  # stiff, so that displacements stay small
FRAME_YIELD, FRAME_HARDENING = 100e3, 5e3  # [N m], [N m²]
HEIGHT, SPAN = 3.0, 6.0  # h, l [m]
VERTICAL = 100e3  # V [N]
LIMIT = (6 * FRAME_YIELD - VERTICAL * SPAN / 2) / HEIGHT  # F [N]
SWAY = 4e-3  # [m]
ELEMENTS = 20, 40, 80  # in a column
HINGE, HINGE_HARDENING = 1e10, 1e3  # stiffness before they yield, and after, [N m/rad]
STIFFER = 1, 10  # how much stiffer the frame with hinges is

# 3. The ring
RADIUS = 0.5  # [m]
RING = {"EA": 4e5, "GA": 1.6e5, "EI": 4.0, "rhoA": 1.0, "rhoI": 1e-5}
RING_YIELD, RING_HARDENING = 8.0, 0.2  # [N m], [N m²]
SPEED, GRAVITY = 6.0, 9.81  # [m/s], [m/s²]
GROUND = 1e5  # stiffness of the ground [N/m²]
DT, T_END = 5e-4, 0.6  # [s]
SHOWN = 0, 200, 1200  # steps in the picture


def kinematic(EA, GA, EI, moment, hardening, **inertia):
    """Section that yields in bending, with linear kinematic hardening."""

    def energy(eps, gamma, kappa, a):
        elastic = EA / 2 * eps**2 + GA / 2 * gamma**2 + EI / 2 * (kappa - a[0]) ** 2
        return elastic + hardening / 2 * a[0] ** 2

    def flow(old, strains0, strains, dt):
        trial = EI * (strains[2] - old[0]) - hardening * old[0]
        excess = ufl.max_value(abs(trial) - moment, 0)
        return [old[0] + ufl.sign(trial) * excess / (EI + hardening)]

    variables = fb.InternalVariables(("plastic curvature",), flow)
    return fb.Section(strain_energy=energy, internal=variables, **inertia)


def isotropic(EA, GA, EI, moment, hardening, **inertia):
    """Section that yields in bending, with linear isotropic hardening."""

    def energy(eps, gamma, kappa, a):
        elastic = EA / 2 * eps**2 + GA / 2 * gamma**2 + EI / 2 * (kappa - a[0]) ** 2
        return elastic + hardening / 2 * a[1] ** 2

    def flow(old, strains0, strains, dt):
        trial = EI * (strains[2] - old[0])
        excess = ufl.max_value(abs(trial) - moment - hardening * old[1], 0) / (EI + hardening)
        return [old[0] + ufl.sign(trial) * excess, old[1] + excess]

    variables = fb.InternalVariables(("plastic curvature", "length of path"), flow)
    return fb.Section(strain_energy=energy, internal=variables, **inertia)


# -- 1. The bar ------------------------------------------------------------------------------------


def bend(material):
    """Curvatures and bending moments of a bar that is bent to and fro."""
    scene = fb.Scene()
    bar = scene.add_beam(
        [(0, 0), (1, 0)],
        material(**BAR, moment=BAR_YIELD, hardening=BAR_HARDENING),
        elements=1,
    )
    scene.clamp(bar.start)
    corners = range(len(CURVATURES))
    scene.prescribe(bar.end, rotation=lambda t: float(np.interp(t, corners, CURVATURES)))
    solution = fb.simulate(scene, dt=0.05, t_end=len(CURVATURES) - 1)
    plastic = solution.internal(bar, "plastic curvature")[:, 0]
    return solution, solution.rotation(bar.end), BAR["EI"] * (solution.rotation(bar.end) - plastic)


def exact_moments(curvatures, material):
    """The exact bending moments along the path, from corner to corner of the yield surface."""
    EI, H = BAR["EI"], BAR_HARDENING
    moment, centre, radius, moments = 0.0, 0.0, BAR_YIELD, [0.0]
    for change in np.diff(curvatures):
        trial = moment + EI * change
        flow = max(abs(trial - centre) - radius, 0.0) / (EI + H) * np.sign(trial - centre)
        moment = trial - EI * flow
        centre += H * flow if material is kinematic else 0.0
        radius += H * abs(flow) if material is isotropic else 0.0
        moments.append(moment)
    return np.array(moments)


# -- 2. The frame ----------------------------------------------------------------------------------


def frame(elements):
    """The frame and its left corner: loaded in the first second, pushed, and let back half-way."""
    scene = fb.Scene()
    section = isotropic(**FRAME, moment=FRAME_YIELD, hardening=FRAME_HARDENING)
    left = scene.add_beam([(0, 0), (0, HEIGHT)], section, elements=elements, name="left column")
    half = scene.add_beam([left.end, (SPAN / 2, HEIGHT)], section, elements=elements, name="left")
    rest = scene.add_beam([half.end, (SPAN, HEIGHT)], section, elements=elements, name="right")
    right = scene.add_beam([rest.end, (SPAN, 0)], section, elements=elements, name="right column")
    scene.clamp(left.start)
    scene.clamp(right.end)
    push(scene, left.end, half.end, SWAY)
    return scene, left.end


def push(scene, corner, middle, sway):
    scene.add_force(middle, lambda t: (0.0, -VERTICAL * min(t, 1.0)))
    scene.prescribe(corner, x=lambda t: sway * float(np.interp(t, (1, 2, 3), (0, 1, 0.5))))


def when_pushed(solution, history):
    """Value of a history when the frame has been pushed, before it is let back."""
    return float(history[solution.t <= 2 + 1e-9][-1])


def plastic_hinge(stiffness):
    """Spring that yields at the moment of the frame's members, with isotropic hardening."""

    def energy(x, a):
        return stiffness / 2 * (x - a[0]) ** 2 + HINGE_HARDENING / 2 * a[1] ** 2

    def flow(old, strains0, strains, dt):
        trial = stiffness * (strains[0] - old[0])
        excess = ufl.max_value(abs(trial) - FRAME_YIELD - HINGE_HARDENING * old[1], 0)
        flown = excess / (stiffness + HINGE_HARDENING)
        return [old[0] + ufl.sign(trial) * flown, old[1] + flown]

    variables = fb.InternalVariables(("plastic angle", "length of path"), flow)
    return fb.Spring(strain_energy=energy, internal=variables)


def hinged_frame(stiffer):
    """The frame of elastic members on plastic hinges, its left corner, and the hinges."""
    scene, spring = fb.Scene(), plastic_hinge(stiffer * HINGE)
    section = fb.Section(**{name: stiffer * value for name, value in FRAME.items()})
    places = [(0, 0), (0, HEIGHT), (SPAN / 2, HEIGHT), (SPAN, HEIGHT), (SPAN, 0)]
    members = [
        scene.add_beam(ends, section, elements=20)
        for ends in zip(places[:-1], places[1:], strict=True)
    ]
    before = [fb.GROUND, *(member.end for member in members)]
    after = [*(member.start for member in members), fb.GROUND]
    hinges = [
        scene.add_joint(fb.Revolute(a, b, spring=spring))
        for a, b in zip(before, after, strict=True)
    ]
    push(scene, members[0].end, members[1].end, SWAY / stiffer)
    return scene, members[0].end, hinges


def pushed(scene, corner):
    """Motion of a frame, and displacement [m] and force [N] at its left corner.

    It has no mass: its motion is a sequence of equilibria.
    """
    solution = fb.simulate(scene, dt=0.01, t_end=3.0)
    force = solution.reaction(corner)[:, 0]
    # Forces are those in the middle of each step.
    return (
        solution,
        np.interp(solution.t_level, solution.t, solution.displacement(corner)[:, 0]),
        force,
    )


# -- 3. The ring -----------------------------------------------------------------------------------


def ground(step):
    depth = step.X[1] + step.u[1]
    return -GROUND * ufl.min_value(depth, 0) * step.virtual_u[1]


def drop():
    """The ring falls from a height of one radius above the ground."""
    scene, R = fb.Scene(gravity=(0.0, -GRAVITY)), RADIUS
    section = kinematic(**RING, moment=RING_YIELD, hardening=RING_HARDENING)
    low, high = (0.0, 0.05), (0.0, 0.05 + 2 * R)
    right = scene.add_beam(
        fb.arc(low, (R, 0.05 + R), high), section, elements=24, degree=2, name="right half"
    )
    left = scene.add_beam(
        fb.arc(right.end, (-R, 0.05 + R), right.start),
        section,
        elements=24,
        degree=2,
        name="left half",
    )
    for half in (right, left):
        scene.set_velocity(half, (0.0, -SPEED))
    scene.add_virtual_work(ground)
    return fb.simulate(scene, dt=DT, t_end=T_END), right, left


def bend_of_ring(solution, halves):
    """Lowest and highest plastic curvature [1/m] at the end."""
    curvatures = [solution.internal(half, "plastic curvature")[-1] for half in halves]
    return float(np.min(curvatures)), float(np.max(curvatures))


def compute(elements=ELEMENTS):
    """The numbers, and what is drawn."""
    loops = {}
    for material in (kinematic, isotropic):
        log.info("the bar with %s hardening", material.__name__)
        loops[material.__name__] = bend(material), material
    frames = {}
    for count in elements:
        log.info("the frame with %d elements in a column", count)
        frames[count] = pushed(*frame(count))
    hinged = {}
    for stiffer in STIFFER:
        log.info("the frame on hinges, %d times as stiff", stiffer)
        scene, corner, hinges = hinged_frame(stiffer)
        hinged[stiffer] = *pushed(scene, corner), hinges
    log.info("the ring")
    ring, *halves = drop()
    numbers = {
        "bar": {
            name: {
                "error of the moment": abs(M - exact_moments(kappa, material)).max() / BAR_YIELD,
                "dissipated": solution.energy.dissipated[-1],
                "least loss of a step": np.diff(solution.energy.dissipated).min(),
            }
            for name, ((solution, kappa, M), material) in loops.items()
        },
        "limit load": LIMIT,
        "frame": {
            str(count): {
                "force": when_pushed(solution, force),
                "relative to limit": when_pushed(solution, force) / LIMIT,
                "sub-steps": solution.stats.substeps,
                "relative balance error": relative_balance_error(solution),
            }
            for count, (solution, _, force) in frames.items()
        },
        "frame on hinges": {
            str(stiffer): {
                "force": when_pushed(solution, force),
                "relative to limit": when_pushed(solution, force) / LIMIT,
                "plastic angles": [
                    when_pushed(solution, solution.joint(hinge).internal("plastic angle"))
                    for hinge in hinges
                ],
                "sub-steps": solution.stats.substeps,
                "relative balance error": relative_balance_error(solution),
            }
            for stiffer, (solution, _, force, hinges) in hinged.items()
        },
        "ring": {
            "plastic curvatures": bend_of_ring(ring, halves),
            "dissipated": ring.energy.dissipated[-1] / ring.energy.kinetic[0],
            "least loss of a step": np.diff(ring.energy.dissipated).min(),
            "relative balance error": relative_balance_error(ring),
        },
    }
    return numbers, (loops, frames, hinged[1], ring)


def relative_balance_error(solution):
    """Largest error of the energy balance, relative to what was dissipated."""
    return float(abs(solution.energy.balance_error).max() / solution.energy.dissipated[-1])


def report(numbers):
    print("1. The bar            error of M / M_p   dissipated [J]   least loss of a step [J]")
    for name, bar in numbers["bar"].items():
        print(
            f"   {name:18} {bar['error of the moment']:17.1e} {bar['dissipated']:16.4f} "
            f"{bar['least loss of a step']:26.1e}"
        )
    print(f"\n2. The frame: limit load {numbers['limit load'] / 1e3:.1f} kN")
    print("   elements in a column   force [kN]   relative to the limit   balance error")
    for count, run in numbers["frame"].items():
        print(
            f"   {count:>20} {run['force'] / 1e3:12.2f} {run['relative to limit']:23.4f} "
            f"{run['relative balance error']:15.1e}"
        )
    for stiffer, run in numbers["frame on hinges"].items():
        print(
            f"   {f'hinges, {stiffer} x as stiff':>20} {run['force'] / 1e3:12.2f} "
            f"{run['relative to limit']:23.5f} {run['relative balance error']:15.1e}"
        )
    ring = numbers["ring"]
    low, high = ring["plastic curvatures"]
    print(
        f"\n3. The ring keeps plastic curvatures from {low:.2f} to {high:.2f} 1/m (its own is "
        f"{1 / RADIUS:.0f} 1/m). It has lost {ring['dissipated']:.0%} of its energy; balance error "
        f"{ring['relative balance error']:.1e}."
    )


def draw(results, loops, frames, hinged, ring):
    # Imported here: the numbers need neither matplotlib nor pyvista.
    from fx_beam import plot
    from shared import thumbnail

    plot.scene(frame(8)[0], results / "scene.png", dimensions=True)

    figure, axes = plot.figure(1, 2, height=3.2)
    axes = axes.flatten()
    for name, ((_, kappa, M), material) in loops.items():
        (line,) = axes[0].plot(kappa, M, label=f"{name} hardening")
        axes[0].plot(kappa[::5], exact_moments(kappa, material)[::5], ".", color=line.get_color())
    axes[0].plot([], [], "k.", label="exact")
    axes[0].set(xlabel=r"curvature $\kappa$ [1/m]", ylabel="bending moment $M$ [N m]")
    for number, (count, (_, sway, force)) in enumerate(frames.items(), start=2):
        label = f"{count} elements in a column"
        axes[1].plot(1e3 * sway, force / 1e3, f"C{number}", label=label)
    _, sway, force, _ = hinged
    axes[1].plot(1e3 * sway, force / 1e3, "k", linewidth=0.8, label="elastic members on hinges")
    axes[1].axhline(LIMIT / 1e3, color="0.5", linestyle="--", label="limit load by hand")
    axes[1].set(xlabel="sway of the corner [mm]", ylabel="force $F$ [kN]")
    plot.save(figure, results / "loops.png")

    thumbnail.card(ring, range(0, len(ring.t), 25), results / "thumbnail.png")
    plot.shapes(ring, results / "ring.png", rows=SHOWN, colour="plastic curvature")
    plot.animate(
        ring, results / "motion.gif", rows=range(0, len(ring.t), 30), colour="plastic curvature"
    )


if __name__ == "__main__":
    script.run()
